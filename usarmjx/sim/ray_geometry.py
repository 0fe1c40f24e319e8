"""Geoms that rays can hit in a world: floor and arena, loose objects, doors, and the robots in use.

Pure functions of one world. Solids of a robot carry its slot, all others -1. For cameras it has colours
too, and the geoms of a robot can be told apart.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np

from usarmjx.base.backend import Array, on_numpy, xp
from usarmjx.base.clock import Time
from usarmjx.base.rotations import mat_from_quat, matmul, matvec
from usarmjx.base.warp_functions import warp_in_use
from usarmjx.engines.base import GeomPoses, PhysicsState
from usarmjx.models.compile.arena_set import ArenaState, arena_index_of
from usarmjx.models.compile.compose import door_boxes
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.compile.victims import VictimTable, segment_poses
from usarmjx.models.compile.visuals import VISUAL_SLOTS, drawn_bones, used_slots
from usarmjx.models.effecters import DroppedTags
from usarmjx.models.types.shapes import GLASS, OPAQUE, texture_names
from usarmjx.sensors.cameras.paint import (
    DOOR_LABEL,
    FALSE_ALARM_LABEL,
    LOOSE_LABEL,
    ROBOT_LABEL,
    VICTIM_LABEL,
    WATER_LABEL,
    WATER_RGB,
    WATER_TRANSPARENCY,
    GeomAppearance,
    bone_labels,
    instances,
    reflectances,
    robot_geom_owner,
    transparencies,
)
from usarmjx.sensors.rays.targets import PADDING_DISTANCE, Geoms, indices_by_key, make_geoms
from usarmjx.sensors.surroundings import Surroundings, surroundings_at, tags_at
from usarmjx.sim.scene import GeomTable, Scene


def arena_state_at(arenas: ArenaState | None, number: Array, episode: Array) -> ArenaState | None:
    """Return the arena of a world's episode: worlds go through the arenas (arenas, ...) in turn."""
    if arenas is None:
        return None
    # By world number and episode, without a draw: every arena is used equally often.
    turn = arena_index_of(number, episode, len(arenas.starts))
    return jax.tree.map(lambda rows: xp.asarray(rows)[turn], arenas)


def victims_of(scene: Scene, arena_state: ArenaState | None) -> VictimTable:
    """Return the victims of a world."""
    return jax.tree.map(xp.asarray, scene.victims) if arena_state is None else arena_state.victims


def surroundings(
    scene: Scene, arena_state: ArenaState | None, dropped: DroppedTags, time: Time
) -> Surroundings | None:
    """Return the victims and tags of a world at a time [s] or clock (); None if no robot senses them.

    Without the victims if no robot has a sensor for those.
    """
    if not any(group.suite.needs_surroundings for group in scene.groups):
        return None
    tags = jax.tree.map(xp.asarray, scene.tags if arena_state is None else arena_state.tags)
    floor = xp.asarray(scene.arena.floor, xp.float32)
    if not any(group.suite.needs_victims for group in scene.groups):
        return tags_at(tags, dropped, floor)
    return surroundings_at(victims_of(scene, arena_state), tags, dropped, time, floor)


def start_poses(scene: Scene, arena_state: ArenaState | None) -> Array:
    """Return the start poses of a world: x, y, z above the arena's floor [m] and yaw [rad] (starts, 4)."""
    if arena_state is not None:
        return xp.asarray(arena_state.starts)
    return xp.array([(*start.at, start.yaw) for start in scene.arena.starts])


def moved_geom_poses(scene: Scene, arena_state: ArenaState | None, time: Time) -> GeomPoses | None:
    """Return the poses of `scene.moved_geoms` at a time [s] or clock (); without an axis over worlds.

    With one arena in the scene, several (...,) work as well: (..., geoms, 3) and (..., geoms, 4).
    """
    if scene.moved_geoms is None:
        return None
    table = victims_of(scene, arena_state)
    pos, quat = segment_poses(table, time, xp)
    if arena_state is None:
        boxes = scene.moving_victim_boxes
        return GeomPoses(pos=pos[..., boxes, :], quat=quat[..., boxes, :])
    return GeomPoses(
        pos=xp.concatenate([arena_state.pos, pos]),
        quat=xp.concatenate([arena_state.quat, quat]),
        size=xp.concatenate([arena_state.size, table.size]),
    )


BOX = int(mujoco.mjtGeom.mjGEOM_BOX)


class VisibleGeoms(NamedTuple):
    """Some geoms.

    Attributes:
        kind: MuJoCo types, or kinds of `models.compile.ray_geoms` (n,).
        pos: Positions [m] (n, 3).
        mat: Orientations (n, 3, 3).
        size: Size numbers [m] (n, 3).
        owner: Slots of the robots that they belong to; -1 for what is no robot's (n,).
        material: Their materials; members of `shapes.MATERIALS` (n,).
        rgb: Their colours (n, 3).
        label: Their labels for cameras, as in `cameras.paint` (n,).
        geom_index: Place of each in its robot's `KinematicTree`; 0 for what is no robot's (n,).
        transparency: Share of the light that passes (n,).
        compact: As in `targets.Geoms`, of all of them.
        fixed: Likewise.
        instance: Their instances, as `cameras.paint.instances` has them (n,); None: one instance for each
            label.
        texture: Codes of what is on them (n,); None: nothing is.
    """

    kind: np.ndarray
    pos: Array
    mat: Array
    size: Array
    owner: Array
    material: np.ndarray
    rgb: Array
    label: Array
    geom_index: np.ndarray
    transparency: np.ndarray
    compact: bool = False
    fixed: bool = False
    instance: Array | None = None
    texture: np.ndarray | None = None


def ray_geoms(rows: Sequence[VisibleGeoms]) -> Geoms:
    """Return rows as what rays are cast at.

    Kernels of Warp have what is fixed apart: once for all worlds.
    """
    # Fixed blocks come first: their indices are the same in all worlds.
    fixed, others = ([row for row in rows if row.fixed == of_them] for of_them in (True, False))
    if not (fixed and others and warp_in_use()):
        return _geoms_of(rows)
    parts = [_geoms_of(fixed), _geoms_of(others)]
    names = ("blocks", "kinds", "materials", "compact")
    joined = {name: getattr(parts[0], name) + getattr(parts[1], name) for name in names}
    count = [len(part.blocks) for part in parts]
    return Geoms(**joined, fixed=(True,) * count[0] + (False,) * count[1])


def _geoms_of(rows: Sequence[VisibleGeoms]) -> Geoms:
    kind, material, compact = _sorting_keys(rows)
    pos, mat, size, owner = _concatenated(rows, "pos", "mat", "size", "owner")
    return make_geoms(kind, pos, mat, size, owner, material, compact)


def camera_geoms(rows: Sequence[VisibleGeoms]) -> tuple[Geoms, GeomAppearance]:
    """Return rows as what cameras look at: owners are those of `paint.robot_geom_owner`."""
    kind, material, compact = _sorting_keys(rows)
    rows = [row if row.instance is not None else _with_instances(row) for row in rows]
    names = ("pos", "mat", "size", "owner", "rgb", "label", "instance")
    pos, mat, size, owner, rgb, label, instance = _concatenated(rows, *names)
    geom_index = np.concatenate([row.geom_index for row in rows])
    # Cameras hide single geoms of their robot, so owners name a geom and not only a slot.
    owner = xp.where(owner >= 0, robot_geom_owner(owner, geom_index), owner)
    geoms = make_geoms(kind, pos, mat, size, owner, material, compact)
    # `make_geoms` sorts by kind, material and compactness: colors have to follow.
    order = np.concatenate(list(indices_by_key(kind, material, compact).values()))
    appearance = GeomAppearance(
        rgb=rgb[order],
        transparency=np.concatenate([row.transparency for row in rows])[order],
        reflectance=reflectances(np.array(material, object)[order]),
        label=label[order],
        instance=instance[order],
        **_texture(rows, order),
    )
    return geoms, appearance


def _texture(rows: Sequence[VisibleGeoms], order: np.ndarray) -> dict[str, Any]:
    """Return the textures of geoms, as fields of `GeomAppearance`; nothing if no geom has one."""
    codes = [np.zeros(len(row.kind), np.int32) if row.texture is None else row.texture for row in rows]
    code = np.concatenate(codes)
    return {"texture": code[order], "textures": texture_names(code)} if code.any() else {}


def _with_instances(row: VisibleGeoms) -> VisibleGeoms:
    return row._replace(instance=instances(xp.asarray(row.label), 0))


def _concatenated(rows: Sequence[VisibleGeoms], *names: str) -> Sequence[Array]:
    columns = [xp.concatenate([xp.asarray(getattr(row, name)) for row in rows]) for name in names]
    if on_numpy():
        return columns
    # Kept as arrays: else XLA computes the poses of all geoms again for every ray, and compiles for minutes.
    return jax.lax.optimization_barrier(columns)  # pyright: ignore[reportUnknownMemberType] - JAX has no type


def _sorting_keys(rows: Sequence[VisibleGeoms]) -> tuple[np.ndarray, list[str], list[bool]]:
    """Return kinds, materials and compactness of all geoms, by which `make_geoms` sorts."""
    kind, material = (np.concatenate([getattr(row, name) for row in rows]) for name in ("kind", "material"))
    compact = np.repeat([row.compact for row in rows], [len(row.kind) for row in rows])
    return kind, material.tolist(), compact.tolist()


def visible_arena(
    scene: Scene, arena_state: ArenaState | None, time: Time, *, drawn: bool = False
) -> list[VisibleGeoms]:
    """Return floor and arena, victims included, at a time [s] or clock ().

    Args:
        scene: The scene.
        arena_state: The world's own arena, where they differ.
        time: The time.
        drawn: Whether victims have their visuals, as in pictures, instead of the boxes that sensors' rays
            meet.
    """
    rows = [_visible(scene.fixed_geoms)._replace(fixed=True)]
    here = moved_geom_poses(scene, arena_state, time)
    if here is not None:
        look = scene.moved_geom_table
        size = look.size if here.size is None else here.size
        # Poses of moved geoms are in the axes of the body `arena`, which stands on the floor.
        lift = xp.array([0.0, 0.0, scene.arena.floor])
        moved = _visible(look, here.pos + lift, mat_from_quat(here.quat), size)
        # Boxes of the arena come first, those of victims after them, as in `moved_geom_poses`.
        boxes = len(moved.kind) - len(victims_of(scene, arena_state).owner)
        if arena_state is not None:
            # Which boxes are false alarms differs between arenas, so labels come from the world and
            # not from the model.
            bones = bone_labels(arena_state.victims.owner, xp)
            moved = moved._replace(
                rgb=xp.concatenate([arena_state.rgb, arena_state.victims.rgba[:, :3]]),
                label=xp.concatenate([xp.asarray(look.label[:boxes]), bones]),
            )
        rows.append(_select_rows(moved, np.arange(max(boxes, 0))) if drawn else moved)
    if drawn:  # what of the victims does not move is among the rest
        is_bone = np.isin(scene.fixed_geoms.label, (VICTIM_LABEL, FALSE_ALARM_LABEL))
        rows[0] = _select_rows(rows[0], np.flatnonzero(~is_bone))
        rows.append(_victim_geoms(scene, arena_state, time))
    return rows


def _select_rows(rows: VisibleGeoms, which: np.ndarray) -> VisibleGeoms:
    """Return the rows with some indices (m,)."""
    fields = {name: column for name, column in rows._asdict().items() if column is not None}
    columns = {name: column[which] for name, column in fields.items() if name not in ("compact", "fixed")}
    return rows._replace(**columns)


def _victim_geoms(scene: Scene, arena_state: ArenaState | None, time: Time) -> VisibleGeoms:
    """Return the visuals of victims and false alarms."""
    table = victims_of(scene, arena_state)
    drawn, boxes, slots = drawn_bones(table, xp), table.num_boxes, len(VISUAL_SLOTS)
    place, quat = segment_poses(table, time, xp)
    turn = mat_from_quat(quat)
    pos = place[:, None] + matvec(turn[:, None], drawn.offset) + xp.array([0.0, 0.0, scene.arena.floor])
    # Parts differ between worlds there, and shapes of arrays may not: unused slots are far away.
    seen = np.ones((boxes, slots), bool) if arena_state is not None else used_slots(scene.victims.part)
    which = np.flatnonzero(seen)  # of worlds that differ, all
    return VisibleGeoms(
        kind=np.tile(VISUAL_SLOTS, boxes)[which],
        pos=pos.reshape(-1, 3)[which],
        mat=xp.repeat(turn, slots, 0)[which],
        size=drawn.size.reshape(-1, 3)[which],
        owner=xp.full(len(which), -1),
        material=np.full(len(which), OPAQUE, object),
        rgb=drawn.rgb.reshape(-1, 3)[which],
        label=xp.repeat(bone_labels(xp.asarray(table.owner), xp), slots)[which],
        geom_index=np.zeros(len(which), int),
        transparency=np.zeros(len(which), np.float32),
        compact=True,
        instance=xp.repeat(_victim_instances(table), slots)[which],
    )


def _victim_instances(table: VictimTable) -> Array:
    """Return the victim of each box, as instances (boxes,); a false alarm is one box."""
    owner = xp.asarray(table.owner)
    # False alarms have no victim's number: they are counted as they come.
    alarm = xp.cumsum(owner < 0) - 1
    index = xp.where(owner >= 0, owner, alarm)
    return instances(bone_labels(owner, xp), index).astype(xp.int32)


def drawn_limbs(table: VictimTable, boxes: np.ndarray) -> list[VisibleGeoms]:
    """Return the visuals of some boxes of victims (n,), each in its own axes; the table is NumPy's."""
    drawn, used, rows = drawn_bones(table), used_slots(table.part), list[VisibleGeoms]()
    for box in boxes:
        slots = np.flatnonzero(used[box])
        n = len(slots)
        rows.append(
            VisibleGeoms(
                kind=np.array(VISUAL_SLOTS)[slots],
                pos=drawn.offset[box, slots],
                mat=np.tile(np.eye(3, dtype=np.float32), (n, 1, 1)),
                size=drawn.size[box, slots],
                owner=np.full(n, -1),
                material=np.full(n, OPAQUE, object),
                rgb=drawn.rgb[box, slots],
                label=np.full(n, bone_labels(table.owner[box])),
                geom_index=np.zeros(n, int),
                transparency=np.zeros(n, np.float32),
                compact=True,
            )
        )
    return rows


def visible_loose(scene: Scene, physics: PhysicsState) -> VisibleGeoms:
    """Return the loose objects."""
    loose = scene.loose_geoms
    root = physics.qpos[loose.root_qposadr]
    turn = mat_from_quat(root[:, 3:])[loose.owner]
    pos = root[loose.owner, :3] + matvec(turn, loose.local.pos)
    instance = instances(LOOSE_LABEL, np.asarray(loose.owner, np.int32))
    rows = _visible(loose.local, pos, matmul(turn, loose.local.mat))
    return rows._replace(compact=True, instance=instance)


def visible_doors(scene: Scene, physics: PhysicsState) -> VisibleGeoms:
    """Return the doors as they stand."""
    pos, mat, size = door_boxes(scene.arena, physics.qpos[scene.door_qpos], xp)
    rgb = np.array([door.rgba[:3] for door in scene.arena.doors], np.float32).reshape(-1, 3)
    instance = instances(DOOR_LABEL, np.arange(len(rgb), dtype=np.int32))
    return _boxes(pos, mat, size, rgb, DOOR_LABEL)._replace(instance=instance)


def visible_water(scene: Scene) -> VisibleGeoms:
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
    rows = _boxes((low + high) / 2, mat, (high - low) / 2, rgb, WATER_LABEL, GLASS)
    return rows._replace(transparency=np.full(n, WATER_TRANSPARENCY, np.float32))


def visible_robots(
    scene: Scene, bodies: Sequence[BodyPoses], active: Sequence[Array], *, drawn: bool = False
) -> list[VisibleGeoms]:
    """Return the robots, by group; those that are not in use are far away.

    Args:
        scene: The scene.
        bodies: Poses of their bodies, by group.
        active: Which are in use, by group.
        drawn: Whether robots have their visuals, as in pictures, instead of the solids that sensors' rays
            meet.
    """
    rows: list[VisibleGeoms] = []
    for group, body, used in zip(scene.groups, bodies, active, strict=True):
        own = group.plan.visuals.solids if drawn else group.plan.solids
        n, g = len(group.slots), len(own.kind)
        pos, mat = own.poses(body.pos, body.mat)
        slot = np.repeat(group.slots, g)
        rows.append(
            VisibleGeoms(
                kind=np.tile(own.kind, n),
                # Far away instead of left out: arrays in a compiled step have fixed shapes.
                pos=xp.where(used[:, None, None], pos, PADDING_DISTANCE).reshape(-1, 3),
                mat=mat.reshape(-1, 3, 3),
                size=xp.tile(own.size, (n, 1)),
                owner=slot,
                material=np.full(n * g, OPAQUE, object),
                rgb=np.tile(own.rgb, (n, 1)),
                label=ROBOT_LABEL + slot,
                geom_index=np.tile(np.arange(g), n),
                transparency=np.zeros(n * g, np.float32),
                compact=True,
                instance=instances(ROBOT_LABEL, np.asarray(slot, np.int32)),
            )
        )
    return rows


def _boxes(
    pos: Array, mat: Array, size: np.ndarray, rgb: np.ndarray, label: int, material: str = OPAQUE
) -> VisibleGeoms:
    """Return boxes that are no robot's."""
    n = len(size)
    made_of = np.full(n, material, object)
    return VisibleGeoms(
        kind=np.full(n, BOX),
        pos=xp.asarray(pos),
        mat=xp.asarray(mat),
        size=xp.asarray(size),
        owner=xp.full(n, -1),
        material=made_of,
        rgb=rgb,
        label=np.full(n, label),
        geom_index=np.zeros(n, int),
        transparency=transparencies(made_of),
    )


def _visible(
    table: GeomTable, pos: Array | None = None, mat: Array | None = None, size: Array | None = None
) -> VisibleGeoms:
    """Return geoms that are no robot's, where the scene has them or elsewhere."""
    return VisibleGeoms(
        kind=table.kind,
        pos=xp.asarray(table.pos if pos is None else pos),
        mat=xp.asarray(table.mat if mat is None else mat),
        size=xp.asarray(table.size if size is None else size),
        owner=xp.full(len(table.kind), -1),
        material=table.material,
        rgb=table.rgb,
        label=table.label,
        geom_index=np.zeros(len(table.kind), int),
        transparency=transparencies(table.material),
        texture=table.texture,
    )
