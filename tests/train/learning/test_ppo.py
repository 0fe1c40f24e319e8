"""One update: its loss, its masks, its shuffling."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from brax.training.acme import running_statistics
from numpy.testing import assert_allclose, assert_array_equal

from tests.train.toys import DriveToy, small_config
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.learner import Trainer
from usarmjx.train.learning.networks import init_statistics
from usarmjx.train.learning.ppo import _adapt, _shuffle, compute_targets, loss, surrogate
from usarmjx.train.learning.processes import PROCESS_AXIS, ProcessGroup
from usarmjx.train.learning.train_state import critic_values

CONFIG = small_config(num_worlds=16, rollout_length=8, num_minibatches=2, num_epochs=2)


@pytest.fixture(scope="module")
def trainer():
    return Trainer(DriveToy(16, rotten=True), CONFIG, ProcessGroup())


@pytest.fixture(scope="module")
def collected(trainer):
    """Learner, and what was collected under it; some of it bad."""
    train_state, worlds = trainer.start()
    worlds, steps, ends, sums = trainer.rollout.collect(train_state, worlds, jax.random.key(3))
    assert np.asarray(steps.bad).any()
    return train_state, steps, ends, {name: one[None] for name, one in sums.items()}


def leaves(tree):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]


@pytest.mark.oracle
def test_the_surrogate_and_its_gradient_are_those_of_the_paper():
    """min(r A, clip(r) A): no gradient where it would push the ratio further out, else that of r A."""
    ratio = np.array([0.5, 0.7, 0.9, 1.0, 1.1, 1.3, 2.0], np.float32)
    log_ratio = np.log(ratio)
    for advantage in (1.5, -1.5):
        value, slope = jax.vmap(jax.value_and_grad(lambda x, a=advantage: surrogate(x, 0.0, a, 0.2)))(
            log_ratio
        )
        pushed_out = (ratio > 1.2) if advantage > 0 else (ratio < 0.8)
        expected = np.where(pushed_out, np.clip(ratio, 0.8, 1.2), ratio) * advantage
        assert_allclose(value, expected, rtol=1e-6)
        assert_allclose(slope, np.where(pushed_out, 0.0, ratio * advantage), rtol=1e-6)


def test_log_probabilities_far_apart_leave_everything_finite():
    """As after many updates, or with actions at the bounds."""
    slope = jax.grad(lambda x: surrogate(x, 0.0, -1.0, 0.2))
    for far in (-1e4, 1e4, 300.0):
        assert np.isfinite(slope(jnp.float32(far)))


def test_the_update_is_finite_and_changes_all_weights(trainer, collected):
    train_state, *experience = collected
    new, known = trainer._update(train_state, tuple(experience), trainer._stream)
    assert all(np.isfinite(leaf).all() for leaf in leaves((new, known)))
    assert known["loss/skipped"] == 0
    # The mean of the probabilities' ratio starts at 1: what was stored is what the networks say again.
    assert known["loss/divergence"] < 0.2
    for before, after in zip(leaves(train_state.params), leaves(new.params), strict=True):
        assert (before != after).any()


@pytest.mark.oracle
def test_weights_and_moments_change_as_optax_changes_trees():
    """One minibatch of all worlds, from optax's own Adam; sums in another order differ by rounding."""
    config = small_config(num_worlds=16, rollout_length=8, num_minibatches=1, num_epochs=1)
    trainer = Trainer(DriveToy(16), config, ProcessGroup())
    old, worlds = trainer.start()
    _, steps, ends, sums = trainer.rollout.collect(old, worlds, jax.random.key(3))
    experience = steps, ends, {name: one[None] for name, one in sums.items()}
    new, _ = trainer._update(old, experience, trainer._stream)
    assert jax.tree.structure(new) == jax.tree.structure(old)

    def targets(one):
        return compute_targets(trainer.networks, old, *one, config)[0]

    of_one_process = jax.tree.map(lambda x: x[None], (steps, ends))
    batch = jax.tree.map(lambda x: x[0], jax.vmap(targets, axis_name=PROCESS_AXIS)(of_one_process))
    key = jax.random.fold_in(jax.random.wrap_key_data(trainer._stream), old.iteration)
    key = jax.random.fold_in(jax.random.fold_in(key, 0), config.shuffled_blocks)
    slope = jax.jit(jax.grad(lambda w: loss(w, trainer.networks, old, batch, key, config), has_aux=True))
    gradient, totals = slope(old.params)
    gradient = jax.tree.map(lambda one: one / totals["weight"], gradient)
    adam = optax.chain(optax.clip_by_global_norm(config.max_grad_norm), optax.scale_by_adam(eps=1e-5))
    change, moments = adam.update(gradient, adam.init(old.params))
    expected = jax.tree.map(lambda w, step: w - old.learning_rate * step, old.params, change)
    largest = max(np.abs(one).max() for one in leaves(gradient))
    for found, wanted in zip(leaves(new.params), leaves(expected), strict=True):
        assert_allclose(found, wanted, rtol=0, atol=1e-2 * config.learning_rate)
    for found, wanted in zip(leaves(new.opt_state), leaves(moments), strict=True):
        assert_allclose(found, wanted, rtol=1e-4, atol=1e-6 * largest)


def test_bad_transitions_teach_nothing(trainer, collected):
    """What they hold may be anything: the update is the same, bit for bit."""
    train_state, steps, ends, sums = collected
    expected, _ = trainer._update(train_state, (steps, ends, sums), trainer._stream)

    def spoil(bad, leaf):
        mask = bad.reshape(*bad.shape, *[1] * (leaf.ndim - 2))
        return jnp.where(mask, 1e3, leaf)

    # Not the critic's value: it is of the state before, in which nothing was wrong yet.
    names = ("reward", "raw_action", "obs", "log_prob", "bootstrap_value")
    spoilt = steps.replace(
        **{name: tuple(spoil(steps.bad, one) for one in getattr(steps, name)) for name in names}
    )
    found, _ = trainer._update(train_state, (spoilt, ends, sums), trainer._stream)
    for one, other in zip(leaves(expected), leaves(found), strict=True):
        assert_array_equal(one, other)


def test_good_transitions_teach(trainer, collected):
    """The other way round, so that the test above can fail."""
    train_state, steps, ends, sums = collected
    expected, _ = trainer._update(train_state, (steps, ends, sums), trainer._stream)
    better = steps.replace(reward=tuple(r + 1 for r in steps.reward))
    found, _ = trainer._update(train_state, (better, ends, sums), trainer._stream)
    assert any((one != other).any() for one, other in zip(leaves(expected), leaves(found), strict=True))


def test_an_update_with_nothing_but_bad_transitions_keeps_the_weights(trainer, collected):
    """And the statistics stay finite."""
    train_state, steps, ends, sums = collected
    spoilt = steps.replace(bad=jnp.ones_like(steps.bad))
    new, _ = trainer._update(train_state, (spoilt, ends, sums), trainer._stream)
    for one, other in zip(
        leaves((train_state.params, train_state.obs_statistics)),
        leaves((new.params, new.obs_statistics)),
        strict=True,
    ):
        assert_array_equal(one, other)


def test_gradients_that_are_not_finite_are_left_out(trainer, collected):
    train_state, steps, ends, sums = collected
    broken = steps.replace(reward=tuple(r.at[0, 0].set(jnp.inf) for r in steps.reward))
    new, known = trainer._update(train_state, (broken, ends, sums), trainer._stream)
    assert known["loss/skipped"] == 1
    for one, other in zip(leaves(train_state.params), leaves(new.params), strict=True):
        assert_array_equal(one, other)


def test_critics_see_more_than_policies(trainer, collected):
    """And both are of a class: another critic, another policy for each."""
    train_state, steps, ends, _ = collected
    seen, fresh = (steps.obs, steps.privileged), (steps.is_first,) * len(steps.obs)
    values, _ = critic_values(trainer.networks, train_state, seen, ends.critic_carry, fresh)
    others, _ = critic_values(
        trainer.networks, train_state, (steps.obs, steps.privileged + 1), ends.critic_carry, fresh
    )
    for value, other in zip(values, others, strict=True):
        assert (value != other).all()
    for networks, inputs in ((train_state.params.policy, set()), (train_state.params.critic, {"shared"})):
        one, other = (weights["params"] for weights in networks)
        assert {name for name in one if name == "shared"} == inputs
        assert (np.asarray(one["layer_0"]["kernel"]) != np.asarray(other["layer_0"]["kernel"])).any()


@pytest.mark.oracle
def test_statistics_are_the_mean_and_deviation_of_what_was_good(trainer, collected):
    """Of all steps that are not bad, by NumPy in double precision."""
    train_state, steps, ends, sums = collected
    new, _ = trainer._update(train_state, (steps, ends, sums), trainer._stream)
    good = ~np.asarray(steps.bad)
    for found, seen in zip(new.obs_statistics, steps.obs, strict=True):
        rows = np.asarray(seen, np.float64)[good].reshape(-1, seen.shape[-1])
        assert_allclose(found.mean, rows.mean(0), atol=1e-5)
        assert_allclose(found.std, rows.std(0), atol=1e-5)
    assert int(new.obs_statistics[0].running.count) == good.sum() * 2


def test_statistics_begin_as_braxs_do():
    """With the names of Brax's fields: checkpoints of before find their leaves."""
    ours = jax.tree.flatten_with_path(init_statistics(3).running)[0]
    theirs = jax.tree.flatten_with_path(running_statistics.init_state(jnp.zeros(3), std_eps=0.0))[0]
    assert [str(path) for path, _ in ours] == [str(path) for path, _ in theirs]
    for (_, one), (_, other) in zip(ours, theirs, strict=True):
        assert_array_equal(one, other)
        assert one.dtype == jnp.asarray(other).dtype


@pytest.mark.parametrize("processes", [1, 2, 4])
def test_minibatches_hold_the_same_worlds_however_many_processes(processes):
    """32 worlds in 8 blocks; a process has its share of both."""
    worlds, blocks, minibatches = 32, 8, 4
    parts = []
    for p in range(processes):
        shuffle = partial(_shuffle, jax.random.key(5), worlds // processes, blocks // processes)
        parts.append(
            np.asarray(shuffle(jnp.int32(p * blocks // processes), minibatches)) + p * worlds // processes
        )
    sets = [set(np.concatenate([part[m] for part in parts]).tolist()) for m in range(minibatches)]
    assert set.union(*sets) == set(range(worlds))
    assert sum(map(len, sets)) == worlds
    whole = np.asarray(_shuffle(jax.random.key(5), worlds, blocks, jnp.int32(0), minibatches))
    assert sets == [set(row.tolist()) for row in whole]
    assert whole.tolist() != np.arange(worlds).reshape(minibatches, -1).tolist()


def test_the_adaptive_rate_follows_the_divergence():
    """Slower where the policy changed too much, faster where too little, the same between and if unknown."""
    config, rate = Config(target_kl=0.01), jnp.float32(1e-3)
    for divergence, factor in ((0.03, 1 / 1.5), (0.001, 1.5), (0.012, 1.0), (np.nan, 1.0)):
        assert_allclose(_adapt(rate, jnp.float32(divergence), config), 1e-3 * factor, rtol=1e-6)
