"""What the cameras of a world's robots see. Pure functions of one world."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.cameras.light import SUN, Headlights, Lamps, lamps_of
from usarmjx.cameras.mounts import Camera, headlight_of
from usarmjx.cameras.paint import ROBOT
from usarmjx.cameras.picture import Picture, take, viewpoint
from usarmjx.cameras.shading import Stage
from usarmjx.engines.base import PhysicsState
from usarmjx.models.build.body_plan import Bodies, body_poses
from usarmjx.sim.scene import Scene
from usarmjx.sim.visible import arena_rows, collect_painted, door_rows, loose_rows, robot_rows, water_rows
from usarmjx.sim.world import World, powered, team_states, time_of

Eye = tuple[int, Camera, int]
"""A team, one of its robots' cameras, and its place among them."""
TILE = 0.5
"""Side of the floor's checkers [m]."""
EVERYWHERE = ((-np.inf, np.inf), (-np.inf, np.inf))


def look_around(scene: Scene, world: World, physics: PhysicsState) -> tuple[Stage, tuple[Bodies, ...]]:
    """Return all that cameras see of a world, and where the robots' bodies are, by team."""
    bodies = tuple(
        jax.vmap(partial(body_poses, team.plan))(team_states(team, physics)) for team in scene.teams
    )
    geoms, paint = collect_painted(
        [
            *arena_rows(scene, world.site, time_of(scene, world)),
            loose_rows(scene, physics),
            door_rows(scene, physics),
            water_rows(scene),
            *robot_rows(scene, bodies, [state.active for state in world.teams]),
        ]
    )
    if world.site is None:
        lamps = lamps_of(scene.arena.lights, scene.arena.floor)
    else:
        lamps = Lamps(pos=world.site.lamps[:, :3], rgb=world.site.lamps[:, 3:])
    sun = np.array(SUN, np.float32)
    stage = Stage(
        geoms=geoms,
        paint=paint,
        sun=sun / np.linalg.norm(sun),
        lamps=lamps,
        headlights=_headlights(scene, world, bodies),
        tile=np.float32(TILE),
        tiled=np.array(EVERYWHERE, np.float32),
    )
    return stage, bodies


def _headlights(scene: Scene, world: World, bodies: tuple[Bodies, ...]) -> Headlights:
    """Return the headlights; those of robots without power are off."""
    pos, along, on = [], [], []
    for team, state, body in zip(scene.teams, world.teams, bodies, strict=True):
        lamp = headlight_of(team.robot)
        mat = body.mat[:, lamp.body]
        pos.append(body.pos[:, lamp.body] + mat @ lamp.at)
        along.append(mat @ lamp.along)
        on.append(state.command.light & powered(scene, world, team, state))
    slots = np.concatenate([team.slots for team in scene.teams])
    joined = [jnp.concatenate(parts) for parts in (pos, along, on)]
    return Headlights(pos=joined[0], along=joined[1], on=joined[2], label=ROBOT + slots)


def pictures(
    scene: Scene,
    world: World,
    physics: PhysicsState,
    eye: Eye,
    size: tuple[int, int],
) -> Picture:
    """Return what a camera of all robots of a team sees; leading axis over robots.

    Args:
        scene: The scene.
        world: The world.
        physics: Where everything is.
        eye: Team, camera, and the camera's place among those of its class; static.
        size: Width and height of a picture; static.
    """
    team, camera, place = eye
    stage, bodies = look_around(scene, world, physics)
    members = bodies[team], jnp.asarray(scene.teams[team].slots), world.teams[team].fov[:, place]
    return each(lambda *member: take(stage, viewpoint(camera, *member), *size), *members)


def each(function: Callable[..., Picture], *values: Any) -> Picture:  # noqa: ANN401 - PyTrees
    """Return a function's pictures for each row of some values.

    On a CPU one after the other: then what a picture does not need, as mirrors where none are in sight, is
    left out, which is three times as fast.
    """
    if jax.default_backend() == "cpu":
        return jax.lax.map(lambda row: function(*row), values)
    return jax.vmap(function)(*values)
