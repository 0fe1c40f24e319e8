"""The wire's frame: SAE J670 axes (manual 6.1), and angles in [0, 2 pi)."""

import math
from collections.abc import Sequence

from usarmjx.base.transforms import Vec3, flip_angles, flip_vector


def flip_wire_vector(values: Sequence[float]) -> Vec3:
    """Convert a vector (3,) between the wire's axes and ours; its own inverse [m]."""
    x, y, z = values
    return flip_vector((float(x), float(y), float(z)))


def flip_wire_angles(values: Sequence[float]) -> Vec3:
    """Convert roll, pitch, yaw between the wire's axes and ours; its own inverse [rad]."""
    roll, pitch, yaw = values
    return flip_angles((float(roll), float(pitch), float(yaw)))


def wrap_angles(values: Sequence[float]) -> Vec3:
    """Return angles in [0, 2 pi), as Unreal's rotators come out on the wire (manual 9.3, INS)."""
    roll, pitch, yaw = values
    return (float(roll) % math.tau, float(pitch) % math.tau, float(yaw) % math.tau)
