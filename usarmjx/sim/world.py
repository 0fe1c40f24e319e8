"""One world: its state beside the physics, and what happens to it in a control step. Pure functions.

`batch` maps these over many worlds; nothing here knows which engine moves the robots.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.comms.links import Links
from usarmjx.comms.mail import Inboxes
from usarmjx.engines.base import Inputs, PhysicsState
from usarmjx.models.build.arena_set import ArenaState
from usarmjx.models.build.body_plan import forward_kinematics
from usarmjx.models.build.variation import RandomizedValues
from usarmjx.models.drives import DRY_DEPTH
from usarmjx.models.drives.state import RobotState
from usarmjx.models.effecters import DroppedTags
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.base import Reading, SensorInput
from usarmjx.sensors.rays.raycast import NO_HITS
from usarmjx.sensors.suite import SensorMemory
from usarmjx.sim.control import DriveConditions, RobotCommand, compute_actuation
from usarmjx.sim.scene import RobotGroup, Scene
from usarmjx.sim.site import moved_geom_poses, surroundings
from usarmjx.sim.streams import Stream
from usarmjx.sim.visible import ray_geoms, visible_arena, visible_doors, visible_loose, visible_robots

T = TypeVar("T")
RUNAWAY_SPEED = 5.0
"""A chassis faster than this, and than half more than its drive's top speed, did not get there by driving:
counted as a fault of the physics [m/s]."""


class CommandHistory(struct.PyTreeNode, kw_only=True):
    """What a robot was told in the control steps before, the last one first.

    Attributes:
        target: `RobotCommand.target` (steps, joints).
        mode: `RobotCommand.mode` (steps, joints).
        setpoint: `RobotCommand.setpoint` (steps, keys).
    """

    target: Array
    mode: Array
    setpoint: Array


class GroupState(struct.PyTreeNode, kw_only=True):
    """The robots of one class in one world; leading axis over them.

    Attributes:
        command: What they are told to do (n, ...).
        active: Whether the robot is in use; the others are parked (n,).
        battery_start: When its battery was full [s] (n,).
        drowned: Whether water has killed its battery (n,).
        releases: What each of their effecters has left to release (n, effecters).
        memory: What their sensors remember (n, ...).
        fov: Horizontal field of view of each of their cameras [rad] (n, cameras).
        command_history: What they were told and may not have heard yet (n, ...); None: they hear at once.
    """

    command: RobotCommand
    active: jax.Array
    battery_start: jax.Array
    drowned: jax.Array
    releases: jax.Array
    memory: SensorMemory
    fov: jax.Array
    command_history: CommandHistory | None = None


class FaultCounts(struct.PyTreeNode, kw_only=True):
    """What went wrong in a world since the batch was made, as counts of control steps ().

    Attributes:
        not_finite: Steps after which the physics was not finite, and the world was reset.
        overflow: Steps in which contact buffers were full.
        runaway: Steps in which a robot was faster than it can drive; see `RUNAWAY_SPEED`.
        refused: Commanded numbers that were not finite.
    """

    not_finite: jax.Array
    overflow: jax.Array
    runaway: jax.Array
    refused: jax.Array


class World(struct.PyTreeNode, kw_only=True):
    """Everything that changes in one world, but for the physics.

    Attributes:
        key: The world's random key, made from the batch's seed and the world's number ().
        number: The world's number ().
        arena_state: The world's arena; None where all worlds have the same.
        episode: Resets so far ().
        step: Control steps since the last reset ().
        groups: The robots by class.
        tags: RFID tags that robots have dropped.
        faults: What went wrong.
        links: The radio links as last evaluated; None without a radio.
        mail: The robots' boxes; None without mail.
        varied: What this world and its robots have otherwise than others; None: nothing.
    """

    key: jax.Array
    number: jax.Array
    arena_state: ArenaState | None
    episode: jax.Array
    step: jax.Array
    groups: tuple[GroupState, ...]
    tags: DroppedTags
    faults: FaultCounts
    links: Links | None = None
    mail: Inboxes | None = None
    varied: RandomizedValues | None = None

    def with_group(self, index: int, group: GroupState) -> "World":
        """Return the world with the state of one group of robots replaced; batched worlds alike."""
        return self.replace(groups=(*self.groups[:index], group, *self.groups[index + 1 :]))


def time_of(scene: Scene, world: World) -> jax.Array:
    """Return the simulated time since the last reset [s] ()."""
    return world.step.astype(jnp.float32) * scene.physics.period


def episode_key(world: World, stream: Stream) -> jax.Array:
    """Return the key of a stream of random numbers in the present episode."""
    return jax.random.fold_in(jax.random.fold_in(world.key, stream), world.episode)


def robot_states(group: RobotGroup, physics: PhysicsState) -> RobotState:
    """Return where a group's robots are; leading axis over them."""
    root, dof = physics.qpos[group.root_qposadr], physics.qvel[group.root_dofadr]
    return RobotState(
        pos=root[:, :3],
        quat=root[:, 3:],
        linear=dof[:, :3],
        angular=dof[:, 3:],
        joint_pos=physics.qpos[group.qposadr],
        joint_vel=physics.qvel[group.dofadr],
    )


def map_robots(
    function: Callable[..., T], sensor_input: SensorInput, group: RobotGroup, key: jax.Array, *rest: object
) -> T:
    """Map function(sensor_input, *rest, key) over a group's robots, each with a key folded by its slot."""
    keys = jax.vmap(partial(jax.random.fold_in, key))(group.slots)
    noise = None if sensor_input.noise_factor is None else 0
    shared: Any = SensorInput(time=None, state=0, bodies=0, hits=0, noise_factor=noise)  # type: ignore - axes, not values
    return jax.vmap(function, in_axes=(shared, *[0] * len(rest), 0))(sensor_input, *rest, keys)


def sense_self(scene: Scene, world: World, physics: PhysicsState, group: RobotGroup) -> SensorInput:
    """Return what a group's robots sense of themselves, no rays cast; leading axis over robots."""
    states = robot_states(group, physics)
    bodies = jax.vmap(partial(forward_kinematics, group.plan))(states)
    blind = jax.tree.map(lambda x: jnp.zeros((len(group.slots), *x.shape)), NO_HITS)
    time = time_of(scene, world)
    around = surroundings(scene, world.arena_state, world.tags, time)
    noise = None if world.varied is None or world.varied.noise is None else world.varied.noise[group.slots]
    return SensorInput(
        time=time, state=states, bodies=bodies, hits=blind, surroundings=around, noise_factor=noise
    )


@jax.named_scope("cast_rays")
def sense(scene: Scene, world: World, physics: PhysicsState) -> tuple[SensorInput, ...]:
    """Return what each group's robots sense, rays cast; leading axis over robots, but for the time."""
    sensor_inputs = [sense_self(scene, world, physics, group) for group in scene.groups]
    geoms = ray_geoms(
        [
            *visible_arena(scene, world.arena_state, time_of(scene, world)),
            visible_loose(scene, physics),
            visible_doors(scene, physics),
            *visible_robots(
                scene,
                [sensor_input.bodies for sensor_input in sensor_inputs],
                [state.active for state in world.groups],
            ),
        ]
    )
    return tuple(
        sensor_input.replace(
            hits=jax.vmap(
                partial(group.suite.cast_rays, geoms, surroundings=sensor_input.surroundings_or_empty)
            )(
                sensor_input.bodies,
                jnp.asarray(group.slots),
                jax.vmap(partial(group.suite.due, jnp.asarray(sensor_input.time)))(state.memory),
            )
        )
        for group, sensor_input, state in zip(scene.groups, sensor_inputs, world.groups, strict=True)
    )


def depth_in_water(arena: ArenaSpec, pos: Array) -> jax.Array:
    """Return how far a point (3,) is below water, negative above it [m] (); without any `DRY_DEPTH`."""
    depth = jnp.full((), DRY_DEPTH)
    for water in arena.waters:
        low, high = np.array(water.low), np.array(water.high)
        here = (pos[:2] >= low[:2]).all() & (pos[:2] <= high[:2]).all() & (pos[2] >= low[2] + arena.floor)
        depth = jnp.where(here, high[2] + arena.floor - pos[2], depth)
    return depth


def drowns(robot: RobotSpec, depth: jax.Array) -> jax.Array:
    """Return whether water kills the battery: of all but underwater robots (KRobot.uc) ()."""
    return (depth > 0) & (robot.drive.vehicle != "NauticVehicle")


def powered(scene: Scene, world: World, group: RobotGroup, state: GroupState) -> jax.Array:
    """Return which robots of a group are in use and have a battery that lasts (n,)."""
    age = time_of(scene, world) - state.battery_start
    return state.active & (age < group.robot.battery_life) & ~state.drowned


@jax.named_scope("compute_inputs")
def compute_inputs(scene: Scene, world: World, physics: PhysicsState) -> tuple[World, Inputs]:
    """Turn the commands in force into the engine's inputs for one control step.

    Parked robots are pinned where they wait; robots with an empty battery brake (KRobot.uc).
    """
    time = time_of(scene, world)
    ctrl, act = jnp.zeros(scene.model.nu), jnp.asarray(physics.act)
    xfrc_applied = jnp.zeros((scene.model.nbody, 6))
    pinned, pinned_dof = jnp.zeros(scene.model.nq, bool), jnp.zeros(scene.model.nv, bool)
    if world.arena_state is not None:
        loose, missing = scene.loose_geoms, jnp.asarray(~world.arena_state.present)
        pinned = _set_mask(pinned, loose.root_qposadr, missing)
        pinned_dof = _set_mask(pinned_dof, loose.root_dof, missing)
    refused = world.faults.refused
    groups: list[GroupState] = []
    for group, state in zip(scene.groups, world.groups, strict=True):
        robots = robot_states(group, physics)
        depth = jax.vmap(partial(depth_in_water, scene.arena))(robots.pos)
        state = state.replace(drowned=state.drowned | (state.active & drowns(group.robot, depth)))
        awake = powered(scene, world, group, state)
        torque, speed = (_of_group(world, group, name) for name in ("torque", "speed"))
        clock = jnp.broadcast_to(time, awake.shape)
        now = DriveConditions(time=clock, powered=awake, depth=depth, torque=torque, speed=speed)
        command, state = _delayed_command(world, group, state)

        run = jax.vmap(partial(compute_actuation, group.plan, period=scene.physics.period))
        driven = run(command, robots, physics.act[group.actadr], now)
        parked = ~state.active
        ctrl = ctrl.at[group.actuator_ids].set(driven.ctrl).at[group.hold_actuator_ids].set(driven.hold)
        act = act.at[group.actadr].set(jnp.where(parked[:, None], 0.0, driven.act))
        wrench = jnp.where(parked[:, None], 0.0, driven.wrench)
        xfrc_applied = xfrc_applied.at[group.chassis].set(wrench)
        for addresses in (group.root_qposadr, group.qposadr):
            pinned = _set_mask(pinned, addresses, parked)
        for addresses in (group.root_dofadr, group.dofadr):
            pinned_dof = _set_mask(pinned_dof, addresses, parked)
        refused = refused + driven.refused.sum().astype(jnp.int32)
        groups.append(state)
    inputs = Inputs(
        ctrl=ctrl,
        act=act,
        xfrc_applied=xfrc_applied,
        pinned=pinned,
        pinned_dof=pinned_dof,
        qpos=jnp.asarray(scene.model.qpos0, jnp.float32),
        geom_poses=moved_geom_poses(scene, world.arena_state, time),
        varied=world.varied,
    )
    return world.replace(groups=tuple(groups), faults=world.faults.replace(refused=refused)), inputs


def _of_group(world: World, group: RobotGroup, name: str) -> jax.Array | None:
    """Return a number of each of a group's robots (n,); None: it does not vary."""
    values = None if world.varied is None else getattr(world.varied, name)
    return None if values is None else values[group.slots]


def _delayed_command(world: World, group: RobotGroup, state: GroupState) -> tuple[RobotCommand, GroupState]:
    """Return what a group's motors have heard of by now, and the state that remembers what they have not."""
    latency, command = _of_group(world, group, "latency"), state.command
    if latency is None or state.command_history is None:
        return command, state
    told = CommandHistory(target=command.target, mode=command.mode, setpoint=command.setpoint)
    history = jax.tree.map(
        lambda new, old: jnp.concatenate([new[:, None], old], 1), told, state.command_history
    )
    heard = jax.tree.map(lambda values: values[np.arange(len(group.slots)), latency], history)
    command = command.replace(target=heard.target, mode=heard.mode, setpoint=heard.setpoint)
    return command, state.replace(command_history=jax.tree.map(lambda values: values[:, :-1], history))


def _set_mask(mask: jax.Array, addresses: np.ndarray, where: jax.Array) -> jax.Array:
    return mask.at[addresses].set(jnp.broadcast_to(where[:, None], addresses.shape))


@jax.named_scope("finish_step")
def finish_step(
    scene: Scene, world: World, physics: PhysicsState, overflow: jax.Array
) -> tuple[World, jax.Array]:
    """Count the step and what went wrong in it; return also whether the physics is still finite ()."""
    finite = (
        jnp.isfinite(physics.qpos).all() & jnp.isfinite(physics.qvel).all() & jnp.isfinite(physics.act).all()
    )
    fast = jnp.zeros((), bool)
    for group, state in zip(scene.groups, world.groups, strict=True):
        speed = jnp.linalg.norm(physics.qvel[group.root_dofadr[:, :3]], axis=-1)
        limit = max(RUNAWAY_SPEED, 1.5 * group.robot.drive.top_speed)
        fast |= (state.active & (speed > limit)).any()
    faults = world.faults.replace(
        not_finite=world.faults.not_finite + ~finite,
        overflow=world.faults.overflow + (overflow != 0),
        runaway=world.faults.runaway + (fast & finite),
    )
    return world.replace(step=world.step + 1, faults=faults), finite


def finish_and_compute_inputs(
    scene: Scene, world: World, physics: PhysicsState, overflow: jax.Array
) -> tuple[World, jax.Array, tuple[World, Inputs]]:
    """Finish a control step as `finish_step` does, and begin the next one as `compute_inputs` does."""
    world, finite = finish_step(scene, world, physics, overflow)
    return world, finite, compute_inputs(scene, world, physics)


@jax.named_scope("observe")
def observe(
    scene: Scene, world: World, physics: PhysicsState
) -> tuple[World, tuple[tuple[Reading, ...], ...]]:
    """Read the sensors that are due; per group and sensor a reading with a leading axis over robots."""
    sensor_inputs = sense(scene, world, physics)
    key = jax.random.fold_in(episode_key(world, Stream.SENSOR_NOISE), world.step)
    groups: list[GroupState] = []
    readings: list[tuple[Reading, ...]] = []
    for group, state, sensor_input in zip(scene.groups, world.groups, sensor_inputs, strict=True):
        with jax.named_scope(group.robot.name):
            memory, values = map_robots(group.suite.read, sensor_input, group, key, state.memory)
        groups.append(state.replace(memory=memory))
        readings.append(values)
    return world.replace(groups=tuple(groups)), tuple(readings)
