"""Planners of explore-v3 on observations of a few known goals."""

import numpy as np
import pytest

from usarmjx.train.baselines.planners import assigned_goal, courier_goal, has_courier, meeting_goal
from usarmjx.train.evaluation.yardsticks import measure_teams
from usarmjx.train.tasks.goal_features import (
    FIRST_GOAL,
    FIRST_MASK,
    FIRST_MATE,
    GOAL_NUMBERS,
    GOALS,
    MATE_NUMBERS,
    MATES,
    OBSERVATION_SIZE,
    chosen_goal,
)

CELL = 0.3


def observation(*, seconds=100.0, news=0.0, home=20.0, frontiers=((3, 12.0), (5, 9.0)), going=0):
    """Return an observation of a way home and of frontiers straight ahead, by lengths [squares]."""
    seen = np.zeros(OBSERVATION_SIZE, np.float32)
    seen[1], seen[5] = seconds / 100.0, news / 1000.0
    goals, mask = seen[FIRST_GOAL:FIRST_MASK].reshape(GOALS, GOAL_NUMBERS), seen[FIRST_MASK:]
    for goal, length in ((0, home), *frontiers):
        goals[goal, 0], goals[goal, 2], goals[goal, 6], mask[goal] = 0.5, length / 100.0, 1.0, 1.0
    goals[going, 9] = 1.0
    return seen


def test_the_nearest_frontier_is_taken_unless_another_goes_there():
    seen = observation()
    assert chosen_goal(seen, CELL, report=False) == 5
    seen[FIRST_GOAL + 5 * GOAL_NUMBERS + 6] = 0.0  # where another one goes: 20 squares more
    assert chosen_goal(seen, CELL, report=False) == 3


def test_other_robots_are_no_frontiers_and_without_one_a_robot_goes_home():
    seen = observation(frontiers=((MATES, 1.0),))
    assert chosen_goal(seen, CELL, report=False) == 0


@pytest.mark.parametrize(
    ("facts", "home"),
    [
        ({"news": 100.0, "seconds": 60.0}, False),  # 20 squares are 6 m: 20 s at 0.3 m/s, and 8 s to spare
        ({"news": 100.0, "seconds": 27.9}, True),
        ({"news": 100.0, "seconds": 28.1}, False),
        ({"news": 20.0, "seconds": 20.0}, False),  # nothing worth the way
        ({"news": 1000.0, "seconds": 100.0}, True),
        ({"news": 100.0, "seconds": 60.0, "going": 0}, True),  # it is on its way
    ],
)
def test_news_are_brought_home_in_time(facts, home):
    seen = observation(**{"going": 5, **facts})
    assert chosen_goal(seen, CELL, report=True) == (0 if home else 5)
    assert chosen_goal(seen, CELL, report=False) == 5


@pytest.mark.parametrize(
    ("facts", "home"),
    [
        # An episode of 160 s: a meeting after 80 s, when 80 s are left; 20 s of way and 8 s to spare.
        ({"news": 100.0, "seconds": 109.0}, False),
        ({"news": 100.0, "seconds": 107.0}, True),
        ({"news": 20.0, "seconds": 107.0}, False),
        ({"news": 5000.0, "seconds": 140.0}, False),  # however much there is
        ({"news": 100.0, "seconds": 79.0}, False),  # the next one is at the end
        ({"news": 100.0, "seconds": 27.0}, True),
        ({"news": 100.0, "seconds": 79.0, "going": 0}, True),  # late for the meeting
        ({"news": 100.0, "seconds": 117.0, "going": 0}, True),  # 9 s ahead of its plan
        ({"news": 100.0, "seconds": 119.0, "going": 0}, False),
        ({"news": 100.0, "seconds": 59.0, "going": 0}, False),  # the meeting was 21 s ago
    ],
)
def test_meetings_are_kept_at_half_time_and_at_the_end(facts, home):
    seen = observation(**{"going": 5, **facts})
    seen[0] = facts["seconds"] / 160.0
    assert meeting_goal(seen, CELL) == (0 if home else 5)


def test_one_robot_carries_what_another_knows():
    """The base is 6 m ahead; the other robot goes there."""
    seen = observation(going=5, news=100.0, seconds=27.0)
    seen[0] = 27.0 / 160.0
    mate = seen[FIRST_MATE : FIRST_MATE + MATE_NUMBERS]
    mate[:3], mate[8], mate[9] = (1.0, 3.0 / 12.0, 0.0), 1.0, 0.01  # 3 m from the base; 10 squares untold
    assert has_courier(seen)
    assert meeting_goal(seen, CELL) == courier_goal(seen, CELL) == 5
    for place, value in ((0, 0.0), (1, -1.0 / 12.0), (8, 0.0), (9, 0.2)):  # none, farther, elsewhere, untold
        kept, mate[place] = mate[place], value
        assert not has_courier(seen)
        assert meeting_goal(seen, CELL) == courier_goal(seen, CELL) == 0
        mate[place] = kept


def test_frontiers_are_shared_out_and_the_cheapest_pair_comes_first():
    """Frontiers 3 and 5 straight ahead, 6 m off as all goals are: ways of 12 and 9 squares of 0.3 m."""
    seen = observation()
    assert assigned_goal(seen, CELL) == 5
    goals = seen[FIRST_GOAL:FIRST_MASK].reshape(GOALS, GOAL_NUMBERS)
    goals[3, 1] = 0.5  # 6 m to the left of 5
    mate = seen[FIRST_MATE : FIRST_MATE + MATE_NUMBERS]
    mate[:3] = 1.0, 0.5, -0.1  # 1.2 m from 5, four squares
    assert assigned_goal(seen, CELL) == 3
    mate[2] = -0.3  # 12 squares from 5, more than the robot's own 9
    assert assigned_goal(seen, CELL) == 5
    goals[3, 3] = 0.5  # much is unknown there, and neither frontier is nearer to the other robot now
    goals[5, 3] = -1.0
    assert assigned_goal(seen, CELL) == 3
    both = np.stack([seen, observation(news=1000.0)])
    assert assigned_goal(both, CELL).tolist() == [3, 0]
    alone = observation(frontiers=((5, 9.0),))
    alone[FIRST_MATE : FIRST_MATE + MATE_NUMBERS] = mate
    alone[FIRST_MATE + 2] = 0.0
    assert assigned_goal(alone, CELL) == 5, "no frontier is left for it: the nearest"


@pytest.mark.thorough
def test_a_team_that_reports_beats_a_silent_one():
    """Only the base's map counts: news have to get into its radio's reach. Mean of three buildings."""
    rows = measure_teams(
        "explore-v3", 3, teams=("frontier", "baseline"), engine="planar", split="validation", count=2
    )
    silent, reporting = (np.array(row.by_world) for row in rows)
    assert reporting.mean() > silent.mean() + 5.0
