"""What rays can hit in a world: floor and arena, loose objects, doors, and the robots in use.

Pure functions of one world. What belongs to a robot carries its slot, all else -1. For cameras it has colours
too, and the geoms of a robot can be told apart.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.rotations import composed, mat_from_quat, turned
from usarmjx.base.transforms import Array
from usarmjx.cameras.paint import (
    DOOR_LABEL,
    ROBOT,
    WATER,
    WATER_CLEAR,
    WATER_RGB,
    Paint,
    bone_labels,
    clears,
    glosses,
    piece_of,
)
from usarmjx.engines.base import PhysicsState
from usarmjx.models.build.arena_set import Site
from usarmjx.models.build.body_plan import Bodies, geom_poses
from usarmjx.models.build.doors import door_boxes
from usarmjx.models.spec.robot import GLASS, OPAQUE
from usarmjx.sensors.rays.targets import FAR_AWAY, Geoms, gather, sort_places
from usarmjx.sim.scene import Scene
from usarmjx.sim.scene_geoms import Look
from usarmjx.sim.site import places

BOX = int(mujoco.mjtGeom.mjGEOM_BOX)


class Rows(NamedTuple):
    """Some geoms: kinds (n,) and materials (n,) as numpy arrays, the others as in `raycast.Block` or `Paint`.

    `piece` is the place of each in its robot's `BodyPlan`; 0 for what is no robot's (n,). `compact` is as in
    `raycast.Geoms`, of all of them.
    """

    kind: np.ndarray
    pos: Array
    mat: Array
    size: Array
    owner: Array
    material: np.ndarray
    rgb: Array
    label: Array
    piece: np.ndarray
    clear: np.ndarray
    compact: bool = False


def collect(rows: Sequence[Rows]) -> Geoms:
    """Return rows as what rays are cast at."""
    # Kept as arrays: else XLA works out the poses of all geoms again for every ray, and compiles for minutes.
    joined = jax.lax.optimization_barrier([_joined(rows, name) for name in ("pos", "mat", "size", "owner")])
    return gather(*_sorts(rows, joined))


def collect_painted(rows: Sequence[Rows]) -> tuple[Geoms, Paint]:
    """Return rows as what cameras look at: owners are those of `paint.piece_of`."""
    names = ("pos", "mat", "size", "owner", "rgb", "label")
    *joined, owner, rgb, label = jax.lax.optimization_barrier([_joined(rows, name) for name in names])
    piece = np.concatenate([row.piece for row in rows])
    geoms = gather(*_sorts(rows, [*joined, jnp.where(owner >= 0, piece_of(owner, piece), owner)]))
    kind, *_, material, compact = _sorts(rows, [])
    order = np.concatenate(list(sort_places(kind, material, compact).values()))
    clear = np.concatenate([row.clear for row in rows])
    paint = Paint(
        rgb=rgb[order],
        clear=clear[order],
        gloss=glosses(np.array(material, object)[order]),
        label=label[order],
    )
    return geoms, paint


def _joined(rows: Sequence[Rows], name: str) -> jax.Array:
    return jnp.concatenate([jnp.asarray(getattr(row, name)) for row in rows])


def _sorts(rows: Sequence[Rows], joined: Sequence[jax.Array]) -> tuple:
    kind, material = (np.concatenate([getattr(row, name) for row in rows]) for name in ("kind", "material"))
    compact = np.repeat([row.compact for row in rows], [len(row.kind) for row in rows])
    return kind, *joined, material.tolist(), compact.tolist()


def arena_rows(scene: Scene, site: Site | None, time: jax.Array) -> list[Rows]:
    """Return floor and arena, victims included, at a time [s] ()."""
    rows = [_rows(scene.fixed_look)]
    here = places(scene, site, time)
    if here is not None:
        look = scene.moved_look
        size = look.size if here.size is None else here.size
        lift = jnp.array([0.0, 0.0, scene.arena.floor])
        moved = _rows(look, here.pos + lift, mat_from_quat(here.quat), size)
        if site is not None:
            bones = bone_labels(site.victims.owner, jnp)
            boxes = len(moved.kind) - len(bones)
            moved = moved._replace(
                rgb=jnp.concatenate([site.rgb, site.victims.rgba[:, :3]]),
                label=jnp.concatenate([jnp.asarray(look.label[:boxes]), bones]),
            )
        rows.append(moved)
    return rows


def loose_rows(scene: Scene, physics: PhysicsState) -> Rows:
    """Return the loose objects."""
    loose = scene.loose_geoms
    root = physics.qpos[loose.root_qpos]
    turn = mat_from_quat(root[:, 3:])[loose.owner]
    pos = root[loose.owner, :3] + turned(turn, loose.local.pos)
    return _rows(loose.local, pos, composed(turn, loose.local.mat))._replace(compact=True)


def door_rows(scene: Scene, physics: PhysicsState) -> Rows:
    """Return the doors as they stand."""
    pos, mat, size = door_boxes(scene.arena, physics.qpos[scene.door_qpos], jnp)
    rgb = np.array([door.rgba[:3] for door in scene.arena.doors], np.float32).reshape(-1, 3)
    return _plain(pos, mat, size, rgb, DOOR_LABEL)


def water_rows(scene: Scene) -> Rows:
    """Return the bodies of water, which only cameras see; as if of glass."""
    corners = np.array([(water.low, water.high) for water in scene.arena.waters], np.float32).reshape(
        -1, 2, 3
    )
    corners = corners + np.array([0.0, 0.0, scene.arena.floor], np.float32)
    low, high = corners[:, 0], corners[:, 1]
    n = len(corners)
    mat, rgb = (
        np.tile(np.eye(3, dtype=np.float32), (n, 1, 1)),
        np.tile(np.array(WATER_RGB, np.float32), (n, 1)),
    )
    rows = _plain((low + high) / 2, mat, (high - low) / 2, rgb, WATER, GLASS)
    return rows._replace(clear=np.full(n, WATER_CLEAR, np.float32))


def robot_rows(scene: Scene, bodies: Sequence[Bodies], active: Sequence[jax.Array]) -> list[Rows]:
    """Return the robots, by team; those that are not in use are far away."""
    rows = []
    for team, body, used in zip(scene.teams, bodies, active, strict=True):
        plan, n, g = team.plan, len(team.slots), len(team.plan.geom_type)
        pos, mat = jax.vmap(partial(geom_poses, plan))(body)
        slot = np.repeat(team.slots, g)
        rows.append(
            Rows(
                kind=np.tile(plan.geom_type, n),
                pos=jnp.where(used[:, None, None], pos, FAR_AWAY).reshape(-1, 3),
                mat=mat.reshape(-1, 3, 3),
                size=jnp.tile(plan.geom_size, (n, 1)),
                owner=slot,
                material=np.full(n * g, OPAQUE, object),
                rgb=np.tile(plan.geom_rgb, (n, 1)),
                label=ROBOT + slot,
                piece=np.tile(np.arange(g), n),
                clear=np.zeros(n * g, np.float32),
                compact=True,
            )
        )
    return rows


def _plain(
    pos: Array, mat: Array, size: np.ndarray, rgb: np.ndarray, label: int, material: str = OPAQUE
) -> Rows:
    """Return boxes that are no robot's."""
    n = len(size)
    made_of = np.full(n, material, object)
    return Rows(
        kind=np.full(n, BOX),
        pos=jnp.asarray(pos),
        mat=jnp.asarray(mat),
        size=jnp.asarray(size),
        owner=jnp.full(n, -1),
        material=made_of,
        rgb=rgb,
        label=np.full(n, label),
        piece=np.zeros(n, int),
        clear=clears(made_of),
    )


def _rows(look: Look, pos: Array = None, mat: Array = None, size: Array = None) -> Rows:
    """Return geoms that are no robot's, where the scene has them or elsewhere."""
    return Rows(
        kind=look.kind,
        pos=jnp.asarray(look.pos if pos is None else pos),
        mat=jnp.asarray(look.mat if mat is None else mat),
        size=jnp.asarray(look.size if size is None else size),
        owner=jnp.full(len(look.kind), -1),
        material=look.material,
        rgb=look.rgb,
        label=look.label,
        piece=np.zeros(len(look.kind), int),
        clear=clears(look.material),
    )
