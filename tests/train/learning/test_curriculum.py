"""Generated arenas that get harder during a run: which worlds meet when, and again after a restart."""

import json
from dataclasses import replace
from itertools import pairwise

import jax
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import usarmjx
from tests.train.envs.test_env import LIGHT
from tests.train.runs import check_goes_on, lines
from usarmjx.base.errors import UsageError
from usarmjx.train.envs.recipe import GeneratedArenas
from usarmjx.train.evaluation.evaluate import run_episodes
from usarmjx.train.learning.checkpoint import FORMAT, Checkpoints, read_part
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.learner import SCORING_SEED, Trainer
from usarmjx.train.learning.processes import ProcessGroup
from usarmjx.train.learning.train_state import make_networks, policy_params
from usarmjx.train.learning.trainer import train
from usarmjx.train.tasks.buildings import Buildings

ARENAS = GeneratedArenas(kind="maze", count=1, levels=(0.0, 0.5, 1.0), size=(3, 3))
"""One easy, one in the middle, one hard."""
STEPS = 4
"""Actions of an episode and of a rollout: each world meets another arena in every iteration."""
CONFIG = Config(
    total_steps=6 * STEPS * 4,  # six iterations of four worlds
    num_worlds=4, rollout_length=STEPS, num_minibatches=2, num_epochs=1,
    hidden_sizes=(4,), critic_hidden_sizes=(4,),
    curriculum=0.5, checkpoint_interval=1, keep_checkpoints=10,
)  # fmt: skip
LEVELS = (0.0, 1 / 3, 2 / 3, 1.0, 1.0, 1.0)
"""It rises over half of the iterations, evenly."""


@pytest.fixture(scope="module")
def env():
    return usarmjx.make(
        "drive-to-goal", 4, "c", **LIGHT, pose="GroundTruth", arena=ARENAS, episode_steps=STEPS, radius=1e-6
    )


@pytest.fixture(scope="module")
def trained(env, tmp_path_factory):
    """Folder of a run."""
    folder = tmp_path_factory.mktemp("curriculum") / "run"
    train(env, CONFIG, folder, progress=False)
    return folder


def numbers(env, solids):
    """Which of the environment's arenas these are, by where their solids are."""
    every = np.asarray(env.scene.arenas.states.pos)
    return [next(n for n, one in enumerate(every) if np.array_equal(one, pos)) for pos in np.asarray(solids)]


def test_arenas_of_a_library_get_harder():
    """By how much stands and lies about in them."""
    arenas = replace(ARENAS, count=3).arenas()
    obstacles = np.array([len(arena.shapes) + len(arena.loose) for arena in arenas]).reshape(3, 3).sum(1)
    assert all(easy < hard for easy, hard in pairwise(obstacles))
    lengths = [sum(2 * max(wall.size) for wall in arena.shapes) for arena in Buildings(count=4).arenas()]
    assert all(easy < hard for easy, hard in pairwise(np.reshape(lengths, (3, 4)).sum(1)))


@pytest.mark.parametrize(
    ("level", "expected"),
    [
        (0.0, [0, 1, 0, 1, 0, 1]),  # no arena is as easy as that: those of the easiest level
        (0.3, [0, 1, 0, 1, 0, 1]),
        (0.6, [0, 1, 2, 3, 0, 2]),  # one of each level comes once more, not both of the easiest
        (np.float32(0.8), [0, 1, 2, 3, 4, 5]),  # a little more than 0.8
        (1.0, [0, 1, 2, 3, 4, 5]),
    ],
)
def test_those_in_play_fill_a_library_evenly(level, expected):
    assert_array_equal(GeneratedArenas(count=2, levels=(0.2, 0.6, 0.8)).arena_indices(level), expected)


def test_arenas_get_harder_during_a_run(env, trained):
    """In each iteration worlds meet only arenas that are no harder than its level, and in the end all."""
    assert [line["level"] for line in lines(trained)] == pytest.approx(LEVELS)
    _, template = Trainer(env, CONFIG, ProcessGroup()).start()
    met = []
    for path, level in zip(Checkpoints(trained).all(), LEVELS, strict=True):
        state = read_part(path, "worlds", template).env_state
        assert float(state.level) == pytest.approx(level)
        allowed = {n for n, one in enumerate(ARENAS.levels) if one <= level}
        assert set(numbers(env, state.batch.arenas.pos)) == allowed
        met.append(set(numbers(env, state.batch.worlds.arena_state.pos)))
        assert met[-1] <= allowed
    assert met[:2] == [{0}, {0}]
    assert set.union(*met[3:]) == {0, 1, 2}


def test_the_best_under_a_curriculum_is_best_in_all_arenas(env, trained):
    """A checkpoint's score is of the same episodes in arenas of all levels; what is in training stays."""
    trainer = Trainer(env, CONFIG, ProcessGroup())
    learner, worlds = trainer.start()
    policy = make_networks(env.groups, env.privileged_size, CONFIG).policy
    checkpoints = Checkpoints(trained)
    path = checkpoints.find("1")
    learner = read_part(path, "learner", learner)
    before = jax.tree.leaves(worlds.env_state.obs)[0].copy()
    expected = run_episodes(env, policy.as_policy(policy_params(learner)), env.worlds, SCORING_SEED)
    assert checkpoints.meta(path)["score"] == pytest.approx(expected.scores.mean())
    assert trainer.full_difficulty_score(learner) == pytest.approx(expected.scores.mean())
    assert checkpoints.meta(path)["kind"] == "at full difficulty"
    assert_array_equal(jax.tree.leaves(worlds.env_state.obs)[0], before)


@pytest.mark.parametrize(
    ("kinds", "best"),
    [
        (("in training", "in training"), 1),  # the higher score
        (("in training", "at full difficulty"), 2),  # arenas were easy then
        (("at full difficulty", "at full difficulty"), 1),
        ((None, None), 1),  # by an earlier version
    ],
)
def test_a_score_of_easy_arenas_is_never_best(kinds, best, tmp_path):
    for number, (kind, score) in enumerate(zip(kinds, (0.9, 0.4), strict=True), start=1):
        folder = tmp_path / "checkpoints" / f"{number:08d}"
        folder.mkdir(parents=True)
        told = {} if kind is None else {"kind": kind}
        about = {"format": FORMAT, "iteration": number, "agent_steps": 1000 * number, "score": score}
        (folder / "meta.json").write_text(json.dumps({**about, **told}))
    checkpoints = Checkpoints(tmp_path)
    assert checkpoints.find("best").name == f"{best:08d}"
    why = f"the best by score {kinds[best - 1] or 'in training'}: {(0.9, 0.4)[best - 1]} after {best},000"
    assert checkpoints.describe("best") == (
        f"checkpoint {best} of {tmp_path}, {why} agent steps (others: {3 - best})"
    )
    assert checkpoints.describe("last").startswith(f"checkpoint 2 of {tmp_path}, the last: 0.4 after 2,000")
    assert checkpoints.describe("1").startswith(f"checkpoint 1 of {tmp_path}, as asked for: 0.9")


def test_a_run_goes_on_with_the_arenas_that_were_in_play(env, trained, tmp_path):
    """Left after two of six iterations, it ends as if it had not been."""
    check_goes_on(env, CONFIG, trained, tmp_path / "run", 2)


def test_arenas_that_are_not_generated_have_no_levels(tmp_path):
    env = usarmjx.make("drive-to-goal", 4, "c", **LIGHT)
    with pytest.raises(UsageError, match=r"curriculum is 0.5, but drive-to-goal has no generated arenas"):
        train(env, CONFIG, tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()
    with pytest.raises(UsageError, match=r"drive-to-goal has no generated arenas, so none of level 0.5"):
        env.reset(level=0.5)
