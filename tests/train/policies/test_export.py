"""Exported policies: NumPy says what JAX says."""

import subprocess
import sys

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.train.toys import DriveToy
from usarmjx.base.errors import UsageError
from usarmjx.train.learning.checkpoint import read_policy
from usarmjx.train.learning.config import Config, EnvArguments, make_record
from usarmjx.train.learning.train_state import make_networks, make_train_state, policy_params
from usarmjx.train.policies.export import export_run
from usarmjx.train.policies.policy_file import NumpyPolicy, save_policy

# Sums of at most 32 products of order 1 in single precision, three layers of them, squashed to +-1.
SAME = 1e-5


def policy_with(memory, tmp_path, half=False):
    """A policy with large random weights and statistics, in JAX and in NumPy."""
    config = Config(num_worlds=4, hidden_sizes=(32, 16), gru_size=memory)
    env = DriveToy(4)
    networks = make_networks(env.groups, env.privileged_size, config)
    params = policy_params(make_train_state(networks, config))
    draw = np.random.default_rng(4)
    params = jax.tree.map(lambda leaf: leaf + 0.3 * draw.normal(size=leaf.shape).astype(np.float32), params)
    params = params.replace(std=jax.tree.map(lambda leaf: 0.5 + abs(leaf), params.std))
    file = tmp_path / "policy.npz"
    save_policy(
        file, networks.policy, params, make_record(env, config, 1, EnvArguments("c", {"radius": "0.5"})), half
    )
    return networks.policy, params, NumpyPolicy(file)


@pytest.mark.oracle
@pytest.mark.parametrize("memory", [0, 8])
def test_numpy_acts_as_jax_does(memory, tmp_path):
    """For ten steps, of both groups, far outliers and what is not a number included."""
    policy, params, told = policy_with(memory, tmp_path)
    act, draw = (
        jax.jit(lambda obs, carry: policy.act(params, obs, carry, deterministic=True)),
        np.random.default_rng(5),
    )
    carry = policy.initial_carry(3)
    own = [told.initial_carry(0, 3, 2), told.initial_carry(1, 3, 1)]
    assert [memory.shape for memory in own] == [memory.shape for memory in carry]
    for step in range(10):
        obs = [draw.normal(size=(3, n, 2), scale=2.0).astype(np.float32) for n in (2, 1)]
        obs[0][0, 0] = [np.nan, 1e9] if step == 4 else obs[0][0, 0]
        actions, carry = act(tuple(obs), carry)
        for g in range(2):
            found, own[g] = told.act(g, obs[g], own[g])
            assert_allclose(found, actions[g], atol=SAME)
            assert_allclose(own[g], carry[g], atol=SAME)
            assert np.abs(found).max() > 0.1


def test_weights_of_16_bits_halve_the_file_and_round_them(tmp_path):
    """Each by 2^-11 of itself at most; statistics keep all their bits."""
    _, _, told = policy_with(8, tmp_path)
    size = (tmp_path / "policy.npz").stat().st_size
    _, _, rounded = policy_with(8, tmp_path, half=True)
    assert (tmp_path / "policy.npz").stat().st_size < 0.75 * size  # names and statistics stay as they are
    pairs = list(zip(jax.tree.leaves(told.weights), jax.tree.leaves(rounded.weights), strict=True))
    for one, other in pairs:
        assert one.dtype == other.dtype == np.float32
        assert_allclose(other, one, rtol=2.0**-11, atol=1e-7)
    assert any((one != other).any() for one, other in pairs)
    assert_array_equal(rounded.std[0], told.std[0])


@pytest.mark.oracle
def test_drawn_actions_have_the_distribution_of_those_that_were_trained(tmp_path):
    """Mean and deviation before squashing, of 20000 actions: 5 standard errors."""
    policy, params, told = policy_with(0, tmp_path)
    obs, count = np.array([0.4, -0.2], np.float32), 20_000
    rows = np.broadcast_to(obs, (count, 1, 2))
    blank = np.zeros((count, 2, 0), np.float32), np.zeros((count, 1, 0), np.float32)
    seen = (np.broadcast_to(obs, (count, 2, 2)), rows)
    drawn = [
        np.asarray(policy.act(params, seen, blank, jax.random.key(1))[0][1]),
        told.act(1, rows, blank[1], np.random.default_rng(6))[0],
    ]
    raw = [np.arctanh(np.clip(actions[:, 0].astype(np.float64), -1 + 1e-7, 1 - 1e-7)) for actions in drawn]
    deviation = raw[0].std(0)
    assert (np.abs(raw[0].mean(0) - raw[1].mean(0)) < 5 * deviation * np.sqrt(2 / count)).all()
    assert_allclose(raw[1].std(0), deviation, rtol=5 * np.sqrt(1 / count))
    with pytest.raises(UsageError, match="with a key"):
        policy.act(params, seen, blank)


def test_an_exported_run_drives_robots_to_their_goals_without_jax(reference, tmp_path):
    """A client's loop: one robot at a time, in a process that never imports JAX."""
    file = tmp_path / "policy.npz"
    export_run(reference, file)
    assert file.stat().st_size < 20_000
    code = """
import sys
import numpy as np
from usarmjx.train.policies.policy_file import NumpyPolicy
policy = NumpyPolicy(sys.argv[1])
group, arrived = policy.group("a"), 0
for trial in range(20):
    draw = np.random.default_rng(trial)
    at, goal, carry = np.zeros(2), draw.uniform(-1, 1, 2), policy.initial_carry(group)
    for step in range(25):
        action, carry = policy.act(group, goal - at, carry)
        at = at + 0.2 * action
        if np.linalg.norm(goal - at) < 0.25:
            arrived += 1
            break
assert not {"jax", "flax", "brax"} & set(sys.modules)
print(policy.task, policy.period, arrived)
"""
    done = subprocess.run(
        [sys.executable, "-c", code, str(file)], capture_output=True, text=True, timeout=120, check=True
    )
    task, period, arrived = done.stdout.split()
    assert (task, period) == ("drive-toy", "0.1")
    assert int(arrived) >= 19


def test_the_actor_of_a_run_acts_as_its_policy(reference):
    """As evaluation wants it."""
    policy, params, _ = read_policy(reference)
    actor, obs = policy.as_policy(params), DriveToy(3).reset(0).obs
    _, actions = actor.act(actor.initial_carry(3), obs, jax.random.key(0))
    expected, _ = policy.act(params, obs, policy.initial_carry(3), deterministic=True)
    for one, other in zip(actions, expected, strict=True):
        assert_array_equal(one, other)


def test_what_is_no_policy_is_refused(tmp_path):
    empty, text = tmp_path / "empty.npz", tmp_path / "text.npz"
    np.savez(empty, something=np.zeros(3))
    text.write_text("hello")
    for file in (empty, text, tmp_path / "none.npz"):
        with pytest.raises(UsageError, match="is no policy"):
            NumpyPolicy(file)


def test_robots_and_observations_that_the_policy_is_not_for_are_refused(tmp_path):
    _, _, told = policy_with(0, tmp_path)
    with pytest.raises(UsageError, match="it is for: A, B"):
        told.group("Talon")
    with pytest.raises(UsageError, match="needs"):
        told.act(0, np.zeros(5), told.initial_carry(0))
