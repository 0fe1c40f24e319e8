"""The ROS 2 node of a served world: topics, commands, services and parameters, in the server's loop."""

import asyncio
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable, Hashable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.base.installation import install_command
from usarmjx.base.settings import AT_LEAST_ONE, Setting, validate
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.pictures.views import CompositeView, RenderThread, ViewImages
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.ros2.transport import (
    CLOCK,
    COMMANDS,
    DEFAULT,
    LATCHED,
    NODE,
    SENSOR,
    Closable,
    Qos,
    Reply,
    Transport,
)
from usarmjx.server.ros2.worker import Outlet, TransportCounts, TransportWorker
from usarmjx.server.rosbridge.definitions import EMPTY, RosMessage, RosVersion
from usarmjx.server.rosbridge.encodings import CdrReader
from usarmjx.server.rosbridge.motion import MAP
from usarmjx.server.rosbridge.robot_description import urdf
from usarmjx.server.rosbridge.services import RosRobots, read_spawn
from usarmjx.server.rosbridge.topics import TWIST, RosTopic, WorldTopics, image_view, picture_message
from usarmjx.server.runtime.logs import FaultLog
from usarmjx.server.worlds.served_world import ServedWorld

UNSUPPORTED, OK, NOT_FOUND, FAILED = 0, 1, 2, 4
"""Values of simulation_interfaces/Result's result."""
SCOPE_TIME, SCOPE_STATE, SCOPE_SPAWNED, SCOPE_ALL = 1, 2, 4, 255
"""Bits of ResetSimulation's scope; 0 means all."""
WORLD_FRAMES = ("", MAP, "world")
"""Frames of a spawn pose."""
ServiceAnswer = RosMessage | Awaitable[RosMessage]
NOT_SET, BOOL, INTEGER, DOUBLE, STRING = range(5)
"""Values of ParameterType that parameters have here."""
VALUE_FIELDS = {BOOL: "bool_value", INTEGER: "integer_value", DOUBLE: "double_value", STRING: "string_value"}
TYPE_NAMES = {BOOL: "a bool", INTEGER: "an integer", DOUBLE: "a double", STRING: "a string"}
SEPARATOR = "."
"""Separator of the parts of a parameter's name."""


class WorldServices:
    """The services of a world.

    Args:
        server: The world's server.
        topics: Its topics, which know the robots' names.
        robots: Robots that ROS 2 lets appear.
        stepped: Is set and cleared in each control step.
    """

    def __init__(
        self, server: BotServer, topics: WorldTopics, robots: RosRobots, stepped: asyncio.Event
    ) -> None:
        self._server, self._topics, self._robots, self._stepped = server, topics, robots, stepped

    def services(self) -> dict[str, tuple[str, Callable[[RosMessage], ServiceAnswer]]]:
        """Return the type and the function of each service, by its name."""
        return {
            "/spawn_entity": ("simulation_interfaces/srv/SpawnEntity", self._spawn),
            "/delete_entity": ("simulation_interfaces/srv/DeleteEntity", self._delete),
            "/reset_simulation": ("simulation_interfaces/srv/ResetSimulation", self._reset),
            "/reset": ("std_srvs/srv/Empty", self._reset_plainly),
        }

    async def _spawn(self, request: RosMessage) -> RosMessage:
        """Spawn a robot of the class that the resource names."""
        try:
            init, spec = read_spawn(self._spawn_arguments(request))
            await self._server.prepare(spec)
            robot = await self._server.join(partial(self._robots.spawn, init, spec))
        except UsageError as error:
            return {"result": _result(FAILED, str(error)), "entity_name": ""}
        return {"result": _result(OK), "entity_name": self._topics.name_of(robot)}

    def _spawn_arguments(self, request: RosMessage) -> dict[str, Any]:
        resource, stamped = request["entity_resource"], request["initial_pose"]
        name, space = request["name"], request["entity_namespace"].strip("/")
        if resource["resource_string"]:
            raise UsageError("resource_string is not read: uri names a robot class, such as P2AT")
        if space not in ("", name):
            raise UsageError(f"entity_namespace is {clip(space)}; a robot's topics are below its name")
        frame = stamped["header"]["frame_id"]
        if frame.lstrip("/") not in WORLD_FRAMES:
            raise UsageError(f"initial_pose is in frame {clip(frame)}, expected {MAP}")
        taken = {robot.name.lower() for robot in self._server.world.robots.values()}
        if request["allow_renaming"] and name.lower() in taken:
            name = ""  # the world numbers robots without a name
        found: dict[str, Any] = {"class": resource["uri"], "name": name}
        pose = stamped["pose"]
        # A pose that nobody has filled in is a start of the arena.
        if frame or any(pose["position"].values()) or pose["orientation"]["w"] not in (0.0, 1.0):
            found["pose"] = pose
        return found

    def _delete(self, request: RosMessage) -> RosMessage:
        name = request["entity"].strip("/")
        robot = self._topics.robots().get(name)
        try:
            self._robots.remove(robot.name if robot is not None else name)
        except UsageError as error:
            return {"result": _result(FAILED if robot is not None else NOT_FOUND, str(error))}
        return {"result": _result(OK)}

    async def _reset(self, request: RosMessage) -> RosMessage:
        """Restart the world, or remove the robots that appeared by `/spawn_entity`."""
        scope = request["scope"] or SCOPE_ALL
        if scope == SCOPE_TIME:
            return {"result": _result(UNSUPPORTED, "time goes on: reset the state, which is 2")}
        try:
            if scope & SCOPE_SPAWNED:
                self._robots.dismiss()
                while not self._robots.is_empty:
                    # `dismiss` removes a robot for each control step, within the share for leaving.
                    await self._stepped.wait()
            if scope & SCOPE_STATE:
                await self._restart()
        except UsageError as error:
            return {"result": _result(FAILED, str(error))}
        return {"result": _result(OK)}

    async def _reset_plainly(self, request: RosMessage) -> RosMessage:
        """Restart the world; robots stay, at their starts."""
        del request
        await self._restart()
        return dict.fromkeys(EMPTY, 0)

    async def _restart(self) -> None:
        world = self._server.world
        # Compiling for a reset may take seconds, for which the loop must step on.
        await asyncio.get_running_loop().run_in_executor(None, world.prepare_reset)
        # Between two control steps, not in the middle of a service's turn.
        await self._stepped.wait()
        world.reset()


def _result(code: int, message: str = "") -> RosMessage:
    return {"result": code, "error_message": message}


@dataclass(frozen=True)
class NodeParameter:
    """A parameter.

    Attributes:
        about: Its description.
        get: Returns its value: a bool, an int, a float or a text.
        set: Sets it; None: it is read-only.
    """

    about: str
    get: Callable[[], bool | int | float | str]
    set: Callable[[Any], None] | None = None


def parameter_value(value: bool | int | float | str | None) -> RosMessage:
    """Return a value as a ParameterValue; None is not set."""
    kind = NOT_SET if value is None else _type_of(value)
    message: RosMessage = {
        "type": kind,
        "bool_value": False,
        "integer_value": 0,
        "double_value": 0.0,
        "string_value": "",
        "byte_array_value": b"",
        "bool_array_value": [],
        "integer_array_value": [],
        "double_array_value": [],
        "string_array_value": [],
    }
    if kind != NOT_SET:
        message[VALUE_FIELDS[kind]] = value
    return message


def _type_of(value: bool | int | float | str) -> int:
    # First, as True and False are whole numbers in Python, too.
    if isinstance(value, bool):
        return BOOL
    return INTEGER if isinstance(value, int) else DOUBLE if isinstance(value, float) else STRING


class ParameterServices:
    """The services of a node's parameters.

    Args:
        parameters: Returns the present parameters, by their names.
    """

    def __init__(self, parameters: Callable[[], Mapping[str, NodeParameter]]) -> None:
        self._parameters = parameters

    def services(self) -> dict[str, tuple[str, Callable[[RosMessage], RosMessage]]]:
        """Return the type and the function of each service, by its name."""
        found = {
            "get_parameters": ("GetParameters", self._get),
            "get_parameter_types": ("GetParameterTypes", self._types),
            "set_parameters": ("SetParameters", self._set),
            "set_parameters_atomically": ("SetParametersAtomically", self._set_all),
            "describe_parameters": ("DescribeParameters", self._describe),
            "list_parameters": ("ListParameters", self._list),
        }
        return {
            f"/{NODE}/{name}": (f"rcl_interfaces/srv/{kind}", function)
            for name, (kind, function) in found.items()
        }

    def _get(self, request: RosMessage) -> RosMessage:
        known = self._parameters()
        return {
            "values": [
                parameter_value(known[name].get() if name in known else None) for name in request["names"]
            ]
        }

    def _types(self, request: RosMessage) -> RosMessage:
        known = self._parameters()
        return {
            "types": [_type_of(known[name].get()) if name in known else NOT_SET for name in request["names"]]
        }

    def _set(self, request: RosMessage) -> RosMessage:
        return {"results": [self._set_one(one) for one in request["parameters"]]}

    def _set_all(self, request: RosMessage) -> RosMessage:
        """Set all parameters, or none if one of them cannot be set."""
        for one in request["parameters"]:
            if reason := self._refusal(one):
                return {"result": {"successful": False, "reason": reason}}
        for one in request["parameters"]:
            self._set_one(one)
        return {"result": {"successful": True, "reason": ""}}

    def _set_one(self, one: RosMessage) -> RosMessage:
        reason = self._refusal(one)
        found = self._parameters().get(one["name"])
        if not reason and found is not None and found.set is not None:
            try:
                found.set(one["value"][VALUE_FIELDS[one["value"]["type"]]])
            except UsageError as error:
                reason = str(error)
        return {"successful": not reason, "reason": reason}

    def _refusal(self, one: RosMessage) -> str:
        """Return why a parameter cannot be set; empty if it can."""
        name, known = one["name"], self._parameters()
        if name not in known:
            return f"no parameter {clip(name)}; known: {', '.join(known)}"
        if known[name].set is None:
            return f"{name} is read-only"
        wanted = _type_of(known[name].get())
        # ROS 2's parameters are typed statically: an int for a double is refused, as rclcpp does.
        return "" if one["value"]["type"] == wanted else f"{name} is {TYPE_NAMES[wanted]}"

    def _describe(self, request: RosMessage) -> RosMessage:
        known = self._parameters()
        return {"descriptors": [_descriptor(name, known.get(name)) for name in request["names"]]}

    def _list(self, request: RosMessage) -> RosMessage:
        """List the parameters below some prefixes, as deep as asked; 0: all."""
        prefixes, depth = request["prefixes"], request["depth"]
        names = [name for name in self._parameters() if _is_below(name, prefixes, depth)]
        above = {name.rpartition(SEPARATOR)[0] for name in names}
        return {"result": {"names": names, "prefixes": sorted(above - {""})}}


def _is_below(name: str, prefixes: list[str], depth: int) -> bool:
    if not prefixes:
        return depth == 0 or name.count(SEPARATOR) < depth
    # Whole parts only: prefix `R1` must not find R10.robot_description.
    below = [prefix for prefix in prefixes if name == prefix or name.startswith(prefix + SEPARATOR)]
    return any(depth == 0 or name[len(prefix) :].count(SEPARATOR) <= depth for prefix in below)


def _descriptor(name: str, found: NodeParameter | None) -> RosMessage:
    return {
        "name": name,
        "type": NOT_SET if found is None else _type_of(found.get()),
        "description": "" if found is None else found.about,
        "additional_constraints": "",
        "read_only": found is not None and found.set is None,
        "dynamic_typing": False,
        "floating_point_range": [],
        "integer_range": [],
    }


log = logging.getLogger(__name__)

IMAGE_PERIOD = 0.1
"""Least interval between two pictures of a topic [s]."""
MOST_INCOMING, MOST_PER_STEP = 1024, 64
"""Most messages and requests that wait for the loop, and most of them in a control step."""
HEADER_BYTES = {"dds": 16, "zenoh": 0}
"""Bytes before the fields of a request, by transport."""
LAST_DOMAIN = 232
"""Last domain whose ports exist."""
STATES = ("nav_msgs/Odometry", "sensor_msgs/JointState", "sensor_msgs/BatteryState", "tf2_msgs/TFMessage")
"""Types of which a late message is worth sending."""
TWIST_STAMPED = "geometry_msgs/TwistStamped"
LoopWork = Callable[[], None]


@dataclass(frozen=True)
class Ros2Settings:
    """Settings of the ROS 2 node.

    Attributes:
        domain: Number of the domain.
        transport: Middleware: `dds` for DDS, `zenoh` for Zenoh.
        is_local: Whether only nodes on this machine are found.
        size: Width and height of pictures [pixels].
        infinite_ranges: Whether a beam without an echo is infinite, as REP 117 wants it, not the largest
            range.
        publishes_map: Whether `/map` and the frame `map` are published, which a node that localises or maps
            publishes otherwise.
    """

    domain: Annotated[int, Setting(ge=0, le=LAST_DOMAIN)] = 0
    transport: Annotated[str, Setting(choices=("dds", "zenoh"))] = "dds"
    is_local: bool = True
    size: Annotated[tuple[int, int], AT_LEAST_ONE] = (320, 240)
    infinite_ranges: bool = False
    publishes_map: bool = True

    def __post_init__(self) -> None:
        """Check the settings."""
        validate(self)


def open_transport(settings: Ros2Settings) -> Transport:
    """Return the transport that settings name.

    Raises:
        UsageError: Its library is not installed, or it cannot be opened.
    """
    try:
        if settings.transport == "zenoh":
            from usarmjx.server.ros2.zenoh_transport import ZenohTransport

            return ZenohTransport(settings.domain)
        from usarmjx.server.ros2.dds_transport import DdsTransport
    except ImportError as error:
        raise UsageError(f"--ros2 needs the extra ros2: {install_command('ros2')} ({error})") from error
    return DdsTransport(settings.domain, is_local=settings.is_local)


def quality(topic: RosTopic) -> Qos:
    """Return the quality of a topic."""
    if topic.is_latched:
        return LATCHED
    if topic.type == "rosgraph_msgs/Clock":
        return CLOCK
    return DEFAULT if topic.type in STATES else SENSOR


@dataclass(eq=False)
class PublishedTopic:
    """A topic that is published.

    Attributes:
        topic: The topic.
        outlet: Outlet of its messages.
        revision: Revision of the last message.
        due: Simulated time of the next one, of pictures [s].
    """

    topic: RosTopic
    outlet: Outlet
    revision: Hashable = None
    due: float = 0.0


class Ros2Server:
    """The ROS 2 node of one world; a `gamebots.server.Service`.

    Args:
        world: The served world.
        settings: Settings of the node.
        opening: Opens the transport; None: the one that the settings name.

    Attributes:
        server: The world's server, which spawned robots report to; set it before the start.
    """

    def __init__(
        self, world: ServedWorld, settings: Ros2Settings, opening: Callable[[], Transport] | None = None
    ) -> None:
        self._world, self._settings = world, settings
        self._infinite = settings.infinite_ranges
        self.server: BotServer | None = None
        self._topics = WorldTopics(world, settings.size)
        self._worker = TransportWorker(opening or partial(open_transport, settings))
        self._known: Mapping[str, RosTopic] = {}
        self._published: dict[str, PublishedTopic] = {}
        self._heard: dict[str, list[Closable]] = {}
        self._services: list[Closable] = []
        self._incoming: deque[LoopWork] = deque()
        self._stepped = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._robots: RosRobots | None = None
        self._render_thread = RenderThread(world)
        self._fault_log = FaultLog(log)

    @property
    def counts(self) -> TransportCounts:
        """Counters of the messages so far."""
        return self._worker.counts

    async def start(self) -> list[str]:
        """Join the domain; return a line for the user.

        Raises:
            UsageError: That is not possible.
        """
        if self.server is None:
            raise UsageError("the ROS 2 node has no server")
        # Joining a domain waits for the network: not in the loop.
        await asyncio.get_running_loop().run_in_executor(None, self._worker.start)
        self._robots = RosRobots(self.server, "ROS 2")
        world = WorldServices(self.server, self._topics, self._robots, self._stepped)
        for services in (world.services(), ParameterServices(self._parameters).services()):
            for name, (kind, function) in services.items():
                take = partial(self._request, kind, function)
                self._services.append(self._worker.serve(name, kind, take))
        settings = self._settings
        where = (
            "" if settings.transport == "zenoh" else ", this machine" if settings.is_local else ", network"
        )
        return [f"ROS 2 by {settings.transport}: domain {settings.domain}{where}, node /usarmjx"]

    def tick(self) -> None:
        """Carry out what has come, and publish new messages that somebody reads."""
        # Wakes all that wait now, and nobody who begins to wait later.
        self._stepped.set()
        self._stepped.clear()
        if self._robots is None:
            return
        # Bounded by what is there now: work that adds work must wait for the next step.
        for _ in range(min(len(self._incoming), MOST_PER_STEP)):
            self._incoming.popleft()()
        self._robots.forget_lost()
        self._robots.tick()
        topics = self._topics.all()
        # By identity: the topics stay the same object until a robot comes or goes.
        if topics is not self._known:
            self._follow(topics)
        pictures: list[PublishedTopic] = []
        for one in self._published.values():
            if one.outlet.wanted:
                self._publish(one, pictures)
        if pictures and self._render_thread.is_ready(time.monotonic()):
            self._render_thread.begin(self._show(pictures))
        self._fault_log.flush()

    def stop(self) -> None:
        """Leave the domain."""
        for task in self._tasks:
            task.cancel()
        self._render_thread.close()
        self._worker.stop()

    # Topics

    def _follow(self, topics: Mapping[str, RosTopic]) -> None:
        """Announce new topics, and withdraw those that are gone."""
        self._known = topics
        for name in [name for name, one in self._published.items() if topics.get(name) is not one.topic]:
            # A topic that is made anew with the same type keeps its publisher.
            new, one = topics.get(name), self._published[name]
            if new is not None and new.type == one.topic.type:
                one.topic = new
            else:
                self._worker.withdraw(self._published.pop(name).outlet)
        for name in [name for name in self._heard if name not in topics]:
            for closable in self._heard.pop(name):
                closable.close()
        for name, topic in topics.items():
            if topic.is_listened_to:
                if name not in self._heard:
                    self._heard[name] = self._listen(topic)
            elif name not in self._published and (name != "/map" or self._settings.publishes_map):
                outlet = self._worker.advertise(name, topic.type, quality(topic))
                self._published[name] = PublishedTopic(topic, outlet)

    def _listen(self, topic: RosTopic) -> list[Closable]:
        # Later tools of ROS 2 send stamped velocities, others plain ones.
        kinds = (TWIST, TWIST_STAMPED) if topic.type == TWIST else (topic.type,)
        return [
            self._worker.subscribe(topic.name, kind, COMMANDS, partial(self._hear, topic.name, kind))
            for kind in kinds
        ]

    def _publish(self, one: PublishedTopic, pictures: list[PublishedTopic]) -> None:
        topic, revision = one.topic, one.topic.revision()
        if revision is None or revision == one.revision:
            return
        if topic.make is None:
            # Times are sums of periods, with rounding errors.
            if self._world.time >= one.due - 1e-6:
                pictures.append(one)
            return
        one.revision = revision
        try:
            message = self._adapted(topic, topic.make(RosVersion.ROS2))
        except Exception as error:  # a sensor may be a user's own, with any error in its reading
            self._fault_log.warning("%s is not published: %s", topic.name, error)
            return
        self._worker.send(one.outlet, message)

    def _adapted(self, topic: RosTopic, message: RosMessage) -> RosMessage:
        """Return a message as the settings want it."""
        if topic.type == "sensor_msgs/LaserScan" and self._infinite:
            ranges = np.asarray(message["ranges"])
            return {**message, "ranges": np.where(ranges >= message["range_max"], np.inf, ranges)}
        if topic.name in ("/tf_static", "/tf") and not self._settings.publishes_map:
            # A mapping program of the user publishes these itself: two parents of a frame would fight.
            kept = [one for one in message["transforms"] if one["header"]["frame_id"] != MAP]
            return {"transforms": kept}
        return message

    async def _show(self, asked: list[PublishedTopic]) -> None:
        now, views = self._world.time, dict[str, CompositeView]()
        for one in asked:
            views[one.topic.name] = image_view(one.topic, self._settings.size)
            # Before rendering: a tick in the meantime must not order the same picture again.
            one.revision, one.due = one.topic.revision(), now + IMAGE_PERIOD

        def make(pictures: ViewImages) -> list[RosMessage]:
            return [
                picture_message(one.topic, RosVersion.ROS2, now, pictures[views[one.topic.name]])
                for one in asked
            ]

        for one, message in zip(asked, await self._render_thread.render(views.values(), make), strict=True):
            self._worker.send(one.outlet, message)

    # Commands and services; the first two are called in the threads of the transport

    def _hear(self, name: str, kind: str, data: bytes) -> None:
        self._enqueue(partial(self._execute, name, kind, data))

    def _request(self, kind: str, function: Callable[[RosMessage], Any], data: bytes, reply: Reply) -> None:
        self._enqueue(partial(self._serve, kind, function, data, reply))

    def _enqueue(self, work: LoopWork) -> None:
        self.counts.received += 1
        if len(self._incoming) >= MOST_INCOMING:
            # The oldest goes: of commands the latest counts.
            self._incoming.popleft()
            self.counts.dropped += 1
        self._incoming.append(work)

    def _execute(self, name: str, kind: str, data: bytes) -> None:
        topic = self._topics.all().get(name)
        if topic is None or topic.robot is None or self._robots is None:
            return
        try:
            self._robots.command(topic.robot, topic.type, CdrReader(data).message(kind))
        except (PeerError, UsageError) as error:
            self._fault_log.warning("%s: %s", name, error)

    def _serve(self, kind: str, function: Callable[[RosMessage], Any], data: bytes, reply: Reply) -> None:
        try:
            skip = HEADER_BYTES[self._settings.transport]
            answer: ServiceAnswer = function(CdrReader(data, skip).message(f"{kind}_Request"))
        except PeerError as error:
            self._fault_log.warning("%s: %s", kind, error)
            return
        if not isinstance(answer, Awaitable):
            self._worker.reply(reply, f"{kind}_Response", answer)
            return

        async def finish() -> None:
            self._worker.reply(reply, f"{kind}_Response", await answer)

        task = asyncio.get_running_loop().create_task(finish())
        # The loop keeps only weak references to tasks: without this one a task may be collected while it
        # runs.
        self._tasks.add(task)
        task.add_done_callback(self._finished)

    def _finished(self, task: "asyncio.Task[None]") -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()):
            log.error("a service of ROS 2 failed", exc_info=error)

    def _parameters(self) -> Mapping[str, NodeParameter]:
        """Return the node's parameters: some of the world, and a description of each robot."""
        found = {
            "use_sim_time": NodeParameter("Whether stamps are simulated time.", lambda: True),
            "arena": NodeParameter("Name of the arena.", lambda: self._world.arena.name),
            "infinite_ranges": NodeParameter(
                "Whether a beam without an echo is infinite (REP 117), not the largest range.",
                lambda: self._infinite,
                self._set_infinite,
            ),
        }
        for name, robot in self._topics.robots().items():
            text = partial(urdf, robot.spec)
            found[f"{name}.robot_description"] = NodeParameter("URDF of the robot.", text)
        return found

    def _set_infinite(self, value: bool) -> None:
        self._infinite = value
