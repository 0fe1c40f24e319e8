"""Networks over sets: order and what is not there do not matter, files act as JAX, toys are learned."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.train.choice_toys import CHOICES, PICTURED, PLAIN, ChoiceToy, WhisperToy
from usarmjx.base.errors import UsageError
from usarmjx.train.envs.layout import (
    ActionVector,
    ObservationLayout,
    layout_from_record,
    layout_record,
    vector_from_record,
)
from usarmjx.train.envs.state import AgentGroup
from usarmjx.train.evaluation.evaluate import evaluate_episodes
from usarmjx.train.learning.checkpoint import read_policy
from usarmjx.train.learning.config import Config, EnvArguments, load_record, make_record
from usarmjx.train.learning.networks import LearnedPolicy, PolicyParams, shared_scale
from usarmjx.train.learning.trainer import train
from usarmjx.train.policies.policy_file import NumpyPolicy, save_policy
from usarmjx.train.policies.sources import load_exported

LAYOUT = ObservationLayout(own=3, others=(4, 3), choices=(6, 4), kinds=(0, 1, 1, 2, 2, 2), picture=(2, 8, 3))
GROUP = AgentGroup("P2AT", ("a", "b"), LAYOUT.size, 6, True, LAYOUT)
SAME = 1e-5


SPEAKING = replace(GROUP, action_size=9, vector=ActionVector(3, 2))
"""With the last two choices a vector of three numbers is sent."""


def policy_of(kind, layers=(16, 8, 12), group=GROUP):
    """A policy of a kind with random weights and statistics."""
    policy = LearnedPolicy((group,), layers, kind=kind)
    draw, other = np.random.default_rng(3), np.random.default_rng(9)

    def moved(path, leaf):
        # The same weights with a vector and without, but for the vector's own.
        own = other if "vector" in jax.tree_util.keystr(path) else draw
        return leaf + 0.2 * own.normal(size=leaf.shape).astype(np.float32)

    weights = jax.tree_util.tree_map_with_path(moved, jax.jit(policy.init)(jax.random.key(1)))
    mean = jnp.asarray(0.3 * draw.normal(size=LAYOUT.size), jnp.float32)
    std = jnp.asarray(0.5 + draw.random(LAYOUT.size), jnp.float32)
    return policy, PolicyParams(weights=weights, mean=(mean,), std=(std,))


def observations(rows):
    draw = np.random.default_rng(5)
    obs = draw.normal(size=(rows, 2, LAYOUT.size)).astype(np.float32)
    others, mask = LAYOUT.others_span, LAYOUT.mask_span
    obs[..., others.first : others.end : 3] = draw.integers(0, 2, (rows, 2, 4))
    obs[..., mask.first :] = draw.integers(0, 2, (rows, 2, 6))
    obs[..., mask.first] = 1.0
    return obs


def logits_of(policy, params, obs):
    parameters = jax.jit(policy.distribution_params)
    out, _ = parameters(params, (jnp.asarray(obs),), policy.initial_carry(len(obs)))
    return np.asarray(out[0])


def permuted(obs, span, order):
    there = obs[..., span.first : span.end].reshape(*obs.shape[:-1], span.rows, span.numbers)
    obs = obs.copy()
    obs[..., span.first : span.end] = there[..., order, :].reshape(*obs.shape[:-1], -1)
    return obs


@pytest.mark.parametrize("kind", ["set", "cnn"])
def test_choices_of_a_kind_and_other_robots_have_no_order(kind):
    policy, params = policy_of(kind)
    obs = observations(20)
    before = logits_of(policy, params, obs)
    order = [0, 2, 1, 5, 3, 4]  # within kinds
    moved = permuted(permuted(obs, LAYOUT.choices_span, order), LAYOUT.mask_span, order)
    assert_allclose(logits_of(policy, params, moved), before[..., order], atol=SAME)
    moved = permuted(obs, LAYOUT.others_span, [3, 1, 0, 2])
    assert_allclose(logits_of(policy, params, moved), before, atol=SAME)
    across = [1, 0, 2, 3, 4, 5]  # of two kinds
    moved = permuted(permuted(obs, LAYOUT.choices_span, across), LAYOUT.mask_span, across)
    both = (obs[..., LAYOUT.mask_span.first :] > 0.5).all(-1)
    assert both.any()
    assert np.abs(logits_of(policy, params, moved) - before[..., across])[both].max() > 1e-3


def test_what_is_not_there_changes_nothing():
    policy, params = policy_of("set")
    obs = observations(20)
    before, changed = logits_of(policy, params, obs), obs.copy()
    for span, marks in ((LAYOUT.others_span, LAYOUT.others_span), (LAYOUT.choices_span, LAYOUT.mask_span)):
        rows = changed[..., span.first : span.end].reshape(20, 2, span.rows, span.numbers)
        there = changed[..., marks.first : marks.end].reshape(20, 2, marks.rows, marks.numbers)[..., 0] > 0.5
        start = 1 if span == marks else 0
        rows[..., start:] = np.where(there[..., None], rows[..., start:], 7.0)
        changed[..., span.first : span.end] = rows.reshape(20, 2, -1)
    assert (changed != obs).any()
    assert_allclose(logits_of(policy, params, changed), before, atol=SAME)


def test_the_picture_counts_for_cnn_alone():
    obs = observations(4)
    changed, span = obs.copy(), LAYOUT.picture_span
    changed[..., span.first : span.end] += 1.0
    differs = {}
    for kind in ("set", "cnn"):
        policy, params = policy_of(kind)
        differs[kind] = np.abs(logits_of(policy, params, changed) - logits_of(policy, params, obs)).max()
    assert differs["set"] == 0.0
    assert differs["cnn"] > 1e-3


def test_a_set_has_one_mean_and_deviation_those_of_all_its_things():
    draw = np.random.default_rng(0)
    values = draw.normal(size=(500, PLAIN.size)) * draw.random(PLAIN.size) + draw.normal(size=PLAIN.size)
    mean, std = map(np.asarray, shared_scale(PLAIN, values.mean(0), values.std(0)))
    things = values[:, 5:15].reshape(500 * CHOICES, 2)
    assert_allclose(mean[5:15], np.tile(things.mean(0), CHOICES), rtol=1e-4, atol=1e-5)
    assert_allclose(std[5:15], np.tile(things.std(0), CHOICES), rtol=1e-4)
    assert (mean[[1, 3, *range(15, 20)]] == 0).all()
    assert (std[[1, 3, *range(15, 20)]] == 1).all()
    assert mean[0] == pytest.approx(values[:, 0].mean(), rel=1e-5)
    again = shared_scale(PLAIN, mean, std)
    assert_allclose(again[1], std, rtol=1e-5)


class Recorded:
    name, privileged_size, episode_steps, period = "recorded", 0, 10, 0.2

    def __init__(self, group):
        self.groups = (group,)


@pytest.mark.oracle
@pytest.mark.parametrize("group", [GROUP, SPEAKING], ids=["choices", "vector"])
@pytest.mark.parametrize("kind", ["mlp", "set", "cnn"])
def test_files_act_as_jax_does(kind, group, tmp_path):
    """In NumPy, in JAX from the file, and in ONNX Runtime."""
    policy, params = policy_of(kind, group=group)
    config = Config(num_worlds=4, network=kind, hidden_sizes=policy.layers)
    file, obs = tmp_path / "policy.npz", observations(50)
    record = make_record(Recorded(group), config, 1, EnvArguments("c", {}))
    save_policy(file, policy, params, record)
    record.save(tmp_path)
    assert load_record(tmp_path).groups == (group,)
    held = NumpyPolicy(file)
    wanted, _ = policy.act(params, (jnp.asarray(obs),), policy.initial_carry(50), deterministic=True)
    found, _ = held.act(0, obs, held.initial_carry(0, 50, 2))
    assert (found[..., :6] == np.asarray(wanted[0])[..., :6]).all()
    assert_allclose(found[..., 6:], wanted[0][..., 6:], atol=SAME)
    assert len(set(found[..., :6].argmax(-1).ravel())) > 3

    learned, loaded = load_exported(file).learned
    assert_allclose(logits_of(learned, loaded, obs), logits_of(policy, params, obs), atol=SAME)
    if kind != "mlp":
        from usarmjx.train.policies.set_forward import NumpyOperations, set_outputs

        seen = np.asarray(policy.normalised(0, params.mean[0], params.std[0], jnp.asarray(obs)))
        numbers = set_outputs(NumpyOperations(), held.weights[0], held.layers, LAYOUT, seen)
        logits, there = logits_of(policy, params, obs), obs[..., LAYOUT.mask_span.first :] > 0.5
        assert_allclose(numbers[..., :6][there], logits[..., :6][there], atol=SAME, rtol=SAME)
        assert_allclose(numbers[..., 6:], logits[..., 6:], atol=SAME, rtol=SAME)

    runtime = pytest.importorskip("onnxruntime")
    from usarmjx.train.policies.onnx_file import write_onnx

    write_onnx(held, tmp_path / "p.onnx")
    session = runtime.InferenceSession(str(tmp_path / "p.onnx"))
    chosen = session.run(["P2AT.action"], {"P2AT.obs": obs[:, 0]})[0]
    assert (chosen[:, :6] == found[:, 0, :6]).all()
    assert_allclose(chosen[:, 6:], found[:, 0, 6:], atol=SAME, rtol=SAME)


def test_layouts_pass_through_files_and_others_are_refused():
    assert layout_from_record(layout_record(LAYOUT)) == LAYOUT
    whole = layout_record(LAYOUT)
    for wrong in (None, {}, {**whole, "own": -1}, {**whole, "kinds": [0.5]}, {**whole, "picture": [1]}):
        with pytest.raises(ValueError, match="layout"):
            layout_from_record(wrong)


def test_vectors_pass_through_files_and_others_are_refused():
    assert vector_from_record([3, 2], 9) == ActionVector(3, 2)
    for wrong in (None, [3], [3, 2, 1], [0, 2], [3, 0], [8, 2], [-1, 2], [1.5, 2]):
        with pytest.raises(ValueError, match="vector"):
            vector_from_record(wrong, 9)


def test_networks_that_observations_do_not_fit_are_refused():
    cases = {
        "chooses of no set": (AgentGroup("A", ("a",), LAYOUT.size, 6, True), "set"),
        "sees no picture": (AgentGroup("A", ("a",), PLAIN.size, CHOICES, True, PLAIN), "cnn"),
        "the observation has 9": (AgentGroup("A", ("a",), 9, CHOICES, True, PLAIN), "set"),
    }
    for words, (group, kind) in cases.items():
        with pytest.raises(UsageError, match=words):
            LearnedPolicy((group,), (8,), kind=kind).check()
    with pytest.raises(UsageError, match="no gru_size"):
        Config(network="set", gru_size=4)


@pytest.mark.usefixtures("optimised_programs")
@pytest.mark.every_run("cnn")
@pytest.mark.parametrize(("kind", "layout"), [("set", PLAIN), ("cnn", PICTURED)], ids=["set", "cnn"])
def test_a_toy_is_learned(kind, layout, tmp_path):
    """At random a robot is right in 1 of 3.5 choices."""
    sizes = {"network": kind, "hidden_sizes": (32, 32), "critic_hidden_sizes": (16, 16)}
    config = Config(
        **{"num_worlds": 64, "rollout_length": 8, "num_minibatches": 4, "num_epochs": 4},
        **{"learning_rate": 3e-3, "gamma": 0.5, "total_steps": 1024 * 14, "checkpoint_interval": 10, **sizes},
    )
    env = ChoiceToy(64, layout=layout)
    train(env, config, tmp_path / "run", progress=False)
    policy, params, _ = read_policy(tmp_path / "run", "last")
    found = evaluate_episodes(env, policy.as_policy(params), 256, seeds=(1000,))
    assert found.score.value > 0.85


@pytest.mark.usefixtures("optimised_programs")
def test_only_a_vector_tells_robots_what_to_name(tmp_path):
    """The same robots are right at once, and guess where they are deaf: one of two, in 512 answers."""
    sizes = {"network": "set", "hidden_sizes": (32, 32), "critic_hidden_sizes": (16, 16)}
    config = Config(
        **{"num_worlds": 128, "rollout_length": 8, "num_minibatches": 4, "num_epochs": 4, "gamma": 0.99},
        **{"learning_rate": 5e-3, "lr_schedule": "linear", "total_steps": 2048 * 24, **sizes},
    )
    train(WhisperToy(128), config, tmp_path / "run", progress=False)
    policy, params, _ = read_policy(tmp_path / "run", "last")
    scores = [
        evaluate_episodes(
            WhisperToy(128, deaf=deaf), policy.as_policy(params), 256, seeds=(1000,)
        ).score.value
        for deaf in (False, True)
    ]
    assert scores[0] > 0.9
    # Four standard errors; robots of a world answer apart.
    assert scores[1] < 0.5 + 4 * np.sqrt(0.25 / 512)
