"""How robots are kept apart here: by JAX, or on a GPU by one kernel of Warp, which has JAX's slope."""

from functools import partial
from typing import Any, cast

import jax
import jax.numpy as jnp

from usarmjx.base.arrays import Array
from usarmjx.base.warp_functions import warp_function
from usarmjx.engines.planar.footprints import Footprints, keep_apart
from usarmjx.engines.planar.overlap import Outlines
from usarmjx.sensors.rays.choice import warp_in_use


def part_robots(
    before: Footprints, after: Footprints, near: Outlines, moves: Array, stacked: Array | None, *, discs: bool
) -> tuple[Footprints, Array]:
    """As `keep_apart`, on Warp where that is in use; what the two find differs by rounding."""
    if not _fits_on_warp(moves.shape[1]):
        return keep_apart(before, after, near, moves, stacked, discs=discs)
    return on_warp(discs, before, after, near, moves, stacked)


def _fits_on_warp(robots: int) -> bool:
    """Return whether worlds of so many robots are for Warp here."""
    if not warp_in_use():
        return False
    from usarmjx.engines.planar.warp_parting import MOST_ROBOTS  # Warp need not be installed

    return 0 < robots <= MOST_ROBOTS


def on_warp(
    discs: bool, before: Footprints, after: Footprints, near: Outlines, moves: Array, stacked: Array | None
) -> tuple[Footprints, Array]:
    """As `part_robots`, on Warp: one launch, in which each world does as many turns as it needs."""
    return _with_slope(discs, before, after, near, moves, stacked)


def _launched(
    discs: bool, before: Footprints, after: Footprints, near: Outlines, moves: Array, stacked: Array | None
) -> tuple[Footprints, Array]:
    del discs  # which solids are discs their radii say
    worlds, robots = moves.shape
    places = [number for prints in (before, after) for number in _place(prints)]
    body = [after.half[..., 0], after.half[..., 1], after.mass, moves]
    numbers = jnp.stack([jnp.broadcast_to(n, moves.shape).astype(jnp.float32) for n in (*places, *body)], -1)
    solids = jnp.stack([jnp.moveaxis(jnp.asarray(part, jnp.float32), -1, 0) for part in near], -1)
    over = jnp.zeros(1, jnp.int32) if stacked is None else jnp.asarray(stacked, jnp.int32).reshape(-1)
    found = _kernel(robots)(
        *(numbers.reshape(-1), solids.reshape(-1), over, solids.shape[1], int(stacked is not None)),
        output_dims=worlds * robots * 4,
        launch_dims=worlds * _lanes(robots),
    )
    kept = found[0].reshape(worlds, robots, 4)
    return after.replace(pos=kept[..., :2], yaw=kept[..., 2]), kept[..., 3] > 0


def _place(prints: Footprints) -> list[Array]:
    """Return a robot's numbers in the order of `warp_parting.PLACES`."""
    one = prints.outlines
    return [one.x, one.y, one.cos, one.sin, prints.yaw, prints.low, prints.high]


@warp_function
def _kernel(robots: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return what launches the kernel for worlds of so many robots."""
    import warp as wp

    from usarmjx.engines.planar.warp_parting import BLOCK, parting_kernel

    return wp.jax_kernel(parting_kernel(robots), block_dim=BLOCK)


def _lanes(robots: int) -> int:
    """Return how many threads a world has."""
    from usarmjx.engines.planar.warp_parting import lanes_for

    return lanes_for(robots)


def _slopes(discs: bool, values: tuple[Any, ...], rates: tuple[Any, ...]) -> tuple[Any, Any]:
    """Return the same and how it changes, forwards or backwards: as `keep_apart` does there."""
    return on_warp(discs, *values), jax.jvp(partial(keep_apart, discs=discs), values, rates)[1]


_with_slope = cast(Any, jax.custom_jvp)(_launched, nondiff_argnums=(0,))  # JAX leaves its types open
_with_slope.defjvp(_slopes)
