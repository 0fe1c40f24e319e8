"""Robots of explore-v3: whose part of the news is whose, and what goals and mates are worth to them."""

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.base.errors import SpecError
from usarmjx.train.mapping.belief import initial_belief
from usarmjx.train.mapping.maps import MapGrid
from usarmjx.train.mapping.planning import Goals
from usarmjx.train.tasks import TASKS
from usarmjx.train.tasks.goal_features import (
    CHANNELS,
    FIRST_MATE,
    GOAL_NUMBERS,
    GOALS,
    LEVELS,
    MATE_NUMBERS,
    MATES,
    OBSERVATION_SIZE,
    OBSERVED_MATES,
    WIDTH,
    GoalView,
    first_mates,
    goal_features,
    mate_features,
    nearest_mates,
)
from usarmjx.train.tasks.reporting_team import ExploreBase

TASK = TASKS.get("explore-v3")
GRID = MapGrid(low=(0.0, 0.0), cell=0.3, shape=(40, 40))
POSES = jnp.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [6.0, 0.0, 0.0]])
"""The base, and two robots that look along x."""


def scene_of(robots):
    """A base in slot 0, and robots."""
    base, agents = SimpleNamespace(name="ComStation"), SimpleNamespace(name="P2AT")
    groups = (
        SimpleNamespace(robot=base, slots=[0]),
        SimpleNamespace(robot=agents, slots=range(1, 1 + robots)),
    )
    return SimpleNamespace(num_robots=1 + robots, groups=groups)


def test_squares_belong_to_those_that_saw_them():
    """A to the first robot, B to two, C to the second, D to nobody; the third, who knows all, saw none."""
    evidence = np.zeros((4, 1, 5), np.int8)
    evidence[1, 0, [0, 1]] = evidence[2, 0, [1, 2]] = -2
    evidence[3] = 3  # it takes them for walls
    memory = SimpleNamespace(belief=SimpleNamespace(evidence=jnp.asarray(evidence)))
    news = jnp.asarray([[True, True, True, True, False]])
    assert isinstance(TASK, ExploreBase)
    parts = np.asarray(TASK.finders(SimpleNamespace(scene=scene_of(3)), memory, news))
    assert parts.tolist() == pytest.approx([0.0, 1.5 + 1 / 3, 1.5 + 1 / 3, 1 / 3])
    for found in (0.0, 0.25, 1.0):
        task = replace(TASK, found=found)
        shares = np.asarray(task.shares(SimpleNamespace(scene=scene_of(3)), memory, news))[1:]
        assert shares.tolist() == pytest.approx(((1 - found) * 4 / 3 + found * parts[1:]).tolist()), found
        assert shares.sum() == pytest.approx(4.0), "no square counts twice"


def test_goals_say_what_is_news_there_and_how_much_time_is_left_after_them():
    belief = initial_belief(GRID, POSES)
    position = jnp.zeros((3, GOALS, 2)).at[:, 0].set(POSES[0, :2]).at[:, 4].set(jnp.array([3.0, 3.0]))
    goals = Goals(
        position=position,
        length=jnp.full((3, GOALS), 1e6).at[:, 0].set(10.0).at[:, 4].set(20.0),
        gain=jnp.zeros((3, GOALS)),
        valid=jnp.zeros((3, GOALS), bool).at[:, jnp.array([0, 1, 4])].set(True),
    )
    untold = jnp.array([[0.0, 0.0, 0.0], [500.0, 0.0, 200.0], [0.0, 0.0, 0.0]])
    mates = nearest_mates(belief, 0, 0.0, MATES)
    judged = GoalView(base=0, time=0.0, seconds=80.0, untold=untold, mates=mates)
    found = np.asarray(goal_features(GRID, belief, goals, jnp.zeros(3, jnp.int32), judged))
    first = found.reshape(3, GOALS, GOAL_NUMBERS)[1]
    # Base, the other robot, a frontier: news in thousands.
    assert first[[0, 1, 4], 10].tolist() == pytest.approx([0.5, 0.2, 0.0])
    # 10 squares are 3 m, 10 s; 20 squares and sqrt(18) m from the base.
    assert first[0, 11] == pytest.approx((80 - 10) / 100)
    assert first[4, 11] == pytest.approx((80 - (6 + 18**0.5) / 0.3) / 100, rel=1e-5)
    assert (first[2] == 0).all()


def test_others_say_whether_they_go_home_and_what_they_have_not_heard():
    belief = initial_belief(GRID, POSES)
    heads = belief.mate_headers.at[1, 2, 3:5].set(jnp.array([0.9, 0.0]))  # 0.9 m from the base
    untold = jnp.zeros((3, 3)).at[1, 2].set(300.0)
    no_links = jnp.zeros((3, 3), bool)
    mates = nearest_mates(belief, 0, 1.0, OBSERVED_MATES)
    judged = GoalView(base=0, time=1.0, seconds=80.0, untold=untold, mates=first_mates(mates, MATES))
    seen = np.asarray(mate_features(belief.replace(mate_headers=heads), mates, no_links, judged))
    row = seen.reshape(3, OBSERVED_MATES, MATE_NUMBERS)[1, 0]
    assert row[0] == 1.0
    assert row[1:3].tolist() == pytest.approx([3.0 / 12.0, 0.0])
    assert row[8:].tolist() == pytest.approx([1.0, 0.3])
    away = np.asarray(mate_features(belief, mates, no_links, judged))
    assert away.reshape(3, OBSERVED_MATES, MATE_NUMBERS)[1, 0, 8] == 0.0


def test_the_layout_has_the_places_of_the_observation():
    layout = TASK.layout(scene_of(4))
    assert layout.size == OBSERVATION_SIZE
    assert layout.others_span.first == FIRST_MATE
    pictured = ExploreBase(observed="map")
    picture = LEVELS * WIDTH * WIDTH * len(CHANNELS)
    assert pictured.layout(scene_of(4)).size == OBSERVATION_SIZE + picture
    assert ExploreBase(actions="wheels").layout(scene_of(4)) is None
    with pytest.raises(SpecError, match="robots see no picture"):
        ExploreBase(observed="map", actions="wheels")
