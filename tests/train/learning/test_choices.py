"""Choices: the distribution against closed forms, masks, and the same choices from a policy's file."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.train.envs.state import AgentGroup
from usarmjx.train.learning.networks import ChoiceDistribution, LearnedPolicy, PolicyParams, mask_logits
from usarmjx.train.learning.ppo import imitation_loss
from usarmjx.train.policies.policy_file import forward, group_record

KIND = ChoiceDistribution(4)
SHARES = np.array([0.1, 0.2, 0.3, 0.4])


def test_probability_entropy_and_mode_are_those_of_the_shares():
    logits = jnp.log(SHARES)
    choice = jnp.eye(4)
    np.testing.assert_allclose(
        jax.vmap(lambda one: KIND.log_prob(logits, one))(choice), np.log(SHARES), rtol=1e-5
    )
    assert KIND.entropy(logits, jax.random.key(0)) == pytest.approx(
        -(SHARES * np.log(SHARES)).sum(), rel=1e-5
    )
    assert KIND.mode(logits).tolist() == [0, 0, 0, 1]
    assert imitation_loss(KIND, logits, choice[1], 0.3) == pytest.approx(-np.log(0.2), rel=1e-5)


def test_drawn_choices_have_their_shares():
    keys = jax.random.split(jax.random.key(1), 4000)
    drawn = jax.vmap(lambda key: KIND.sample_no_postprocessing(jnp.log(SHARES), key))(keys)
    assert (drawn.sum(-1) == 1).all()
    # Four standard deviations of a share of 4000 draws.
    np.testing.assert_allclose(drawn.mean(0), SHARES, atol=4 * np.sqrt(0.25 / 4000))


def test_what_is_not_there_is_never_chosen_and_adds_no_entropy():
    seen = jnp.array([9.0, 9.0, 1.0, 0.0, 1.0, 0.0])  # the last four are the mask
    logits = mask_logits(jnp.array([0.0, 50.0, 0.0, 50.0]), seen)
    share = jax.nn.softmax(logits)
    assert share.tolist() == pytest.approx([0.5, 0.0, 0.5, 0.0])
    assert KIND.entropy(logits, jax.random.key(0)) == pytest.approx(np.log(2))
    gradient = jax.grad(lambda x: KIND.entropy(mask_logits(x, seen), jax.random.key(0)))(jnp.ones(4))
    assert np.isfinite(gradient).all()


def test_a_learned_policy_acts_by_masked_choices_as_its_weights_say_in_numpy():
    group = AgentGroup("P2AT", ("a", "b"), 7, 4, discrete=True)
    policy = LearnedPolicy((group,), (8,))
    weights = policy.init(jax.random.key(2))
    params = PolicyParams(weights=weights, mean=(jnp.zeros(7),), std=(jnp.ones(7),))
    draw = np.random.default_rng(0)
    obs = draw.normal(size=(50, 2, 7)).astype(np.float32)
    obs[..., 3:] = draw.integers(0, 2, (50, 2, 4))
    obs[..., 3] = 1.0
    (action,), _ = policy.act(params, (jnp.asarray(obs),), policy.initial_carry(50), deterministic=True)
    tree = jax.tree.map(np.asarray, weights[0]["params"])
    logits, _ = forward(tree, 1, obs, np.zeros((50, 2, 0), np.float32))
    wanted = np.where(obs[..., 3:] > 0.5, logits, -np.inf).argmax(-1)
    assert logits.shape == (50, 2, 4)
    assert (np.asarray(action).argmax(-1) == wanted).all()
    (drawn,), _ = policy.act(params, (jnp.asarray(obs),), policy.initial_carry(50), jax.random.key(3))
    assert (np.take_along_axis(obs[..., 3:], np.asarray(drawn).argmax(-1)[..., None], -1) == 1).all()


def test_files_of_policies_without_choices_have_no_new_fact():
    names = {"name", "agents", "obs_size", "action_size"}
    assert group_record(AgentGroup("P2AT", ("a",), 7, 4)).keys() == names
    assert group_record(AgentGroup("P2AT", ("a",), 7, 4, discrete=True)).keys() == names | {"discrete"}
