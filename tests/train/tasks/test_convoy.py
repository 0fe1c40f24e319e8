"""convoy: lanes, judgements of states made by hand, pure pursuit, and a drive on engine c."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import usarmjx
from tests.train.views import placed, told, view_of
from usarmjx.base.errors import SpecError, UsageError
from usarmjx.models.arenas.arda import NETWORK, ORIGIN
from usarmjx.train.baselines import BASELINES
from usarmjx.train.baselines.pursuit import pursuit_action
from usarmjx.train.tasks.convoy import AHEAD, Convoy, ConvoyMemory, LanePath, closed_lane

SQUARE = LanePath(points=np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]), width=4.0)
STEPS = 80
TASK = Convoy(count=2, episode_steps=STEPS)
LENGTH, WIDTH = 4.2779, 1.7883  # manual 12.7.1
PERIOD = 0.1  # 5 control steps of 20 ms


@pytest.fixture(scope="module")
def view():
    return view_of(TASK)


def on_lane(along, left=0.0):
    """Pose of a car in TASK's lane."""
    (x, y), yaw = (
        np.asarray(TASK.path.position(np.float32(along))),
        float(TASK.path.heading(np.float32(along))),
    )
    return (float(x) - left * math.sin(yaw), float(y) + left * math.cos(yaw), 0.66, 0.0, 0.0, yaw)


def test_places_along_a_square():
    np.testing.assert_allclose(
        SQUARE.position(jnp.array([3.0, 12.0, 39.0, 43.0])), [(3, 0), (10, 2), (0, 1), (3, 0)]
    )
    np.testing.assert_allclose(SQUARE.heading(jnp.array([3.0, 12.0, -1.0])), [0, math.pi / 2, -math.pi / 2])
    along, left = SQUARE.nearest(jnp.array([(3.0, 1.0), (3.0, -2.0), (11.0, 5.0), (1.0, 8.0)]))
    np.testing.assert_allclose(along, [3, 3, 15, 32], atol=1e-5)
    np.testing.assert_allclose(left, [1, -2, -1, 1], atol=1e-5)
    assert SQUARE.length == 40.0


def test_lane_1_1_has_the_length_of_its_straights_and_chords():
    """Half a lane inside of the loop: straights of 90 and 60 m, four curves of 4 chords each."""
    way = closed_lane(NETWORK, (1, 1), ORIGIN)
    chords = 16 * 2 * (15.0 - 6 * 0.3048) * math.sin(math.radians(22.5) / 2)
    assert way.length == pytest.approx(2 * 90 + 2 * 60 + chords, abs=0.02), "degrees are rounded to 1 mm"
    assert way.width == pytest.approx(12 * 0.3048)


def test_only_lanes_that_close_in_arenas_that_have_a_place():
    with pytest.raises(SpecError, match=r"lane 2\.1 ends"):
        closed_lane(NETWORK, (2, 1), ORIGIN)
    with pytest.raises(SpecError, match="no latitude"):
        closed_lane(NETWORK, (1, 1), None)
    with pytest.raises(UsageError, match="a P2AT in a convoy"):
        Convoy(robot="P2AT").robots  # noqa: B018 - it raises


def moved(view, along, left=(0.0, 0.0), speed=4.0):
    """StepResult on two cars at such places that came there at some speed; the first one leads."""
    memory = ConvoyMemory(
        target_speed=jnp.float32(4.0),
        ahead=jnp.array([-1, 0]),
        arc_length=jnp.array(along) - PERIOD * speed,
        poses=jnp.zeros((2, 6)),
        speeds=jnp.zeros(2),
        score=jnp.float32(50.0),
    )
    here = placed(view, *(on_lane(a, b) for a, b in zip(along, left, strict=True)))
    return TASK.evaluate(told(here, INS=np.zeros((2, 6))), memory)


# Wanted at 4 m/s: 3 m and 1 s, so 7 m.
@pytest.mark.parametrize(
    ("gap", "left", "speed", "worth"),
    [
        (7.0, (0.0, 0.0), 4.0, (1.0, 1.0)),
        (7.0, (0.9, -0.9), 4.0, (1.0, 1.0)),  # (3.658 - 1.788) / 2 = 0.935 m
        (7.0, (0.96, 0.0), 4.0, (0.0, 1.0)),
        (3.5, (0.0, 0.0), 4.0, (1.0, 0.5)),
        (10.5, (0.0, 0.0), 4.0, (1.0, 0.5)),
        (20.0, (0.0, 0.0), 4.0, (1.0, 0.0)),
        (5.0, (0.0, 0.0), 2.0, (0.5, 0.5)),
        (7.0, (0.0, 0.0), 6.0, (1.0, 1 - 2 / 9)),
        (3.0, (0.0, 0.0), -2.0, (0.0, 0.0)),
    ],
)
def test_what_a_step_is_worth(view, gap, left, speed, worth):
    along = (30.0 + LENGTH + gap, 30.0)
    result = moved(view, along, left, speed)
    np.testing.assert_allclose(result.reward[0], 100.0 * np.array(worth) / STEPS, atol=2e-4)
    assert float(result.score) == pytest.approx(50.0 + 100.0 * np.mean(worth) / STEPS, abs=2e-4)
    assert not bool(result.terminated)


def test_running_into_the_car_ahead_or_off_the_road_ends_the_episode(view):
    rear = moved(view, (30.0 + LENGTH - 0.01, 30.0))
    assert bool(rear.terminated)
    np.testing.assert_allclose(rear.reward[0], [100.0 / STEPS, -5.0], atol=2e-4)
    for left, lost in ((3.6, False), (3.7, True)):
        assert bool(moved(view, (60.0, 30.0), (-left, 0.0)).terminated) is lost, "the lane is 3.66 m wide"


def test_progress_goes_on_past_the_end_of_the_lane(view):
    length = TASK.path.length
    result = moved(view, (length + 0.1 + LENGTH + 7.0, length + 0.1))
    np.testing.assert_allclose(result.reward[0], 100.0 / STEPS, atol=2e-4)
    assert float(result.memory.arc_length[1]) == pytest.approx(length + 0.1, abs=1e-3)


def test_who_follows_whom_is_seen_from_their_places(view):
    here = told(placed(view, on_lane(20.0), on_lane(40.0)), INS=np.zeros((2, 6)))
    assert TASK.start(here, jax.random.key(0)).ahead.tolist() == [1, -1]


def test_a_car_sees_the_lane_by_its_ins_and_not_by_the_truth(view):
    """It is truly elsewhere; the INS says 0.5 m to the left of a straight piece and 0.1 rad off."""
    x, y, z, _, _, yaw = on_lane(60.0, 0.5)
    pose = [x, y, z, 0.0, 0.0, yaw + 0.1]
    scans = np.stack([np.full(13, 20.0), np.full(13, 5.0)])
    memory = TASK.start(told(view, INS=np.zeros((2, 6))), jax.random.key(0))
    memory = memory.replace(target_speed=jnp.float32(5.0), speeds=jnp.array([2.0, 0.0]))
    (seen,) = TASK.observe(told(view, INS=[pose, pose], RangeScanner=scans), memory)
    expected = [0.25, math.sin(0.1), math.cos(0.1), 0.2, 0.5]
    np.testing.assert_allclose(seen[0, :5], expected, atol=1e-4)
    ahead = [(a * math.cos(0.1) - 0.5 * math.sin(0.1)) / 20 for a in AHEAD]
    aside = [(-a * math.sin(0.1) - 0.5 * math.cos(0.1)) / 20 for a in AHEAD]
    np.testing.assert_allclose(seen[0, 5:17], np.stack([ahead, aside], -1).ravel(), atol=1e-4)
    np.testing.assert_allclose(seen[:, 17:], scans / 20)


def seen(bend=0.0, gap=20.0, speed=0.5):
    """What a car observes that is on a lane which bends to the left, at a share of 10 m/s; 0.4 is told."""
    angle = np.array(AHEAD) * bend
    points = np.stack([np.sin(angle) / bend, (1 - np.cos(angle)) / bend], -1) if bend else np.zeros((6, 2))
    points[:, 0] = points[:, 0] if bend else AHEAD
    scan = np.ones(13)
    scan[6] = gap / 20.0
    return jnp.array([0.0, 0.0, 1.0, speed, 0.4, *(points / 20.0).ravel(), *scan])


def test_pure_pursuit_of_a_circle_steers_the_bicycle_of_that_circle():
    """tan(steer) = wheel base / radius, for a point that is on the circle: 3 m and 0.6 s ahead are 5 m."""
    straight = pursuit_action(seen(), TASK)
    np.testing.assert_allclose(straight, (0.4, 0.0), atol=1e-6)
    for bend in (1 / 15, -1 / 15):
        steer = float(pursuit_action(seen(bend, speed=1 / 3), TASK)[1]) * 0.56
        assert steer == pytest.approx(math.atan(2.55 * bend), rel=1e-3)


def test_the_gap_sets_the_speed():
    """A time of 1 s behind what is 3 m nearer, at most a quarter faster than told, 4 m/s."""
    for gap, speed in ((5.0, 2.0), (7.0, 4.0), (15.0, 5.0), (2.0, 0.0), (20.0, 4.0)):
        assert float(pursuit_action(seen(gap=gap), TASK)[0]) == pytest.approx(speed / 10, abs=1e-6)


@pytest.fixture(scope="module")
def driven():
    """Two worlds driven by hand and then left alone: scores, and the states at the end."""
    env = usarmjx.make("convoy", worlds=2, engine="c", count=2, episode_steps=STEPS)
    policy = BASELINES.get("convoy")(env)
    act = jax.jit(policy.act)
    states = []
    for share in (1.0, 0.0):
        state = env.reset(0)
        for _ in range(STEPS - 1):
            _, actions = act((), state.obs, jax.random.key(0))
            state = env.step(state, (share * actions[0],))
        states.append(state)
    return env, *states


@pytest.mark.thorough
def test_the_baseline_keeps_its_lane_and_distance(driven):
    """8 s, of which it takes 2 to get up to speed: at least 70 of 100, and 0 for cars that stand."""
    env, state, still = driven
    assert env.period == pytest.approx(PERIOD)
    assert not np.asarray(state.bad).any()
    assert not np.asarray(state.done).any()
    assert np.asarray(state.score).min() > 70.0
    assert np.asarray(still.score).max() < 1.0
    assert np.asarray(state.metrics["sideways"]).max() < 0.9
    assert np.isfinite(np.asarray(state.obs[0])).all()


@pytest.mark.thorough
def test_speeds_by_the_ins_are_true_to_some_percent(driven):
    _, state, _ = driven
    truly = np.asarray(state.privileged)[:, 2:4]
    np.testing.assert_allclose(state.memory.speeds, truly, atol=0.3)  # it is noisy by 1 %, and speeds change
