"""However long an environment runs: memory stays as it is, and nothing is compiled after the first steps."""

import gc

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.listening import compilations
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import DomainRandomization
from usarmjx.train.make import make

CHUNK = 50
"""Actions of one compiled call."""
EPISODE = 40
OWN = {
    "planar": {"physics": "coarse", "arena": "yellow"},
    "c": {"physics": Physics(timestep=0.01, substeps=5)},
}
LIGHT = {"ranges": (), "pose": "GroundTruth", "repeat": 2}


def goal_env(engine="planar", worlds=8, **more):
    own = {"episode_steps": EPISODE, **LIGHT, **OWN[engine], **more}
    return make("drive-to-goal", worlds=worlds, engine=engine, **own)


def live_bytes():
    """What arrays of JAX hold that something refers to."""
    gc.collect()
    return sum(array.nbytes for array in jax.live_arrays())


def used_after(env, counts, used_bytes):
    """Bytes in use after so many actions each, and the environment's state after the last."""

    def act(state, key):
        action = jax.random.uniform(key, (env.worlds, 1, env.groups[0].action_size), minval=-1.0)
        return env.step(state, (action,)), None

    @jax.jit
    def run(state, key):
        return jax.lax.scan(act, state, jax.random.split(key, CHUNK))[0]

    state, used, done = env.reset(3), [], 0
    for count in counts:
        assert count % CHUNK == 0
        for place in range(done // CHUNK, count // CHUNK):
            state = run(state, jax.random.key(place))
        done = count
        jax.block_until_ready(state)
        used.append(used_bytes())
    return used, state


@pytest.mark.thorough
def test_arrays_take_no_more_memory_after_many_actions_than_after_a_few():
    env = goal_env()
    (few, many), state = used_after(env, (100, 1000), live_bytes)
    assert few == many > 0
    # Every world has begun at least once in 40 steps of the 1000.
    assert np.asarray(state.batch.worlds.episode).min() >= 1000 // EPISODE - 1


@pytest.mark.parametrize("engine", ["c", pytest.param("planar", marks=pytest.mark.thorough)])
def test_other_seeds_noise_and_ranges_compile_nothing(engine):
    """Ranges of quantities that a task varies are data where worlds are given their own."""
    env = goal_env(engine, vary=DomainRandomization(noise=(0.0, 1.0), speed=(0.5, 1.0)))
    actions = (np.full((8, 1, env.groups[0].action_size), 0.5, np.float32),)

    def play(seed, ranges):
        state = env.step(env.reset(seed), actions)
        keys = jax.random.split(jax.random.key(seed), 8)
        own = {name: np.tile(np.float32(span), (8, 1)) for name, span in ranges.items()}
        state = env.step(env.reset_each(keys, ranges=own), actions)
        return np.asarray(env.step(state, actions).batch.worlds.varied.noise)

    slight = play(0, {"noise": (0.0, 0.1), "speed": (0.5, 0.6)})
    with compilations() as events:
        strong = play(1, {"noise": (2.0, 3.0), "speed": (0.9, 1.0)})
    # Random keys of the worlds are mapped over their numbers without a compiled function around it.
    assert {event.rsplit("/", 1)[1] for event in events} <= {"jaxpr_trace_duration"}
    assert slight.max() <= 0.1
    assert strong.min() >= 2.0


def test_an_array_that_is_kept_is_seen():
    before = live_bytes()
    kept = jnp.zeros(1000) + 1.0
    assert live_bytes() - before >= kept.nbytes
