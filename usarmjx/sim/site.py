"""The arena of a world: what of it is data, and where that is now. Pure functions of one world.

A scene with one arena keeps it in the model; only what moves in it, its victims, is data. A scene with
several gives each world a `Site` of its own at every reset.
"""

import jax
import jax.numpy as jnp

from usarmjx.engines.base import Places
from usarmjx.models.build.arena_set import Site, turn_of
from usarmjx.models.build.victims import VictimTable, segment_poses
from usarmjx.models.effecters import Tags
from usarmjx.sensors.surroundings import Surroundings, survey
from usarmjx.sim.scene import Scene


def site_at(library: Site | None, number: jax.Array, episode: jax.Array) -> Site | None:
    """Return the arena of a world's episode: worlds go through the library (arenas, ...) in turn."""
    if library is None:
        return None
    turn = turn_of(number, episode, len(library.starts))
    return jax.tree.map(lambda rows: jnp.asarray(rows)[turn], library)


def victims_of(scene: Scene, site: Site | None) -> VictimTable:
    """Return the victims of a world."""
    return jax.tree.map(jnp.asarray, scene.victims) if site is None else site.victims


def surroundings(scene: Scene, site: Site | None, dropped: Tags, time: jax.Array) -> Surroundings | None:
    """Return the victims and tags of a world at a time [s] (); None if no robot has a sensor for them."""
    if not any(team.suite.looks_around for team in scene.teams):
        return None
    tags = jax.tree.map(jnp.asarray, scene.tags if site is None else site.tags)
    return survey(victims_of(scene, site), tags, dropped, time, jnp.asarray(scene.arena.floor, jnp.float32))


def start_poses(scene: Scene, site: Site | None) -> jax.Array:
    """Return the start poses of a world: x, y, z above the arena's floor [m] and yaw [rad] (starts, 4)."""
    if site is not None:
        return site.starts
    return jnp.array([(*start.at, start.yaw) for start in scene.arena.starts])


def places(scene: Scene, site: Site | None, time: jax.Array) -> Places | None:
    """Return where the geoms of `scene.moved` are at a time [s] (); without an axis over worlds."""
    if scene.moved is None:
        return None
    table = victims_of(scene, site)
    pos, quat = segment_poses(table, time, jnp)
    if site is None:
        return Places(pos=pos[scene.swinging], quat=quat[scene.swinging])
    return Places(
        pos=jnp.concatenate([site.pos, pos]),
        quat=jnp.concatenate([site.quat, quat]),
        size=jnp.concatenate([site.size, table.size]),
    )
