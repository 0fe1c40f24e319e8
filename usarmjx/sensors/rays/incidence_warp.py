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
    GROUP_SIZE,
    geom_row,
    integer_quotient,
    load_vec4,
    local,
    pack,
    thread_index,
)
from usarmjx.sensors.rays.targets import GeomBlock, GeomBlockInfo, GeomHits, merge_vmaps
from usarmjx.sensors.rays.warp_kinds import normal_of

wp.set_module_options({"enable_backward": False})

BLOCK_DIM = 256
"""Threads of a block."""


@wp.func
def _cosine(geoms: wp.array[wp.vec4], at: int, start: wp.vec3, along: wp.vec3, distance: float) -> float:
    """Return the cosine between a ray and the surface normal at its hit."""
    pos = load_vec4(geoms, at)
    r0 = load_vec4(geoms, at + 32)
    r1 = load_vec4(geoms, at + 64)
    r2 = load_vec4(geoms, at + 96)
    s = load_vec4(geoms, at + 128)
    point = local(r0, r1, r2, start + distance * along - wp.vec3(pos[0], pos[1], pos[2]))
    normal = normal_of(int(r1[3]), point, wp.vec3(s[0], s[1], s[2]))
    return wp.abs(wp.dot(normal, local(r0, r1, r2, along)))


@wp.kernel(enable_backward=False, grid_stride=False)
def cosines_of_fans(  # noqa: PLR0913 - a kernel's arguments are its buffers
    geoms: wp.array[wp.vec4],
    world: wp.array[int],
    distance: wp.array[float],
    geom: wp.array[int],
    pos: wp.array[wp.vec3],
    mat: wp.array[wp.mat33],
    lines: wp.array[wp.vec3],
    slots: wp.array[int],
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
        fan = cast * fans + integer_quotient(ray, integer_quotient(rays, fans))
        at = world[cast] * ((count + 31) >> 5) * GROUP_SIZE + geom_row(slots[geom[t]])
        found = _cosine(geoms, at, pos[fan], mat[fan] * lines[ray], distance[t])
    cosine[t] = found


@wp.kernel(enable_backward=False, grid_stride=False)
def cosines_of_rays(  # noqa: PLR0913 - as above
    geoms: wp.array[wp.vec4],
    world: wp.array[int],
    distance: wp.array[float],
    geom: wp.array[int],
    origin: wp.array[wp.vec3],
    direction: wp.array[wp.vec3],
    slots: wp.array[int],
    count: int,
    rays: int,
    cosine: wp.array[float],
) -> None:
    """Compute the cosines of individual rays, 0 without a hit."""
    t = thread_index(wp.tid())
    found = wp.float32(0.0)
    if geom[t] >= 0:
        at = world[integer_quotient(t, rays)] * ((count + 31) >> 5) * GROUP_SIZE + geom_row(slots[geom[t]])
        found = _cosine(geoms, at, origin[t], direction[t], distance[t])
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
    if not work or not len(first.distance):
        return jnp.zeros_like(first.distance)
    count = len(first.distance)
    of_fans = isinstance(rays, Fans)
    given = (rays.pos, rays.mat) if of_fans else rays
    lines = (np.asarray(rays.directions, np.float32).reshape(-1, 3),) if of_fans else ()
    numbers = [sum(info.num_geoms for info, _ in work), count, *([len(rays.pos)] if of_fans else [])]
    slots = _slots_of(work)

    def run(geoms: Array, world: Array, *casts: Array) -> Array:
        arrays = [x.reshape(-1, *x.shape[2:]) for x in casts]
        size = len(world) * count
        (found,) = _kernel("fans" if of_fans else "rays")(
            geoms.reshape(-1, 4), world, *arrays, *lines, slots, *numbers, output_dims=size, launch_dims=size
        )
        return found.reshape(len(world), count)

    casts = [first.distance, first.geom_index, *(jnp.asarray(x, jnp.float32) for x in given)]
    return merge_vmaps(run)(pack(work)[None], jnp.zeros(1, jnp.int32), *(x[None] for x in casts))[0]
