"""Separation of overlapping robots: on JAX, or on a GPU by one Warp kernel with JAX's gradient."""

from typing import Any, cast

import jax
import jax.numpy as jnp

from usarmjx.base.accelerator import warp_in_use
from usarmjx.base.arrays import Array
from usarmjx.base.warp_functions import warp_function
from usarmjx.engines.planar.footprints import Footprints, separate_footprints
from usarmjx.engines.planar.neighbor_lists import NeighborList, obstacle_outlines
from usarmjx.engines.planar.proposed_motion import ProposedMotion, pack_motion


def separate_robots(proposed: ProposedMotion, neighbors: NeighborList) -> tuple[Footprints, Array]:
    """Return the robots' resolved poses, as `separate_footprints` does; equal on Warp within rounding."""
    return (separate_on_warp if _fits_on_warp(proposed.moves.shape[1]) else _separate_on_jax)(
        proposed, neighbors
    )


def _separate_on_jax(proposed: ProposedMotion, neighbors: NeighborList) -> tuple[Footprints, Array]:
    near = obstacle_outlines(proposed.left, neighbors.near)
    return separate_footprints(
        proposed.left, proposed.there, near, proposed.moves, proposed.stacked, discs=neighbors.discs
    )


def _fits_on_warp(robots: int) -> bool:
    """Return whether Warp is used for worlds of `robots` robots."""
    if not warp_in_use():
        return False
    from usarmjx.engines.planar.warp_separation import MAX_ROBOTS

    return 0 < robots <= MAX_ROBOTS


def separate_on_warp(proposed: ProposedMotion, neighbors: NeighborList) -> tuple[Footprints, Array]:
    """As `separate_robots`, on Warp: one launch, with as many iterations per world as it needs."""
    return _with_jax_gradient(proposed, neighbors)


def _separate_on_warp(proposed: ProposedMotion, neighbors: NeighborList) -> tuple[Footprints, Array]:
    worlds, robots = proposed.moves.shape
    stacked, near = proposed.stacked, neighbors.packed_obstacles
    over = jnp.zeros(1, jnp.int32) if stacked is None else jnp.asarray(stacked, jnp.int32).reshape(-1)
    solids = near.reshape(-1) if near.size else jnp.zeros(1)
    found = _kernel(robots)(
        *(pack_motion(proposed), solids, over, worlds, near.shape[2], int(stacked is not None)),
        output_dims=worlds * robots * 4,
        launch_dims=worlds * _lanes(robots),
    )
    kept = found[0].reshape(worlds, robots, 4)
    return proposed.there.replace(pos=kept[..., :2], yaw=kept[..., 2]), kept[..., 3] > 0


@warp_function
def _kernel(robots: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return the kernel for worlds of `robots` robots."""
    import warp as wp

    from usarmjx.engines.planar.warp_separation import block_threads_for, separation_kernel

    return wp.jax_kernel(separation_kernel(robots), block_dim=block_threads_for(robots))


def _lanes(robots: int) -> int:
    """Return the number of threads per world."""
    from usarmjx.engines.planar.warp_separation import lanes_for

    return lanes_for(robots)


def _gradients(values: tuple[Any, ...], rates: tuple[Any, ...]) -> tuple[Any, Any]:
    """Return the result and its derivative, forward or backward: that of `separate_footprints`."""
    return separate_on_warp(*values), jax.jvp(_separate_on_jax, values, rates)[1]


_with_jax_gradient = cast(Any, jax.custom_jvp)(_separate_on_warp)  # JAX leaves its types open
_with_jax_gradient.defjvp(_gradients)
