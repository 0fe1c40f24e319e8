"""The check that the radio matters: what its variants are, and when it holds."""

from dataclasses import replace

import numpy as np
import pytest

from tests.train.rooms import room
from usarmjx.base.errors import UsageError
from usarmjx.comms.attenuation import RadioSettings, link_range, received_power
from usarmjx.train.evaluation.radio_matters import (
    Interval,
    VariantResult,
    check_results,
    few_arenas,
    main,
    measure,
    table,
    variants,
)
from usarmjx.train.make import make_task
from usarmjx.train.tasks.team import PERFECT_RADIO, WALLED_RADIO

STARTS = ((0.6, 0.9), (0.6, 2.1), (1.8, 0.9), (1.8, 2.1))
TEAMS = {
    "explore-v1": {"count": 3},
    "relay-chain-v1": {"count": 2},
    "victim-search-v1": {"wheeled": ("P2AT",) * 2},
}
"""Fields that make each team small: three robots, the base counted."""
PAIRS = 6
LETTERS = {"explore-v1": (PAIRS, 0), "relay-chain-v1": (PAIRS, 0), "victim-search-v1": (PAIRS, 2)}
"""How many robots write to how many others, with the task's own radio and without messages: to none, or each
but the base to the base."""


WORLDS = {"explore-v1": "12", "relay-chain-v1": "3", "victim-search-v1": "3"}
"""Of the check's runs in docs/evidence/tasks.md."""


def small(name):
    """A team task of three robots in a room."""
    more = {"tracked": (), "flying": ()} if name == "victim-search-v1" else {}
    return make_task(name, arena=room(STARTS, ((5.0, 1.5),)), **TEAMS[name], **more)


@pytest.mark.parametrize("name", TEAMS)
def test_variants_differ_in_their_radio_and_in_who_writes_to_whom(name):
    task = small(name)
    found = variants(task)
    assert found["real"] == task
    assert found["perfect"] == replace(task, radio=PERFECT_RADIO)
    assert found["none"] == replace(task, talk=found["none"].talk)
    scene = task.scene()
    assert scene.num_robots == 3
    written = [int(found[which].recipients(scene).sum()) for which in ("perfect", "real", "none")]
    assert written == [PAIRS, *LETTERS[name]]


def test_each_world_has_an_arena_of_its_own_of_all_levels_alike():
    task = make_task("explore-v1")
    levels = task.arena.levels
    few = few_arenas(task, 2 * len(levels))
    assert few == replace(task, arena=replace(task.arena.of_split("test"), count=2))
    assert few_arenas(small("explore-v1"), 5) == small("explore-v1")
    with pytest.raises(UsageError, match=f"4 worlds for {len(levels)} levels of arenas: expected a multiple"):
        few_arenas(task, 4)


def test_the_tasks_radio_is_stopped_by_walls_that_the_manuals_is_not():
    """By the manual's formula (3.2.4), 10^((pdo - walls WAF - cutoff) / 10 n)."""
    metres = [link_range(WALLED_RADIO, walls) for walls in range(3)]
    np.testing.assert_allclose(metres, [10 ** (9 / 20), 10 ** (3 / 20), 10 ** (-3 / 20)])
    cell = 1.2  # of the buildings, whose inner walls count twice
    assert metres[2] < cell < link_range(RadioSettings(), 5)
    for name in TEAMS:
        assert make_task(name).radio == WALLED_RADIO


def test_a_perfect_radio_is_heard_behind_all_walls_of_all_arenas():
    assert (received_power(PERFECT_RADIO, np.float32(1e5), np.arange(1000)) >= PERFECT_RADIO.cutoff).all()


def row(name, mean, half, unlinked=0.5):
    """A row with a score of mean +- half."""
    score = Interval(mean=mean, low=mean - half, high=mean + half)
    return VariantResult(name=name, score=score, seeds=(mean,), metrics={"unlinked": unlinked})


@pytest.mark.parametrize(
    ("perfect", "real", "none", "expected"),
    [
        ((56, 2), (50, 2), (44, 2), (True, True, True)),
        ((54, 1), (50, 1), (46, 1), (False, False, True)),  # 8 % is not 10 %
        ((56, 4), (50, 3), (44, 2), (False, True, True)),  # 52 to 53: the intervals overlap
        ((56, 2), (50, 3), (44, 4), (True, False, True)),
        ((56, 2), (50, 2, 0.19), (44, 2), (True, True, False)),
        ((56, np.inf), (50, np.inf), (44, np.inf), (False, False, True)),  # one seed says nothing
    ],
)
def test_the_check_asks_for_a_tenth_and_intervals_apart_and_lost_links(perfect, real, none, expected):
    rows = [row("perfect", *perfect), row("real", *real), row("none", *none)]
    assert tuple(check_results(rows).values()) == expected


def test_the_table_names_score_interval_and_metrics():
    told = table([row("real", 50.0, 2.0)]).splitlines()
    assert told[0] == "| radio | score | 95 % interval | unlinked |"
    assert told[2] == "| real | 50.0 | 48.0 to 52.0 | 0.50 |"


def test_tasks_without_a_team_have_no_such_check():
    with pytest.raises(UsageError, match="drive-to-goal is no task for a team"):
        measure("drive-to-goal", 1, range(1))


@pytest.mark.slow
@pytest.mark.parametrize("name", TEAMS)
def test_the_radio_matters(name):
    """The check itself; docs/evidence/tasks.md has its figures."""
    assert main([name, "--worlds", WORLDS[name], "--engine", "c"]) == 0
