"""One world: its state beside the physics, and what happens to it in a control step. Pure functions.

`batch` maps these over many worlds; nothing here knows which engine moves the robots.
"""

from collections.abc import Callable, Sequence
from enum import IntEnum
from functools import partial
from typing import Any, TypeVar

import jax
import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import (
    Array,
    Part,
    get_rows,
    known_all,
    named_scope,
    on_numpy,
    set_rows,
    traced_once,
    vmap,
    xp,
)
from usarmjx.base.clock import Clock
from usarmjx.base.nodes import Node
from usarmjx.comms.links import Links
from usarmjx.comms.mail import Inboxes, receive
from usarmjx.engines.base import GeomPoses, Inputs, PhysicsState
from usarmjx.models.compile.arena_set import ArenaState
from usarmjx.models.compile.kinematic_tree import BodyPoses, forward_kinematics
from usarmjx.models.compile.randomization import RandomizedValues
from usarmjx.models.drives import DRY_DEPTH
from usarmjx.models.drives.base import RobotState
from usarmjx.models.effecters import DroppedTags
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.base import ROBOT_FIELDS, Reading, SensorInput
from usarmjx.sensors.rays.raycast import NO_HITS, Hits, RayCaster, cast_rays
from usarmjx.sensors.suite import SensorMemory
from usarmjx.sensors.surroundings import Surroundings
from usarmjx.sim.control import DriveConditions, RobotCommand, compute_actuation
from usarmjx.sim.ray_geometry import (
    moved_geom_poses,
    ray_geoms,
    surroundings,
    visible_arena,
    visible_doors,
    visible_loose,
    visible_robots,
)
from usarmjx.sim.scene import RobotGroup, Scene


class Stream(IntEnum):
    """Streams of a world's random numbers; see `world.episode_key`. Other numbers change results of runs."""

    SENSOR_START = 0
    SENSOR_NOISE = 1
    START_POSES = 2
    RADIO = 3
    MAIL = 4
    TASK_START = 5
    TASK_STEP = 6
    RANDOMIZATION = 7


def depth_in_water(arena: ArenaSpec, pos: Array) -> Array:
    """Return the depth of points (..., 3) below water, negative above it [m] (...,); else `DRY_DEPTH`."""
    depth = xp.full(pos.shape[:-1], DRY_DEPTH)
    for water in arena.waters:
        low, high = np.array(water.low), np.array(water.high)
        inside = (pos[..., :2] >= low[:2]).all(-1) & (pos[..., :2] <= high[:2]).all(-1)
        here = inside & (pos[..., 2] >= low[2] + arena.floor)
        # Of overlapping bodies of water the later one counts.
        depth = xp.where(here, high[2] + arena.floor - pos[..., 2], depth)
    return depth


def drowns(robot: RobotSpec, depth: Array) -> Array:
    """Return whether water kills the battery: of all but underwater robots (KRobot.uc) (...,)."""
    return (depth > 0) & (robot.drive.vehicle != "NauticVehicle")


T = TypeVar("T")
RUNAWAY_SPEED = 5.0
"""A chassis faster than this, and than half more than its drive's top speed, did not get there by driving:
counted as a fault of the physics [m/s]."""


class CommandHistory(Node, kw_only=True):
    """Commands of a robot in the control steps before, the last one first.

    Attributes:
        target: `RobotCommand.target` (steps, joints).
        mode: `RobotCommand.mode` (steps, joints).
        setpoint: `RobotCommand.setpoint` (steps, keys).
    """

    target: Array
    mode: Array
    setpoint: Array


class GroupState(Node, kw_only=True):
    """The robots of one class in one world; leading axis over them.

    Attributes:
        command: Their commands (n, ...).
        active: Whether the robot is in use; the others are parked (n,).
        battery_start: Control step at which its battery was full (n,).
        drowned: Whether water has killed its battery (n,).
        hold: Inputs that their holding actuators had in the last control step (n, actuators).
        stiffness: Share of their gains and torque that their servos exert (n, actuators); None: all.
        releases: Stock of each of their effecters (n, effecters).
        memory: Memory of their sensors (n, ...).
        fov: Horizontal field of view of each of their cameras [rad] (n, cameras).
        command_history: Commands that latency may still delay (n, ...); None: no latency.
    """

    command: RobotCommand
    active: Array
    battery_start: Array
    drowned: Array
    hold: Array
    releases: Array
    memory: SensorMemory
    fov: Array
    command_history: CommandHistory | None = None
    stiffness: Array | None = None


class FaultCounts(Node, kw_only=True):
    """Faults in a world since the batch was made, as counts of control steps ().

    Attributes:
        not_finite: Steps after which the physics was not finite, and the world was reset or recovered.
        overflow: Steps in which contact buffers were full.
        runaway: Steps in which a robot was faster than it can drive; see `RUNAWAY_SPEED`.
        refused: Commanded numbers that were not finite.
        task: Steps after which the task's own reward, score or observation was not finite.
    """

    not_finite: Array
    overflow: Array
    runaway: Array
    refused: Array
    task: Array


class World(Node, kw_only=True):
    """Everything that changes in one world, but for the physics.

    Attributes:
        key: The world's random key, made from the batch's seed and the world's number ().
        number: The world's number ().
        arena_state: The world's arena; None where all worlds have the same.
        episode: Resets so far ().
        step: Control steps since the last reset ().
        groups: The robots by class.
        tags: RFID tags that robots have dropped.
        faults: Counts of faults.
        links: The radio links as last evaluated; None without a radio.
        mail: The robots' boxes; None without mail.
        varied: Randomized values of this world and its robots; None: nothing varies.
        ranges: The ranges that this draws from, where they differ between worlds: lowest and highest of
            some quantities of `DomainRandomization` (2,); None: all have the scene's.
    """

    key: Array
    number: Array
    arena_state: ArenaState | None
    episode: Array
    step: Array
    groups: tuple[GroupState, ...]
    tags: DroppedTags
    faults: FaultCounts
    links: Links | None = None
    mail: Inboxes | None = None
    varied: RandomizedValues | None = None
    ranges: dict[str, Array] | None = None

    def with_group(self, index: int, group: GroupState) -> "World":
        """Return the world with the state of one group of robots replaced; batched worlds alike."""
        return self.replace(groups=(*self.groups[:index], group, *self.groups[index + 1 :]))


def clock_of(scene: Scene, world: World) -> Clock:
    """Return the simulated time since the last reset ()."""
    return Clock(step=xp.asarray(world.step, xp.int32), period=scene.physics.period)


def episode_key(world: World, stream: Stream) -> Array:
    """Return the key of a stream of random numbers in the present episode."""
    if on_numpy():
        return random.fold_in(random.fold_in(world.key, stream), world.episode)
    # All streams at once, so that XLA computes them once: a fold is over a hundred operations to it.
    streams = random.fold_in(world.key, np.arange(len(Stream)))
    return jax.vmap(random.fold_in, (0, None))(streams, world.episode)[stream]


def robot_states(group: RobotGroup, physics: PhysicsState) -> RobotState:
    """Return the states of a group's robots; leading axis over them."""
    root, dof = physics.qpos[group.root_qposadr], physics.qvel[group.root_dofadr]
    return RobotState(
        pos=root[:, :3],
        quat=root[:, 3:],
        linear=dof[:, :3],
        angular=dof[:, 3:],
        joint_pos=physics.qpos[group.qposadr],
        joint_vel=physics.qvel[group.dofadr],
    )


def robot_keys(scene: Scene, group: RobotGroup, key: Array) -> Array:
    """Return a key for each of a group's robots (robots,), folded by its slot."""
    if on_numpy():
        return random.fold_in(key, group.slots)
    # Those of all robots, so that XLA computes them once.
    return get_rows(random.fold_in(key, np.arange(scene.num_robots)), group.slots)


def map_robots(function: Callable[..., T], sensor_input: SensorInput, keys: Array, *rest: object) -> T:
    """Map function(sensor_input, *rest, key) over some robots and their keys (robots,)."""
    own = {name: getattr(sensor_input, name) for name in (*ROBOT_FIELDS, "noise_factor")}

    def one(own: dict[str, Any], *rest: object) -> T:
        return function(sensor_input.replace(**own), *rest)

    return vmap(one)(own, *rest, keys)


def sense_self(
    scene: Scene,
    world: World,
    physics: PhysicsState,
    group: RobotGroup,
    around: Surroundings | None = None,
) -> SensorInput:
    """Return the sensor inputs of a group's robots without rays; leading axis over robots.

    Args:
        scene: The scene.
        world: The world.
        physics: State of the physics.
        group: The robots.
        around: The surroundings, if they are known already.
    """
    states = robot_states(group, physics)
    bodies = forward_kinematics(group.plan, states)
    # Sensors without rays need an input of the same structure.
    blind = jax.tree.map(lambda x: xp.zeros((len(group.slots), *x.shape)), NO_HITS)
    clock = clock_of(scene, world)
    around = surroundings(scene, world.arena_state, world.tags, clock) if around is None else around
    return SensorInput(
        clock=clock,
        state=states,
        bodies=bodies,
        hits=blind,
        surroundings=around,
        noise_factor=_group_values(world, group, "noise"),
    )


def caster(scene: Scene, world: World, physics: PhysicsState, bodies: Sequence[BodyPoses]) -> RayCaster:
    """Return a caster of rays at everything in a world, on JAX.

    Args:
        scene: The scene.
        world: The world.
        physics: State of the physics.
        bodies: Bodies of each group's robots; leading axis over robots.
    """
    geoms = ray_geoms(
        [
            *visible_arena(scene, world.arena_state, clock_of(scene, world)),
            visible_loose(scene, physics),
            visible_doors(scene, physics),
            *visible_robots(scene, bodies, [state.active for state in world.groups]),
        ]
    )
    return partial(cast_rays, geoms)


@named_scope("cast_rays")
def sense(
    scene: Scene, world: World, physics: PhysicsState, cast: RayCaster | None = None
) -> tuple[SensorInput, ...]:
    """Return the sensor inputs of each group's robots with rays; leading axis over robots, but for the time.

    Args:
        scene: The scene, or one with some of a world's robots only.
        world: The world, of these robots.
        physics: State of the physics.
        cast: Casts rays; None: those of `caster`.
    """
    around = surroundings(scene, world.arena_state, world.tags, clock_of(scene, world))
    inputs = [sense_self(scene, world, physics, group, around) for group in scene.groups]
    cast = caster(scene, world, physics, [one.bodies for one in inputs]) if cast is None else cast
    return tuple(
        one.replace(
            hits=_hits(group, one, state.memory, cast),
            battery=battery_left(scene, world, group, state) if group.suite.needs_battery else None,
        )
        for group, one, state in zip(scene.groups, inputs, world.groups, strict=True)
    )


def _hits(group: RobotGroup, inputs: SensorInput, memory: SensorMemory, cast: RayCaster) -> Hits:
    """Return the hits of the rays of a group's robots (robots, rays); those of sensors that are due."""

    def one(bodies: BodyPoses, slot: Array, due: Array, own: tuple[Any, ...] | None) -> Hits:
        return group.suite.hits(cast, bodies, slot, due, inputs.surroundings_or_empty, own)

    together = one if on_numpy() else vmap(one)
    own = memory.own if group.suite.steers_rays else None
    return together(inputs.bodies, xp.asarray(group.slots), group.suite.due(inputs.clock, memory), own)


def battery_left(scene: Scene, world: World, group: RobotGroup, state: GroupState) -> Array:
    """Return the battery time left of a group's robots, 0 if drowned [s] (n,)."""
    age = clock_of(scene, world).since(state.battery_start)
    # `since` wraps around with the count: an age is exact for up to 2**31 steps.
    return xp.where(state.drowned, 0.0, xp.maximum(group.robot.battery_life - age, 0.0))


def powered(scene: Scene, world: World, group: RobotGroup, state: GroupState) -> Array:
    """Return which robots of a group are in use and have a battery that lasts (n,)."""
    age = clock_of(scene, world).since(state.battery_start)
    return state.active & ~state.drowned & (group.robot.battery_life - age > 0)


@traced_once("solved")
@named_scope("compute_inputs")
def compute_inputs(
    scene: Scene, world: World, physics: PhysicsState, moved: GeomPoses | None = None, *, solved: bool = True
) -> tuple[World, Inputs]:
    """Turn the commands in force into the engine's inputs for one control step.

    Parked robots are pinned where they wait; robots with an empty battery brake (KRobot.uc).

    Args:
        scene: The scene.
        world: The world.
        physics: State of the physics.
        moved: Present poses of the moving geoms, if they are known already.
        solved: Whether the engine solves for contact forces.
    """
    clock = clock_of(scene, world)
    ctrl, act, wrenches, pinned, pinned_dof = (list[Part]() for _ in range(5))
    if world.arena_state is not None:
        # All worlds share one model: loose objects that this world's arena lacks are held where they are.
        loose, missing = scene.loose_geoms, xp.asarray(~world.arena_state.present)[:, None]
        pinned.append((loose.root_qposadr, missing))
        pinned_dof.append((loose.root_dof, missing))
    refused = world.faults.refused
    groups: list[GroupState] = []
    for group, state in zip(scene.groups, world.groups, strict=True):
        robots = robot_states(group, physics)
        depth = depth_in_water(scene.arena, robots.pos)
        if scene.arena.waters:
            state = state.replace(drowned=state.drowned | (state.active & drowns(group.robot, depth)))
        awake = powered(scene, world, group, state)
        factors = {name: _group_values(world, group, name) for name in ("torque", "speed")}
        own = {"hold": state.hold, "stiffness": state.stiffness, **factors}
        step = xp.broadcast_to(clock.step, awake.shape)  # `vmap` over robots needs the axis
        now = DriveConditions(step=step, powered=awake, depth=depth, solved=solved, **own)
        command, state = _delayed_command(world, group, state)
        driven = compute_actuation(
            group.plan, command, robots, physics.act[group.actadr], now, scene.physics.period
        )
        ctrl += [(group.actuator_ids, driven.ctrl), (group.hold_actuator_ids, driven.hold)]
        if known_all(state.active):
            act.append((group.actadr, driven.act))
            wrenches.append((group.chassis, driven.wrench))
        else:
            parked = ~state.active[:, None]
            act.append((group.actadr, xp.where(parked, 0.0, driven.act)))
            wrenches.append((group.chassis, xp.where(parked, 0.0, driven.wrench)))
            pinned += [(places, parked) for places in (group.root_qposadr, group.qposadr)]
            pinned_dof += [(places, parked) for places in (group.root_dofadr, group.dofadr)]
        refused = refused + driven.refused.sum().astype(xp.int32)
        groups.append(state.replace(hold=driven.hold))
    inputs = Inputs(
        ctrl=set_rows(xp.zeros(scene.model.nu), *ctrl),
        act=set_rows(physics.act, *act),
        xfrc_applied=set_rows(xp.zeros((scene.model.nbody, 6)), *wrenches),
        pinned=set_rows(xp.zeros(scene.model.nq, bool), *pinned),
        pinned_dof=set_rows(xp.zeros(scene.model.nv, bool), *pinned_dof),
        qpos=xp.asarray(scene.parked_qpos),
        geom_poses=moved_geom_poses(scene, world.arena_state, clock) if moved is None else moved,
        varied=world.varied,
    )
    return world.replace(groups=tuple(groups), faults=world.faults.replace(refused=refused)), inputs


def _group_values(world: World, group: RobotGroup, name: str) -> Array | None:
    """Return a number of each of a group's robots (n,); None: it does not vary."""
    values = None if world.varied is None else getattr(world.varied, name)
    return None if values is None else get_rows(values, group.slots)


def _delayed_command(world: World, group: RobotGroup, state: GroupState) -> tuple[RobotCommand, GroupState]:
    """Return the command that has reached a group's motors by now, and the state with the delayed ones."""
    latency, command = _group_values(world, group, "latency"), state.command
    if latency is None or state.command_history is None:
        return command, state
    current = CommandHistory(target=command.target, mode=command.mode, setpoint=command.setpoint)
    # Row 0 is the present command and row k that of k steps before, so a latency is an index.
    history = jax.tree.map(
        lambda new, old: xp.concatenate([new[:, None], old], 1), current, state.command_history
    )
    delayed = jax.tree.map(lambda values: values[np.arange(len(group.slots)), latency], history)
    command = command.replace(target=delayed.target, mode=delayed.mode, setpoint=delayed.setpoint)
    return command, state.replace(command_history=jax.tree.map(lambda values: values[:, :-1], history))


def runaway_limit(robot: RobotSpec) -> float:
    """Return the highest plausible speed of a robot's chassis [m/s]."""
    return max(RUNAWAY_SPEED, 1.5 * robot.drive.top_speed)


def _chassis_speeds(scene: Scene, physics: PhysicsState) -> Array:
    """Return the speeds of all robots' chassis, group by group [m/s] (robots,)."""
    dofs = np.concatenate([group.root_dofadr[:, :3] for group in scene.groups])
    return xp.linalg.norm(physics.qvel[dofs], axis=-1)


def _runaway_limits(scene: Scene) -> np.ndarray:
    """Return `runaway_limit` of all robots, group by group [m/s] (robots,)."""
    limits = [np.full(len(group.slots), runaway_limit(group.robot)) for group in scene.groups]
    return np.concatenate(limits).astype(np.float32)


@named_scope("finish_step")
def finish_step(scene: Scene, world: World, physics: PhysicsState, overflow: Array) -> tuple[World, Array]:
    """Count the step and its faults; return also whether the physics is still finite ()."""
    # All in one, and all groups in one: a GPU has a kernel for each reduction. So each number gets a grade,
    # and the highest counts: 2 of a number that is not finite, 1 of a robot that runs away.
    values = xp.concatenate([physics.qpos, physics.qvel, physics.act])
    grades = [xp.where(xp.isfinite(values), 0, 2)]
    if scene.groups:
        active = xp.concatenate([state.active for state in world.groups])
        # NaN compares false, and an infinite speed is not finite already.
        fast = active & (_chassis_speeds(scene, physics) > _runaway_limits(scene))
        grades.append(xp.where(fast, 1, 0))
    highest = xp.concatenate(grades).max(initial=0)
    finite = highest < 2
    faults = world.faults.replace(
        not_finite=world.faults.not_finite + ~finite,
        overflow=world.faults.overflow + (overflow != 0),
        runaway=world.faults.runaway + (highest == 1),
    )
    return world.replace(step=world.step + 1, faults=faults), finite


def finish_and_compute_inputs(
    scene: Scene, world: World, physics: PhysicsState, overflow: Array
) -> tuple[World, Array, tuple[World, Inputs]]:
    """Finish a control step as `finish_step` does, and begin the next one as `compute_inputs` does."""
    world, finite = finish_step(scene, world, physics, overflow)
    # Only engines outside of JAX take this way, and all of them solve for contacts: `solved` stays True.
    return world, finite, compute_inputs(scene, world, physics)


@named_scope("observe")
def observe(
    scene: Scene, world: World, physics: PhysicsState, cast: RayCaster | None = None
) -> tuple[World, tuple[tuple[Reading, ...], ...]]:
    """Read the sensors that are due; per group and sensor a reading with a leading axis over robots.

    Messages under way that have arrived are in the robots' boxes afterwards.

    Arguments are those of `sense`.
    """
    sensor_inputs = sense(scene, world, physics, cast)
    # By the step's number and not by a running key: a reading does not depend on which steps were observed.
    key = random.fold_in(episode_key(world, Stream.SENSOR_NOISE), world.step)
    groups: list[GroupState] = []
    readings: list[tuple[Reading, ...]] = []
    for group, state, sensor_input in zip(scene.groups, world.groups, sensor_inputs, strict=True):
        with named_scope(group.robot.name):
            keys = robot_keys(scene, group, key)
            # NumPy reads all robots of a class in one call; factors of their own need one robot at a time.
            if on_numpy() and sensor_input.noise_factor is None:
                memory, values = group.suite.read(sensor_input, state.memory, keys)
            else:
                memory, values = map_robots(group.suite.read, sensor_input, keys, state.memory)
        groups.append(state.replace(memory=memory))
        readings.append(values)
    if world.mail is not None:
        # Here and not in the step: batches without observations pay nothing for mail.
        world = world.replace(mail=receive(world.mail, clock_of(scene, world)))
    return world.replace(groups=tuple(groups)), tuple(readings)
