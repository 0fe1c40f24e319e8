"""Ablations hide what they name, and compare in the same buildings."""

import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.base.estimates import estimate_groups
from usarmjx.train.envs.task import Policy
from usarmjx.train.evaluation.ablation import (
    ABLATIONS,
    MAP_SIZE,
    MATES,
    ablation_row,
    ablation_table,
    hidden_policy,
)
from usarmjx.train.evaluation.yardsticks import TeamResult
from usarmjx.train.tasks.explore import Explore
from usarmjx.train.tasks.team import PERFECT_RADIO

OTHERS = 3
SIZE = MATES + 4 * OTHERS + 2 * MAP_SIZE + 2
"""Two numbers more, as `relay-chain` has."""


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
