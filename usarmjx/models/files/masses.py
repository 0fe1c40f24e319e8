"""Solids whose masses make a given inertia."""

from dataclasses import replace

import mujoco
import numpy as np

from usarmjx.base.transforms import flip_angles, flip_vector
from usarmjx.models.build.geoms import add_geom
from usarmjx.models.files.mjcf_solids import Inertia, inertia_box, mat_of
from usarmjx.models.spec.shapes import Shape

INERTIA_TOLERANCE = 1e-3
"""Relative difference of inertias that counts as none."""


def with_masses(shapes: list[Shape], whole: Inertia) -> tuple[Shape, ...]:
    """Return solids whose masses make the given inertia, if need be all on one box more, never touched."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body()
    body.add_freejoint()
    for i, shape in enumerate(shapes):
        add_geom(spec, body, str(i), shape)
    if sum(shape.mass for shape in shapes) > 0:
        model = spec.compile()
        turn = mat_of(model.body_iquat[1])
        tensor = turn @ np.diag(model.body_inertia[1]) @ turn.T
        reach = np.sqrt(np.trace(whole.tensor) / whole.mass)
        if (
            abs(model.body_mass[1] - whole.mass) <= INERTIA_TOLERANCE * whole.mass
            and np.abs(model.body_ipos[1] - whole.centre).max() <= INERTIA_TOLERANCE * reach
            and np.abs(tensor - whole.tensor).max() <= INERTIA_TOLERANCE * np.trace(whole.tensor)
        ):
            return tuple(shapes)
    box = inertia_box(whole)
    box = replace(box, at=flip_vector(box.at), rotation=flip_angles(box.rotation))
    return (*(replace(shape, mass=0.0) for shape in shapes), box)
