"""A teacher sees what its task hides from the policy, and the policy does not."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.train.rooms import play, room
from usarmjx.base.errors import SpecError, UsageError
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.env import Env
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.learner import Trainer
from usarmjx.train.learning.ppo import teacher_obs, teacher_of
from usarmjx.train.learning.processes import ProcessGroup
from usarmjx.train.tasks import TASKS

STARTS = ((0.6, 0.9), (0.6, 2.1), (1.8, 0.9))
SEARCHERS = {"wheeled": ("P2AT",), "tracked": (), "flying": ("AirRobot",)}
TEAMS = {
    "explore-v1": {"count": 3},
    "explore-v2": {"count": 3},
    "victim-search-v1": SEARCHERS,
    "victim-search-v2": SEARCHERS,
    "relay-chain-v1": {"count": 2},
}
"""All tasks with advice, and teams of three for them."""
ADVICE = 5
"""Numbers of an observation, the first."""


def worlds_of(name, task, count):
    """What a teacher and its task ask for of an environment, without the worlds."""
    scene = task.scene()
    return SimpleNamespace(name=name, task=task, scene=scene, worlds=count, episode_steps=task.episode_steps)


def test_the_tasks_below_are_all_that_give_advice():
    advised = {name for name, task in TASKS if hasattr(task, "advice") and not task.discrete}
    assert advised == set(TEAMS)
    with pytest.raises(SpecError, match="robots of this task see no advice"):
        replace(TASKS.get("explore-v3"), advice=False)


FEW = ("victim-search-v2", "relay-chain-v1")
"""Every run shows them; the others, which have the same planner, are thorough."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in FEW else pytest.mark.thorough)
        for name in TEAMS
        if not name.endswith("-v1")
    ],
)
def test_a_teacher_acts_as_the_baseline_does_that_is_advised(name):
    shown = replace(TASKS.get(name), arena=room(STARTS, [(4.8, 2.0)]), **TEAMS[name])
    hidden = replace(shown, advice=False)
    way = np.array([[(x + 0.1 * step, y, 0.2) for x, y in STARTS] for step in range(3)])
    view, memory, _ = list(play(hidden, way))[-1]
    loud = view.links.replace(power=jnp.full_like(view.links.power, -40.0))  # else a relay waits
    view = view.replace(world=view.world.replace(links=loud))
    with_advice, seen = shown.observe(view, memory), hidden.observe(view, memory)
    assert all(np.abs(one[:, :ADVICE]).max() > 0.1 for one in with_advice)
    assert not any(np.asarray(one[:, :ADVICE]).any() for one in seen)

    def batch(tree):
        return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], tree)

    env, open_ = worlds_of(name, hidden, 1), worlds_of(name, shown, 1)
    given = teacher_obs(env, batch(memory), batch(seen))
    for one, other in zip(given, batch(with_advice), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-7)
    key, teacher, baseline = jax.random.key(0), teacher_of(env), BASELINES.get(name)(open_)
    _, taught = jax.jit(teacher.act)(teacher.initial_carry(1), given, key)
    _, expected = jax.jit(baseline.act)(baseline.initial_carry(1), batch(with_advice), key)
    for one, other in zip(taught, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)
        assert np.abs(other).max() > 0.1
    # Where nothing is hidden it sees the arrays that the policy sees.
    assert shown.baseline_obs(view.scene, memory, with_advice) is with_advice
    with pytest.raises(UsageError, match=f"{name} with advice=false: its baseline drives the way"):
        BASELINES.get(name)(env)


@pytest.fixture(scope="module")
def both():
    """Two worlds of `explore-v2` in a room, without advice and with it."""
    task = replace(
        TASKS.get("explore-v2"), arena=room(STARTS), count=2, episode_steps=3, repeat=2, physics="coarse"
    )
    return [Env(replace(task, advice=on), 2, name="explore-v2", engine="planar") for on in (False, True)]


@pytest.mark.slow
def test_a_training_without_advice_imitates_what_the_advised_baseline_does(both):
    """Over the end of an episode, too; what the policy sees has its size, and zeros for the advice."""
    hidden, shown = both
    assert [group.obs_size for group in hidden.groups] == [group.obs_size for group in shown.groups]
    config = Config(
        num_worlds=2,
        rollout_length=5,
        num_minibatches=1,
        hidden_sizes=(8,),
        critic_hidden_sizes=(8,),
        imitation_steps=100,
    )
    trainer = Trainer(hidden, replace(config, stagger_resets=False), ProcessGroup())
    train_state, worlds = trainer.start()
    _, steps, _, _ = trainer.rollout.collect(train_state, worlds, jax.random.key(0))
    kind, baseline = trainer.networks.policy.distribution(0), BASELINES.get("explore-v2")(shown)
    state = shown.reset(config.seed)
    for step in range(config.rollout_length):
        (seen,), (mine,) = state.obs, (np.asarray(steps.obs[0][step]),)
        assert np.abs(seen[..., :ADVICE]).max() > 0.1
        assert not mine[..., :ADVICE].any()
        np.testing.assert_array_equal(mine[..., ADVICE:], seen[..., ADVICE:])
        _, (expected,) = baseline.act((), state.obs, jax.random.key(0))
        np.testing.assert_allclose(steps.teacher_action[0][step], expected, rtol=1e-5, atol=1e-6)
        state = shown.step(state, (kind.postprocess(steps.raw_action[0][step]),))
    assert np.asarray(steps.done).any()
