"""Ablations hide what they name, and compare in the same buildings."""

import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import estimate_groups
from usarmjx.cli.app import app
from usarmjx.train.envs.task import Policy
from usarmjx.train.evaluation import ablation
from usarmjx.train.evaluation.ablation import (
    ABLATIONS,
    GOAL_ABLATIONS,
    MAP_SIZE,
    MATES,
    ablate,
    ablation_row,
    ablation_table,
    ablations_of,
    hidden_policy,
    unchanged_task,
)
from usarmjx.train.evaluation.yardsticks import TeamResult
from usarmjx.train.mapping.belief import SECTOR_COUNT, initial_belief
from usarmjx.train.mapping.maps import MapGrid
from usarmjx.train.mapping.planning import Goals
from usarmjx.train.tasks.explore import Explore
from usarmjx.train.tasks.goal_features import (
    GOALS,
    OBSERVATION_SIZE,
    OBSERVED_MATES,
    OWN_NUMBERS,
    GoalView,
    first_mates,
    goal_features,
    mate_features,
    nearest_mates,
)
from usarmjx.train.tasks.goal_features import (
    MATES as GOAL_MATES,
)
from usarmjx.train.tasks.reporting_team import ExploreBase
from usarmjx.train.tasks.team import PERFECT_RADIO

OTHERS = 3
SIZE = MATES + 4 * OTHERS + 2 * MAP_SIZE + 2
"""Two numbers more, as `relay-chain-v1` has."""


def hidden(name):
    """Where an ablation changes an observation of nines, and what it puts there."""
    policy = Policy(lambda worlds: (), lambda carry, obs, key: (carry, obs))
    _, (seen,) = hidden_policy(policy, ABLATIONS[name][1], OTHERS).act(
        (), (jnp.full((1, 2, SIZE), 9.0),), None
    )
    (places,) = np.nonzero(np.asarray(seen[0, 1]) != 9.0)
    return places, np.asarray(seen[0, 1])[places]


def test_each_ablation_hides_its_part_of_the_observation():
    """Places by `TeamTask`: advice 5, progress 1, sectors 12, time, index, four of each mate, the map."""
    assert [len(hidden(name)[0]) for name in ("nothing", "messages", "perfect radio")] == [0, 0, 0]
    places, values = hidden("advice")
    assert (places.tolist(), values.tolist()) == ([0, 1, 2, 3, 4], [0.0] * 5)
    assert hidden("goal")[0].tolist() == [2, 3, 4]
    places, values = hidden("mates")
    assert (places[0], places[-1]) == (20, 31)
    assert values.tolist() == [0.0, 0.0, 1.0, 0.0] * OTHERS
    places, values = hidden("map")
    assert (places[0], len(places), values.sum()) == (32, 2 * MAP_SIZE, MAP_SIZE)


def test_radio_ablations_change_the_task():
    task = Explore(count=2)
    assert ABLATIONS["messages"][0](task).talk == "none"
    assert ABLATIONS["perfect radio"][0](task).radio == PERFECT_RADIO


GRID = MapGrid(low=(0.0, 0.0), cell=0.3, shape=(40, 40))
POSES = jnp.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.5], [6.0, 1.0, 2.0], [4.0, 4.0, -1.0]])
"""The base, and three robots."""


@jax.jit
def observed_goals(untold, heard):
    """Return the robots' observations if they have heard of these others (robots, robots)."""
    belief = initial_belief(GRID, POSES)
    belief = belief.replace(heard_time=jnp.where(heard, 0.0, -jnp.inf))
    mates = nearest_mates(belief, 0, 1.0, OBSERVED_MATES)
    others = heard[:, [2, 3]] & ~jnp.eye(4, dtype=bool)[:, [2, 3]]
    goals = Goals(
        position=jnp.stack(
            [jnp.full((4, GOALS), 2.0), jnp.broadcast_to(jnp.arange(GOALS) / 3, (4, GOALS))], -1
        ),
        length=jnp.full((4, GOALS), 9.0),
        gain=jnp.full((4, GOALS), 0.5),
        valid=jnp.ones((4, GOALS), bool).at[:, 1:3].set(others).at[:, 12:].set(False),
    )
    judged = GoalView(base=0, time=1.0, seconds=80.0, untold=untold, mates=first_mates(mates, GOAL_MATES))
    chosen = jnp.full(4, 4, jnp.int32)
    own = jnp.full((4, OWN_NUMBERS), 0.7).at[:, 5].set(untold[:, 0] / 1000.0)
    own = own.at[:, 7].set((heard & ~jnp.eye(4, dtype=bool))[:, 1:].sum(-1) / 16)
    rows = [own, jnp.full((4, SECTOR_COUNT), 0.3)]
    rows += [mate_features(belief, mates, jnp.zeros((4, 4), bool), judged)]
    rows += [goal_features(GRID, belief, goals, chosen, judged), goals.valid.astype(jnp.float32)]
    seen = jnp.concatenate(rows, -1)[1:]
    assert seen.shape == (3, OBSERVATION_SIZE)
    return seen


def test_others_that_are_hidden_are_as_if_they_were_never_heard():
    """The observation is that of robots which have heard nobody, to the bit."""
    untold = jnp.array([[0.0] * 4, [500.0, 0.0, 90.0, 80.0], [0.0, 70.0, 0.0, 60.0], [50.0, 40.0, 30.0, 0.0]])
    everybody, nobody = jnp.ones((4, 4), bool), jnp.zeros((4, 4), bool)
    seen = observed_goals(untold, everybody)
    hidden_others = GOAL_ABLATIONS["mates"][1](seen, OTHERS)
    np.testing.assert_array_equal(hidden_others, observed_goals(untold, nobody))
    assert (np.asarray(seen != hidden_others).sum(-1) > 30).all()
    np.testing.assert_array_equal(GOAL_ABLATIONS["messages"][1](seen, OTHERS), seen)


def test_news_that_are_hidden_are_as_if_the_others_knew_all():
    untold = jnp.array([[0.0] * 4, [500.0, 0.0, 90.0, 80.0], [0.0, 70.0, 0.0, 60.0], [50.0, 40.0, 30.0, 0.0]])
    everybody = jnp.ones((4, 4), bool)
    seen = observed_goals(untold, everybody)
    known = observed_goals(jnp.zeros((4, 4)), everybody)
    np.testing.assert_array_equal(GOAL_ABLATIONS["news"][1](seen, OTHERS), known)
    assert (seen[0] != known[0]).any()


def test_robots_that_choose_goals_have_their_own_ablations():
    task = ExploreBase(count=2)
    assert ablations_of(task) is GOAL_ABLATIONS
    assert ablations_of(Explore(count=2)) is ABLATIONS
    assert GOAL_ABLATIONS["messages"][0](task).talk == "base"
    with pytest.raises(UsageError, match="expected actions=goals, not wheels"):
        ablations_of(ExploreBase(count=2, actions="wheels"))


def result(name, by_world):
    scores = np.array(by_world)
    return TeamResult(
        name=name,
        score=estimate_groups(scores[np.isfinite(scores)]),
        parts={"explored": 10.0},
        finds=(1.0,),
        outside=0.0,
        bad=int(np.isnan(scores).sum()),
        by_world=tuple(by_world),
    )


def test_differences_are_of_the_worlds_that_both_have():
    """Three pairs of -9, -10 and -11: a mean of -10, and Student's interval of three: 4.303 / sqrt(3)."""
    whole = result("mine", [50.0, 40.0, 30.0, np.nan])
    row = ablation_row("mine", "advice", result("mine", [41.0, 30.0, 19.0, 7.0]), whole)
    assert row.difference.value == pytest.approx(-10.0)
    assert row.difference.high - row.difference.value == pytest.approx(4.303 / 3**0.5, rel=1e-3)
    table = ablation_table([ablation_row("mine", "nothing", whole, whole), row])
    assert "| mine | advice | 24.2 | -10.0 (-12.5 to -7.5) | 10.0 |" in table


@pytest.fixture
def games(monkeypatch):
    """The tasks that were built, and the games that were played: name, task and whether all is seen.

    A game gives 10 points, and 5 less without messages.
    """
    built, played = [], []

    def build(task, worlds, name, engine):
        built.append(task)
        return SimpleNamespace(task=task, worlds=worlds, scene=SimpleNamespace(num_robots=3))

    def play(env, task, policy, name, seed):
        seen = observed_goals(jnp.full((4, 4), 500.0), jnp.ones((4, 4), bool))
        _, (shown,) = policy.act((), (seen,), jax.random.key(seed))
        played.append((name, task, bool((shown == seen).all())))
        return result(name, [10.0 - 5.0 * (task.talk == "base") + world for world in range(env.worlds)])

    monkeypatch.setattr(ablation, "build_env", build)
    monkeypatch.setattr(ablation, "play_team", play)
    still = Policy(lambda worlds: (), lambda carry, obs, key: (carry, obs))
    monkeypatch.setattr(ablation, "find_team", lambda name: (unchanged_task, lambda env: still))
    return built, played


def test_each_part_is_taken_away_in_a_game_of_its_own_and_worlds_are_built_once(games):
    built, played = games
    rows = ablate(ExploreBase(count=2), "explore-v3", 3, ["mine", "other"])
    assert [(row.team, row.without) for row in rows] == [
        (team, part) for team in ("mine", "other") for part in GOAL_ABLATIONS
    ]
    assert [row.difference.value for row in rows] == [0.0, 0.0, 0.0, -5.0, 0.0] * 2
    assert [whole for *_, whole in played[:5]] == [True, False, False, True, True]
    assert [(task.talk, task.radio == PERFECT_RADIO) for task in built] == [
        ("all", False),
        ("base", False),
        ("all", True),
    ]


@pytest.mark.usefixtures("games")
def test_the_command_prints_the_table_and_keeps_the_rows(tmp_path):
    file = tmp_path / "rows.json"
    words = ["teams", "explore-v3", "packaged", "--ablate", "--worlds", "3", "--set", "count=2"]
    found = CliRunner().invoke(app, [*words, "--engine", "c", "--json", str(file)])
    assert found.exit_code == 0, found.output
    assert "| packaged | messages | 6.0 | -5.0" in found.output
    kept = json.loads(file.read_text())
    assert (kept["task"], kept["split"], kept["settings"]) == ("explore-v3", "test", ["count=2"])
    assert [row["without"] for row in kept["rows"]] == list(GOAL_ABLATIONS)
    assert kept["rows"][3]["by_world"] == [5.0, 6.0, 7.0]
