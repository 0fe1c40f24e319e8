"""Effects of effecters on their robot and on the world around it. Pure functions."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import numpy as np

from usarmjx.base.backend import Array, ArrayLike, named_scope, set_at, vmap, xp
from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.nodes import Node
from usarmjx.base.rotations import matvec
from usarmjx.base.transforms import flip_vector
from usarmjx.engines.base import PhysicsState
from usarmjx.models.compile.kinematic_tree import (
    BodyPoses,
    KinematicTree,
    forward_kinematics,
    kinematic_tree_of,
)
from usarmjx.models.compile.parts import parts_of
from usarmjx.models.effecters import (
    MAX_DROPPED_TAGS,
    DroppedTags,
    Effect,
    Effecter,
    Opcode,
)
from usarmjx.models.effecters.base import LIMIT_TOLERANCE
from usarmjx.models.types.robot import RobotSpec
from usarmjx.models.types.shapes import SKY
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.raycast import Hits, RayCaster, RayQuery, cast_rays
from usarmjx.sim.control import CommandUpdate, ControlMode, RobotCommand, update_command
from usarmjx.sim.ray_geometry import ray_geoms, visible_arena
from usarmjx.sim.scene import RobotGroup, Scene
from usarmjx.sim.world import World, clock_of, powered, robot_states

NO_NUMBER = -1
"""The number of a result that has none."""


@dataclass(frozen=True)
class Operation:
    """One operation of one effecter of a robot class."""

    robot: RobotSpec
    effecter: Effecter
    opcode: Opcode


class OperationResult(Node, kw_only=True):
    """Result of an operation, per robot.

    Attributes:
        done: Whether it was carried out (...,).
        number: Number that the answer gives instead of OK, such as the tags that are left (...,);
            `NO_NUMBER` without one.
    """

    done: Array
    number: Array


class EffecterState(Node, kw_only=True):
    """State that an operation of one effecter can change; leading axis over the robots.

    Attributes:
        command: The robots' command.
        stock: Items that the effecter has left (n,).
        tags: The tags in their world; no axis over robots.
    """

    command: RobotCommand
    stock: Array
    tags: DroppedTags


def find_operation(
    group: RobotGroup, name: str, opcode: str, value: ArrayLike | None = None
) -> tuple[int, Opcode, ArrayLike]:
    """Return the index of a group's effecter, one of its operations, and the parameter; names' case ignored.

    Args:
        group: The robots.
        name: Name of the effecter.
        opcode: Name of the operation.
        value: The parameter; None: the usual one.

    Raises:
        UnknownNameError: The robots have no such effecter, or it has no such operation; lists what there is.
        UsageError: The operation needs a parameter.
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
    value = operation.default_val if value is None else value
    if value is None:
        raise UsageError(f"{operation.name} of {name} needs a value")
    return place, operation, value


def apply_operation(
    what: Operation,
    value: Array,
    state: EffecterState,
    *,
    mask: Array,
    ground: Callable[[], Array],
) -> tuple[EffecterState, OperationResult]:
    """Carry out one operation of robots of one class in one world.

    Args:
        what: The operation.
        value: Its parameter (n,).
        state: The state that it can change.
        mask: Mask of the robots that do it (n,).
        ground: Returns the ground below the effecters [m] (n, 3), not finite where there is none.

    Returns:
        The new state and the result: a parameter that is out of range, or no number, does nothing.
    """
    value, opcode = xp.asarray(value, xp.float32), what.opcode
    # Without a parameter any number is in range: the value is a stand-in.
    low, high = (opcode.min_val, opcode.max_val) if opcode.takes_value else (-np.inf, np.inf)
    # Clipped for the effect, and compared unclipped below: a value just off the limit by rounding is meant.
    effect = what.effecter.effect(opcode, xp.clip(value, low, high), state.stock)
    # Comparisons with NaN are false: a parameter that is no number does nothing.
    done = mask & (value >= low - LIMIT_TOLERANCE) & (value <= high + LIMIT_TOLERANCE) & effect.possible
    tags = state.tags
    if effect.drops:
        done, tags = _drop_tags(tags, ground(), done)
    number = NO_NUMBER if effect.reply_number is None else effect.reply_number
    result = OperationResult(done=done, number=xp.where(done, number, NO_NUMBER).astype(xp.int32))
    stock = state.stock if effect.stock is None else xp.where(done, effect.stock, state.stock)
    return EffecterState(
        command=_update_command(what, effect, state.command, done), stock=stock, tags=tags
    ), result


def _update_command(what: Operation, effect: Effect, command: RobotCommand, done: Array) -> RobotCommand:
    """Return the commands (n, ...) of robots that have an effect on themselves."""
    joints: dict[str, ArrayLike] = {}
    for part in parts_of(what.robot):
        if effect.target is not None and part.name in what.effecter.joints:
            joints[part.name] = what.effecter.joint_target(part, effect.target)
    update = CommandUpdate(joints=joints, mode=ControlMode(effect.mode), light=effect.light)
    return update_command(kinematic_tree_of(what.robot), command, update, done)


def _drop_tags(tags: DroppedTags, ground: Array, requested: Array) -> tuple[Array, DroppedTags]:
    """Put one tag on the ground (n, 3) for each robot of a mask, as long as there is room."""
    requested = requested & xp.isfinite(ground).all(-1)
    # Robots of one step take places in the order of their group.
    index = tags.count + xp.cumsum(requested) - 1
    done = requested & (index < MAX_DROPPED_TAGS)
    # A table in place of a scatter: several robots may drop tags in one step, each at an index of its own.
    at_index = done[:, None] & (index[:, None] == np.arange(MAX_DROPPED_TAGS))
    # 0 * inf is NaN: heights where there is no ground must not reach the sum.
    pos = (at_index[..., None] * xp.where(done[:, None], ground, 0.0)[:, None]).sum(0)
    pos = xp.where(xp.any(at_index, 0)[:, None], pos, tags.pos).astype(xp.float32)
    return done, DroppedTags(pos=pos, count=(tags.count + done.sum()).astype(xp.int32))


def effecter_position(effecter: Effecter, plan: KinematicTree, bodies: BodyPoses) -> Array:
    """Return the position of robots' effecter in the world [m] (..., 3)."""
    body = plan.parts.index(effecter.mount.parent)
    at = np.array(flip_vector(effecter.mount.at), np.float32)
    return bodies.pos[..., body, :] + matvec(bodies.mat[..., body, :, :], at)


def ground_below(point: Array, cast: RayCaster) -> Array:
    """Return the ground below points (n, 3) [m] (n, 3), infinitely low where there is none."""
    down = np.broadcast_to(np.array([0.0, 0.0, -1.0], np.float32), point.shape)
    # No robot is passed: the geoms of this caster are floor and arena only.
    hits = cast(point, down, RayQuery(transparent=frozenset({SKY})), None)
    return set_at(point, (..., 2), point[..., 2] - hits.distance)


def _ground_caster(scene: Scene, world: World) -> RayCaster:
    """Return a ray caster for floor and arena on JAX, each ray for itself: they start far from each other."""
    geoms = ray_geoms(visible_arena(scene, world.arena_state, clock_of(scene, world)))

    def cast(origin: Array, direction: Array, query: RayQuery, fans: Fans | None = None) -> Hits:
        del fans

        def one(origin: Array, direction: Array) -> Hits:
            return cast_rays(geoms, origin[None], direction[None], query)

        return jax.tree.map(lambda values: values[..., 0], vmap(one)(origin, direction))

    return cast


@dataclass(frozen=True, kw_only=True)
class EffecterCommand:
    """Command to one effecter of the robots of one group.

    Attributes:
        group: Index into `scene.groups`.
        effecter: Index into the group's `effecters`.
        opcode: One of its operations.
        value: The parameter (robots,).
        where: Mask of the robots that carry it out (robots,).
    """

    group: int
    effecter: int
    opcode: Opcode
    value: Array
    where: Array


@named_scope("operate")
def operate(
    scene: Scene, world: World, physics: PhysicsState, order: EffecterCommand, cast: RayCaster | None = None
) -> tuple[World, OperationResult]:
    """Let a group's robots operate one of their effecters; those without power cannot.

    Args:
        scene: The scene.
        world: One world.
        physics: Its physics.
        order: The command.
        cast: Casts rays at what dropped things fall on, floor and arena; None: on JAX `cast_rays`.
    """
    group, state = scene.groups[order.group], world.groups[order.group]
    effecter = group.effecters[order.effecter]

    # A function: most operations drop nothing, and need no rays.
    def ground() -> Array:
        bodies = vmap(partial(forward_kinematics, group.plan))(robot_states(group, physics))
        point = effecter_position(effecter, group.plan, bodies)
        return ground_below(point, _ground_caster(scene, world) if cast is None else cast)

    stock = state.releases[:, order.effecter]
    before = EffecterState(command=state.command, stock=stock, tags=world.tags)
    mask = order.where & powered(scene, world, group, state)
    what = Operation(robot=group.robot, effecter=effecter, opcode=order.opcode)
    after, result = apply_operation(what, order.value, before, mask=mask, ground=ground)
    releases = set_at(state.releases, (slice(None), order.effecter), after.stock)
    state = state.replace(command=after.command, releases=releases)
    return world.with_group(order.group, state).replace(tags=after.tags), result


def operate_in_worlds(
    scene: Scene,
    worlds: World,
    physics: PhysicsState,
    effecter_index: tuple[int, int],
    opcode: Opcode,
    value: Array,
    where: Array,
) -> tuple[World, OperationResult]:
    """Let the robots of a group operate as `operate` does, in all worlds (worlds, ...)."""

    def one(world: World, physics: PhysicsState, value: Array, where: Array) -> tuple[World, OperationResult]:
        group, effecter = effecter_index
        order = EffecterCommand(group=group, effecter=effecter, opcode=opcode, value=value, where=where)
        return operate(scene, world, physics, order)

    return vmap(one)(worlds, physics, value, where)
