"""Reports of a client's robot, sent when its message timer runs out (KRobot.uc, timer)."""

import math
from collections.abc import Iterable

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import PeerError
from usarmjx.base.transforms import angles_from_mat
from usarmjx.sensors.ranging import ObjectSensor
from usarmjx.server.gamebots.grippers import gripper_reports
from usarmjx.server.gamebots.sensors import package_report, robot_report, sensor_report
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.protocol.grammar import Message
from usarmjx.server.protocol.reports import sen_objects
from usarmjx.server.protocol.session import RobotSession
from usarmjx.server.worlds.met_objects import MetObject
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.sim.control import joint_efforts

MAX_TEAM = 8
"""Most robots of a class that report in one control step: more would make that step a long one."""


def first_report_time(robot: Robot, others: Iterable[Robot], since: float, period: float) -> float:
    """Return the time of a new robot's first report [s]: within its msgTimer, after the present step.

    It is the time at which most others of its class report, fewer than `MAX_TEAM` of them; if there is
    none, the time with the fewest reports; if all are equal, the end of its msgTimer.

    Args:
        robot: The robot.
        others: The others in its world.
        since: Now [s].
        period: Length of a control step [s].
    """
    timer, there = robot.spec.msg_timer, [other for other in others if other is not robot]

    def merit(time: float) -> tuple[int, int]:
        # Half a step as tolerance: report times are sums of floats, equal ones differ in the last digits.
        together = [other for other in there if abs(other.next_report - time) < period / 2]
        team = sum(other.spec is robot.spec for other in together)
        return team if team < MAX_TEAM else 0, -len(together)

    # `max` keeps the first of equal times, and that is the end of the msgTimer.
    return max((since + timer - step * period for step in range(max(1, round(timer / period)))), key=merit)


def objects_report(sensor: ObjectSensor, met: Iterable[MetObject], time: float | None) -> Message:
    """Return the SEN of an object sensor: what its beams meet, in the wire's axes."""
    objects = [
        (one.name, flip_wire_vector(one.pos.tolist()), flip_wire_angles(angles_from_mat(one.mat).tolist()))
        for one in met
    ]
    return sen_objects(time, sensor.mounts[0].name, objects)


def battery_left(world: ServedWorld, robot: Robot) -> int:
    """Return the remaining time of the battery [s], as in STA."""
    # Without the margin 120.0000001 s left would be reported as 121.
    return max(0, math.ceil(world.battery(robot) - 1e-6))


class Reporter:
    """Makes a client's reports.

    Args:
        world: The served world.
        session: The client's dialogue.
    """

    def __init__(self, world: ServedWorld, session: RobotSession) -> None:
        self._world, self._session = world, session
        self._failed_sensors: set[int] = set()

    def report(self, robot: Robot) -> None:
        """Send STA, fresh readings of sensors, MISSTA, and EFF of later versions: the original's order."""
        world, time = self._world, self._world.time
        # Added to the due time, not to now: a late report must not shift all later ones.
        robot.next_report += robot.spec.msg_timer
        now, physics = world.one_world()
        state, battery = world.state(robot, physics), battery_left(world, robot)
        joints = state.joint_pos
        # STA comes first, and alone from a robot with an empty battery (KRobot.uc, timer).
        self._session.send(robot_report(robot.plan, robot.command, joints, time, battery, robot.tile))
        if battery <= 0:
            # Readings of an empty robot would otherwise all go out, stale, if the battery were filled.
            robot.pending.clear()
            return
        for index in range(len(robot.suite.sensors)):
            if index in robot.pending:
                self._send_reading(robot, index, robot.pending.pop(index), time)
        if robot.spec.packages:
            scene = world.scene
            group, member = scene.group_of(robot.slot)
            act, hold = physics.act[scene.groups[group].actadr[member]], now.groups[group].hold[member]
            with numpy_backend():
                efforts = joint_efforts(robot.plan, state, act, hold)
            for message in package_report(robot.plan, joints, efforts, time):
                self._session.send(message)
        if self._session.dialect.has_binary_grippers:
            for message in gripper_reports(world, robot):
                self._session.send(message)

    def _send_reading(self, robot: Robot, index: int, reading: np.ndarray, time: float) -> None:
        """Send a sensor's reading; one that makes no message is left out, and the log reports that once."""
        sensor, world = robot.suite.sensors[index], self._world
        try:
            stamped = self._session.dialect.is_stamped
            if isinstance(sensor, ObjectSensor):
                stamped = stamped or sensor.settings[0].with_time_stamp
                met = world.met_objects(robot, index)
                message = objects_report(sensor, met, time if stamped else None)
            else:
                message = sensor_report(
                    sensor, reading, time, world.arena.gps, world.tag_texts, stamped=stamped
                )
            if message is not None:
                self._session.send(message)
        # A client that does not read is a fault of the connection, not of the sensor: it drops the client.
        except PeerError:
            raise
        except Exception as error:  # a sensor may be a user's own, with any error in `quantities`
            if index not in self._failed_sensors:
                self._failed_sensors.add(index)
                name = sensor.mounts[0].name
                self._session.add_fault(f"{robot.spec.name}'s {sensor.kind} {name} is not reported: {error}")
