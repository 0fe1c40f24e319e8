"""The ROS 2 node of a served world: its topics, commands and services, in the server's loop."""

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
from usarmjx.server.ros2.node import NodeParameter, ParameterServices, ServiceAnswer, WorldServices
from usarmjx.server.ros2.transport import (
    CLOCK,
    COMMANDS,
    DEFAULT,
    LATCHED,
    SENSOR,
    Closable,
    Qos,
    Reply,
    Transport,
)
from usarmjx.server.ros2.worker import Outlet, TransportCounts, TransportWorker
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.encodings import CdrReader
from usarmjx.server.rosbridge.images import image_view, picture_message
from usarmjx.server.rosbridge.motion import MAP
from usarmjx.server.rosbridge.robot_description import urdf
from usarmjx.server.rosbridge.services import RosRobots
from usarmjx.server.rosbridge.topics import TWIST, RosTopic, WorldTopics
from usarmjx.server.runtime.logs import FaultLog
from usarmjx.server.worlds.served_world import ServedWorld

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
        self._stepped.set()
        self._stepped.clear()
        if self._robots is None:
            return
        for _ in range(min(len(self._incoming), MOST_PER_STEP)):
            self._incoming.popleft()()
        self._robots.forget_lost()
        self._robots.tick()
        topics = self._topics.all()
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
