"""`count_walls` on Warp, for all worlds in one launch."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import warp as wp

from usarmjx.base.arrays import Array
from usarmjx.base.warp_functions import warp_function
from usarmjx.comms import warp_walls
from usarmjx.sensors.rays.over_worlds import over_worlds
from usarmjx.sensors.rays.targets import GeomBlockInfo, Geoms
from usarmjx.sensors.rays.warp_calls import pack


@warp_function
def _kernel() -> Any:  # noqa: ANN401
    return wp.jax_kernel(warp_walls.count_crossings)


def _count(count: int, geoms: Array, world: Array, start: Array, end: Array) -> jax.Array:
    shape = start.shape[:2]
    ends = [x.reshape(-1, 3) for x in (start, end)]
    threads = shape[0] * shape[1]
    found = _kernel()(
        geoms.reshape(-1, 4), world, *ends, count, shape[1], output_dims=threads, launch_dims=threads
    )
    return found[0].reshape(shape)


def count_on_warp(geoms: Geoms, start: Array, end: Array) -> jax.Array:
    """As `walls.count_walls`; any axes before those of the vectors' components."""
    infos = [
        GeomBlockInfo(kind, len(b.owner), 0, False) for kind, b in zip(geoms.kinds, geoms.blocks, strict=True)
    ]
    packed = pack(list(zip(infos, geoms.blocks, strict=True)))
    ends = [jnp.asarray(x, jnp.float32).reshape(1, -1, 3) for x in (start, end)]
    found = over_worlds(partial(_count, sum(info.num_geoms for info in infos)))(
        packed[None], jnp.zeros(1, jnp.int32), *ends
    )
    return found.reshape(start.shape[:-1])
