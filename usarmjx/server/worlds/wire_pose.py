"""Poses in the wire's axes, for messages that are not of sensors."""

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import Vec3, angles_from_mat
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector


def wire_pose(pos: Array, quat: Array) -> tuple[Vec3, Vec3]:
    """Return position [m] and roll, pitch and yaw [rad] on the wire.

    Args:
        pos: Position in our axes [m] (3,).
        quat: Orientation, w first (4,).
    """
    with numpy_backend():
        angles = angles_from_mat(np.asarray(mat_from_quat(np.asarray(quat)), float))
    position = flip_wire_vector(np.asarray(pos, float).tolist())
    return position, flip_wire_angles(np.asarray(angles, float).tolist())
