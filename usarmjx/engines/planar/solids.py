"""What robots stand on and stop at: solids seen from above, with the plane of their tops.

A solid is a rectangle or a disc on the plan, from a height to another. A box whose top lies less steep than
`STEEPEST` can be driven on where the robot comes up to it without a step: ramps and levels.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.base.rotations import mat_from_quat, matmul, matvec
from usarmjx.engines.base import GeomPoses
from usarmjx.engines.planar.overlap import Outlines, outlines

STEEPEST = math.cos(math.radians(30.0))
"""Cosine of the steepest slope that robots drive on."""
NOWHERE = 1e6
"""A solid so high, or so low, meets nobody [m]."""
KINDS = {
    int(mujoco.mjtGeom.mjGEOM_BOX),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE),
    int(mujoco.mjtGeom.mjGEOM_SPHERE),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID),
}


class PlanSolids(struct.PyTreeNode, kw_only=True):
    """Solids, of one world or of many.

    Attributes:
        outline: On the plan (..., solids).
        low: Lowest point [m] (..., solids).
        top: Height of the top over the middle [m] (..., solids).
        slope_x: How the top rises along x (..., solids).
        slope_y: How it rises along y (..., solids).
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
        """How many there are."""
        return self.low.shape[-1]


def as_numbers(solids: PlanSolids | Array) -> Array:
    """Return the numbers of solids (..., k, robots) in one array (..., numbers, k, robots)."""
    return jnp.stack(jax.tree.leaves(solids), -3) if isinstance(solids, PlanSolids) else jnp.asarray(solids)


def as_solids(solids: PlanSolids | Array, *, discs: bool) -> PlanSolids:
    """Return solids, or those whose numbers `as_numbers` has put together; `discs` as theirs."""
    if isinstance(solids, PlanSolids):
        return solids
    parts = [solids[..., i, :, :] for i in range(solids.shape[-3])]
    outline, others = Outlines(*parts[: len(Outlines._fields)]), parts[len(Outlines._fields) :]
    low, top, slope_x, slope_y, highest = others
    return PlanSolids(
        outline=outline, low=low, top=top, slope_x=slope_x, slope_y=slope_y, highest=highest, discs=discs
    )


class SolidGeoms(NamedTuple):
    """The geoms of a model that robots can meet and that are no robot's.

    Attributes:
        ids: Their ids (n,).
        kinds: MuJoCo geom types (n,).
        bodies: The bodies that they are fixed to (n,).
        moved: Places in `GeomPoses` of those that are data (n,); -1: they are fixed to their bodies.
    """

    ids: np.ndarray
    kinds: np.ndarray
    bodies: np.ndarray
    moved: np.ndarray

    def where(self, mask: np.ndarray) -> "SolidGeoms":
        """Return some of them, masked (n,)."""
        return SolidGeoms(*(part[mask] for part in self))


def solid_geoms(model: mujoco.MjModel, robot_bodies: set[int], moved_ids: list[int]) -> SolidGeoms:
    """Return the geoms that robots can meet, without floors.

    Raises:
        UnsupportedFeatureError: One is of a kind that this engine does not know: meshes and height fields.
    """
    touches = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    others = [g for g in np.flatnonzero(touches).tolist() if model.geom_bodyid[g] not in robot_bodies]
    others = [g for g in others if model.geom_type[g] != mujoco.mjtGeom.mjGEOM_PLANE]
    strange = [model.geom(g).name for g in others if int(model.geom_type[g]) not in KINDS]
    if strange:
        names = ", ".join(map(repr, strange[:4]))
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
    """Return how high the floor is [m]; without one, far below all."""
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    heights = [model.body_pos[model.geom_bodyid[g], 2] + model.geom_pos[g, 2] for g in planes]
    return float(max(heights, default=-NOWHERE))


def solids_of(
    model: mujoco.MjModel, geoms: SolidGeoms, bodies: tuple[Array, Array], poses: GeomPoses | None
) -> PlanSolids:
    """Return the solids of one world.

    Args:
        model: The model.
        geoms: Which geoms they are.
        bodies: Origins (nbody, 3) [m] and orientations (nbody, 3, 3) of the model's bodies.
        poses: Where geoms are that are data.
    """
    pos, mat = jnp.asarray(model.geom_pos[geoms.ids]), mat_from_quat(jnp.asarray(model.geom_quat[geoms.ids]))
    size = jnp.asarray(model.geom_size[geoms.ids])
    if poses is not None:
        is_moved, place = geoms.moved >= 0, np.maximum(geoms.moved, 0)
        pos = jnp.where(is_moved[:, None], poses.pos[place], pos)
        mat = jnp.where(is_moved[:, None, None], mat_from_quat(poses.quat)[place], mat)
        if poses.size is not None:
            size = jnp.where(is_moved[:, None], poses.size[place], size)
    origin, turn = bodies[0][geoms.bodies], bodies[1][geoms.bodies]
    pos, mat = origin + matvec(turn, pos), matmul(turn, mat)
    return seen_from_above(geoms.kinds, pos, mat, size)


def joined(one: PlanSolids, other: PlanSolids) -> PlanSolids:
    """Return the solids of both, of which one set may be the same in all worlds."""
    discs = one.discs or other.discs
    both = one.replace(discs=discs), other.replace(discs=discs)
    return jax.tree.map(_end_to_end, *both)


def _end_to_end(first: Array, second: Array) -> Array:
    worlds = np.broadcast_shapes(first.shape[:-1], second.shape[:-1])
    parts = (jnp.broadcast_to(part, (*worlds, part.shape[-1])) for part in (first, second))
    return jnp.concatenate([*parts], -1)


def seen_from_above(kinds: np.ndarray, pos: Array, mat: Array, size: Array) -> PlanSolids:
    """Return what geoms look like on the plan.

    Args:
        kinds: MuJoCo geom types (n,).
        pos: Middles [m] (n, 3).
        mat: Orientations (n, 3, 3).
        size: MuJoCo sizes [m] (n, 3).
    """
    box, half = _half_box(kinds, size)
    upright = jnp.abs(mat[:, 2])  # how much each axis points up
    up = jnp.argmax(upright, -1)
    normal = jnp.take_along_axis(mat, up[:, None, None], 2)[..., 0]
    normal = normal * jnp.where(normal[:, 2:] < 0, -1.0, 1.0)
    thick = jnp.take_along_axis(half, up[:, None], 1)[:, 0]
    height = (upright * half).sum(-1)
    flat = box & (normal[:, 2] >= STEEPEST)
    slope = jnp.where(flat[:, None], -normal[:, :2] / jnp.maximum(normal[:, 2:], 0.1), 0.0)
    middle = pos + normal * thick[:, None]
    over = middle[:, 2] + (slope * (pos - middle)[:, :2]).sum(-1)
    # The first side lies as the most level of the two other axes does.
    level = jnp.argmin(jnp.where(jnp.arange(3) == up[:, None], 2.0, upright), -1)
    first = jnp.take_along_axis(mat, level[:, None, None], 2)[:, :2, 0]
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
    """Return which geoms are boxes (n,), and half sides of the boxes around all of them (n, 3)."""
    geom = mujoco.mjtGeom
    box = kinds == int(geom.mjGEOM_BOX)
    as_is = box | (kinds == int(geom.mjGEOM_ELLIPSOID))
    radius = size[:, :1]
    long = jnp.where((kinds == int(geom.mjGEOM_CAPSULE))[:, None], size[:, 1:2] + radius, size[:, 1:2])
    long = jnp.where((kinds == int(geom.mjGEOM_SPHERE))[:, None], radius, long)
    return box, jnp.where(as_is[:, None], size, jnp.concatenate([radius, radius, long], -1))


def ground_under(solids: PlanSolids, floor: float, points: Array, reach: Array) -> Array:
    """Return how high the ground is under points (..., 2); what is above `reach` (...,) is not ground."""
    if not solids.count:  # the largest of nothing has no slope
        return jnp.full(points.shape[:-1], floor)
    tops = tops_under(solids, points[..., :1], points[..., 1:], reach[..., None])
    return jnp.maximum(jnp.max(tops, axis=-1), floor)


def tops_under(solids: PlanSolids, x: Array, y: Array, reach: Array) -> Array:
    """Return how high solids are at points, broadcast to them; where they are no ground, far below all."""
    one = solids.outline
    dx, dy = x - one.x, y - one.y
    inside = jnp.abs(dx * one.cos + dy * one.sin) <= one.length
    inside &= jnp.abs(dy * one.cos - dx * one.sin) <= one.width
    if solids.discs:
        inside |= dx * dx + dy * dy <= one.radius * one.radius
    height = solids.top + dx * solids.slope_x + dy * solids.slope_y
    return jnp.where(inside & (height <= reach), height, -NOWHERE)
