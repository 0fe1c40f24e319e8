"""A real task under other libraries' interfaces: their checkers, and the environment's own numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import usarmjx
from usarmjx.models.compile.physics import Physics

LIMIT = 4
"""Steps of an episode."""


def goal(engine, worlds=1):
    """A P2AT on an empty floor, in steps coarse enough for a test; it never reaches its goal."""
    light = {"ranges": (), "pose": "GroundTruth", "physics": Physics(timestep=0.01, substeps=5), "repeat": 2}
    return usarmjx.make("drive-to-goal", worlds, engine, episode_steps=LIMIT, radius=1e-6, **light)


@pytest.fixture(scope="module")
def env():
    return goal("c")


@pytest.mark.thorough
def test_a_task_passes_pettingzoo_checks(env):
    pytest.importorskip("pettingzoo", reason="needs the extra rl")
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    from usarmjx.train.adapters.pettingzoo import ParallelWorld

    parallel_api_test(ParallelWorld(env), num_cycles=2 * LIMIT)
    parallel_seed_test(lambda: ParallelWorld(env), num_cycles=LIMIT)


@pytest.mark.thorough
def test_a_task_as_a_gymnasium_vector_has_its_own_numbers(env):
    pytest.importorskip("gymnasium", reason="needs the extra rl")
    from usarmjx.train.adapters.gymnasium import VectorWorlds

    worlds = VectorWorlds(env)
    obs, _ = worlds.reset(seed=4)
    state = env.reset(4)
    np.testing.assert_array_equal(obs, state.obs[0][:, 0])
    for step in range(LIMIT):
        action = np.full(worlds.action_space.shape, 0.5, np.float32)
        obs, reward, ended, late, info = worlds.step(action)
        state = env.step(state, (jnp.asarray(action)[:, None],))
        np.testing.assert_array_equal(obs, state.obs[0][:, 0])
        np.testing.assert_allclose(reward, state.reward[0][:, 0])
        assert not ended.any()
        assert late.tolist() == [step == LIMIT - 1]
    np.testing.assert_array_equal(info["final_obs"][0], state.final_obs[0][0, 0])
    assert set(info["final_info"]) >= {*state.metrics, "score"}


@pytest.mark.slow
@pytest.mark.thorough
def test_a_task_is_mapped_by_jaxmarl_and_unrolled_by_brax():
    pytest.importorskip("jaxmarl", reason="needs the extra rl")
    pytest.importorskip("brax", reason="needs the extra train")
    from brax.training.acting import generate_unroll

    from usarmjx.train.adapters.brax import BatchedRobots
    from usarmjx.train.adapters.jaxmarl import MultiAgentWorld

    marl = MultiAgentWorld(goal("jax"))
    keys = jax.random.split(jax.random.key(0), 2)
    obs, state = jax.vmap(marl.reset)(keys)
    (name,) = marl.agents
    assert not np.array_equal(obs[name][0], obs[name][1]), "other keys, other goals"
    ahead = {name: jnp.full((2, *marl.action_space(name).shape), 0.5)}
    for step in range(LIMIT):
        obs, state, _, done, info = jax.vmap(marl.step)(keys, state, ahead)
        assert done["__all__"].tolist() == [step == LIMIT - 1] * 2
    assert bool(info["truncated"].all())
    assert all(bool(jnp.isfinite(row).all()) for row in obs.values())

    robots = BatchedRobots(goal("jax", 2))
    start = robots.reset(jax.random.key(0))

    def still(obs, key):
        return jnp.zeros((2, robots.action_size)), {}

    _, data = generate_unroll(robots, start, still, jax.random.key(1), LIMIT, extra_fields=("truncation",))
    assert data.observation.shape == (LIMIT, 2, robots.observation_size)
    np.testing.assert_array_equal(data.extras["state_extras"]["truncation"][:, 0], [0, 0, 0, 1])
