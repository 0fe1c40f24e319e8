"""Training where agents drop out: what they would have done counts for nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.train.toys import DriveToy, small_config
from usarmjx.train.learning.learner import Trainer
from usarmjx.train.learning.networks import recur
from usarmjx.train.learning.ppo import compute_targets
from usarmjx.train.learning.processes import ProcessGroup

CONFIG = small_config(num_worlds=8, rollout_length=6)


@pytest.fixture(scope="module")
def trainer():
    return Trainer(DriveToy(8), CONFIG, ProcessGroup())


@pytest.fixture(scope="module")
def collected(trainer):
    """Learner, steps in which agents are missing at random, ends, and sums."""
    train_state, worlds = trainer.start()
    _, steps, ends, sums = trainer.rollout.collect(train_state, worlds, jax.random.key(3))
    draw = np.random.default_rng(0)
    alive = tuple(jnp.asarray(draw.random(one.shape) < 0.6) for one in steps.reward)
    survived = tuple(jnp.concatenate([one[1:], one[-1:]]) for one in alive)
    return (
        train_state,
        steps.replace(alive=alive, survived=survived),
        ends,
        {k: v[None] for k, v in sums.items()},
    )


def garbled(steps):
    """The steps with other numbers in all that agents that are not alive have."""

    def other(alive, values, far):
        mask = alive.reshape(*alive.shape, *[1] * (values.ndim - alive.ndim))
        return jnp.where(mask, values, values + far)

    numbers = {"obs": 3.0, "raw_action": 1.0, "log_prob": 0.5, "value": 2.0, "reward": 5.0}
    return steps.replace(
        **{
            name: tuple(other(a, one, far) for a, one in zip(steps.alive, getattr(steps, name), strict=True))
            for name, far in numbers.items()
        }
    )


def test_an_update_does_not_depend_on_what_absent_agents_have(trainer, collected):
    train_state, steps, ends, sums = collected
    one, known = trainer._update(train_state, (steps, ends, sums), trainer._stream)
    other, again = trainer._update(train_state, (garbled(steps), ends, sums), trainer._stream)
    for name in ("params", "obs_statistics", "return_statistics"):
        jax.tree.map(assert_array_equal, getattr(one, name), getattr(other, name))
    for name in ("loss/policy", "loss/value", "loss/explained"):
        assert_allclose(known[name], again[name], rtol=1e-5)


@pytest.mark.thorough
def test_an_update_depends_on_who_is_absent(trainer, collected):
    """Another program, of steps without masks, changes the weights otherwise."""
    train_state, steps, ends, sums = collected
    one, _ = trainer._update(train_state, (steps, ends, sums), trainer._stream)
    unmasked = steps.replace(alive=(), survived=())
    whole, _ = trainer._update(train_state, (unmasked, ends, sums), trainer._stream)
    pairs = zip(jax.tree.leaves(one.params), jax.tree.leaves(whole.params), strict=True)
    assert any((np.asarray(a) != b).any() for a, b in pairs), "the masks matter"


@pytest.mark.oracle
def test_the_end_of_an_agent_is_an_end_of_its_own_episode(trainer, collected):
    """Advantages are those of each agent's own stretches: the paper's recursion, backwards in NumPy."""
    train_state, steps, ends, _ = collected
    batch, returns = compute_targets_alone(trainer, train_state, steps, ends)
    reward, value = np.asarray(steps.reward[0], float), np.asarray(steps.value[0], float)
    alive, survived = np.asarray(steps.alive[0]), np.asarray(steps.survived[0])
    done, late = np.asarray(steps.done), np.asarray(steps.truncated)
    gamma, trace = CONFIG.gamma, CONFIG.gae_lambda
    following, advantage = np.asarray(ends.last_value[0], float), np.zeros(reward.shape[1:])
    for t in reversed(range(len(reward))):
        over = done[t][:, None] | ~survived[t]
        cut = (late[t][:, None] & survived[t]) * np.asarray(steps.bootstrap_value[0][t])
        delta = reward[t] + gamma * np.where(over, cut, following) - value[t]
        advantage = np.where(alive[t], delta + gamma * trace * np.where(over, 0.0, advantage), 0.0)
        assert_allclose(
            np.asarray(returns[0][t])[alive[t]], (advantage + value[t])[alive[t]], rtol=1e-4, atol=1e-4
        )
        following = value[t]
    assert_array_equal(np.asarray(batch.advantage[0])[~alive], 0.0)


def compute_targets_alone(trainer, train_state, steps, ends):
    """Targets as one process has them: sums over all processes are its own."""
    from jax.sharding import Mesh, PartitionSpec

    from usarmjx.train.learning.processes import PROCESS_AXIS

    def targets(train_state, steps, ends):
        return compute_targets(trainer.networks, train_state, steps, ends, CONFIG)

    mesh = Mesh(np.array(jax.devices()[:1]), (PROCESS_AXIS,))
    spec = PartitionSpec()
    return jax.jit(jax.shard_map(targets, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False))(
        train_state, steps, ends
    )


def test_memories_of_agents_are_reset_one_by_one():
    """Against each robot as a world of its own."""
    draw = np.random.default_rng(1)
    gates, carry = draw.normal(size=(5, 3, 2, 12)), draw.normal(size=(3, 2, 4))
    weights, bias, first = draw.normal(size=(4, 12)), draw.normal(size=4), draw.random((5, 3, 2)) < 0.4
    given = [jnp.asarray(one, jnp.float32) for one in (gates, weights, bias, carry)]
    found = recur(*given, jnp.asarray(first))
    for robot in (slice(0, 1), slice(1, 2)):
        mine = given[0][:, :, robot], *given[1:3], given[3][:, robot]
        alone = recur(*mine, jnp.asarray(first[..., robot.start]))
        assert_allclose(found[:, :, robot], alone, atol=1e-6)
