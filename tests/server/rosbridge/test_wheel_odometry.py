"""Odometry in ROS against the sensor's formula, integrated over the true angles of the wheels."""

from dataclasses import replace

import numpy as np
import pytest

from tests.arenas import FLAT
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount
from usarmjx.server.rosbridge.definitions import RosVersion
from usarmjx.server.rosbridge.motion import estimate_of, odometry_sensor
from usarmjx.server.rosbridge.topics import WorldTopics
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.control import CommandUpdate

TICK = 0.01  # rad, of the encoders
STEPS = 150


def drive(world, robot, left, right, steps=STEPS):
    """Yield the angles of the left and the right front wheel after every control step."""
    world.update_command(robot, CommandUpdate(drive={"Left": left, "Right": right}))
    wheels = [robot.plan.joint_index(name) for name in ("LeftFWheel", "RightFWheel")]
    for step in range(steps):
        world.step()
        if step % 10 == 9:
            world.observe([robot])
        yield world.state(robot).joint_pos[wheels]


@pytest.mark.parametrize(("left", "right"), [(2.0, 2.0), (1.0, 3.0), (-1.0, 1.0)])
def test_it_integrates_the_wheels_from_the_start_between_readings_too(left, right):
    world = DynamicWorld(FLAT)
    robot = world.spawn(P2AT, "R", (1.0, -2.0, 0.4), (0.0, 0.0, 1.0))
    wheels = [robot.plan.joint_index(name) for name in ("LeftFWheel", "RightFWheel")]
    before = np.asarray(world.state(robot).joint_pos[wheels], float)
    np.testing.assert_allclose(estimate_of(world, robot).pos, 0.0, atol=1e-6)
    x = y = heading = 0.0
    for angles in drive(world, robot, left, right):
        one, other = (np.asarray(angles, float) - before) * P2AT.wheel_radius
        middle = heading + (other - one) / P2AT.wheel_separation / 2
        x, y = x + (one + other) / 2 * np.cos(middle), y + (one + other) / 2 * np.sin(middle)
        heading += (other - one) / P2AT.wheel_separation
        before = np.asarray(angles, float)
        estimate = estimate_of(world, robot)
        # A tick of each wheel; and the sensor goes along the heading of its last reading, 0.2 s ago.
        chord = abs(right - left) * P2AT.wheel_radius / P2AT.wheel_separation * 0.2 / 2
        way = abs(left + right) / 2 * P2AT.wheel_radius * STEPS * world.period
        assert np.hypot(*(estimate.pos[:2] - (x, y))) < 2 * TICK * P2AT.wheel_radius + chord * way + 1e-3
        turned = 2 * np.arctan2(estimate.quat[3], estimate.quat[0])
        apart = (turned - heading + np.pi) % (2 * np.pi) - np.pi
        assert abs(apart) < 2 * TICK * P2AT.wheel_radius / P2AT.wheel_separation + 1e-3
    assert abs(x) + abs(heading) > 0.3
    speeds = world.state(robot).joint_vel[wheels] * P2AT.wheel_radius
    assert estimate.linear[0] == pytest.approx(speeds.mean(), abs=1e-5)
    assert estimate.angular[2] == pytest.approx((speeds[1] - speeds[0]) / P2AT.wheel_separation, abs=1e-5)


def test_a_reset_of_the_sensor_begins_a_new_frame_and_the_map_stays():
    world = DynamicWorld(FLAT)
    robot = world.spawn(P2AT, "R", (0.0, 0.0, 0.4), (0.0, 0.0, 0.0))
    list(drive(world, robot, 3.0, 3.0, 100))
    assert estimate_of(world, robot).pos[0] > 0.3
    assert world.operate_sensor(robot, odometry_sensor(world, robot), "RESET", ())
    np.testing.assert_allclose(estimate_of(world, robot).pos, 0.0, atol=1e-6)
    frames = WorldTopics(world, (32, 24)).all()["/tf"].make(RosVersion.ROS2)["transforms"]
    (drift,) = (one for one in frames if one["child_frame_id"] == "R/odom")
    at = world.state(robot).pos
    assert drift["transform"]["translation"]["x"] == pytest.approx(float(at[0]), abs=1e-5)


def test_a_robot_without_the_sensor_has_the_truth_in_a_fixed_frame():
    bare = replace(P2AT, name="Bare", sensors=(Mount(kind="INS", name="INS"),))
    for kind in (bare, ROBOTS.get("AirRobot")):
        world = DynamicWorld(FLAT)
        robot = world.spawn(kind, "R", (1.0, 2.0, 0.6), (0.0, 0.0, 0.5))
        world.step()
        assert odometry_sensor(world, robot) is None
        np.testing.assert_array_equal(estimate_of(world, robot).pos, world.state(robot).pos)
        topics = WorldTopics(world, (32, 24)).all()
        fixed, moving = (topics[name].make(RosVersion.ROS2)["transforms"] for name in ("/tf_static", "/tf"))
        assert "R/odom" in [one["child_frame_id"] for one in fixed]
        assert "R/odom" not in [one["child_frame_id"] for one in moving]
