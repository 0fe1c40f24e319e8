"""The raycaster that all sensors share: what there is to hit, and casts that pass what a sensor sees through.

MJX's own `ray` misses cylinders and height fields without a word. Conventions are those of C MuJoCo's
`mj_ray`: the distance to the first surface crossed, from inside a solid too, in units of the direction's
length (directions here are unit vectors, so metres); a plane is seen from its front only. Meshes and terrain
are seen as their triangles, see `models.pieces`.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.errors import UnsupportedGeomError
from usarmjx.models.pieces import HFIELD, MESH
from usarmjx.models.spec import OPAQUE
from usarmjx.sensors.kernels import KERNELS, surface_cosine
from usarmjx.transforms import Array

FAR_AWAY = 1e6
"""Where padding geoms are parked [m]."""

GeomType = mujoco.mjtGeom


Sort = tuple[int, str]
"""Kind and material of geoms: those of one sort make a block."""


class Block(struct.PyTreeNode, kw_only=True):
    """Geoms of one kind and material.

    Attributes:
        pos: Centres, of triangles the first corners [m] (geoms, 3).
        mat: Orientations (geoms, 3, 3).
        size: MuJoCo's size numbers, or those that `models.pieces` tells of [m] (geoms, 3).
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
        types: What kind each block is of: MuJoCo's type, or a kind of `models.pieces`.
        materials: What each block is made of; a member of `spec.MATERIALS`.
    """

    blocks: tuple[Block, ...]
    types: tuple[int, ...] = struct.field(pytree_node=False)
    materials: tuple[str, ...] = struct.field(pytree_node=False)

    def seen(self, passes: frozenset[str]) -> tuple[tuple[int, Block], ...]:
        """Return kinds and blocks without those of materials that rays pass."""
        return tuple(
            (kind, block)
            for kind, block, material in zip(self.types, self.blocks, self.materials, strict=True)
            if material not in passes
        )


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


def check_types(geom_types: Sequence[int], names: Sequence[str]) -> None:
    """Refuse geoms that no kernel can hit.

    Raises:
        UnsupportedGeomError: Names the types and the geoms.
    """
    known = {*KERNELS, MESH, HFIELD}  # the latter two as triangles
    bad = [(int(t), name) for t, name in zip(geom_types, names, strict=True) if int(t) not in known]
    if bad:
        types = sorted({GeomType(t).name for t, _ in bad})
        raise UnsupportedGeomError(f"no ray kernel for {types}; used by {[name for _, name in bad]}")


def sort_places(kind: np.ndarray, material: Sequence[str]) -> dict[Sort, np.ndarray]:
    """Return the places of geoms of each kind (n,) and material (n,), sorted by these."""
    places: dict[Sort, list[int]] = {}
    for i, sort in enumerate(zip(map(int, kind), material, strict=True)):
        places.setdefault(sort, []).append(i)
    return {sort: np.array(places[sort]) for sort in sorted(places)}


def gather(
    kind: np.ndarray, pos: Array, mat: Array, size: Array, owner: Array, material: Sequence[str] | None = None
) -> Geoms:
    """Sort geoms into blocks by kind and material, in the order given within each.

    Args:
        kind: Their kinds (n,).
        pos: Positions [m] (n, 3).
        mat: Orientations (n, 3, 3).
        size: Size numbers [m] (n, 3).
        owner: Owners (n,).
        material: What each is made of; None: all opaque.
    """
    places = sort_places(kind, [OPAQUE] * len(kind) if material is None else material)
    return Geoms(
        blocks=tuple(Block(pos=pos[i], mat=mat[i], size=size[i], owner=owner[i]) for i in places.values()),
        types=tuple(sort[0] for sort in places),
        materials=tuple(sort[1] for sort in places),
    )


def _distances(
    kind: int, block: Block, origin: jax.Array, direction: jax.Array, viewer: jax.Array
) -> jax.Array:
    """Distance of every geom of a block along one ray (geoms,), the viewer's own left out."""
    # Sums of products instead of matrix products: they fuse with the kernel, so that no array of rays
    # times geoms is ever stored, and a GPU does not round them to TensorFloat-32.
    offset, mat = origin - block.pos, block.mat
    local = jnp.stack([sum(mat[:, j, i] * offset[:, j] for j in range(3)) for i in range(3)])
    along = jnp.stack([sum(mat[:, j, i] * direction[j] for j in range(3)) for i in range(3)])
    t = KERNELS[kind](local, along, block.size.T)
    return jnp.where(block.owner == viewer, jnp.inf, t)


def cast(
    geoms: Geoms,
    origin: jax.Array,
    direction: jax.Array,
    viewer: jax.Array,
    passes: frozenset[str] = frozenset(),
) -> Hits:
    """Return the distance to the first surface that each ray meets (rays,); no angles.

    Args:
        geoms: What there is to hit.
        origin: Starts of the rays [m] (rays, 3).
        direction: Unit vectors (rays, 3).
        viewer: Slot of the robot that looks; its own geoms are transparent to it ().
        passes: Materials that the rays go through; static, and without any cost.
    """

    def one(start: jax.Array, along: jax.Array) -> jax.Array:
        nearest = jnp.asarray(jnp.inf)
        for kind, block in geoms.seen(passes):
            nearest = jnp.minimum(nearest, _distances(kind, block, start, along, viewer).min())
        return nearest

    distance = jax.vmap(one)(origin, direction)
    return Hits(distance=distance, cosine=jnp.zeros_like(distance))


def cast_incidence(
    geoms: Geoms,
    origin: jax.Array,
    direction: jax.Array,
    viewer: jax.Array,
    passes: frozenset[str] = frozenset(),
) -> Hits:
    """As `cast`, with the angle at which each ray meets its surface.

    The nearest geom of each block is picked first and its distance computed again: one reduction over
    all geoms, a handful of operations for the angle.
    """

    def one(start: jax.Array, along: jax.Array) -> Hits:
        nearest, cosine = jnp.asarray(jnp.inf), jnp.asarray(0.0)
        for kind, block in geoms.seen(passes):
            geom = block
            if len(block.owner) > 1:
                best = jnp.argmin(_distances(kind, block, start, along, viewer))
                geom = jax.tree.map(lambda x, i=best: jax.lax.dynamic_index_in_dim(x, i), block)
            distance = _distances(kind, geom, start, along, viewer)[0]
            local, turned = geom.mat[0].T @ (start - geom.pos[0]), geom.mat[0].T @ along
            reach = jnp.where(jnp.isfinite(distance), distance, 0.0)
            angle = surface_cosine(kind, local + reach * turned, turned, geom.size[0])
            cosine = jnp.where(distance < nearest, angle, cosine)
            nearest = jnp.minimum(nearest, distance)
        return Hits(distance=nearest, cosine=cosine)

    return jax.vmap(one)(origin, direction)
