"""Imitation of a policy by hand before PPO."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.distribution import NormalTanhDistribution
from numpy.testing import assert_allclose, assert_array_equal

from tests.train.toys import DriveToy
from usarmjx.base.errors import UsageError
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.task import Policy
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.learner import Trainer
from usarmjx.train.learning.ppo import MIN_LEARNING_RATE, imitation_loss
from usarmjx.train.learning.processes import ProcessGroup
from usarmjx.train.learning.train_state import policy_params

CONFIG = Config(
    num_worlds=32,
    rollout_length=16,
    num_minibatches=2,
    hidden_sizes=(32,),
    critic_hidden_sizes=(8,),
    learning_rate=3e-3,
)
ROUND = CONFIG.num_worlds * CONFIG.rollout_length * 3
"""Agent steps of an iteration: three robots."""


def straight(env):
    """Go straight to the goal; remember the steps of the episode."""
    del env

    def act(steps, obs, key):
        del key
        return steps + 1, tuple(jnp.clip(2.0 * one, -0.8, 0.8) for one in obs)

    return Policy(initial_carry=lambda worlds: jnp.zeros(worlds, jnp.int32), act=act)


@pytest.fixture(autouse=True)
def teacher(monkeypatch):
    monkeypatch.setattr(BASELINES, "_entries", dict(BASELINES._entries))
    BASELINES.add("drive-toy", straight)


def trainer_of(env=None, **settings):
    return Trainer(
        env or DriveToy(CONFIG.num_worlds), dataclasses.replace(CONFIG, **settings), ProcessGroup()
    )


class HiddenToy(DriveToy):
    """As its base, but robots do not see their goals; a task knows them from its memory."""

    scene = None

    def __init__(self, *args, **more):
        self.task = self
        self.for_baseline = "the task with goals in view"
        super().__init__(*args, **more)

    def see(self, x, time):
        return tuple(map(jnp.zeros_like, super().see(x, time)[0])), jnp.zeros(6)

    def started_at(self, memory, steps):
        return memory

    def baseline_obs(self, scene, memory, obs):
        assert scene is None
        assert not memory.x["goal"].shape[2:]  # of one world
        return super().see(memory.x, None)[0]


@pytest.mark.oracle
def test_the_loss_is_half_the_squares_of_what_is_off():
    kind = NormalTanhDistribution(2, min_std=0.0)
    scale = np.log(np.expm1(np.array([0.1, 0.1 + 0.2])))  # the inverse of softplus
    logits = jnp.array([*np.arctanh([0.5, -0.3]), *scale])
    assert_allclose(imitation_loss(kind, logits, jnp.array([0.5, -0.3]), 0.1), 0.5 * 0.2**2, rtol=1e-4)
    # What a teacher asks for beyond what a robot can do counts as all it can do.
    off = imitation_loss(kind, logits, jnp.array([3.0, -0.3]), 0.1)
    assert_allclose(off, 0.5 * (0.5**2 + 0.2**2), rtol=1e-4)


@pytest.mark.thorough
def test_a_learner_does_what_it_was_shown():
    trainer = trainer_of(imitation_steps=20 * ROUND, total_steps=25 * ROUND, imitation_std=0.1)
    train_state, worlds = trainer.start()
    off = []
    for iteration in range(20):
        train_state, worlds, known = trainer.iterate(train_state, worlds, iteration)
        off.append(float(known["loss/imitation"]))
    assert off[-1] < 0.05 * off[0]
    obs = worlds.env_state.obs
    done, _ = trainer.networks.policy.act(
        policy_params(train_state), obs, worlds.policy_carry, deterministic=True
    )
    drawn, _ = trainer.networks.policy.act(
        policy_params(train_state), obs, worlds.policy_carry, jax.random.key(0)
    )
    strays = np.concatenate(
        [(np.arctanh(a) - np.arctanh(b)).ravel() for a, b in zip(drawn, done, strict=True)]
    )
    assert 0.07 < np.std(strays) < 0.2, "near what imitate_std asks for, and not the usual 0.3"
    _, shown = straight(None).act(0, obs, None)
    for mine, his in zip(done, shown, strict=True):
        assert np.sqrt(np.mean((mine - his) ** 2)) < 0.15  # of 0.8, the teacher's fastest
    weights = train_state.params.policy
    for iteration in range(20, 25):  # PPO from here on: the policy goes on changing, and stays finite
        train_state, worlds, known = trainer.iterate(train_state, worlds, iteration)
    assert np.isfinite(float(known["loss/policy"]))
    assert not np.array_equal(
        weights[0]["params"]["head"]["bias"], train_state.params.policy[0]["params"]["head"]["bias"]
    )


def after_lessons(**settings):
    """What is known of the first update by PPO after twenty of imitation."""
    trainer = trainer_of(
        imitation_steps=20 * ROUND, total_steps=22 * ROUND, imitation_std=0.1, num_minibatches=8, **settings
    )
    (train_state, worlds), known = trainer.start(), {}
    for iteration in range(21):
        train_state, worlds, known = trainer.iterate(train_state, worlds, iteration)
    return {name: float(one) for name, one in known.items()}, trainer.config


@pytest.mark.thorough
def test_ppo_begins_carefully_after_the_lessons():
    """Its first update changed the policy by 37 times `target_kl`."""
    known, config = after_lessons()
    assert config.lr_schedule == "adaptive"
    assert known["loss/divergence"] < 3 * config.target_kl


@pytest.mark.thorough
def test_ppo_begins_with_moments_of_its_own():
    """By those of imitation the first update at a constant rate changed the policy by 0.17."""
    known, config = after_lessons(lr_schedule="constant")
    assert known["loss/rate"] == pytest.approx(config.learning_rate)
    assert known["loss/divergence"] < 0.1


def test_a_teacher_begins_anew_with_each_episode():
    trainer = trainer_of(imitation_steps=ROUND)
    train_state, worlds = trainer.start()
    worlds, steps, _, _ = trainer.rollout.collect(train_state, worlds, jax.random.key(0))
    since = np.zeros(CONFIG.num_worlds, int)
    for done in np.asarray(steps.done):
        since = np.where(done, 0, since + 1)
    assert_array_equal(worlds.teacher_carry, since)
    assert since.min() < CONFIG.rollout_length  # some episodes did end
    for shown, obs in zip(steps.teacher_action, steps.obs, strict=True):
        assert_allclose(shown, np.clip(2.0 * np.asarray(obs), -0.8, 0.8), rtol=1e-6)


def test_a_teacher_sees_what_is_hidden_and_the_policy_does_not():
    tasks = []
    BASELINES.replace("drive-toy", lambda env: tasks.append(env.task) or straight(env))
    env = HiddenToy(CONFIG.num_worlds)
    trainer = trainer_of(env, imitation_steps=ROUND)
    assert tasks == ["the task with goals in view"]
    assert env.task is env, "the worlds stay as they are"
    train_state, worlds = trainer.start()
    _, steps, _, _ = trainer.rollout.collect(train_state, worlds, jax.random.key(0))
    assert not any(np.asarray(one).any() for one in (*steps.obs, steps.privileged))
    way = worlds.env_state.memory.x["goal"] - worlds.env_state.memory.x["at"]
    for shown, part in zip(steps.teacher_action, (way[:, :2], way[:, 2:]), strict=True):
        assert_allclose(shown[0], np.clip(2.0 * np.asarray(part), -0.8, 0.8), rtol=1e-6)


@pytest.mark.parametrize("since", [0, pytest.param(1, marks=pytest.mark.thorough)])
def test_after_the_lessons_only_ppo_counts(since):
    """An update of a train_state past its lessons is that of one that never had any, to rounding.

    The first one begins at the lowest rate, with moments of its own.
    """
    with_teacher, alone = trainer_of(imitation_steps=ROUND), trainer_of()
    train_state, worlds = alone.start()
    assert int(train_state.iteration) == 0
    train_state = train_state.replace(iteration=train_state.iteration + 1 + since)
    _, steps, ends, sums = alone.rollout.collect(train_state, worlds, jax.random.key(0))
    _, same, _, _ = with_teacher.rollout.collect(train_state, with_teacher.start()[1], jax.random.key(0))
    assert not any(np.asarray(shown).any() for shown in same.teacher_action)
    experience = ends, {name: one[None] for name, one in sums.items()}
    begun = train_state if since else train_state.replace(learning_rate=jnp.float32(MIN_LEARNING_RATE))
    expected, _ = alone._update(begun, (steps, *experience), alone._stream)
    used = jax.tree.map(lambda one: one + jnp.ones_like(one), train_state.opt_state)
    taught = train_state if since else train_state.replace(opt_state=used)
    found, known = with_teacher._update(taught, (same, *experience), with_teacher._stream)
    assert "loss/imitation" in known
    for a, b in zip(jax.tree.leaves(expected.params), jax.tree.leaves(found.params), strict=True):
        assert_allclose(a, b, rtol=1e-6, atol=1e-7)
    assert_allclose(found.learning_rate, expected.learning_rate, rtol=1e-6)


def test_what_cannot_be_imitated_is_said():
    BASELINES._entries.pop("drive-toy")
    with pytest.raises(UsageError, match=r"drive-toy has no baseline.*set imitation_steps to 0.*explore"):
        trainer_of(imitation_steps=1)
    with pytest.raises(UsageError, match="imitation_steps is -1, expected a whole number from 0"):
        Config(imitation_steps=-1)
