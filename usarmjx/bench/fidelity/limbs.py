"""Manoeuvres of flippers and grippers, for the classes that have some; see `manoeuvres.py`."""

import math

import mujoco
import numpy as np

from usarmjx.bench.fidelity.track import Orders, Track
from usarmjx.models.build.compose import Physics
from usarmjx.models.effecters import effecters_of
from usarmjx.models.effecters.gripper import LEVER
from usarmjx.models.spec.arena import LooseObject
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.models.spec.shapes import Shape

MASSES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Of the blocks that are gripped [kg]."""
HALF = 0.03
"""Half the edge of a block [m]."""
WIDE = 2 * math.asin((HALF + 0.0005) / LEVER)
"""Angle to which a gripper opens, its fingers 1 mm farther apart than a block is wide [rad]."""
HELD = 2 * HALF
"""A block that has slipped by less is held [m]."""
AWAY = (3.0, 0.0, HALF)
"""Where a block lies until it is put between the fingers [m]."""


def flipper_lift(physics: Physics, robot: RobotSpec, orders: Orders) -> float:
    """How much higher it stands on its flippers, after 8 s [m]."""
    assert orders.flippers is not None
    track = Track(physics, robot)
    track.run(1.0)
    low = track.pose()[0][2]
    track.move(orders.flippers)
    track.run(8.0)
    return float(track.pose()[0][2] - low)


class Grasp:
    """A robot whose gripper closes on a block that was put between its fingers.

    Args:
        physics: The settings.
        robot: The class.
        gripper: Index of its gripper.
        mass: Of the block [kg].
    """

    def __init__(self, physics: Physics, robot: RobotSpec, gripper: int, mass: float) -> None:
        shape = Shape(kind="box", size=(HALF, HALF, HALF), mass=mass, surface="loose")
        self.track = Track(physics, robot, loose=(LooseObject(name="block", at=AWAY, shapes=(shape,)),))
        self._hand = effecters_of(robot)[gripper]
        engine = self.track.world.engine
        self._block = engine.model.body("loose/block").id
        fingers = [self.track.body(name) for name in self._hand.joints]
        self._geoms = np.flatnonzero(np.isin(engine.model.geom_bodyid, fingers))
        self._operate(gripper, WIDE)
        self.track.run(2.0)
        start = engine.model.body_jntadr[self._block]
        place, rest = engine.model.jnt_qposadr[start], engine.model.jnt_dofadr[start]
        engine.data.qpos[place : place + 3] = engine.data.geom_xpos[self._geoms].mean(0)
        mujoco.mju_mat2Quat(engine.data.qpos[place + 3 : place + 7], engine.data.xmat[fingers[0]])
        engine.data.qvel[rest : rest + 6] = 0.0
        self._operate(gripper, 0.0)

    def _operate(self, gripper: int, angle: float) -> None:
        opened = self._hand.opcode("Open")
        assert opened is not None
        self.track.world.operate(0, gripper, opened, angle)

    @property
    def holds(self) -> bool:
        """Whether the block is between the fingers."""
        data = self.track.world.engine.data
        apart = data.xpos[self._block] - data.geom_xpos[self._geoms].mean(0)
        return bool(np.linalg.norm(apart) < HELD)


def gripper_hold(physics: Physics, robot: RobotSpec, orders: Orders) -> float:
    """The heaviest block that its gripper holds for 4 s [kg]; 0: none."""
    assert orders.gripper is not None
    heaviest = 0.0
    for mass in MASSES:
        grasp = Grasp(physics, robot, orders.gripper, mass)
        grasp.track.run(4.0)
        if not grasp.holds:
            break
        heaviest = mass
    return heaviest
