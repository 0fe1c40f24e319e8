"""The arena of a world: what of it is data, and where that is now. Pure functions of one world.

A scene with one arena keeps it in the model; only what moves in it, its victims, is data. A scene with
several gives each world an `ArenaState` of its own at every reset.
"""

import jax

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.engines.base import GeomPoses
from usarmjx.models.build.arena_set import ArenaState, arena_index_of
from usarmjx.models.build.victims import VictimTable, segment_poses
from usarmjx.models.effecters import DroppedTags
from usarmjx.sensors.surroundings import Surroundings, surroundings_at, tags_at
from usarmjx.sim.scene import Scene


def arena_state_at(arenas: ArenaState | None, number: Array, episode: Array) -> ArenaState | None:
    """Return the arena of a world's episode: worlds go through the arenas (arenas, ...) in turn."""
    if arenas is None:
        return None
    turn = arena_index_of(number, episode, len(arenas.starts))
    return jax.tree.map(lambda rows: xp.asarray(rows)[turn], arenas)


def victims_of(scene: Scene, arena_state: ArenaState | None) -> VictimTable:
    """Return the victims of a world."""
    return jax.tree.map(xp.asarray, scene.victims) if arena_state is None else arena_state.victims


def surroundings(
    scene: Scene, arena_state: ArenaState | None, dropped: DroppedTags, time: Array
) -> Surroundings | None:
    """Return the victims and tags of a world at a time [s] (); None if no robot has a sensor for them.

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


def moved_geom_poses(scene: Scene, arena_state: ArenaState | None, time: Array) -> GeomPoses | None:
    """Return where the geoms of `scene.moved` are at a time [s] (); without an axis over worlds.

    Of a scene with one arena at times (...,) as well: (..., geoms, 3) and (..., geoms, 4).
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
