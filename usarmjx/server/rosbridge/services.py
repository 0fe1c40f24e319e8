"""Services of a served world: what topics there are, and robots that come and go."""

import logging
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import angles_from_mat
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import RobotSpec
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.spawning import spawn_from_init
from usarmjx.server.protocol.commands import Init
from usarmjx.server.protocol.grammar import clip, flip_wire_angles, flip_wire_vector
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.motion import drive_keys, read_twist
from usarmjx.server.rosbridge.topics import WorldTopics
from usarmjx.server.worlds.robot import Robot
from usarmjx.sim.control import CommandUpdate

log = logging.getLogger(__name__)


class RosRobots:
    """What a client has; the robots that it let appear go when it goes.

    Args:
        server: The world's server.
        peer: What the log calls the client.
    """

    def __init__(self, server: BotServer, peer: str) -> None:
        self._server, self._peer = server, peer
        self._own: list[Client] = []
        self._driven: list[Robot] = []

    @property
    def is_empty(self) -> bool:
        """Whether it has let no robot appear that is still there."""
        self.forget_lost()
        return not self._own

    def spawn(self, init: Init, spec: RobotSpec) -> Robot:
        """Let a robot appear, and report without a connection.

        Raises:
            UsageError: There is no room for it, or its name is taken.
        """
        world = self._server.world
        if init.name.lower() in {robot.name.lower() for robot in world.robots.values()}:
            raise UsageError(f"there is a robot {init.name} already")
        robot = spawn_from_init(world, init, spec)
        own = Client(world, self._peer)
        own.attach_robot(robot, robot.spawn_time)
        self._server.guests.append(own)
        self._own.append(own)
        log.info("%s: spawned %s as %r", self._peer, spec.name, robot.name)
        return robot

    def remove(self, name: str) -> None:
        """Take a robot out of the world that this client let appear.

        Raises:
            UsageError: It has none of that name.
        """
        own = next((one for one in self._own if one.robot and one.robot.name.lower() == name.lower()), None)
        if own is None:
            raise UsageError(f"you have let no robot {clip(name)} appear")
        self._let_go(own)

    def let_one_go(self) -> None:
        """Take one of its robots out of the world: all at once would hold up the others."""
        if self._own:
            self._let_go(self._own[0])

    def forget_lost(self) -> None:
        """Forget robots that are gone, or that somebody else has been given."""
        for own in [one for one in self._own if one.robot is None or one.lost]:
            self._own.remove(own)
            self._dismiss(own)

    def drive(self, robot: Robot, twist: object) -> None:
        """Let a robot move as a Twist says, until it is told otherwise.

        Raises:
            UsageError: It is no Twist, or somebody else drives the robot.
        """
        if robot.obeys is not None:
            raise UsageError(f"{robot.name} is driven from the page")
        if self._server.world.robots.get(robot.slot) is not robot:
            raise UsageError(f"a policy drives {robot.name}: /simulator/spawn with that name takes it over")
        keys = drive_keys(robot.spec, read_twist(twist))
        self._server.world.update_command(robot, CommandUpdate(drive=keys))
        if robot not in self._driven:
            self._driven.append(robot)

    def stop_driven(self) -> None:
        """Stop the robots that it has driven."""
        world = self._server.world
        for robot in self._driven:
            if world.robots.get(robot.slot) is robot and robot.obeys is None:
                still = dict.fromkeys(robot.spec.drive.keys, 0.0)
                world.update_command(robot, CommandUpdate(drive=still))
        self._driven.clear()

    def _let_go(self, own: Client) -> None:
        self._own.remove(own)
        self._dismiss(own)
        if own.robot is not None and not own.lost:
            own.leave()

    def _dismiss(self, own: Client) -> None:
        if own in self._server.guests:
            self._server.guests.remove(own)


SPAWN, REMOVE = "/simulator/spawn", "/simulator/remove"
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
"""What a robot may be called that appears by a service: so its topics and frames are called, too."""


class TopicServices:
    """The services that tell of topics, as rosapi has them.

    Args:
        topics: The topics.
        version: Whose names types have.
        now: Returns the simulated time [s].
    """

    def __init__(self, topics: WorldTopics, version: RosVersion, now: Callable[[], float]) -> None:
        self._topics, self._version, self._now = topics, version, now
        self._services: dict[str, Callable[[Mapping[str, Any]], RosMessage]] = {
            "/rosapi/topics": self._list,
            "/rosapi/topics_and_raw_types": self._list_raw,
            "/rosapi/topics_for_type": self._of_type,
            "/rosapi/topic_type": self._type,
            "/rosapi/services": lambda args: {"services": self.names()},
            "/rosapi/get_time": lambda args: {"time": self._version.stamp(self._now())},
        }

    def names(self) -> list[str]:
        """Return the names of all services."""
        return [*self._services, SPAWN, REMOVE]

    def call(self, service: str, args: Mapping[str, Any]) -> RosMessage:
        """Return the values that a service answers.

        Raises:
            UsageError: There is no such service.
        """
        found = self._services.get(service)
        if found is None:
            raise UsageError(f"no service {clip(service)}; there is: {', '.join(self.names())}")
        return found(args)

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
        wanted = str(args.get("type", "")).replace("/msg/", "/")
        return {"topics": [topic.name for topic in self._topics.all().values() if topic.type == wanted]}

    def _type(self, args: Mapping[str, Any]) -> RosMessage:
        topic = self._topics.all().get(str(args.get("topic", "")))
        return {"type": self._version.type_name(topic.type) if topic else ""}


def read_spawn(args: Mapping[str, Any]) -> tuple[Init, RobotSpec]:
    """Return the INIT and the class of a robot that is to appear.

    Args:
        args: `class`; and, if wanted, `name`, and `pose`, a geometry_msgs/Pose, or `start`, the tag of a
            start pose.

    Raises:
        UsageError: Something is wrong with them.
    """
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
    place = _numbers(pose, "position", "xyz")
    x, y, z, w = _numbers(pose, "orientation", "xyzw")
    length = float(np.linalg.norm((w, x, y, z)))
    if length < 1e-6:
        raise UsageError("an orientation of length 0 is none")
    with numpy_backend():
        angles = angles_from_mat(np.asarray(mat_from_quat(np.array((w, x, y, z)) / length)))
    return Init(spec.name, name, flip_wire_vector(place), flip_wire_angles(angles.tolist())), spec


def _numbers(pose: Any, part: str, axes: str) -> list[float]:  # noqa: ANN401 - JSON
    values = pose.get(part) if isinstance(pose, dict) else None
    if not isinstance(values, dict):
        raise UsageError(f"a pose has {part} with {', '.join(axes)}")
    numbers = [values.get(axis, 0.0) for axis in axes]
    if not all(type(one) in (int, float) and abs(one) < 1e6 for one in numbers):
        raise UsageError(f"{part} of a pose has numbers {', '.join(axes)}")
    return [float(one) for one in numbers]
