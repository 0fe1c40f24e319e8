"""Robots that choose goals and carry the radio of a base, and the planner of their chain."""

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from tests.train.rooms import play, room
from usarmjx.train.baselines import PLANNERS
from usarmjx.train.baselines.planners import AHEAD, LOST, STRONG, chain_goal
from usarmjx.train.evaluation.yardsticks import play_team, task_to_play
from usarmjx.train.make import build_env
from usarmjx.train.tasks import TASKS
from usarmjx.train.tasks.goal_features import (
    FIRST_GOAL,
    FIRST_MASK,
    FIRST_MATE,
    GOAL_NUMBERS,
    GOALS,
    MATE_NUMBERS,
    MATES,
    OBSERVATION_SIZE,
)
from usarmjx.train.tasks.goal_team import HOLD
from usarmjx.train.tasks.relay_chain import DEEP, SIGNAL_SCALE, RelayBase

STARTS = ((0.6, 0.9), (1.8, 0.9), (3.0, 0.9))
ENDS = ((0.6, 0.9), (2.7, 1.5), (5.1, 1.5))
STEPS = 4
TASK = RelayBase(arena=room(STARTS), count=2, episode_steps=STEPS, price=0.0, hint=0.0, hold=1)
"""A base and two robots; all tests play this task, which is compiled once."""


def links(*pairs):
    """Links of the base and two robots."""
    table = np.zeros((3, 3), bool)
    for i, j in pairs:
        table[i, j] = table[j, i] = True
    return table


WHOLE, BROKEN, SHORT = links((0, 1), (1, 2)), links((1, 2)), links((0, 1))
LINKS = [WHOLE, WHOLE, SHORT, BROKEN, WHOLE]


@pytest.fixture(scope="module")
def chain():
    """Robots that drive into the room, while the chain breaks twice."""
    share = np.linspace(0.0, 1.0, STEPS + 1)[:, None, None]
    way = np.array(STARTS) + share * (np.array(ENDS) - np.array(STARTS))
    path = np.concatenate([way, np.zeros((STEPS + 1, 3, 1))], -1)
    return path, list(play(TASK, path, LINKS))


def test_the_deepest_robot_that_reaches_the_base_counts(chain):
    path, steps = chain
    depth, grid = np.asarray(steps[0][1].extra.achieved.depth), TASK.arena_grid(steps[0][0].scene)
    reaching, total = {1: (1, 2), 2: (1,), 3: (), 4: (1, 2)}, 0.0
    for k, robots in reaching.items():
        deep = [float(depth[tuple(np.asarray(grid.index(path[k, robot, :2])))]) for robot in robots]
        np.testing.assert_allclose(steps[k][2].metrics["reach"], max(deep, default=0.0), rtol=1e-5)
        total += max(deep, default=0.0)
    assert total > 0
    results = [result for _, _, result in steps[1:]]
    np.testing.assert_allclose(results[-1].score, 100 * total / STEPS, rtol=1e-5)
    rewards = np.array([np.asarray(result.reward[0]) for result in results])
    np.testing.assert_allclose(rewards.sum(0), [50 * total / STEPS] * 2, rtol=1e-5)
    series = {name: np.array([r.metrics[name] for r in results]) for name in ("reach", "contacts")}
    parts = TASK.score_parts(series)
    assert parts.keys() == TASK.most_points.keys()
    np.testing.assert_allclose(sum(parts.values()), [float(r.score) for r in results], rtol=1e-5)


def test_a_goal_is_to_stay(chain):
    """The third goal is each robot's own square, always valid; who chooses it is given no way."""
    _, steps = chain
    view, memory, _ = steps[-1]
    goals = memory.extra.goals
    gap = np.linalg.norm(np.asarray(goals.position[1:, HOLD] - memory.belief.pose[1:, :2]), axis=-1)
    assert (gap < 0.22).all()  # half a diagonal of a square of 0.3 m
    assert np.asarray(goals.valid[1:, HOLD]).all()
    wanted = (jnp.eye(GOALS)[jnp.array([HOLD, 3])],)
    after = TASK.followed(TASK.decide(view, memory, wanted))
    still = np.asarray(after.waypoint == memory.belief.pose[:, :2]).all(-1)
    assert still[1:].tolist() == [True, False]


def test_links_are_observed_as_powers_above_the_cutoff(chain):
    _, steps = chain
    view, memory, _ = steps[-1]
    power = np.zeros((3, 3), np.float32)
    power[1, 0], power[1, 2], power[2, 0] = -49.0 + 5.0, -49.0 + 30.0, -49.0 + 3.0
    world = view.world.replace(links=view.world.links.replace(power=jnp.asarray(power)))
    seen = np.asarray(TASK.observe(view.replace(world=world), memory)[0])
    assert seen.shape == (2, OBSERVATION_SIZE)
    assert seen[:, 3].tolist() == pytest.approx([5.0 / SIGNAL_SCALE, 0.0])  # the second has no link to it
    assert seen[0, FIRST_MATE + 6] == 1.0


def test_an_oracle_goes_to_the_deepest_squares(chain):
    view, memory, _ = chain[1][0]
    depth, targets = np.asarray(memory.extra.achieved.depth), np.asarray(TASK.targets(view, memory))
    assert targets.any()
    assert (depth[targets] > DEEP).all()
    assert depth.max() == 1.0


def test_one_goal_fewer_is_another_robot():
    scene = SimpleNamespace(num_robots=3, groups=())
    layout = TASK.layout(scene)
    assert layout.size == OBSERVATION_SIZE
    assert len(set(layout.kinds[:4])) == 4
    assert TASK.mate_goals == MATES - 1


def observation(*, base=0.5, contact=0.0, mate=None):
    """Return an observation of the base 6 m behind, and of two frontiers: 4 the nearer, 5 far from the base.

    Args:
        base: Signal of the base.
        contact: Time since the last contact with it [s].
        mate: Distance of another robot, towards the base [m], and its signal.
    """
    seen = np.zeros(OBSERVATION_SIZE, np.float32)
    seen[3], seen[4] = base, contact / 60.0
    goals, mask = seen[FIRST_GOAL:FIRST_MASK].reshape(GOALS, GOAL_NUMBERS), seen[FIRST_MASK:]
    goals[0, 0] = -0.5
    for goal, length, away in ((HOLD, 0.0, 6.0), (4, 10.0, 6.0), (5, 30.0, 12.0)):
        goals[goal, 2], goals[goal, 4], mask[goal] = length / 100.0, away / 30.0, 1.0
    if mate:
        row = seen[FIRST_MATE : FIRST_MATE + MATE_NUMBERS]
        row[0], row[1], row[6] = 1.0, -mate[0] / 12.0, mate[1]
    return seen


@pytest.mark.parametrize(
    ("facts", "goal"),
    [
        ({}, 5),  # 6 m farther from the base are worth 60 squares of way
        ({"base": STRONG}, HOLD),
        ({"base": 0.0}, HOLD),
        ({"base": 0.0, "mate": (1.0, 0.5)}, 5),
        ({"base": 0.0, "mate": (1.0, 0.05)}, HOLD),
        ({"base": 0.0, "mate": (0.9 * AHEAD, 0.5)}, HOLD),  # as near to the base as the robot
        ({"base": 0.0, "mate": (-1.0, 0.5)}, HOLD),  # behind it in the chain
        ({"contact": LOST + 0.1, "mate": (1.0, 0.5)}, 0),
        ({"contact": LOST - 0.1}, 5),
    ],
)
def test_a_robot_goes_on_while_it_hears_the_one_before_it(facts, goal):
    assert chain_goal(observation(**facts), 0.3) == goal


def test_without_frontiers_a_robot_stays():
    seen = observation()
    seen[FIRST_MASK + 3 :] = 0.0
    assert chain_goal(seen, 0.3) == HOLD


@pytest.mark.thorough
def test_who_relays_beats_who_does_not_even_if_he_knows_the_building():
    """Means of three small buildings: an oracle and a planner that explores, as a chain and without links."""
    small = replace(TASKS.get("relay-chain-v3").arena, sizes=((12, 10),))
    task, worlds = task_to_play(
        "relay-chain-v3", 3, "validation", physics="coarse", arena=small, episode_steps=300
    )
    for played, gain in ((replace(task, oracle=True), 15.0), (task, 8.0)):
        env = build_env(played, worlds, name="relay-chain-v3", engine="planar")
        chained, silent = (
            np.array(play_team(env, played, planner(env), "", 0).by_world).mean()
            for planner in (PLANNERS["chain"], PLANNERS["frontier"])
        )
        assert chained > silent + gain
