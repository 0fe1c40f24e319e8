"""What episodes of a task are made of: their beginning, their steps, their end. Pure functions to be traced.

`make_view`, `start_episode` and `apply_policy_actions` are of one world; `evaluate_step` and `reset_done_worlds` of a batch.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from usarmjx.engines import PhysicsState
from usarmjx.sensors.base import Reading
from usarmjx.sim.batch import select_worlds
from usarmjx.sim.radio import update_links
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import FaultCounts, World, episode_key, observe
from usarmjx.train.envs.actions import apply_actions
from usarmjx.train.envs.state import EnvState, EpisodeStart
from usarmjx.train.envs.task import TASK_STREAM, Task, TaskView

Array = jax.Array


def make_view(scene: Scene, world: World, physics: PhysicsState) -> tuple[World, TaskView]:
    """Read sensors and links."""
    world, readings = observe(scene, world, physics)
    if scene.radio is not None:
        world = world.replace(links=update_links(scene, world, physics))
    return world, TaskView(world=world, physics=physics, readings=readings, scene=scene)


def _see(task: Task, view: TaskView, memory: Any) -> tuple[tuple[Array, ...], Array]:  # noqa: ANN401
    """Return what agents and critics see."""
    obs = tuple(jnp.asarray(seen, jnp.float32) for seen in task.observe(view, memory))
    return obs, jnp.asarray(task.privileged(view, memory), jnp.float32)


def start_episode(
    scene: Scene, task: Task, world: World, physics: PhysicsState
) -> tuple[World, EpisodeStart]:
    """Begin an episode."""
    world, view = make_view(scene, world, physics)
    memory = task.start(view, episode_key(world, TASK_STREAM))
    obs, privileged = _see(task, view, memory)
    zero = jnp.zeros((), jnp.int32)
    return world, EpisodeStart(
        memory=memory, obs=obs, privileged=privileged, score=jnp.zeros(()), length=zero
    )


def apply_policy_actions(
    scene: Scene,
    task: Task,
    world: World,
    physics: PhysicsState,
    memory: Any,  # noqa: ANN401
    actions: tuple[Array, ...],
) -> World:
    """Give the robots their orders, from actions per group (robots, action_size)."""
    told = tuple(jnp.clip(jnp.where(jnp.isfinite(a), a, 0.0), -1.0, 1.0) for a in actions)
    last = tuple(
        tuple(Reading(value=value, fresh=jnp.zeros(state.active.shape, bool)) for value in state.memory.last)
        for state in world.groups
    )
    view = TaskView(world=world, physics=physics, readings=last, scene=scene)
    return apply_actions(scene, world, physics, task.act(view, memory, told))


def evaluate_step(
    scene: Scene, task: Task, state: EnvState, worlds: World, physics: PhysicsState, before: FaultCounts
) -> tuple[World, EnvState]:
    """Judge a step of all worlds.

    Args:
        scene: The scene.
        task: The task.
        state: That before the step, without its batch.
        worlds: The worlds after it.
        physics: Their physics.
        before: The status before it.
    """
    now = worlds.faults
    bad = (now.not_finite > before.not_finite) | (now.overflow > before.overflow)
    worlds, views = jax.vmap(partial(make_view, scene))(worlds, physics)
    verdict = jax.vmap(task.evaluate)(views, state.memory)
    obs, privileged = jax.vmap(partial(_see, task))(views, verdict.memory)
    length = state.length + 1
    terminated, late = verdict.terminated & ~bad, length >= task.episode_steps
    done = terminated | late | bad
    score = jnp.where(bad, state.score, verdict.score)
    return worlds, state.replace(
        memory=verdict.memory,
        obs=obs,
        privileged=privileged,
        reward=tuple(jnp.where(bad[:, None], 0.0, reward) for reward in verdict.reward),
        done=done,
        truncated=late & ~terminated & ~bad,
        final_obs=obs,
        final_privileged=privileged,
        score=score,
        final_score=jnp.where(done, score, state.final_score),
        length=length,
        bad=bad,
        metrics={name: jnp.asarray(value, jnp.float32) for name, value in verdict.metrics.items()},
    )


def reset_done_worlds(
    scene: Scene, task: Task, state: EnvState, worlds: World, physics: PhysicsState
) -> tuple[World, EnvState]:
    """Begin an episode in the worlds that are done; `state` is without its batch."""
    fresh, opening = jax.vmap(partial(start_episode, scene, task))(worlds, physics)
    here = partial(select_worlds, state.done)
    changed = {
        name: jax.tree.map(here, getattr(opening, name), getattr(state, name))
        for name in ("memory", "obs", "privileged", "score", "length")
    }
    return jax.tree.map(here, fresh, worlds), state.replace(**changed)
