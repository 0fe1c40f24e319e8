"""Keys and sticks move robots of every kind of steering the way that they say."""

import asyncio
import math
import os
from dataclasses import replace

import numpy as np
import pytest

from tests.arenas import FLAT
from tests.cli.console.robots import Driven
from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import mat_from_quat
from usarmjx.cli.console.app import DRIVING_KEYS
from usarmjx.cli.console.driving import (
    ACTIONS,
    AT_FIRST,
    AXIS,
    BUTTON,
    EVENT,
    FULL,
    NO_DRIVE,
    NO_ROBOT,
    JoystickDevice,
    JoystickDriver,
    KeyDriver,
    find_joystick,
    joystick_path,
    link_axis,
)
from usarmjx.cli.console.knowledge import Knowledge, PackageLink
from usarmjx.models.types.arena import Water
from usarmjx.server.worlds.served_world import CameraRequest

DEEP = replace(FLAT, waters=(Water(low=(-50, -50, -9), high=(50, 50, 9)),))


def motion(driven, *actions, seconds=1.0):
    """How far a robot goes ahead, left and up [m], and turns to the left [degrees], while keys say so."""
    before = driven.world.state(driven.robot)
    driven.press(*actions)
    driven.run(seconds)
    after = driven.world.state(driven.robot)
    first, last = (np.asarray(mat_from_quat(np.array(state.quat))) for state in (before, after))
    way = first.T @ (np.array(after.pos) - np.array(before.pos))
    turn = first.T @ last
    return (*way.tolist(), math.degrees(math.atan2(turn[1, 0], turn[0, 0])))


def test_skid_steered_robots_drive_and_turn_on_the_spot():
    robot = Driven("P2AT")
    assert motion(robot, "forward")[0] > 0.1
    assert motion(robot, "backward")[0] < 0.0
    assert motion(robot, "stop", "left")[3] > 15.0
    assert motion(robot, "right")[3] < -10.0
    motion(robot, "stop", seconds=0.4)
    assert motion(robot) == pytest.approx((0, 0, 0, 0), abs=1.0)
    slow = motion(robot, "slower", "slower", "forward")[0]
    motion(robot, "stop", seconds=0.4)
    assert motion(robot, *["faster"] * 6, "forward")[0] > 2 * slow
    assert robot.faults == []


def test_cars_steer_further_with_each_press_and_go_on():
    car = Driven("Hummer")
    assert motion(car, *["slower"] * 3, "forward")[0] > 0.5
    left = motion(car, "left", "left")[3]
    assert left > 2.0
    assert motion(car, "straight", "right", "right")[3] < 0.5 * left
    assert car.pilot.ahead == 1.0
    assert motion(car, "stop", seconds=3.0)[0] > 0.0
    assert motion(car)[0] == pytest.approx(0.0, abs=0.05)
    assert car.faults == []


def test_wheels_that_are_told_one_by_one_steer_against_each_other():
    lisa = Driven("Lisa")
    assert motion(lisa, "forward")[0] > 0.2
    assert motion(lisa, "left")[3] > 2.0
    assert lisa.faults == []


def test_what_flies_climbs_and_turns():
    robot = Driven("AirRobot", height=2.0)
    assert motion(robot, "up")[2] > 0.5
    assert motion(robot, "level", "forward")[0] > 0.5
    assert motion(robot, "stop", "left")[3] > 10.0
    assert motion(robot, "down", seconds=2.0)[2] < 0.0
    blimp = Driven("Passarola", height=2.0)
    assert motion(blimp, "up", seconds=2.0)[2] > 0.2
    assert motion(blimp, "level", "forward", seconds=2.0)[0] > 0.1
    assert motion(blimp, "left", seconds=2.0)[3] > 5.0
    assert robot.faults == blimp.faults == []


@pytest.mark.parametrize(("action", "sign"), [("up", 1), ("down", -1)])
def test_what_dives_rises_and_sinks(action, sign):
    """It has tonnes: the way that it begins to go is told."""
    boat = Driven("Submarine", height=1.0, arena=DEEP)
    assert motion(boat, *["faster"] * 6, "forward")[0] > 1e-3
    ahead, _, up, left = motion(boat, "left", "left", "left", action, seconds=2.0)
    assert ahead > 5e-3
    assert left > 1e-3
    assert sign * up > 1e-5
    assert boat.faults == []


def view(driven):
    """Where a robot's camera looks: to the left and up of straight ahead [degrees]."""
    state = driven.world.state(driven.robot)
    body = np.asarray(mat_from_quat(np.array(state.quat)))
    ahead = body.T @ np.array(driven.world.viewpoint(CameraRequest(driven.robot, 0, 4, 4)).mat)[:, 0]
    return math.degrees(math.atan2(ahead[1], ahead[0])), math.degrees(math.asin(ahead[2]))


@pytest.mark.parametrize(("kind", "pans"), [("P2AT", True), ("AirRobot", False)])
def test_the_camera_turns_by_ten_degrees_the_way_that_keys_say(kind, pans):
    robot = Driven(kind)
    for action, sign, place in (
        ("pan_left", 1, 0),
        ("pan_right", -1, 0),
        ("tilt_up", 1, 1),
        ("tilt_down", -1, 1),
    ):
        before = view(robot)[place]
        robot.press(action, seconds=2.0)
        turned = view(robot)[place] - before
        assert turned == pytest.approx(10.0 * sign if pans or place else 0.0, abs=1.0), action
    for _ in range(9):
        robot.press("tilt_up")
    robot.run(4.0)
    low, high = robot.knowledge.packages["CameraPanTilt"][2 if pans else 1].limits
    assert view(robot)[1] == pytest.approx(math.degrees(high if pans else -low), abs=1.0), "no further"


def test_zooming_goes_to_the_limits_and_back():
    robot = Driven("P2AT")
    before = robot.robot.fovs[0]
    robot.press("zoom_in")
    assert robot.robot.fovs[0] == pytest.approx(0.8 * before, abs=1e-3)
    robot.press("zoom_out")
    assert robot.robot.fovs[0] == pytest.approx(before, abs=1e-3)
    robot.press(*["zoom_in"] * 20)
    assert robot.robot.fovs[0] == pytest.approx(robot.robot.cameras[0].min_fov, abs=1e-3)


def test_light_and_trace_are_switched():
    robot = Driven("P2AT")
    robot.press("light", seconds=0.3)
    assert bool(robot.robot.command.light)
    assert robot.knowledge.light
    robot.press("light")
    assert not bool(robot.robot.command.light)
    robot.press("trace", "forward", seconds=1.5)
    points = len(robot.world.traces.points)
    assert points >= 2
    robot.press("trace", seconds=1.0)
    assert len(robot.world.traces.points) == points


def test_what_cannot_be_driven_says_so():
    assert KeyDriver(Knowledge()).press("forward") == []
    assert KeyDriver(Knowledge()).problem() == NO_ROBOT
    walker = Driven("QRIO")
    assert walker.pilot.press("forward") == []
    assert walker.pilot.problem() == NO_DRIVE
    assert KeyDriver(Knowledge()).press("tilt_up") == KeyDriver(Knowledge()).press("zoom_in") == []


def test_every_key_does_something():
    assert set(DRIVING_KEYS.values()) == set(ACTIONS)


def test_links_turn_about_axes_that_follow_from_the_links_before():
    links = {1: PackageLink(-1, (math.pi, 0.0, 0.0)), 2: PackageLink(1, (math.pi / 2, 0.0, 0.0))}
    assert link_axis(links, 1) == pytest.approx((0, 0, -1), abs=1e-6)
    assert link_axis(links, 2) == pytest.approx((0, 1, 0), abs=1e-6)
    assert link_axis({1: PackageLink(1)}, 1) == pytest.approx((0, 0, 1)), "one that hangs on itself ends"


# Joysticks


def event(kind, number, value):
    return EVENT.pack(1, value, kind, number)


def test_a_stick_drives_as_far_as_it_is_pushed():
    robot = Driven("P2AT")
    stick = JoystickDriver(robot.pilot)
    assert stick.feed(event(AXIS | AT_FIRST, 1, 0)) == []
    assert stick.feed(event(AXIS, 1, -FULL)) == ["DRIVE {Normalized True} {Left 100} {Right 100}"]
    assert stick.feed(event(AXIS, 1, -FULL // 2)) == ["DRIVE {Normalized True} {Left 50} {Right 50}"]
    assert stick.feed(event(AXIS, 0, -FULL // 2)) == ["DRIVE {Normalized True} {Left 0} {Right 100}"]
    assert stick.feed(event(AXIS, 0, -FULL // 2 - 20)) == [], "a hand that trembles"
    whole = event(AXIS, 0, 0) + event(AXIS, 1, 3000)
    assert stick.feed(whole[:11]) == ["DRIVE {Normalized True} {Left 50} {Right 50}"]
    assert stick.feed(whole[11:]) == ["DRIVE {Normalized True} {Left 0} {Right 0}"], "in the dead zone"
    (tilt,) = stick.feed(event(AXIS, 7, -FULL))
    assert tilt.startswith("MISPKG {Name CameraPanTilt} {Link 2} {Value 0.17")
    (pan,) = stick.feed(event(AXIS, 6, FULL))
    assert pan.startswith("MISPKG {Name CameraPanTilt} {Link 1} {Value -0.17")
    assert stick.feed(event(BUTTON, 1, 1)) == ["DRIVE {Light True}"]
    assert stick.feed(event(BUTTON, 1, 0) + event(BUTTON, 9, 1)) == []


def test_a_device_file_is_read_until_it_goes(tmp_path):
    os.mkfifo(tmp_path / "js0")
    (tmp_path / "mouse0").touch()
    assert find_joystick(tmp_path) == tmp_path / "js0"
    assert find_joystick(tmp_path / "nowhere") is None

    async def read():
        taken = []
        device = JoystickDevice(tmp_path / "js0", taken.append)
        with open(tmp_path / "js0", "wb", buffering=0) as writer:
            writer.write(event(AXIS, 1, -FULL))
            while not taken:
                await asyncio.sleep(0.01)
        while b"" not in taken:
            await asyncio.sleep(0.01)
        device.close()
        return taken

    assert asyncio.run(read()) == [event(AXIS, 1, -FULL), b""]


def test_which_joystick_is_an_option(tmp_path):
    assert joystick_path("off", lambda: tmp_path) is None
    assert joystick_path("auto", lambda: tmp_path) == tmp_path
    assert joystick_path(str(tmp_path)) == tmp_path
    with pytest.raises(UsageError, match="expected auto, off or a device"):
        joystick_path("/dev/nothing")
