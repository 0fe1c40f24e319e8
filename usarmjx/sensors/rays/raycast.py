"""The raycaster that all sensors share: casts in bundles that pass what a sensor sees through.

MJX's own `ray` misses cylinders and height fields without a word. Conventions are those of C MuJoCo's
`mj_ray`: the distance to the first surface crossed, from inside a solid too, in units of the direction's
length (directions here are unit vectors, so metres); a plane is seen from its front only. Meshes and terrain
are seen as their triangles, see `models.build.pieces`.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct
from jax.custom_batching import custom_vmap

from usarmjx.base.accelerator import warp_in_use
from usarmjx.base.arrays import Array, Bool, Float, Int
from usarmjx.base.backend import xp
from usarmjx.models.compile.ray_geoms import TRIANGLE_KIND
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.kernels import RAY_KERNELS
from usarmjx.sensors.rays.raycast_cpu import nearest_of_bundles
from usarmjx.sensors.rays.targets import GeomBlock, GeomBlockInfo, GeomHits, Geoms, normals, sloped

T = TypeVar("T")


def cast_if_wanted(wanted: Bool[Array, ""] | None, cast: Callable[..., T], missed: T, *args: Any) -> T:  # noqa: ANN401
    """Return `cast(*args)` where that is wanted, else misses.

    Mapped over robots and worlds it is cast for all of them if any one wants it, and not at all if none does.
    (A plain `lax.cond` would become a select there, which always casts.)

    Args:
        wanted: Whether anybody wants to know (); None: yes.
        cast: A function of arrays only; it must not close over any that are traced.
        missed: What a miss is, a number for each array of its result.
        args: Its arguments.
    """
    if wanted is None:
        return cast(*args)
    hits = _cast_if_any(wanted, cast, missed, args)
    return jax.tree.map(lambda hit, miss: jnp.where(wanted, hit, miss), hits, missed)


def _cast_if_any(wanted: Array, cast: Callable[..., T], missed: T, args: tuple[Any, ...]) -> T:
    """Return what is cast, if any of many want it (...); else misses of the same shape."""
    cast = jax.jit(cast, inline=True)  # traced once: for its shapes, for its work, and for all maps

    @custom_vmap
    def run(wanted: Array, args: tuple[Any, ...]) -> T:
        shapes = jax.eval_shape(cast, *args)
        blank = jax.tree.map(lambda hit, miss: jnp.full(hit.shape, miss, hit.dtype), shapes, missed)
        return jax.lax.cond(jnp.any(wanted), lambda args: cast(*args), lambda _: blank, args)

    @run.def_vmap
    def run_mapped(size: int, batched: Any, wanted: Array, args: tuple[Any, ...]) -> tuple[T, Any]:  # noqa: ANN401
        axes = jax.tree.map(lambda mapped: 0 if mapped else None, batched[1])
        mapped = jax.vmap(cast, in_axes=axes, axis_size=size)
        # Not `run` again: an outer map calls this rule too, with one axis more on everything.
        hits = _cast_if_any(wanted, mapped, missed, args)
        return hits, jax.tree.map(lambda _: True, hits)

    return run(wanted, args)


DEFAULT_BUNDLE_SIZE = 32
"""Rays after each other that go about the same way, if nobody says otherwise."""
COMPACT_KINDS = frozenset({int(mujoco.mjtGeom.mjGEOM_SPHERE), TRIANGLE_KIND})
"""Kinds that count as compact anyway; the triangles of meshes and terrain are small."""
CULLING_THRESHOLD = 100_000
"""Rays times geoms, of all robots and worlds, from which on leaving out geoms pays on a CPU, ..."""
CULLING_GEOMS = 300
"""... if there are more geoms, or few casts are wanted: to test so many takes as long as to find the near."""

EXCLUDE_NONE = np.int32(-2)
"""No owner of any geom: robots' slots count from 0, and the arena is -1."""


class Hits(struct.PyTreeNode, kw_only=True):
    """What rays hit first.

    Attributes:
        distance: Distance to the surface, infinite where nothing was hit [m] (rays,).
        cosine: Cosine between the ray and the surface normal, in [0, 1]; 0 without a hit, and where it
            was not asked for (rays,).
    """

    distance: Array
    cosine: Array


NO_HITS = Hits(distance=np.zeros(0, np.float32), cosine=np.zeros(0, np.float32))
"""Of a robot that casts no rays."""


class RayQuery(struct.PyTreeNode, kw_only=True):
    """How rays are cast, and for whom; all backends honour all of it.

    Attributes:
        transparent: Materials that they go through, without any cost.
        bundle_size: So many rays after each other start and go about the same way. What is nowhere near their
            cone costs them next to nothing.
        max_distance: What is farther is not met [m].
        incidence: Whether to find out at which angle they meet surfaces.
        exclude_owner: Slot of the robot that looks; its own geoms are transparent to it ().
        wanted: Whether anybody wants to know; if not, nothing is met (); None: yes.
    """

    transparent: frozenset[str] = struct.field(pytree_node=False, default=frozenset())
    bundle_size: int = struct.field(pytree_node=False, default=DEFAULT_BUNDLE_SIZE)
    max_distance: float = struct.field(pytree_node=False, default=math.inf)
    incidence: bool = struct.field(pytree_node=False, default=False)
    exclude_owner: Int[Array, ""] | np.int32 = EXCLUDE_NONE
    wanted: Bool[Array, ""] | None = None


DEFAULT_QUERY = RayQuery()
RayCaster = Callable[[Array, Array, RayQuery, Fans | None], Hits]
"""Casts rays at all there is in a world: as `cast_rays`, its geoms given."""


NO_COSINE: Any = 0.0
"""Of a miss; a number in place of an array."""


class IndexedBlock(NamedTuple):
    """Geoms of a kind that rays do not pass, and what is known of them while compiling."""

    info: GeomBlockInfo
    block: GeomBlock


def distance_to(kind: int, geom: GeomBlock, origin: Array, direction: Array) -> Array:
    """Distance of rays (..., 3) from geoms, whose axes go before those of the rays' components [m] (...)."""
    # Sums of products instead of matrix products: they fuse with the kernel, so that no array of rays
    # times geoms is ever stored, and a GPU does not round them to TensorFloat-32.
    offset, mat = origin - geom.pos, geom.mat
    local = [sum(mat[..., j, i] * offset[..., j] for j in range(3)) for i in range(3)]
    along = [sum(mat[..., j, i] * direction[..., j] for j in range(3)) for i in range(3)]
    return RAY_KERNELS[kind](local, along, xp.moveaxis(geom.size, -1, 0))


def indexed_blocks(geoms: Geoms, transparent: frozenset[str] = frozenset()) -> list[IndexedBlock]:
    """Return the geoms that rays do not pass; what is compact comes last, as the rest may hide it."""
    compact = geoms.compact or (False,) * len(geoms.blocks)
    found, first = list[IndexedBlock](), 0
    for kind, block, small, material in zip(geoms.kinds, geoms.blocks, compact, geoms.materials, strict=True):
        count = len(block.owner)
        if material not in transparent:
            info = GeomBlockInfo(kind, count, first, small or kind in COMPACT_KINDS)
            found.append(IndexedBlock(info, block))
        first += count
    return sorted(found, key=lambda part: part.info.compact)


@jax.named_scope("nearest_hits")
def nearest_hits(
    geoms: Geoms,
    origin: Float[Array, "rays 3"],
    direction: Float[Array, "rays 3"],
    query: RayQuery = DEFAULT_QUERY,
    fans: Fans | None = None,
) -> GeomHits:
    """Return what each ray meets first.

    Args:
        geoms: What there is to hit.
        origin: Origins of the rays [m] (rays, 3).
        direction: Unit vectors (rays, 3).
        query: How, and for whom.
        fans: The same rays as fans, if they are such: a GPU turns them where it needs them.
    """
    seen = indexed_blocks(geoms, query.transparent)
    if warp_in_use():
        return warp_hits(seen, (origin, direction) if fans is None else fans, query)
    return _hits_on_a_cpu(seen, origin, direction, query, fans, CULLING_THRESHOLD, CULLING_GEOMS)


def brute_force_hits(
    seen: Sequence[IndexedBlock],
    origin: Float[Array, "rays 3"],
    direction: Float[Array, "rays 3"],
    query: RayQuery = DEFAULT_QUERY,
) -> GeomHits:
    """As `nearest_hits`: all rays against one geom after the other."""
    return _hits_on_a_cpu(seen, origin, direction, query, None, math.inf)


def culled_hits(
    seen: Sequence[IndexedBlock],
    origin: Float[Array, "rays 3"],
    direction: Float[Array, "rays 3"],
    query: RayQuery = DEFAULT_QUERY,
    fans: Fans | None = None,
) -> GeomHits:
    """As `nearest_hits`: each bundle of rays against the geoms that its cone meets, front to back."""
    return _hits_on_a_cpu(seen, origin, direction, query, fans, 0)


def _hits_on_a_cpu(
    seen: Sequence[IndexedBlock],
    origin: Array,
    direction: Array,
    query: RayQuery,
    fans: Fans | None,
    culling_threshold: float,
    culling_geoms: int = 0,
) -> GeomHits:
    return nearest_of_bundles(
        [(part.info, part.block) for part in seen],
        (origin, direction) if fans is None else fans,
        (query.exclude_owner, jnp.ones((), bool) if query.wanted is None else query.wanted),
        bundle_size=query.bundle_size,
        max_distance=query.max_distance,
        culling_threshold=culling_threshold,
        culling_geoms=culling_geoms,
    )


def warp_hits(
    seen: Sequence[IndexedBlock],
    rays: tuple[Array, Array] | Fans,
    query: RayQuery = DEFAULT_QUERY,
) -> GeomHits:
    """As `nearest_hits`: see `raycast_warp`."""
    from usarmjx.sensors.rays.raycast_warp import nearest_of_bundles

    wanted = jnp.ones((), bool) if query.wanted is None else query.wanted
    found = nearest_of_bundles(
        seen,
        rays,
        (query.exclude_owner, wanted),
        bundle_size=query.bundle_size,
        max_distance=query.max_distance,
    )
    return GeomHits(*found)


def cast_rays(
    geoms: Geoms,
    origin: Float[Array, "rays 3"],
    direction: Float[Array, "rays 3"],
    query: RayQuery = DEFAULT_QUERY,
    fans: Fans | None = None,
) -> Hits:
    """Return the first surface that each ray meets, see `nearest_hits`; at which angle, if the query asks.

    Rays without a direction (of zeros) meet nothing.
    Distances can be differentiated, see `surfaces.sloped`; angles count as constant.
    """
    lines, frames = (None, ()) if fans is None else (fans.directions, (fans.pos, fans.mat))
    first = sloped(partial(_nearest_of_frames, lines), geoms, origin, direction, query, *frames)
    cosine: Array = jnp.zeros_like(first.distance)
    if query.incidence:
        cosine = _incidence(query, lines, *jax.lax.stop_gradient((geoms, first, origin, direction, *frames)))
    distance = first.distance
    if fans is None:
        distance = jnp.where((direction != 0).any(-1), distance, jnp.inf)
    return Hits(distance=distance, cosine=cosine)


@jax.named_scope("incidence")
def _incidence(
    query: RayQuery,
    lines: np.ndarray | None,
    geoms: Geoms,
    first: GeomHits,
    origin: Array,
    direction: Array,
    *frames: Array,
) -> Array:
    """Return the cosine between each ray and the surface that it meets (rays,); frames as below."""
    if warp_in_use():
        from usarmjx.sensors.rays.incidence_warp import cosines_of_hits

        rays = (origin, direction) if lines is None else Fans(frames[0], frames[1], lines)
        return cosines_of_hits(indexed_blocks(geoms, query.transparent), rays, first)
    wanted = None if jax.default_backend() == "gpu" else query.wanted
    return cast_if_wanted(wanted, _cosines, NO_COSINE, geoms, first, origin, direction)


def _nearest_of_frames(
    lines: np.ndarray | None,
    geoms: Geoms,
    origin: Array,
    direction: Array,
    query: RayQuery,
    *frames: Array,
) -> GeomHits:
    """As `nearest_hits`; of fans the lines are no values of the function, but known while compiling."""
    fans = None if lines is None else Fans(frames[0], frames[1], lines)
    return nearest_hits(geoms, origin, direction, query, fans)


def _cosines(geoms: Geoms, first: GeomHits, origin: jax.Array, direction: jax.Array) -> jax.Array:
    return jnp.abs((normals(geoms, first, origin, direction) * direction).sum(-1))
