"""The later versions' inertial unit and compass, against closed forms and the lines of their sources."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.arenas import FLAT
from tests.handy import known
from tests.sensors.test_inertial import measure, sensor
from tests.server.peers import say
from usarmjx.base.transforms import GRAVITY
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount
from usarmjx.sensors.suite import suite_of
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.gamebots.sensors import configuration, geometry, sensor_report
from usarmjx.server.protocol.dialects import MANUAL, UDK
from usarmjx.server.protocol.grammar import format_message
from usarmjx.server.rosbridge.definitions import RosVersion
from usarmjx.server.rosbridge.topics import sensor_topics
from usarmjx.server.worlds.dynamic_world import DynamicWorld

EXACT = 1e-4  # single precision of angles and speeds over 0.1 s


def test_an_ahrs_divides_the_changes_by_the_time():
    """(cur - last) / timeDiff of velocity, angles and rates; the rates are 0 before (IMU.uc)."""
    unit = sensor("AHRS")
    moments = [
        {"time": 0.0, "angles": (0.0, 0.0, 0.0), "linear": (1.0, 0.0, 0.0)},
        {"time": 0.1, "angles": (0.01, 0.02, 0.05), "linear": (1.2, -0.1, 0.05)},
        {"time": 0.3, "angles": (0.01, 0.04, 0.01), "linear": (1.0, 0.0, 0.0)},
    ]
    np.testing.assert_allclose(measure(unit, moments[0]), 0.0, atol=EXACT)
    first, second = measure(unit, *moments[:2]), measure(unit, *moments)
    rates = np.array([0.1, 0.2, 0.5])
    seen = Rotation.from_euler("ZYX", (0.05, 0.02, 0.01)).inv().apply([2.0, -1.0, 0.5])
    np.testing.assert_allclose(first, [*seen, *rates, *rates / 0.1, 0.01, 0.02, 0.05], atol=2e-3)
    later = np.array([0.0, 0.1, -0.2])
    seen = Rotation.from_euler("ZYX", (0.01, 0.04, 0.01)).inv().apply([-1.0, 0.5, -0.25])
    np.testing.assert_allclose(second, [*seen, *later, *(later - rates) / 0.2, 0.01, 0.04, 0.01], atol=2e-3)


def test_its_yaw_goes_over_the_half_turn_and_its_axes_are_the_mounts():
    unit = sensor("AHRS", direction=(0.0, 0.0, math.pi / 2))  # as on the wire: it looks to the right
    before = {"angles": (0.0, 0.0, math.pi - 0.01), "linear": (0.0, 0.0, 0.0)}
    after = {"time": 0.2, "angles": (0.0, 0.0, -math.pi + 0.01), "linear": (-0.2, 0.0, 0.0)}
    told = measure(unit, before, after)
    assert told[5] == pytest.approx(0.1, abs=1e-3)
    # The robot has sped up ahead (to -x); to its right, along the sensor's x, lies -y of its own: ahead is y.
    np.testing.assert_allclose(told[:3], [0.0, 1.0, 0.0], atol=0.02)
    at_rest = measure(unit, {}, {"time": 0.2})
    np.testing.assert_allclose(at_rest, 0.0, atol=EXACT, err_msg="without gravity")


@pytest.mark.parametrize(
    ("yaw", "north", "told"),
    [(0.0, 0.0, 0.0), (0.5, 0.0, 0.5), (-0.5, 0.0, -0.5), (0.0, 1.0, 1.0), (3.0, 1.0, 4.0 - 2 * math.pi)],
)
def test_a_compass_points_from_the_heading_to_north(yaw, north, told):
    """DiffAngle(N, yaw), clockwise positive as all yaws on the wire (MagneticCompass.uc)."""
    compass = sensor("MagneticCompass", North=north)
    value = measure(compass, {"angles": (0.2, 0.1, yaw)})
    message = sensor_report(compass, value, 2.0, stamped=True)
    (line,) = [format_message(one) for one in UDK.translate(message, "P3AT")]
    assert line.startswith("SEN {Time 2.0000} {Type MagneticCompass} {Name MagneticCompass} {MagneticAngle ")
    assert float(line[line.index("Angle ") + 6 : -1]) == pytest.approx(told, abs=2e-4)


def test_it_is_called_imu_in_the_later_dialect():
    unit = sensor("AHRS")
    value = np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.01, 0.02, 0.03])
    message = sensor_report(unit, value, 2.0, stamped=True)
    keys = (
        "{XYZAcceleration 1.0000,-2.0000,3.0000} {AngularVel 0.1000,-0.2000,-0.3000}"
        " {AngularAccel 0.4000,-0.5000,-0.6000} {Rotation 0.0100,-0.0200,-0.0300}"
    )
    told = [format_message(one) for one in UDK.translate(message, "P3AT")]
    assert told == [f"SEN {{Time 2.0000}} {{Type IMU}} {{Name AHRS}} {keys}"]
    (plain,) = [format_message(one) for one in MANUAL.translate(message, "P3AT")]
    assert plain == f"SEN {{Time 2.0000}} {{Type AHRS}} {{Name AHRS}} {keys}"
    robot = unit.plan.robot
    for asked in ("IMU", "AHRS"):
        (where,) = geometry(unit.plan, asked, "")
        assert where.get("Type") == asked
        assert where.get("Name").startswith("AHRS Location")
        (about,) = configuration(replace(robot, cameras=()), (unit,), (), asked, "AHRS")
        assert "ScanInterval" in format_message(about)


def test_a_client_reads_it_every_report():
    robot = replace(P2AT, name="Attitude", sensors=(Mount(kind="AHRS", name="Unit"),))
    with known(robot):
        client = Client(DynamicWorld(FLAT, max_robots=1), "peer", dialect=UDK)
        say(client, "INIT {ClassName USARBot.Attitude} {Name R} {Location 0,0,-0.4} {Rotation 0,0,0.5}")
        for _ in range(20):
            client._world.step()
        client._world.observe([client.robot])
        client.report()
        lines = client.session.data_to_send().decode().splitlines()
    (line,) = [line for line in lines if "{Type IMU} {Name Unit}" in line]
    assert line.endswith("0.4999}") or line.endswith("0.5000}") or line.endswith("0.5001}")


def test_ros_gets_its_orientation_and_the_force_that_carries_it():
    """REP 145: at rest an accelerometer tells +g upward."""
    unit = sensor("AHRS")
    roll, pitch, yaw = 0.1, -0.2, 0.3
    turn, rates = Rotation.from_euler("ZYX", (yaw, pitch, roll)), np.array([0.0, 0.0, 0.4])
    value = np.concatenate([np.zeros(3), rates, np.zeros(3), [roll, pitch, yaw]])
    (topic,) = sensor_topics(unit, None)
    message = topic.make(RosVersion.ROS2, 1.0, "R", value)
    x, y, z, w = turn.as_quat()
    got = [message["orientation"][axis] for axis in "xyzw"]
    assert got == pytest.approx([x, y, z, w], abs=1e-6)
    force = [message["linear_acceleration"][axis] for axis in "xyz"]
    assert force == pytest.approx(turn.inv().apply([0.0, 0.0, GRAVITY]).tolist(), abs=1e-5)
    spin = [message["angular_velocity"][axis] for axis in "xyz"]
    assert spin == pytest.approx(
        turn.inv().apply([0.0, 0.0, 0.4]).tolist(), abs=1e-6
    )  # yaw is about the vertical
    assert suite_of(unit.plan.robot).sensors[0] is unit
