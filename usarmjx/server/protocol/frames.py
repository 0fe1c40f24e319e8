"""The wire's frame: SAE J670 axes (manual 6.1), angles in [0, 2 pi) where the wire has them so."""

import math
from collections.abc import Sequence

from usarmjx.base.transforms import Vec3, flip_angles, flip_vector


def flip_wire_vector(values: Sequence[float]) -> Vec3:
    """Convert a vector (3,) between the wire's axes and ours; its own inverse [m]."""
    x, y, z = (float(v) for v in values)
    return flip_vector((x, y, z))


def flip_wire_angles(values: Sequence[float]) -> Vec3:
    """Convert roll, pitch, yaw between the wire's axes and ours; its own inverse [rad]."""
    roll, pitch, yaw = (float(v) for v in values)
    return flip_angles((roll, pitch, yaw))


def wrap_angles(values: Sequence[float]) -> Vec3:
    """Return angles in [0, 2 pi), as Unreal's rotators come out on the wire (manual 9.3, INS)."""
    roll, pitch, yaw = (float(v) % (2 * math.pi) for v in values)
    return (roll, pitch, yaw)
