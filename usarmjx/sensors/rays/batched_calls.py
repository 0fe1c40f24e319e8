"""Functions of the geoms of worlds and of casts in them that all maps turn into one call."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from usarmjx.base.arrays import Array


def over_worlds(run: Callable[..., Any]) -> Callable[..., Any]:
    """Return `run(geoms, world, *casts)` such that all maps over it make one call, with longer axes.

    `geoms` has an axis over worlds, `world` says whose geoms each cast meets (casts,), and all else has an
    axis over casts, as results have.
    """
    call = custom_vmap(run)

    @call.def_vmap
    def mapped(size: int, batched: Sequence[bool], geoms: Array, *casts: Array) -> tuple[Any, Any]:
        pairs = zip(casts, batched[1:], strict=True)
        world, *rest = (x if own else jnp.broadcast_to(x, (size, *x.shape)) for x, own in pairs)
        if batched[0]:
            world = world + geoms.shape[1] * jnp.arange(size, dtype=jnp.int32)[:, None]
            geoms = geoms.reshape(-1, *geoms.shape[2:])
        found = over_worlds(run)(geoms, *(x.reshape(-1, *x.shape[2:]) for x in (world, *rest)))
        found = jax.tree.map(lambda x: x.reshape(*world.shape, *x.shape[1:]), found)
        return found, jax.tree.map(lambda _: True, found)

    return call
