"""Launches of the ray kernels on Warp: which kernel casts which rays, in how many threads."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp

from usarmjx.base.backend import Array
from usarmjx.base.errors import UsageError
from usarmjx.base.warp_functions import warp_function
from usarmjx.sensors.rays import first_of_fans_warp, raycast_warp
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.raycast_warp import MAX_BUNDLE, apart
from usarmjx.sensors.rays.targets import GeomBlock, GeomBlockInfo, merge_vmaps

BLOCK_DIM = 64
"""Threads of a block."""
MAX_THREADS = 2**31 - 1
"""Largest number of threads of a launch, and of its results, which kernels index with 32 bits."""
UNLIMITED_DISTANCE = 3e38
"""Finite stand-in for an unlimited range, as misses are infinitely far."""


@warp_function
def _kernel(name: str) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    made = first_of_fans_warp if name == "cast_first_of_fans" else raycast_warp
    return wp.jax_kernel(getattr(made, name), num_outputs=2, block_dim=BLOCK_DIM)


class _Launch(NamedTuple):
    """Name of a kernel, the warps of a cast, and what the kernel is given after geoms and rays."""

    name: str
    warps: int
    given: list[Any]


def _bundle_of(size: int) -> int:
    """Return the size of equal bundles of which a few make a requested one."""
    # 48 rays are two bundles of 24, not one of 32 and one that is half empty.
    return -(-size // -(-size // MAX_BUNDLE))


def _launch_of_rays(count: int, bundle_size: int, numbers: Sequence[float]) -> _Launch:
    """Return how single rays are cast; numbers are those of `nearest_of_bundles`."""
    *geoms, reach = numbers
    # Rays without a common cone would each fill a warp of their own.
    if bundle_size == 1:
        return _Launch("cast_single_rays", 1, [*geoms, count, reach])
    size = _bundle_of(bundle_size)
    bundles = -(-count // size)
    return _Launch("cast_rays", bundles, [*geoms, count, bundles, size, reach])


def finds_first_only(
    work: Sequence[tuple[GeomBlockInfo, GeomBlock]], directions: np.ndarray, least_cosines: tuple[float, ...]
) -> bool:
    """Return whether of fans (fans, rays, 3) only hits are found that `least_cosines` let count."""
    geoms = sum(info.num_geoms for info, _ in work)
    fits = geoms <= first_of_fans_warp.MOST_GEOMS and directions.shape[1] <= MAX_BUNDLE
    return bool(least_cosines) and fits


def _launch_of_fans(
    directions: np.ndarray, bundle_size: int, least_cosines: tuple[float, ...], numbers: Sequence[float]
) -> _Launch:
    """Return how fans are cast, likewise; `least_cosines` if only first hits are to be found."""
    (fans, per_fan, _), (*geoms, reach) = directions.shape, numbers
    lines = np.asarray(directions, np.float32)
    flat = lines.reshape(-1, 3)
    if least_cosines:
        fixed = [flat, first_of_fans_warp.cones_of(lines), np.array(least_cosines, np.float32)]
        return _Launch("cast_first_of_fans", 1, [*fixed, *geoms[1:], fans, per_fan, reach])
    size = _bundle_of(bundle_size)
    bundles = -(-len(flat) // size)
    return _Launch("cast_fans", bundles, [flat, *geoms, len(flat), bundles, size, reach, fans])


def nearest_of_bundles(
    work: Sequence[tuple[GeomBlockInfo, GeomBlock]],
    rays: tuple[Array, Array] | Fans,
    exclude_and_wanted: tuple[Array | np.int32, Array],
    *,
    bundle_size: int,
    max_distance: float,
    least_cosines: tuple[float, ...] = (),
) -> tuple[jax.Array, jax.Array]:
    """Return distance (inf for a miss) and geom index (-1 for a miss) of each first hit, both (rays,).

    Args:
        work: The geoms, compact ones last.
        rays: Origins [m] and unit vectors (rays, 3); or fans, whose rays are never materialised.
        exclude_and_wanted: Owner whose geoms are excluded (), and whether to cast at all ().
        bundle_size: See `raycast.RayQuery`.
        max_distance: See `raycast.RayQuery` [m].
        least_cosines: See `raycast.RayQuery`.

    Raises:
        UsageError: The vmapped launch needs more than `MAX_THREADS` threads or results.
    """
    given = (rays.pos, rays.mat) if isinstance(rays, Fans) else rays
    count = rays.directions[..., 0].size if isinstance(rays, Fans) else len(rays[0])
    if not work or not count:
        return jnp.full(count, jnp.inf), jnp.full(count, -1, jnp.int32)
    wide = sum(info.num_geoms for info, _ in work if not info.compact)
    # Fixed arrays have no axis over worlds: one copy serves all of them.
    packed, fixed_slots = apart(work)
    geoms = sum(info.num_geoms for info, _ in work)
    numbers = wide, *fixed_slots, geoms, min(max_distance, UNLIMITED_DISTANCE)
    if isinstance(rays, Fans):
        first_only = finds_first_only(work, rays.directions, least_cosines)
        launch = _launch_of_fans(rays.directions, bundle_size, least_cosines if first_only else (), numbers)
    else:
        launch = _launch_of_rays(count, bundle_size, numbers)

    def run(
        geoms: tuple[Array, Array], world: tuple[Array, Array], exclude: Array, wanted: Array, *given: Array
    ) -> tuple[Array, ...]:
        casts = len(exclude)
        arrays = [*(x.reshape(-1, 4) for x in geoms), *world, exclude, wanted]
        arrays += [x.reshape(-1, *x.shape[2:]) for x in given]  # fans or rays of all casts on one axis
        threads = casts * launch.warps * MAX_BUNDLE
        # Checked here: beyond it indices overflow in the kernel, silently.
        needed = max(threads, casts * count)
        if needed > MAX_THREADS:
            raise UsageError(
                f"{casts:,} casts of {count:,} rays each need {needed:,} threads or results of a GPU at "
                f"once, at most {MAX_THREADS:,}: fewer worlds"
            )
        kernel = _kernel(launch.name)
        found = kernel(*arrays, *launch.given, output_dims=casts * count, launch_dims=threads)
        return tuple(x.reshape(casts, count) for x in found)

    asked = [jnp.asarray(number).astype(jnp.int32) for number in exclude_and_wanted]
    casts = [*asked, *(jnp.asarray(x, jnp.float32) for x in given)]
    found = merge_vmaps(run)(packed, (jnp.zeros(1, jnp.int32),) * 2, *(x[None] for x in casts))
    return found[0][0], found[1][0]
