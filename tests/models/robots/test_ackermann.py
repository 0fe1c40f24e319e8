"""Wheels that steer about one turning centre, against plane geometry done another way."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.base.backend import numpy_backend
from usarmjx.models.drives.ground import Ackermann, Wheel
from usarmjx.models.robots.cars import HUMMER, SEDAN
from usarmjx.sim.control import ControlMode, idle_command, set_drive

BASE, TRACK, AHEAD = 2.6, 1.5, 0.2  # m: of no car; the origin is not midway between the axles
FRONT, REAR = BASE / 2 + AHEAD, -BASE / 2 + AHEAD
SINGLE = 2e-6  # relative: float32, a few roundings


def car(powered="FR", rear_steer=0.5, brakes=False):
    """Four wheels, all of which steer unless `rear_steer` is 0."""
    wheels = [
        Wheel(
            joint=f"{side}{axle}",
            steer=f"{side}{axle}_Steer" if axle == "F" or rear_steer else "",
            x=x,
            y=y,
            powered=axle in powered,
            brakes=brakes,
        )
        for axle, x in (("F", FRONT), ("R", REAR))
        for side, y in (("Left", -TRACK / 2), ("Right", TRACK / 2))
    ]
    return Ackermann(
        wheels=tuple(wheels), max_spin=50.0, radius=0.3, max_front_steer=0.6, max_rear_steer=rear_steer
    )


def told(drive, speed, front, rear=0.0):
    """Speeds of powered wheels and angles of steered ones, by joint (those that do not steer: 0)."""
    values = drive.targets(np.array([speed, front, rear], np.float32))
    by_joint = dict(zip((aim.joint for aim in drive.joint_controls), values.tolist(), strict=True))
    return by_joint, {wheel.joint: by_joint.get(wheel.steer, 0.0) for wheel in drive.wheels}


def turning_centre(front, rear):
    """Where the axes of the bicycle's two wheels cross: solved as two lines, x forward and y left [m]."""
    axes = np.array([[-math.sin(front), math.cos(front)], [-math.sin(rear), math.cos(rear)]])
    at = np.array([[FRONT, 0.0], [REAR, 0.0]])
    along = np.linalg.solve(np.stack([axes[0], -axes[1]], 1), at[1] - at[0])
    return at[0] + along[0] * axes[0]


STEERED = [
    (0.3, 0.0),
    (-0.6, 0.0),
    (0.01, 0.0),
    (0.4, -0.4),
    (-0.5, 0.5),
    (0.5, 0.2),
    (0.1, 0.4),
    (0.0, -0.3),
]


@pytest.mark.parametrize(("front", "rear"), STEERED)
def test_the_axes_of_all_wheels_meet_in_one_point(front, rear):
    drive = car()
    centre = turning_centre(front, rear)
    _, angles = told(drive, 1.0, front, rear)
    for wheel in drive.wheels:
        offset = centre - np.array([wheel.x, -wheel.y])
        heading = np.array([math.cos(angles[wheel.joint]), math.sin(angles[wheel.joint])])
        assert abs(heading @ offset) < 1e-5 * np.linalg.norm(offset), "the axis is square to the heading"


@pytest.mark.parametrize("powered", ["F", "R", "FR"])
@pytest.mark.parametrize(("front", "rear"), STEERED)
def test_wheels_turn_as_their_distances_from_the_centre_ask_for(powered, front, rear):
    drive = car(powered)
    centre = turning_centre(front, rear)
    speeds, _ = told(drive, 10.0, front, rear)
    driven = [wheel for wheel in drive.wheels if wheel.powered]
    middle = np.mean([(wheel.x, -wheel.y) for wheel in driven], axis=0)
    for wheel in driven:
        ratio = np.linalg.norm(centre - (wheel.x, -wheel.y)) / np.linalg.norm(centre - middle)
        assert speeds[wheel.joint] == pytest.approx(10.0 * ratio, rel=1e-5)


def test_positive_steers_left_and_the_inner_wheel_most():
    """Manual 9.4: `{FrontSteer 0.523599}` is 30 degrees to the left."""
    speeds, angles = told(car(rear_steer=0.0), 10.0, math.radians(30))
    assert angles["LeftF"] > math.radians(30) > angles["RightF"] > 0
    assert speeds["RightR"] > speeds["LeftR"] > 0


@pytest.mark.parametrize("angle", [0.0, 0.4, -0.25])
def test_equal_angles_make_a_crab(angle):
    speeds, angles = told(car(), 7.0, angle, angle)
    assert list(angles.values()) == pytest.approx([angle] * 4, abs=SINGLE)
    assert [speeds[joint] for joint in angles] == pytest.approx([7.0] * 4, rel=SINGLE)


def test_opposite_angles_halve_the_turning_circle():
    """Two axles that share the turn: the centre is beside the middle, half as far as with one axle."""
    both, one = turning_centre(0.3, -0.3), turning_centre(0.3, 0.0)
    assert both[1] == pytest.approx(one[1] / 2)
    _, angles = told(car(), 1.0, 0.3, -0.3)
    assert angles["LeftF"] == pytest.approx(math.atan(BASE / 2 / (both[1] - TRACK / 2)), rel=1e-5)
    assert angles["LeftR"] == pytest.approx(-angles["LeftF"], rel=1e-5)


def test_no_wheel_turns_faster_than_it_can():
    """At full speed in a curve the outer wheel has it, and all keep their proportions."""
    drive = car()
    fast, slow = told(drive, 50.0, 0.5)[0], told(drive, 1.0, 0.5)[0]
    spins = [wheel.joint for wheel in drive.wheels]
    assert max(fast[joint] for joint in spins) == pytest.approx(50.0, rel=SINGLE)
    assert [fast[j] / fast["LeftF"] for j in spins] == pytest.approx([slow[j] / slow["LeftF"] for j in spins])
    assert told(drive, -50.0, 0.5)[0]["RightF"] == pytest.approx(-50.0, rel=SINGLE)


@pytest.mark.parametrize(("front", "rear"), [*STEERED, (0.0, 0.0), (0.2, 0.2)])
def test_reported_angles_are_those_that_were_asked_for(front, rear):
    drive = car()
    by_joint, _ = told(drive, 1.0, front, rear)
    reported = drive.steering_angles(by_joint, np.zeros(3))
    assert reported["front_steer"] == pytest.approx(front, abs=1e-6)
    assert reported["rear_steer"] == pytest.approx(rear, abs=1e-6)


def test_reported_angles_are_measured():
    """One wheel straight, one at the angle that would turn it about a centre: the mean of both."""
    drive = car(rear_steer=0.0)
    joints = {"LeftF_Steer": 0.0, "RightF_Steer": 0.2}
    lever = math.tan(0.2) * TRACK / 2
    curvature = (math.tan(0.2) / 2) / (BASE - lever / 2)
    expected = math.atan(curvature * BASE)
    assert drive.steering_angles(joints, np.array([0, 0.5, 0]))["front_steer"] == pytest.approx(expected)


def test_many_setpoints_at_once_and_on_jax():
    drive = car()
    setpoints = np.array([[5.0, front, rear] for front, rear in STEERED], np.float32).reshape(2, 4, 3)
    with numpy_backend():
        one_by_one = [drive.targets(row) for row in setpoints.reshape(-1, 3)]
        expected = np.array(one_by_one).reshape(2, 4, -1)
        np.testing.assert_allclose(drive.targets(setpoints), expected, rtol=1e-6)
    np.testing.assert_allclose(drive.targets(jnp.asarray(setpoints)), expected, rtol=1e-5, atol=1e-6)


def test_a_car_without_rear_steering_accepts_the_key_and_leaves_its_wheels_straight():
    command = set_drive(HUMMER, idle_command(HUMMER), {"Speed": 10.0, "FrontSteer": 9.0, "RearSteer": 0.3})
    assert command.setpoint == pytest.approx([10.0, HUMMER.drive.max_steering[0], 0.0])
    assert HUMMER.drive.full_scale["RearSteer"] == 0.0


def test_only_the_front_wheels_of_a_sedan_are_powered():
    """Manual 12.7.1. Its rear wheels brake at Speed 0 and roll freely otherwise (chosen)."""
    drive = SEDAN.drive
    orders = [drive.control_modes(np.array([speed, 0.2, 0.0], np.float32)) for speed in (3.0, 0.0)]
    by_joint = {aim.joint: (int(a), int(b)) for aim, a, b in zip(drive.joint_controls, *orders, strict=True)}
    moves, stands = (ControlMode.VELOCITY, ControlMode.VELOCITY), (ControlMode.TORQUE, ControlMode.VELOCITY)
    assert by_joint["LeftFWheel"] == by_joint["RightFWheel"] == moves
    assert by_joint["LeftRWheel"] == by_joint["RightRWheel"] == stands
    assert by_joint["LeftFWheel_Steer"] == (ControlMode.POSITION, ControlMode.POSITION)
    speeds, _ = told(drive, 3.0, 0.2)
    assert speeds["LeftRWheel"] == speeds["RightRWheel"] == 0.0, "no torque"


def test_what_conf_reports():
    drive = car()
    assert (drive.steering, drive.vehicle) == ("AckermanSteered", "GroundVehicle")  # manual 9.3's spelling
    assert (drive.max_speed, drive.max_steering, drive.top_speed) == (50.0, (0.6, 0.5), pytest.approx(15.0))
    assert drive.wheel_base == pytest.approx(BASE)
