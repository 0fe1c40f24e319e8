"""hover-inspect: judgements of states made by hand, the way through windows, and flights on engine c."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import usarmjx
from tests.train.views import placed, told, view_of
from usarmjx.base.errors import UsageError
from usarmjx.train.baselines import BASELINES
from usarmjx.train.baselines.hover import inspection_action
from usarmjx.train.tasks.hover_inspect import HoverInspect, InspectMemory, wall_clearance

TASK = HoverInspect(rooms=2, dwell=3, near=2.0, view=0.35, bonus=2.0, haste=0.01, price=3.0)
WALL, WINDOW = 2.5, (2.5, 0.8, 1.3)
"""x of the wall between the rooms, the middle of its window [m]."""


@pytest.fixture(scope="module")
def view():
    return view_of(TASK)


def memory(point=(0.0, 2.5, 1.0), seen=0, held=0, aim=(0.0, 0.0, 0.0), distance=5.0):
    points = jnp.array([point, (5.0, -2.5, 1.0)] if seen == 0 else [(0.0, 2.5, 1.0), point])
    return InspectMemory(
        points=points,
        inspected_count=jnp.int32(seen),
        dwell_steps=jnp.int32(held),
        target=jnp.array(aim),
        distance=jnp.float32(distance),
    )


LEFT = math.pi / 2


@pytest.mark.parametrize(
    ("pose", "looks"),
    [
        ((0.0, 1.0, 1.0, 0.0, 0.0, LEFT), True),
        ((0.0, 0.51, 1.0, 0.0, 0.0, LEFT), True),
        ((0.0, 0.49, 1.0, 0.0, 0.0, LEFT), False),  # 2.01 m away
        ((0.0, 1.0, 1.0, 0.0, 0.0, LEFT + 0.34), True),
        ((0.0, 1.0, 1.0, 0.0, 0.0, LEFT + 0.36), False),
        ((0.0, 1.0, 1.0, 0.0, 0.36, LEFT), False),  # its nose is down
        ((0.0, 1.0, 1.0, 0.0, 0.0, -LEFT), False),
    ],
)
def test_looking_takes_a_room_a_distance_and_a_direction(view, pose, looks):
    result = TASK.evaluate(placed(view, pose), memory(held=1))
    assert int(result.memory.dwell_steps) == (2 if looks else 0)
    assert float(result.score) == 0.0


def test_nothing_is_looked_at_from_the_next_room(view):
    point = (2.4, 2.0, 1.0)
    for x, looks in ((1.9, True), (3.2, False)):  # both are within 1 m of it, one beyond the wall
        yaw = math.atan2(0.0, point[0] - x)
        result = TASK.evaluate(placed(view, (x, 2.0, 1.0, 0.0, 0.0, yaw)), memory(point=point))
        assert bool(result.metrics["looks"]) is looks


def test_points_count_one_after_the_other_until_all_are_seen(view):
    here = placed(view, (0.0, 1.0, 1.0, 0.0, 0.0, LEFT))
    found = TASK.evaluate(here, memory(held=2, aim=(0.0, 2.5, 1.0), distance=1.7))
    assert (int(found.memory.inspected_count), int(found.memory.dwell_steps), float(found.score)) == (
        1,
        0,
        50.0,
    )
    assert float(found.reward[0][0]) == pytest.approx(1.7 - 1.5 + 2.0 - 0.01, abs=1e-5)
    assert not bool(found.terminated)
    np.testing.assert_allclose(found.memory.target, (2.5 + 0.9, 0.8, 1.3), atol=1e-6)
    last = TASK.evaluate(here, memory(seen=1, held=2))
    assert (float(last.score), bool(last.terminated)) == (100.0, True)


def test_touching_a_wall_or_leaving_over_it_ends_the_episode(view):
    """The frame reaches 0.4995 m from its middle; the walls of the first room are at 2.5 m."""
    for y, touched in ((1.98, False), (1.995, True)):
        result = TASK.evaluate(placed(view, (0.0, y, 1.0, 0.0, 0.0, 0.0)), memory())
        assert bool(result.terminated) is touched
    assert float(result.reward[0][0]) == pytest.approx(5.0 - math.hypot(1.995, 1.0) - 0.01 - 3.0, abs=1e-4)
    assert bool(TASK.evaluate(placed(view, (0.0, 0.0, 3.1, 0.0, 0.0, 0.0)), memory()).terminated)


def test_in_the_window_a_fifth_of_a_metre_is_free_on_each_side(view):
    """1.4 m less 0.999 m, halved; above and below there is more: it is 0.2 m high or less."""
    x, y, z = WINDOW
    assert float(wall_clearance(placed(view, (x, y, z, 0.0, 0.0, 0.0)))) == pytest.approx(0.2, abs=1e-3)
    assert float(wall_clearance(placed(view, (x, y + 0.1, z + 0.5, 0.0, 0.0, 0.0)))) == pytest.approx(
        0.1, abs=1e-3
    )
    assert float(wall_clearance(placed(view, (x, y, z - 0.7, 0.0, 0.0, 0.0)))) == 0.0, "the sill"


def test_the_way_leads_through_the_window_until_it_is_behind():
    task = HoverInspect(rooms=3)
    first, second = task.windows
    for x, target, window, side in (
        (0.0, 10.0, first, 1.0),
        (3.3, 10.0, first, 1.0),
        (3.5, 10.0, second, 1.0),
        (8.5, 10.0, None, 0.0),
        (10.0, 0.0, second, -1.0),
        (5.0, 0.0, first, -1.0),
        (3.5, 5.0, None, 0.0),
        (1.5, 0.0, None, 0.0),
        (1.7, 0.0, first, -1.0),
    ):
        found, way, there = task.next_window(jnp.array([x, 0.0, 1.0]), jnp.array([target, 2.5, 1.0]))
        assert bool(there) is (window is not None), (x, target)
        if window is not None:
            np.testing.assert_allclose(found, window)
            assert float(way) == side


def test_it_sees_point_and_window_from_its_pose(view):
    """It looks along y, 1 m before the wall and 1 m to the side of the window; the point is behind that."""
    pose = [1.5, -0.2, 1.0, 0.1, 0.2, LEFT]
    here = told(view, GroundTruth=[pose], RangeScanner=[np.arange(12) / 4])
    (seen,) = TASK.observe(here, memory(point=(5.0, -2.5, 1.5), seen=1, held=1))
    point, window = (-2.3 / 5, -3.5 / 5, 0.1), (1.0 / 5, -1.0 / 5, 0.3 / 5)
    expected = [*point, *window, 1.0, 1.0, 0.0, 0.1, 0.2, 0.2, 1 / 3, *(np.arange(12) / 20)]
    np.testing.assert_allclose(seen[0], expected, atol=1e-5)


def observed(point, window=None, yaw=0.0):
    there = window is not None
    return jnp.array(
        [*np.array(point) / 5, *np.array(window or (0, 0, 0)) / 5, there, np.sin(yaw), np.cos(yaw)]
    )


def test_the_baseline_squares_up_flies_through_and_hovers_before_the_point():
    """Up, forward, right, clockwise; 1 is 1.5 m/s."""
    through = inspection_action(observed((4.0, 0.0, 0.0), (1.3, 0.0, 0.0)))
    np.testing.assert_allclose(through, (0.0, 0.8 / 1.5, 0.0, 0.0), atol=1e-6)
    aside = inspection_action(observed((4.0, 0.0, 0.0), (1.3, 0.5, 0.0)))
    np.testing.assert_allclose(aside, (0.0, 0.0, -0.5 / 1.5, 0.0), atol=1e-6)
    before = inspection_action(observed((1.3, 0.0, 0.3)))
    np.testing.assert_allclose(before, (0.2, 0.0, 0.0, 0.0), atol=1e-6)
    assert float(inspection_action(observed((0.0, 1.3, 0.0)))[3]) < 0, "turns left, which is not clockwise"


def test_rooms_and_robots_that_do_not_go():
    with pytest.raises(UsageError, match="rooms is 9, expected a whole number from 1 to 5"):
        HoverInspect(rooms=9).arenas  # noqa: B018 - it raises
    with pytest.raises(UsageError, match="a P2AT in the air"):
        HoverInspect(robot="P2AT").robots  # noqa: B018 - it raises


@pytest.mark.thorough
def test_the_baseline_flies_through_a_window_and_looks_at_two_points():
    """Two of four worlds do nothing: they stay on the ground and see nothing."""
    steps = 110
    env = usarmjx.make("hover-inspect", worlds=4, engine="c", rooms=2, episode_steps=steps)
    policy = BASELINES.get("hover-inspect")(env)
    act, go = jax.jit(policy.act), np.array([1.0, 1.0, 0.0, 0.0])[:, None, None]
    state, first = env.reset(0), np.full(4, np.nan)
    for _ in range(steps):
        _, actions = act((), state.obs, jax.random.key(0))
        state = env.step(state, (go * actions[0],))
        ended = np.asarray(state.done) & np.isnan(first)
        first = np.where(ended, np.asarray(state.final_score), first)
        assert not np.asarray(state.bad).any()
    np.testing.assert_allclose(first, (100.0, 100.0, 0.0, 0.0))
