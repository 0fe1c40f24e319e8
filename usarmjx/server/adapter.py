"""The bridge between a client's dialogue and a robot in a served world; knows no socket."""

import logging
import math
from collections.abc import Callable

import numpy as np

from usarmjx.control import FLIP_TIME, Command, Order
from usarmjx.errors import PeerError, UnknownNameError, UsageError
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec import RobotSpec
from usarmjx.scene import start_height
from usarmjx.server import commands as wire
from usarmjx.server import reports
from usarmjx.server.frames import angles, vector
from usarmjx.server.grammar import to_vector
from usarmjx.server.host import HostWorld, Robot
from usarmjx.server.session import RobotSession
from usarmjx.server.wording import configuration, geometry, link_joint, package_report, sensor_report
from usarmjx.transforms import Vec3

log = logging.getLogger(__name__)

LOG_INTERVAL = 1.0
"""A client's faults are collected for this long, so that junk does not fill the disk with log lines [s]."""
BRAKE = 3
"""The wire's order for holding a joint where it is (KRobot.uc)."""
RELATIVE = {10: Order.POSITION, 11: Order.VELOCITY}
"""The wire's orders that add to the present position or speed (KRobot.uc)."""


class Client:
    """One connection: a session, and a robot once INIT has spawned one.

    Args:
        world: The served world.
        peer: The peer's address, for the log.
    """

    def __init__(self, world: HostWorld, peer: str) -> None:
        self.session = RobotSession(reports.nfo_greeting(world.arena.name))
        self.robot: Robot | None = None
        self.next_report = 0.0
        self._next_log = 0.0
        self._world = world
        self._peer = peer
        self._handlers: dict[type, Callable[..., None]] = {
            wire.GetStartPoses: self._start_poses,
            wire.Drive: self._drive,
            wire.MisPkg: self._move_package,
            wire.Set: self._set,
            wire.GetGeo: self._geometry,
            wire.GetConf: self._configuration,
        }

    def handle(self, command: wire.Command) -> None:
        """Carry out any command but INIT; nothing if the robot is lost: its place may be another's."""
        if not self.lost:
            self._handlers[type(command)](command)

    def log_faults(self) -> None:
        """Log what was wrong with the client's lines, at most once a second of the world's time."""
        if self._world.time < self._next_log:
            return
        self._next_log = self._world.time + LOG_INTERVAL
        for fault in self.session.take_faults():
            log.warning("%s: %s", self._peer, fault)

    # INIT comes in two halves, so that the server can prepare the class beside the loop.

    def class_of(self, init: wire.Init) -> RobotSpec | None:
        """Return the robot class that an INIT asks for; None, logged, when there is no such class."""
        try:
            return ROBOTS.get(init.class_name)
        except UnknownNameError as error:
            log.warning("%s: %s", self._peer, error)
            return None

    def spawn(self, init: wire.Init, spec: RobotSpec) -> bool:
        """Put the robot into the world; return whether that worked (the client hears nothing, as ever)."""
        try:
            pos, turn = self._place(init, spec)
            robot = self._world.spawn(spec, init.name or self._free_name(spec), pos, turn)
        except UsageError as error:
            log.warning("%s: INIT refused: %s", self._peer, error)
            return False
        self.robot = robot
        self.next_report = robot.born + spec.msg_timer
        log.info("%s: spawned %s as %r", self._peer, spec.name, robot.name)
        return True

    def _place(self, init: wire.Init, spec: RobotSpec) -> tuple[Vec3, Vec3]:
        starts = {start.tag.lower(): start for start in self._world.arena.starts}
        if init.start and init.start.lower() not in starts:
            raise UsageError(
                f"no start pose {init.start!r}; known: {', '.join(s.tag for s in starts.values())}"
            )
        turn = angles(init.rotation) if init.rotation else (0.0, 0.0, 0.0)
        if init.location is not None and not init.start:
            return vector(init.location), turn
        if not starts:
            raise UsageError(f"arena {self._world.arena.name} has no start poses: give a Location")
        start = starts[init.start.lower()] if init.start else self._world.arena.starts[0]
        place = (*start.at[:2], start_height(self._world.arena, spec))
        return place, turn if init.rotation else (0.0, 0.0, start.yaw)

    def _free_name(self, spec: RobotSpec) -> str:
        taken = {robot.name.lower() for robot in self._world.robots.values()}
        numbers = (f"{spec.name}_{i}" for i in range(len(taken) + 1))
        return next(name for name in numbers if name.lower() not in taken)

    def leave(self) -> None:
        """Take the robot out of the world (the connection is gone)."""
        if self.robot is not None:
            self._world.remove(self.robot)
            self.robot = None
        self.session.close()

    @property
    def lost(self) -> bool:
        """Whether the robot has vanished under the client (its world started again)."""
        return self.robot is not None and self._world.robots.get(self.robot.slot) is not self.robot

    @property
    def battery_empty(self) -> bool:
        """Whether the robot has used up its battery: then only STA goes on (KRobot.uc)."""
        return self._battery(self._present) <= 0

    @property
    def _present(self) -> Robot:
        if self.robot is None:
            raise UsageError("the client has no robot")
        return self.robot

    def _battery(self, robot: Robot) -> int:
        return max(0, math.ceil(robot.spec.battery_life - (self._world.time - robot.born) - 1e-6))

    # Commands

    def _start_poses(self, command: wire.GetStartPoses) -> None:
        del command
        arena = self._world.arena
        poses = [
            (start.tag, vector((*start.at[:2], arena.floor + start.at[2])), angles((0.0, 0.0, start.yaw)))
            for start in arena.starts
        ]
        self.session.send(reports.nfo_start_poses(poses))

    def _drive(self, command: wire.Drive) -> None:
        robot = self._present
        told: Command = robot.command
        target, scale = told.target.copy(), robot.spec.drive.max_speed / 100 if command.normalized else 1.0
        for joint, wheel in enumerate(robot.spec.wheels):
            speed = command.left if wheel.side == "left" else command.right
            if speed is not None:
                target[joint] = speed * scale
        told = told.replace(target=target)
        if command.light is not None:
            told = told.replace(light=np.bool_(command.light))
        if command.flip:
            told = told.replace(flip_until=np.float32(self._world.time + FLIP_TIME))
        self._world.tell(robot, told)

    def _move_package(self, command: wire.MisPkg) -> None:
        robot = self._present
        target, order = robot.command.target.copy(), robot.command.order.copy()
        for link in command.links:
            joint = link_joint(robot.spec, command.name, link.link)
            if joint is None:
                log.warning("%s: no link %d in package %r", self._peer, link.link, command.name)
            elif link.order in (Order.POSITION, Order.VELOCITY):
                target[joint], order[joint] = link.value, link.order
            elif link.order == BRAKE:
                target[joint], order[joint] = 0.0, Order.VELOCITY
            elif link.order in RELATIVE:
                mode = RELATIVE[link.order]
                base = self._world.joints(robot)[joint] if mode == Order.POSITION else 0.0
                if mode == Order.VELOCITY and order[joint] == Order.VELOCITY:
                    base = target[joint]
                target[joint], order[joint] = base + link.value, mode
            else:
                log.warning("%s: MISPKG order %d is not supported", self._peer, link.order)
        self._world.tell(robot, robot.command.replace(target=target, order=order))

    def _set(self, command: wire.Set) -> None:
        robot = self._present
        if self.battery_empty:
            return
        place = robot.suite.find(command.type, command.name)
        values, done = self._numbers(command.params), False
        if place is not None and values is not None:
            if command.opcode.upper() == "POSE" and len(values) == 6:
                values = (*vector(values[:3]), *angles(values[3:]))
            done = self._world.order(robot, place, command.opcode, values)
        status = "OK" if done else "Failed"
        self.session.send(reports.res(self._world.time, command.type, command.name, status))

    def _numbers(self, params: str) -> tuple[float, ...] | None:
        """Return the numbers of a SET; None, logged, when one is not finite: the client stays."""
        try:
            return to_vector(params)
        except PeerError as error:
            log.warning("%s: %s", self._peer, error)
            return None

    def _geometry(self, command: wire.GetGeo) -> None:
        if not self.battery_empty:
            for message in geometry(self._present.spec, command.type, command.name):
                self.session.send(message)

    def _configuration(self, command: wire.GetConf) -> None:
        if not self.battery_empty:
            robot = self._present
            for message in configuration(robot.spec, robot.suite.sensors, command.type, command.name):
                self.session.send(message)

    # Reports

    def due(self) -> bool:
        """Whether the robot's message timer has run out."""
        return self.robot is not None and self._world.time >= self.next_report - 1e-6

    def report(self) -> None:
        """Send STA, the sensors with fresh readings, and MISSTA, in the original's order (KRobot.uc)."""
        robot, time = self._present, self._world.time
        self.next_report += robot.spec.msg_timer
        light = bool(robot.command.light)
        state = reports.GroundVehicleState(
            time=time, light=light, intensity=100 if light else 0, battery=self._battery(robot)
        )
        self.session.send(reports.sta_ground_vehicle(state))
        if self.battery_empty:
            robot.pending.clear()
            return
        for place, sensor in enumerate(robot.suite.sensors):
            if place in robot.pending:
                self.session.send(sensor_report(sensor, robot.pending.pop(place), time))
        for message in package_report(robot.spec, self._world.joints(robot), time):
            self.session.send(message)
