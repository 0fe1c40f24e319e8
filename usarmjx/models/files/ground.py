"""The ground under a point of an arena's solids, before the arena is built."""

from collections.abc import Sequence

import mujoco
import numpy as np

from usarmjx.models.compile.geoms import add_geom
from usarmjx.models.files.content import corners_of
from usarmjx.models.types.shapes import Shape

MAX_BELOW = 1.0
"""Height above a point from which the ground under it is searched [m]."""


def ground_under(shapes: Sequence[Shape], at: tuple[float, float, float], *, floor: bool) -> float:
    """Return the height of the highest fixed solid under a point, or of the floor; else its own [m].

    Args:
        shapes: Fixed solids, of which those that nothing touches do not count.
        at: The point.
        floor: Whether there is a floor at height 0.
    """
    x, y, z = at
    near = [shape for shape in shapes if shape.surface != "fixture" and _covers(shape, x, y)]
    found = [0.0] if floor else []
    if near:
        spec = mujoco.MjSpec()
        for number, shape in enumerate(near):
            add_geom(spec, spec.worldbody, str(number), shape)
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        start = np.array([x, y, z + MAX_BELOW])
        geom = np.zeros(1, np.int32)
        distance = mujoco.mj_ray(model, data, start, np.array([0.0, 0.0, -1.0]), None, 1, -1, geom, None)
        if geom[0] >= 0:
            found.append(float(start[2] - distance))
    return max((height for height in found if height <= z + MAX_BELOW), default=z)


def _covers(shape: Shape, x: float, y: float) -> bool:
    low, high = corners_of(shape)
    return bool(low[0] <= x <= high[0] and low[1] <= y <= high[1])
