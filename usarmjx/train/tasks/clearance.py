"""True distances of robots from their surroundings, in the plane: for evaluation, not for policies.

A robot is the upright box around all its solids with its joints at 0. Obstacles are the arena's upright
solids that reach into its height, less what its wheels drive over, and the other robots. Tilted solids,
meshes, terrain, doors, victims and loose objects are none.
"""

from functools import cache, partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.backend import Array
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import RobotSpec
from usarmjx.models.types.shapes import Shape
from usarmjx.train.envs.task import TaskView

DRIVABLE_HEIGHT = 0.1
"""Height above a robot's wheels up to which solids are driven over, as boards are [m]."""
UPRIGHT_COSINE = 0.999
"""Cosine of the tilt from which a solid counts as a ramp."""
NO_OBSTACLE = 1e3
"""Clearance where there is nothing at all [m]."""

GeomType = mujoco.mjtGeom
Corner = tuple[jax.Array, jax.Array]


class Boxes(struct.PyTreeNode, kw_only=True):
    """Upright boxes.

    Attributes:
        centre: In the world, x and y [m] (..., 2).
        half: Half lengths along their own axes [m] (..., 2).
        yaw: Rotation about the vertical [rad] (...,).
        low: Height of the lower face [m] (...,).
        high: Of the upper one [m] (...,).
    """

    centre: Array
    half: Array
    yaw: Array
    low: Array
    high: Array


def box_distance(one: Boxes, others: Boxes) -> jax.Array:
    """Return the distance in the plane of a box from others (n,) [m] (n,); 0 where they overlap."""
    # By components, the boxes last: so they are computed eight at a time, in one loop.
    cos, sin = jnp.cos(one.yaw), jnp.sin(one.yaw)
    coss, sins = jnp.cos(others.yaw), jnp.sin(others.yaw)
    half, halves = (one.half[0], one.half[1]), (others.half[:, 0], others.half[:, 1])
    away = others.centre[:, 0] - one.centre[0], others.centre[:, 1] - one.centre[1]
    turn = cos * coss + sin * sins, cos * sins - sin * coss  # from the others' axes to the one's
    middle = cos * away[0] + sin * away[1], cos * away[1] - sin * away[0]
    back = -(coss * away[0] + sins * away[1]), -(coss * away[1] - sins * away[0])
    # Of two rectangles apart, one nearest point is a corner, of the one or of the other.
    theirs, ours = _corners(middle, turn, halves), _corners(back, (turn[0], -turn[1]), half)
    # Squared, so that one root at the end suffices for all eight corners.
    near = jnp.minimum(_nearest_corner(theirs, half), _nearest_corner(ours, halves))
    # Separating axes: two rectangles are apart exactly if one of their four sides' directions separates them.
    apart = reduce(
        jnp.logical_or,
        [
            (reduce(jnp.minimum, places) > reach) | (reduce(jnp.maximum, places) < -reach)
            for corners, reaches in ((theirs, half), (ours, halves))
            for places, reach in zip(zip(*corners, strict=True), reaches, strict=True)
        ],
    )
    return jnp.where(apart, jnp.sqrt(near), 0.0)


def _corners(middle: Corner, turn: Corner, half: tuple[Array, Array]) -> list[Corner]:
    """Return where the corners of rectangles are, x and y each; `turn` is cosine and sine of their yaw."""
    (cos, sin), corners = turn, list[Corner]()
    for x, y in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
        ahead, aside = x * half[0], y * half[1]
        corners.append((middle[0] + cos * ahead - sin * aside, middle[1] + sin * ahead + cos * aside))
    return corners


def _nearest_corner(corners: list[Corner], half: tuple[Array, Array]) -> jax.Array:
    """Return the least squared distance of corners from a rectangle around the origin."""
    gaps = [[jnp.maximum(jnp.abs(corner[i]) - half[i], 0.0) for i in range(2)] for corner in corners]
    return reduce(jnp.minimum, [x * x + y * y for x, y in gaps])


def _einsum(subscripts: str, *operands: Array) -> jax.Array:
    """`jnp.einsum`, one option of which jax leaves without a type."""
    return jnp.einsum(subscripts, *operands)  # pyright: ignore[reportUnknownMemberType]


def _turn(yaw: Array) -> jax.Array:
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)
    return jnp.stack([jnp.stack([cos, -sin], -1), jnp.stack([sin, cos], -1)], -2)


@cache
def bounding_box_of(robot: RobotSpec) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest corner of a robot in its own axes, joints at 0 [m] (3,), (3,)."""
    plan = kinematic_tree_of(robot)
    # With all joints at 0 most parts are not turned; those that are count by their turned axes.
    turns = [np.eye(3)]
    for body in range(1, len(plan.parent)):
        turns.append(turns[plan.parent[body]] @ plan.rest_mat[body])
    mat = np.array(turns)[plan.geom_body]
    pos = plan.rest_pos[plan.geom_body] + np.einsum("gij,gj->gi", mat, plan.geom_pos)
    reach = _reach(plan.geom_type, plan.geom_size, mat @ plan.geom_mat)
    return (pos - reach).min(0), (pos + reach).max(0)


def _reach(kind: np.ndarray, size: np.ndarray, mat: np.ndarray) -> np.ndarray:
    """Return how far geoms reach from their centres along the axes [m] (geoms, 3)."""
    # Cosines between the geom's own z axis, that of rotation, and the three axes.
    along = np.abs(mat[:, :, 2])
    radius, length = size[:, :1], size[:, 1:2]
    reaches = {
        GeomType.mjGEOM_BOX: (np.abs(mat) * size[:, None]).sum(-1),
        GeomType.mjGEOM_SPHERE: np.broadcast_to(radius, along.shape),
        GeomType.mjGEOM_CAPSULE: radius + length * along,
        # Rounding may bring a cosine above 1.
        GeomType.mjGEOM_CYLINDER: radius * np.sqrt(np.maximum(0.0, 1 - along**2)) + length * along,
        GeomType.mjGEOM_ELLIPSOID: np.sqrt(((mat * size[:, None]) ** 2).sum(-1)),
    }
    masks = [np.broadcast_to((kind == int(k))[:, None], along.shape) for k in reaches]
    # Other kinds by the diagonal of their size, which is never too short.
    return np.select(masks, list(reaches.values()), np.linalg.norm(size, axis=-1, keepdims=True))


def _upright(shapes: tuple[Shape, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return boxes around solids: centre, half lengths (n, 6), and quaternions (n, 4); MuJoCo's sizes."""
    rows: list[tuple[float, ...]] = []
    quats: list[Any] = []
    for shape in shapes:
        if shape.kind in ("mesh", "hfield"):
            continue
        radius, half = shape.size[0], shape.size[1] if len(shape.size) > 1 else 0.0
        size = {
            "box": shape.size,
            "ellipsoid": shape.size,
            "sphere": (radius,) * 3,
            "cylinder": (radius, radius, half),
            "capsule": (radius, radius, radius + half),
        }[shape.kind]
        rows.append((*shape.at, *size))
        quats.append(quat_from_angles(*shape.rotation))
    return np.array(rows, np.float32).reshape(-1, 6), np.array(quats, np.float32).reshape(-1, 4)


@cache
def _standing(arena: ArenaSpec) -> tuple[np.ndarray, np.ndarray]:
    return _upright(arena.shapes)


def obstacle_boxes(view: TaskView) -> Boxes:
    """Return the arena's solids as upright boxes; those that are tilted have no height."""
    state, floor = view.world.arena_state, view.scene.arena.floor
    if state is None:
        rows, quat = _standing(view.scene.arena)
        pos, size, quat = jnp.asarray(rows[:, :3]), jnp.asarray(rows[:, 3:]), jnp.asarray(quat)
    else:
        pos, size, quat = state.pos, state.size, state.quat
    mat = mat_from_quat(quat)
    upright = mat[:, 2, 2] >= UPRIGHT_COSINE
    # A negative height makes the box meet nobody, without a shape that depends on how many are tilted.
    height = jnp.where(upright, size[:, 2], -1.0)
    return Boxes(
        centre=pos[:, :2],
        half=size[:, :2],
        # The first column of the matrix is the x axis of the box in the world.
        yaw=jnp.arctan2(mat[:, 1, 0], mat[:, 0, 0]),
        low=pos[:, 2] - height + floor,
        high=pos[:, 2] + height + floor,
    )


def robot_boxes(view: TaskView, group: int) -> Boxes:
    """Return a group's robots as upright boxes; those that are not in use have no height."""
    robots, (low, high) = view.robots(group), bounding_box_of(view.scene.groups[group].robot)
    mat = mat_from_quat(robots.quat)
    yaw = jnp.arctan2(mat[:, 1, 0], mat[:, 0, 0])
    middle = np.array((low[:2] + high[:2]) / 2, np.float32)
    used = view.world.groups[group].active
    return Boxes(
        centre=robots.pos[:, :2] + _einsum("nij,j->ni", _turn(yaw), middle),
        half=jnp.broadcast_to(jnp.array((high - low)[:2] / 2, jnp.float32), (len(yaw), 2)),
        yaw=yaw,
        # Infinite bounds the wrong way round: a parked robot meets nothing.
        low=jnp.where(used, robots.pos[:, 2] + low[2], jnp.inf),
        high=jnp.where(used, robots.pos[:, 2] + high[2], -jnp.inf),
    )


def clearance(view: TaskView) -> tuple[jax.Array, ...]:
    """Return how far each robot is from the nearest obstacle, per group [m] (robots,); 0: they overlap."""
    walls = obstacle_boxes(view)
    groups = [robot_boxes(view, group) for group in range(len(view.scene.groups))]
    # Another robot stands on the ground as this one does: all of it is in the way.
    robots = _joined(*groups)
    around, count, n = _joined(walls, robots), len(walls.yaw), len(robots.yaw)  # the walls come first
    # Robots drive over boards, not over each other.
    drivable = np.repeat(np.array([DRIVABLE_HEIGHT, 0.0], np.float32), [count, n])
    least = jax.vmap(partial(_least, around, drivable))(robots, count + jnp.arange(n))
    bounds = np.cumsum([len(group.yaw) for group in groups])[:-1]
    return tuple(jnp.split(least, bounds))


def _joined(*boxes: Boxes) -> Boxes:
    def join(*parts: Array) -> jax.Array:
        return jnp.concatenate(parts)

    return jax.tree.map(join, *boxes)


def _least(around: Boxes, drivable: np.ndarray, one: Boxes, me: jax.Array) -> jax.Array:
    """Return how far a box is from the nearest other that is in its way [m] ().

    Args:
        around: All boxes (n,).
        drivable: Height above the box's lower face up to which each is not in its way [m] (n,).
        one: The box.
        me: Which of them it is ().
    """
    meets = (around.high > one.low + drivable) & (around.low < one.high)
    # The robot itself is among the boxes around it.
    meets &= jnp.arange(len(around.yaw)) != me
    return jnp.where(meets, box_distance(one, around), NO_OBSTACLE).min(initial=NO_OBSTACLE)
