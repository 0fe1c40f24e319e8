"""The raycaster that all sensors share: one small kernel per geom type, one table, a loud refusal.

MJX's own `ray` misses cylinders and height fields without a word. Conventions are those of C MuJoCo's
`mj_ray`: the distance to the first surface crossed, from inside a solid too, in units of the direction's
length (directions here are unit vectors, so metres); a plane is seen from its front only.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.errors import UnsupportedGeomError
from usarmjx.transforms import Array

TINY = 1e-12
"""Stands in for a zero component of a direction, so that slabs parallel to a ray divide safely."""
FAR_AWAY = 1e6
"""Where padding geoms are parked [m]."""

GeomType = mujoco.mjtGeom


class Block(struct.PyTreeNode, kw_only=True):
    """Geoms of one type.

    Attributes:
        pos: Centres [m] (geoms, 3).
        mat: Orientations (geoms, 3, 3).
        size: MuJoCo size numbers [m] (geoms, 3).
        owner: Robot slot that the geom belongs to; -1 for the arena (geoms,).
    """

    pos: Array
    mat: Array
    size: Array
    owner: Array


class Geoms(struct.PyTreeNode, kw_only=True):
    """All that rays can hit in one world, by type; `types` holds the MuJoCo type of each block."""

    blocks: tuple[Block, ...]
    types: tuple[int, ...] = struct.field(pytree_node=False)


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


# Each kernel takes a ray in the geom's frame, origin and direction as (3, ...) arrays, and the geom's
# size as (3, ...), and returns the distance to its surface (...), infinite for a miss.


def _nearest(*candidates: jax.Array) -> jax.Array:
    """The smallest of the candidates that are not behind the origin."""
    ahead = [jnp.where(t >= 0, t, jnp.inf) for t in candidates]
    out = ahead[0]
    for t in ahead[1:]:
        out = jnp.minimum(out, t)
    return out


def ray_plane(origin: jax.Array, direction: jax.Array, size: jax.Array) -> jax.Array:
    """Distance to a plane through the frame's origin with normal z; sizes 0 mean unbounded."""
    t = jnp.where(direction[2] < -TINY, -origin[2] / jnp.where(direction[2] < -TINY, direction[2], -1), -1)
    inside = jnp.ones_like(t, bool)
    for axis in (0, 1):
        inside &= (size[axis] <= 0) | (jnp.abs(origin[axis] + t * direction[axis]) <= size[axis])
    return jnp.where(inside & (t >= 0), t, jnp.inf)


def ray_box(origin: jax.Array, direction: jax.Array, size: jax.Array) -> jax.Array:
    """Distance to a box with half lengths `size`: the slab method."""
    near, far = jnp.asarray(-jnp.inf), jnp.asarray(jnp.inf)
    for axis in range(3):
        step = jnp.where(jnp.abs(direction[axis]) < TINY, TINY, direction[axis])
        a, b = (-size[axis] - origin[axis]) / step, (size[axis] - origin[axis]) / step
        near, far = jnp.maximum(near, jnp.minimum(a, b)), jnp.minimum(far, jnp.maximum(a, b))
    return jnp.where(near <= far, _nearest(near, far), jnp.inf)


def _ball(origin: jax.Array, direction: jax.Array, radius: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Both crossings of a sphere, NaN-free: infinite when the ray misses."""
    middle = -(origin * direction).sum(0)
    # The squared distance of the centre from the ray, by the foot point: |o|^2 - m^2 would cancel.
    foot = origin + middle * direction
    under = radius**2 - (foot * foot).sum(0)
    root = jnp.sqrt(jnp.maximum(under, 0.0))
    hit = under >= 0
    return jnp.where(hit, middle - root, jnp.inf), jnp.where(hit, middle + root, jnp.inf)


def ray_sphere(origin: jax.Array, direction: jax.Array, size: jax.Array) -> jax.Array:
    """Distance to a sphere of radius `size[0]`."""
    return _nearest(*_ball(origin, direction, size[0]))


def _tube(origin: jax.Array, direction: jax.Array, radius: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Both crossings of an unbounded tube about z."""
    flat = direction[0] ** 2 + direction[1] ** 2
    safe = jnp.maximum(flat, TINY)
    middle = -(origin[0] * direction[0] + origin[1] * direction[1]) / safe
    x, y = origin[0] + middle * direction[0], origin[1] + middle * direction[1]
    under = radius**2 - x * x - y * y
    half = jnp.sqrt(jnp.maximum(under, 0.0) / safe)
    hit = (under >= 0) & (flat > TINY)
    return jnp.where(hit, middle - half, jnp.inf), jnp.where(hit, middle + half, jnp.inf)


def _within(t: jax.Array, z: jax.Array, low: jax.Array | float, high: jax.Array | float) -> jax.Array:
    return jnp.where((z >= low) & (z <= high), t, jnp.inf)


def ray_cylinder(origin: jax.Array, direction: jax.Array, size: jax.Array) -> jax.Array:
    """Distance to a cylinder about z with radius `size[0]` and half length `size[1]`."""
    radius, half = size[0], size[1]
    sides = [_within(t, origin[2] + t * direction[2], -half, half) for t in _tube(origin, direction, radius)]
    step = jnp.where(jnp.abs(direction[2]) < TINY, TINY, direction[2])
    caps = []
    for end in (-half, half):
        t = (end - origin[2]) / step
        x, y = origin[0] + t * direction[0], origin[1] + t * direction[1]
        caps.append(jnp.where(x * x + y * y <= radius**2, t, jnp.inf))
    return _nearest(*sides, *caps)


def ray_capsule(origin: jax.Array, direction: jax.Array, size: jax.Array) -> jax.Array:
    """Distance to a capsule about z with radius `size[0]` and half length `size[1]` of its tube."""
    radius, half = size[0], size[1]
    hits = [_within(t, origin[2] + t * direction[2], -half, half) for t in _tube(origin, direction, radius)]
    for end, low, high in ((half, half, jnp.inf), (-half, -jnp.inf, -half)):
        shifted = jnp.stack([origin[0] + 0 * end, origin[1] + 0 * end, origin[2] - end])
        for t in _ball(shifted, direction, radius):
            hits.append(_within(t, origin[2] + t * direction[2], low, high))
    return _nearest(*hits)


def ray_ellipsoid(origin: jax.Array, direction: jax.Array, size: jax.Array) -> jax.Array:
    """Distance to an ellipsoid with radii `size`: a unit ball where every axis is measured in its radius."""
    start, along = origin / size, direction / size
    stretch = (along * along).sum(0)
    middle = -(start * along).sum(0) / stretch
    foot = start + middle * along  # as in `_ball`
    under = 1.0 - (foot * foot).sum(0)
    half = jnp.sqrt(jnp.maximum(under, 0.0) / stretch)
    return jnp.where(under >= 0, _nearest(middle - half, middle + half), jnp.inf)


KERNELS: dict[int, Callable[[jax.Array, jax.Array, jax.Array], jax.Array]] = {
    int(GeomType.mjGEOM_PLANE): ray_plane,
    int(GeomType.mjGEOM_BOX): ray_box,
    int(GeomType.mjGEOM_SPHERE): ray_sphere,
    int(GeomType.mjGEOM_CAPSULE): ray_capsule,
    int(GeomType.mjGEOM_CYLINDER): ray_cylinder,
    int(GeomType.mjGEOM_ELLIPSOID): ray_ellipsoid,
}


def check_types(geom_types: Sequence[int], names: Sequence[str]) -> None:
    """Refuse geoms that no kernel can hit.

    Raises:
        UnsupportedGeomError: Names the types and the geoms.
    """
    bad = [(int(t), name) for t, name in zip(geom_types, names, strict=True) if int(t) not in KERNELS]
    if bad:
        types = sorted({GeomType(t).name for t, _ in bad})
        raise UnsupportedGeomError(f"no ray kernel for {types}; used by {[name for _, name in bad]}")


def gather(geom_type: np.ndarray, pos: jax.Array, mat: jax.Array, size: jax.Array, owner: jax.Array) -> Geoms:
    """Sort geoms (pos (n, 3), mat (n, 3, 3), size (n, 3), owner (n,)) into blocks by type."""
    types = sorted({int(t) for t in geom_type})
    picks = [np.flatnonzero(geom_type == t) for t in types]
    blocks = tuple(Block(pos=pos[i], mat=mat[i], size=size[i], owner=owner[i]) for i in picks)
    return Geoms(blocks=blocks, types=tuple(types))


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


def cast(geoms: Geoms, origin: jax.Array, direction: jax.Array, viewer: jax.Array) -> Hits:
    """Return the distance to the first surface that each ray meets (rays,); no angles.

    Args:
        geoms: What there is to hit.
        origin: Starts of the rays [m] (rays, 3).
        direction: Unit vectors (rays, 3).
        viewer: Slot of the robot that looks; its own geoms are transparent to it ().
    """

    def one(start: jax.Array, along: jax.Array) -> jax.Array:
        nearest = jnp.asarray(jnp.inf)
        for kind, block in zip(geoms.types, geoms.blocks, strict=True):
            nearest = jnp.minimum(nearest, _distances(kind, block, start, along, viewer).min())
        return nearest

    distance = jax.vmap(one)(origin, direction)
    return Hits(distance=distance, cosine=jnp.zeros_like(distance))


def _surface_cosine(kind: int, point: jax.Array, direction: jax.Array, size: jax.Array) -> jax.Array:
    """|cos| between a ray and the normal of the surface it meets at `point`, both in the geom's frame."""
    if kind == GeomType.mjGEOM_PLANE:
        normal = jnp.array([0.0, 0.0, 1.0])
    elif kind == GeomType.mjGEOM_BOX:
        normal = jax.nn.one_hot(jnp.argmax(jnp.abs(point) - size), 3)
    elif kind == GeomType.mjGEOM_ELLIPSOID:
        normal = point / size**2
        normal = normal / jnp.maximum(jnp.linalg.norm(normal), TINY)
    else:
        tube = kind != GeomType.mjGEOM_SPHERE
        axis_point = jnp.array([0.0, 0.0, 1.0]) * jnp.clip(point[2], -size[1], size[1]) * tube
        normal = point - axis_point
        normal = normal / jnp.maximum(jnp.linalg.norm(normal), TINY)
        if kind == GeomType.mjGEOM_CYLINDER:
            on_cap = size[1] - jnp.abs(point[2]) < size[0] - jnp.hypot(point[0], point[1])
            normal = jnp.where(on_cap, jnp.array([0.0, 0.0, 1.0]), normal)
    return jnp.abs(jnp.dot(normal, direction))


def cast_incidence(geoms: Geoms, origin: jax.Array, direction: jax.Array, viewer: jax.Array) -> Hits:
    """As `cast`, with the angle at which each ray meets its surface.

    The nearest geom of each type is picked first and its distance computed again: one reduction over
    all geoms, a handful of operations for the angle.
    """

    def one(start: jax.Array, along: jax.Array) -> Hits:
        nearest, cosine = jnp.asarray(jnp.inf), jnp.asarray(0.0)
        for kind, block in zip(geoms.types, geoms.blocks, strict=True):
            geom = block
            if len(block.owner) > 1:
                best = jnp.argmin(_distances(kind, block, start, along, viewer))
                geom = jax.tree.map(lambda x, i=best: jax.lax.dynamic_index_in_dim(x, i), block)
            distance = _distances(kind, geom, start, along, viewer)[0]
            local, turned = geom.mat[0].T @ (start - geom.pos[0]), geom.mat[0].T @ along
            reach = jnp.where(jnp.isfinite(distance), distance, 0.0)
            angle = _surface_cosine(kind, local + reach * turned, turned, geom.size[0])
            cosine = jnp.where(distance < nearest, angle, cosine)
            nearest = jnp.minimum(nearest, distance)
        return Hits(distance=nearest, cosine=cosine)

    return jax.vmap(one)(origin, direction)
