"""What effecters do when they are told to: to their robot and to the world around it. Pure functions."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UnknownNameError
from usarmjx.base.transforms import flip_vector
from usarmjx.engines.base import PhysicsState
from usarmjx.models.build.body_plan import BodyPoses, KinematicTree, forward_kinematics
from usarmjx.models.build.parts import parts_of
from usarmjx.models.effecters import MAX_DROPPED_TAGS, DroppedTags, Effect, Effecter, Opcode
from usarmjx.models.spec.robot import SKY, RobotSpec
from usarmjx.sensors.rays.raycast import RayQuery, cast_rays
from usarmjx.sensors.rays.targets import Geoms
from usarmjx.sim.control import RobotCommand
from usarmjx.sim.scene import RobotGroup, Scene
from usarmjx.sim.visible import ray_geoms, visible_arena
from usarmjx.sim.world import World, powered, robot_states, time_of

LIMIT_TOLERANCE = 1e-3
"""A parameter may be this far outside of its limits: CONF tells them with 4 decimals, cut off."""
NO_NUMBER = -1
"""The number of an outcome that has none."""
NO_VIEWER = -2
"""A viewer to whom no geom belongs."""


@dataclass(frozen=True)
class Operation:
    """One operation of one effecter of a robot class."""

    robot: RobotSpec
    effecter: Effecter
    opcode: Opcode


class OperationResult(struct.PyTreeNode, kw_only=True):
    """What became of an operation, per robot.

    Attributes:
        done: Whether it was carried out (...,).
        number: What the answer says instead of OK, such as the tags that are left; `NO_NUMBER` without one (...,).
    """

    done: Array
    number: Array


class EffecterState(struct.PyTreeNode, kw_only=True):
    """What an operation of one effecter can change; leading axis over the robots that are told.

    Attributes:
        command: What the robots are told to do.
        stock: What the effecter has left in stock (n,).
        tags: The tags in their world; no axis over robots.
    """

    command: RobotCommand
    stock: Array
    tags: DroppedTags


def find_operation(group: RobotGroup, name: str, opcode: str) -> tuple[int, Opcode]:
    """Return the place of a team's effecter by its name, and one of its operations, case ignored.

    Raises:
        UnknownNameError: The robots have no such effecter, or it has no such operation; lists what there is.
    """
    names = [effecter.mount.name for effecter in group.effecters]
    place = next((i for i, known in enumerate(names) if known.lower() == name.lower()), None)
    if place is None:
        raise UnknownNameError(
            f"{group.robot.name} has no effecter {name!r}; it has: {', '.join(names) or 'none'}"
        )
    effecter = group.effecters[place]
    operation = effecter.opcode(opcode)
    if operation is None:
        known = ", ".join(known.name for known in effecter.opcodes)
        raise UnknownNameError(f"{effecter.kind} {name} has no opcode {opcode!r}; it has: {known}")
    return place, operation


def apply_operation(
    what: Operation,
    value: Array,
    state: EffecterState,
    *,
    mask: Array,
    ground: Callable[[], Array],
    xp: ModuleType = jnp,
) -> tuple[EffecterState, OperationResult]:
    """Carry out one operation of robots of one class in one world.

    Args:
        what: The operation.
        value: Its parameter (n,).
        state: What it can change.
        mask: Which robots shall do it (n,).
        ground: Returns the ground below the effecters [m] (n, 3), not finite where there is none.
        xp: Array module of all arrays.

    Returns:
        What it changed, and what became of it: a parameter that is out of range, or no number, does nothing.
    """
    value, opcode = xp.asarray(value, xp.float32), what.opcode
    low, high = (opcode.min_val, opcode.max_val) if opcode.takes_value else (-np.inf, np.inf)
    effect = what.effecter.effect(opcode, xp.clip(value, low, high), state.stock, xp)
    done = mask & (value >= low - LIMIT_TOLERANCE) & (value <= high + LIMIT_TOLERANCE) & effect.possible
    tags = state.tags
    if effect.drops:
        done, tags = _drop_tags(tags, ground(), done, xp)
    number = NO_NUMBER if effect.reply_number is None else effect.reply_number
    outcome = OperationResult(done=done, number=xp.where(done, number, NO_NUMBER).astype(xp.int32))
    stock = state.stock if effect.stock is None else xp.where(done, effect.stock, state.stock)
    return EffecterState(
        command=_update_command(what, effect, state.command, done, xp), stock=stock, tags=tags
    ), outcome


def _update_command(
    what: Operation, effect: Effect, command: RobotCommand, done: Array, xp: ModuleType
) -> RobotCommand:
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
                mode=xp.where(here, effect.mode, command.mode).astype(xp.int32),
            )
    return command


def _drop_tags(tags: DroppedTags, ground: Array, asked: Array, xp: ModuleType) -> tuple[Array, DroppedTags]:
    """Put one tag on the ground (n, 3) for each of those who asked for it, as long as there is room."""
    asked = asked & xp.isfinite(ground).all(-1)
    place = tags.count + xp.cumsum(asked) - 1
    done = asked & (place < MAX_DROPPED_TAGS)
    here = done[:, None] & (place[:, None] == np.arange(MAX_DROPPED_TAGS))
    pos = (here[..., None] * xp.where(done[:, None], ground, 0.0)[:, None]).sum(0)
    pos = xp.where(here.any(0)[:, None], pos, tags.pos).astype(xp.float32)
    return done, DroppedTags(pos=pos, count=(tags.count + done.sum()).astype(xp.int32))


def effecter_position(effecter: Effecter, plan: KinematicTree, bodies: BodyPoses) -> Array:
    """Return where in the world an effecter of one robot is [m] (3,)."""
    body = plan.parts.index(effecter.mount.parent)
    return bodies.pos[body] + bodies.mat[body] @ np.array(flip_vector(effecter.mount.at), np.float32)


def ground_below(geoms: Geoms, point: jax.Array) -> jax.Array:
    """Return the point of floor or arena below a point (3,) [m] (3,); infinitely low where there is none."""
    down = jnp.array([[0.0, 0.0, -1.0]])
    hits = cast_rays(geoms, point[None], down, jnp.int32(NO_VIEWER), RayQuery(frozenset({SKY})))
    return point.at[2].add(-hits.distance[0])


def operate(
    scene: Scene,
    world: World,
    physics: PhysicsState,
    effecter_index: tuple[int, int],
    opcode: Opcode,
    value: jax.Array,
    mask: jax.Array,
) -> tuple[World, OperationResult]:
    """Let a team's robots operate one of their effecters; those without power cannot.

    Args:
        scene: The scene.
        world: One world.
        physics: Its physics.
        effecter_index: Team, and place of the effecter among `effecters_of` the team's class.
        opcode: One of the effecter's operations.
        value: Its parameter (robots,).
        mask: Which robots shall do it (robots,).
    """
    number, place = effecter_index
    team, state = scene.groups[number], world.groups[number]
    effecter = team.effecters[place]

    def ground() -> jax.Array:
        bodies = jax.vmap(partial(forward_kinematics, team.plan))(robot_states(team, physics))
        points = jax.vmap(partial(effecter_position, effecter, team.plan))(bodies)
        geoms = ray_geoms(visible_arena(scene, world.arena_state, time_of(scene, world)))
        return jax.vmap(partial(ground_below, geoms))(points)

    load = EffecterState(command=state.command, stock=state.releases[:, place], tags=world.tags)
    mask = mask & powered(scene, world, team, state)
    what = Operation(robot=team.robot, effecter=effecter, opcode=opcode)
    load, outcome = apply_operation(what, value, load, mask=mask, ground=ground)
    state = state.replace(command=load.command, releases=state.releases.at[:, place].set(load.stock))
    teams = (*world.groups[:number], state, *world.groups[number + 1 :])
    return world.replace(groups=teams, tags=load.tags), outcome
