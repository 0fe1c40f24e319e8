"""Viewpoints of nobody's camera."""

import math

import numpy as np

from usarmjx.base.transforms import mat_from_angles
from usarmjx.sensors.cameras.picture import HIDDEN_GEOMS_MULTIPLE, Viewpoint
from usarmjx.sensors.rays.raycast import EXCLUDE_NONE

FOV = math.radians(75.0)


def viewpoint_at(pos, yaw, pitch):
    """A pinhole at a position [m], turned to the left of the x axis and downwards [rad]."""
    return Viewpoint(
        pos=np.asarray(pos, np.float32),
        mat=mat_from_angles(0.0, pitch, yaw).astype(np.float32),
        eye_offsets=np.zeros((1, 3)),
        fov=np.array(FOV, np.float32),
        default_fov=np.array(FOV, np.float32),
        slot=np.asarray(EXCLUDE_NONE),
        hidden_geoms=np.zeros(HIDDEN_GEOMS_MULTIPLE, bool),
        lens="pinhole",
    )
