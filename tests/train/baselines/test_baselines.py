"""Hand-written policies, and how policies are evaluated."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import usarmjx
from tests.train.envs.test_env import LIGHT
from tests.train.toys import LineToy
from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.models.robots import ROBOTS
from usarmjx.train.baselines import BASELINES
from usarmjx.train.baselines.driving import BugCarry, bug_action, driver, roam_action
from usarmjx.train.envs.task import Policy
from usarmjx.train.evaluation.evaluate import Episodes, evaluate_episodes, evaluation_of, run_episodes
from usarmjx.train.evaluation.radio_matters import interval

SONAR = ("Sonar",)
AHEAD = BugCarry(side=jnp.zeros(()), best=jnp.zeros(()))


def seen(angle, distance=5.0, **near):
    """An observation of a goal, with some of 16 sonars nearer than 5 m."""
    ranges = np.ones(16)
    for name, value in near.items():
        ranges[int(name[1:]) - 1 + 8 * (name[0] == "R")] = value / 5.0
    return jnp.array([np.cos(angle), np.sin(angle), distance / 10, min(distance, 1.0), *ranges])


def test_drivers_turn_left_for_a_positive_turn():
    for name, key_left in (("P2AT", 1), ("Talon", 1)):
        left = driver(ROBOTS.get(name))(jnp.float32(0.0), jnp.float32(1.0))
        assert left[key_left] > 0 > left[0], "the right side forward, the left one backward"
    car = driver(ROBOTS.get("Hummer"))(jnp.float32(1.0), jnp.float32(0.5))
    assert car.shape == (2,)
    assert car[1] == 0.5
    copter = driver(ROBOTS.get("AirRobot"))(jnp.float32(1.0), jnp.float32(1.0))
    assert copter[3] == -1.0, "rotational velocity is clockwise"
    with pytest.raises(UsageError, match="no hand-written policy drives a Submarine"):
        driver(ROBOTS.get("Submarine"))


def test_it_goes_straight_turns_to_the_goal_and_around_what_is_ahead():
    robot = ROBOTS.get("P2AT")
    memory, straight = bug_action(robot, SONAR, AHEAD, seen(0.0))
    assert float(straight[0]) == pytest.approx(float(straight[1]), abs=0.1)
    assert float(straight.min()) > 0.8
    assert float(memory.side) == 0.0
    _, left = bug_action(robot, SONAR, AHEAD, seen(1.5))
    assert float(left[1]) > 0 > float(left[0])
    wall = {f"F{i}": 0.2 for i in range(2, 8)}
    along, turned = bug_action(robot, SONAR, AHEAD, seen(0.0, **wall))
    assert float(along.side) != 0.0, "it follows the wall"
    assert float(jnp.abs(turned[1] - turned[0])) > 0.3, "it turns away"


def test_it_wanders_off_walls_and_turns_where_the_way_ends():
    robot, drives = ROBOTS.get("P2AT"), jnp.zeros(())
    free = seen(0.0)[4:]
    _, straight = roam_action(robot, SONAR, drives, free)
    np.testing.assert_allclose(straight, 1.0, atol=0.01)
    _, off = roam_action(robot, SONAR, drives, free.at[0].set(0.3 / 5))  # something 0.3 m to the left of F1
    assert float(off[0]) > float(off[1]) + 0.1, "it turns to the right"
    ended = jnp.full(16, 0.2 / 5).at[7:9].set(0.5)  # open to the right only: F8 and R1
    turning, spot = roam_action(robot, SONAR, drives, ended)
    assert float(turning) == -1.0
    assert float(spot[0]) > 0 > float(spot[1])
    # It goes on turning that way until the way is free for longer than where it began to.
    barely = free.at[3:5].set(0.3 / 5)
    assert float(roam_action(robot, SONAR, jnp.float32(1.0), barely)[0]) == 1.0
    assert float(roam_action(robot, SONAR, drives, barely)[0]) == 0.0


@pytest.mark.thorough
def test_the_baseline_reaches_its_goals_on_an_empty_floor():
    """11 m at 0.7 m/s take 80 of the 150 steps, half a turn on the spot 10."""
    settings = {**LIGHT, "repeat": 4, "pose": "GroundTruth", "episode_steps": 150}
    env = usarmjx.make("drive-to-goal", worlds=16, engine="c", **settings)
    came = run_episodes(env, BASELINES.get("drive-to-goal")(env), 32)
    assert came.bad == 0
    assert len(came.scores) == 32
    assert came.scores.mean() >= 0.95


def test_baselines_are_for_their_own_tasks():
    env = usarmjx.make("wander", engine="c", arena="floor", ranges=())
    with pytest.raises(UsageError, match="not of wander"):
        BASELINES.get("drive-to-goal")(env)
    with pytest.raises(UnknownNameError, match=r"known: .*drive-to-goal"):
        BASELINES.get("chess")


def test_a_mean_comes_with_its_interval():
    """Of 1, 2, 3, 4: standard error 0.6455, Student's t for 3 degrees of freedom 3.1824 (tables)."""
    found = interval(np.array([1.0, 2.0, 3.0, 4.0]))
    assert found.mean == 2.5
    assert found.high - found.mean == pytest.approx(0.6455 * 3.1824, rel=1e-3)
    assert found.mean - found.low == pytest.approx(0.6455 * 3.1824, rel=1e-3)
    assert interval(np.ones(1)).high == np.inf
    with pytest.raises(UsageError, match="no episode ended well"):
        interval(np.zeros(0))


def push(share):
    return Policy(
        initial_carry=lambda worlds: jnp.zeros(worlds),
        act=lambda memory, obs, key: (memory + 1, (jnp.full((*obs[0].shape[:2], 2), share),)),
    )


PUSH = 0.93


def way(number):
    """Score and steps of a toy world's first episode, pushed by a tenth of `PUSH` a step."""
    places, x = [], (number + 1) / 8
    while len(places) < 6 and (not places or places[-1] <= 1.5):
        places.append(x + 0.1 * PUSH * (len(places) + 1))
    return sum(places), len(places)


def test_short_episodes_count_no_more_often_than_long_ones():
    """Worlds 10 and 11 are done after one or two steps, the others after six."""
    env = LineToy(worlds=12, robots=1, mixed=False)
    came = run_episodes(env, push(PUSH), 12)
    expected = [way(number) for number in range(12)]
    assert sorted(came.lengths) == sorted(steps for _, steps in expected)
    np.testing.assert_allclose(sorted(came.scores), sorted(score for score, _ in expected), rtol=1e-5)
    assert min(came.lengths) < 3


def played(seed, *scores):
    none = np.zeros(len(scores), int)
    return Episodes(seed=seed, scores=np.array(scores), lengths=none, worlds=none, episode_index=none, bad=0)


def test_a_share_stays_between_0_and_1():
    """Wilson's interval of 0 and of 1 of 10 (tables); of means that are no shares, Student's."""
    none = evaluation_of([played(0, *[0.0] * 10)]).score
    assert (none.low, none.high) == (pytest.approx(0.0), pytest.approx(0.2775, abs=1e-4))
    one = evaluation_of([played(0, *[1.0] * 9, 0.0)]).score
    assert (one.method, one.low, one.high) == (
        "Wilson",
        pytest.approx(0.5958, abs=1e-4),
        pytest.approx(0.9821, abs=1e-4),
    )
    spread = evaluation_of([played(0, *range(100))]).score
    assert spread.method == "crossed"
    assert spread.high - spread.low == pytest.approx(2 * 1.96 * np.std(range(100)) / 10, rel=0.1)


def test_visits_of_one_building_are_drawn_together():
    """Five seeds in the same 6 buildings that differ by level: Student's interval of 6 means, less levels."""
    draw = np.random.default_rng(0)
    levels = np.repeat([0, 1], 3)
    means = 50.0 * levels + draw.normal(0.0, 5.0, 6)
    runs = [replace(played(seed, *means), buildings=np.arange(6), levels=levels) for seed in range(5)]
    found = evaluation_of(runs).score
    rest = means - np.repeat([means[:3].mean(), means[3:].mean()], 3)
    error = np.sqrt((rest**2).sum() / (6 - 2) / 6)
    assert found.count == 30
    assert found.drawn("buildings") == 6
    half = stats.t.ppf(0.975, 4) * error
    np.testing.assert_allclose([found.low, found.high], [means.mean() - half, means.mean() + half], rtol=1e-9)


def test_one_odd_seed_hardly_moves_the_interquartile_mean():
    found = evaluation_of([played(seed, score) for seed, score in enumerate((10.0, 11.0, 12.0, 900.0))])
    assert found.over_seeds.value == 11.5
    assert found.score.value == 233.25
    with pytest.raises(UsageError, match="no episode ended well"):
        evaluation_of([played(0, 1.0), played(1)])


def test_several_seeds_give_a_row_each_and_all_their_episodes_together():
    env = LineToy(worlds=2, robots=1, mixed=False)
    result = evaluate_episodes(env, push(PUSH), 2, seeds=(0, 1, 2))
    means = [np.mean([way(seed)[0], way(seed + 1)[0]]) for seed in range(3)]
    np.testing.assert_allclose([row.value for row in result.seed_scores], means, rtol=1e-5)
    assert [run.seed for run in result.episodes] == [0, 1, 2]
    assert result.score.value == pytest.approx(np.mean(means), rel=1e-5)
    assert (result.score.count, result.over_seeds.count) == (6, 3)
    with pytest.raises(UsageError, match="at least one seed"):
        evaluate_episodes(env, push(PUSH), 2, seeds=())
    with pytest.raises(UsageError, match="0 episodes"):
        run_episodes(env, push(PUSH), 0)
