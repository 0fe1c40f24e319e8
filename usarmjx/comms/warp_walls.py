"""Wall counting on Warp: one thread per segment loops over the solids of its world.

The functions mirror those of `walls` and `clipping` with the same arithmetic, so that exchanging a segment's
ends changes no bit of the result.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import warp as wp

from usarmjx.base.backend import Array
from usarmjx.base.warp_functions import warp_function
from usarmjx.comms import clipping
from usarmjx.models.compile.ray_geoms import COLUMN_KIND
from usarmjx.sensors.rays.raycast_warp import GROUP_SIZE, geom_row, load_vec4, local, pack, thread_index
from usarmjx.sensors.rays.targets import GeomBlockInfo, Geoms, merge_vmaps
from usarmjx.sensors.rays.warp_kinds import BOX, CAPSULE, CYLINDER, ELLIPSOID, PLANE, SPHERE, TINY, TRIANGLE

wp.set_module_options({"enable_backward": False, "fast_math": True})

SIDE_MARGIN = wp.constant(clipping.SIDE_MARGIN)
COLUMN = wp.constant(COLUMN_KIND)


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
    inside = _positive_interval(-m[2], -h[2])
    bottom = _positive_interval(m[2] + s[0] * m[0] + s[1] * m[1] + s[2], h[2] + s[0] * h[0] + s[1] * h[1])
    inside = _intersection(inside, bottom)
    inside = _intersection(inside, _positive_interval(m[0] + SIDE_MARGIN, h[0]))
    inside = _intersection(inside, _positive_interval(m[1] + SIDE_MARGIN, h[1]))
    inside = _intersection(inside, _positive_interval(1.0 + SIDE_MARGIN - m[0] - m[1], -h[0] - h[1]))
    return inside[0] < inside[1]


@wp.kernel(enable_backward=False, grid_stride=False)
def count_crossings(
    geoms: wp.array[wp.vec4],
    world: wp.array[int],
    start: wp.array[wp.vec3],
    end: wp.array[wp.vec3],
    count: int,
    segments: int,
    crossings: wp.array[int],
) -> None:
    """Count the solids that each segment crosses.

    Pieces of a solid are adjacent; its last piece is followed by another owner or kind.
    """
    t = thread_index(wp.tid())
    # A world has its geoms in groups of 32, the last one padded (`raycast_warp.pack`).
    first = world[t // segments] * ((count + 31) >> 5) * GROUP_SIZE
    middle = (start[t] + end[t]) * 0.5
    half = (end[t] - start[t]) * 0.5
    total = wp.int32(0)
    inside = wp.vec2(-1.0, 1.0)
    met = wp.bool(False)
    index = wp.int32(0)
    while index < count:
        at = first + geom_row(index)
        pos = load_vec4(geoms, at)
        r0 = load_vec4(geoms, at + 32)
        r1 = load_vec4(geoms, at + 64)
        r2 = load_vec4(geoms, at + 96)
        size = load_vec4(geoms, at + 128)
        s = wp.vec3(size[0], size[1], size[2])
        m = local(r0, r1, r2, middle - wp.vec3(pos[0], pos[1], pos[2]))
        h = local(r0, r1, r2, half)
        kind = int(r1[3])
        if kind >= TRIANGLE:  # pieces: triangles and columns
            if kind == TRIANGLE:
                inside = _intersection(inside, _positive_interval(-m[2], -h[2]))
            else:
                met = met or _crosses_column(m, h, s)
            last = index + 1 == count
            if not last:
                after = first + geom_row(index + 1)
                # The fourth number of the first row is the owner, that of the second the kind.
                last = load_vec4(geoms, after + 32)[3] != r0[3] or load_vec4(geoms, after + 64)[3] != r1[3]
            if last:
                if met or (kind == TRIANGLE and inside[0] < inside[1]):
                    total += 1
                inside = wp.vec2(-1.0, 1.0)
                met = False
        elif _crosses(kind, m, h, s):
            total += 1
        index += 1
    # Each thread owns a segment, so nothing is counted atomically and results are the same in every run.
    crossings[t] = total


@warp_function
def _kernel() -> Any:  # noqa: ANN401
    return wp.jax_kernel(count_crossings)


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
    found = merge_vmaps(partial(_count, sum(info.num_geoms for info in infos)))(
        packed[None], jnp.zeros(1, jnp.int32), *ends
    )
    return found.reshape(start.shape[:-1])
