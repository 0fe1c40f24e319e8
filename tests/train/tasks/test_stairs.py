"""stairs: judgements of states made by hand, observations, and climbs on engine c."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import usarmjx
from tests.train.views import placed, told, view_of
from usarmjx.base.errors import UsageError
from usarmjx.train.baselines import BASELINES
from usarmjx.train.baselines.climb import climb_action, flipper_targets
from usarmjx.train.tasks.stairs import Stairs

TASK = Stairs(steps=3, rise=0.2, going=0.3, haste=0.01, bonus=2.0, price=3.0)
GROUND = 0.1


@pytest.fixture(scope="module")
def view():
    return view_of(TASK)


def begun(view):
    return TASK.start(placed(view, (-1.0, 0.0, GROUND, 0.0, 0.0, 0.0)), jax.random.key(0))


def test_stairs_have_their_edge_and_goal_where_the_steps_say():
    assert TASK.height == pytest.approx(0.6)
    assert TASK.edge == pytest.approx(0.6)
    np.testing.assert_allclose(TASK.goal, (1.4, 0.0, 0.6))
    tops = [shape.at[2] + shape.size[2] for shape in TASK.arenas.shapes]
    faces = [shape.at[0] - shape.size[0] for shape in TASK.arenas.shapes]
    np.testing.assert_allclose(tops, (0.2, 0.4, 0.6))
    np.testing.assert_allclose(faces, (0.0, 0.3, 0.6), atol=1e-9)
    with pytest.raises(UsageError, match="steps is 0, expected a whole number from 1"):
        Stairs(steps=0).arenas  # noqa: B018 - it raises
    with pytest.raises(UsageError, match="a AirRobot on stairs"):
        Stairs(robot="AirRobot").robots  # noqa: B018 - it raises


@pytest.mark.parametrize(
    ("pose", "score", "there", "fallen"),
    [
        ((-0.5, 0.0, GROUND, 0.0, 0.0, 0.0), 0.0, False, False),
        ((0.3, 0.0, GROUND + 0.3, 0.0, -0.6, 0.0), 45.0, False, False),
        ((0.9, 0.0, GROUND + 0.6, 0.0, 0.0, 0.0), 90.0, False, False),  # not 0.4 m beyond the edge
        ((1.1, 0.0, GROUND + 0.6, 0.0, 0.0, 0.0), 100.0, True, False),
        ((1.1, 0.0, GROUND + 0.56, 0.0, 0.0, 0.0), 100.0, True, False),
        ((1.1, 0.0, GROUND + 0.54, 0.0, 0.0, 0.0), 81.0, False, False),
        ((1.1, 0.0, GROUND + 0.6, 0.0, -0.35, 0.0), 90.0, False, False),  # 20 degrees
        ((0.3, 0.0, GROUND + 0.3, 1.3, 0.0, 0.0), 45.0, False, True),  # cos 1.3 = 0.27
    ],
)
def test_height_arrival_and_falls(view, pose, score, there, fallen):
    before = begun(view)
    after, reward, terminated, points, _ = TASK.evaluate(placed(view, pose), before)
    assert float(points) == pytest.approx(score, abs=1e-3)
    assert bool(terminated) is (there or fallen)
    goal = (1.4, 0.0, 0.6 + GROUND)
    nearer = math.dist((-1.0, 0.0, GROUND), goal) - math.dist(pose[:3], goal)
    assert float(reward[0][0]) == pytest.approx(nearer - 0.01 + 2.0 * there - 3.0 * fallen, abs=1e-4)
    assert float(after.distance) == pytest.approx(math.dist(pose[:3], goal), abs=1e-5)


def test_what_was_climbed_stays_climbed(view):
    up, down = ((0.3, 0.0, GROUND + z, 0.0, 0.0, 0.0) for z in (0.4, 0.1))
    memory = TASK.evaluate(placed(view, up), begun(view)).memory
    assert float(TASK.evaluate(placed(view, down), memory).score) == pytest.approx(60.0, abs=1e-3)


def test_it_sees_goal_attitude_and_flippers_by_its_sensors(view):
    """2 m before the goal by the INS, 0.5 m below its height, nose 0.3 rad up (MuJoCo's pitch is down)."""
    pose = [-0.6, 0.0, GROUND + 0.1, 0.05, -0.3, 0.0]
    here = told(view, INS=[pose], Encoder=[[60.0, -24.0]], RangeScanner=[np.arange(8) / 4])
    (seen,) = TASK.observe(here, begun(view))
    expected = [1.0, 0.0, 0.2, 1.0, 0.5, 0.05, 0.3, 0.5, 0.2, *(np.arange(8) / 8)]
    np.testing.assert_allclose(seen[0], expected, atol=1e-5)


def test_the_baseline_steers_to_the_goal_and_presses_its_flippers_on_stairs():
    ahead = jnp.array([1.0, 0.0, 0.2, 1.0, 0.5, 0.0, 0.0])
    np.testing.assert_allclose(climb_action(ahead, 0.8), (0.8, 0.8))
    left, right = climb_action(ahead.at[:2].set((math.cos(0.2), math.sin(0.2))), 0.8)
    assert (float(left), float(right)) == pytest.approx((0.8 * 0.7, 0.8), abs=1e-5)
    np.testing.assert_allclose(flipper_targets(ahead, 0.2), (0.5, 0.0))
    np.testing.assert_allclose(flipper_targets(ahead.at[6].set(0.5), 0.24), (-0.2, -0.2), atol=1e-6)


@pytest.fixture(scope="module")
def climbed():
    """A Kenaf climbs six steps of 35 degrees in each of two worlds; two stay where they are."""
    env = usarmjx.make("stairs", worlds=4, engine="c", episode_steps=130)
    policy = BASELINES.get("stairs")(env)
    act, go = jax.jit(policy.act), np.array([1.0, 1.0, 0.0, 0.0])[:, None, None]
    state, first, flipped = env.reset(0), np.full(4, np.nan), 0.0
    for step in range(130):
        _, actions = act((), state.obs, jax.random.key(0))
        state = env.step(state, (go * actions[0],))
        ended = np.asarray(state.done) & np.isnan(first)
        first = np.where(ended, np.asarray(state.final_score), first)
        if step == 10:
            flipped = np.asarray(state.obs[0])[:, 0, 7]
    return env, first, flipped, np.asarray(state.bad)


@pytest.mark.thorough
def test_the_baseline_climbs_the_stairs(climbed):
    _, first, _, bad = climbed
    assert not bad.any()
    np.testing.assert_allclose(first[:2], 100.0, atol=1e-4)
    assert (first[2:] < 1.0).all(), "who does nothing climbs nothing"


@pytest.mark.thorough
def test_encoders_tell_where_the_flippers_are(climbed):
    """0.6 rad up were told, half of 1.2; a tick is 0.01 rad, and the motors hold to some of that."""
    _, _, flipped, _ = climbed
    np.testing.assert_allclose(flipped[:2], 0.5, atol=0.03)
    np.testing.assert_allclose(flipped[2:], 0.0, atol=0.03)


def test_robots_without_flippers_have_their_tracks_only():
    task = Stairs(robot="Talon")
    scene = task.scene()
    assert task.action_sizes(scene) == (2,)
    here = told(view_of(task, scene), INS=np.zeros((1, 6)), RangeScanner=np.zeros((1, 8)))
    assert task.observe(here, task.start(here, jax.random.key(0)))[0].shape == (1, 4 + 3 + 8)
