"""What there is to hit: geoms by kind and material, as arrays."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UnsupportedGeomError
from usarmjx.models.build.pieces import HFIELD, MESH
from usarmjx.models.spec.shapes import OPAQUE
from usarmjx.sensors.rays.kernels import RAY_KERNELS

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
