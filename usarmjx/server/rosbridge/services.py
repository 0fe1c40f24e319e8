"""Services: robots of a client, which come and go; and rosapi's topics, nodes, types and parameters."""

import json
import logging
import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from usarmjx.base.backend import ArrayLike, numpy_backend
from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import angles_from_mat
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import RobotSpec
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.spawning import spawn_from_init
from usarmjx.server.protocol.commands import Init
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.rosbridge.definitions import (
    BUILTIN,
    MessageFields,
    RosMessage,
    RosVersion,
    json_object,
)
from usarmjx.server.rosbridge.motion import TrajectoryRun, drive_keys, read_trajectory, read_twist
from usarmjx.server.rosbridge.republisher import REPUBLISH
from usarmjx.server.rosbridge.robot_description import urdf
from usarmjx.server.rosbridge.service_types import (
    SERVICE_TYPES,
    TYPE_DEFINITION,
    TYPE_DEFINITION_FIELDS,
    find_service_type,
    short_name,
)
from usarmjx.server.rosbridge.topics import TRAJECTORY, WorldTopics
from usarmjx.server.worlds.robot import Robot
from usarmjx.sim.control import CommandUpdate, ControlMode

log = logging.getLogger(__name__)
SPAWN, REMOVE = "/simulator/spawn", "/simulator/remove"
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
"""Allowed names of spawned robots: they also name topics and frames."""


class RosRobots:
    """Robots of a client; those that it spawned are removed when it leaves.

    Args:
        server: The world's server.
        peer: Name of the client in the log.
    """

    def __init__(self, server: BotServer, peer: str) -> None:
        self._server, self._peer = server, peer
        self._own: list[Client] = []
        self._driven: list[Robot] = []
        self._runs: dict[Robot, TrajectoryRun] = {}

    @property
    def is_empty(self) -> bool:
        """Whether no robot that it spawned is left."""
        self.forget_lost()
        return not self._own

    def spawn(self, init: Init, spec: RobotSpec) -> Robot:
        """Spawn a robot, which reports without a connection.

        Raises:
            UsageError: There is no room for it, or its name is taken.
        """
        world = self._server.world
        # The same way as INIT over the Gamebots port, with its rules of names and poses.
        robot = spawn_from_init(world, init, spec)
        own = Client(world, self._peer)
        own.attach_robot(robot, robot.spawn_time)
        self._server.guests.append(own)
        self._own.append(own)
        log.info("%s: spawned %s as %r", self._peer, spec.name, robot.name)
        return robot

    def remove(self, name: str) -> None:
        """Remove a robot that this client spawned.

        Raises:
            UsageError: It has none of that name.
        """
        own = next((one for one in self._own if one.robot and one.robot.name.lower() == name.lower()), None)
        if own is None:
            raise UsageError(f"you have let no robot {clip(name)} appear")
        self._remove(own)

    def dismiss(self) -> None:
        """Let its robots leave, one after the other: all at once would delay the others' reports."""
        for own in self._own:
            self._detach(own)
            self._server.dismiss(own)

    def forget_lost(self) -> None:
        """Forget robots that are gone, or that another client has taken over."""
        # A list, as the loop removes from it.
        for own in [one for one in self._own if one.robot is None or one.lost]:
            self._own.remove(own)
            self._detach(own)

    def command(self, robot: Robot, kind: str, message: object) -> None:
        """Give a robot a message of a type that it listens to.

        Raises:
            UsageError: It is no such message, or somebody else drives the robot.
        """
        if robot.controller is not None:
            raise UsageError(f"{robot.name} is driven from the page")
        if self._server.world.robots.get(robot.slot) is not robot:
            raise UsageError(f"a policy drives {robot.name}: /simulator/spawn with that name takes it over")
        if kind == TRAJECTORY:
            self._follow(robot, message)
        else:
            self._drive(robot, message)

    def tick(self) -> None:
        """Move the joints of robots that follow trajectories."""
        world = self._server.world
        # A list, as finished runs are deleted on the way.
        for robot, run in list(self._runs.items()):
            if world.robots.get(robot.slot) is not robot or robot.controller is not None:
                del self._runs[robot]
                continue
            if world.time >= run.start:
                goals: dict[str, ArrayLike] = {**run.at(world.time)}
                world.update_command(robot, CommandUpdate(joints=goals, mode=ControlMode.POSITION))
            if run.is_over(world.time):
                del self._runs[robot]

    def _follow(self, robot: Robot, message: object) -> None:
        """Let a robot follow a JointTrajectory from now on, or from its header's time."""
        path = read_trajectory(message, robot.plan)
        # Also without points: such a trajectory stops the robot.
        self._runs.pop(robot, None)
        if path is None:
            return
        world = self._server.world
        # Part 0 is the chassis, which has no joint.
        places = [robot.plan.parts.index(name) - 1 for name in path.joints]
        now = np.asarray(world.state(robot).joint_pos, float)[places]
        # A start that has passed, as 0 has, means now.
        self._runs[robot] = TrajectoryRun(path, max(world.time, path.start), now)

    def _drive(self, robot: Robot, twist: object) -> None:
        """Set a robot's velocity to a Twist, until the next one."""
        keys = drive_keys(robot.spec, read_twist(twist))
        self._server.world.update_command(robot, CommandUpdate(drive=keys))
        if robot not in self._driven:
            self._driven.append(robot)

    def stop_driven(self) -> None:
        """Stop the robots that it has driven."""
        world = self._server.world
        self._runs.clear()
        for robot in self._driven:
            # Its slot may have another robot by now.
            if world.robots.get(robot.slot) is robot and robot.controller is None:
                still: dict[str, ArrayLike] = dict.fromkeys(robot.spec.drive.keys, 0.0)
                world.update_command(robot, CommandUpdate(drive=still))
        self._driven.clear()

    def _remove(self, own: Client) -> None:
        self._own.remove(own)
        self._detach(own)
        if own.robot is not None and not own.lost:
            own.leave()

    def _detach(self, own: Client) -> None:
        if own in self._server.guests:
            self._server.guests.remove(own)


def read_spawn(args: Mapping[str, Any]) -> tuple[Init, RobotSpec]:
    """Return INIT and class for a request to spawn a robot.

    Args:
        args: `class`; optionally `name`, and `pose`, a geometry_msgs/Pose, or `start`, the tag of a
            start pose.

    Raises:
        UsageError: An argument is not valid.
    """
    # Only registered classes: a name from the network must not open a file.
    kind, name = str(args.get("class", "")), args.get("name") or ""
    if kind not in ROBOTS:
        raise UsageError(f"unknown robot {clip(kind)}; known: {', '.join(ROBOTS.names())}")
    if name and not (isinstance(name, str) and NAME.fullmatch(name)):
        raise UsageError(f"a name has up to 40 letters, digits and _, not {clip(str(name))}")
    spec, pose = ROBOTS.get(kind), args.get("pose")
    start = str(args.get("start") or "")
    if pose is None:
        return Init(spec.name, name, None, None, start), spec
    if start:
        raise UsageError("give either pose or start")
    location = _numbers(pose, "position", "xyz")
    x, y, z, w = _numbers(pose, "orientation", "xyzw")
    # Clients send quaternions of rounded numbers, and a matrix needs unit length.
    length = float(np.linalg.norm((w, x, y, z)))
    if length < 1e-6:
        raise UsageError("an orientation of length 0 is none")
    with numpy_backend():
        angles = angles_from_mat(np.asarray(mat_from_quat(np.array((w, x, y, z)) / length)))
    return Init(spec.name, name, flip_wire_vector(location), flip_wire_angles(angles.tolist())), spec


def _numbers(pose: object, part: str, axes: str) -> list[float]:
    whole = json_object(pose)
    values = None if whole is None else json_object(whole.get(part))
    if values is None:
        raise UsageError(f"a pose has {part} with {', '.join(axes)}")
    numbers: list[Any] = [values.get(axis, 0.0) for axis in axes]
    # Exact types: a bool is an int for isinstance.
    if not all(type(one) in (int, float) and abs(one) < 1e6 for one in numbers):
        raise UsageError(f"{part} of a pose has numbers {', '.join(axes)}")
    return [float(one) for one in numbers]


NODE = "/usarmjx"
"""Name of the one node."""
DESCRIPTION = "/robot_description"
MOST_PARAMETERS = 256
"""Most parameters that clients may add."""
LONGEST_VALUE = 65_536
"""Longest value of a parameter [characters of JSON]."""
EXAMPLES = {"string": "", "bool": "false", "float32": "0.0", "float64": "0.0"}
_FURTHER = (SPAWN, REMOVE, REPUBLISH)
"""Services that are not rosapi's."""

ServiceFunction = Callable[[Mapping[str, Any]], RosMessage]


class Parameters:
    """The parameters of a served world: those of its robots, and those that clients set.

    Args:
        topics: The topics, which know the robots and their names.
    """

    def __init__(self, topics: WorldTopics) -> None:
        self._topics = topics
        # Nodes of ROS follow the topic /clock only where this parameter is true.
        self._set: dict[str, Any] = {"/use_sim_time": True}

    def names(self) -> list[str]:
        """Return the names of all parameters."""
        robots = [f"/{name}{DESCRIPTION}" for name in self._topics.robots()]
        return [*self._set, *([DESCRIPTION] if robots else []), *robots]

    def get(self, name: str) -> object:
        """Return a value; None if there is no such parameter.

        `robot_description` is that of the first robot, `R1/robot_description` that of R1.
        """
        full = _full(name)
        if full in self._set:
            return self._set[full]
        robots = self._topics.robots()
        owner = full.removesuffix(DESCRIPTION).strip("/") if full.endswith(DESCRIPTION) else None
        if owner is None or not robots:
            return None
        # Most tools read a bare /robot_description: the first robot's.
        robot = robots.get(owner) if owner else next(iter(robots.values()))
        return None if robot is None else urdf(robot.spec)

    def set(self, name: str, text: str) -> None:
        """Set a parameter to a value in JSON.

        Raises:
            UsageError: It is no JSON, too long, or there are too many parameters.
        """
        full = _full(name)
        if len(text) > LONGEST_VALUE:
            raise UsageError(f"{clip(full)} has {len(text)} characters; at most {LONGEST_VALUE} are kept")
        if full not in self._set and len(self._set) >= MOST_PARAMETERS:
            raise UsageError(f"there are {MOST_PARAMETERS} parameters already")
        try:
            self._set[full] = json.loads(text)
        # The text is a client's: some thousand nested brackets exhaust Python's stack.
        except (ValueError, RecursionError) as error:
            raise UsageError(f"the value of {clip(full)} is no JSON: {error}") from error

    def delete(self, name: str) -> None:
        """Delete a parameter that a client may have set."""
        self._set.pop(_full(name), None)


def _full(name: str) -> str:
    # ROS 2's rosapi puts a node in front: `/usarmjx:use_sim_time`.
    return "/" + name.rpartition(":")[2].strip("/")


class RosApi:
    """The services of rosapi.

    Args:
        topics: The topics.
        version: Version of the types' names.
        now: Returns the simulated time [s].
    """

    def __init__(self, topics: WorldTopics, version: RosVersion, now: Callable[[], float]) -> None:
        self._topics, self._version, self._now = topics, version, now
        self._parameters = Parameters(topics)
        self._services: dict[str, ServiceFunction] = {
            **self._of_topics(),
            **self._of_nodes(),
            **self._of_parameters(),
        }

    def names(self) -> list[str]:
        """Return the names of all services."""
        return [*self._services, *_FURTHER]

    def call(self, service: str, args: Mapping[str, Any]) -> RosMessage:
        """Return the values of a service's answer.

        Raises:
            UsageError: There is no such service, or an argument is not valid.
        """
        found = self._services.get(service)
        if found is None:
            raise UsageError(f"no service {clip(service)}; known: {', '.join(self.names())}")
        return found(args)

    def _of_topics(self) -> dict[str, ServiceFunction]:
        return {
            "/rosapi/topics": self._list,
            "/rosapi/topics_and_raw_types": self._list_raw,
            "/rosapi/topics_for_type": self._of_type,
            "/rosapi/topic_type": self._type,
            "/rosapi/publishers": lambda args: {"publishers": self._nodes_of(args, drives=False)},
            "/rosapi/subscribers": lambda args: {"subscribers": self._nodes_of(args, drives=True)},
            "/rosapi/message_details": self._details,
            "/rosapi/action_servers": lambda args: {"action_servers": ["/tf2_web_republisher"]},
            "/rosapi/get_time": self._time,
        }

    def _of_nodes(self) -> dict[str, ServiceFunction]:
        return {
            "/rosapi/nodes": lambda args: {"nodes": [NODE]},
            "/rosapi/node_details": self._node,
            "/rosapi/services": lambda args: {"services": self.names()},
            "/rosapi/service_type": lambda args: {"type": self._service_type(_text(args, "service"))},
            "/rosapi/service_node": lambda args: {
                "node": NODE if _text(args, "service") in self.names() else ""
            },
            "/rosapi/service_providers": lambda args: {
                "providers": [NODE] if self._services_for(_text(args, "service")) else []
            },
            "/rosapi/services_for_type": lambda args: {"services": self._services_for(_text(args, "type"))},
            "/rosapi/service_request_details": partial(self._service_details, part="Request"),
            "/rosapi/service_response_details": partial(self._service_details, part="Response"),
        }

    def _of_parameters(self) -> dict[str, ServiceFunction]:
        return {
            "/rosapi/get_param": self._get_parameter,
            "/rosapi/set_param": self._set_parameter,
            "/rosapi/has_param": lambda args: {
                "exists": self._parameters.get(_text(args, "name")) is not None
            },
            "/rosapi/delete_param": self._delete_parameter,
            "/rosapi/search_param": self._search,
            "/rosapi/get_param_names": lambda args: {"names": self._parameters.names()},
        }

    # Topics

    def _list(self, args: Mapping[str, Any]) -> RosMessage:
        del args
        topics = self._topics.all().values()
        return {
            "topics": [topic.name for topic in topics],
            "types": [self._version.type_name(topic.type) for topic in topics],
        }

    def _list_raw(self, args: Mapping[str, Any]) -> RosMessage:
        texts = [self._version.text(topic.type) for topic in self._topics.all().values()]
        return {**self._list(args), "typedefs_full_text": texts}

    def _of_type(self, args: Mapping[str, Any]) -> RosMessage:
        wanted = short_name(str(args.get("type", "")))
        return {"topics": [topic.name for topic in self._topics.all().values() if topic.type == wanted]}

    def _type(self, args: Mapping[str, Any]) -> RosMessage:
        topic = self._topics.all().get(str(args.get("topic", "")))
        return {"type": self._version.type_name(topic.type) if topic else ""}

    def _nodes_of(self, args: Mapping[str, Any], *, drives: bool) -> list[str]:
        topic = self._topics.all().get(_text(args, "topic"))
        return [NODE] if topic is not None and topic.is_listened_to == drives else []

    def _details(self, args: Mapping[str, Any]) -> RosMessage:
        """Return the fields of a type and of the types in it."""
        asked = _text(args, "type")
        name = short_name(asked)
        return {"typedefs": self._definitions(asked, name, self._fields(asked, name))}

    def _service_details(self, args: Mapping[str, Any], part: str) -> RosMessage:
        """Return the fields of a service's Request or Response and of the types in it."""
        asked = _text(args, "type")
        found = find_service_type(asked)
        if found is None:
            raise UsageError(f"no service type {clip(asked)} is known here")
        is_later = "/srv/" in asked
        name = f"{asked}_{part}" if is_later else f"{found.name}{part}"
        return {
            "typedefs": self._definitions(asked, name, found.request if part == "Request" else found.response)
        }

    def _fields(self, asked: str, name: str) -> MessageFields:
        """Return the fields of a type that occurs in what was asked for."""
        if name == TYPE_DEFINITION:
            return TYPE_DEFINITION_FIELDS
        try:
            return self._version.fields(name)
        except KeyError:
            raise UsageError(f"no type {clip(asked)} is known here") from None

    def _definitions(self, asked: str, name: str, fields: MessageFields) -> list[RosMessage]:
        """Return the definitions of a type with these fields, and of the types in it.

        Raises:
            UsageError: A type in it is not known.
        """
        is_long = "/msg/" in asked or "/srv/" in asked
        waiting, definitions = [(name, fields)], list[RosMessage]()
        seen = {name}
        while waiting:
            name, fields = waiting.pop(0)
            definitions.append(_definition(name, fields, long=is_long))
            # Seen types are kept apart from waiting ones: a type that contains itself by way of another would
            # never end.
            inner = [base for base in (kind.partition("[")[0] for kind in fields.values()) if "/" in base]
            new = [base for base in dict.fromkeys(inner) if base not in seen]
            waiting += [(base, self._fields(asked, base)) for base in new]
            seen.update(inner)
        return definitions

    def _time(self, args: Mapping[str, Any]) -> RosMessage:
        del args
        # Clients such as roslibpy's `get_time` read ROS 1's names of either server.
        return {"time": RosVersion.ROS2.stamp(self._now()) | RosVersion.ROS1.stamp(self._now())}

    # Nodes and services

    def _node(self, args: Mapping[str, Any]) -> RosMessage:
        if _text(args, "node") not in (NODE, NODE[1:]):
            return {"subscribing": [], "publishing": [], "services": []}
        topics = self._topics.all().values()
        return {
            "subscribing": [topic.name for topic in topics if topic.is_listened_to],
            "publishing": [topic.name for topic in topics if not topic.is_listened_to],
            "services": self.names(),
        }

    def _service_type(self, service: str) -> str:
        found = SERVICE_TYPES.get(service)
        return "" if found is None else found.full_name(self._version)

    def _services_for(self, kind: str) -> list[str]:
        return [name for name in self.names() if self._service_type(name) == kind]

    # Parameters

    def _get_parameter(self, args: Mapping[str, Any]) -> RosMessage:
        value = self._parameters.get(_text(args, "name"))
        # rosapi of ROS 1 has `default`, that of ROS 2 `default_value`.
        default = str(args.get("default") or args.get("default_value") or "null")
        return {"value": default if value is None else json.dumps(value), "successful": value is not None}

    def _set_parameter(self, args: Mapping[str, Any]) -> RosMessage:
        self._parameters.set(_text(args, "name"), _text(args, "value"))
        return {"successful": True}

    def _delete_parameter(self, args: Mapping[str, Any]) -> RosMessage:
        self._parameters.delete(_text(args, "name"))
        return {"successful": True}

    def _search(self, args: Mapping[str, Any]) -> RosMessage:
        name = _text(args, "name")
        return {"global_name": _full(name) if self._parameters.get(name) is not None else ""}


def _text(args: Mapping[str, Any], key: str) -> str:
    value = args.get(key, "")
    if not isinstance(value, str):
        raise UsageError(f"{key} is {clip(str(value))}, expected a text")
    return value


def _long_name(name: str) -> str:
    """Return the name of a type in ROS 2's form; rosapi's types have a package of their own there."""
    return RosVersion.ROS2.type_name(name.replace("rosapi/", "rosapi_msgs/"))


def _definition(name: str, fields: Mapping[str, str], *, long: bool) -> RosMessage:
    """Return the fields of a type as rosapi's TypeDef: -1 is no list, 0 one of any length."""
    bases, lengths = list[str](), list[int]()
    for kind in fields.values():
        base, bracket, length = kind.partition("[")
        bases.append(base)
        # `float64[36]` has a length, `float64[]` any.
        lengths.append(-1 if not bracket else int(length[:-1] or 0))
    return {
        "type": _long_name(name) if long else name,
        "fieldnames": list(fields),
        "fieldtypes": [_long_name(base) if long else BUILTIN.get(base, base) for base in bases],
        "fieldarraylen": lengths,
        "examples": [
            "[]" if length >= 0 else "{}" if "/" in base else EXAMPLES.get(base, "0")
            for base, length in zip(bases, lengths, strict=True)
        ],
        "constnames": [],
        "constvalues": [],
    }
