"""What episodes of a task are made of: their beginning, their steps, their end. Pure functions to be traced.

`look`, `open_episode` and `tell` are of one world; `finish` and `reopen` of a batch.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from usarmjx.engines import PhysicsState
from usarmjx.sensors.base import Reading
from usarmjx.sim.batch import choose
from usarmjx.sim.radio import present_links
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import Status, World, episode_key, observe
from usarmjx.train.envs.actions import carry_out
from usarmjx.train.envs.state import EnvState, Opening
from usarmjx.train.envs.task import TASK_STREAM, Task, View

Array = jax.Array


def look(scene: Scene, world: World, physics: PhysicsState) -> tuple[World, View]:
    """Read sensors and links."""
    world, readings = observe(scene, world, physics)
    if scene.radio is not None:
        world = world.replace(links=present_links(scene, world, physics))
    return world, View(world=world, physics=physics, readings=readings, scene=scene)


def _see(task: Task, view: View, memory: Any) -> tuple[tuple[Array, ...], Array]:  # noqa: ANN401
    """Return what agents and critics see."""
    obs = tuple(jnp.asarray(seen, jnp.float32) for seen in task.observe(view, memory))
    return obs, jnp.asarray(task.privileged(view, memory), jnp.float32)


def open_episode(scene: Scene, task: Task, world: World, physics: PhysicsState) -> tuple[World, Opening]:
    """Begin an episode."""
    world, view = look(scene, world, physics)
    memory = task.start(view, episode_key(world, TASK_STREAM))
    obs, privileged = _see(task, view, memory)
    zero = jnp.zeros((), jnp.int32)
    return world, Opening(memory=memory, obs=obs, privileged=privileged, score=jnp.zeros(()), length=zero)


def tell(
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
        for state in world.teams
    )
    view = View(world=world, physics=physics, readings=last, scene=scene)
    return carry_out(scene, world, physics, task.act(view, memory, told))


def finish(
    scene: Scene, task: Task, state: EnvState, worlds: World, physics: PhysicsState, before: Status
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
    now = worlds.status
    bad = (now.not_finite > before.not_finite) | (now.overflow > before.overflow)
    worlds, views = jax.vmap(partial(look, scene))(worlds, physics)
    verdict = jax.vmap(task.judge)(views, state.memory)
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


def reopen(
    scene: Scene, task: Task, state: EnvState, worlds: World, physics: PhysicsState
) -> tuple[World, EnvState]:
    """Begin an episode in the worlds that are done; `state` is without its batch."""
    fresh, opening = jax.vmap(partial(open_episode, scene, task))(worlds, physics)
    here = partial(choose, state.done)
    changed = {
        name: jax.tree.map(here, getattr(opening, name), getattr(state, name))
        for name in ("memory", "obs", "privileged", "score", "length")
    }
    return jax.tree.map(here, fresh, worlds), state.replace(**changed)
