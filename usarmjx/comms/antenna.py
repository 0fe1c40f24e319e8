"""Where a robot's antenna is."""

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import Vec3, flip_vector
from usarmjx.models.spec.robot import RobotSpec

MIN_ANTENNA_HEIGHT = 0.01
"""No antenna is lower than this above the arena's floor: a robot on its back would have it below [m]."""


def antenna_of(robot: RobotSpec) -> Vec3:
    """Return where a class has its antenna, in USARSim's axes on the chassis [m].

    Without a place of its own it is half the robot's height above the chassis origin; a ComStation's is
    so on top of its mast.
    """
    return (0.0, 0.0, -robot.dimensions[2] / 2) if robot.antenna is None else robot.antenna


def antenna_positions(robot: RobotSpec, pos: Array, quat: Array, floor: float) -> Array:
    """Return where the antennas of robots of one class are in the world [m] (..., 3).

    Args:
        robot: The class.
        pos: Chassis origins [m] (..., 3).
        quat: Orientations, w first (..., 4).
        floor: Height of the arena's floor [m].
    """
    mat, (x, y, z) = mat_from_quat(quat), flip_vector(antenna_of(robot))
    position = pos + mat[..., 0] * x + mat[..., 1] * y + mat[..., 2] * z
    lowest = np.array([-np.inf, -np.inf, floor + MIN_ANTENNA_HEIGHT], np.float32)
    return xp.maximum(position, lowest)
