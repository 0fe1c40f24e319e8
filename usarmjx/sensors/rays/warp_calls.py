"""Warp's kernels as functions of JAX arrays, mapped over robots and worlds in one launch."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp
from jax.custom_batching import custom_vmap

from usarmjx.base.arrays import Array
from usarmjx.sensors.rays import raycast_warp
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.kernels import bounding_radius
from usarmjx.sensors.rays.targets import GeomBlockInfo

WARP_SIZE = 32
UNLIMITED_DISTANCE = 3e38


def pack(blocks: Sequence[tuple[GeomBlockInfo, Any]]) -> jax.Array:
    """Return a world's geoms as the kernels read them (5, geoms, 4).

    By row: position and bounding radius, 0 where the box is looked at; the orientation's rows, after them
    owner, kind and place; size.
    """
    rows = []
    for info, block in blocks:
        count = info.num_geoms

        def column(values: Array) -> Array:
            return jnp.asarray(values, jnp.float32).reshape(-1, 1)

        radius = bounding_radius(info.kind, tuple(block.size.T)) if info.compact else jnp.zeros(count)
        place = info.first_index + np.arange(count)
        last = (radius, block.owner, np.full(count, info.kind), place, np.zeros(count))
        parts = (block.pos, block.mat[:, 0], block.mat[:, 1], block.mat[:, 2], block.size)
        rows.append(
            jnp.stack(
                [
                    jnp.concatenate([jnp.asarray(a, jnp.float32), column(b)], -1)
                    for a, b in zip(parts, last, strict=True)
                ]
            )
        )
    return jnp.concatenate(rows, 1)


def over_worlds(run: Callable[..., Any]) -> Callable[..., Any]:
    """Return `run(geoms, world, *casts)` such that maps make its leading axes longer.

    `geoms` has an axis over worlds, `world` (casts,) says whose geoms each cast meets, and all else has an
    axis over casts, as results have.
    """
    call = custom_vmap(run)

    @call.def_vmap
    def mapped(size: int, batched: Sequence[bool], geoms: Array, world: Array, *casts: Array) -> Any:  # noqa: ANN401
        each = [
            value if own else jnp.broadcast_to(value, (size, *value.shape))
            for value, own in zip((world, *casts), batched[1:], strict=True)
        ]
        if batched[0]:
            each[0] = each[0] + geoms.shape[1] * jnp.arange(size, dtype=jnp.int32)[:, None]
            geoms = geoms.reshape(-1, *geoms.shape[2:])
        count = each[0].shape[1]
        found = over_worlds(run)(geoms, *(value.reshape(-1, *value.shape[2:]) for value in each))
        return jax.tree.map(lambda x: x.reshape(size, count, *x.shape[1:]), found), jax.tree.map(
            lambda _: True, found
        )

    return call


@cache
def _kernel(name: str) -> Callable[..., Any]:
    return wp.jax_kernel(getattr(raycast_warp, name), num_outputs=2, block_dim=raycast_warp.BLOCK_DIM)


def _launch(
    name: str, arrays: Sequence[Array], numbers: Sequence[float], casts: int, rays: int, bundle: int
) -> Any:
    threads = casts * -(-rays // bundle) * WARP_SIZE
    found = _kernel(name)(*arrays, *numbers, output_dims=casts * rays, launch_dims=threads)
    return tuple(x.reshape(casts, rays) for x in found)


def nearest_of_bundles(
    blocks: Sequence[tuple[GeomBlockInfo, Any]],
    rays: tuple[Array, Array] | Fans,
    exclude_and_wanted: tuple[Array | np.int32, Array],
    *,
    bundle_size: int,
    max_distance: float,
) -> tuple[jax.Array, jax.Array]:
    """As `raycast_gpu.nearest_of_bundles`, on Warp."""
    bundle = -(-bundle_size // -(-bundle_size // WARP_SIZE))
    reach = min(max_distance, UNLIMITED_DISTANCE)
    geoms = pack(blocks)
    count = geoms.shape[1]
    lines = None if not isinstance(rays, Fans) else np.asarray(rays.directions, np.float32).reshape(-1, 3)
    per_cast = len(rays[0]) if lines is None else len(lines)

    def run(geoms: Array, world: Array, exclude: Array, wanted: Array, *given: Array) -> Any:
        casts = len(world)
        arrays = [geoms.reshape(-1, 4), world, exclude, wanted]
        if lines is None:
            arrays += [x.reshape(-1, 3) for x in given]
            return _launch("cast_rays", arrays, (count, per_cast, bundle, reach), casts, per_cast, bundle)
        fans = given[0].shape[1]
        arrays += [given[0].reshape(-1, 3), given[1].reshape(-1, 3, 3), jnp.asarray(lines)]
        return _launch("cast_fans", arrays, (count, fans, bundle, reach), casts, per_cast, bundle)

    given = (rays.pos, rays.mat) if isinstance(rays, Fans) else rays
    asked = [jnp.asarray(number).astype(jnp.int32) for number in exclude_and_wanted]
    casts = [*asked, *(jnp.asarray(x, jnp.float32) for x in given)]
    found = over_worlds(run)(geoms[None], jnp.zeros(1, jnp.int32), *(x[None] for x in casts))
    return tuple(x[0] for x in found)
