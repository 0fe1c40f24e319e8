"""Fans of which only the nearest hit counts, on Warp: the fans of a robot one after the other, in one warp.

The warp first lists the geoms in reach of the robot by shells about it, the nearest shell first. For each
fan its lanes then compute the distances at which the fan's cone meets a row of the list, and test the rays
against one geom after the other, the nearest first, until the next is farther than the first hit that counts.
On a CPU, in tests, each thread is a ray of its own in each fan.
"""

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from usarmjx.sensors.rays import bundles
from usarmjx.sensors.rays.kernels import TINY
from usarmjx.sensors.rays.raycast_warp import (
    BEYOND,
    LAST_KEY,
    SLOT_BITS,
    WarpBest,
    WarpCone,
    WorldGeoms,
    any_lane,
    box_key,
    geom_of,
    lanes,
    lanes_in_which,
    least_key_of_lanes,
    local,
    row_of,
    thread_index,
    world_geoms,
)
from usarmjx.sensors.rays.warp_kinds import distance_of, normal_of

wp.set_module_options({"enable_backward": False, "fast_math": True})

BLOCK_DIM = 64
"""Threads of a block."""
MOST_GEOMS = 256
"""Geoms of a world that a warp holds in shared memory."""
CONE_MARGIN = wp.constant(bundles.CONE_MARGIN)
INNER_SHELL, MIDDLE_SHELL = wp.constant(0.15), wp.constant(0.35)
"""Radii of the shells as shares of the reach (chosen)."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __popc(votes);
#else
    return (int)votes;
#endif
""")
def _count(votes: wp.uint32) -> int: ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __popc(votes & ((1u << (threadIdx.x & 31u)) - 1u));
#else
    return 0;
#endif
""")
def _count_before(votes: wp.uint32) -> int: ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __syncwarp();
#endif
""")
def _wait_for_lanes() -> None: ...


def _shared_code(kind: str, value: str) -> str:
    """Return code that writes a value to a warp's list in shared memory, or, if it is negative, reads one.

    One function does both, so that both know one array.
    """
    return f"""
#if defined(__CUDA_ARCH__)
    __shared__ {kind} listed[{BLOCK_DIM // 32}][{MOST_GEOMS}];
    {kind}* const mine = listed[threadIdx.x >> 5];
    if ({value} >= 0) mine[place] = {value};
    return {value} >= 0 ? {value} : mine[place];
#else
    return {value};
#endif
"""


@wp.func_native(_shared_code("int", "geom"))
def _shared_list(place: int, geom: int) -> int: ...


@wp.func_native(_shared_code("float", "gap"))
def _shared_gaps(place: int, gap: float) -> float: ...


if TYPE_CHECKING:
    OwnGaps = wp.vec4
    OwnList = wp.vec4i
else:
    OwnGaps = wp.types.vector(length=MOST_GEOMS, dtype=wp.float32)
    OwnList = wp.types.vector(length=MOST_GEOMS, dtype=wp.int32)


@wp.func
def _gap(at: wp.uint64, point: wp.vec3, exclude: float) -> float:
    """Return the distance of a point from a geom's bounding box, infinite for an excluded geom [m]."""
    pos = row_of(at, 0)
    r0 = row_of(at, 1)
    r1 = row_of(at, 2)
    r2 = row_of(at, 3)
    half = row_of(at, 5)
    away = local(r0, r1, r2, point - wp.vec3(pos[0], pos[1], pos[2]))
    x = wp.max(wp.abs(away[0]) - half[0], 0.0)
    y = wp.max(wp.abs(away[1]) - half[1], 0.0)
    z = wp.max(wp.abs(away[2]) - half[2], 0.0)
    return wp.where(r0[3] == exclude, wp.inf, wp.sqrt(x * x + y * y + z * z))


@wp.func
def _limit(distance: float, counts: bool) -> wp.uint32:
    """Return the bits of the distance beyond which no hit matters: the nearest that counts, or the last."""
    nearest = least_key_of_lanes(wp.cast(wp.where(counts, distance, wp.inf), wp.uint32))
    # The largest is the complement of the smallest complement: there is only one reduction.
    farthest = ~least_key_of_lanes(~wp.cast(distance, wp.uint32))
    return wp.min(nearest, farthest)


@wp.func
def _cosine(kind: int, start: wp.vec3, along: wp.vec3, t: float, size: wp.vec3) -> float:
    return wp.abs(wp.dot(normal_of(kind, start + t * along, size), along))


@wp.func
def _miss_all(at: int, rays: int, lane: int, distance: wp.array[float], geom: wp.array[int]) -> None:
    """Write misses of all rays of a cast."""
    i = wp.int32(lane)
    while i < rays:
        distance[at + i] = wp.inf
        geom[at + i] = -1
        i += 32


@wp.struct
class _NearGeoms:
    """List of the geoms in reach, in shared memory or on a CPU `own`; ends of the first shells, and of all.

    Radii of the first shells are `inner` and `middle`, about the point from which tips are at most `spread`.
    """

    own: OwnList
    inner_end: int
    middle_end: int
    end: int
    spread: float
    inner: float
    middle: float


@wp.func
def _listed(near: _NearGeoms, place: int) -> int:
    """Return a geom of the list."""
    geom = wp.int32(0)
    if lanes() == 1:  # noqa: SIM108 - Warp would compute both
        geom = near.own[place]
    else:
        geom = _shared_list(place, -1)
    return geom


@wp.func
def _list_near_geoms(
    world: WorldGeoms,
    count: int,
    center: wp.vec3,
    spread: float,
    reach: float,
    exclude: float,
    column: int,
) -> _NearGeoms:
    """List the geoms of a world within a distance of tips, one shell after the other."""
    near = _NearGeoms()
    near.spread = spread
    near.inner = spread + INNER_SHELL * reach
    near.middle = spread + MIDDLE_SHELL * reach
    width = lanes()
    gaps = OwnGaps()  # pyright: ignore[reportCallIssue] - zeros
    begin = wp.int32(0)
    while begin < count:
        slot = begin + column
        # Lanes past the end read the last geom: a vote needs every lane of the warp.
        gap = _gap(geom_of(world, wp.min(slot, count - 1)), center, exclude)
        if width == 1:
            gaps[slot] = gap
        else:
            # The copies of the last geom past the end are in no shell.
            _shared_gaps(slot, wp.where(slot < count, gap, wp.inf))
        begin += width
    listed = OwnList()
    end = wp.int32(0)
    # Coarse shells instead of sorting: near geoms are tested first, and shorten the rays.
    for shell in range(3):
        low = wp.where(shell == 0, -1.0, wp.where(shell == 1, near.inner, near.middle))
        high = wp.where(shell == 0, near.inner, wp.where(shell == 1, near.middle, spread + reach))
        begin = wp.int32(0)
        while begin < count:
            slot = begin + column
            gap = wp.float32(0.0)
            if width == 1:  # noqa: SIM108 - as above
                gap = gaps[slot]
            else:
                gap = _shared_gaps(slot, -1.0)
            here = gap > low and gap <= high
            votes = lanes_in_which(here)
            if here:
                if width == 1:
                    listed[end] = slot
                else:
                    _shared_list(end + _count_before(votes), slot)
            end += _count(votes)
            begin += width
        if shell == 0:
            near.inner_end = end
        if shell == 1:
            near.middle_end = end
    # Used on a CPU only, where each thread has its own list.
    near.own = listed
    near.end = end
    # Each lane reads what others have listed.
    _wait_for_lanes()
    return near


@wp.func
def _first_of_fan(  # noqa: PLR0913 - a struct of them would do no more
    world: WorldGeoms,
    near: _NearGeoms,
    cone: WarpCone,
    along: wp.vec3,
    reach: float,
    least: float,
    exclude: float,
    column: int,
) -> WarpBest:
    """Return the first hit of this lane's ray, a miss if it does not count, up to the fan's first."""
    best = WarpBest()
    best.distance = reach
    best.geom = -1.0
    counts = bool(False)  # noqa: UP018 - Warp's variable, not a constant
    limit = wp.cast(reach, wp.uint32)
    assured = wp.uint32(LAST_KEY)
    row = wp.int32(0)
    while row < near.end:
        low = wp.where(row >= near.middle_end, near.middle, wp.where(row >= near.inner_end, near.inner, 0.0))
        # Everything from here on is in shells farther than any hit that still matters.
        if wp.cast(wp.max(low - near.spread, 0.0), wp.uint32) > limit:
            row = near.end
        else:
            at = geom_of(world, _listed(near, wp.min(row + column, near.end - 1)))
            mine = box_key(at, cone, exclude, column, near.end - row)
            key = least_key_of_lanes(mine)
            # Slot bits are set in the limit, as a key's own would otherwise push an equal distance beyond it.
            while key < BEYOND and key <= (limit | SLOT_BITS):
                at = geom_of(world, _listed(near, row + wp.int32(key & SLOT_BITS)))
                p = row_of(at, 0)
                r0 = row_of(at, 1)
                r1 = row_of(at, 2)
                r2 = row_of(at, 3)
                s = row_of(at, 4)
                key = least_key_of_lanes(wp.where(mine > key, mine, LAST_KEY))
                size = wp.vec3(s[0], s[1], s[2])
                there = local(r0, r1, r2, cone.tip - wp.vec3(p[0], p[1], p[2]))
                way = local(r0, r1, r2, along)
                far = distance_of(int(r1[3]), there, way, size)
                closer = far < best.distance
                if closer:
                    best.distance = far
                    best.geom = r2[3]
                    counts = _cosine(int(r1[3]), there, way, far, size) >= least
                if any_lane(closer):
                    limit = _limit(best.distance, counts)
            row += lanes()
        assured = wp.min(assured, limit)
        # A hit that hides the first one without counting itself lets geoms matter that were too far before.
        if row >= near.end and limit > assured:
            row = wp.int32(0)
            assured = wp.uint32(LAST_KEY)
    # A geom that hides the ray without counting leaves a miss, not the geom behind it.
    if not counts:
        best.distance = wp.inf
        best.geom = -1.0
    return best


@wp.kernel(enable_backward=False, grid_stride=False, cuda_max_registers=64)
def cast_first_of_fans(  # noqa: PLR0913 - a kernel's arguments are its buffers
    own: wp.array[wp.vec4],
    fixed: wp.array[wp.vec4],
    own_world: wp.array[int],
    fixed_world: wp.array[int],
    exclude: wp.array[int],
    wanted: wp.array[int],
    pos: wp.array[wp.vec3],
    mat: wp.array[wp.mat33],
    lines: wp.array[wp.vec3],
    cones: wp.array[wp.vec4],
    least: wp.array[float],
    begin_fixed: int,
    end_fixed: int,
    count: int,
    fans: int,
    per_fan: int,
    reach: float,
    distance: wp.array[float],
    geom: wp.array[int],
) -> None:
    """Cast the rays of fans; a warp per cast. Hits beyond a fan's first that counts may be missing."""
    t = thread_index(wp.tid())
    cast = t >> 5
    lane = t & 31
    # 0 on a CPU, where a thread works on its own and sees no other lanes.
    column = lane & (lanes() - 1)
    # Surplus lanes repeat the last ray: votes need all of them, and equal writes do no harm.
    ray = wp.min(lane, per_fan - 1)
    if wanted[cast] <= 0:
        _miss_all(cast * fans * per_fan, fans * per_fan, lane, distance, geom)
        return
    world = world_geoms(own, own_world[cast], fixed, fixed_world[cast], begin_fixed, end_fixed, count)
    other = float(exclude[cast])
    # One list for all fans of a cast, about the middle of their tips: `spread` widens its shells.
    center = wp.vec3(0.0, 0.0, 0.0)
    for fan in range(fans):
        center += pos[cast * fans + fan] / float(fans)
    spread = wp.float32(0.0)
    for fan in range(fans):
        spread = wp.max(spread, wp.length(pos[cast * fans + fan] - center))
    near = _list_near_geoms(world, count, center, spread + CONE_MARGIN, reach, other, column)
    for fan in range(fans):
        turn = mat[cast * fans + fan]
        shape = cones[fan]
        cone = WarpCone()
        cone.tip = pos[cast * fans + fan]
        cone.axis = turn * wp.vec3(shape[0], shape[1], shape[2])
        cone.tip_radius = CONE_MARGIN
        cone.slope = shape[3]
        along = turn * lines[fan * per_fan + ray]
        best = _first_of_fan(world, near, cone, along, reach, least[fan], other, column)
        distance[(cast * fans + fan) * per_fan + ray] = best.distance
        geom[(cast * fans + fan) * per_fan + ray] = int(best.geom)


def cones_of(directions: np.ndarray) -> np.ndarray:
    """Return the bounding cones of fans (fans, rays, 3) from one point each: axis and slope (fans, 4)."""
    # As `bundles.bounding_cones`, but on the host: directions on the mount never change.
    axis = directions.mean(1)
    axis /= np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), TINY)
    cosine = np.min((directions * axis[:, None]).sum(-1), -1)
    slope = np.sqrt(np.maximum(1 - cosine**2, 0)) / np.maximum(cosine, bundles.MIN_COSINE) + bundles.MIN_SLOPE
    return np.column_stack([axis, np.where(cosine < bundles.MIN_COSINE, -1, slope)]).astype(np.float32)
