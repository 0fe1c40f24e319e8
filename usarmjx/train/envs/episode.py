"""What episodes of a task are made of: their beginning, their steps, their end. Pure functions to be traced.

`make_view`, `start_episode` and `apply_policy_actions` are of one world; `evaluate_step` and
`restart_some` of a batch.
"""

from functools import partial

import jax
import jax.numpy as jnp

from usarmjx.base.arrays import Array
from usarmjx.engines import PhysicsState
from usarmjx.models.build.arena_set import ArenaState
from usarmjx.sensors.base import Reading
from usarmjx.sim.actions import apply_actions
from usarmjx.sim.batch_state import select_worlds
from usarmjx.sim.radio import update_links
from usarmjx.sim.reset import reset
from usarmjx.sim.scene import Scene
from usarmjx.sim.streams import Stream
from usarmjx.sim.world import FaultCounts, World, episode_key, observe
from usarmjx.train.envs.state import EpisodeStart, Memory, Restart, TaskState
from usarmjx.train.envs.task import Task, TaskView

WRITTEN_ALONE = 1024
"""Of what is larger than so many numbers a world, rows are written. Of anything smaller all worlds' are
written again: a GPU has one kernel for many such, and for each that writes rows one of its own."""


@partial(jax.jit, static_argnums=0)  # so that it is traced once for all the functions that call it
def make_view(scene: Scene, world: World, physics: PhysicsState) -> tuple[World, TaskView]:
    """Read sensors and links."""
    world, readings = observe(scene, world, physics)
    if scene.radio is not None:
        world = world.replace(links=update_links(scene, world, physics))
    return world, TaskView(world=world, physics=physics, readings=readings, scene=scene)


@jax.named_scope("task.observe")
def _observe(task: Task, view: TaskView, memory: Memory) -> tuple[tuple[jax.Array, ...], jax.Array]:
    """Return what agents and critics observe."""
    obs = tuple(jnp.asarray(one, jnp.float32) for one in task.observe(view, memory))
    return obs, jnp.asarray(task.privileged(view, memory), jnp.float32)


def start_episode(
    scene: Scene, task: Task, world: World, physics: PhysicsState
) -> tuple[World, EpisodeStart]:
    """Begin an episode."""
    world, view = make_view(scene, world, physics)
    memory = task.start(view, jnp.asarray(episode_key(world, Stream.TASK_START)))
    obs, privileged = _observe(task, view, memory)
    zero = jnp.zeros((), jnp.int32)
    return world, EpisodeStart(
        memory=memory, obs=obs, privileged=privileged, score=jnp.zeros(()), length=zero
    )


def apply_policy_actions(
    scene: Scene,
    task: Task,
    world: World,
    physics: PhysicsState,
    memory: Memory,
    actions: tuple[Array, ...],
) -> World:
    """Command the robots, from a policy's actions per group (robots, action_size)."""
    clipped = tuple(jnp.clip(jnp.where(jnp.isfinite(a), a, 0.0), -1.0, 1.0) for a in actions)
    # Sensors are read once a step, at its end: actions are chosen and carried out on what was read then.
    last = tuple(
        tuple(Reading(value=value, fresh=jnp.zeros(state.active.shape, bool)) for value in state.memory.last)
        for state in world.groups
    )
    view = TaskView(world=world, physics=physics, readings=last, scene=scene)
    return apply_actions(scene, world, physics, task.act(view, memory, clipped))


def evaluate_step(
    scene: Scene, task: Task, state: TaskState, worlds: World, physics: PhysicsState, before: FaultCounts
) -> tuple[World, TaskState]:
    """Evaluate a step of all worlds, and observe.

    Args:
        scene: The scene.
        task: The task.
        state: How the task stood before it.
        worlds: The worlds after it.
        physics: Their physics.
        before: What had gone wrong until then.
    """
    now = worlds.faults
    bad = (now.not_finite > before.not_finite) | (now.overflow > before.overflow)
    worlds, views = jax.vmap(partial(make_view, scene))(worlds, physics)
    with jax.named_scope("task.evaluate"):
        result = jax.vmap(task.evaluate)(views, state.memory)
    obs, privileged = jax.vmap(partial(_observe, task))(views, result.memory)
    length = state.length + 1
    terminated, late = result.terminated & ~bad, length >= task.episode_steps
    done = terminated | late | bad
    score = jnp.where(bad, state.score, result.score)
    return worlds, state.replace(
        memory=result.memory,
        obs=obs,
        privileged=privileged,
        reward=tuple(jnp.where(bad[:, None], 0.0, reward) for reward in result.reward),
        done=done,
        truncated=late & ~terminated & ~bad & (task.time_limit == "truncation"),
        final_obs=obs,
        final_privileged=privileged,
        score=score,
        final_score=jnp.where(done, score, state.final_score),
        length=length,
        bad=bad,
        metrics={name: jnp.asarray(value, jnp.float32) for name, value in result.metrics.items()},
    )


@jax.named_scope("restart")
def restart_some(scene: Scene, task: Task, together: int, now: Restart, arenas: ArenaState | None) -> Restart:
    """Begin an episode in the first worlds of those that are left; only they are computed.

    Args:
        scene: The scene.
        task: The task.
        together: How many worlds; where fewer are left, some of the others are computed for nothing.
        now: All worlds, and which are left.
        arenas: See `sim.reset.reset`.
    """
    rows = jnp.nonzero(now.left, size=together, fill_value=len(now.left))[0]
    some = jax.tree.map(lambda old: old.at[rows].get(mode="clip"), now.worlds)
    fresh, qpos = jax.vmap(partial(reset, scene, shuffle=task.shuffle), in_axes=(0, None))(some, arenas)
    still = [jnp.zeros((together, size), jnp.float32) for size in (scene.model.nv, scene.model.na)]
    physics = PhysicsState(qpos=qpos, qvel=still[0], act=still[1])
    fresh, begun = jax.vmap(partial(start_episode, scene, task))(fresh, physics)

    place = jnp.full(now.left.shape, together).at[rows].set(jnp.arange(together), mode="drop")

    def put(old: jax.Array, new: jax.Array) -> jax.Array:
        if old[0].size > WRITTEN_ALONE:
            return old.at[rows].set(new, mode="drop")
        return select_worlds(place < together, new.at[place].get(mode="clip"), old)

    return Restart(
        worlds=jax.tree.map(put, now.worlds, fresh),
        begun=jax.tree.map(put, now.begun, begun),
        qpos=put(now.qpos, jnp.asarray(qpos)),
        left=now.left.at[rows].set(False, mode="drop"),
    )
