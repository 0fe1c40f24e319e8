"""Teams of sixteen in the largest buildings of the tasks whose robots choose goals."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from usarmjx.train.make import make
from usarmjx.train.policies.sources import load_policy
from usarmjx.train.tasks import TASKS

TEAM = 16


def largest(name):
    """One of the largest buildings of a task."""
    arenas = TASKS.get(name).arena
    return replace(arenas, sizes=arenas.sizes[-1:], count=1, levels=(0.6,), renewable=False)


@pytest.mark.parametrize("name", ["explore-v3", "victim-search-v3", "relay-chain-v3"])
def test_sixteen_robots_and_the_base_start_apart(name):
    task = replace(TASKS.get(name), count=TEAM, arena=largest(name))
    scene = task.scene()
    assert scene.num_robots == 1 + TEAM
    at = np.array([start.at[:2] for start in scene.arena.starts[: scene.num_robots]])
    gaps = np.linalg.norm(at[:, None] - at[None], axis=-1)
    assert gaps[~np.eye(len(at), dtype=bool)].min() >= task.arena.spacing - 1e-6


@pytest.mark.thorough
def test_the_packaged_policy_plays_sixteen():
    env = make("explore-v3", engine="planar", physics="coarse", arena=largest("explore-v3"), count=TEAM)
    policy = load_policy("explore-v3").policy(env)
    act, carry, state = jax.jit(policy.act), policy.initial_carry(1), env.reset(0)
    for step in range(5 * env.task.hold):
        carry, actions = act(carry, state.obs, jax.random.key(step))
        state = env.step(state, actions)
    assert state.obs[0].shape[:2] == (1, TEAM)
    assert not state.bad.any()
    assert float(state.metrics["explored"][0]) > 0.1
    goals = np.asarray(state.memory.extra.goals.position)[0, 1:, 3:]
    there = np.asarray(state.memory.extra.goals.valid)[0, 1:, 3:]
    assert len(np.unique(goals[there].round(1), axis=0)) > TEAM, "frontiers of many places"
