"""The raycaster's kernel for GPUs: one program for each bundle of rays, which takes the geoms front to back.

First each lane of the program looks at a few geoms and finds out how far away a bundle's cone meets them.
Then geom after geom, the nearest first, all rays of the bundle are tested against one, until the next is
farther than what every ray has met.
"""

from collections.abc import Sequence
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton

from usarmjx.base.arrays import Array
from usarmjx.sensors.rays.bundles import (
    CONE_MARGIN,
    MIN_COSINE,
    MIN_SLOPE,
    Cone,
    Fans,
    cone_box_distance,
    cone_sphere_distance,
)
from usarmjx.sensors.rays.kernels import RAY_KERNELS, TINY, bounding_radius
from usarmjx.sensors.rays.targets import GeomBlockInfo

LANES = 64
"""Geoms that a program looks at together; more take more registers, and then fewer programs run at a time."""
MAX_PASS_GEOMS = 256
"""Most geoms whose distances a program keeps while it tests the nearest; a power of two."""
MAX_UNCULLED_GEOMS = 2
"""So many geoms are tested without looking."""
OWNER_ROW, RADIUS_ROW, GEOM_ROWS = 15, 16, 17
"""Of a geom's numbers, which are position (3), orientation by rows (9), size (3), owner, bounding radius."""
UNLIMITED_DISTANCE = 3e38
"""Stands for an unlimited reach, as what is missed is infinitely far."""


def pack(kind: int, block: Any) -> jax.Array:  # noqa: ANN401 - a raycast.Block
    """Return a block's geoms by number (GEOM_ROWS, room).

    There is room for whole groups of `LANES`; for whole passes of `MAX_PASS_GEOMS` if there are more.
    """
    count = len(block.owner)
    step = LANES if count <= MAX_PASS_GEOMS else MAX_PASS_GEOMS
    room = -(-count // step) * step
    last = jnp.stack([block.owner.astype(jnp.float32), bounding_radius(kind, tuple(block.size.T))])
    rows = jnp.concatenate([block.pos.T, block.mat.reshape(-1, 9).T, block.size.T, last])
    return jnp.pad(rows.astype(jnp.float32), ((0, 0), (0, room - count)))  # pyright: ignore[reportUnknownMemberType] - jnp.pad is half typed


def _local(mat: Sequence[jax.Array], vector: Sequence[Any] | jax.Array) -> tuple[jax.Array, ...]:
    """Return a vector in the frame of a geom."""
    return tuple(mat[i] * vector[0] + mat[3 + i] * vector[1] + mat[6 + i] * vector[2] for i in range(3))


class _Bundle(NamedTuple):
    """One bundle of rays.

    Attributes:
        origin: Their starts by component [m], (size,) each.
        direction: Their directions by component, (size,) each.
        cone: The cone about them, by number.
        exclude_owner: Slot of the robot that looks ().
    """

    origin: tuple[jax.Array, ...]
    direction: tuple[jax.Array, ...]
    cone: Cone
    exclude_owner: jax.Array


def _approach(info: GeomBlockInfo, fields: Any, at: Any, bundle: _Bundle) -> jax.Array:  # noqa: ANN401
    """Return how far away the bundle's cone meets some geoms (geoms,)."""
    tip, axis, thick, slope = bundle.cone
    away = tuple(fields[i, at] - tip[i] for i in range(3))
    if info.compact:
        return cone_sphere_distance(away, axis, fields[RADIUS_ROW, at], thick, slope)
    mat, size = [fields[i, at] for i in range(3, 12)], tuple(fields[i, at] for i in range(12, 15))
    return cone_box_distance(
        info.kind, size, _local(mat, tuple(-x for x in away)), _local(mat, tuple(axis)), thick, slope
    )


def _test(info: GeomBlockInfo, fields: Any, index: Any, bundle: _Bundle) -> jax.Array:  # noqa: ANN401
    """Return the distance of one geom from every ray (size,)."""
    geom = [fields[i, index] for i in range(15)]
    away = tuple(bundle.origin[i] - geom[i] for i in range(3))
    mat, size = geom[3:12], tuple(geom[12:15])
    return jnp.asarray(RAY_KERNELS[info.kind](_local(mat, away), _local(mat, bundle.direction), size))


Best = tuple[jax.Array, jax.Array]
"""How far away (size,) and which (size,) the nearest is up to now."""


def _distance_keys(info: GeomBlockInfo, fields: Any, begin: Any, number: int, bundle: _Bundle) -> jax.Array:  # noqa: ANN401
    """Return keys of some geoms, which sort as their distances do (LANES,).

    The last bits of a key are the geom's number in the pass, which is `number` for the first one here.
    """
    lanes = jax.lax.broadcasted_iota(jnp.int32, (LANES,), 0)  # pyright: ignore[reportUnknownMemberType]
    here = pl.ds(begin, LANES)
    near = _approach(info, fields, here, bundle)
    there = (lanes + begin < info.num_geoms) & (fields[OWNER_ROW, here] != bundle.exclude_owner)
    bits = jax.lax.bitcast_convert_type(jnp.where(there, near, jnp.inf), jnp.int32)
    return (bits & ~(MAX_PASS_GEOMS - 1)) | (lanes + number)


def _pass(info: GeomBlockInfo, fields: Any, count: int, bundle: _Bundle, begin: Any, best: Best) -> Best:  # noqa: ANN401
    """Return the best of so many geoms from a place on, at most `MAX_PASS_GEOMS`, and what there was."""
    keys = [_distance_keys(info, fields, begin + number, number, bundle) for number in range(0, count, LANES)]

    def least(keys: Sequence[jax.Array]) -> jax.Array:
        return jnp.min(reduce(jnp.minimum, keys))

    def more(carry: Any) -> jax.Array:  # noqa: ANN401
        _, key, (reach, _) = carry
        farthest = jnp.max(jax.lax.bitcast_convert_type(reach, jnp.int32))  # integers are reduced faster
        return key <= (farthest | (MAX_PASS_GEOMS - 1))

    def test(carry: Any) -> Any:  # noqa: ANN401
        keys, key, (reach, found) = carry
        place = begin + (key & (MAX_PASS_GEOMS - 1))
        t = _test(info, fields, place, bundle)
        closer = t < reach
        keys = [jnp.where(group == key, LAST_KEY, group) for group in keys]
        return (
            keys,
            least(keys),
            (jnp.where(closer, t, reach), jnp.where(closer, info.first_index + place, found)),
        )

    return jax.lax.while_loop(more, test, (keys, least(keys), best))[2]


LAST_KEY = 0x7FFFFFFF
"""A key after all others."""


def _all(info: GeomBlockInfo, fields: Any, bundle: _Bundle, best: Best) -> Best:  # noqa: ANN401
    """Return the best of a few geoms and what there was; all are tested."""
    for index in range(info.num_geoms):
        t = _test(info, fields, index, bundle)
        closer = (t < best[0]) & (fields[OWNER_ROW, index] != bundle.exclude_owner)
        best = (jnp.where(closer, t, best[0]), jnp.where(closer, info.first_index + index, best[1]))
    return best


def _cone(start: Sequence[jax.Array], along: Sequence[jax.Array]) -> Cone:
    """As `bundles.bounding_cones`, of one bundle by components (size,)."""
    count = start[0].shape[0]
    tip, axis = [x.sum() / count for x in start], [x.sum() for x in along]
    length = jnp.sqrt(jnp.maximum(sum(x * x for x in axis), TINY))
    axis = [x / length for x in axis]
    cosine = jnp.min(sum(x * y for x, y in zip(along, axis, strict=True)))
    slope = jnp.sqrt(jnp.maximum(1.0 - cosine * cosine, 0.0)) / jnp.maximum(cosine, MIN_COSINE) + MIN_SLOPE
    thick = jnp.sqrt(jnp.max(sum((x - y) * (x - y) for x, y in zip(start, tip, strict=True)))) + CONE_MARGIN
    return Cone(tip, axis, thick, jnp.where(cosine < MIN_COSINE, -1.0, slope))


RayComponents = tuple[tuple[jax.Array, ...], tuple[jax.Array, ...]]
"""Starts and directions of some rays, by component."""


def _given(rays: Sequence[Any], ray: jax.Array) -> RayComponents:
    """Return some of the rays of arrays (rays, 3)."""
    start, along = (tuple(x[ray, i] for i in range(3)) for x in rays)
    return start, along


def _fanned(rays: Sequence[Any], ray: jax.Array) -> RayComponents:
    """Return some of the rays of fans: origins (fans, 3), orientations (fans, 9), lines (3, rays)."""
    pos, mat, lines = rays
    fan = ray // (lines.shape[1] // pos.shape[0]) if pos.shape[0] > 1 else 0
    line = [lines[i, ray] for i in range(3)]
    along = tuple(sum(mat[fan, 3 * i + j] * line[j] for j in range(3)) for i in range(3))
    return tuple(jnp.broadcast_to(pos[fan, i], ray.shape) for i in range(3)), along  # type: ignore - sums of 3


def _program(*refs: Any, blocks_info: tuple[GeomBlockInfo, ...], bundle: int, reach: float) -> None:  # noqa: ANN401
    blocks, (*rays, exclude_owner, wanted, distance, geom_index) = (
        refs[: len(blocks_info)],
        refs[len(blocks_info) :],
    )
    lanes = jax.lax.broadcasted_iota(jnp.int32, (max(16, 1 << (bundle - 1).bit_length()),), 0)  # pyright: ignore[reportUnknownMemberType]
    begin, count = pl.program_id(0) * bundle, distance.shape[0]
    ray = jnp.minimum(begin + lanes, jnp.minimum(begin + bundle, count) - 1)  # lanes left over: the last ray
    nothing = (jnp.full(ray.shape, reach, jnp.float32), jnp.full(ray.shape, -1, jnp.int32))

    def look(best: Best) -> Best:
        start, along = _given(rays, ray) if len(rays) == 2 else _fanned(rays, ray)
        excluded = exclude_owner[0].astype(jnp.float32)
        return _first(blocks_info, blocks, _Bundle(start, along, _cone(start, along), excluded), best)

    reached, found = jax.lax.cond(wanted[0] > 0, look, lambda best: best, nothing)
    # Lanes left over say the same as the last one.
    distance[ray], geom_index[ray] = jnp.where(found < 0, jnp.inf, reached), found


def _first(infos: tuple[GeomBlockInfo, ...], blocks: Sequence[Any], bundle: _Bundle, best: Best) -> Best:
    """Return the best of all geoms and what there was."""
    for info, fields in zip(infos, blocks, strict=True):
        room = fields.shape[1]
        look = partial(_pass, info, fields, min(room, MAX_PASS_GEOMS), bundle)
        if info.num_geoms <= MAX_UNCULLED_GEOMS:
            best = _all(info, fields, bundle, best)
        elif room <= MAX_PASS_GEOMS:
            best = look(0, best)
        else:
            best = jax.lax.fori_loop(
                0, room // MAX_PASS_GEOMS, lambda turn, best, f=look: f(turn * MAX_PASS_GEOMS, best), best
            )
    return best


def _whole(axes: int, program: Any) -> tuple[int, ...]:  # noqa: ANN401
    """Every program is given the whole of an array."""
    del program
    return (0,) * axes


def nearest_of_bundles(
    work: Sequence[tuple[GeomBlockInfo, jax.Array]],
    rays: tuple[Array, Array] | Fans,
    exclude_and_wanted: tuple[Array | np.int32, Array],
    *,
    bundle_size: int,
    max_distance: float,
    interpret: bool = False,
) -> tuple[jax.Array, jax.Array]:
    """Return distance (infinite for none) and place (-1 for none) of what each ray meets first, both (rays,).

    Args:
        work: The geoms, from `pack`.
        rays: Starts [m] (rays, 3) and unit vectors (rays, 3); or fans, whose rays are never written down.
        exclude_and_wanted: Whose geoms are left out (), and whether to cast the rays at all ().
        bundle_size: See `raycast.RayQuery`.
        max_distance: See `raycast.RayQuery` [m].
        interpret: Run on any device, slowly.
    """
    if isinstance(rays, Fans):
        count = rays.directions.shape[0] * rays.directions.shape[1]
        given = (rays.pos, rays.mat.reshape(-1, 9), jnp.asarray(rays.directions).reshape(count, 3).T)
    else:
        count, given = len(rays[0]), rays
    asked = [number.astype(jnp.int32)[None] for number in exclude_and_wanted]
    arrays = [*(fields for _, fields in work), *given, *asked]
    infos = tuple(info for info, _ in work)
    return pl.pallas_call(
        partial(_program, blocks_info=infos, bundle=bundle_size, reach=min(max_distance, UNLIMITED_DISTANCE)),
        grid=(-(-count // bundle_size),),
        in_specs=[pl.BlockSpec(array.shape, partial(_whole, array.ndim)) for array in arrays],
        out_specs=[pl.BlockSpec((count,), partial(_whole, 1))] * 2,
        out_shape=[jax.ShapeDtypeStruct((count,), dtype) for dtype in (jnp.float32, jnp.int32)],
        compiler_params=triton.CompilerParams(num_warps=1, num_stages=1),
        interpret=interpret,
    )(*arrays)
