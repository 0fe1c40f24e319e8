"""Ray caster for CPUs: a few casts at a time, each bundle against the geoms near it, front to back.

However many robots and worlds there are, one loop handles the wanted casts. For each bundle it computes the
distance at which its cone meets each geom of a type. Then all rays of a bundle are tested against one geom
after the other, the nearest first, until the next one is farther than the hits of all rays.
"""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.sensors.rays.bundles import (
    Cone,
    Fans,
    bounding_cones,
    bundled,
    cone_box_distance,
    cone_sphere_distance,
)
from usarmjx.sensors.rays.kernels import RAY_KERNELS, XYZ, bounding_radius
from usarmjx.sensors.rays.targets import GeomBlock, GeomBlockInfo, GeomHits, merge_vmaps

RAYS_AT_A_TIME = 256
"""Approximate number of rays in a group of casts; its bundles iterate in lockstep."""
UNCULLED_RAYS_AT_A_TIME = 8192
"""The same if all geoms are tested, without lockstep: enough for all cores."""
GEOMS_AT_A_TIME = 4
"""Geoms per iteration of the loop without culling, which reads and writes the hits once."""
LANES = 16
"""Divisor of bundle sizes: a small multiple of the SIMD width."""
MAX_UNCULLED_GEOMS = 2
"""Number of geoms of a type up to which they are tested without culling."""
POS_OFFSET, MAT_OFFSET, SIZE_OFFSET, OWNER_OFFSET, PACKED_SIZE = 0, 3, 12, 15, 16
"""Offsets of a geom's packed values: position (3), orientation by rows (9), size (3), owner; and their
number."""
NO_RANK = np.int32(np.iinfo(np.int32).max)
"""Rank of a geom that is not met: after all others."""


class _Bundles(NamedTuple):
    """Bundles of rays of some casts; components as in `kernels.XYZ`.

    Attributes:
        start: Origins [m] (casts, bundles, size).
        along: Unit vectors (casts, bundles, size).
        exclude: Owner whose geoms a cast's rays pass (casts,).
    """

    start: XYZ
    along: XYZ
    exclude: jax.Array


def pack(work: Sequence[tuple[GeomBlockInfo, GeomBlock]]) -> jax.Array:
    """Return the packed geoms of a world, block by block (NUMBERS, geoms)."""
    # Owners are small whole numbers, exact in float32: so they fit beside lengths in one array.
    blocks = [
        jnp.concatenate([b.pos.T, b.mat.reshape(-1, 9).T, b.size.T, jnp.asarray(b.owner)[None]])
        for _, b in work
    ]
    return jnp.concatenate([block.astype(jnp.float32) for block in blocks], 1)


def nearest_of_bundles(
    work: Sequence[tuple[GeomBlockInfo, GeomBlock]],
    rays: tuple[Array, Array] | Fans,
    exclude_and_wanted: tuple[Array | np.int32, Array],
    *,
    bundle_size: int,
    max_distance: float,
    culling_threshold: float,
    culling_geoms: int = 0,
) -> GeomHits:
    """Return the first hit of each ray.

    Args:
        work: The geoms.
        rays: Origins and directions (rays, 3), or fans.
        exclude_and_wanted: Owner whose geoms the rays pass (), and whether the result is needed ().
        bundle_size: Number of consecutive rays with similar directions.
        max_distance: Range [m].
        culling_threshold: Number of ray-geom pairs of all casts up to which every pair is tested: less to
            compile.
        culling_geoms: Number of geoms up to which every pair is tested, too, if most casts are wanted.
    """
    count = rays.directions[..., 0].size if isinstance(rays, Fans) else len(rays[0])
    if not work or not count:
        return GeomHits(jnp.full(count, jnp.inf, jnp.float32), jnp.full(count, -1, jnp.int32))
    lines, given, piece = None, rays, -(-count // -(-count // RAYS_AT_A_TIME))  # equal pieces: no padding
    if isinstance(rays, Fans) and piece < count:  # pieces may cut through a fan
        given = rays.rays()
    elif isinstance(rays, Fans):
        lines, given = np.asarray(rays.directions, np.float32), (rays.pos, rays.mat)
    infos = [info for info, _ in work]
    pairs, size = count * sum(info.num_geoms for info in infos), -(-min(bundle_size, count) // LANES) * LANES

    def run(geoms: Array, world: Array, exclude: Array, wanted: Array, *given: Array) -> GeomHits:
        shape = len(world), piece
        blank = GeomHits(jnp.full(shape, jnp.inf, jnp.float32), jnp.full(shape, -1, jnp.int32))

        def groups(size: int | None, rays_at_a_time: int) -> Callable[[tuple[Array, ...]], GeomHits]:
            some, together = partial(_cast_some, infos, lines, size, max_distance), rays_at_a_time // piece
            return lambda casts: _cast_wanted(some, max(1, together), blank, *casts)

        cast = groups(size, RAYS_AT_A_TIME)
        if len(world) * pairs <= culling_threshold:
            cast = groups(None, len(world) * piece)
        elif pairs <= count * culling_geoms:
            all_geoms, most = groups(None, UNCULLED_RAYS_AT_A_TIME), 2 * wanted.sum() > len(wanted)
            cast = partial(jax.lax.cond, most, all_geoms, cast)

        def miss(_: tuple[Array, ...]) -> GeomHits:
            return blank

        return jax.lax.cond(wanted.any(), cast, miss, (wanted, geoms, world, exclude, *given))

    split = [jnp.asarray(x, jnp.float32)[None] for x in given]
    if lines is None:
        split = [bundled(x[0].T, piece).transpose(1, 2, 0) for x in split]
    exclude, wanted = (jnp.full(len(split[0]), number) for number in exclude_and_wanted)
    casts = jnp.zeros(len(split[0]), jnp.int32), exclude.astype(jnp.float32), wanted
    found = merge_vmaps(run)(pack(work)[None], *casts, *split)
    return GeomHits(*(x.reshape(-1)[:count] for x in found))


def _cast_wanted(
    some: Callable[..., GeomHits],
    together: int,
    blank: GeomHits,
    wanted: Array,
    geoms: Array,
    *casts: Array,
) -> GeomHits:
    """Return the hits of wanted casts (casts,), a few at a time; the others hit nothing."""
    number = len(wanted)
    if together >= number:
        pairs = zip(some(geoms, *casts), blank, strict=True)
        return GeomHits(*(_where(wanted, new, old) for new, old in pairs))
    total = wanted.sum()
    # Padding rows index past the end: reads are clipped, writes dropped.
    order = jnp.nonzero(wanted, size=number + -number % together, fill_value=number)[0]

    def more(carry: tuple[jax.Array, GeomHits]) -> tuple[jax.Array, GeomHits]:
        i, found = carry
        rows = jax.lax.dynamic_slice_in_dim(order, i, together)
        new = some(geoms, *(jnp.asarray(x).at[rows].get(mode="clip") for x in casts))
        return i + together, GeomHits(
            *(old.at[rows].set(one, mode="drop") for old, one in zip(found, new, strict=True))
        )

    # A loop over the wanted casts: its length is known only while it runs, which `scan` does not allow.
    return jax.lax.while_loop(lambda carry: carry[0] < total, more, (jnp.zeros((), int), blank))[1]


def _where(wanted: Array, new: jax.Array, old: jax.Array) -> jax.Array:
    return jnp.where(wanted[:, None], new, old)


def _rays(lines: np.ndarray | None, given: Sequence[jax.Array]) -> tuple[XYZ, XYZ]:
    """Return the components of ray origins and directions (casts, rays)."""
    if lines is None:
        start, along = (tuple(jnp.moveaxis(x, -1, 0)) for x in given)
        return start, along
    pos, mat = given
    shape = len(pos), -1
    # Components stand apart, so that each product runs over contiguous rays.
    along = [_dot([mat[..., j, i, None] for i in range(3)], np.moveaxis(lines, -1, 0)) for j in range(3)]
    start = [jnp.broadcast_to(pos[..., j, None], along[j].shape) for j in range(3)]
    return [x.reshape(shape) for x in start], [x.reshape(shape) for x in along]


def _dot(one: XYZ, other: XYZ) -> jax.Array:
    return jnp.asarray(one[0] * other[0] + one[1] * other[1] + one[2] * other[2])


def _cast_some(
    infos: Sequence[GeomBlockInfo],
    lines: np.ndarray | None,
    size: int | None,
    max_distance: float,
    geoms: jax.Array,
    world: jax.Array,
    exclude: jax.Array,
    *given: jax.Array,
) -> GeomHits:
    """Return the hits of some casts (casts, rays).

    Args:
        infos: Static properties of the geoms.
        lines: Directions of fans; None: individual rays.
        size: Bundle size; None: no culling.
        max_distance: Range [m].
        geoms: Geoms of all worlds (worlds, NUMBERS, geoms).
        world: World of each cast (casts,).
        exclude: Owners whose geoms the rays pass (casts,).
        given: Poses of fans, or rays (casts, ...).
    """
    rays = _rays(lines, given)
    count = rays[0][0].shape[1]
    start, along = ([bundled(x, size or count) for x in vector] for vector in rays)
    bundles = _Bundles(start, along, exclude)
    cone = None if size is None else bounding_cones(start, along)
    shape, own, first = start[0].shape, geoms[world], 0
    # The range as first distance: what lies beyond it is never nearer.
    found = GeomHits(jnp.full(shape, max_distance, jnp.float32), jnp.full(shape, -1, jnp.int32))
    # Large geoms come first (`indexed_blocks`) and shorten the rays before many small ones are tested.
    for info in infos:
        block = own[:, :, first : first + info.num_geoms]
        if cone is None or info.num_geoms <= MAX_UNCULLED_GEOMS:
            found = _test_all(info, block, bundles, found)
        else:
            found = _test_near(info, block, bundles, cone, found)
        first += info.num_geoms
    return GeomHits(*(x.reshape(len(world), -1)[:, :count] for x in found)).met()


def _split(numbers: jax.Array, axis: int) -> Sequence[jax.Array]:
    """Return the packed values of geoms one by one, with an axis of length 1 in place of `axis`.

    One operation to trace instead of three for each value, of which a caster has hundreds.
    """
    return jax.lax.split(numbers, (1,) * PACKED_SIZE, axis)


def _distance(kind: int, numbers: jax.Array, start: XYZ, along: XYZ) -> jax.Array:
    """Return the distances of rays (..., size) to geoms (..., NUMBERS) [m] (..., size)."""
    number = _split(numbers, numbers.ndim - 1)
    offset = [start[j] - number[POS_OFFSET + j] for j in range(3)]
    turned = [[number[MAT_OFFSET + 3 * j + i] for j in range(3)] for i in range(3)]
    local, way = ([_dot(row, vector) for row in turned] for vector in (offset, along))
    return jnp.asarray(RAY_KERNELS[kind](local, way, number[SIZE_OFFSET:OWNER_OFFSET]))


def _test_all(info: GeomBlockInfo, block: jax.Array, bundles: _Bundles, found: GeomHits) -> GeomHits:
    """Update the hits with some geoms (casts, NUMBERS, geoms)."""

    def closer(found: GeomHits, one: tuple[jax.Array, jax.Array]) -> tuple[GeomHits, None]:
        numbers, index = one[0][:, None], one[1]
        t = _distance(info.kind, numbers, bundles.start, bundles.along)
        passed = numbers[..., OWNER_OFFSET] == bundles.exclude[:, None]
        return found.closer(jnp.where(passed[..., None], jnp.inf, t), index), None

    # On a CPU a scan is ten times as fast as reductions over arrays of rays times geoms.
    rows = jnp.moveaxis(block, -1, 0), info.first_index + jnp.arange(info.num_geoms, dtype=jnp.int32)
    return jax.lax.scan(closer, found, rows, unroll=min(GEOMS_AT_A_TIME, info.num_geoms))[0]


def _test_near(
    info: GeomBlockInfo, block: jax.Array, bundles: _Bundles, cone: Cone, found: GeomHits
) -> GeomHits:
    """As `_test_all`, for each bundle only with the near geoms, front to back."""
    casts, number, size = found.distance.shape
    # As few bits as indices need: each bit taken from the distance makes the order of geoms coarser.
    bits = (info.num_geoms - 1).bit_length()
    low = np.int32((1 << bits) - 1)
    near = _cone_distances(info, block, cone)
    near = jnp.where((block[:, OWNER_OFFSET] == bundles.exclude[:, None])[:, None], jnp.inf, near)
    # A rank is the distance's bit pattern with the geom's index in its last bits: positive floats sort
    # like their bit patterns, and integer comparisons are fast.
    ranks = jax.lax.bitcast_convert_type(near, jnp.int32) & ~low | np.arange(info.num_geoms, dtype=np.int32)
    ranks = jnp.where(near < jnp.inf, ranks, NO_RANK).reshape(casts * number, -1)
    start, along = ([x.reshape(-1, size) for x in vector] for vector in (bundles.start, bundles.along))
    whose = np.repeat(np.arange(casts), number)

    def reaches(rank: jax.Array, found: GeomHits) -> jax.Array:
        # With its last bits cleared the distance is rounded down: still a lower bound.
        entry = jax.lax.bitcast_convert_type(rank & ~low, jnp.float32)
        return ((rank < NO_RANK) & (entry <= _reduce_rows(jnp.maximum, found.distance))).any()

    def test(carry: tuple[jax.Array, jax.Array, GeomHits]) -> tuple[jax.Array, jax.Array, GeomHits]:
        rank, _, found = carry
        index = rank & low
        numbers = block.at[whose, :, index].get(mode="clip")
        t = _distance(info.kind, numbers, start, along)
        # Bundles iterate in lockstep: those that are done test an arbitrary geom, which must not count.
        t = jnp.where((rank < NO_RANK)[:, None], t, jnp.inf)
        place = (info.first_index + index)[:, None]
        # Ties go to the first geom of the block, as in a test of all in order.
        same = (t == found.distance) & (place < found.geom_index) & (found.geom_index >= info.first_index)
        found = found.closer(t, place)
        found = found._replace(geom_index=jnp.where(same, place, found.geom_index))
        rank = _next_rank(ranks, rank)
        return rank, reaches(rank, found), found

    flat = GeomHits(*(x.reshape(-1, size) for x in found))
    rank = _next_rank(ranks, jnp.full(len(ranks), -1, jnp.int32))
    end = jax.lax.while_loop(lambda carry: carry[1], test, (rank, reaches(rank, flat), flat))
    return GeomHits(*(x.reshape(casts, number, size) for x in end[2]))


def _next_rank(ranks: jax.Array, rank: jax.Array) -> jax.Array:
    """Return the smallest rank of each bundle (bundles, geoms) above a given one (bundles,)."""
    missing = -ranks.shape[1] % LANES
    ranks = jnp.pad(ranks, ((0, 0), (0, missing)), constant_values=NO_RANK)  # pyright: ignore[reportUnknownMemberType] - jnp.pad is half typed
    return _reduce_rows(jnp.minimum, jnp.where(ranks > rank[:, None], ranks, NO_RANK))


def _reduce_rows(both: Callable[[Array, Array], jax.Array], values: jax.Array) -> jax.Array:
    """Reduce each row (rows, n LANES) by `both` (rows,).

    A plain reduction along the rows would not be vectorised.
    """
    parts = [values[:, i : i + LANES] for i in range(0, values.shape[1], LANES)]
    # The barrier keeps XLA from fusing both halves into a plain reduction again.
    lanes: jax.Array = jax.lax.optimization_barrier(reduce(both, parts))  # pyright: ignore[reportUnknownMemberType] - JAX has no type
    while (half := lanes.shape[1] // 2) > 0:
        lanes = both(lanes[:, :half], lanes[:, half:])
    return lanes[:, 0]


def _cone_distances(info: GeomBlockInfo, block: jax.Array, cone: Cone) -> jax.Array:
    """Return the distances at which cones meet geoms (casts, bundles, geoms)."""
    number = _split(block, 1)
    tip, axis = ([x[..., None] for x in vector] for vector in (cone.tip, cone.axis))
    radius, slope = cone.tip_radius[..., None], cone.slope[..., None]
    offset, size = (
        [tip[j] - number[POS_OFFSET + j] for j in range(3)],
        tuple(number[SIZE_OFFSET:OWNER_OFFSET]),
    )
    if info.compact:
        # Compact geoms fill their bounding spheres: these cull as well as turned boxes, with less arithmetic.
        around = bounding_radius(info.kind, size)
        return cone_sphere_distance([-x for x in offset], axis, around, radius, slope)
    turned = [[number[MAT_OFFSET + 3 * j + i] for j in range(3)] for i in range(3)]
    local, way = ([_dot(row, vector) for row in turned] for vector in (offset, axis))
    return cone_box_distance(info.kind, size, local, way, radius, slope)
