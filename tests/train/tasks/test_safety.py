"""The safety layer of team tasks: commands that keep robots clear of what they know."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.sensors.ranging import ScannerSettings
from usarmjx.train.make import make
from usarmjx.train.tasks import safety
from usarmjx.train.tasks.buildings import Buildings
from usarmjx.train.tasks.equip import mapping_robot

BODY = safety.footprint_of(mapping_robot("P2AT"))
assert BODY is not None
FULL = jnp.array([0.9, 0.0])
NOBODY = jnp.full((8, 2), 50.0)


def follow(command: np.ndarray, time: float, steps: int = 20000) -> np.ndarray:
    """Return where a P2AT comes, by small steps of its wheels' speeds: x, y [m], yaw [rad] (3,)."""
    assert BODY is not None
    left, right = np.clip([command[0] - command[1], command[0] + command[1]], -1, 1) * BODY.top_speed
    rate = np.clip((right - left) / BODY.lever, -BODY.max_turn, BODY.max_turn)
    yaw = rate * (np.arange(steps) + 0.5) * time / steps
    speed = (left + right) / 2 * time / steps
    return np.array([(speed * np.cos(yaw)).sum(), (speed * np.sin(yaw)).sum(), rate * time])


@pytest.mark.parametrize("command", [(0.9, 0.0), (0.4, 0.3), (0.0, -0.5), (-0.5, 0.2), (0.0, 1.0)])
def test_commands_are_followed_along_arcs(command: tuple[float, float]) -> None:
    position, yaw = safety.moved(BODY, jnp.array(command), 0.4)
    # Beside 20,000 midpoints, wrong by 1e-10; single precision rounds to 1e-7 of a few decimetres.
    np.testing.assert_allclose([*position, yaw], follow(np.array(command), 0.4), atol=1e-6)


def test_nothing_near_leaves_the_command() -> None:
    for command in ([0.9, 0.2], [-0.5, 0.3], [0.0, -0.4]):
        found = safety.safe_command(BODY, NOBODY, NOBODY, jnp.array(command))
        np.testing.assert_array_equal(found, np.float32(command))


def test_a_robot_stops_before_a_wall() -> None:
    wall = jnp.stack([jnp.full(9, BODY.high[0] + 0.1), jnp.linspace(-1, 1, 9)], -1)
    speed, _ = safety.safe_command(BODY, wall, NOBODY, FULL)
    assert speed <= 0.0


def test_robots_keep_farther_from_each_other_than_from_walls() -> None:
    outline = safety.outline(BODY.low, BODY.high) + np.float32([2 * BODY.high[0] + 0.4, 0.0])
    slow = jnp.array([0.3, 0.0])
    assert (
        safety.safe_command(BODY, NOBODY, jnp.asarray(outline), slow)[0] > 0
    )  # goes 0.08 m: 0.32 m are left
    nearer = jnp.asarray(outline) - jnp.array([0.1, 0.0])
    assert safety.safe_command(BODY, NOBODY, nearer, slow)[0] < 0.3
    np.testing.assert_array_equal(safety.safe_command(BODY, nearer, NOBODY, slow), slow)


def test_a_robot_that_is_too_near_may_leave() -> None:
    behind = jnp.array([[BODY.low[0] - 0.01, 0.0]])
    np.testing.assert_array_equal(safety.safe_command(BODY, behind, NOBODY, FULL), FULL)
    ahead = jnp.array([[BODY.high[0] + 0.01, 0.0]])
    assert safety.safe_command(BODY, ahead, NOBODY, FULL)[0] <= 0.0


def test_chosen_commands_keep_clear() -> None:
    rng, kept = np.random.default_rng(3), 0
    choose = jax.jit(lambda points, command: safety.safe_command(BODY, points, NOBODY, command))
    for _ in range(200):
        points = rng.uniform(-1.0, 1.0, (12, 2)).astype(np.float32)
        command = rng.uniform(-1.0, 1.0, 2).astype(np.float32)
        now = box_distance(points, np.zeros(3))
        if now == 0:
            continue
        chosen = np.asarray(choose(points, command))
        ends = [box_distance(points, follow(chosen, time, 500)) for time in safety.HORIZONS]
        wanted = [box_distance(points, follow(command, time, 500)) for time in safety.HORIZONS]
        least = min(safety.MARGIN, now)
        if min(wanted) >= least + 1e-3:
            np.testing.assert_allclose(chosen, command, atol=1e-6)
        assert min(ends) >= least - 1e-3  # to stand still keeps the distance, so there is always a safe one
        kept += min(wanted) < least - 1e-3
    assert kept > 20  # commands that were not safe


def box_distance(points: np.ndarray, pose: np.ndarray) -> float:
    """Return the distance of the nearest point from a P2AT at a pose [m]."""
    assert BODY is not None
    away, (cos, sin) = points - pose[:2], (np.cos(pose[2]), np.sin(pose[2]))
    own = np.stack([cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0]], -1)
    gap = np.maximum(np.maximum(BODY.low - own, own - BODY.high), 0)
    return float(np.linalg.norm(gap, axis=-1).min())


def test_beams_end_where_they_met_something() -> None:
    scanner = ScannerSettings(max_range=4.0, resolution=np.pi / 2, scan_fov=np.pi)
    points = safety.beam_points(scanner, np.array([0.1, 0.0, 0.0]), jnp.array([1.0, 2.0, 4.0]))
    np.testing.assert_allclose(points[:2], [[0.1, -1.0], [2.1, 0.0]], atol=1e-6)
    assert np.linalg.norm(points[2]) > 100


def test_mates_are_boxes_where_they_said_to_be() -> None:
    lines = np.tile(safety.outline(BODY.low, BODY.high), (3, 1, 1))
    pose, mates = (
        jnp.array([1.0, 2.0, np.pi / 2]),
        jnp.array([[1.0, 4.0, 0.0], [3.0, 2.0, 0.5], [0.0, 0.0, 0.0]]),
    )
    age = jnp.array([0.2, 5.0, jnp.inf])
    points = np.asarray(safety.mate_points(pose, mates, age, lines))
    # The first is 2 m ahead, across; the others are too old.
    half = np.float32([BODY.high[1], BODY.high[0]])
    np.testing.assert_allclose(points[:8].min(0), np.array([2.0, 0.0]) - half, atol=1e-6)
    np.testing.assert_allclose(points[:8].max(0), np.array([2.0, 0.0]) + half, atol=1e-6)
    assert np.abs(points[8:]).max(-1).min() > 100


def test_robots_that_drive_straight_on_touch_nothing() -> None:
    arena = Buildings(count=1, size=(5, 4))
    env = make("explore-v1", worlds=1, engine="planar", arena=arena, count=2, safety=True)
    step, first = jax.jit(env.step), env.reset()
    actions = tuple(jnp.tile(FULL, (1, len(group.agents), 1)) for group in env.groups)
    state = first
    for _ in range(60):
        last, state = state, step(state, actions)
    assert float(state.metrics["contacts"][0]) == 0
    went, lately = (
        np.linalg.norm(np.asarray(state.memory.belief.pose - one.memory.belief.pose)[0, :2, :2], axis=-1)
        for one in (first, last)
    )
    assert went.max() > 0.5  # they drove, as far as there was room,
    assert lately.max() < 0.05  # and stand before what they would have touched
