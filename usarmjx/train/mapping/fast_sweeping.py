"""Distances over maps on a CPU: in turns from all four sides, row by row, for many maps at once.

A sweep from one side carries a distance along its whole way until that turns back, where a wave needs a round
for each step. Of all maps together the same square is looked at: maps are the last axis.
"""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap

from usarmjx.base.backend import Array

MAPS_AT_A_TIME = 64
"""Maps that are swept together: this number stays in a core's own cache, and wait for each other."""
UNREACHABLE = 1e6
"""Distance of squares that no path leads to [squares]."""
SLANT = np.float32(math.sqrt(2))
"""Cost of a slanting step [squares]."""


def _entered(before: jax.Array, row: jax.Array, enter: jax.Array) -> jax.Array:
    """Return a row (squares, maps) after steps from the row before it, straight and slanting ones."""
    # Infinite, so that no slanting step comes from beyond the map's edge.
    beside = jnp.full((1, before.shape[1]), jnp.inf)
    slanting = jnp.minimum(jnp.concatenate([before[1:], beside]), jnp.concatenate([beside, before[:-1]]))
    return jnp.minimum(row, jnp.minimum(before + 1.0, slanting + SLANT) + enter)


def _sweep(far: jax.Array, enter: jax.Array, axis: int, *, back: bool) -> jax.Array:
    """Return distances (i, j, maps) after one sweep along an axis."""
    # Steps along a row are left out: the sweeps along the other axis make them.
    length = far.shape[axis]

    def row(values: jax.Array, i: Array | int) -> jax.Array:
        return jax.lax.dynamic_index_in_dim(values, i, axis, keepdims=False)  # pyright: ignore[reportUnknownVariableType] - half typed

    def step(k: jax.Array, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        far, before = state
        i = length - 1 - k if back else k
        now = _entered(before, row(far, i), row(enter, i))
        return jax.lax.dynamic_update_index_in_dim(far, now, i, axis), now  # pyright: ignore[reportUnknownVariableType] - half typed

    return jax.lax.fori_loop(1, length, step, (far, row(far, length - 1 if back else 0)))[0]


def _sweeps(start: jax.Array, enter: jax.Array, until: jax.Array) -> jax.Array:
    """Return the distances of some maps; all are (i, j, maps), but `until`, which is (2, maps)."""
    which = jnp.arange(start.shape[-1])

    def turn(state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        before, _ = state
        far = before
        for axis in range(2):
            for back in (False, True):
                far = _sweep(far, enter, axis, back=back)
        # Squares farther than the one that is asked for lie on no way from there.
        asked = jnp.where(until[0] < 0, jnp.inf, far[until[0], until[1], which])
        return far, ((far < before) & (far <= asked)).any()

    return jax.lax.while_loop(lambda state: state[1], turn, (start, jnp.ones((), bool)))[0]


def _of_all(start: jax.Array, enter: jax.Array, until: jax.Array) -> jax.Array:
    """Return the distances of maps (maps, i, j)."""
    count = len(start)
    together = min(count, MAPS_AT_A_TIME)
    missing = -count % together

    def grouped(values: jax.Array) -> jax.Array:
        # Padding repeats the last map, so that it needs no more turns than that one.
        whole = jnp.concatenate([values, jnp.broadcast_to(values[-1:], (missing, *values.shape[1:]))])
        return jnp.moveaxis(whole.reshape(-1, together, *values.shape[1:]), 1, -1)

    def some(maps: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        return _sweeps(*maps)

    # Group after group: each stays in the cache, and waits only for its own slowest map.
    far = jax.lax.map(some, tuple(map(grouped, (start, enter, until))))
    return jnp.moveaxis(far, -1, 1).reshape(-1, *start.shape[1:])[:count]


def over_maps(run: Callable[..., jax.Array]) -> Callable[..., jax.Array]:
    """Return a function of arrays over maps such that all maps over it make one call, with a longer axis.

    Args:
        run: Its arguments and its result have a first axis over maps.
    """
    call = custom_vmap(run)

    # JAX calls this for `vmap`; a nested one calls it again for the longer axis, until one call is left.
    @call.def_vmap
    def mapped(size: int, batched: list[bool], *args: jax.Array) -> tuple[jax.Array, bool]:
        rows = [
            x if own else jnp.broadcast_to(x, (size, *x.shape)) for x, own in zip(args, batched, strict=True)
        ]
        found = over_maps(run)(*(x.reshape(-1, *x.shape[2:]) for x in rows))
        return found.reshape(*rows[0].shape[:2], *found.shape[1:]), True

    return call


def of_one_map(run: Callable[..., jax.Array], start: Array, enter: Array, until: Array | None) -> jax.Array:
    """As `swept_distances`, by what `over_maps` takes, as `_of_all`."""
    asked = jnp.full(2, -1, jnp.int32) if until is None else jnp.asarray(until, jnp.int32)
    rows = (jnp.asarray(start, jnp.float32), jnp.asarray(enter, jnp.float32), asked)
    return over_maps(run)(*(x[None] for x in rows))[0]


def swept_distances(start: Array, enter: Array, until: Array | None) -> jax.Array:
    """Return how far each square is from the nearest start, as `wavefront.distances` (i, j).

    Args:
        start: Cost at the beginning of a way that begins in a square (i, j).
        enter: Cost of entering a square, beside the step; infinite: none leads through it (i, j).
        until: See there.
    """
    return of_one_map(_of_all, start, enter, until)
