"""Choices: the distribution against closed forms, masks, and the same choices from a policy's file."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.train.envs.layout import ActionVector
from usarmjx.train.envs.state import AgentGroup
from usarmjx.train.learning.distributions import ChoiceDistribution, MixedDistribution, mask_logits
from usarmjx.train.learning.networks import LearnedPolicy, PolicyParams
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


MIXED = MixedDistribution(4, ActionVector(2, 3))
"""Of four choices the last three come with a vector of two numbers."""
MEANS, WIDTHS = np.array([0.3, -0.8]), np.array([-0.5, 1.2])
PARAMETERS = jnp.concatenate([jnp.log(SHARES), jnp.asarray(MEANS), jnp.asarray(WIDTHS)])


def density(raw):
    """Logarithm of the density of the squashed numbers of a vector: a normal one's by the slope of tanh."""
    std = np.log1p(np.exp(WIDTHS)) + 0.01
    normal = -((raw - MEANS) ** 2) / (2 * std**2) - np.log(std) - 0.5 * np.log(2 * np.pi)
    return (normal - np.log(1 - np.tanh(raw) ** 2)).sum()


def test_a_vector_counts_with_the_choices_that_send_it_alone():
    raw = np.array([0.9, -0.2])
    for number in range(4):
        sample = jnp.concatenate([jnp.eye(4)[number], jnp.asarray(raw)])
        wanted = np.log(SHARES[number]) + (density(raw) if number > 0 else 0.0)
        assert MIXED.log_prob(PARAMETERS, sample) == pytest.approx(wanted, rel=1e-5)
    assert MIXED.mode(PARAMETERS).tolist() == pytest.approx([0, 0, 0, 1, *np.tanh(MEANS)])
    assert MIXED.postprocess(sample).tolist() == pytest.approx([0, 0, 0, 1, *np.tanh(raw)])


def test_entropy_of_a_vector_counts_by_the_probability_of_sending_it():
    """Estimated: by the chain rule it is that of the choice, and 0.9 times the vector's own on average."""
    keys = jax.random.split(jax.random.key(4), 4000)
    drawn = np.asarray(jax.vmap(lambda key: MIXED.entropy(PARAMETERS, key))(keys))
    std = np.log1p(np.exp(WIDTHS)) + 0.01
    raw = MEANS + std * np.random.default_rng(0).standard_normal((20_000, 2))
    own = -np.mean([density(one) for one in raw])
    wanted = -(SHARES * np.log(SHARES)).sum() + 0.9 * own
    # Four standard errors of both means; a density's deviation is below 2.
    error = 4 * (drawn.std() / np.sqrt(4000) + 2.0 / np.sqrt(20_000))
    assert drawn.mean() == pytest.approx(wanted, abs=error)


def test_drawn_vectors_and_choices_have_their_distribution():
    keys = jax.random.split(jax.random.key(5), 4000)
    drawn = np.asarray(jax.vmap(lambda key: MIXED.sample_no_postprocessing(PARAMETERS, key))(keys))
    np.testing.assert_allclose(drawn[:, :4].mean(0), SHARES, atol=4 * np.sqrt(0.25 / 4000))
    std = np.log1p(np.exp(WIDTHS)) + 0.01
    np.testing.assert_allclose(drawn[:, 4:].mean(0), MEANS, atol=4 * std.max() / np.sqrt(4000))
    np.testing.assert_allclose(drawn[:, 4:].std(0), std, rtol=4 / np.sqrt(2 * 4000))


def test_no_gradient_of_a_vector_where_it_is_not_sent():
    """With every option to send hidden, too: means and deviations stay as they are."""
    seen = jnp.array([1.0, 0.0, 0.0, 0.0])
    sample = jnp.array([1.0, 0.0, 0.0, 0.0, 0.4, 0.4])

    def value(parameters):
        masked = MIXED.masked(parameters, seen)
        return MIXED.log_prob(masked, sample) + MIXED.entropy(masked, jax.random.key(0))

    np.testing.assert_allclose(jax.grad(value)(PARAMETERS)[4:], 0.0)


def test_a_teacher_is_imitated_in_its_vector_where_it_sends_one():
    """Half the squares of modes and deviations, as of robots that drive."""
    vector = np.array([0.1, -0.2])
    std = np.log1p(np.exp(WIDTHS)) + 0.01
    own = 0.5 * ((np.tanh(MEANS) - vector) ** 2 + (std - 0.3) ** 2).sum()
    for number, part in ((0, 0.0), (2, own)):
        action = jnp.concatenate([jnp.eye(4)[number], jnp.asarray(vector)])
        loss = imitation_loss(MIXED, PARAMETERS, action, 0.3)
        assert loss == pytest.approx(part - np.log(SHARES[number]), rel=1e-5)


def test_files_of_policies_without_choices_have_no_new_fact():
    names = {"name", "agents", "obs_size", "action_size"}
    assert group_record(AgentGroup("P2AT", ("a",), 7, 4)).keys() == names
    assert group_record(AgentGroup("P2AT", ("a",), 7, 4, discrete=True)).keys() == names | {"discrete"}
    mixed = AgentGroup("P2AT", ("a",), 7, 6, discrete=True, vector=ActionVector(2, 3))
    assert group_record(mixed).keys() == names | {"discrete", "vector"}
