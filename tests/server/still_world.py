"""A served world in which nothing moves: for tests of the server, not of the simulator."""

from types import SimpleNamespace

import numpy as np

from tests.arenas import FLAT
from usarmjx.base.errors import UsageError
from usarmjx.models.drives.base import RobotState
from usarmjx.sensors.suite import suite_of
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.sim.control import idle_command

CLASS = "ComStation"  # the class with the least to it


class StillWorld(ServedWorld):
    """Robots come and go and report; whatever else a served world can, nobody asks of it here."""

    def __init__(self, arena=FLAT, max_robots=16):
        self.arena, self.period, self.robots = arena, 0.02, {}
        self._max_robots, self._steps = max_robots, 0
        self.on_step = lambda: None
        """Is called in every control step."""

    @property
    def steps(self):
        return self._steps

    @property
    def scene(self):
        """As much of one as a report asks for."""
        places = PerRobot(self, lambda count: np.zeros(count, int))
        return SimpleNamespace(group_of=lambda slot: (0, slot), groups=[SimpleNamespace(actadr=places)])

    def one_world(self):
        held = SimpleNamespace(groups=[SimpleNamespace(hold=PerRobot(self, np.ones))])
        return held, SimpleNamespace(act=np.zeros(1))

    def spawn_at(self, robot, name, poses):
        self.check_position(poses[0][0])
        slot = min(set(range(self._max_robots)) - set(self.robots), default=None)
        if slot is None:
            raise UsageError(f"there is room for {self._max_robots} robots")
        suite = suite_of(robot)
        self.robots[slot] = Robot(slot, name, suite, idle_command(robot), self.time)
        return self.robots[slot]

    def remove(self, robot):
        del self.robots[robot.slot]

    def step(self):
        self._steps += 1
        self.on_step()

    def observe(self, due):
        pass

    def battery(self, robot):
        return robot.spec.battery_life

    def state(self, robot, physics=None):
        zero, joints = np.zeros(3), np.zeros(len(robot.plan.parts) - 1)
        return RobotState(
            pos=zero, quat=np.eye(4)[0], linear=zero, angular=zero, joint_pos=joints, joint_vel=joints
        )


class PerRobot:
    """An array for each robot, of as many numbers as it has actuators."""

    def __init__(self, world, make):
        self._world, self._make = world, make

    def __getitem__(self, slot):
        return self._make(len(self._world.robots[slot].plan.actuated))


StillWorld.__abstractmethods__ = frozenset()


def init(name="R1", **more):
    """The line that asks for a robot."""
    fields = {"ClassName": f"USARBot.{CLASS}", "Name": name, "Start": "S0"} | more
    return "INIT " + " ".join(f"{{{key} {value}}}" for key, value in fields.items())
