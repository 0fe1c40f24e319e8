"""How a world starts: its first episode and the next ones. Pure functions of one world."""

import jax
import jax.numpy as jnp

from usarmjx.base.arrays import Array
from usarmjx.cameras.mounts import cameras_of
from usarmjx.comms.links import no_links
from usarmjx.comms.mail import empty_inboxes
from usarmjx.engines.base import PhysicsState
from usarmjx.models.build.arena_set import ArenaState
from usarmjx.models.build.variation import max_wheel_radius, sample_values
from usarmjx.models.effecters import no_dropped_tags
from usarmjx.sensors.suite import NO_MEMORY
from usarmjx.sim.control import RobotCommand, idle_command
from usarmjx.sim.scene import Scene, origin_height, parking_position
from usarmjx.sim.site import arena_state_at, start_poses
from usarmjx.sim.streams import Stream
from usarmjx.sim.world import (
    CommandHistory,
    FaultCounts,
    GroupState,
    World,
    episode_key,
    map_robots,
    sense_self,
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
    faults = FaultCounts(not_finite=zero, overflow=zero, runaway=zero, refused=zero)
    world = World(
        key=key,
        number=number,
        arena_state=None,
        episode=zero - 1,
        step=zero,
        groups=(),
        tags=no_dropped_tags(),
        faults=faults,
    )
    return reset(scene, world, arenas, shuffle=shuffle)


@jax.named_scope("reset")
def reset(
    scene: Scene, world: World, arenas: ArenaState | None = None, *, shuffle: bool = False
) -> tuple[World, jax.Array]:
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
        arena_state=arena_state_at(arenas, world.number, episode),
        step=jnp.zeros((), jnp.int32),
        groups=(),
        tags=no_dropped_tags(),
        links=None if scene.radio is None else no_links(scene.num_robots),
        mail=None if scene.mail is None else empty_inboxes(scene.mail, scene.num_robots),
    )
    if scene.varied_bodies is not None:
        drawn = sample_values(
            scene.varied_bodies.vary, scene.varied_bodies.varies, episode_key(world, Stream.RANDOMIZATION)
        )
        world = world.replace(varied=drawn)
    qpos = _start_qpos(scene, world, shuffle)
    physics = PhysicsState(qpos=qpos, qvel=jnp.zeros(scene.model.nv), act=jnp.zeros(scene.model.na))
    groups: list[GroupState] = []
    for group in scene.groups:
        n = len(group.slots)
        active = jnp.array([not scene.roster[int(slot)].parked for slot in group.slots])
        command = jax.tree.map(lambda x, n=n: jnp.broadcast_to(x, (n, *x.shape)), idle_command(group.robot))
        groups.append(
            GroupState(
                command=command,
                active=active,
                battery_start=jnp.zeros(n),
                drowned=jnp.zeros(n, bool),
                releases=jnp.tile(jnp.array(group.releases, jnp.int32), (n, 1)),
                memory=NO_MEMORY,
                fov=jnp.tile(
                    jnp.array([c.default_fov for c in cameras_of(group.robot)], jnp.float32), (n, 1)
                ),
                command_history=_initial_history(scene, command),
            )
        )
    world = world.replace(groups=tuple(groups))
    key = episode_key(world, Stream.SENSOR_START)
    groups = [
        state.replace(
            memory=map_robots(group.suite.init_memory, sense_self(scene, world, physics, group), group, key)
        )
        for group, state in zip(scene.groups, world.groups, strict=True)
    ]
    return world.replace(groups=tuple(groups)), qpos


def _start_qpos(scene: Scene, world: World, shuffle: bool) -> jax.Array:
    """Active robots take start poses in the arena's (or a random) order, parked ones their places."""
    starts = start_poses(scene, world.arena_state)
    order = jnp.arange(len(starts))
    if shuffle:
        order = jax.random.permutation(episode_key(world, Stream.START_POSES), order)
    qpos = jnp.asarray(scene.model.qpos0, jnp.float32)
    if world.arena_state is not None:
        qpos = qpos.at[scene.loose_geoms.root_qposadr].set(world.arena_state.loose)
    active = [slot for slot, entry in enumerate(scene.roster) if not entry.parked]
    for group in scene.groups:
        for place, slot in enumerate(group.slots):
            address = group.root_qposadr[place]
            if slot in active:
                x, y, z, yaw = starts[order[active.index(slot)]]
                height = origin_height(scene.arena, z, group.robot)
                if world.varied is not None and world.varied.wheel is not None:
                    # Larger wheels shall not start in the floor.
                    height += jnp.maximum(world.varied.wheel[slot] - 1.0, 0.0) * max_wheel_radius(group.robot)
                root = [x, y, height, jnp.cos(yaw / 2), 0.0, 0.0, jnp.sin(yaw / 2)]
            else:
                root = [*parking_position(scene.arena, int(slot)), 1.0, 0.0, 0.0, 0.0]
            qpos = qpos.at[address].set(jnp.stack([jnp.asarray(v, jnp.float32) for v in root]))
    return qpos


def _initial_history(scene: Scene, command: RobotCommand) -> CommandHistory | None:
    """Return the history of robots that have not been told anything but the command."""
    latency = None if scene.vary is None else scene.vary.latency
    if latency is None:
        return None

    def before(value: Array) -> jax.Array:
        return jnp.repeat(jnp.asarray(value)[:, None], latency[1], 1)

    return CommandHistory(
        target=before(command.target), mode=before(command.mode), setpoint=before(command.setpoint)
    )
