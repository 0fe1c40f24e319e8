"""Warp's kernels as functions of JAX arrays, mapped over robots and worlds in one launch."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UsageError
from usarmjx.base.warp_functions import warp_function
from usarmjx.sensors.rays import raycast_warp
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.kernels import bounding_box, bounding_radius
from usarmjx.sensors.rays.over_worlds import over_worlds
from usarmjx.sensors.rays.targets import GeomBlock, GeomBlockInfo

MAX_BUNDLE = 32
"""Most rays of a bundle: one for each lane."""
MOST_THREADS = 2**31 - 1
"""Of a launch: kernels number them with 32 bits."""
UNLIMITED_DISTANCE = 3e38
"""Stands for an unlimited reach, as what is missed is infinitely far."""


def pack(blocks: Sequence[tuple[GeomBlockInfo, GeomBlock]]) -> jax.Array:
    """Return a world's geoms as kernels read them: four numbers at a time, of 32 after each other.

    Of each there are (6, 4): position and bounding radius, which is 0 where the box about it is to be looked
    at; the rows of the orientation, each with a number: owner, kind, place; size; half lengths of the box.

    Returns:
        (groups, 6, 32, 4); zeros fill the last group up.
    """
    geoms = jnp.concatenate([_packed(info, block) for info, block in blocks], 1)
    whole = jnp.pad(geoms, ((0, 0), (0, -geoms.shape[1] % 32), (0, 0)))  # pyright: ignore[reportUnknownMemberType] - jnp.pad is half typed
    return whole.reshape(6, -1, 32, 4).swapaxes(0, 1)


def _packed(info: GeomBlockInfo, block: GeomBlock) -> jax.Array:
    none = np.zeros(info.num_geoms, np.float32)
    radius = bounding_radius(info.kind, tuple(block.size.T)) if info.compact else none
    half = block.size if info.compact else jnp.stack(bounding_box(info.kind, tuple(block.size.T))[1], -1)
    place = info.first_index + np.arange(info.num_geoms)
    rows = (block.pos, *(block.mat[:, i] for i in range(3)), block.size, half)
    last = (radius, block.owner, none + info.kind, place, none, none)
    single = [
        (jnp.asarray(a, jnp.float32), jnp.asarray(b, jnp.float32)[:, None])
        for a, b in zip(rows, last, strict=True)
    ]
    return jnp.stack([jnp.concatenate(pair, -1) for pair in single])


@warp_function
def _kernel(name: str) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    return wp.jax_kernel(getattr(raycast_warp, name), num_outputs=2, block_dim=raycast_warp.BLOCK_DIM)


def _bundle_of(size: int) -> int:
    """Return the size of equal bundles of which a few make one that was asked for."""
    return -(-size // -(-size // MAX_BUNDLE))


def nearest_of_bundles(
    work: Sequence[tuple[GeomBlockInfo, GeomBlock]],
    rays: tuple[Array, Array] | Fans,
    exclude_and_wanted: tuple[Array | np.int32, Array],
    *,
    bundle_size: int,
    max_distance: float,
) -> tuple[jax.Array, jax.Array]:
    """As `raycast_gpu.nearest_of_bundles`, on Warp; the geoms are given as they are.

    Raises:
        UsageError: Mapped over so many worlds and robots, more than `MOST_THREADS` were needed at once.
    """
    name, given, lines = "cast_rays", rays, ()
    if isinstance(rays, Fans):
        name, given = "cast_fans", (rays.pos, rays.mat)
        lines = (np.asarray(rays.directions, np.float32).reshape(-1, 3),)
    count, bundle = len(lines[0] if lines else rays[0]), _bundle_of(bundle_size)
    if not work or not count:
        return jnp.full(count, jnp.inf), jnp.full(count, -1, jnp.int32)
    wide = sum(info.num_geoms for info, _ in work if not info.compact)
    geoms = sum(info.num_geoms for info, _ in work)
    bundles = -(-count // bundle)
    numbers = [wide, geoms, count, bundles, bundle, min(max_distance, UNLIMITED_DISTANCE)]
    if isinstance(rays, Fans):
        numbers.append(len(rays.pos))

    def run(geoms: Array, world: Array, exclude: Array, wanted: Array, *given: Array) -> tuple[Array, ...]:
        casts = len(world)
        arrays = [geoms.reshape(-1, 4), world, exclude, wanted]
        arrays += [x.reshape(-1, *x.shape[2:]) for x in given]  # fans, or rays, of all casts in one axis
        threads = casts * bundles * MAX_BUNDLE
        if threads > MOST_THREADS:
            raise UsageError(
                f"{casts:,} casts of {count:,} rays each need {threads:,} threads of a GPU at once, "
                f"at most {MOST_THREADS:,}: fewer worlds"
            )
        found = _kernel(name)(*arrays, *lines, *numbers, output_dims=casts * count, launch_dims=threads)
        return tuple(x.reshape(casts, count) for x in found)

    asked = [jnp.asarray(number).astype(jnp.int32) for number in exclude_and_wanted]
    casts = [*asked, *(jnp.asarray(x, jnp.float32) for x in given)]
    found = over_worlds(run)(pack(work)[None], jnp.zeros(1, jnp.int32), *(x[None] for x in casts))
    return found[0][0], found[1][0]
