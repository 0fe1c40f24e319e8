"""One policy for all classes of robots."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.train.toys import DriveToy, group
from usarmjx.base.errors import UsageError
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.learner import Trainer
from usarmjx.train.learning.processes import ProcessGroup
from usarmjx.train.learning.train_state import make_networks, make_train_state, policy_params

CONFIG = Config(
    num_worlds=16,
    rollout_length=8,
    num_minibatches=2,
    hidden_sizes=(8,),
    critic_hidden_sizes=(8,),
    shared_policy=True,
)


@pytest.fixture(scope="module")
def learned():
    """Networks, and weights before and after an update in which both classes acted."""
    trainer = Trainer(DriveToy(CONFIG.num_worlds), CONFIG, ProcessGroup())
    train_state, worlds = trainer.start()
    after, _, _ = trainer.iterate(train_state, worlds, 0)
    return trainer.networks, train_state, after


def test_an_update_changes_one_policy_and_what_tells_the_classes_apart(learned):
    _, before, after = learned
    assert len(after.params.policy) == 1
    assert len(after.params.critic) == len(after.params.group_bias) == 2
    for old, new in zip(jax.tree.leaves(before.params), jax.tree.leaves(after.params), strict=True):
        assert not np.array_equal(old, new)
    a, b = (policy["params"] for policy in policy_params(after).weights)
    assert_array_equal(a["layer_0"]["kernel"], b["layer_0"]["kernel"])
    assert_array_equal(a["head"]["kernel"], b["head"]["kernel"])
    apart = after.params.group_bias[0] - after.params.group_bias[1]
    assert_allclose(a["layer_0"]["bias"] - b["layer_0"]["bias"], apart, atol=1e-6)
    assert np.abs(apart).max() > 1e-4


def test_at_first_all_classes_do_the_same_with_what_they_see(learned):
    networks, before, after = learned
    obs = jnp.array([[[0.3, -0.2]]])
    seen, carry = (obs, obs), networks.policy.initial_carry(1)[1]
    for train_state, alike in ((before, True), (after, False)):
        params = policy_params(train_state)
        params = params.replace(mean=params.mean[:1] * 2, std=params.std[:1] * 2)  # both normalised alike
        (one, other), _ = networks.policy.act(params, seen, (carry, carry), deterministic=True)
        assert np.array_equal(one, other) == alike


def test_classes_that_see_or_do_different_numbers_are_refused_by_name():
    groups = (group("A", 1, 3, 2), group("B", 1, 3, 1))
    with pytest.raises(UsageError, match="A sees 3 and does 2, B sees 3 and does 1"):
        make_networks(groups, 0, CONFIG)
    alone = dataclasses.replace(CONFIG, shared_policy=False)
    assert len(make_train_state(make_networks(groups, 0, alone), alone).params.policy) == 2
