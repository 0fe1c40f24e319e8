"""What a client is told each time its robot reports (KRobot.uc, timer)."""

import math
from collections.abc import Iterable

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import PeerError
from usarmjx.models.drives.base import RobotState
from usarmjx.server.gamebots.sensors import package_report, robot_report, sensor_report
from usarmjx.server.protocol.session import RobotSession
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.sim.control import joint_efforts

TEAM = 8
"""So many robots of a class report together: more would make that control step a long one."""


def first_report(robot: Robot, others: Iterable[Robot], since: float, period: float) -> float:
    """Return when a new robot reports first [s]: within its msgTimer, and no sooner than in the next step.

    That is with most others of its class that have room in their team; if none have, when fewest others
    report; when it does not matter, after its msgTimer.

    Args:
        robot: The robot.
        others: The others in its world.
        since: Now [s].
        period: Length of a control step [s].
    """
    timer, there = robot.spec.msg_timer, [other for other in others if other is not robot]

    def merit(time: float) -> tuple[int, int]:
        together = [other for other in there if abs(other.next_report - time) < period / 2]
        team = sum(other.spec is robot.spec for other in together)
        return team if team < TEAM else 0, -len(together)

    return max((since + timer - step * period for step in range(max(1, round(timer / period)))), key=merit)


def battery_left(world: ServedWorld, robot: Robot) -> int:
    """Return for how many seconds the battery lasts, as STA says it."""
    return max(0, math.ceil(world.battery(robot) - 1e-6))


class Reporter:
    """Makes a client's reports.

    Args:
        world: The served world.
        session: The client's dialogue.
    """

    def __init__(self, world: ServedWorld, session: RobotSession) -> None:
        self._world, self._session = world, session
        self._untold: set[int] = set()

    def report(self, robot: Robot) -> None:
        """Send STA, the sensors with fresh readings, and MISSTA, in the original's order."""
        world, time = self._world, self._world.time
        robot.next_report += robot.spec.msg_timer
        state, battery = world.state(robot), battery_left(world, robot)
        joints = state.joint_pos
        self._session.send(robot_report(robot.plan, robot.command, joints, time, battery, robot.tile))
        if battery <= 0:
            robot.pending.clear()
            return
        for index in range(len(robot.suite.sensors)):
            if index in robot.pending:
                self._tell(robot, index, robot.pending.pop(index))
        if robot.spec.packages:
            for message in package_report(robot.plan, joints, self._efforts(robot, state), time):
                self._session.send(message)

    def _tell(self, robot: Robot, index: int, reading: np.ndarray) -> None:
        """Send a sensor's reading; one that makes no message is left out, and the log says so once."""
        sensor, world = robot.suite.sensors[index], self._world
        try:
            stamped = self._session.dialect.is_stamped
            message = sensor_report(
                sensor, reading, world.time, world.arena.gps, world.tag_texts, stamped=stamped
            )
            if message is not None:
                self._session.send(message)
        except PeerError:
            raise
        except Exception as error:  # sensors may be anybody's
            if index not in self._untold:
                self._untold.add(index)
                name = sensor.mounts[0].name
                self._session.add_fault(f"{robot.spec.name}'s {sensor.kind} {name} is not told: {error}")

    def _efforts(self, robot: Robot, state: RobotState) -> Array:
        """Return what acts on each of the robot's joints [N m or N] (joints,)."""
        scene, (world, physics) = self._world.scene, self._world.one_world()
        group, member = scene.group_of(robot.slot)
        act, hold = physics.act[scene.groups[group].actadr[member]], world.groups[group].hold[member]
        with numpy_backend():
            return joint_efforts(robot.plan, state, act, hold)
