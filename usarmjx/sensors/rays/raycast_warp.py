"""Ray caster on Warp: a warp of threads for each bundle of rays tests a world's geoms front to back.

First each lane computes the distances at which the bundle's cone meets a few geoms. Then every lane tests its
ray against one geom after the other, the nearest first, until the next is farther than the hits of all rays.
On a CPU, in tests, each thread is a bundle of one ray.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp

from usarmjx.sensors.rays import bundles
from usarmjx.sensors.rays.kernels import bounding_box, bounding_radius
from usarmjx.sensors.rays.targets import GeomBlock, GeomBlockInfo
from usarmjx.sensors.rays.warp_kinds import cone_box_distance, cone_sphere_distance, distance_of

wp.set_module_options({"enable_backward": False, "fast_math": True})

KEYS_PER_LANE = 4
"""Geoms whose distances a lane holds during a pass."""
SLOT_BITS = wp.constant(wp.uint32(255))
"""Last bits of a key: index of the geom in the pass. The first bits sort like the distance."""
LAST_KEY = wp.constant(wp.uint32(0xFFFFFFFF))
"""Key after all others."""
BEYOND = wp.constant(wp.uint32(0x7F800000))
"""First key of geoms that the cone misses: the bits of infinity."""
CONE_MARGIN = wp.constant(bundles.CONE_MARGIN)
MIN_SLOPE = wp.constant(bundles.MIN_SLOPE)
MIN_COSINE = wp.constant(bundles.MIN_COSINE)
TINY = wp.constant(1e-12)
GROUP_SIZE = wp.constant(6 * 32)
"""Four-vectors of a group of 32 geoms."""
MAX_BUNDLE = 32
"""Largest bundle: one ray per lane."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return (int)(((blockIdx.z * gridDim.y + blockIdx.y) * gridDim.x + blockIdx.x) * blockDim.x + threadIdx.x);
#else
    return index;
#endif
""")
def thread_index(index: int) -> int:
    """Return `wp.tid()`, passed as `index`, without the 64-bit division by which a GPU computes it.

    Warp spreads more than 2**24 threads over rows of blocks.
    """
    ...


@wp.func_native("return (int)((unsigned)number / (unsigned)size);")
def integer_quotient(number: int, size: int) -> int:
    """Return the quotient of two integers, the first at least 0, by an unsigned division."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return 32;
#else
    return 1;
#endif
""")
def lanes() -> int:
    """Return the threads that work together: a warp's, or one on a CPU."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1) x += __shfl_xor_sync(0xffffffffu, x, step);
#endif
    return x;
""")
def sum_of_lanes(x: float) -> float:
    """Return the sum of a number over all lanes."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1) x = fminf(x, __shfl_xor_sync(0xffffffffu, x, step));
#endif
    return x;
""")
def least_of_lanes(x: float) -> float:
    """Return the smallest of all lanes' numbers."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
#if __CUDA_ARCH__ >= 800
    return __reduce_min_sync(0xffffffffu, x);
#else
    for (int step = 16; step > 0; step >>= 1) {
        const wp::uint32 other = __shfl_xor_sync(0xffffffffu, x, step);
        x = other < x ? other : x;
    }
    return x;
#endif
#else
    return x;
#endif
""")
def least_key_of_lanes(x: wp.uint32) -> wp.uint32:
    """Return the smallest number of all lanes."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __any_sync(0xffffffffu, x) != 0;
#else
    return x;
#endif
""")
def any_lane(x: bool) -> bool:
    """Return whether it is true in any lane."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __ballot_sync(0xffffffffu, x);
#else
    return x ? 1u : 0u;
#endif
""")
def lanes_in_which(x: bool) -> wp.uint32:
    """Return the lanes in which it is true: bit k for lane k."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __ffs((int)lanes) - 1;
#else
    return lanes == 0u ? -1 : 0;
#endif
""")
def first_lane(lanes: wp.uint32) -> int:
    """Return the first of some lanes; -1 without any."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, x, lane);
#else
    return x;
#endif
""")
def from_lane(x: float, lane: int) -> float:
    """Return another lane's number."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    const float4 v = __ldg(reinterpret_cast<const float4*>(values.data) + index);
    return wp::vec_t<4, wp::float32>(v.x, v.y, v.z, v.w);
#else
    return values.data[index];
#endif
""")
def load_vec4(values: wp.array[wp.vec4], index: int) -> wp.vec4:
    """Return a four-vector in one load."""
    ...


@wp.func_native("return reinterpret_cast<wp::uint64>(values.data + index);")
def address_of(values: wp.array[wp.vec4], index: int) -> wp.uint64:
    """Return the address of a row."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    const float4 v = __ldg(reinterpret_cast<const float4*>(geom) + 32 * row);
    return wp::vec_t<4, wp::float32>(v.x, v.y, v.z, v.w);
#else
    return reinterpret_cast<const wp::vec_t<4, wp::float32>*>(geom)[32 * row];
#endif
""")
def row_of(geom: wp.uint64, row: int) -> wp.vec4:
    """Return a row of a geom (see `pack`) in one load, from its address."""
    ...


@wp.struct
class WorldGeoms:
    """Addresses of the geoms of a world: its own, and those of slots in [begin, end), which worlds share."""

    own: wp.uint64
    fixed: wp.uint64
    begin: int
    end: int


@wp.func
def world_geoms(
    own: wp.array[wp.vec4],
    own_world: int,
    fixed: wp.array[wp.vec4],
    fixed_world: int,
    begin: int,
    end: int,
    count: int,
) -> WorldGeoms:
    """Return where the geoms of a world are; `count` of both."""
    world = WorldGeoms()
    # `pack` makes one group of padding of no geoms at all, hence at least 1.
    world.own = address_of(own, own_world * wp.max((count - (end - begin) + 31) >> 5, 1) * GROUP_SIZE)
    world.fixed = address_of(fixed, fixed_world * wp.max((end - begin + 31) >> 5, 1) * GROUP_SIZE)
    world.begin = begin
    world.end = end
    return world


@wp.func
def geom_of(world: WorldGeoms, slot: int) -> wp.uint64:
    """Return the address of the first row of a world's geom."""
    is_fixed = slot >= world.begin and slot < world.end
    # Fixed geoms are missing in the world's own array, so later slots move up.
    index = wp.where(slot >= world.end, slot - (world.end - world.begin), slot)
    index = wp.where(is_fixed, slot - world.begin, index)
    return wp.where(is_fixed, world.fixed, world.own) + wp.uint64(geom_row(index) * 16)


@wp.struct
class WarpCone:
    """As `bundles.Cone`."""

    tip: wp.vec3
    axis: wp.vec3
    tip_radius: float
    slope: float


@wp.func
def cone_about(start: wp.vec3, along: wp.vec3, same_start: bool) -> WarpCone:
    """Return the bounding cone of the rays of all lanes."""
    cone = WarpCone()
    # Surplus lanes count, too, as they repeat a ray of the bundle.
    share = 1.0 / wp.float32(lanes())
    cone.tip = start
    cone.tip_radius = CONE_MARGIN
    if not same_start:
        cone.tip = share * wp.vec3(sum_of_lanes(start[0]), sum_of_lanes(start[1]), sum_of_lanes(start[2]))
        away = start - cone.tip
        # A ball about the mean of the starts holds all of them. The largest by the smallest of the
        # negatives: one reduction serves both.
        cone.tip_radius = CONE_MARGIN + wp.sqrt(-least_of_lanes(-wp.dot(away, away)))
    axis = share * wp.vec3(sum_of_lanes(along[0]), sum_of_lanes(along[1]), sum_of_lanes(along[2]))
    cone.axis = axis / wp.sqrt(wp.max(wp.dot(axis, axis), TINY))
    cosine = least_of_lanes(wp.dot(along, cone.axis))
    slope = wp.sqrt(wp.max(1.0 - cosine * cosine, 0.0)) / wp.max(cosine, MIN_COSINE) + MIN_SLOPE
    cone.slope = wp.where(cosine < MIN_COSINE, -1.0, slope)
    return cone


@wp.func
def geom_row(geom: int) -> int:
    """Return the index of the first row of a world's geom; see `pack`."""
    return (geom >> 5) * GROUP_SIZE + (geom & 31)


@wp.func
def local(r0: wp.vec4, r1: wp.vec4, r2: wp.vec4, v: wp.vec3) -> wp.vec3:
    """Rotate a vector into a geom's frame."""
    return wp.vec3(
        r0[0] * v[0] + r1[0] * v[1] + r2[0] * v[2],
        r0[1] * v[0] + r1[1] * v[1] + r2[1] * v[2],
        r0[2] * v[0] + r1[2] * v[1] + r2[2] * v[2],
    )


if TYPE_CHECKING:
    Keys = wp.vec4ui
else:
    Keys = wp.types.vector(length=KEYS_PER_LANE, dtype=wp.uint32)


@wp.func
def _key(near: float, owner: float, exclude: float, cone: WarpCone, slot: int, number: int) -> wp.uint32:
    """Return a key that sorts like the distance (`SLOT_BITS`); the last key for missing geoms."""
    # Positive floats sort like their bits, so distance and slot are compared as one integer.
    bits = wp.cast(wp.where(cone.slope < 0.0, 0.0, near), wp.uint32) & ~SLOT_BITS
    return wp.where(slot >= number or owner == exclude, LAST_KEY, bits | wp.uint32(slot))


@wp.func
def box_key(at: wp.uint64, cone: WarpCone, exclude: float, slot: int, number: int) -> wp.uint32:
    """Return the key of a geom by its bounding box."""
    pos = row_of(at, 0)
    r0 = row_of(at, 1)
    r1 = row_of(at, 2)
    r2 = row_of(at, 3)
    half = row_of(at, 5)
    tip = local(r0, r1, r2, cone.tip - wp.vec3(pos[0], pos[1], pos[2]))
    axis = local(r0, r1, r2, cone.axis)
    near = cone_box_distance(wp.vec3(half[0], half[1], half[2]), tip, axis, cone.tip_radius, cone.slope)
    return _key(near, r0[3], exclude, cone, slot, number)


@wp.func
def _sphere_key(at: wp.uint64, cone: WarpCone, exclude: float, slot: int, number: int) -> wp.uint32:
    """Return the key of a geom by its bounding sphere."""
    pos = row_of(at, 0)
    r0 = row_of(at, 1)
    away = wp.vec3(pos[0], pos[1], pos[2]) - cone.tip
    near = cone_sphere_distance(away, cone.axis, pos[3], cone.tip_radius, cone.slope)
    return _key(near, r0[3], exclude, cone, slot, number)


@wp.struct
class WarpBest:
    """Nearest hit so far: distance [m] and geom."""

    distance: float
    geom: float


@wp.func
def _first_key(keys: Keys) -> wp.uint32:
    """Return the smallest key of all lanes."""
    mine = LAST_KEY
    for k in range(KEYS_PER_LANE):
        mine = wp.min(mine, keys[k])
    return least_key_of_lanes(mine)


@wp.func
def _next_key(keys: Keys, after: wp.uint32) -> wp.uint32:
    """Return the smallest key of all lanes above a given one."""
    mine = LAST_KEY
    for k in range(KEYS_PER_LANE):
        mine = wp.min(mine, wp.where(keys[k] > after, keys[k], LAST_KEY))
    return least_key_of_lanes(mine)


@wp.func
def nearest_geom(  # noqa: PLR0913 - a struct of them would do no more
    world: WorldGeoms,
    wide: int,
    count: int,
    lane: int,
    start: wp.vec3,
    along: wp.vec3,
    same_start: bool,
    exclude: float,
    reach: float,
) -> WarpBest:
    """Return the first hit of this lane's ray among the geoms of a world."""
    best = WarpBest()
    best.distance = reach
    best.geom = -1.0
    cone = cone_about(start, along, same_start)
    width = lanes()
    begin = wp.int32(0)
    while begin < count:
        # A pass is of one kind of geoms, or lanes of a warp would take different branches.
        end = wp.where(begin < wide, wide, count)
        keys = Keys()
        if begin < wide:
            # Lanes past the end load the last geom; `_key` leaves it out by its slot.
            for k in range(KEYS_PER_LANE):
                slot = k * width + lane
                at = geom_of(world, wp.min(begin + slot, end - 1))
                keys[k] = box_key(at, cone, exclude, slot, end - begin)
        else:
            for k in range(KEYS_PER_LANE):
                slot = k * width + lane
                at = geom_of(world, wp.min(begin + slot, end - 1))
                keys[k] = _sphere_key(at, cone, exclude, slot, end - begin)
        key = _first_key(keys)
        # All lanes stay in the loop until none needs the next geom: the shuffles need the whole warp.
        while key < BEYOND and any_lane(key <= (wp.cast(best.distance, wp.uint32) | SLOT_BITS)):
            at = geom_of(world, begin + wp.int32(key & SLOT_BITS))
            pos = row_of(at, 0)
            r0 = row_of(at, 1)
            r1 = row_of(at, 2)
            r2 = row_of(at, 3)
            s = row_of(at, 4)
            key = _next_key(keys, key)
            away = start - wp.vec3(pos[0], pos[1], pos[2])
            t = distance_of(
                int(r1[3]), local(r0, r1, r2, away), local(r0, r1, r2, along), wp.vec3(s[0], s[1], s[2])
            )
            if t < best.distance:
                best.distance = t
                best.geom = r2[3]
        # At most to the end of this kind: the next pass begins with the first compact geom.
        begin = wp.min(begin + KEYS_PER_LANE * width, end)
    if best.geom < 0.0:
        best.distance = wp.inf
    return best


@wp.kernel(enable_backward=False, grid_stride=False, cuda_max_registers=56)
def cast_fans(  # noqa: PLR0913 - a kernel's arguments are its buffers
    own: wp.array[wp.vec4],
    fixed: wp.array[wp.vec4],
    own_world: wp.array[int],
    fixed_world: wp.array[int],
    exclude: wp.array[int],
    wanted: wp.array[int],
    pos: wp.array[wp.vec3],
    mat: wp.array[wp.mat33],
    lines: wp.array[wp.vec3],
    wide: int,
    begin_fixed: int,
    end_fixed: int,
    count: int,
    rays: int,
    bundles: int,
    bundle: int,
    reach: float,
    fans: int,
    distance: wp.array[float],
    geom: wp.array[int],
) -> None:
    """Cast the rays of fans; a warp per bundle and cast."""
    t = thread_index(wp.tid())
    lane = t & 31
    cast = integer_quotient(t >> 5, bundles)
    begin = ((t >> 5) - cast * bundles) * bundle
    # Surplus lanes repeat the last ray and write the same numbers: they neither diverge nor widen the cone.
    ray = wp.min(begin + lane, wp.min(begin + bundle, rays) - 1)
    best = WarpBest()
    best.distance = wp.inf
    best.geom = -1.0
    if wanted[cast] > 0:
        # Poses of all casts lie one after the other, and those of a cast's fans together.
        fan = cast * fans
        if fans > 1:
            # All fans of a cast have the same number of rays, one fan after the other.
            fan += integer_quotient(ray, integer_quotient(rays, fans))
        world = world_geoms(own, own_world[cast], fixed, fixed_world[cast], begin_fixed, end_fixed, count)
        best = nearest_geom(
            world,
            wide,
            count,
            lane & (lanes() - 1),
            pos[fan],
            mat[fan] * lines[ray],
            fans == 1,
            float(exclude[cast]),
            reach,
        )
    distance[cast * rays + ray] = best.distance
    geom[cast * rays + ray] = int(best.geom)


@wp.kernel(enable_backward=False, grid_stride=False, cuda_max_registers=56)
def cast_rays(  # noqa: PLR0913 - as above
    own: wp.array[wp.vec4],
    fixed: wp.array[wp.vec4],
    own_world: wp.array[int],
    fixed_world: wp.array[int],
    exclude: wp.array[int],
    wanted: wp.array[int],
    origin: wp.array[wp.vec3],
    direction: wp.array[wp.vec3],
    wide: int,
    begin_fixed: int,
    end_fixed: int,
    count: int,
    rays: int,
    bundles: int,
    bundle: int,
    reach: float,
    distance: wp.array[float],
    geom: wp.array[int],
) -> None:
    """Cast individual rays; a warp per bundle and cast. Rays with a zero direction hit nothing."""
    t = thread_index(wp.tid())
    lane = t & 31
    cast = integer_quotient(t >> 5, bundles)
    begin = ((t >> 5) - cast * bundles) * bundle
    ray = cast * rays + wp.min(begin + lane, wp.min(begin + bundle, rays) - 1)
    best = WarpBest()
    best.distance = wp.inf
    best.geom = -1.0
    along = direction[ray]
    # Lanes without a ray stay, with no reach: the shuffles of a warp need all of its lanes.
    aimed = wp.length_sq(along) > 0.0
    if wanted[cast] > 0 and any_lane(aimed):
        world = world_geoms(own, own_world[cast], fixed, fixed_world[cast], begin_fixed, end_fixed, count)
        best = nearest_geom(
            world,
            wide,
            count,
            lane & (lanes() - 1),
            origin[ray],
            along,
            False,
            float(exclude[cast]),
            wp.where(aimed, reach, 0.0),
        )
    distance[ray] = best.distance
    geom[ray] = int(best.geom)


@wp.kernel(enable_backward=False, grid_stride=False, cuda_max_registers=56)
def cast_single_rays(  # noqa: PLR0913 - as above
    own: wp.array[wp.vec4],
    fixed: wp.array[wp.vec4],
    own_world: wp.array[int],
    fixed_world: wp.array[int],
    exclude: wp.array[int],
    wanted: wp.array[int],
    origin: wp.array[wp.vec3],
    direction: wp.array[wp.vec3],
    wide: int,
    begin_fixed: int,
    end_fixed: int,
    count: int,
    rays: int,
    reach: float,
    distance: wp.array[float],
    geom: wp.array[int],
) -> None:
    """Cast rays that have nothing in common; a warp per cast takes one after the other, as `cast_rays`."""
    t = thread_index(wp.tid())
    cast = t >> 5
    lane = t & 31
    world = world_geoms(own, own_world[cast], fixed, fixed_world[cast], begin_fixed, end_fixed, count)
    # On a CPU each lane is a thread of its own, and takes only the rays that it keeps.
    step = wp.where(lanes() == 1, 32, 1)
    begin = wp.int32(0)
    while begin < rays:
        kept = WarpBest()
        kept.distance = wp.inf
        kept.geom = -1.0
        i = begin + wp.where(lanes() == 1, lane, 0)
        end = wp.min(begin + 32, rays)
        while i < end and wanted[cast] > 0:
            along = direction[cast * rays + i]
            if wp.length_sq(along) > 0.0:
                best = nearest_geom(
                    world,
                    wide,
                    count,
                    lane & (lanes() - 1),
                    origin[cast * rays + i],
                    along,
                    True,
                    float(exclude[cast]),
                    reach,
                )
                # All lanes cast each ray together; each keeps its own, so that writes go side by side.
                if i - begin == lane:
                    kept = best
            i += step
        if begin + lane < rays:
            distance[cast * rays + begin + lane] = kept.distance
            geom[cast * rays + begin + lane] = int(kept.geom)
        begin += 32


def pack(blocks: Sequence[tuple[GeomBlockInfo, GeomBlock]]) -> jax.Array:
    """Return a world's geoms packed for the kernels: four-vectors, in groups of 32 geoms.

    Each geom has (6, 4): position and bounding radius, which is 0 if the bounding box is to be used; the rows
    of the orientation, each with one more value: owner, type, index; size; half lengths of the box.

    Returns:
        (groups, 6, 32, 4); the last group is padded with zeros.
    """
    geoms = jnp.concatenate([_packed(info, block) for info, block in blocks], 1)
    # Groups of 32: the lanes of a warp load the same row of neighbouring geoms at once.
    whole = jnp.pad(geoms, ((0, 0), (0, -geoms.shape[1] % 32), (0, 0)))  # pyright: ignore[reportUnknownMemberType] - jnp.pad is half typed
    return whole.reshape(6, -1, 32, 4).swapaxes(0, 1)


def _packed(info: GeomBlockInfo, block: GeomBlock) -> jax.Array:
    none, size = np.zeros(info.num_geoms, np.float32), tuple(block.size.T)
    # Owners, kinds and indices are whole numbers below 2**24, exact in float32.
    radius = bounding_radius(info.kind, size) if info.compact else none
    middle, half = bounding_box(info.kind, size)
    # A box about another point than the geom's position, as a triangle's, gives way to the sphere's.
    half = jnp.stack(half if middle is None else [bounding_radius(info.kind, size)] * 3, -1)
    place = info.first_index + np.arange(info.num_geoms)
    rows = (block.pos, *(block.mat[:, i] for i in range(3)), block.size, half)
    last = (radius, block.owner, none + info.kind, place, none, none)
    single = [
        (jnp.asarray(a, jnp.float32), jnp.asarray(b, jnp.float32)[:, None])
        for a, b in zip(rows, last, strict=True)
    ]
    return jnp.stack([jnp.concatenate(pair, -1) for pair in single])


def apart(
    work: Sequence[tuple[GeomBlockInfo, GeomBlock]],
) -> tuple[tuple[jax.Array, jax.Array], tuple[int, int]]:
    """Return a world's geoms packed, its own and the fixed ones, and first and last slot of these plus one.

    Args:
        work: The geoms; fixed ones one after the other.

    Returns:
        Each (1, groups, 6, 32, 4), see `pack`; one group of zeros for none.
    """
    parts = [[part for part in work if part[0].fixed == fixed] for fixed in (False, True)]
    begin = end = 0
    for info, _ in work:
        if info.fixed:
            break
        begin += info.num_geoms
    end = begin + sum(info.num_geoms for info, _ in parts[1])
    # Kernels take no empty arrays.
    none = jnp.zeros((1, 6, 32, 4), jnp.float32)
    own, fixed = ((pack(part) if part else none)[None] for part in parts)
    return (own, fixed), (begin, end)
