"""Proposed motion of all robots in a step, and its packed form for Warp kernels."""

from typing import NamedTuple

import jax.numpy as jnp

from usarmjx.base.arrays import Array
from usarmjx.engines.base import GeomPoses
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.movable import SolidPlacement

POSE_FIELDS = ("x", "y", "cos", "sin", "yaw", "low", "high")
"""Fields of a row for the old and the proposed pose."""
BODY_FIELDS = ("length", "width", "mass", "moves", "step")
"""Further fields, before the height limits of the four feet."""
ROW_FIELDS = (
    *(f"{time}_{name}" for time in ("before", "there") for name in POSE_FIELDS),
    *BODY_FIELDS,
    *(f"limit_{i}" for i in range(4)),
)
"""All fields of a row, in order."""
MACROS = {f"FIELD_{name.upper()}": place for place, name in enumerate(ROW_FIELDS)}
"""Macros of native code: index of each field."""


class ProposedMotion(NamedTuple):
    """Proposed motion of the robots of all worlds, and the placement of movable solids.

    Attributes:
        left: Old footprints (worlds, robots).
        there: Proposed footprints, with the height range of the whole step.
        moves: Which robots may move (worlds, robots).
        stacked: Which robots are above each other (worlds, robots, robots); None: no robot flies.
        limit: Height limits of ground under the feet [m] (worlds, 4, robots).
        scene: Placement of the movable solids.
        qpos: Positions (worlds, nq).
        poses: Input poses of geoms; None: none.
    """

    left: Footprints
    there: Footprints
    moves: Array
    stacked: Array | None
    limit: Array
    scene: SolidPlacement
    qpos: Array
    poses: GeomPoses | None


def pack_motion(proposed: ProposedMotion) -> Array:
    """Return the packed motion (fields * worlds * robots,), field by field."""
    there = proposed.there
    places = [number for footprints in (proposed.left, there) for number in _place(footprints)]
    body = [there.half[..., 0], there.half[..., 1], there.mass, proposed.moves, proposed.left.step]
    numbers = [*places, *body, *(proposed.limit[:, i] for i in range(4))]
    rows = [jnp.broadcast_to(number, proposed.moves.shape).astype(jnp.float32) for number in numbers]
    return jnp.stack(rows).reshape(-1)


def _place(footprints: Footprints) -> list[Array]:
    """Return a robot's values in the order of `POSE_FIELDS`."""
    one = footprints.outlines
    return [one.x, one.y, one.cos, one.sin, footprints.yaw, footprints.low, footprints.high]
