"""The table of what scores mean: who plays, what the rows say, what is refused."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.train.envs.recipe import held_out
from usarmjx.train.envs.state import AgentGroup
from usarmjx.train.evaluation import yardsticks
from usarmjx.train.evaluation.yardsticks import (
    HELD_STEPS,
    TEAMS,
    alone,
    arenas_to_play,
    default_teams,
    find_team,
    measure_teams,
    packaged_policy,
    random_policy,
    table,
    team_result,
    unchanged,
    with_perfect_radio,
)
from usarmjx.train.make import make_task
from usarmjx.train.policies.sources import PolicySource, arenas_of
from usarmjx.train.tasks.buildings import Buildings
from usarmjx.train.tasks.team import PERFECT_RADIO

STEPS, WORLDS = 8, 3


@pytest.fixture(scope="module")
def row():
    """A team that explores half at once and half of the rest in step 6, in three worlds."""
    task = make_task("explore-v2", episode_steps=STEPS)
    seen = np.repeat([0.5] * 5 + [0.75] * 3, WORLDS).reshape(STEPS, WORLDS)
    series = {"explored": seen, "known": 0 * seen, "contacts": np.ones_like(seen)}
    scores = 50 * (0.5 + 0.25 * (0.75 + 0.25 * 3 / 8)) - task.price + np.array([-1.0, 0.0, 1.0])
    return task, team_result(task, "baseline", scores, series, bad=1)


def test_a_row_says_how_the_score_is_made_up_and_how_early_it_came(row):
    task, found = row
    late = 50 * 0.25 * (0.75 + 0.25 * 3 / 8)
    assert found.parts == pytest.approx({"explored": 25 + late, "known": 0.0, "contacts": -task.price})
    assert sum(found.parts.values()) == pytest.approx(found.score.value)
    assert found.finds == pytest.approx((*[25.0] * 5, *[25 + late] * 3))
    assert found.reached == pytest.approx((25 / (25 + late), 25 / (25 + late), 1.0))
    assert found.score.low < found.score.value < found.score.high
    with pytest.raises(UsageError, match="baseline: no episode ended well"):
        team_result(task, "baseline", np.zeros(0), {})


def test_the_table_has_the_bytes_that_robots_send_where_they_are_counted(row):
    task, found = row
    plain, counted = table(task, [found]), table(task, [replace(found, sent=12.3), found])
    assert "bytes/s" not in plain
    head, _, _, first, second = counted.splitlines()
    assert head.endswith("| bytes/s |")
    assert first.endswith("| 12 |")
    assert second.endswith("|  |")


def test_the_table_begins_with_what_can_be_reached_at_most(row):
    head, _, most, line = table(row[0], [row[1]]).splitlines()
    assert head == (
        "| team | score | 95 % interval | explored | known | contacts | 1/4 | 1/2 | 3/4 | outside |"
    )
    assert most == "| at most | 100 |  | 50 | 50 | 0 |  |  |  |  |"
    assert line.startswith("| baseline | 35.3 |")
    assert line.endswith("| 35.5 | 0.0 | -0.2 | 70 % | 70 % | 100 % | 0 % |")


def test_teams_are_the_task_with_a_robot_or_a_radio_of_another_kind():
    search, explore = make_task("victim-search-v2"), make_task("explore-v2")
    assert [spec.name for spec in alone(search).robots] == ["ComStation", "P2AT"]
    assert [spec.name for spec in alone(explore).robots] == ["P2AT"]
    assert alone(explore).arena == explore.arena
    assert with_perfect_radio(search).radio == PERFECT_RADIO
    limited = make_task("relay-chain-v3", byte_rate=64.0, talk="none", actions="goals+message")
    change, _ = find_team("oracle")
    known = replace(limited, oracle=True, radio=PERFECT_RADIO, byte_rate=None, talk="all")
    assert change(limited) == known


def test_teams_without_a_policy_of_ones_own_are_those_that_can_play():
    assert default_teams("explore-v2") == tuple(TEAMS)
    assert default_teams("victim-search-v2") == tuple(TEAMS)
    assert default_teams("soccer-v1") == tuple(name for name in TEAMS if name != "packaged")
    assert find_team("one") is TEAMS["one"]
    change, _ = find_team("explore-v1")  # a packaged policy, by its own name
    task = make_task("explore-v2")
    assert change(task) is task
    with pytest.raises(UnknownNameError, match=r"fast is none of the teams random, one, .* is no folder"):
        find_team("fast")


def test_robots_at_random_keep_what_they_drew_for_a_while():
    group = AgentGroup("P2AT", ("a", "b"), 5, 2)
    policy, rows = random_policy(SimpleNamespace(groups=(group,))), []
    carry = policy.initial_carry(WORLDS)
    for step in range(2 * HELD_STEPS):
        carry, (action,) = policy.act(carry, (jnp.zeros((WORLDS, 2, 5)),), jax.random.key(step))
        rows.append(np.asarray(action))
    first, second = np.split(np.stack(rows), 2)
    assert (first == first[0]).all()
    assert (second == second[0]).all()
    assert len(np.unique(np.stack([first[0], second[0]]))) == 2 * WORLDS * 2 * 2
    assert np.abs(rows).max() <= 1.0


SMALL = Buildings(size=(3, 3), levels=(0.5, 0.8))


def test_teams_of_a_split_play_in_its_buildings_each_in_its_own():
    whole = arenas_to_play("explore-v2", None, "validation", arena=SMALL)
    assert whole == arenas_of("explore-v2", {"arena": SMALL}, "validation").arenas()
    assert len(whole) == 100
    assert {held_out([arena]) for arena in whole} == {"validation"}
    some = arenas_to_play("explore-v2", 5, "validation", arena=SMALL)
    assert some == whole[::20], "of all levels alike: 50 easy ones come first"
    assert len(arenas_to_play("explore-v2", 300, "validation", arena=SMALL)) == 100
    with pytest.raises(UnknownNameError, match="exam"):
        arenas_to_play("explore-v2", 5, "exam")
    with pytest.raises(UsageError, match="explore-v1 has no generated arenas as it is set up"):
        arenas_to_play("explore-v1", 5, "test", arena="floor")


@pytest.fixture
def games(monkeypatch):
    """Who played in what, instead of games: name, task, worlds."""
    seen = []

    def play(env, task, policy, name, seed, watch):
        seen.append((name, task, env[1]))
        return SimpleNamespace(name=name)

    def found(name):
        told = {"runs/blind": {"advice": "false"}, "runs/told": {"advice": "true"}, "runs/usual": {}}
        return PolicySource(name=name, task="explore-v2", overrides=told[name])

    monkeypatch.setattr(yardsticks, "build_env", lambda task, worlds, name, engine: (task, worlds))
    monkeypatch.setattr(yardsticks, "play_team", play)
    monkeypatch.setattr(yardsticks, "load_policy", found)
    monkeypatch.setattr(PolicySource, "policy", lambda source, env: None)
    monkeypatch.setattr(
        yardsticks, "TEAMS", {n: (change, lambda env: None) for n, (change, _) in TEAMS.items()}
    )
    return seen


def test_all_teams_play_in_the_same_held_out_buildings(games):
    measure_teams("explore-v2", 4, split="test", arena=SMALL)
    assert [name for name, *_ in games] == list(TEAMS)
    assert {worlds for *_, worlds in games} == {4}
    assert len({task.arena for _, task, _ in games}) == 1
    assert held_out(games[0][1].arena) == "test"
    games.clear()
    measure_teams("explore-v2", 4, arena=SMALL)
    assert held_out(games[0][1].arena) == "test"
    games.clear()
    measure_teams("explore-v2", 4, split="train", arena=SMALL)
    assert held_out(games[0][1].arena) is None


def test_a_packaged_policy_for_other_robots_is_left_out_unless_it_is_named(games, monkeypatch):
    def refused(env):
        raise UsageError("packaged is for another robot")

    monkeypatch.setattr(yardsticks, "TEAMS", {**yardsticks.TEAMS, "packaged": (unchanged, refused)})
    warnings = []
    measure_teams("explore-v2", 4, warn=warnings.append, arena=SMALL)
    assert [name for name, *_ in games] == [name for name in TEAMS if name != "packaged"]
    assert warnings == ["packaged is left out: packaged is for another robot"]
    games.clear()
    with pytest.raises(UsageError, match="for another robot"):
        measure_teams("explore-v2", 4, teams=("random", "packaged"), arena=SMALL)
    assert games == [], "refused before anybody plays"


def test_policies_see_advice_as_in_training_and_by_hand_always(games):
    names = ("random", "one", "baseline", "perfect-radio", "runs/blind", "runs/told", "runs/usual")
    measure_teams("explore-v2", 4, teams=names, arena=SMALL)
    assert [task.advice for _, task, _ in games] == [True] * 4 + [False, True, True]
    games.clear()
    measure_teams("explore-v2", 4, teams=names, arena=SMALL, advice=False)
    assert [task.advice for _, task, _ in games] == [False, True, True, True] + [False] * 3


def test_what_has_no_parts_or_no_policy_is_refused():
    with pytest.raises(UsageError, match="drive-to-goal is no task for a team: its score has no parts"):
        measure_teams("drive-to-goal", 1)
    with pytest.raises(UsageError, match="no policy is packaged for soccer-v1; known: drive-to-goal"):
        packaged_policy(SimpleNamespace(name="soccer-v1"))
