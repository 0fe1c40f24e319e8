"""The start of a world: its first episode and the next ones. Pure functions of one world."""

import jax
import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, ArrayLike, Part, named_scope, on_numpy, set_rows, traced_once, xp
from usarmjx.base.rotations import parts, quat_times
from usarmjx.comms.links import no_links
from usarmjx.comms.mail import empty_inboxes
from usarmjx.engines.base import PhysicsState
from usarmjx.models.compile.arena_set import ArenaState
from usarmjx.models.compile.randomization import sample_values
from usarmjx.models.compile.standing import stance_of, stances_in
from usarmjx.models.effecters import no_dropped_tags
from usarmjx.sensors.cameras.mounts import cameras_of
from usarmjx.sensors.suite import NO_MEMORY
from usarmjx.sim.control import RobotCommand, idle_command
from usarmjx.sim.ray_geometry import arena_state_at, start_poses
from usarmjx.sim.scene import RobotGroup, Scene, origin_height, parking_position
from usarmjx.sim.world import (
    CommandHistory,
    FaultCounts,
    GroupState,
    Stream,
    World,
    episode_key,
    map_robots,
    robot_keys,
    sense_self,
)


def init_world(
    scene: Scene,
    key: Array,
    number: Array,
    arenas: ArenaState | None = None,
    *,
    shuffle: bool = False,
) -> tuple[World, Array]:
    """Return a new world and the qpos (nq,) it starts from; see `reset`."""
    zero = xp.zeros((), xp.int32)
    faults = FaultCounts(not_finite=zero, overflow=zero, runaway=zero, refused=zero, task=zero)
    world = World(
        key=key,
        number=number,
        arena_state=None,
        # `reset` counts up: the first episode is 0.
        episode=zero - 1,
        step=zero,
        groups=(),
        tags=no_dropped_tags(),
        faults=faults,
    )
    return reset(scene, world, arenas, shuffle=shuffle)


@traced_once("shuffle")
@named_scope("reset")
def reset(
    scene: Scene, world: World, arenas: ArenaState | None = None, *, shuffle: bool = False
) -> tuple[World, Array]:
    """Return the world at the start of its next episode, and the qpos (nq,) it starts from.

    Args:
        scene: The scene.
        world: The world as it was; its key, number and faults live on.
        arenas: The arenas that worlds go through (arenas, ...); None: all have the scene's.
        shuffle: Draw the robots' start poses instead of handing them out in the arena's order.
    """
    episode = world.episode + 1
    world = world.replace(
        episode=episode,
        # The arena comes first: start poses and victims are read from it below.
        arena_state=arena_state_at(arenas, world.number, episode),
        step=xp.zeros((), xp.int32),
        groups=(),
        tags=no_dropped_tags(),
        links=None if scene.radio is None else no_links(scene.num_robots),
        mail=None if scene.mail is None else empty_inboxes(scene.mail, scene.num_robots),
    )
    if scene.varied_bodies is not None:
        drawn = sample_values(
            scene.varied_bodies.vary,
            scene.varied_bodies.varies,
            episode_key(world, Stream.RANDOMIZATION),
            world.ranges,
        )
        world = world.replace(varied=drawn)
    qpos = start_qpos(scene, world, shuffle)
    physics = PhysicsState(qpos=qpos, qvel=xp.zeros(scene.model.nv), act=xp.zeros(scene.model.na))
    return _with_idle_robots(scene, world, physics), qpos


def restart_in_place(scene: Scene, world: World, physics: PhysicsState) -> World:
    """Return a world at the start of its next episode in the same arena, its robots where they are.

    Args:
        scene: The scene.
        world: The world as it was; its key, number and faults live on.
        physics: State of the physics.
    """
    world = world.replace(
        episode=world.episode + 1,
        step=xp.zeros((), xp.int32),
        tags=no_dropped_tags(),
        links=None if scene.radio is None else no_links(scene.num_robots),
    )
    return _with_idle_robots(scene, world, physics)


def _with_idle_robots(scene: Scene, world: World, physics: PhysicsState) -> World:
    """Return a world whose robots have idle commands and whose sensors start now."""
    groups: list[GroupState] = []
    for group in scene.groups:
        active = xp.array([not scene.roster[int(slot)].parked for slot in group.slots])
        groups.append(new_group_state(scene, group, active, xp.zeros(len(group.slots), xp.int32)))
    # All groups are in the world before any sensor starts: sensors may look at other robots.
    world = world.replace(groups=tuple(groups))
    groups = [
        start_sensors(scene, world, physics, group, state)
        for group, state in zip(scene.groups, world.groups, strict=True)
    ]
    return world.replace(groups=tuple(groups))


def new_group_state(scene: Scene, group: RobotGroup, active: ArrayLike, since: Array) -> GroupState:
    """Return robots with idle commands whose sensors have not started.

    Args:
        scene: The scene.
        group: Robots of one class.
        active: Which of them are in use, broadcast to (robots,).
        since: Control step at which their batteries are full (robots,).
    """
    n = len(group.slots)
    command = jax.tree.map(lambda x: xp.broadcast_to(x, (n, *x.shape)), idle_command(group.robot))
    return GroupState(
        command=command,
        active=xp.broadcast_to(active, (n,)),
        battery_start=since,
        drowned=xp.zeros(n, bool),
        hold=xp.ones((n, len(group.plan.actuated))),
        releases=xp.tile(xp.array(group.releases, xp.int32), (n, 1)),
        memory=NO_MEMORY,
        fov=xp.tile(xp.array([c.default_fov for c in cameras_of(group.robot)], xp.float32), (n, 1)),
        command_history=_initial_history(scene, command),
    )


def start_sensors(
    scene: Scene, world: World, physics: PhysicsState, group: RobotGroup, state: GroupState
) -> GroupState:
    """Return the state of robots whose sensors start now, as those of all do at a reset.

    Args:
        scene: The scene.
        world: The world that they join.
        physics: State of the physics.
        group: Robots of one class, some of a group of the scene or others.
        state: As `new_group_state` returns it.
    """
    key = episode_key(world, Stream.SENSOR_START)
    if on_numpy() and world.step:  # those who join later draw other numbers than those who began
        key = random.fold_in(key, world.step)
    inputs = sense_self(scene, world, physics, group)
    return state.replace(memory=map_robots(group.suite.init_memory, inputs, robot_keys(scene, group, key)))


def start_qpos(scene: Scene, world: World, shuffle: bool) -> Array:
    """Return qpos: active robots rest at start poses in the arena's or random order, the others wait."""
    starts = start_poses(scene, world.arena_state)
    # All start poses are shuffled, not only as many as there are robots: each may be drawn.
    order = xp.arange(len(starts))
    if shuffle:
        order = random.permutation(episode_key(world, Stream.START_POSES), order)
    rows = list[Part]()
    if world.arena_state is not None:
        # The model has the loose objects of the template, each world those of its own arena.
        rows.append((scene.loose_geoms.root_qposadr, world.arena_state.loose))
    active = [slot for slot, entry in enumerate(scene.roster) if not entry.parked]
    for group in scene.groups:
        stands = np.isin(group.slots, active)
        if stands.any():
            slots = group.slots[stands]
            # Start poses go to the robots in use by their rank among these, whatever their class.
            x, y, z, yaw = starts[order[np.array([active.index(slot) for slot in slots])]].T
            height = origin_height(scene.arena, z, group.robot)
            tilt: Array = np.asarray(stance_of(group.robot).tilt, np.float32)
            own = stances_in(scene.vary, world.varied, group.robot, slots)
            if own is not None:
                height, tilt = height + own.lift, own.tilt
                rows.append((group.qposadr[stands], own.joints))
            none = xp.zeros_like(x)
            heading = xp.cos(yaw / 2), none, none, xp.sin(yaw / 2)
            # Heading times tilt: the tilt is in the robot's own axes.
            turned = quat_times(heading, parts(tilt))
            # MuJoCo's order: position, then the quaternion with w first.
            root = xp.stack([x, y, height, *turned], -1)
            rows.append((group.root_qposadr[stands], xp.asarray(root, xp.float32)))
        if not stands.all():
            parked = [parking_position(scene.arena, int(slot)) for slot in group.slots[~stands]]
            root = np.array([[*position, 1.0, 0.0, 0.0, 0.0] for position in parked], np.float32)
            rows.append((group.root_qposadr[~stands], xp.asarray(root)))
    # Coordinates without a row stay as described: doors, and the joints of parked robots.
    return set_rows(xp.asarray(scene.parked_qpos), *rows)


def _initial_history(scene: Scene, command: RobotCommand) -> CommandHistory | None:
    """Return a history that holds nothing but the present command."""
    latency = None if scene.vary is None else scene.vary.latency
    if latency is None:
        return None

    def repeated(value: Array) -> Array:
        # As long as the longest latency, so that shapes are the same in all worlds.
        return xp.repeat(xp.asarray(value)[:, None], latency[1], 1)

    return CommandHistory(
        target=repeated(command.target), mode=repeated(command.mode), setpoint=repeated(command.setpoint)
    )
