"""Sensors of the later versions, against their sources' formulas and lines."""

import numpy as np
import pytest

from tests.sensors.test_inertial import measure, sensor
from usarmjx.base.errors import UsarmjxError
from usarmjx.models.robots import ROBOTS
from usarmjx.server.gamebots.sensors import sensor_report
from usarmjx.server.protocol.dialects import MANUAL, UDK
from usarmjx.server.protocol.grammar import format_message

WHEELS = ("LeftFWheel", "RightFWheel", "LeftRWheel", "RightRWheel")


def turning(tachometer, time, *angles, spin=0.0):
    """The state of a P2AT whose wheels have turned so far [rad]."""
    joints = len(tachometer.plan.parts) - 1
    pos, vel = np.zeros(joints), np.zeros(joints)
    for wheel, angle in zip(WHEELS, angles, strict=True):
        pos[tachometer.plan.joint_index(wheel)], vel[tachometer.plan.joint_index(wheel)] = angle, spin
    return {"time": time, "joint_pos": pos, "joint_vel": vel}


def lines(sensor, value, time=2.0):
    message = sensor_report(sensor, np.asarray(value), time, stamped=True)
    assert message is not None
    assert list(MANUAL.translate(message, "P2AT")) == [message]
    return [format_message(one) for one in UDK.translate(message, "P3AT")]


def test_a_tachometer_divides_the_rotation_of_each_wheel_by_the_time():
    """(CurValue - Old) / timeDiff, and CurValue (Tachometer.uc); forward is positive."""
    tachometer = sensor("Tachometer")
    driven = [part.name for part in tachometer.plan.robot.wheels]
    assert sorted(driven) == sorted(WHEELS)
    first = turning(tachometer, 0.0, 0.0, 0.0, 0.0, 0.0, spin=1.5)
    np.testing.assert_allclose(
        measure(tachometer, first), [1.5] * 4 + [0.0] * 4, err_msg="the momentary spin"
    )
    told = measure(tachometer, first, turning(tachometer, 0.2, 0.4, -0.2, 0.3, -0.1, spin=9.0))
    angles: dict[str, float] = dict(zip(WHEELS, (0.4, -0.2, 0.3, -0.1), strict=True))
    expected = [angles[name] for name in driven]
    np.testing.assert_allclose(told, [*(np.array(expected) / 0.2), *expected], rtol=1e-6)
    assert lines(tachometer, [1.0, -1.0, 2.0, 0.5, 4.0, 3.0, 2.0, 1.0]) == [
        "SEN {Time 2.0000} {Type Tachometer} {Name Tachometer} {Vel 1.0000,-1.0000,2.0000,0.5000}"
        " {Pos 4.0000,3.0000,2.0000,1.0000}"
    ]


def test_a_tachometer_needs_wheels():
    with pytest.raises(UsarmjxError, match="Tachometer Tachometer: With Tachometer has no driven wheels"):
        sensor("Tachometer", robot=ROBOTS.get("AirRobot"))


@pytest.mark.parametrize(("risen", "absolute"), [(0.0, 111.0), (2.5, 113.5), (-1.0, 110.0), (-120.0, 0.0)])
def test_an_altitude_is_above_the_start_and_above_the_sea(risen, absolute):
    """ASL is 111 m, and below the sea is 0 (AltitudeSensor.uc)."""
    altimeter = sensor("AltitudeSensor")
    told = measure(altimeter, {"pos": (0, 0, 0.3)}, {"pos": (5, 0, 0.3 + risen), "time": 0.2})
    np.testing.assert_allclose(told, [risen, absolute], atol=1e-5)
    higher = sensor("AltitudeSensor", ASL=500.0)
    assert measure(higher, {"pos": (0, 0, 0.3)}, {"pos": (0, 0, 1.3), "time": 1.0})[1] == pytest.approx(501.0)
    assert lines(altimeter, [1.25, 112.25]) == [
        "SEN {Time 2.0000} {Type AltitudeSensor} {Name AltitudeSensor} {relativeAltitude 1.2500}"
        " {absoluteAltitude 112.2500}"
    ]


@pytest.mark.parametrize(
    ("begin", "end", "minutes"), [(0, 59.9, 0), (0, 60.0, 1), (33.0, 92.9, 0), (33.0, 1293.0, 21)]
)
def test_a_mission_is_counted_in_whole_minutes_from_the_start_of_the_robot(begin, end, minutes):
    clock = sensor("MissionTime")
    assert measure(clock, {"time": begin}, {"time": end}).tolist() == [minutes]
    assert lines(clock, [minutes]) == [
        f"SEN {{Time 2.0000}} {{Type MissionTime}} {{Name MissionTime}} {{Minutes {minutes}}}"
    ]
