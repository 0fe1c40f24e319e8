"""What effecters do when they are told to: to their robot and to the world around it. Pure functions."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.errors import UnknownNameError
from usarmjx.base.transforms import Array, flip_vector
from usarmjx.engines.base import PhysicsState
from usarmjx.models.build.body_plan import Bodies, BodyPlan, body_poses
from usarmjx.models.build.parts import parts_of
from usarmjx.models.effecters import TAG_ROOM, Effect, Effecter, Opcode, Tags
from usarmjx.models.spec.robot import SKY, RobotSpec
from usarmjx.sensors.rays.raycast import Gaze, cast
from usarmjx.sensors.rays.targets import Geoms
from usarmjx.sim.control import Command
from usarmjx.sim.scene import Scene, Team
from usarmjx.sim.visible import arena_rows, collect
from usarmjx.sim.world import World, powered, team_states, time_of

SLACK = 1e-3
"""A parameter may be this far outside of its limits: CONF tells them with 4 decimals, cut off."""
OK = -1
"""The number of an outcome that has none."""
NOBODY = -2
"""A viewer to whom no geom belongs."""


@dataclass(frozen=True)
class Operation:
    """One operation of one effecter of a robot class."""

    robot: RobotSpec
    effecter: Effecter
    opcode: Opcode


class Outcome(struct.PyTreeNode, kw_only=True):
    """What became of an operation, per robot.

    Attributes:
        done: Whether it was carried out (...,).
        number: What the answer says instead of OK, such as the tags that are left; `OK` without one (...,).
    """

    done: Array
    number: Array


class Load(struct.PyTreeNode, kw_only=True):
    """What an operation of one effecter can change; leading axis over the robots that are told.

    Attributes:
        command: What the robots are told to do.
        stock: What the effecter has left in stock (n,).
        tags: The tags in their world; no axis over robots.
    """

    command: Command
    stock: Array
    tags: Tags


def find_operation(team: Team, name: str, opcode: str) -> tuple[int, Opcode]:
    """Return the place of a team's effecter by its name, and one of its operations, case ignored.

    Raises:
        UnknownNameError: The robots have no such effecter, or it has no such operation; lists what there is.
    """
    names = [effecter.mount.name for effecter in team.effecters]
    place = next((i for i, known in enumerate(names) if known.lower() == name.lower()), None)
    if place is None:
        raise UnknownNameError(
            f"{team.robot.name} has no effecter {name!r}; it has: {', '.join(names) or 'none'}"
        )
    effecter = team.effecters[place]
    operation = effecter.opcode(opcode)
    if operation is None:
        known = ", ".join(known.name for known in effecter.opcodes)
        raise UnknownNameError(f"{effecter.kind} {name} has no opcode {opcode!r}; it has: {known}")
    return place, operation


def perform(
    what: Operation,
    value: Array,
    load: Load,
    *,
    asked: Array,
    ground: Callable[[], Array],
    xp: ModuleType = jnp,
) -> tuple[Load, Outcome]:
    """Carry out one operation of robots of one class in one world.

    Args:
        what: The operation.
        value: Its parameter (n,).
        load: What it can change.
        asked: Which robots shall do it (n,).
        ground: Returns the ground below the effecters [m] (n, 3), not finite where there is none.
        xp: Array module of all arrays.

    Returns:
        What it changed, and what became of it: a parameter that is out of range, or no number, does nothing.
    """
    value, opcode = xp.asarray(value, xp.float32), what.opcode
    low, high = (opcode.min_val, opcode.max_val) if opcode.takes_value else (-np.inf, np.inf)
    effect = what.effecter.effect(opcode, xp.clip(value, low, high), load.stock, xp)
    done = asked & (value >= low - SLACK) & (value <= high + SLACK) & effect.possible
    tags = load.tags
    if effect.drops:
        done, tags = _drop(tags, ground(), done, xp)
    number = OK if effect.number is None else effect.number
    outcome = Outcome(done=done, number=xp.where(done, number, OK).astype(xp.int32))
    stock = load.stock if effect.stock is None else xp.where(done, effect.stock, load.stock)
    return Load(command=_tell(what, effect, load.command, done, xp), stock=stock, tags=tags), outcome


def _tell(what: Operation, effect: Effect, command: Command, done: Array, xp: ModuleType) -> Command:
    """Return the commands (n, ...) of robots that have an effect on themselves."""
    if effect.light is not None:
        command = command.replace(light=xp.where(done, effect.light, command.light))
    if effect.target is None:
        return command
    parts = parts_of(what.robot)
    for joint, part in enumerate(parts):
        if part.name in what.effecter.joints:
            here = done[:, None] & (np.arange(len(parts)) == joint)
            target = what.effecter.joint_target(part, effect.target, xp)[:, None]
            command = command.replace(
                target=xp.where(here, target, command.target).astype(xp.float32),
                order=xp.where(here, effect.order, command.order).astype(xp.int32),
            )
    return command


def _drop(tags: Tags, ground: Array, asked: Array, xp: ModuleType) -> tuple[Array, Tags]:
    """Put one tag on the ground (n, 3) for each of those who asked for it, as long as there is room."""
    asked = asked & xp.isfinite(ground).all(-1)
    place = tags.count + xp.cumsum(asked) - 1
    done = asked & (place < TAG_ROOM)
    here = done[:, None] & (place[:, None] == np.arange(TAG_ROOM))
    pos = (here[..., None] * xp.where(done[:, None], ground, 0.0)[:, None]).sum(0)
    pos = xp.where(here.any(0)[:, None], pos, tags.pos).astype(xp.float32)
    return done, Tags(pos=pos, count=(tags.count + done.sum()).astype(xp.int32))


def mount_point(effecter: Effecter, plan: BodyPlan, bodies: Bodies) -> Array:
    """Return where in the world an effecter of one robot is [m] (3,)."""
    body = plan.parts.index(effecter.mount.parent)
    return bodies.pos[body] + bodies.mat[body] @ np.array(flip_vector(effecter.mount.at), np.float32)


def ground_below(geoms: Geoms, point: jax.Array) -> jax.Array:
    """Return the point of floor or arena below a point (3,) [m] (3,); infinitely low where there is none."""
    down = jnp.array([[0.0, 0.0, -1.0]])
    hits = cast(geoms, point[None], down, jnp.int32(NOBODY), Gaze(frozenset({SKY})))
    return point.at[2].add(-hits.distance[0])


def operate(
    scene: Scene,
    world: World,
    physics: PhysicsState,
    where: tuple[int, int],
    opcode: Opcode,
    value: jax.Array,
    asked: jax.Array,
) -> tuple[World, Outcome]:
    """Let a team's robots operate one of their effecters; those without power cannot.

    Args:
        scene: The scene.
        world: One world.
        physics: Its physics.
        where: Team, and place of the effecter among `effecters_of` the team's class.
        opcode: One of the effecter's operations.
        value: Its parameter (robots,).
        asked: Which robots shall do it (robots,).
    """
    number, place = where
    team, state = scene.teams[number], world.teams[number]
    effecter = team.effecters[place]

    def ground() -> jax.Array:
        bodies = jax.vmap(partial(body_poses, team.plan))(team_states(team, physics))
        points = jax.vmap(partial(mount_point, effecter, team.plan))(bodies)
        geoms = collect(arena_rows(scene, world.site, time_of(scene, world)))
        return jax.vmap(partial(ground_below, geoms))(points)

    load = Load(command=state.command, stock=state.stock[:, place], tags=world.tags)
    asked = asked & powered(scene, world, team, state)
    what = Operation(robot=team.robot, effecter=effecter, opcode=opcode)
    load, outcome = perform(what, value, load, asked=asked, ground=ground)
    state = state.replace(command=load.command, stock=state.stock.at[:, place].set(load.stock))
    teams = (*world.teams[:number], state, *world.teams[number + 1 :])
    return world.replace(teams=teams, tags=load.tags), outcome
