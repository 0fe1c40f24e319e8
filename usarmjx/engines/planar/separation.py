"""How robots are kept apart here: by JAX, or on a GPU by one kernel of Warp, which has JAX's slope."""

from typing import Any, cast

import jax
import jax.numpy as jnp

from usarmjx.base.accelerator import warp_in_use
from usarmjx.base.arrays import Array
from usarmjx.base.warp_functions import warp_function
from usarmjx.engines.planar.footprints import Footprints, keep_apart
from usarmjx.engines.planar.neighbor_lists import NeighborList, stopping
from usarmjx.engines.planar.proposed_motion import ProposedMotion, rows_of


def part_robots(aims: ProposedMotion, around: NeighborList) -> tuple[Footprints, Array]:
    """Return where robots come to, as `keep_apart` does; on Warp where that is in use, within rounding."""
    return (parted_on_warp if _fits_on_warp(aims.moves.shape[1]) else _parted)(aims, around)


def _parted(aims: ProposedMotion, around: NeighborList) -> tuple[Footprints, Array]:
    near = stopping(aims.left, around.near)
    return keep_apart(aims.left, aims.there, near, aims.moves, aims.stacked, discs=around.discs)


def _fits_on_warp(robots: int) -> bool:
    """Return whether worlds of so many robots are for Warp here."""
    if not warp_in_use():
        return False
    from usarmjx.engines.planar.warp_separation import MOST_ROBOTS

    return 0 < robots <= MOST_ROBOTS


def parted_on_warp(aims: ProposedMotion, around: NeighborList) -> tuple[Footprints, Array]:
    """As `part_robots`, on Warp: one launch, in which each world does as many turns as it needs."""
    return _with_slope(aims, around)


def _launched(aims: ProposedMotion, around: NeighborList) -> tuple[Footprints, Array]:
    worlds, robots = aims.moves.shape
    stacked, near = aims.stacked, around.near_numbers
    over = jnp.zeros(1, jnp.int32) if stacked is None else jnp.asarray(stacked, jnp.int32).reshape(-1)
    solids = near.reshape(-1) if near.size else jnp.zeros(1)
    found = _kernel(robots)(
        *(rows_of(aims), solids, over, worlds, near.shape[2], int(stacked is not None)),
        output_dims=worlds * robots * 4,
        launch_dims=worlds * _lanes(robots),
    )
    kept = found[0].reshape(worlds, robots, 4)
    return aims.there.replace(pos=kept[..., :2], yaw=kept[..., 2]), kept[..., 3] > 0


@warp_function
def _kernel(robots: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return what launches the kernel for worlds of so many robots."""
    import warp as wp

    from usarmjx.engines.planar.warp_separation import BLOCK, parting_kernel

    return wp.jax_kernel(parting_kernel(robots), block_dim=BLOCK)


def _lanes(robots: int) -> int:
    """Return how many threads a world has."""
    from usarmjx.engines.planar.warp_separation import lanes_for

    return lanes_for(robots)


def _slopes(values: tuple[Any, ...], rates: tuple[Any, ...]) -> tuple[Any, Any]:
    """Return the same and how it changes, forwards or backwards: as `keep_apart` does there."""
    return parted_on_warp(*values), jax.jvp(_parted, values, rates)[1]


_with_slope = cast(Any, jax.custom_jvp)(_launched)  # JAX leaves its types open
_with_slope.defjvp(_slopes)
