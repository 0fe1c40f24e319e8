"""What people at the page may do and see beside the picture, by messages that their browsers would send."""

import math
import re
import time
from functools import partial

import numpy as np
import pytest
from viser import _messages

from tests.arenas import FLAT
from tests.view.visitor import PATIENCE, until, visiting
from usarmjx.models.robots import ROBOTS
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.view import user_panels as people_module
from usarmjx.view.controls import BY_CLIENT, BY_PAGE, ControlLock, StartPoseChoice, WorldStatus
from usarmjx.view.drawing import RobotFrame
from usarmjx.view.page import ViewerPage
from usarmjx.view.robot_controls import DIRECTIONS, HOLD_TIMEOUT, DrivePad, pad_html
from usarmjx.view.user_panels import MAX_POINTS, TAKE, WINDOW, SensorPlot, UserPanels, banner_html, state_html

CLASSES = ("Talon", "kenaf", "AirRobot", "ERS", "UnitLoader")
TALON, KENAF, DRONE, DOG, LOADER = range(len(CLASSES))
STARTS = [StartPoseChoice("S0", (1.0, 2.0, 0.0), 0.5)]


class Noted:
    """Controls that note what they are asked for."""

    classes = ("P2AT", "Zerg")
    reset_about = "All begins anew."

    def __init__(self):
        self.asked = []
        self.now = WorldStatus(time=1.0, drivers={TALON: BY_CLIENT, KENAF: BY_PAGE})

    def status(self, world):
        return self.now

    def starts(self, world):
        return STARTS

    def __getattr__(self, name):
        return lambda *args, **kwargs: self.asked.append((name, *args, *kwargs.values()))


@pytest.fixture(scope="module")
def world():
    world = DynamicWorld(FLAT, max_robots=len(CLASSES))
    for number, name in enumerate(CLASSES):
        world.spawn(ROBOTS.get(name), f"R{number}", (2.0 * number - 4.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    world.step()
    return world


@pytest.fixture
def controls():
    return Noted()


@pytest.fixture
def lock():
    return ControlLock()


@pytest.fixture
def page(world, controls, lock, monkeypatch):
    monkeypatch.setattr(people_module, "UPDATE_PERIOD", 0.0)
    page = ViewerPage(ServedSource([world]), controls=controls, panels=[partial(UserPanels, lock=lock)])
    yield page
    page.close()


def port_of(page):
    return page.server.get_port()


def uuid_of(visitor, label):
    """The newest element of that label that a visitor has; a panel's elements come one by one."""
    end = time.monotonic() + PATIENCE
    while label not in labels(visitor):
        assert time.monotonic() < end, f"nothing is called {label}"
        time.sleep(0.01)
    found = [m for m in list(visitor.heard) if m["type"].startswith("Gui") and "props" in m]
    return [m["uuid"] for m in found if m["props"].get("label") == label][-1]


def labels(visitor):
    found = [m for m in list(visitor.heard) if m["type"].startswith("Gui") and "props" in m]
    return [m["props"].get("label") for m in found]


def options(visitor):
    """All lists of robots that a visitor has been given to choose from."""
    updates = [m["updates"] for m in list(visitor.heard) if "updates" in m]
    return [list(update["options"]) for update in updates if "options" in update]


def say(visitor, label, value=True):
    visitor.say(_messages.GuiUpdateMessage(uuid=uuid_of(visitor, label), updates={"value": value}))


def take(page, visitor, robot=None):
    """Let a visitor take the controls, and choose a robot."""
    until(page, lambda: TAKE in labels(visitor))
    say(visitor, TAKE)
    until(page, lambda: "Pause" in labels(visitor))
    if robot is not None:
        say(visitor, "Robot", f"R{robot}")
        until(page, lambda: "Take over" in labels(visitor))


def asked(page, controls, *expected):
    until(page, lambda: expected in controls.asked)


# Who may


def test_only_who_has_the_controls_can_do_anything(page, controls, lock):
    with visiting(port_of(page)) as one, visiting(port_of(page)) as other:
        take(page, one)
        until(page, lambda: TAKE in labels(other))
        assert "Pause" not in labels(other)
        say(other, TAKE)  # its button is out of sight, but a page can send what it likes
        other.say(_messages.GuiUpdateMessage(uuid=uuid_of(one, "Single step"), updates={"value": True}))
        say(one, "Pause")
        asked(page, controls, "pause", True)
        assert controls.asked == [("pause", True)]
        before = uuid_of(one, "Single step")
        say(one, TAKE)  # the same button, which by now gives them back
        until(page, lambda: lock.holder is None)
        one.say(_messages.GuiUpdateMessage(uuid=before, updates={"value": True}))
        asked(page, controls, "release_all")
        take(page, other)
        say(other, "Single step")
        asked(page, controls, "step")
        assert controls.asked.count(("step",)) == 1, "who has given the controls back cannot step"


def test_who_goes_gives_the_controls_back_and_lets_go(page, controls, lock):
    with visiting(port_of(page)) as one:
        take(page, one)
    until(page, lambda: lock.holder is None)
    assert controls.asked == [("release_all",)]


def test_where_nobody_may_there_is_no_button(world, controls):
    lock = ControlLock(allowed=False)
    page = ViewerPage(ServedSource([world]), controls=controls, panels=[partial(UserPanels, lock=lock)])
    try:
        with visiting(port_of(page)) as one:
            until(page, lambda: TAKE in labels(one))
            shown = [m for m in one.of("GuiButtonMessage") if m["props"]["label"] == TAKE]
            assert [m["props"]["visible"] for m in shown] == [False]
            say(one, TAKE)
            time.sleep(0.1)
            until(page, lambda: True)
            assert lock.holder is None
    finally:
        page.close()


def test_what_cannot_be_done_is_told_to_who_asked(page, controls):
    with visiting(port_of(page)) as one, visiting(port_of(page)) as other:
        take(page, one)
        until(page, lambda: TAKE in labels(other))
        controls.now = WorldStatus(time=2.0, errors=1, last_error="no seat left")
        until(page, lambda: one.of("NotificationShowMessage") or one.of("NotificationMessage"))
        told = [m for m in list(one.heard) if "no seat left" in str(m)]
        assert len(told) == 1
        assert not [m for m in list(other.heard) if "no seat left" in str(m)]


# What


def test_worlds_pause_step_change_their_speed_and_are_reset_after_a_question(page, controls):
    with visiting(port_of(page)) as one:
        take(page, one)
        say(one, "Speed", "x 2")
        asked(page, controls, "set_speed", 2.0)
        say(one, "Reset")
        until(page, lambda: "Reset it" in labels(one))
        assert "reset" not in {order for order, *_ in controls.asked}
        say(one, "Reset it")
        asked(page, controls, "reset", 0)


def test_a_robot_is_put_where_the_form_says(page, controls):
    with visiting(port_of(page)) as one:
        take(page, one)
        say(one, "Class", "Zerg")
        say(one, "Name", "Z1")
        say(one, "Spawn")
        asked(page, controls, "spawn", 0, "Zerg", "Z1", STARTS[0].pos, 0.5)
        say(one, "Place", "at x, y")
        say(one, "x, y [m]", (1.5, -0.5))
        say(one, "Direction [deg]", 90)
        say(one, "Spawn")
        asked(page, controls, "spawn", 0, "Zerg", "Z1", (1.5, -0.5, 0.0), math.pi / 2)


def test_a_robot_of_an_arm_has_sliders_for_all_that_moves(page, controls):
    with visiting(port_of(page)) as one:
        take(page, one, TALON)
        say(one, "TalonArm_Link1 [rad]", 0.3)
        asked(page, controls, "set_joint", 0, TALON, "TalonArm_Link1", 0.3)
        say(one, "Headlight", True)
        asked(page, controls, "set_light", 0, TALON, True)
        say(one, "Camera zoom [deg]", 60.0)
        asked(page, controls, "zoom", 0, TALON, "Camera", math.radians(60.0))
        say(one, "Open", 1.0)  # first the button, whose slider of that name comes before it
        asked(page, controls, "operate", 0, TALON, "Gripper", "Open", 1.57)
        assert not [label for label in labels(one) if label and "Wheel" in label]
        say(one, "Take over")
        asked(page, controls, "take_over", 0, TALON, True)
        say(one, "Remove")
        until(page, lambda: "Remove it" in labels(one))
        say(one, "Remove it")
        asked(page, controls, "remove", 0, TALON, True)


@pytest.mark.parametrize(
    ("robot", "there", "missing"),
    [
        (KENAF, "FRFlipper [rad]", "drive up"),
        (DRONE, "drive up", "drive hover"),
        (DOG, "LeftFKnee [rad]", "drive ahead"),
        (LOADER, "RollerTable Roller", "Camera zoom [deg]"),
    ],
)
def test_each_robot_has_what_it_has(page, robot, there, missing):
    with visiting(port_of(page)) as one:
        take(page, one, robot)
        until(page, lambda: there in labels(one))
        assert missing not in labels(one)


def test_a_robot_of_the_page_leaves_without_a_question(page, controls):
    with visiting(port_of(page)) as one:
        take(page, one, KENAF)
        say(one, "Remove")
        asked(page, controls, "remove", 0, KENAF)


def test_held_arrows_drive_and_others_stop(page, controls):
    full = ROBOTS.get("kenaf").drive.full_scale["Left"]
    with visiting(port_of(page)) as one:
        take(page, one, KENAF)
        say(one, "Speed [%]", 100)
        one.say(_messages.GuiButtonHoldMessage(uuid=uuid_of(one, "drive ahead"), frequency=10.0))
        asked(page, controls, "drive", 0, KENAF, {"Left": full, "Right": full})
        say(one, "drive ahead")
        asked(page, controls, "drive", 0, KENAF, {"Left": 0.0, "Right": 0.0})


# What is seen


def test_the_state_and_readings_of_the_chosen_robot_are_told(page, world):
    with visiting(port_of(page)) as one:
        until(page, lambda: "Robot" in labels(one))
        say(one, "Robot", "R0")
        until(page, lambda: "Sensors" in labels(one))
        until(page, lambda: any("by its client" in str(m) for m in list(one.heard)))
        titles = [m["props"]["title"] for m in one.of("GuiUplotMessage")]
        assert [title.split()[0] for title in titles] == ["Odometry", "INS", "GroundTruth"]


def test_a_robot_that_goes_is_no_longer_offered(page, world):
    with visiting(port_of(page)) as one:
        until(page, lambda: "Robot" in labels(one))
        robot = world.robots[LOADER]
        world.remove(robot)
        try:
            until(page, lambda: ["none", "R0", "R1", "R2", "R3"] in options(one))
        finally:
            world.spawn(robot.spec, "R4", (4.0, 0.0, 1.0), (0.0, 0.0, 0.0))


def test_the_banner_tells_what_went_wrong():
    status = WorldStatus(
        time=12.34,
        realtime_factor=0.5,
        connections=3,
        bad_worlds=2,
        put_back=4,
        put_back_names=("R1", "<b>crate"),
    )
    text = re.sub(r"<[^>]*>", " ", banner_html(status, ControlLock()))
    assert "12.3 s" in text
    assert "x 0.50 real time" in text
    assert "3 clients connected" in text
    assert "reset 2 times" in text
    assert "4 put back, last R1, &lt;b&gt;crate" in text


def test_names_cannot_bring_html_into_the_page(world):
    drawn = ServedSource([world]).drawing(0).robots[TALON]
    frame = RobotFrame(
        pos=np.zeros(3),
        quat=np.array([math.cos(0.5), 0.0, 0.0, math.sin(0.5)]),
        linear=np.array([3.0, 4.0, 0.0]),
        angular=np.zeros(3),
        joint_pos=np.zeros(len(drawn.joints)),
        battery=drawn.battery_life / 10,
        light=True,
        drive=np.array([1.0, -2.0]),
        readings=(),
        fovs=np.zeros(4),
    )
    text = state_html(drawn, frame, driver="<script>")
    assert "<script>" not in text
    assert "5.00 m/s" in text
    assert "10 %" in text
    assert "Left 1, Right -2" in text
    assert f"0, 0, {math.degrees(1.0):.0f}" in text


class Gui:
    """Takes the place of a person's GUI."""

    def __init__(self):
        self.data = []

    def add_uplot(self, data, series, **_):
        assert len(data) == len(series)
        return self

    def __setattr__(self, name, value):
        self.data.append(value) if name == "data" and "data" in self.__dict__ else super().__setattr__(
            name, value
        )


def test_few_numbers_are_plotted_over_time_and_many_over_their_index():
    few, many = Gui(), Gui()
    plot = SensorPlot(few, "INS", 3)
    for second in range(40):
        plot.update(float(second), np.array([1.0, second, np.inf]))
    times, ones, seconds, bad = few.data[-1]
    np.testing.assert_array_equal(times, np.arange(40 - WINDOW - 1, 40))
    np.testing.assert_array_equal(seconds, times)
    assert (ones == 1.0).all()
    assert np.isnan(bad).all()
    plot.update(0.0, np.zeros(3))
    plot.update(1.0, np.zeros(3))
    assert list(few.data[-1][0]) == [0.0, 1.0], "time began again"
    for _ in range(MAX_POINTS):
        plot.update(1.0, np.ones(3))
    assert list(few.data[-1][0]) == [0.0, 1.0], "while it stands still nothing is forgotten"
    SensorPlot(many, "Scan", 1081).update(0.0, np.arange(1081.0))
    numbers, ranges = many.data[-1]
    assert len(numbers) == len(ranges) <= MAX_POINTS
    assert ranges[1] == 1081 // MAX_POINTS + 1


class Pad(DrivePad):
    """A pad without a page."""

    def __init__(self):
        self._held, self.told = {}, []
        self._steer = lambda *order: self.told.append(order)


def test_directions_add_up_and_are_forgotten_when_nothing_is_heard():
    pad = Pad()
    pad.hold("ahead", 0.0)
    pad.hold("left", 0.1)
    pad.hold("up", 0.1)
    assert pad.told[-1] == (1.0, 1.0, 1.0)
    pad.release("up", 0.2)
    pad.hold("right", 0.1 + HOLD_TIMEOUT)
    assert pad.told[-1] == (0.0, -1.0, 0.0)
    pad.release("right", 0.2 + HOLD_TIMEOUT)
    assert pad.told[-1] == (0.0, 0.0, 0.0)
    count = len(pad.told)
    pad.release("right", 1.0)
    assert len(pad.told) == count, "nothing was held"


def test_the_pad_has_an_arrow_for_each_direction_and_hides_what_it_holds():
    flat = pad_html({name: f"u-{name}" for name in ("ahead", "left", "right", "back")})
    assert re.findall(r'aria-label="(\w+)" style', flat) == ["ahead", "left", "right", "back"]
    assert "KeyR" not in flat
    assert 'div:has(> [id="u-left"])' in flat
    assert "KeyR" in pad_html({name: f"u-{name}" for name in DIRECTIONS})
