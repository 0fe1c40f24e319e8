"""Wall counting on Warp: one thread per segment loops over the solids of its world.

From above, a solid lies within a circle. A thread first lists the circles that its segment comes near, by a
few operations each, and then tests only the solids on its list. Pieces of meshes and terrain have no list:
a segment is tested against each.

The functions mirror those of `walls` and `clipping` with the same arithmetic, so that exchanging a segment's
ends changes no bit of the result.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp

from usarmjx.base.backend import Array
from usarmjx.base.warp_functions import warp_function
from usarmjx.comms import clipping
from usarmjx.comms.clipping import PIECE_KINDS
from usarmjx.sensors.rays.kernels import bounding_radius
from usarmjx.sensors.rays.raycast_warp import integer_quotient, load_vec4, local, thread_index
from usarmjx.sensors.rays.targets import GeomBlock, Geoms, merge_vmaps
from usarmjx.sensors.rays.warp_kinds import BOX, CAPSULE, CYLINDER, ELLIPSOID, PLANE, SPHERE, TINY, TRIANGLE

wp.set_module_options({"enable_backward": False, "fast_math": True})

ROWS = wp.constant(7)
"""Four-vectors of a geom."""
GROUP = wp.constant(32)
"""Geoms that a thread tests at once; a world's are padded to whole groups."""
SLACK = 0.01
"""Rounding error of a distance from a segment, above that of 40 km [m]."""
SIDE_MARGIN = wp.constant(clipping.SIDE_MARGIN)


@wp.func
def _crosses_plane(m: wp.vec3, h: wp.vec3, s: wp.vec3) -> bool:
    t = -m[2] / wp.where(h[2] == 0.0, 1.0, h[2])
    crossed = wp.abs(m[2]) < wp.abs(h[2])
    crossed = crossed and (s[0] <= 0.0 or wp.abs(m[0] + t * h[0]) < s[0])
    return crossed and (s[1] <= 0.0 or wp.abs(m[1] + t * h[1]) < s[1])


@wp.func
def _separates(mj: float, mk: float, hj: float, hk: float, sj: float, sk: float) -> bool:
    """Whether the cross product of a box axis and the segment separates them."""
    room = sj * wp.abs(hk) + sk * wp.abs(hj)
    return wp.abs(mj * hk - mk * hj) >= room and room != 0.0


@wp.func
def _crosses_box(m: wp.vec3, h: wp.vec3, s: wp.vec3) -> bool:
    apart = wp.abs(m[0]) >= s[0] + wp.abs(h[0])
    apart = apart or wp.abs(m[1]) >= s[1] + wp.abs(h[1])
    apart = apart or wp.abs(m[2]) >= s[2] + wp.abs(h[2])
    apart = apart or _separates(m[1], m[2], h[1], h[2], s[1], s[2])
    apart = apart or _separates(m[2], m[0], h[2], h[0], s[2], s[0])
    return not (apart or _separates(m[0], m[1], h[0], h[1], s[0], s[1]))


@wp.func
def _nearest_squared(m: wp.vec3, h: wp.vec3) -> float:
    t = wp.clamp(-wp.dot(m, h) / wp.max(wp.dot(h, h), TINY), -1.0, 1.0)
    at = m + t * h
    return wp.dot(at, at)


@wp.func
def _crosses_cylinder(m: wp.vec3, h: wp.vec3, s: wp.vec3) -> bool:
    slope = wp.where(wp.abs(h[2]) < TINY, TINY, h[2])
    centre = -m[2] / slope
    width = s[1] / wp.abs(slope)
    low = wp.clamp(centre - width, -1.0, 1.0)
    high = wp.clamp(centre + width, -1.0, 1.0)
    # Nearest to the axis on the part of the segment, which goes from -1 to 1, between the planes of the caps.
    t = wp.clamp(-(m[0] * h[0] + m[1] * h[1]) / wp.max(h[0] * h[0] + h[1] * h[1], TINY), low, high)
    x = m[0] + t * h[0]
    y = m[1] + t * h[1]
    return wp.abs(m[2]) < s[1] + wp.abs(h[2]) and x * x + y * y < s[0] * s[0]


@wp.func
def _crosses_capsule(m: wp.vec3, h: wp.vec3, s: wp.vec3) -> bool:
    square = s[0] * s[0]
    end = wp.vec3(0.0, 0.0, s[1])
    in_ball = _nearest_squared(m - end, h) < square or _nearest_squared(m + end, h) < square
    return in_ball or _crosses_cylinder(m, h, s)


@wp.func
def _crosses(kind: int, m: wp.vec3, h: wp.vec3, s: wp.vec3) -> bool:
    """Whether a segment crosses the interior of a solid of one geom."""
    crossed = wp.bool(False)
    if kind == BOX:
        crossed = _crosses_box(m, h, s)
    elif kind == PLANE:
        crossed = _crosses_plane(m, h, s)
    elif kind == CYLINDER:
        crossed = _crosses_cylinder(m, h, s)
    elif kind == SPHERE:
        crossed = _nearest_squared(m, h) < s[0] * s[0]
    elif kind == CAPSULE:
        crossed = _crosses_capsule(m, h, s)
    elif kind == ELLIPSOID:
        crossed = _nearest_squared(wp.cw_div(m, s), wp.cw_div(h, s)) < 1.0
    return crossed


@wp.func
def _positive_interval(start: float, slope: float) -> wp.vec2:
    t = -start / wp.where(slope == 0.0, 1.0, slope)
    low = wp.where(slope > 0.0, wp.max(t, -1.0), -1.0)
    high = wp.where(slope < 0.0, wp.min(t, 1.0), 1.0)
    return wp.where(slope == 0.0 and start <= 0.0, wp.vec2(1.0, -1.0), wp.vec2(low, high))


@wp.func
def _intersection(one: wp.vec2, other: wp.vec2) -> wp.vec2:
    return wp.vec2(wp.max(one[0], other[0]), wp.min(one[1], other[1]))


@wp.func
def _crosses_column(m: wp.vec3, h: wp.vec3, s: wp.vec3) -> bool:
    # Below the triangle z = 0, above the plane of the bottom, and within the three sides.
    inside = _positive_interval(-m[2], -h[2])
    bottom = _positive_interval(m[2] + s[0] * m[0] + s[1] * m[1] + s[2], h[2] + s[0] * h[0] + s[1] * h[1])
    inside = _intersection(inside, bottom)
    inside = _intersection(inside, _positive_interval(m[0] + SIDE_MARGIN, h[0]))
    inside = _intersection(inside, _positive_interval(m[1] + SIDE_MARGIN, h[1]))
    inside = _intersection(inside, _positive_interval(1.0 + SIDE_MARGIN - m[0] - m[1], -h[0] - h[1]))
    return inside[0] < inside[1]


@wp.func_native("""
    const float* rows = reinterpret_cast<const float*>(geoms.data + first);
    const float away = along[1] * middle[0] - along[0] * middle[1];
    const float before = along[0] * middle[0] + along[1] * middle[1];
    wp::uint32 near = 0u;
    for (int begin = 0; begin < count && begin < 32; begin += 8) {
        wp::uint32 some = 0u;
        #pragma unroll
        for (int k = 0; k < 8; ++k) {
#if defined(__CUDA_ARCH__)
            const float4 v = __ldg(reinterpret_cast<const float4*>(rows) + begin + k);
            const float x = v.x, y = v.y, reach = v.z;
#else
            const float* v = rows + 4 * (begin + k);
            const float x = v[0], y = v[1], reach = v[2];
#endif
            const float across = fabsf(x * along[1] - (y * along[0] + away));
            const float ahead = fabsf(x * along[0] + (y * along[1] - before)) - length;
            if ((across < reach) & (ahead < reach)) some |= 1u << k;
        }
        near |= some << begin;
    }
    return near;
""")
def near_geoms(
    geoms: wp.array[wp.vec4], first: int, count: int, middle: wp.vec3, along: wp.vec2, length: float
) -> wp.uint32:
    """Return which of a group's geoms a segment may cross, seen from above: bit k for geom k.

    Args:
        geoms: See `pack_solids`.
        first: First row of the group.
        count: Geoms in the group and those after it.
        middle: The segment's midpoint [m].
        along: Its horizontal direction, a unit vector.
        length: Half of its horizontal length [m].
    """
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __ffs((int)bits) - 1;
#else
    return __builtin_ctz(bits);
#endif
""")
def lowest_bit(bits: wp.uint32) -> int:
    """Return the place of the lowest bit that is set; there is one."""
    ...


@wp.func
def _crosses_geom(geoms: wp.array[wp.vec4], at: int, stride: int, middle: wp.vec3, half: wp.vec3) -> bool:
    """Whether a segment crosses the geom whose first row is `at`, which is no piece."""
    place = load_vec4(geoms, at + stride)
    offset = middle - wp.vec3(place[0], place[1], place[2])
    crossed = wp.bool(False)
    # Most walls are upright boxes, for which these rows are enough; all others have a height of -1.
    if place[3] >= 0.0:
        turn = load_vec4(geoms, at + 2 * stride)
        m = wp.vec3(
            turn[2] * offset[0] + turn[3] * offset[1], turn[2] * offset[1] - turn[3] * offset[0], offset[2]
        )
        h = wp.vec3(turn[2] * half[0] + turn[3] * half[1], turn[2] * half[1] - turn[3] * half[0], half[2])
        crossed = _crosses_box(m, h, wp.vec3(turn[0], turn[1], place[3]))
    else:
        r0 = load_vec4(geoms, at + 3 * stride)
        r1 = load_vec4(geoms, at + 4 * stride)
        r2 = load_vec4(geoms, at + 5 * stride)
        size = load_vec4(geoms, at + 6 * stride)
        s = wp.vec3(size[0], size[1], size[2])
        crossed = _crosses(int(r1[3]), local(r0, r1, r2, offset), local(r0, r1, r2, half), s)
    return crossed


@wp.func
def _count_wholes(
    geoms: wp.array[wp.vec4], first: int, stride: int, count: int, middle: wp.vec3, half: wp.vec3
) -> int:
    """Return how many geoms that are no pieces a segment crosses."""
    along = wp.vec2(half[0], half[1])
    length = wp.length(along)
    # A vertical segment has no horizontal direction: as its length is 0, any will do.
    along = wp.where(length > TINY, along / wp.max(length, TINY), wp.vec2(1.0, 0.0))
    total = wp.int32(0)
    begin = wp.int32(0)
    while begin < count:
        # The geoms near a segment are few, but others for each thread: each goes through a list of its own,
        # as the threads of a warp would wait for each other at every geom of any of them.
        near = wp.uint32(0)
        second = wp.uint32(0)
        third = wp.uint32(0)
        fourth = wp.uint32(0)
        # Four groups at a time, from the last to the first: their bits are shifted along and `near` has the
        # first's.
        group = wp.min((count - begin + 31) >> 5, 4)
        at = first + begin + group * GROUP
        while group > 0:
            group -= 1
            at -= GROUP
            fourth = third
            third = second
            second = near
            near = near_geoms(geoms, at, count - begin - GROUP * group, middle, along, length)
        while (near | second | third | fourth) != wp.uint32(0):
            if near == wp.uint32(0):
                near = second
                second = third
                third = fourth
                fourth = wp.uint32(0)
                at += GROUP
            if near != wp.uint32(0):
                geom = lowest_bit(near)
                near = near & (near - wp.uint32(1))
                if _crosses_geom(geoms, at + geom, stride, middle, half):
                    total += 1
        begin += 128
    return total


@wp.func
def _count_in_pieces(
    geoms: wp.array[wp.vec4],
    first: int,
    stride: int,
    begin: int,
    count: int,
    middle: wp.vec3,
    half: wp.vec3,
) -> int:
    """Return how many solids that consist of pieces a segment crosses.

    Pieces of a solid are adjacent; its last piece is followed by another owner or kind.
    """
    total = wp.int32(0)
    inside = wp.vec2(-1.0, 1.0)
    met = wp.bool(False)
    index = begin
    while index < count:
        at = first + index
        pos = load_vec4(geoms, at + stride)
        r0 = load_vec4(geoms, at + 3 * stride)
        r1 = load_vec4(geoms, at + 4 * stride)
        r2 = load_vec4(geoms, at + 5 * stride)
        size = load_vec4(geoms, at + 6 * stride)
        m = local(r0, r1, r2, middle - wp.vec3(pos[0], pos[1], pos[2]))
        h = local(r0, r1, r2, half)
        kind = int(r1[3])
        if kind == TRIANGLE:
            inside = _intersection(inside, _positive_interval(-m[2], -h[2]))
        else:
            met = met or _crosses_column(m, h, wp.vec3(size[0], size[1], size[2]))
        last = index + 1 == count
        if not last:
            # The fourth number of the first row is the owner, that of the second the kind.
            last = load_vec4(geoms, at + 1 + 3 * stride)[3] != r0[3]
            last = last or load_vec4(geoms, at + 1 + 4 * stride)[3] != r1[3]
        if last:
            if met or (kind == TRIANGLE and inside[0] < inside[1]):
                total += 1
            inside = wp.vec2(-1.0, 1.0)
            met = False
        index += 1
    return total


@wp.kernel(enable_backward=False, grid_stride=False)
def count_crossings(
    geoms: wp.array[wp.vec4],
    world: wp.array[int],
    start: wp.array[wp.vec3],
    end: wp.array[wp.vec3],
    wholes: int,
    count: int,
    segments: int,
    crossings: wp.array[int],
) -> None:
    """Count the solids that each segment crosses; the first `wholes` of a world's geoms are no pieces."""
    t = thread_index(wp.tid())
    # The padding of `pack_solids`: GROUP is a power of two.
    stride = (count + GROUP - 1) & ~(GROUP - 1)
    first = world[integer_quotient(t, segments)] * ROWS * stride
    middle = (start[t] + end[t]) * 0.5
    half = (end[t] - start[t]) * 0.5
    total = _count_wholes(geoms, first, stride, wholes, middle, half)
    # Each thread owns a segment, so nothing is counted atomically and results are the same in every run.
    crossings[t] = total + _count_in_pieces(geoms, first, stride, wholes, count, middle, half)


def pack_solids(geoms: Geoms) -> tuple[jax.Array, int, int]:
    """Return a world's solids packed for the kernel, and how many geoms are no pieces and how many there are.

    Each geom has (7, 4): horizontal position and reach from above (-inf for pieces, which no list has), 0;
    position and half height of an upright box, -1 for other geoms; half length and half width of that box,
    cosine and sine of its yaw; the rows of the orientation with owner, kind and 0; size, 0.

    Returns:
        (7, geoms, 4), pieces last, padded to whole groups; and the two counts.
    """
    # Pieces last: the kernel takes them in a loop of its own.
    pairs = sorted(zip(geoms.kinds, geoms.blocks, strict=True), key=lambda pair: pair[0] in PIECE_KINDS)
    parts = [_packed(kind, block) for kind, block in pairs]
    wholes = sum(len(block.owner) for kind, block in pairs if kind not in PIECE_KINDS)
    count = sum(len(block.owner) for _, block in pairs)
    padding = np.zeros((ROWS, -count % GROUP, 4), np.float32)
    padding[0, :, 2] = -np.inf
    # A row of all geoms after the other: what XLA would have to transpose is copied in every step.
    return jnp.concatenate([*parts, padding], 1), wholes, count


def _packed(kind: int, block: GeomBlock) -> jax.Array:
    """Return geoms of one kind as rows (7, geoms, 4)."""
    count, mat, size = len(block.owner), jnp.asarray(block.mat), jnp.asarray(block.size)
    none = np.zeros(count, np.float32)
    upright = jnp.zeros(count, bool)
    if kind in PIECE_KINDS:
        reach = none - np.float32(np.inf)
    elif kind == PLANE:
        # Unbounded: every segment is near it.
        reach = none + np.float32(np.inf)
    else:
        reach = jnp.asarray(bounding_radius(kind, tuple(size.T)))
    if kind == BOX:
        # Without a tolerance: a box with the least tilt goes through the general test.
        level = (mat[:, 0, 0] == mat[:, 1, 1]) & (mat[:, 1, 0] == -mat[:, 0, 1]) & (mat[:, 2, 2] == 1)
        upright = level & (mat[:, 2, :2] == 0).all(-1) & (mat[:, :2, 2] == 0).all(-1)
        # The circle around its base, which is smaller than that around its bounding sphere.
        reach = jnp.where(upright, jnp.hypot(size[:, 0], size[:, 1]), reach)
    x, y, z = jnp.asarray(block.pos).T
    rows = (
        (x, y, reach + SLACK, none),
        (x, y, z, jnp.where(upright, size[:, 2], -1.0)),
        (size[:, 0], size[:, 1], mat[:, 0, 0], mat[:, 1, 0]),
        *((*mat[:, i].T, last) for i, last in enumerate((block.owner, none + kind, none))),
        (*size.T, none),
    )
    return jnp.stack([jnp.stack([jnp.asarray(x, jnp.float32) for x in row], -1) for row in rows])


@warp_function
def _kernel() -> Any:  # noqa: ANN401
    return wp.jax_kernel(count_crossings)


def _count(wholes: int, count: int, geoms: Array, world: Array, start: Array, end: Array) -> jax.Array:
    shape = start.shape[:2]
    ends = [x.reshape(-1, 3) for x in (start, end)]
    threads = shape[0] * shape[1]
    found = _kernel()(
        geoms.reshape(-1, 4), world, *ends, wholes, count, shape[1], output_dims=threads, launch_dims=threads
    )
    return found[0].reshape(shape)


def count_on_warp(geoms: Geoms, start: Array, end: Array) -> jax.Array:
    """As `walls.count_walls`; any axes before those of the vectors' components."""
    packed, wholes, count = pack_solids(geoms)
    ends = [jnp.asarray(x, jnp.float32).reshape(1, -1, 3) for x in (start, end)]
    found = merge_vmaps(partial(_count, wholes, count))(packed[None], jnp.zeros(1, jnp.int32), *ends)
    return found.reshape(start.shape[:-1])
