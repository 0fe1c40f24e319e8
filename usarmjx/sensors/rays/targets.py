"""What there is to hit: geoms by kind and material, as arrays."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UnsupportedGeomError
from usarmjx.base.rotations import matvec
from usarmjx.models.compile.ray_geoms import HFIELD, MESH
from usarmjx.models.types.shapes import OPAQUE
from usarmjx.sensors.rays.kernels import RAY_KERNELS, surface_normal

PADDING_DISTANCE = 1e6
"""Where padding geoms are parked [m]."""


GeomType = mujoco.mjtGeom


BlockKey = tuple[int, str]
"""Kind and material of geoms: those of one sort make a block."""


class GeomBlockInfo(NamedTuple):
    """What is known of geoms while compiling: kind, how many, index of the first, and if they are compact."""

    kind: int
    num_geoms: int
    first_index: int
    compact: bool


class GeomBlock(struct.PyTreeNode, kw_only=True):
    """Geoms of one kind and material.

    Attributes:
        pos: Centres, of triangles the first corners [m] (geoms, 3).
        mat: Orientations (geoms, 3, 3).
        size: MuJoCo's size numbers, or those that `models.build.pieces` tells of [m] (geoms, 3).
        owner: Robot slot that the geom belongs to; -1 for the arena (geoms,).
    """

    pos: Array
    mat: Array
    size: Array
    owner: Array


class Geoms(struct.PyTreeNode, kw_only=True):
    """All that rays can hit in one world.

    Attributes:
        blocks: The geoms, by kind and material.
        kinds: What kind each block is of: MuJoCo's type, or a kind of `models.build.pieces`.
        materials: What each block is made of; a member of `spec.MATERIALS`.
        compact: Whether the bounding sphere of each geom of a block is a fair picture of it, as of robots'
            parts and unlike of walls; empty: of none.
    """

    blocks: tuple[GeomBlock, ...]
    kinds: tuple[int, ...] = struct.field(pytree_node=False)
    materials: tuple[str, ...] = struct.field(pytree_node=False)
    compact: tuple[bool, ...] = struct.field(pytree_node=False, default=())


def check_ray_kinds(geom_types: Sequence[int], names: Sequence[str]) -> None:
    """Refuse geoms that no kernel can hit.

    Raises:
        UnsupportedGeomError: Names the types and the geoms.
    """
    known = {*RAY_KERNELS, MESH, HFIELD}  # the latter two as triangles
    bad = [(int(t), name) for t, name in zip(geom_types, names, strict=True) if int(t) not in known]
    if bad:
        types = sorted({GeomType(t).name for t, _ in bad})
        raise UnsupportedGeomError(f"no ray kernel for {types}; used by {[name for _, name in bad]}")


def indices_by_key(kind: np.ndarray, *others: Sequence[Any]) -> dict[Any, np.ndarray]:
    """Return the places of geoms of each kind (n,), material (n,) and so on, sorted by these."""
    indices: dict[Any, list[int]] = {}
    for i, sort in enumerate(zip(map(int, kind), *others, strict=True)):
        indices.setdefault(sort, []).append(i)
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
    """Sort geoms into blocks by kind, material and compactness, in the order given within each.

    Args:
        kind: Their kinds (n,).
        pos: Positions [m] (n, 3).
        mat: Orientations (n, 3, 3).
        size: Size numbers [m] (n, 3).
        owner: Owners (n,).
        material: What each is made of; None: all opaque.
        compact: See `Geoms` (n,); None: none is.
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


FLATTEST = 1e-3
"""A ray that meets a surface at a smaller cosine counts as one that meets it at this one, for slopes."""


class GeomHits(NamedTuple):
    """What rays meet first.

    Attributes:
        distance: How far away, infinite where there is nothing [m] (rays,).
        geom_index: Which geom of all blocks, one block after the other; -1 for none (rays,).
    """

    distance: jax.Array
    geom_index: jax.Array

    def closer(self, distance: jax.Array, index: jax.Array) -> "GeomHits":
        """Return what is closer, this or something else."""
        better = distance < self.distance
        return GeomHits(jnp.where(better, distance, self.distance), jnp.where(better, index, self.geom_index))

    def met(self) -> "GeomHits":
        """Return it with an infinite distance where nothing was met."""
        return GeomHits(jnp.where(self.geom_index < 0, jnp.inf, self.distance), self.geom_index)


def concatenated(geoms: Geoms) -> GeomBlock:
    """Return all geoms as one block, one block after the other."""
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *geoms.blocks)


def normals(geoms: Geoms, first: GeomHits, origin: jax.Array, direction: jax.Array) -> jax.Array:
    """Return the unit normals of the surfaces that rays meet, in world axes and towards the rays (rays, 3).

    They are zero where nothing was met.
    """
    geom = jax.tree.map(lambda x: x[jnp.maximum(first.geom_index, 0)], concatenated(geoms))
    reach = jnp.where(first.geom_index >= 0, first.distance, 0.0)[:, None]
    offset = origin + reach * direction - geom.pos
    point = jnp.stack([sum(geom.mat[:, j, i] * offset[:, j] for j in range(3)) for i in range(3)], -1)
    normal, before = jnp.zeros_like(point), 0
    for kind, block in zip(geoms.kinds, geoms.blocks, strict=True):
        mine = (first.geom_index >= before) & (first.geom_index < before + len(block.owner))
        normal = jnp.where(mine[:, None], surface_normal(kind, point, geom.size), normal)
        before += len(block.owner)
    turned = jnp.stack([sum(geom.mat[:, i, j] * normal[:, j] for j in range(3)) for i in range(3)], -1)
    return jnp.where((turned * direction).sum(-1, keepdims=True) > 0, -turned, turned)


def sloped(
    cast: Callable[..., GeomHits],
    geoms: Geoms,
    origin: Array,
    direction: Array,
    *others: Any,  # noqa: ANN401 - of the caster
) -> GeomHits:
    """Return what `cast(geoms, origin, direction, *others)` says; its distances can be differentiated.

    In both modes, whatever casts: what is met first stays so for a small change, and the surface counts as
    its plane there. Slopes are by where rays and geoms are, not by how large geoms are.
    """
    return _cast(cast, geoms, origin, direction, *others)


def _as_it_is(cast: Callable[..., GeomHits], *values: Any) -> GeomHits:  # noqa: ANN401 - of the caster
    return cast(*values)


def _slopes(
    cast: Callable[..., GeomHits], values: tuple[Any, ...], rates: tuple[Any, ...]
) -> tuple[GeomHits, GeomHits]:
    geoms, origin, direction = values[:3]
    first = sloped(cast, *values)
    met, which = first.geom_index >= 0, jnp.maximum(first.geom_index, 0)
    reach = jnp.where(met, first.distance, 0.0)[:, None]
    normal = normals(geoms, first, origin, direction)

    def placed(seen: Geoms) -> tuple[Array, Array]:
        pos, mat = ([getattr(block, name) for block in seen.blocks] for name in ("pos", "mat"))
        return jnp.concatenate(pos)[which], jnp.concatenate(mat)[which]

    (pos, mat), (pos_rate, mat_rate) = placed(geoms), placed(rates[0])
    own = matvec(jnp.swapaxes(mat, -1, -2), normal)
    rate = rates[1] + reach * rates[2] - pos_rate
    away = (normal * rate + matvec(mat_rate, own) * (origin + reach * direction - pos)).sum(-1)
    facing = jnp.minimum((normal * direction).sum(-1), -FLATTEST)
    slope = jnp.where(met, -away / facing, 0.0)
    return first, GeomHits(slope, np.zeros(which.shape, jax.dtypes.float0))  # type: ignore - of whole numbers


_cast: Any = jax.custom_jvp(_as_it_is, nondiff_argnums=(0,))
_cast.defjvp(_slopes)
