"""drive-to-goal and wander: rewards, ends and scores in states made by hand."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.train.scenes.test_clearance import HALF_LENGTH, solid, view_of
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.base import Reading
from usarmjx.train.tasks.drive_to_goal import DriveToGoal, GoalMemory, goal_observation
from usarmjx.train.tasks.team import range_lines, reduce_to_sectors
from usarmjx.train.tasks.wander import Wander

GOAL = DriveToGoal(haste=0.02, bonus=2.0, radius=0.5)


def at(view, x, y):
    """The same view with the robot elsewhere."""
    address = view.scene.groups[0].root_qposadr[0, :2]
    return view.replace(physics=view.physics.replace(qpos=view.physics.qpos.at[address].set((x, y))))


@pytest.fixture(scope="module")
def view():
    return view_of(solid("box", (0.05, 1.0, 0.5), (1.0, 0.0, 0.5)))


def test_progress_is_rewarded_by_the_metre_less_haste(view):
    memory = GoalMemory(goal=jnp.array([3.0, 4.0]), distance=jnp.float32(5.5))
    after, reward, terminated, score, metrics = GOAL.evaluate(view, memory)
    assert float(after.distance) == pytest.approx(5.0)
    assert float(reward[0][0]) == pytest.approx(0.5 - 0.02)
    assert not bool(terminated)
    assert float(score) == 0.0
    assert float(metrics["distance"]) == pytest.approx(5.0)


def test_within_the_radius_the_episode_ends_with_a_bonus_and_score_one(view):
    memory = GoalMemory(goal=jnp.array([3.0, 4.0]), distance=jnp.float32(0.7))
    inside, outside = (GOAL.evaluate(at(view, 3.0, 4.0 - d), memory) for d in (0.49, 0.51))
    assert bool(inside.terminated)
    assert float(inside.score) == 1.0
    assert float(inside.reward[0][0]) == pytest.approx(0.7 - 0.49 + 2.0 - 0.02, abs=1e-5)
    assert not bool(outside.terminated)
    assert float(outside.score) == 0.0


def test_goals_are_start_poses_that_are_far_enough(view):
    """Of (0, 0) and (5, 0) only the second is 2 m from the origin; from between, the farther one is."""
    for key in range(4):
        np.testing.assert_array_equal(GOAL.start(view, jax.random.key(key)).goal, (5.0, 0.0))
    near = replace(GOAL, nearest=50.0).start(at(view, 4.0, 0.0), jax.random.key(0))
    np.testing.assert_array_equal(near.goal, (0.0, 0.0))
    assert float(near.distance) == pytest.approx(4.0)
    drawn = {tuple(GOAL.start(at(view, 2.5, 0.0), jax.random.key(key)).goal.tolist()) for key in range(12)}
    assert drawn == {(0.0, 0.0), (5.0, 0.0)}


def test_the_goal_is_seen_from_the_pose_that_the_sensor_tells():
    """2 m away and 90 degrees to the left of a robot that looks along y; then 30 m behind it."""
    left = goal_observation(jnp.array([1.0, 1.0, 0.2, 0.0, 0.0, math.pi / 2]), jnp.array([-1.0, 1.0]))
    np.testing.assert_allclose(left, (0.0, 1.0, 0.2, 1.0), atol=1e-6)
    behind = goal_observation(jnp.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0]), jnp.array([-30.0, 0.0]))
    np.testing.assert_allclose(behind, (-1.0, 0.0, 1.0, 1.0), atol=1e-6)


def test_observations_hold_the_sensor_not_the_truth(view):
    wrong = jnp.array([[9.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    sonar = jnp.full((1, 16), 2.5)
    suite = view.scene.groups[0].suite
    values = {suite.index("INS"): wrong, suite.index("Sonar"): sonar}
    readings = tuple(Reading(value=values.get(i), fresh=None) for i in range(len(suite.sensors)))
    memory = GoalMemory(goal=jnp.array([10.0, 0.0]), distance=jnp.float32(10.0))
    (seen,) = GOAL.observe(view.replace(readings=(readings,)), memory)
    np.testing.assert_allclose(seen[0], [1, 0, 0.1, 1, *[0.5] * 16], atol=1e-6)


def test_many_beams_are_seen_in_sectors():
    beams = jnp.arange(181.0)
    # 8 beams each, the last sector has 5.
    np.testing.assert_array_equal(reduce_to_sectors(beams), np.arange(0, 181, 8))
    np.testing.assert_array_equal(reduce_to_sectors(beams[:24]), beams[:24])


def test_ranges_know_along_which_lines_they_are():
    """Manual 12.1.1: F1 looks left, F8 right, R1 right; a scan runs from right to left."""
    origin, angle = range_lines(ROBOTS.get("P2AT"), ("Sonar",))
    degrees = [90, 50, 30, 10, -10, -30, -50, -90]
    np.testing.assert_allclose(np.degrees(angle[:8]), degrees, atol=0.1)
    np.testing.assert_allclose(np.degrees(angle[8]) % 360, 270, atol=0.1)
    np.testing.assert_allclose(origin[0], (0.145, 0.13), atol=1e-6)
    _, scan = range_lines(ROBOTS.get("P2AT"), ("RangeScanner",))
    np.testing.assert_allclose(np.degrees(scan[:2]), (-86, -78), atol=0.1)
    assert len(scan) == 23
    assert len(range_lines(ROBOTS.get("AirRobot"), ("Sonar",))[1]) == 0


def test_new_squares_are_counted_once(view):
    task = Wander(square=2.0)
    memory = task.start(view, jax.random.key(0))
    assert memory.visited.shape == (9, 9)
    scores = []
    for x, y in ((0.5, 0.5), (-1.5, 0.0), (0.5, 0.0), (-3.5, 0.0)):
        memory, reward, terminated, score, _ = task.evaluate(at(view, x, y), memory)
        scores.append((float(reward[0][0]), float(score), bool(terminated)))
    # Squares begin at -9: (0, 0) and (0.5, 0.5) are in the same one.
    assert scores == [(0.0, 0.0, False), (1.0, 1.0, False), (0.0, 1.0, False), (1.0, 2.0, False)]
    memory, reward, _, score, _ = task.evaluate(at(view, 50.0, 0.0), memory)
    assert (float(reward[0][0]), float(score)) == (0.0, 2.0), "outside of the arena nothing counts"


def test_a_contact_ends_the_episode(view):
    task = Wander(touch=0.01, price=5.0, square=20.0)
    memory = task.start(view, jax.random.key(0))
    for gap, touched in ((0.02, False), (0.005, True), (-0.1, True)):
        result = task.evaluate(at(view, 0.95 - HALF_LENGTH - gap, 0.0), memory)
        assert bool(result.terminated) == touched
        assert float(result.metrics["touched"]) == touched
        expected = -5.0 * touched
        assert float(result.reward[0][0]) == expected
        assert float(result.score) == 0.0
