"""Lisa: two wheels that drive and steer each for itself (manual 9.4, 12.18)."""

import math

import numpy as np
import pytest

from tests.rig import Rig, steady_spin
from usarmjx.base.errors import UnknownNameError
from usarmjx.models.drives.ground import OmniDrive, Wheel
from usarmjx.models.robots.lisa import LISA
from usarmjx.sim.control import idle_command, set_drive

EXAMPLE = 0.75  # rad: manual 9.4's example, with wheel speeds of +-3.14 rad/s
ROLL_RTOL = 0.03  # of a wheel 5 cm wide that turns on the spot


def test_keys_are_those_of_the_driven_wheels():
    assert LISA.drive.full_scale == {
        "WheelSpeed0": 8.0,
        "WheelSteer0": 3.14,
        "WheelSpeed1": 8.0,
        "WheelSteer1": 3.14,
    }
    assert LISA.drive.steering == "OmniDrive"
    assert LISA.drive.max_steering == (3.14, 3.14)  # manual 12.18.2: MaxSteerAngle


def test_wheels_without_motor_or_steering_have_no_keys():
    """Manual 12.18.2: PowerType=Not_Powered. Numbers are places: the wheel behind keeps its own."""
    wheels = (
        Wheel(joint="A", x=1, y=0),
        Wheel(joint="B", steer="B_Steer", x=-1, y=0, powered=True),
        Wheel(joint="C", x=0, y=1, powered=True),
    )
    drive = OmniDrive(wheels=wheels, max_spin=2.0, radius=0.1, max_steer=1.0)
    assert drive.keys == ("WheelSpeed1", "WheelSteer1", "WheelSpeed2")
    assert [(aim.joint, aim.mode) for aim in drive.joint_controls] == [("B", 1), ("B_Steer", 0), ("C", 1)]
    assert drive.targets(np.array([1.0, 0.5, -1.0])).tolist() == [1.0, 0.5, -1.0]
    assert drive.steering_angles({"B_Steer": 0.5}, np.zeros(3)) == {"front_steer": 0.0, "rear_steer": 0.5}


def test_values_are_clipped_and_passive_wheels_cannot_be_driven():
    command = set_drive(LISA, idle_command(LISA), {"WheelSpeed0": 99.0, "WheelSteer1": -9.0})
    assert command.setpoint == pytest.approx([8.0, 0.0, 0.0, -3.14])
    with pytest.raises(UnknownNameError, match="WheelSpeed2"):
        set_drive(LISA, idle_command(LISA), {"WheelSpeed2": 1.0})


def test_at_the_manuals_angle_both_axes_go_through_the_middle():
    """Manual 9.4: so steered "the robot rotates on place"."""
    for wheel in LISA.drive.wheels:
        heading = (math.cos(EXAMPLE), math.sin(EXAMPLE))  # forward, left
        assert heading[0] * wheel.x - heading[1] * wheel.y == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("speed", [3.14, 8.0])
def test_the_manuals_example_turns_it_on_the_spot(speed):
    rig = Rig("Lisa").tell(WheelSteer0=EXAMPLE, WheelSteer1=EXAMPLE)
    rig.run(1.0)
    rig.tell(WheelSpeed0=speed, WheelSpeed1=-speed)
    lever = math.hypot(LISA.wheel_base, LISA.wheel_separation) / 2
    assert steady_spin(rig) == pytest.approx(speed * LISA.wheel_radius / lever, rel=ROLL_RTOL)
    assert np.linalg.norm(rig.data.qpos[:2]) < 0.01, "the front right wheel ahead: to the left, in place"


@pytest.mark.parametrize("angle", [0.6, math.pi / 2, -math.pi / 2, 3.1])
def test_both_wheels_at_one_angle_carry_it_there_without_turning(angle):
    rig = Rig("Lisa").tell(WheelSteer0=angle, WheelSteer1=angle)
    rig.run(2.0)
    angles = LISA.drive.steering_angles({part.name: rig.joint(part.name) for part in LISA.parts}, np.zeros(4))
    assert angles == pytest.approx({"front_steer": angle, "rear_steer": angle}, abs=1e-3)
    rig.tell(WheelSpeed0=4.0, WheelSpeed1=4.0)
    rig.run(2.0)
    start, yaw = rig.data.qpos[:2].copy(), math.atan2(rig.mat("chassis")[1, 0], rig.mat("chassis")[0, 0])
    log = rig.run(2.0)
    way = log[-1, :2] - start
    assert np.linalg.norm(way) == pytest.approx(2.0 * 4.0 * LISA.wheel_radius, rel=ROLL_RTOL)
    assert math.atan2(way[1], way[0]) - yaw == pytest.approx(
        angle, abs=0.01
    )  # mostly to the left, as Ackermann
    assert np.abs(log[:, 8]).max() < 1e-3
