"""Solids of engine `planar`: obstacles and ground, projected to the plan, with the plane of their tops.

A solid is a rectangle or a disc on the plan with a height range. A box whose top is less steep than
`MIN_DRIVABLE_COSINE` is drivable where the robot reaches it without a step: ramps and levels.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.backend import Array
from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.base.rotations import mat_from_quat, matmul, matvec
from usarmjx.engines.base import GeomPoses
from usarmjx.engines.planar.overlap import Outlines, outlines

MIN_DRIVABLE_COSINE = math.cos(math.radians(30.0))
"""Cosine of the steepest drivable slope."""
FAR_AWAY = 1e6
"""Coordinate of a solid that touches nothing [m]."""
GEOM_TYPES = {
    int(mujoco.mjtGeom.mjGEOM_BOX),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE),
    int(mujoco.mjtGeom.mjGEOM_SPHERE),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID),
}
"""Supported geom types."""


class PlanSolids(struct.PyTreeNode, kw_only=True):
    """Solids of one world or of many.

    Attributes:
        outline: Outlines on the plan (..., solids).
        low: Lowest point [m] (..., solids).
        top: Height of the top above the centre [m] (..., solids).
        slope_x: Slope of the top along x (..., solids).
        slope_y: Slope of the top along y (..., solids).
        highest: Highest point [m] (..., solids).
        discs: Whether any may be a disc.
    """

    outline: Outlines
    low: Array
    top: Array
    slope_x: Array
    slope_y: Array
    highest: Array
    discs: bool = struct.field(pytree_node=False)

    @property
    def count(self) -> int:
        """Number of solids."""
        return self.low.shape[-1]


def pack_solids(solids: PlanSolids | Array) -> Array:
    """Pack solids (..., k, robots) into one array (..., numbers, k, robots)."""
    # In the order of the leaves, on which the native code's offsets rely.
    return jnp.stack(jax.tree.leaves(solids), -3) if isinstance(solids, PlanSolids) else jnp.asarray(solids)


def unpack_solids(solids: PlanSolids | Array, *, discs: bool) -> PlanSolids:
    """Unpack solids packed by `pack_solids`; `discs` as for those."""
    if isinstance(solids, PlanSolids):
        return solids
    # In the order of the leaves, as `pack_solids` stacks them.
    parts = [solids[..., i, :, :] for i in range(solids.shape[-3])]
    outline, others = Outlines(*parts[: len(Outlines._fields)]), parts[len(Outlines._fields) :]
    low, top, slope_x, slope_y, highest = others
    return PlanSolids(
        outline=outline, low=low, top=top, slope_x=slope_x, slope_y=slope_y, highest=highest, discs=discs
    )


class SolidGeoms(NamedTuple):
    """Geoms of a model that robots can touch, without the robots' own.

    Attributes:
        ids: Geom ids (n,).
        kinds: MuJoCo geom types (n,).
        bodies: Their bodies (n,).
        moved: Indices in `GeomPoses` of geoms that are inputs (n,); -1: fixed to the body.
    """

    ids: np.ndarray
    kinds: np.ndarray
    bodies: np.ndarray
    moved: np.ndarray

    def where(self, mask: np.ndarray) -> "SolidGeoms":
        """Return the masked ones (n,)."""
        return SolidGeoms(*(part[mask] for part in self))


def solid_geoms(model: mujoco.MjModel, robot_bodies: set[int], moved_ids: list[int]) -> SolidGeoms:
    """Return the geoms that robots can touch, without floors.

    Raises:
        UnsupportedFeatureError: A geom type is not supported: meshes and height fields.
    """
    touches = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    others = [g for g in np.flatnonzero(touches).tolist() if model.geom_bodyid[g] not in robot_bodies]
    # Floors are ground everywhere, and no obstacle.
    others = [g for g in others if model.geom_type[g] != mujoco.mjtGeom.mjGEOM_PLANE]
    unsupported = [model.geom(g).name for g in others if int(model.geom_type[g]) not in GEOM_TYPES]
    if unsupported:
        names = ", ".join(map(repr, unsupported[:4]))
        raise UnsupportedFeatureError(
            f"engine 'planar' cannot run this scene: {names} of meshes or height fields; engines c, jax and "
            "warp can"
        )
    ids = np.array(others, int)
    places = {geom: place for place, geom in enumerate(moved_ids)}
    return SolidGeoms(
        ids=ids,
        kinds=model.geom_type[ids],
        bodies=model.geom_bodyid[ids],
        moved=np.array([places.get(geom, -1) for geom in others], int),
    )


def floor_height(model: mujoco.MjModel) -> float:
    """Return the height of the floor [m]; far below everything without one."""
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    # Floors are level: their height is the same everywhere.
    heights = [model.body_pos[model.geom_bodyid[g], 2] + model.geom_pos[g, 2] for g in planes]
    return float(max(heights, default=-FAR_AWAY))


def world_solids(
    model: mujoco.MjModel, geoms: SolidGeoms, bodies: tuple[Array, Array], poses: GeomPoses | None
) -> PlanSolids:
    """Return the solids of one world.

    Args:
        model: The model.
        geoms: Its geoms.
        bodies: Origins (nbody, 3) [m] and orientations (nbody, 3, 3) of the model's bodies.
        poses: Input poses of geoms.
    """
    pos, mat = jnp.asarray(model.geom_pos[geoms.ids]), mat_from_quat(jnp.asarray(model.geom_quat[geoms.ids]))
    size = jnp.asarray(model.geom_size[geoms.ids])
    if poses is not None:
        # Geoms fixed to their body (-1) read the first pose, which `where` throws away.
        is_moved, place = geoms.moved >= 0, np.maximum(geoms.moved, 0)
        pos = jnp.where(is_moved[:, None], poses.pos[place], pos)
        mat = jnp.where(is_moved[:, None, None], mat_from_quat(poses.quat)[place], mat)
        if poses.size is not None:
            size = jnp.where(is_moved[:, None], poses.size[place], size)
    origin, turn = bodies[0][geoms.bodies], bodies[1][geoms.bodies]
    pos, mat = origin + matvec(turn, pos), matmul(turn, mat)
    return project_geoms(geoms.kinds, pos, mat, size)


def concatenate_solids(one: PlanSolids, other: PlanSolids) -> PlanSolids:
    """Concatenate solids, of which one set may be shared by all worlds."""
    discs = one.discs or other.discs
    both = one.replace(discs=discs), other.replace(discs=discs)
    return jax.tree.map(_end_to_end, *both)


def _end_to_end(first: Array, second: Array) -> Array:
    worlds = np.broadcast_shapes(first.shape[:-1], second.shape[:-1])
    parts = (jnp.broadcast_to(part, (*worlds, part.shape[-1])) for part in (first, second))
    return jnp.concatenate([*parts], -1)


def project_geoms(kinds: np.ndarray, pos: Array, mat: Array, size: Array) -> PlanSolids:
    """Project geoms to the plan.

    Args:
        kinds: MuJoCo geom types (n,).
        pos: Centres [m] (n, 3).
        mat: Orientations (n, 3, 3).
        size: MuJoCo sizes [m] (n, 3).
    """
    box, half = _half_box(kinds, size)
    upright = jnp.abs(mat[:, 2])  # vertical component of each axis
    up = jnp.argmax(upright, -1)
    normal = jnp.take_along_axis(mat, up[:, None, None], 2)[..., 0]
    # The axis may point down: the top is on the other side then.
    normal = normal * jnp.where(normal[:, 2:] < 0, -1.0, 1.0)
    thick = jnp.take_along_axis(half, up[:, None], 1)[:, 0]
    height = (upright * half).sum(-1)
    # Steeper tops are walls, and round solids have no flat top: those count as level at their highest point.
    flat = box & (normal[:, 2] >= MIN_DRIVABLE_COSINE)
    # Bounded for steep tops, whose slope is not used: their derivative must stay finite.
    slope = jnp.where(flat[:, None], -normal[:, :2] / jnp.maximum(normal[:, 2:], 0.1), 0.0)
    middle = pos + normal * thick[:, None]
    over = middle[:, 2] + (slope * (pos - middle)[:, :2]).sum(-1)
    # The first side follows the more level one of the two other axes.
    level = jnp.argmin(jnp.where(jnp.arange(3) == up[:, None], 2.0, upright), -1)
    first = jnp.take_along_axis(mat, level[:, None, None], 2)[:, :2, 0]
    # An axis of length 0 would be one that stands upright, which argmin avoids.
    axis = first / jnp.maximum(jnp.linalg.norm(first, axis=-1, keepdims=True), 1e-6)
    along = jnp.abs(axis[:, :1] * mat[:, 0] + axis[:, 1:] * mat[:, 1])
    across = jnp.abs(-axis[:, 1:] * mat[:, 0] + axis[:, :1] * mat[:, 1])
    sides = jnp.stack([(along * half).sum(-1), (across * half).sum(-1)], -1)
    round_ = ~box & (up == 2) | (kinds == int(mujoco.mjtGeom.mjGEOM_SPHERE))
    sides, radius = jnp.where(round_[:, None], 0.0, sides), jnp.where(round_, half[:, 0], 0.0)
    return PlanSolids(
        outline=outlines(pos[:, :2], axis, sides, radius),
        low=pos[:, 2] - height,
        top=jnp.where(flat, over, pos[:, 2] + height),
        slope_x=slope[:, 0],
        slope_y=slope[:, 1],
        highest=pos[:, 2] + height,
        discs=not box.all(),
    )


def _half_box(kinds: np.ndarray, size: Array) -> tuple[np.ndarray, Array]:
    """Return which geoms are boxes (n,), and half sides of all geoms' bounding boxes (n, 3)."""
    geom = mujoco.mjtGeom
    box = kinds == int(geom.mjGEOM_BOX)
    as_is = box | (kinds == int(geom.mjGEOM_ELLIPSOID))
    radius = size[:, :1]
    # A capsule's length in MuJoCo is without its caps.
    long = jnp.where((kinds == int(geom.mjGEOM_CAPSULE))[:, None], size[:, 1:2] + radius, size[:, 1:2])
    long = jnp.where((kinds == int(geom.mjGEOM_SPHERE))[:, None], radius, long)
    return box, jnp.where(as_is[:, None], size, jnp.concatenate([radius, radius, long], -1))


def ground_heights(solids: PlanSolids, floor: float, points: Array, reach: Array) -> Array:
    """Return the ground heights under points (..., 2); solids above `reach` (...,) are not ground."""
    if not solids.count:  # the maximum of an empty axis has no gradient
        return jnp.full(points.shape[:-1], floor)
    tops = top_heights(solids, points[..., :1], points[..., 1:], reach[..., None])
    return jnp.maximum(jnp.max(tops, axis=-1), floor)


def top_heights(solids: PlanSolids, x: Array, y: Array, reach: Array) -> Array:
    """Return the heights of solids at points, broadcast to them; far below everything where not ground."""
    one = solids.outline
    dx, dy = x - one.x, y - one.y
    inside = jnp.abs(dx * one.cos + dy * one.sin) <= one.length
    inside &= jnp.abs(dy * one.cos - dx * one.sin) <= one.width
    if solids.discs:
        # The sides of discs are 0: the tests before leave all but their middles out.
        inside |= dx * dx + dy * dy <= one.radius * one.radius
    height = solids.top + dx * solids.slope_x + dy * solids.slope_y
    return jnp.where(inside & (height <= reach), height, -FAR_AWAY)
