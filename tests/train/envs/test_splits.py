"""Generated arenas that nobody trains on, and what they are for."""

from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.cli.app import app
from usarmjx.cli.task_options import PolicyOptions
from usarmjx.train.envs.recipe import HELD_OUT_END, HELD_OUT_START, SPLITS, GeneratedArenas, held_out
from usarmjx.train.envs.task import Policy
from usarmjx.train.evaluation.evaluate import play_episodes
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.learner import Trainer
from usarmjx.train.learning.processes import ProcessGroup
from usarmjx.train.make import make
from usarmjx.train.tasks.buildings import Buildings

SMALL = GeneratedArenas(kind="maze", count=1, levels=(0.0, 1.0), size=(3, 3))


class Place(SimpleNamespace):
    """Somewhere: what is not said of it is None."""

    def __getattr__(self, name):
        return None


def test_no_arena_is_of_two_splits(monkeypatch):
    """Not even where the drawn seeds would fall among those that are held out."""
    library = Buildings()
    seeds = {name: set(library.of_split(name).seeds().tolist()) for name, _ in SPLITS}
    assert {name: len(found) for name, found in seeds.items()} == {
        "train": 48,
        "validation": 102,
        "test": 201,
        "fresh": 102,
    }
    for name in ("train", "validation", "test"):
        assert not seeds["fresh"] & seeds[name]
    assert not seeds["train"] & (seeds["validation"] | seeds["test"])
    assert not seeds["validation"] & seeds["test"]
    drawn = np.array([0, HELD_OUT_START, HELD_OUT_END - 1, HELD_OUT_END], np.uint32)

    class Drawn:
        def __init__(self, seed):
            pass

        def generate_state(self, count, kind):
            return drawn

    monkeypatch.setattr(np.random, "SeedSequence", Drawn)
    found = SPLITS.get("train").seeds(0, 4)
    assert not ((found >= HELD_OUT_START) & (found < HELD_OUT_END)).any()
    assert (found[[0, 3]] == drawn[[0, 3]]).all()


def test_the_arenas_trained_on_are_those_of_before():
    """Shipped policies were trained in them, and their scores are of them."""
    assert Buildings(count=1).arenas()[0].name == "DM-building-10x8-2968811710"


@pytest.mark.parametrize("split", ["validation", "test", "fresh"])
def test_nobody_trains_on_held_out_arenas(split):
    """Whether all worlds have one of them or each its own."""
    config = Config(num_worlds=2, num_minibatches=1, hidden_sizes=(4,), critic_hidden_sizes=(4,))
    arenas = SMALL.of_split(split).arenas()[:2]
    for scene in (Place(arena=arenas[1]), Place(arenas=Place(arenas=arenas))):
        env = Place(name="mine", worlds=2, levels=(), scene=scene)
        with pytest.raises(UsageError, match=f"mine has arenas of the split {split}, which are held out"):
            Trainer(env, config, ProcessGroup())
    assert held_out(SMALL.arenas()) is None


def test_consecutive_arenas_of_a_mixed_order_are_of_all_levels_alike():
    """As many of each level, or one more, wherever one begins; and each arena once in a round."""
    library = Buildings(count=3)
    order = library.mixed_order()
    assert sorted(order) == list(range(library.total))
    levels = np.concatenate([order, order]) // library.count
    for begin in range(library.total):
        for end in range(begin + 1, begin + library.total):
            counts = np.bincount(levels[begin:end], minlength=3)
            assert counts.max() - counts.min() <= 1


@pytest.mark.parametrize("worlds", [3, *(pytest.param(more, marks=pytest.mark.thorough) for more in (6, 12))])
def test_few_worlds_meet_all_levels_when_a_policy_is_tried(worlds):
    """Worlds go through the arenas in turn, and the easy ones come first: twenty worlds met few others."""
    arenas = GeneratedArenas(kind="maze", count=4, levels=(0.0, 0.5, 1.0), size=(3, 3))
    env = make(
        "drive-to-goal",
        worlds=worlds,
        engine="c",
        arena=arenas,
        episode_steps=1,
        ranges=(),
        pose="GroundTruth",
    )

    def act(carry, obs, key):
        return carry, tuple(np.zeros((*one.shape[:-1], 2), np.float32) for one in obs)

    step, serials = env.step, []

    def noted(state, actions):
        serials.append(np.asarray(state.batch.worlds.arena_state.serial) // arenas.count)
        return step(state, actions)

    env.step = noted
    play_episodes(env, Policy(lambda worlds: (), act), 2 * worlds)
    met = [np.bincount(one, minlength=3).tolist() for one in serials]
    assert met == [[worlds // 3] * 3] * 2
    first = env.reset(0)
    assert np.asarray(first.batch.worlds.arena_state.serial).tolist() == list(range(worlds)), "as ever"
    with pytest.raises(UsageError, match=r"not of level 0\.5 and below"):
        env.reset(0, 0.5, mixed=True)


def test_eval_plays_each_arena_of_a_split_once():
    options = PolicyOptions(baseline="drive-to-goal", settings=["arena=maze", "ranges="])
    source = options.source()
    assert options.amount(source, "validation", None, None) == (100, 100)
    assert options.amount(source, "validation", 10, None) == (10, 100)
    assert options.amount(source, None, None, None) == (80, 80), "in its own, too: all levels count alike"
    assert options.amount(source, None, None, 300) == (80, 300)
    assert options.amount(source, None, 20, 60) == (20, 60)
    floor = PolicyOptions(baseline="drive-to-goal")
    assert floor.amount(floor.source(), None, None, None) == (20, 100)
    env, _ = options.env(source, 1, "c", "validation")
    assert held_out(env.scene.arenas.arenas[-1:]) == "validation"
    assert len(env.scene.arenas.arenas) == 100
    told = CliRunner().invoke(app, ["eval", "--baseline", "drive-to-goal", "--split", "test"])
    assert told.exit_code == 2
    assert "drive-to-goal has no generated arenas as it is set up, so none of the split test" in told.output
    with pytest.raises(UnknownNameError, match="unknown split 'exam'; known: fresh, test, train, validation"):
        SMALL.of_split("exam")
