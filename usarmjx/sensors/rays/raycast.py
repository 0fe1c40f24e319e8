"""Ray caster of all sensors: nearest hits in bundles, through transparent materials.

MJX's own `ray` silently misses cylinders and height fields. Conventions are those of C MuJoCo's `mj_ray`: the
distance to the first surface crossed, also from inside a solid, in units of the direction's length
(directions here are unit vectors, so metres); a plane is visible only from its front. Meshes and terrain
consist of triangles, see `models.compile.ray_geoms`.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct
from jax.custom_batching import custom_vmap
from jaxtyping import Bool, Float, Int

from usarmjx.base.backend import Array, xp
from usarmjx.base.nodes import Node
from usarmjx.base.warp_functions import warp_in_use
from usarmjx.models.compile.ray_geoms import TRIANGLE_KIND
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.kernels import RAY_KERNELS
from usarmjx.sensors.rays.raycast_cpu import nearest_of_bundles
from usarmjx.sensors.rays.targets import (
    GeomBlock,
    GeomBlockInfo,
    GeomHits,
    Geoms,
    differentiable_cast,
    normals,
)

T = TypeVar("T")
DEFAULT_BUNDLE_SIZE = 32
"""Default number of consecutive rays with similar directions."""
COMPACT_KINDS = frozenset({int(mujoco.mjtGeom.mjGEOM_SPHERE), TRIANGLE_KIND})
"""Geom types that are always compact; triangles of meshes and terrain are small."""
CULLING_THRESHOLD = 100_000
"""Number of ray-geom pairs, over all robots and worlds, above which culling pays on a CPU."""
CULLING_GEOMS = 300
"""Number of geoms above which culling pays if most casts are wanted: brute force over this number takes as
long as the search for the near ones."""
EXCLUDE_NONE = np.int32(-2)
"""Owner that no geom has: slots count from 0, and the arena is -1."""
NO_COSINE: Any = 0.0
"""Cosine of a miss, a number in place of an array."""


def masked_cast(wanted: Bool[Array, ""] | None, cast: Callable[..., T], missed: T, *args: Any) -> T:  # noqa: ANN401
    """Return `cast(*args)` if it is wanted, otherwise misses.

    Under vmap over robots and worlds it casts for all of them if any wants it, and not at all if none does.
    (A plain `lax.cond` would become a select there, which always casts.)

    Args:
        wanted: Whether the result is needed (); None: yes.
        cast: Function of arrays only; it must not close over traced ones.
        missed: Value of a miss, a number for each array of the result.
        args: Its arguments.
    """
    if wanted is None:
        return cast(*args)
    # Under vmap all are cast if any is wanted, so the others' hits are dropped below.
    hits = _masked_cast(wanted, cast, missed, args)
    return jax.tree.map(lambda hit, miss: jnp.where(wanted, hit, miss), hits, missed)


def _masked_cast(wanted: Array, cast: Callable[..., T], missed: T, args: tuple[Any, ...]) -> T:
    """Cast if any of many want it (...); otherwise return misses of the same shape."""
    cast = jax.jit(cast, inline=True)  # one trace serves shapes, execution and all vmaps

    @custom_vmap
    def run(wanted: Array, args: tuple[Any, ...]) -> T:
        shapes = jax.eval_shape(cast, *args)
        blank = jax.tree.map(lambda hit, miss: jnp.full(hit.shape, miss, hit.dtype), shapes, missed)
        # The arguments are passed in: a condition must not close over traced arrays of an outer `vmap`.
        return jax.lax.cond(jnp.any(wanted), lambda args: cast(*args), lambda _: blank, args)

    @run.def_vmap
    def run_mapped(size: int, batched: Any, wanted: Array, args: tuple[Any, ...]) -> tuple[T, Any]:  # noqa: ANN401
        axes = jax.tree.map(lambda mapped: 0 if mapped else None, batched[1])
        mapped = jax.vmap(cast, in_axes=axes, axis_size=size)
        # Not `run` again: an outer vmap calls this rule, too, with one more axis on everything.
        hits = _masked_cast(wanted, mapped, missed, args)
        return hits, jax.tree.map(lambda _: True, hits)

    return run(wanted, args)


class Hits(Node, kw_only=True):
    """First hits of rays.

    Attributes:
        distance: Distance to the surface, infinite without a hit [m] (rays,).
        cosine: Cosine between the ray and the surface normal, in [0, 1]; 0 without a hit, or if not
            requested; 1 where a backend has left out all hits at less than `RayQuery.least_cosines` (rays,).
    """

    distance: Array
    cosine: Array


NO_HITS = Hits(distance=np.zeros(0, np.float32), cosine=np.zeros(0, np.float32))
"""Hits of a robot without rays."""


class RayQuery(Node, kw_only=True):
    """Options of a cast, which all backends honour.

    Attributes:
        transparent: Materials that the rays pass.
        bundle_size: Number of consecutive rays with similar origins and directions. Geoms far from their
            common cone cost next to nothing.
        max_distance: Range [m].
        incidence: Whether to compute the angles of incidence.
        exclude_owner: Slot of the casting robot, whose own geoms are transparent ().
        wanted: Whether the result is needed; if not, nothing is hit (); None: yes.
        least_cosines: Of each fan only the nearest hit counts, among those with at least this cosine of
            incidence (fans,); a backend may leave out all others, also by `incidence`. Empty: all count.
        kept_as: Name by which `CRayCaster` keeps the geoms that are met, for the casting robot; empty: it
            does not, and other backends never do.
    """

    transparent: frozenset[str] = struct.field(pytree_node=False, default=frozenset())
    bundle_size: int = struct.field(pytree_node=False, default=DEFAULT_BUNDLE_SIZE)
    max_distance: float = struct.field(pytree_node=False, default=math.inf)
    incidence: bool = struct.field(pytree_node=False, default=False)
    exclude_owner: Int[Array, ""] | np.int32 = EXCLUDE_NONE
    wanted: Bool[Array, ""] | None = None
    least_cosines: tuple[float, ...] = struct.field(pytree_node=False, default=())
    kept_as: str = struct.field(pytree_node=False, default="")


DEFAULT_QUERY = RayQuery()
RayCaster = Callable[[Array, Array, RayQuery, Fans | None], Hits]
"""Caster for everything in a world: `cast_rays` with its geoms bound."""


@runtime_checkable
class RobotsRayCaster(Protocol):
    """A `RayCaster` that casts the rays of several robots at once, on NumPy."""

    def __call__(self, origin: Array, direction: Array, query: RayQuery, fans: Fans | None, /) -> Hits:
        """Return the first hit of each ray."""
        ...

    def of_robots(self, origin: Array, direction: Array, query: RayQuery) -> Hits:
        """Return the first hits of rays (robots, rays, 3); a zero direction hits nothing.

        `query.exclude_owner` are the robots' slots (robots,).
        """
        ...


class IndexedBlock(NamedTuple):
    """Geoms of one type that block rays, and their static properties."""

    info: GeomBlockInfo
    block: GeomBlock


def distance_to(kind: int, geom: GeomBlock, origin: Array, direction: Array) -> Array:
    """Return the distances of rays (..., 3) from geoms, whose axes precede the rays' last [m] (...)."""
    # Sums of products instead of matrix products: they fuse with the kernel, so that no array of rays
    # times geoms is ever stored, and a GPU does not round them to TensorFloat-32.
    offset, mat = origin - geom.pos, geom.mat
    local = [sum(mat[..., j, i] * offset[..., j] for j in range(3)) for i in range(3)]
    along = [sum(mat[..., j, i] * direction[..., j] for j in range(3)) for i in range(3)]
    return RAY_KERNELS[kind](local, along, xp.moveaxis(geom.size, -1, 0))


def indexed_blocks(geoms: Geoms, transparent: frozenset[str] = frozenset()) -> list[IndexedBlock]:
    """Return the geoms that block rays; compact ones last, as others may hide them, fixed ones together."""
    compact, fixed = (given or (False,) * len(geoms.blocks) for given in (geoms.compact, geoms.fixed))
    found, first = list[IndexedBlock](), 0
    rows = zip(geoms.kinds, geoms.blocks, compact, fixed, geoms.materials, strict=True)
    for kind, block, small, still, material in rows:
        count = len(block.owner)
        if material not in transparent:
            info = GeomBlockInfo(kind, count, first, small or kind in COMPACT_KINDS, still)
            found.append(IndexedBlock(info, block))
        first += count
    # Large geoms first: their hits shorten the rays, and most small ones are then out of reach.
    return sorted(found, key=lambda part: (part.info.compact, part.info.fixed != part.info.compact))


@jax.named_scope("nearest_hits")
def nearest_hits(
    geoms: Geoms,
    origin: Float[Array, "rays 3"],
    direction: Float[Array, "rays 3"],
    query: RayQuery = DEFAULT_QUERY,
    fans: Fans | None = None,
) -> GeomHits:
    """Return the first hit of each ray.

    Args:
        geoms: The geoms.
        origin: Origins of the rays [m] (rays, 3).
        direction: Unit vectors (rays, 3).
        query: Options.
        fans: The same rays as fans, if they are: a GPU rotates them where it needs them.
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
    """As `nearest_hits`: all rays against each geom."""
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
    """As `nearest_hits`, on Warp; see `raycast_warp`."""
    # Here, as Warp belongs to an extra.
    from usarmjx.sensors.rays.warp_launches import nearest_of_bundles

    wanted = jnp.ones((), bool) if query.wanted is None else query.wanted
    found = nearest_of_bundles(
        seen,
        rays,
        (query.exclude_owner, wanted),
        bundle_size=query.bundle_size,
        max_distance=query.max_distance,
        least_cosines=query.least_cosines,
    )
    return GeomHits(*found)


def cast_rays(
    geoms: Geoms,
    origin: Float[Array, "rays 3"],
    direction: Float[Array, "rays 3"],
    query: RayQuery = DEFAULT_QUERY,
    fans: Fans | None = None,
) -> Hits:
    """Return the first hit of each ray, see `nearest_hits`, with its angle if the query asks for it.

    Rays with a zero direction hit nothing. Distances are differentiable, see `targets.differentiable_cast`;
    angles are constants.
    """
    lines, frames = (None, ()) if fans is None else (fans.directions, (fans.pos, fans.mat))
    # Directions of fans are static: a GPU keeps them as constants.
    first = differentiable_cast(partial(_nearest_of_frames, lines), geoms, origin, direction, query, *frames)
    cosine: Array = jnp.zeros_like(first.distance)
    if query.incidence:
        cosine = _incidence(query, lines, *jax.lax.stop_gradient((geoms, first, origin, direction, *frames)))
    distance = first.distance
    if fans is None:
        # Zero directions mark unused rays; fans have none.
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
    """Return the cosine between each ray and the surface at its hit (rays,); frames as below."""
    if warp_in_use():
        from usarmjx.sensors.rays.incidence_warp import cosines_of_hits
        from usarmjx.sensors.rays.warp_launches import finds_first_only

        seen = indexed_blocks(geoms, query.transparent)
        if lines is not None and finds_first_only(seen, lines, query.least_cosines):
            # Hits at flatter angles have been left out, so any cosine that passes the sensor's test will do.
            return jnp.where(first.geom_index >= 0, 1.0, 0.0)
        rays = (origin, direction) if lines is None else Fans(frames[0], frames[1], lines)
        return cosines_of_hits(seen, rays, first)
    # The host of a GPU would have to wait for the condition; computing is quicker.
    wanted = None if jax.default_backend() == "gpu" else query.wanted
    return masked_cast(wanted, _cosines, NO_COSINE, geoms, first, origin, direction)


def _nearest_of_frames(
    lines: np.ndarray | None,
    geoms: Geoms,
    origin: Array,
    direction: Array,
    query: RayQuery,
    *frames: Array,
) -> GeomHits:
    """As `nearest_hits`, with the directions of fans as a static argument."""
    fans = None if lines is None else Fans(frames[0], frames[1], lines)
    return nearest_hits(geoms, origin, direction, query, fans)


def _cosines(geoms: Geoms, first: GeomHits, origin: jax.Array, direction: jax.Array) -> jax.Array:
    return jnp.abs((normals(geoms, first, origin, direction) * direction).sum(-1))
