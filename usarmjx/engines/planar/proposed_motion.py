"""What robots would do in a step; and the same as Warp's kernels read it, a row of numbers each."""

from typing import NamedTuple

import jax.numpy as jnp

from usarmjx.base.arrays import Array
from usarmjx.engines.base import GeomPoses
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.movable import SolidPlacement


class ProposedMotion(NamedTuple):
    """What the robots of all worlds would do in a step, and where else solids are.

    Attributes:
        left: What they take up on the plan before (worlds, robots).
        there: What they would, as high as before and after.
        moves: Which may move (worlds, robots).
        stacked: Which are over or under each other (worlds, robots, robots); None: nobody flies.
        limit: Up to what height the ground may be under where they stand [m] (worlds, 4, robots).
        scene: Where the solids are that can be elsewhere.
        qpos: Positions (worlds, nq).
        poses: Where the geoms are that are data; None: there are none.
    """

    left: Footprints
    there: Footprints
    moves: Array
    stacked: Array | None
    limit: Array
    scene: SolidPlacement
    qpos: Array
    poses: GeomPoses | None


PLACE = ("x", "y", "cos", "sin", "yaw", "low", "high")
"""What a row tells of where a robot was, and of where it would go."""
BODY = ("length", "width", "mass", "moves", "step")
"""What else it tells, before up to what height the ground may be under each of the four stances."""
NUMBERS = (
    *(f"{time}_{name}" for time in ("before", "there") for name in PLACE),
    *BODY,
    *(f"limit_{i}" for i in range(4)),
)
"""All of a row, in this order."""
WORDS = {f"NUMBER_{name.upper()}": place for place, name in enumerate(NUMBERS)}
"""What native code calls their places."""


def rows_of(aims: ProposedMotion) -> Array:
    """Return the rows of robots (numbers * worlds * robots,): first the first number of all of them."""
    there = aims.there
    places = [number for prints in (aims.left, there) for number in _place(prints)]
    body = [there.half[..., 0], there.half[..., 1], there.mass, aims.moves, aims.left.step]
    numbers = [*places, *body, *(aims.limit[:, i] for i in range(4))]
    rows = [jnp.broadcast_to(number, aims.moves.shape).astype(jnp.float32) for number in numbers]
    return jnp.stack(rows).reshape(-1)


def _place(prints: Footprints) -> list[Array]:
    """Return a robot's numbers in the order of `PLACE`."""
    one = prints.outlines
    return [one.x, one.y, one.cos, one.sin, prints.yaw, prints.low, prints.high]
