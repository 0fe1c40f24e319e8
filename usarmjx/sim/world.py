"""One world: its state beside the physics, and what happens to it in a control step. Pure functions.

`batch` maps these over many worlds; nothing here knows which engine moves the robots.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.cameras.mounts import cameras_of
from usarmjx.comms.links import Links, no_links
from usarmjx.comms.mail import Inboxes, empty_inboxes
from usarmjx.engines.base import Inputs, PhysicsState
from usarmjx.models.build.arena_set import ArenaState
from usarmjx.models.build.body_plan import forward_kinematics
from usarmjx.models.build.variation import RandomizedValues, max_wheel_radius, sample_values
from usarmjx.models.drives import DRY_DEPTH
from usarmjx.models.drives.state import RobotState
from usarmjx.models.effecters import DroppedTags, no_dropped_tags
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.base import Reading, SensorInput
from usarmjx.sensors.rays.raycast import NO_HITS
from usarmjx.sensors.suite import NO_MEMORY, SensorMemory
from usarmjx.sim.control import DriveConditions, RobotCommand, compute_actuation, idle_command
from usarmjx.sim.scene import RobotGroup, Scene, origin_height, parking_position
from usarmjx.sim.site import arena_state_at, moved_geom_poses, start_poses, surroundings
from usarmjx.sim.visible import ray_geoms, visible_arena, visible_doors, visible_loose, visible_robots

RUNAWAY_SPEED = 5.0
"""A chassis faster than this, and than half more than its drive's top speed, did not get there by driving:
counted as a fault of the physics [m/s]."""
SENSOR_START_STREAM, NOISE_STREAM, START_POSE_STREAM, RADIO_STREAM, MAIL_STREAM = 0, 1, 2, 3, 4
"""First fold of a world's key, by what the numbers are for."""
RANDOMIZATION_STREAM = 7
"""The same for domain randomisation; 5 and 6 are those of `train.envs.task`."""


class CommandHistory(struct.PyTreeNode, kw_only=True):
    """What a team's robots were told in the control steps before, the last one first (n, steps, ...)."""

    target: jax.Array
    mode: jax.Array
    setpoint: jax.Array


class GroupState(struct.PyTreeNode, kw_only=True):
    """The robots of one class in one world; leading axis over them.

    Attributes:
        command: What they are told to do.
        active: Whether the robot is in use; the others are parked (n,).
        battery_start: When its battery was full [s] (n,).
        drowned: Whether water has killed its battery (n,).
        releases: What each of their effecters has left to release (n, effecters).
        memory: What their sensors remember.
        fov: Horizontal field of view of each of their cameras [rad] (n, cameras).
        command_history: What they were told and may not have heard yet; None: they hear at once.
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


def time_of(scene: Scene, world: World) -> jax.Array:
    """Return the simulated time since the last reset [s] ()."""
    return world.step.astype(jnp.float32) * scene.physics.period


def episode_key(world: World, stream: int) -> jax.Array:
    """Return the key of a stream of random numbers in the present episode."""
    return jax.random.fold_in(jax.random.fold_in(world.key, stream), world.episode)


def robot_states(group: RobotGroup, physics: PhysicsState) -> RobotState:
    """Return where a team's robots are; leading axis over them."""
    root, dof = physics.qpos[group.root_qposadr], physics.qvel[group.root_dofadr]
    return RobotState(
        pos=root[:, :3],
        quat=root[:, 3:],
        linear=dof[:, :3],
        angular=dof[:, 3:],
        joint_pos=physics.qpos[group.qposadr],
        joint_vel=physics.qvel[group.dofadr],
    )


def init_world(
    scene: Scene,
    key: jax.Array,
    number: jax.Array,
    arenas: ArenaState | None = None,
    *,
    shuffle: bool = False,
) -> tuple[World, jax.Array]:
    """Return a new world and the qpos (nq,) it starts from; see `reset`."""
    zero = jnp.zeros((), jnp.int32)
    status = FaultCounts(not_finite=zero, overflow=zero, runaway=zero, refused=zero)
    before = {"site": None, "episode": zero - 1, "step": zero, "teams": (), "tags": no_dropped_tags()}
    world = World(key=key, number=number, faults=status, **before)
    return reset(scene, world, arenas, shuffle=shuffle)


def reset(
    scene: Scene, world: World, arenas: ArenaState | None = None, *, shuffle: bool = False
) -> tuple[World, jax.Array]:
    """Return the world at the start of its next episode, and the qpos (nq,) it starts from.

    Args:
        scene: The scene.
        world: The world as it was; its key, number and status live on.
        arenas: The arenas that worlds go through (arenas, ...); None: all have the scene's.
        shuffle: Draw the robots' start poses instead of handing them out in the arena's order.
    """
    episode = world.episode + 1
    world = world.replace(
        episode=episode,
        arena_state=arena_state_at(arenas, world.number, episode),
        step=jnp.zeros((), jnp.int32),
        groups=(),
        tags=no_dropped_tags(),
        links=None if scene.radio is None else no_links(scene.num_robots),
        mail=None if scene.mail is None else empty_inboxes(scene.mail, scene.num_robots),
    )
    if scene.varied_bodies is not None:
        drawn = sample_values(
            scene.varied_bodies.vary, scene.varied_bodies.varies, episode_key(world, RANDOMIZATION_STREAM)
        )
        world = world.replace(varied=drawn)
    qpos = _start_qpos(scene, world, shuffle)
    physics = PhysicsState(qpos=qpos, qvel=jnp.zeros(scene.model.nv), act=jnp.zeros(scene.model.na))
    teams = []
    for team in scene.groups:
        n = len(team.slots)
        active = jnp.array([not scene.roster[slot].parked for slot in team.slots])
        command = jax.tree.map(lambda x, n=n: jnp.broadcast_to(x, (n, *x.shape)), idle_command(team.robot))
        teams.append(
            GroupState(
                command=command,
                active=active,
                battery_start=jnp.zeros(n),
                drowned=jnp.zeros(n, bool),
                releases=jnp.tile(jnp.array(team.releases, jnp.int32), (n, 1)),
                memory=NO_MEMORY,
                fov=jnp.tile(jnp.array([c.default_fov for c in cameras_of(team.robot)], jnp.float32), (n, 1)),
                command_history=_initial_history(scene, command),
            )
        )
    world = world.replace(groups=tuple(teams))
    key = episode_key(world, SENSOR_START_STREAM)
    teams = [
        state.replace(
            memory=_map_robots(team.suite.init_memory, sense_self(scene, world, physics, team), team, key)
        )
        for team, state in zip(scene.groups, world.groups, strict=True)
    ]
    return world.replace(groups=tuple(teams)), qpos


def _start_qpos(scene: Scene, world: World, shuffle: bool) -> jax.Array:
    """Active robots take start poses in the arena's (or a random) order, parked ones their places."""
    starts = start_poses(scene, world.arena_state)
    order = jnp.arange(len(starts))
    if shuffle:
        order = jax.random.permutation(episode_key(world, START_POSE_STREAM), order)
    qpos = jnp.asarray(scene.model.qpos0, jnp.float32)
    if world.arena_state is not None:
        qpos = qpos.at[scene.loose_geoms.root_qposadr].set(world.arena_state.loose)
    active = [slot for slot, entry in enumerate(scene.roster) if not entry.parked]
    for team in scene.groups:
        for place, slot in enumerate(team.slots):
            address = team.root_qposadr[place]
            if slot in active:
                x, y, z, yaw = starts[order[active.index(slot)]]
                height = origin_height(scene.arena, z, team.robot)
                if world.varied is not None and world.varied.wheel is not None:
                    # Larger wheels shall not start in the floor.
                    height += jnp.maximum(world.varied.wheel[slot] - 1.0, 0.0) * max_wheel_radius(team.robot)
                root = [x, y, height, jnp.cos(yaw / 2), 0.0, 0.0, jnp.sin(yaw / 2)]
            else:
                root = [*parking_position(scene.arena, int(slot)), 1.0, 0.0, 0.0, 0.0]
            qpos = qpos.at[address].set(jnp.stack([jnp.asarray(v, jnp.float32) for v in root]))
    return qpos


def _map_robots(
    function: Any, sensor_input: SensorInput, group: RobotGroup, key: jax.Array, *rest: Any
) -> Any:  # noqa: ANN401
    """Map function(sight, *rest, key) over a team's robots, with a key folded by each robot's slot."""
    keys = jax.vmap(partial(jax.random.fold_in, key))(group.slots)
    noise = None if sensor_input.noise_factor is None else 0
    shared: Any = SensorInput(time=None, state=0, bodies=0, hits=0, noise_factor=noise)  # type: ignore - axes, not values
    return jax.vmap(function, in_axes=(shared, *[0] * len(rest), 0))(sensor_input, *rest, keys)


def sense_self(scene: Scene, world: World, physics: PhysicsState, group: RobotGroup) -> SensorInput:
    """Return what a team's robots sense of themselves, no rays cast; leading axis over robots."""
    states = robot_states(group, physics)
    bodies = jax.vmap(partial(forward_kinematics, group.plan))(states)
    blind = jax.tree.map(lambda x: jnp.zeros((len(group.slots), *x.shape)), NO_HITS)
    time = time_of(scene, world)
    around = surroundings(scene, world.arena_state, world.tags, time)
    noise = None if world.varied is None or world.varied.noise is None else world.varied.noise[group.slots]
    return SensorInput(
        time=time, state=states, bodies=bodies, hits=blind, surroundings=around, noise_factor=noise
    )


def sense(scene: Scene, world: World, physics: PhysicsState) -> tuple[SensorInput, ...]:
    """Return what each team's robots sense, rays cast; leading axis over robots, but for the time."""
    sights = [sense_self(scene, world, physics, team) for team in scene.groups]
    geoms = ray_geoms(
        [
            *visible_arena(scene, world.arena_state, time_of(scene, world)),
            visible_loose(scene, physics),
            visible_doors(scene, physics),
            *visible_robots(
                scene, [sight.bodies for sight in sights], [state.active for state in world.groups]
            ),
        ]
    )
    return tuple(
        sight.replace(
            hits=jax.vmap(partial(team.suite.cast_rays, geoms, surroundings=sight.surroundings_or_empty))(
                sight.bodies,
                jnp.asarray(team.slots),
                jax.vmap(partial(team.suite.due, sight.time))(state.memory),
            )
        )
        for team, sight, state in zip(scene.groups, sights, world.groups, strict=True)
    )


def depth_in_water(arena: ArenaSpec, pos: jax.Array) -> jax.Array:
    """Return how far a point (3,) is below the surface of water, negative above it [m] (); else `DRY`."""
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
    """Return which robots of a team are in use and have a battery that lasts (n,)."""
    age = time_of(scene, world) - state.battery_start
    return state.active & (age < group.robot.battery_life) & ~state.drowned


def compute_inputs(scene: Scene, world: World, physics: PhysicsState) -> tuple[World, Inputs]:
    """Turn the commands in force into the engine's inputs for one control step.

    Parked robots are pinned where they wait; robots with an empty battery brake (KRobot.uc).
    """
    time = time_of(scene, world)
    inputs = Inputs(
        ctrl=jnp.zeros(scene.model.nu),
        act=physics.act,
        xfrc_applied=jnp.zeros((scene.model.nbody, 6)),
        pinned=jnp.zeros(scene.model.nq, bool),
        pinned_dof=jnp.zeros(scene.model.nv, bool),
        qpos=jnp.asarray(scene.model.qpos0, jnp.float32),
        geom_poses=moved_geom_poses(scene, world.arena_state, time),
        varied=world.varied,
    )
    if world.arena_state is not None:
        loose, missing = scene.loose_geoms, ~world.arena_state.present
        inputs = inputs.replace(
            pinned=_set_mask(inputs.pinned, loose.root_qposadr, missing),
            pinned_dof=_set_mask(inputs.pinned_dof, loose.root_dof, missing),
        )
    refused, teams = world.faults.refused, []
    for team, state in zip(scene.groups, world.groups, strict=True):
        robots = robot_states(team, physics)
        depth = jax.vmap(partial(depth_in_water, scene.arena))(robots.pos)
        state = state.replace(drowned=state.drowned | (state.active & drowns(team.robot, depth)))
        awake = powered(scene, world, team, state)
        torque, speed = (_of_group(world, team, name) for name in ("torque", "speed"))
        clock = jnp.broadcast_to(time, awake.shape)
        now = DriveConditions(time=clock, powered=awake, depth=depth, torque=torque, speed=speed)
        command, state = _delayed_command(world, team, state)

        run = jax.vmap(partial(compute_actuation, team.plan, period=scene.physics.period))
        driven = run(command, robots, physics.act[team.actadr], now)
        parked = ~state.active
        inputs = inputs.replace(
            ctrl=inputs.ctrl.at[team.actuator_ids]
            .set(driven.ctrl)
            .at[team.hold_actuator_ids]
            .set(driven.hold),
            act=inputs.act.at[team.actadr].set(jnp.where(parked[:, None], 0.0, driven.act)),
            xfrc_applied=inputs.xfrc_applied.at[team.chassis].set(
                jnp.where(parked[:, None], 0.0, driven.wrench)
            ),
            pinned=_set_mask(_set_mask(inputs.pinned, team.root_qposadr, parked), team.qposadr, parked),
            pinned_dof=_set_mask(_set_mask(inputs.pinned_dof, team.root_dofadr, parked), team.dofadr, parked),
        )
        refused = refused + driven.refused.sum().astype(jnp.int32)
        teams.append(state)
    status = world.faults.replace(refused=refused)
    return world.replace(groups=tuple(teams), faults=status), inputs


def _of_group(world: World, group: RobotGroup, name: str) -> jax.Array | None:
    """Return a number of each of a team's robots (n,); None: it does not vary."""
    values = None if world.varied is None else getattr(world.varied, name)
    return None if values is None else values[group.slots]


def _initial_history(scene: Scene, command: RobotCommand) -> CommandHistory | None:
    """Return the trail of robots that have not been told anything but the command."""
    latency = None if scene.vary is None else scene.vary.latency
    if latency is None:
        return None

    def before(value: Any) -> jax.Array:  # noqa: ANN401 - of either array module
        return jnp.repeat(jnp.asarray(value)[:, None], latency[1], 1)

    return CommandHistory(
        target=before(command.target), mode=before(command.mode), setpoint=before(command.setpoint)
    )


def _delayed_command(world: World, group: RobotGroup, state: GroupState) -> tuple[RobotCommand, GroupState]:
    """Return what a team's motors have heard of by now, and the state that remembers what they have not."""
    latency, command = _of_group(world, group, "latency"), state.command
    if latency is None or state.command_history is None:
        return command, state
    told = CommandHistory(target=command.target, mode=command.mode, setpoint=command.setpoint)
    trail = jax.tree.map(
        lambda new, old: jnp.concatenate([new[:, None], old], 1), told, state.command_history
    )
    heard = jax.tree.map(lambda values: values[np.arange(len(group.slots)), latency], trail)
    command = command.replace(target=heard.target, mode=heard.mode, setpoint=heard.setpoint)
    return command, state.replace(command_history=jax.tree.map(lambda values: values[:, :-1], trail))


def _set_mask(mask: jax.Array, addresses: np.ndarray, where: jax.Array) -> jax.Array:
    return mask.at[addresses].set(jnp.broadcast_to(where[:, None], addresses.shape))


def finish_step(
    scene: Scene, world: World, physics: PhysicsState, overflow: jax.Array
) -> tuple[World, jax.Array]:
    """Count the step and what went wrong in it; return also whether the physics is still finite ()."""
    finite = (
        jnp.isfinite(physics.qpos).all() & jnp.isfinite(physics.qvel).all() & jnp.isfinite(physics.act).all()
    )
    fast = jnp.zeros((), bool)
    for team, state in zip(scene.groups, world.groups, strict=True):
        speed = jnp.linalg.norm(physics.qvel[team.root_dofadr[:, :3]], axis=-1)
        limit = max(RUNAWAY_SPEED, 1.5 * team.robot.drive.top_speed)
        fast |= (state.active & (speed > limit)).any()
    status = world.faults
    status = status.replace(
        not_finite=status.not_finite + ~finite,
        overflow=status.overflow + (overflow != 0),
        runaway=status.runaway + (fast & finite),
    )
    return world.replace(step=world.step + 1, faults=status), finite


def observe(
    scene: Scene, world: World, physics: PhysicsState
) -> tuple[World, tuple[tuple[Reading, ...], ...]]:
    """Read the sensors that are due; per team and sensor a reading with a leading axis over robots."""
    sights = sense(scene, world, physics)
    key = jax.random.fold_in(episode_key(world, NOISE_STREAM), world.step)
    teams, readings = [], []
    for team, state, sight in zip(scene.groups, world.groups, sights, strict=True):

        def read(
            one: SensorInput, memory: SensorMemory, robot_key: jax.Array, suite: Any = team.suite
        ) -> Any:  # noqa: ANN401
            return suite.read(one, memory, robot_key)

        memory, values = _map_robots(read, sight, team, key, state.memory)
        teams.append(state.replace(memory=memory))
        readings.append(values)
    return world.replace(groups=tuple(teams)), tuple(readings)
