"""Robots that drop out, leave or join within an episode, and teams that differ between worlds.

A task that has none of these returns None from `Task.team` and `Task.presence`, and its programs are the same
as without this module. Losses and late arrivals follow from the world as it is, so that a task needs no
memory of them.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Part, set_rows
from usarmjx.engines import Engine, PhysicsState
from usarmjx.sim.batch import BatchState
from usarmjx.sim.reset import new_group_state, start_qpos, start_sensors
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import GroupState, Stream, World, episode_key, powered

if TYPE_CHECKING:
    from usarmjx.train.envs.task import Task, TaskView

TEAM_KEY = 1
"""Folded into the key of an episode's start for the draw of its team."""


class Presence(NamedTuple):
    """Part that the robots take in a world, by slot.

    Attributes:
        alive: Whether the robot's agent acts, is rewarded and is learned from (robots,).
        present: Whether the robot is in the world; else it is parked, and its agent is not alive (robots,).
    """

    alive: jax.Array
    present: jax.Array


def team_key(world: World) -> jax.Array:
    """Return the key by which `Task.team` draws the team of the present episode."""
    # Folded, as `Task.start` draws with the key itself: its numbers must not depend on those of the team.
    return jax.random.fold_in(jnp.asarray(episode_key(world, Stream.TASK_START)), TEAM_KEY)


def in_use(scene: Scene, world: World) -> jax.Array:
    """Return which robots are not parked, by slot (robots,)."""
    parts = [(group.slots, state.active) for group, state in zip(scene.groups, world.groups, strict=True)]
    return jnp.asarray(set_rows(jnp.zeros(scene.num_robots, bool), *parts))


def begin_team(scene: Scene, task: "Task", world: World, qpos: jax.Array) -> tuple[World, jax.Array]:
    """Return a world at the start of an episode and its qpos (nq,), with absent robots parked."""
    present = task.team(scene, team_key(world))
    if present is None:
        return world, qpos
    parts = list[Part]()
    for group in scene.groups:
        # The pose of the model itself, far from the arena, where parked robots wait.
        waiting = np.asarray(scene.model.qpos0[group.root_qposadr], np.float32)
        rows = jnp.where(present[group.slots][:, None], qpos[group.root_qposadr], waiting)
        parts.append((group.root_qposadr, rows))
    return _with_active(scene, world, present), jnp.asarray(set_rows(qpos, *parts))


def _with_active(scene: Scene, world: World, present: jax.Array) -> World:
    groups = [
        state.replace(active=state.active & present[group.slots])
        for group, state in zip(scene.groups, world.groups, strict=True)
    ]
    return world.replace(groups=tuple(groups))


def alive_agents(task: "Task", view: "TaskView", presence: Presence) -> tuple[jax.Array, ...]:
    """Return which agents are alive, per group (robots,): those whose sensors have been read in the world."""
    alive = presence.alive & presence.present & in_use(view.scene, view.world)
    return tuple(alive[view.scene.groups[group].slots] for group in task.agent_groups(view.scene))


def masked(alive: tuple[jax.Array, ...] | None, values: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
    """Return values per group (..., robots) or (..., robots, n), 0 for agents that are not alive."""
    if alive is None:
        return values
    return tuple(
        # A choice, not a product: 0 times NaN is NaN.
        jnp.where(one.reshape(*one.shape, *[1] * (value.ndim - one.ndim)), value, 0.0)
        for one, value in zip(alive, values, strict=True)
    )


def carry_of_alive(carry: Any, *alive: tuple[Any, ...] | None) -> Any:  # noqa: ANN401 - a policy's own
    """Return a policy's carry, reset for agents that were not alive, or are not alive any more.

    Args:
        carry: A part per group, of arrays of its agents (worlds, robots, ...); any other carry stays.
        alive: Masks before and after an action, per group (worlds, robots); None: all are.
    """
    masks = [one for one in alive if one is not None]
    # A user's carry may have any form: what is not one part for each group is left alone.
    if len(masks) < len(alive) or not isinstance(carry, tuple):
        return carry
    keep = [jnp.asarray(before) & after for before, after in zip(*masks, strict=True)]
    parts = cast(tuple[Any, ...], carry)
    sizes = [{jnp.shape(leaf)[:2] for leaf in jax.tree.leaves(part)} for part in parts]
    if sizes != [{mask.shape} for mask in keep]:
        return parts

    def kept(mask: jax.Array, now: jax.Array) -> jax.Array:
        # Zeros, as memories of networks begin with.
        return jnp.where(mask.reshape(*mask.shape, *[1] * (now.ndim - 2)), now, 0)

    return tuple(jax.tree.map(partial(kept, mask), part) for mask, part in zip(keep, parts, strict=True))


def share_alive(alive: tuple[jax.Array, ...]) -> jax.Array:
    """Return the share of a world's agents that are alive (...,)."""
    # Over all agents at once: a mean of the groups' means would weigh those of small groups more.
    return jnp.concatenate(alive, -1).mean(-1)


def come_and_go(
    engine: Engine[Any], regroup_worlds: Callable[..., Any], batch: BatchState, present: jax.Array
) -> BatchState:
    """Return the worlds with robots parked that are not present, and those that join at their start poses.

    A robot that joins stands still there, its battery is full and its sensors start; its sensors are read
    after the next action. Nobody looks whether its start pose is free.

    Args:
        engine: The engine.
        regroup_worlds: `regroup` for all worlds, compiled.
        batch: The worlds.
        present: Which robots are to be in the world, by slot (worlds, robots).
    """
    worlds, joined, pins = regroup_worlds(batch.worlds, present)
    # Only on the host can the mask be read: a traced engine sets poses in any case.
    if not engine.traceable and not np.asarray(joined).any():
        return batch.replace(worlds=worlds)
    return batch.replace(worlds=worlds, physics=engine.set_qpos(batch.physics, *pins))


def regroup(
    scene: Scene, shuffle: bool, world: World, present: jax.Array
) -> tuple[World, jax.Array, tuple[jax.Array, jax.Array, jax.Array]]:
    """Return one world, which robots join (robots,), and what is set: which qpos, which dofs, and qpos.

    Args:
        scene: The scene.
        shuffle: Whether the episode's start poses were drawn.
        world: The world.
        present: Which robots are to be in it, by slot (robots,).
    """
    joined = present & ~in_use(scene, world)
    qpos = jnp.asarray(start_qpos(scene, world, shuffle))
    # All robots at their start poses: sensors are started for each, and kept for those that join.
    physics = PhysicsState(qpos=qpos, qvel=jnp.zeros(scene.model.nv), act=jnp.zeros(scene.model.na))
    groups, pinned, pinned_dof = list[GroupState](), list[Part](), list[Part]()
    for group, state in zip(scene.groups, world.groups, strict=True):
        mine = joined[group.slots]
        # The battery is full now, not since the start of the episode.
        since = jnp.full(len(group.slots), world.step)
        # Of all robots of the group: shapes must not depend on who joins.
        fresh = new_group_state(scene, group, True, since)
        fresh = start_sensors(scene, world, physics, group, fresh)
        state = jax.tree.map(partial(_where, mine), fresh, state)
        groups.append(state.replace(active=present[group.slots]))
        # Joints as well as the root: a robot that was here before must not keep their angles.
        pinned += [(at, mine[:, None]) for at in (group.root_qposadr, group.qposadr)]
        pinned_dof += [(at, mine[:, None]) for at in (group.root_dofadr, group.dofadr)]
    pins = (
        jnp.asarray(set_rows(jnp.zeros(scene.model.nq, bool), *pinned)),
        jnp.asarray(set_rows(jnp.zeros(scene.model.nv, bool), *pinned_dof)),
        qpos,
    )
    return world.replace(groups=tuple(groups)), joined, pins


def _where(mask: jax.Array, new: jax.Array, old: jax.Array) -> jax.Array:
    old = jnp.asarray(old)
    # The old type stays: a Python number in a fresh state would change it, and compile anew.
    return jnp.where(mask.reshape(-1, *[1] * (old.ndim - 1)), new, old).astype(old.dtype)


LOSS_KEY = 1
"""Folded into the key of a moment for the draw of losses."""


def drawn_team(scene: Scene, agents: np.ndarray, least: int, key: jax.Array) -> jax.Array:
    """Return which robots a world has in an episode, by slot (robots,).

    Args:
        scene: The scene.
        agents: Slots of the robots that may be missing.
        least: Least number of them; the number is uniform from that to all. 0: always all.
        key: A key of the episode.
    """
    everybody = jnp.ones(scene.num_robots, bool)
    if least == 0:
        return everybody
    size, order = jax.random.split(key)
    number = jax.random.randint(size, (), least, len(agents) + 1)
    place = jax.random.permutation(order, jnp.arange(len(agents)))
    # By a permutation, not by a draw for each: the number is uniform, and each team of a size equally likely.
    return everybody.at[agents].set(place < number)


def arrival_actions(scene: Scene, agents: np.ndarray, interval: float, period: float) -> np.ndarray:
    """Return the actions after which robots arrive, by slot (robots,): one robot each interval [s]."""
    actions = np.zeros(scene.num_robots, int)
    # The margin keeps a quotient such as 3.0000000004 from being rounded up to 4.
    actions[agents] = np.ceil(np.arange(len(agents)) * interval / period - 1e-6)
    return actions


def remaining_robots(
    view: "TaskView", agents: np.ndarray, least: int, arrivals: np.ndarray, repeat: int, loss_rate: float
) -> Presence:
    """Return which robots take part from now on.

    Args:
        view: The world.
        agents: Slots of the robots that may be missing.
        least: See `drawn_team`.
        arrivals: Result of `arrival_actions`.
        repeat: Control steps per action.
        loss_rate: Losses of a robot per second; a lost robot leaves the world.
    """
    scene, world = view.scene, view.world
    action = world.step // repeat
    team = drawn_team(scene, agents, least, team_key(world))
    arrives = team & (arrivals > 0) & (action == arrivals)
    # A lost robot is no longer in use, and arrives at one action only: it stays lost without a memory of it.
    present = in_use(scene, world) | arrives
    if loss_rate > 0:
        # A rate per second as a share per action: exponential lifetimes, whatever the length of an action.
        share = 1.0 - math.exp(-loss_rate * repeat * scene.physics.period)
        # Folded, as tasks may draw with the moment's key itself.
        drawn = jax.random.uniform(jax.random.fold_in(view.key, LOSS_KEY), (scene.num_robots,)) < share
        # Nobody is lost at the very start, or with the action in which it arrives.
        may = jnp.zeros(scene.num_robots, bool).at[agents].set(True) & (action > 0) & ~arrives
        present &= ~(drawn & may)
    awake = [
        (group.slots, powered(scene, world, group, state))
        for group, state in zip(scene.groups, world.groups, strict=True)
    ]
    return Presence(alive=jnp.asarray(set_rows(jnp.zeros(scene.num_robots, bool), *awake)), present=present)
