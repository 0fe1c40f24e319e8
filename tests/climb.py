"""Steps and stairs, and robots that drive over them with or without the help of their joints."""

import math

import mujoco
import numpy as np

from tests.rig import PERIOD, Rig
from usarmjx.models.compile.parts import joint_names
from usarmjx.models.types.shapes import Shape

NEAR = 1.0
"""x of the first step's face [m]."""
GAP = 0.1
"""How far before it a robot's nose starts [m]."""


def step(height, near=NEAR, depth=20.0):
    """Return a step up to a platform."""
    at = (near + depth / 2, 0.0, height / 2)
    return Shape(kind="box", size=(depth / 2, 2.0, height / 2), at=at, surface="ground")


def stairs(count, rise, going, near=NEAR):
    """Return a flight of stairs up to a platform, a box for each step."""
    tops = [rise * (i + 1) for i in range(count - 1)]
    flight = [
        Shape(
            kind="box",
            size=(going / 2, 1.0, top / 2),
            at=(near + going * (i + 0.5), 0.0, top / 2),
            surface="ground",
        )
        for i, top in enumerate(tops)
    ]
    return (*flight, step(rise * count, near + going * (count - 1)))


def flippers(front, rear):
    """Return angles of front and rear flippers by joint: up is negative in front, positive behind."""
    return {"FRFlipper": front, "FLFlipper": front, "RRFlipper": rear, "RLFlipper": rear}


FOLDED = flippers(-math.pi / 2, math.pi / 2)


def nose(rig):
    """Return how far the robot's wheels reach ahead of its origin [m]."""
    model, ours = rig.model, np.isin(rig.model.geom_bodyid, rig.indices[0].body_ids)
    wheels = ours & (model.geom_type == mujoco.mjtGeom.mjGEOM_CYLINDER)
    return (rig.data.geom_xpos[:, 0] + model.geom_size[:, 0])[wheels].max() - rig.data.qpos[0]


class Climb:
    """A robot with its joints in a pose before an obstacle; it drives on while they follow a script.

    Args:
        name: Robot class.
        solids: The obstacle, with its face at `NEAR`.
        pose: Angles of joints to start with.
    """

    def __init__(self, name, *solids, pose=None):
        rig = self._posed(name, (), pose or {}, 0.0)
        self.rig = self._posed(name, solids, pose or {}, NEAR - GAP - nose(rig))
        self.worst = 1.0

    @staticmethod
    def _posed(name, solids, pose, x):
        rig = Rig(name, *solids, places=((x, 0.0, 0.0),))
        names = joint_names(rig.robot)
        for joint, angle in pose.items():
            rig.data.qpos[rig.indices[0].qposadr[names.index(joint)]] = angle
        rig.move(pose).run(1.0)
        return rig

    def drive(self, share, seconds, script=()):
        """Drive at a share of the top speed; `script`: (time [s], {joint: angle [rad]}) in order of time."""
        rig, script = self.rig, list(script)
        speed = share * rig.robot.drive.max_spin
        rig.tell(Left=speed, Right=speed)
        for tick in range(round(seconds / PERIOD)):
            while script and script[0][0] <= tick * PERIOD:
                rig.move(script.pop(0)[1])
            rig.step()
            self.worst = min(self.worst, rig.up[0])
        return self

    def on_top(self, height, near=NEAR):
        """Whether the whole robot stands upright on a platform that starts at `near`."""
        x, _, z = self.rig.data.qpos[:3]
        stands = height + 0.8 * self.rig.plan.clearance < z < height + 1.5 * self.rig.plan.clearance
        return bool(x > near + 0.3 and stands and self.rig.up[0] > 0.98)
