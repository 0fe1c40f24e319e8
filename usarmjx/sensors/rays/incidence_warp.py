"""Angles of incidence on Warp: one thread per ray reads the one geom that its ray has hit."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import warp as wp

from usarmjx.base.backend import Array
from usarmjx.base.warp_functions import warp_function
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.raycast_warp import (
    apart,
    geom_of,
    integer_quotient,
    local,
    row_of,
    thread_index,
    world_geoms,
)
from usarmjx.sensors.rays.targets import GeomBlock, GeomBlockInfo, GeomHits, merge_vmaps
from usarmjx.sensors.rays.warp_kinds import normal_of

wp.set_module_options({"enable_backward": False})

BLOCK_DIM = 256
"""Threads of a block."""


@wp.func
def _cosine(at: wp.uint64, start: wp.vec3, along: wp.vec3, distance: float) -> float:
    """Return the cosine between a ray and the surface normal at its hit."""
    pos = row_of(at, 0)
    r0 = row_of(at, 1)
    r1 = row_of(at, 2)
    r2 = row_of(at, 3)
    s = row_of(at, 4)
    point = local(r0, r1, r2, start + distance * along - wp.vec3(pos[0], pos[1], pos[2]))
    normal = normal_of(int(r1[3]), point, wp.vec3(s[0], s[1], s[2]))
    # The absolute value, as normals here may point inward.
    return wp.abs(wp.dot(normal, local(r0, r1, r2, along)))


@wp.kernel(enable_backward=False, grid_stride=False)
def cosines_of_fans(  # noqa: PLR0913 - a kernel's arguments are its buffers
    own: wp.array[wp.vec4],
    fixed: wp.array[wp.vec4],
    own_world: wp.array[int],
    fixed_world: wp.array[int],
    distance: wp.array[float],
    geom: wp.array[int],
    pos: wp.array[wp.vec3],
    mat: wp.array[wp.mat33],
    lines: wp.array[wp.vec3],
    slots: wp.array[int],
    begin_fixed: int,
    end_fixed: int,
    count: int,
    rays: int,
    fans: int,
    cosine: wp.array[float],
) -> None:
    """Compute the cosines of fans' rays, 0 without a hit."""
    t = thread_index(wp.tid())
    found = wp.float32(0.0)
    if geom[t] >= 0:
        cast = integer_quotient(t, rays)
        ray = t - cast * rays
        # All fans of a cast have the same number of rays.
        fan = cast * fans + integer_quotient(ray, integer_quotient(rays, fans))
        world = world_geoms(own, own_world[cast], fixed, fixed_world[cast], begin_fixed, end_fixed, count)
        # `geom` counts in the scene's order, the packed array in the order of blocks.
        at = geom_of(world, slots[geom[t]])
        found = _cosine(at, pos[fan], mat[fan] * lines[ray], distance[t])
    cosine[t] = found


@wp.kernel(enable_backward=False, grid_stride=False)
def cosines_of_rays(  # noqa: PLR0913 - as above
    own: wp.array[wp.vec4],
    fixed: wp.array[wp.vec4],
    own_world: wp.array[int],
    fixed_world: wp.array[int],
    distance: wp.array[float],
    geom: wp.array[int],
    origin: wp.array[wp.vec3],
    direction: wp.array[wp.vec3],
    slots: wp.array[int],
    begin_fixed: int,
    end_fixed: int,
    count: int,
    rays: int,
    cosine: wp.array[float],
) -> None:
    """Compute the cosines of individual rays, 0 without a hit."""
    t = thread_index(wp.tid())
    found = wp.float32(0.0)
    if geom[t] >= 0:
        cast = integer_quotient(t, rays)
        world = world_geoms(own, own_world[cast], fixed, fixed_world[cast], begin_fixed, end_fixed, count)
        at = geom_of(world, slots[geom[t]])
        found = _cosine(at, origin[t], direction[t], distance[t])
    cosine[t] = found


@warp_function
def _kernel(name: str) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    kernel = cosines_of_fans if name == "fans" else cosines_of_rays
    return wp.jax_kernel(kernel, num_outputs=1, block_dim=BLOCK_DIM)


def _slots_of(work: Sequence[tuple[GeomBlockInfo, GeomBlock]]) -> np.ndarray:
    """Return each geom's position in the array of `pack` (geoms,); undefined for transparent geoms."""
    slots = np.zeros(max(info.first_index + info.num_geoms for info, _ in work), np.int32)
    before = 0
    for info, _ in work:
        slots[info.first_index : info.first_index + info.num_geoms] = before + np.arange(info.num_geoms)
        before += info.num_geoms
    return slots


def cosines_of_hits(
    work: Sequence[tuple[GeomBlockInfo, GeomBlock]], rays: tuple[Array, Array] | Fans, first: GeomHits
) -> Array:
    """Return the cosine between each ray and the surface at its hit, in [0, 1]; 0 without a hit (rays,).

    Args:
        work: Geoms that block rays.
        rays: Origins and directions (rays, 3), or fans.
        first: Hits.
    """
    # Kernels take no empty arrays.
    if not work or not len(first.distance):
        return jnp.zeros_like(first.distance)
    count = len(first.distance)
    of_fans = isinstance(rays, Fans)
    given = (rays.pos, rays.mat) if of_fans else rays
    lines = (np.asarray(rays.directions, np.float32).reshape(-1, 3),) if of_fans else ()
    packed, fixed_slots = apart(work)
    numbers = [
        *fixed_slots,
        sum(info.num_geoms for info, _ in work),
        count,
        *([len(rays.pos)] if of_fans else []),
    ]
    # Hits have the indices of all geoms, and kernels places among those that block rays.
    slots = _slots_of(work)

    def run(geoms: tuple[Array, Array], world: tuple[Array, Array], *casts: Array) -> Array:
        arrays = [x.reshape(-1, *x.shape[2:]) for x in casts]
        size = len(world[0]) * count
        (found,) = _kernel("fans" if of_fans else "rays")(
            *(x.reshape(-1, 4) for x in geoms),
            *world,
            *arrays,
            *lines,
            slots,
            *numbers,
            output_dims=size,
            launch_dims=size,
        )
        return found.reshape(len(world[0]), count)

    casts = [first.distance, first.geom_index, *(jnp.asarray(x, jnp.float32) for x in given)]
    return merge_vmaps(run)(packed, (jnp.zeros(1, jnp.int32),) * 2, *(x[None] for x in casts))[0]
