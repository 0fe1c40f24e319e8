"""Ray targets: geoms by type and material as arrays, their hits, normals and gradients."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct
from jax.custom_batching import custom_vmap

from usarmjx.base.backend import Array
from usarmjx.base.errors import UnsupportedGeomError
from usarmjx.base.nodes import Node
from usarmjx.base.rotations import matvec
from usarmjx.models.compile.ray_geoms import HFIELD, MESH
from usarmjx.models.types.shapes import OPAQUE
from usarmjx.sensors.rays.kernels import RAY_KERNELS, surface_normal

PADDING_DISTANCE = 1e6
"""Coordinate of padding geoms [m]."""


GeomType = mujoco.mjtGeom


MIN_GRADIENT_COSINE = 1e-3
"""Lowest cosine of incidence in gradients."""


class GeomBlockInfo(NamedTuple):
    """Static properties of a block: geom type, number of geoms, index of the first, and as in `Geoms`."""

    kind: int
    num_geoms: int
    first_index: int
    compact: bool
    fixed: bool = False


class GeomBlock(Node, kw_only=True):
    """Geoms of one type and material.

    Attributes:
        pos: Centres, or the first corners of triangles [m] (geoms, 3).
        mat: Orientations (geoms, 3, 3).
        size: MuJoCo sizes, or those defined in `models.compile.ray_geoms` [m] (geoms, 3).
        owner: Slot of the robot; -1 for the arena (geoms,).
    """

    pos: Array
    mat: Array
    size: Array
    owner: Array


class Geoms(Node, kw_only=True):
    """Geoms of one world.

    Attributes:
        blocks: Geoms by type and material.
        kinds: Geom type of each block: MuJoCo's, or one of `models.compile.ray_geoms`.
        materials: Material of each block; a member of `shapes.MATERIALS`.
        compact: Whether the bounding sphere is a good approximation of each geom of a block, as for robots'
            parts and unlike walls; empty: false for all.
        fixed: Whether each block is where it is in all worlds and at all times; empty: false for all.
    """

    blocks: tuple[GeomBlock, ...]
    kinds: tuple[int, ...] = struct.field(pytree_node=False)
    materials: tuple[str, ...] = struct.field(pytree_node=False)
    compact: tuple[bool, ...] = struct.field(pytree_node=False, default=())
    fixed: tuple[bool, ...] = struct.field(pytree_node=False, default=())


def check_ray_kinds(geom_types: Sequence[int], names: Sequence[str]) -> None:
    """Refuse geoms without a ray kernel.

    Raises:
        UnsupportedGeomError: Names the types and the geoms.
    """
    known = {*RAY_KERNELS, MESH, HFIELD}  # meshes and height fields become triangles
    bad = [(int(t), name) for t, name in zip(geom_types, names, strict=True) if int(t) not in known]
    if bad:
        types = sorted({GeomType(t).name for t, _ in bad})
        raise UnsupportedGeomError(f"no ray kernel for {types}; used by {[name for _, name in bad]}")


def indices_by_key(kind: np.ndarray, *others: Sequence[Any]) -> dict[Any, np.ndarray]:
    """Return the indices of geoms of each type (n,), material (n,) and so on, sorted by these."""
    indices: dict[Any, list[int]] = {}
    for i, sort in enumerate(zip(map(int, kind), *others, strict=True)):
        indices.setdefault(sort, []).append(i)
    # Sorted, so that the order of blocks, and with it every program, does not depend on the order of geoms.
    return {sort: np.array(indices[sort]) for sort in sorted(indices)}


def make_geoms(
    kind: np.ndarray,
    pos: Array,
    mat: Array,
    size: Array,
    owner: Array,
    material: Sequence[str] | None = None,
    compact: Sequence[bool] | None = None,
) -> Geoms:
    """Sort geoms into blocks by type, material and compactness, in the given order within each.

    Args:
        kind: Geom types (n,).
        pos: Positions [m] (n, 3).
        mat: Orientations (n, 3, 3).
        size: Sizes [m] (n, 3).
        owner: Owners (n,).
        material: Materials; None: all opaque.
        compact: See `Geoms` (n,); None: false for all.
    """
    made_of = [OPAQUE] * len(kind) if material is None else material
    indices = indices_by_key(kind, made_of, [False] * len(kind) if compact is None else compact)
    return Geoms(
        blocks=tuple(
            GeomBlock(pos=pos[i], mat=mat[i], size=size[i], owner=owner[i]) for i in indices.values()
        ),
        kinds=tuple(sort[0] for sort in indices),
        materials=tuple(sort[1] for sort in indices),
        compact=tuple(bool(sort[2]) for sort in indices),
    )


class GeomHits(NamedTuple):
    """First hits of rays.

    Attributes:
        distance: Distance, infinite without a hit [m] (rays,).
        geom_index: Index of the geom in all blocks; -1 for none (rays,).
    """

    distance: jax.Array
    geom_index: jax.Array

    def closer(self, distance: jax.Array, index: jax.Array) -> "GeomHits":
        """Return the closer ones of these hits and others."""
        better = distance < self.distance
        return GeomHits(jnp.where(better, distance, self.distance), jnp.where(better, index, self.geom_index))

    def met(self) -> "GeomHits":
        """Return the hits with an infinite distance where nothing was hit."""
        return GeomHits(jnp.where(self.geom_index < 0, jnp.inf, self.distance), self.geom_index)


def concatenated(geoms: Geoms) -> GeomBlock:
    """Return all geoms as one block."""
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *geoms.blocks)


def normals(geoms: Geoms, first: GeomHits, origin: jax.Array, direction: jax.Array) -> jax.Array:
    """Return the unit normals at the hits, in world axes and towards the rays (rays, 3).

    They are zero without a hit.
    """
    # Misses read the first geom, since arrays have no entry for none; `mine` drops their values.
    geom = jax.tree.map(lambda x: x[jnp.maximum(first.geom_index, 0)], concatenated(geoms))
    reach = jnp.where(first.geom_index >= 0, first.distance, 0.0)[:, None]
    offset = origin + reach * direction - geom.pos
    # Sums of products and no `@`, which a GPU computes with TensorFloat-32 by default.
    point = jnp.stack([sum(geom.mat[:, j, i] * offset[:, j] for j in range(3)) for i in range(3)], -1)
    normal, before = jnp.zeros_like(point), 0
    for kind, block in zip(geoms.kinds, geoms.blocks, strict=True):
        mine = (first.geom_index >= before) & (first.geom_index < before + len(block.owner))
        normal = jnp.where(mine[:, None], surface_normal(kind, point, geom.size), normal)
        before += len(block.owner)
    turned = jnp.stack([sum(geom.mat[:, i, j] * normal[:, j] for j in range(3)) for i in range(3)], -1)
    # Triangles and surfaces seen from inside face the other way.
    return jnp.where((turned * direction).sum(-1, keepdims=True) > 0, -turned, turned)


def differentiable_cast(
    cast: Callable[..., GeomHits],
    geoms: Geoms,
    origin: Array,
    direction: Array,
    *others: Any,  # noqa: ANN401 - of the caster
) -> GeomHits:
    """Return `cast(geoms, origin, direction, *others)` with differentiable distances.

    Forward and reverse mode, for any caster: the hit geom counts as constant, and its surface as the tangent
    plane. Gradients are with respect to the poses of rays and geoms, not to the geoms' sizes.
    """
    return _cast(cast, geoms, origin, direction, *others)


def _cast_unchanged(cast: Callable[..., GeomHits], *values: Any) -> GeomHits:  # noqa: ANN401 - of the caster
    return cast(*values)


def _cast_gradient(
    cast: Callable[..., GeomHits], values: tuple[Any, ...], rates: tuple[Any, ...]
) -> tuple[GeomHits, GeomHits]:
    geoms, origin, direction = values[:3]
    first = differentiable_cast(cast, *values)
    met, which = first.geom_index >= 0, jnp.maximum(first.geom_index, 0)
    reach = jnp.where(met, first.distance, 0.0)[:, None]
    normal = normals(geoms, first, origin, direction)

    def placed(seen: Geoms) -> tuple[Array, Array]:
        pos, mat = ([getattr(block, name) for block in seen.blocks] for name in ("pos", "mat"))
        return jnp.concatenate(pos)[which], jnp.concatenate(mat)[which]

    (pos, mat), (pos_rate, mat_rate) = placed(geoms), placed(rates[0])
    # The normal in the geom's axes turns with it.
    own = matvec(jnp.swapaxes(mat, -1, -2), normal)
    # Implicit differentiation: normal . (point of the ray - point of the surface) stays 0 at the hit.
    rate = rates[1] + reach * rates[2] - pos_rate
    away = (normal * rate + matvec(mat_rate, own) * (origin + reach * direction - pos)).sum(-1)
    # Bounded: the gradient of a grazing hit diverges.
    facing = jnp.minimum((normal * direction).sum(-1), -MIN_GRADIENT_COSINE)
    slope = jnp.where(met, -away / facing, 0.0)
    # JAX wants derivatives of whole numbers to have this type.
    return first, GeomHits(slope, np.zeros(which.shape, jax.dtypes.float0))  # type: ignore - of whole numbers


_cast: Any = jax.custom_jvp(_cast_unchanged, nondiff_argnums=(0,))
_cast.defjvp(_cast_gradient)


def merge_vmaps(run: Callable[..., Any]) -> Callable[..., Any]:
    """Return `run(geoms, world, *casts)` with a batching rule: vmaps lengthen its axes.

    `geoms` has an axis over worlds, `world` has the world of each cast (casts,), and all other arguments and
    the results have an axis over casts. Both may be tuples, of geoms in worlds of their own.
    """
    call = custom_vmap(run)

    @call.def_vmap
    def mapped(size: int, batched: Any, geoms: Any, world: Any, *casts: Array) -> tuple[Any, Any]:  # noqa: ANN401 - trees
        def spread(x: Array, own: bool) -> Array:
            return x if own else jnp.broadcast_to(x, (size, *x.shape))

        def number(one: Array, x: Array, own: bool) -> Array:
            # Separate worlds: number them consecutively, one batch entry after the other.
            return one + x.shape[1] * jnp.arange(size, dtype=jnp.int32)[:, None] if own else one

        def flat(x: Array) -> Array:
            return x.reshape(-1, *x.shape[2:])

        world = jax.tree.map(number, jax.tree.map(spread, world, batched[1]), geoms, batched[0])
        # Geoms shared by the batch stay one world: copies would fill the memory.
        geoms = jax.tree.map(lambda x, own: flat(x) if own else x, geoms, batched[0])
        rest = [spread(x, own) for x, own in zip(casts, batched[2:], strict=True)]
        # Wrapped again: an outer `vmap` calls this rule once more, with longer axes.
        found = merge_vmaps(run)(geoms, jax.tree.map(flat, world), *map(flat, rest))
        shape = jax.tree.leaves(world)[0].shape
        found = jax.tree.map(lambda x: x.reshape(*shape, *x.shape[1:]), found)
        return found, jax.tree.map(lambda _: True, found)

    return call
