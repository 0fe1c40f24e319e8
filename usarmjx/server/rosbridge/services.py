"""Robots of a client, which come and go by services."""

import logging
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from usarmjx.base.arrays import ArrayLike
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
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.rosbridge.definitions import json_object
from usarmjx.server.rosbridge.motion import TrajectoryRun, drive_keys, read_trajectory, read_twist
from usarmjx.server.rosbridge.topics import TRAJECTORY
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
        self._runs.pop(robot, None)
        if path is None:
            return
        world = self._server.world
        places = [robot.plan.parts.index(name) - 1 for name in path.joints]
        now = np.asarray(world.state(robot).joint_pos, float)[places]
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
    if not all(type(one) in (int, float) and abs(one) < 1e6 for one in numbers):
        raise UsageError(f"{part} of a pose has numbers {', '.join(axes)}")
    return [float(one) for one in numbers]
