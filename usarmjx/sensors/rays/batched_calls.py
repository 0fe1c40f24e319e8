"""Batching rule for calls with geoms of several worlds: any number of vmaps makes one call."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from usarmjx.base.arrays import Array


def merge_vmaps(run: Callable[..., Any]) -> Callable[..., Any]:
    """Return `run(geoms, world, *casts)` with a batching rule: vmaps lengthen its axes.

    `geoms` has an axis over worlds, `world` has the world of each cast (casts,), and all other arguments and
    the results have an axis over casts.
    """
    call = custom_vmap(run)

    @call.def_vmap
    def mapped(size: int, batched: Sequence[bool], geoms: Array, *casts: Array) -> tuple[Any, Any]:
        pairs = zip(casts, batched[1:], strict=True)
        world, *rest = (x if own else jnp.broadcast_to(x, (size, *x.shape)) for x, own in pairs)
        # Separate worlds: number them consecutively, one batch entry after the other.
        if batched[0]:
            world = world + geoms.shape[1] * jnp.arange(size, dtype=jnp.int32)[:, None]
            geoms = geoms.reshape(-1, *geoms.shape[2:])
        found = merge_vmaps(run)(geoms, *(x.reshape(-1, *x.shape[2:]) for x in (world, *rest)))
        found = jax.tree.map(lambda x: x.reshape(*world.shape, *x.shape[1:]), found)
        return found, jax.tree.map(lambda _: True, found)

    return call
