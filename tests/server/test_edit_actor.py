"""`editactor`: parameters of robots and sensors change while they run; what cannot be is one clear line."""

import contextlib
import shlex

import numpy as np
import pytest

from tests.arenas import COURSE
from tests.server.still_world import CLASS, StillWorld
from usarmjx.base.errors import UsageError
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.cameras.mounts import CameraSettings
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.viewing.console import PARAMETERS, edit_actor
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.control import CommandUpdate

P2AT, HUMMER = ROBOTS.get("P2AT"), ROBOTS.get("Hummer")


@pytest.fixture
def world():
    world = DynamicWorld(COURSE, seed=1)
    world.spawn(P2AT, "R1", (-1.0, -2.0, 0.3), (0.0, 0.0, 0.0))
    world.spawn(P2AT, "R2", (-1.0, -4.0, 0.3), (0.0, 0.0, 0.0))
    return world


def edit(world, text):
    return edit_actor(world, shlex.split(text))


def robot(world, name):
    return next(one for one in world.robots.values() if one.name == name)


def reading(world, one, kind, steps=1):
    """What a sensor says after so many steps."""
    for _ in range(steps):
        world.step()
        world.observe([one])
    return one.pending[one.suite.index(kind)]


def distance(world, one, seconds):
    """How far a robot drives with all wheels at 5 rad/s."""
    world.update_command(one, CommandUpdate(drive={"Left": 5.0, "Right": 5.0}))
    before = np.array(world.state(one).pos)
    for _ in range(round(seconds / world.period)):
        world.step()
    return float(np.linalg.norm(np.array(world.state(one).pos) - before)[()])


def test_a_sensors_range_is_that_of_its_next_reading_and_nobody_elses(world):
    one, other = robot(world, "R1"), robot(world, "R2")
    before = reading(world, one, "Sonar"), reading(world, other, "Sonar")
    assert max(before[0]) == 5.0
    told = edit(world, "name=R1 class=Sonar MaxRange=0.7 Noise=0")
    assert told.startswith("R1: Sonar F1 F2")
    assert "MaxRange=0.7" in told
    assert max(reading(world, one, "Sonar")) == np.float32(0.7)
    assert max(reading(world, other, "Sonar")) == 5.0
    edit(world, "name=R1 sensor=f1 maxrange=0.4")
    assert list(reading(world, one, "Sonar")[:2]) == [np.float32(0.4), np.float32(0.7)]


def test_a_scan_interval_is_that_of_the_next_scans(world):
    one = robot(world, "R1")
    scanner = one.suite.index("RangeScanner")

    def scans(steps):
        count = 0
        for _ in range(steps):
            world.step()
            one.pending.clear()
            world.observe([one])
            count += scanner in one.pending
        return count

    assert scans(1) == 1
    assert scans(100) == 4
    edit(world, "name=R1 sensor=Scanner1 ScanInterval=0.1")
    assert scans(100) == pytest.approx(20, abs=1)


def test_a_robots_speed_mass_and_battery(world):
    one, other = robot(world, "R1"), robot(world, "R2")
    assert distance(world, one, 1.0) > 0.4
    told = edit(world, "name=R1 maxSpinSpeed=1 ChassisMass=2 battery=100")
    assert told.split("; ")[0].endswith("ChassisMass=2 MaxTorque=60 maxSpinSpeed=1")
    distance(world, one, 0.4)
    assert distance(world, one, 1.0) == pytest.approx(1.0 * P2AT.wheel_radius, rel=0.15)
    assert distance(world, other, 1.0) > 0.4
    assert world.battery(one) == pytest.approx(100.0 - 2.4, abs=0.1)
    assert world.battery(other) > 1000.0
    edit(world, "class=P2AT ChassisMass=2")
    model, (first, second) = world.scene.model, [group.indices[0] for group in world.scene.groups]
    masses = [model.body_mass[index.body_ids[0]] for index in (first, second)]
    assert masses[0] == pytest.approx(masses[1]), "twice what the class says, not twice as much again"


def test_reports_come_as_often_as_said_and_a_camera_looks_as_wide(world):
    one = robot(world, "R1")
    edit(world, "class=KRobot msgTimer=0.5")
    assert [each.spec.msg_timer for each in world.robots.values()] == [0.5, 0.5]
    edit(world, "name=R1 sensor=Camera CameraDefFov=1.2")
    assert one.fovs == [pytest.approx(1.2)]
    edit(world, "name=R1 sensor=Camera CameraDefFov=0.9 CameraMaxFov=1.0")
    assert one.fovs == [pytest.approx(0.9)]
    world.zoom(one, 0, 2.0)
    assert one.fovs == [pytest.approx(1.0)]
    assert robot(world, "R2").fovs == [CameraSettings.camera_def_fov]


def test_without_a_parameter_it_shows_those_that_there_are(world):
    assert edit(world, "name=R1").startswith(
        "R1 (P2AT): Battery=3600 batteryLife=3600 msgTimer=0.2 Weight=14"
    )
    lines = edit(world, "class=RangeScanner").splitlines()
    assert [line[:26] for line in lines] == ["R1: RangeScanner Scanner1:", "R2: RangeScanner Scanner1:"]
    assert "MaxRange=20" in lines[0]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "say which one: editactor .class=CLASS."),
        ("R1", "'R1' is not of the form KEY=VALUE"),
        ("name=R9", "nothing here is name=R9; robots: R1 .P2AT., R2 .P2AT.; on them: Camera Camera"),
        ("class=Talon", "nothing here is class=Talon; robots: R1"),
        ("name=R1 sensor=F9", "nothing here is name=R1 sensor=F9"),
        (
            "name=R1 Colour=3",
            "a robot has no parameter 'Colour'; those that can be changed: Battery, batteryLife",
        ),
        ("class=Sonar Range=3", "Sonar F1 has no parameter 'Range'; those that can be changed: HiddenSensor"),
        ("class=Sonar Weight=3", "Sonar F1 has no parameter 'Weight'"),
        ("class=Sonar MaxRange=-1", "MaxRange is -1.0, expected a number above 0"),
        ("class=Sonar MaxRange=nan", "MaxRange is nan, expected a number above 0"),
        ("class=Sonar MaxRange=far", "MaxRange is 'far', expected a number"),
        ("class=Sonar MaxRange=" + "9" * 400, "9{30} is out of reach: settings go to 1e[+]06 and -1e[+]06"),
        ("class=INS Mean=-1e30", "-1e30 is out of reach"),
        ("class=Sonar MinRange=9", "MinRange is 9, expected at most MaxRange, 5"),
        ("sensor=F1 ScanInterval=1", "all Sonar sensors report together"),
        ("name=R1 sensor=Camera CameraDefFov=3", "expected 0 < CameraMinFov <= CameraDefFov"),
        ("name=R1 maxSpinSpeed=1e9", "maxSpinSpeed is '1e9', expected a number from 0.001 to 1000"),
        ("name=R1 Battery=x", "Battery is 'x', expected a number from 0"),
        ("name=R1 SteerSpeed=100", "SteerSpeed changes nothing: P2AT has no joint that it is about"),
    ],
)
def test_what_cannot_be_is_one_clear_line_and_changes_nothing(world, text, told):
    before = {one.name: one.spec for one in world.robots.values()}
    with pytest.raises(UsageError, match=told) as found:
        edit(world, text)
    assert "\n" not in str(found.value)
    assert {one.name: one.spec for one in world.robots.values()} == before


def test_all_robots_change_or_none(world):
    """A Hummer steers, a P2AT does not."""
    world.spawn(HUMMER, "H", (-1.0, 4.0, 1.0), (0.0, 0.0, 0.0))
    with pytest.raises(UsageError, match="SteerTorque changes nothing: P2AT"):
        edit(world, "class=KRobot SteerTorque=500")
    assert robot(world, "H").spec == HUMMER
    assert "SteerTorque=500" in edit(world, "name=H SteerTorque=500")


@pytest.mark.parametrize("key", list(PARAMETERS))
def test_every_figure_can_be_changed_and_the_world_stays_sound(world, key):
    """To the smallest and the largest value; a Hummer steers and has springs, a kenaf has flippers."""
    steered = world.spawn(HUMMER, "H", (-1.0, 4.0, 1.0), (0.0, 0.0, 0.0))
    armed = world.spawn(ROBOTS.get("kenaf"), "K", (-4.0, 4.0, 0.4), (0.0, 0.0, 0.0))
    one = armed if key.startswith("Motor") else steered
    for value in PARAMETERS[key]:
        assert f"{key}={value:g}" in edit(world, f"name={one.name} {key}={value}")
        world.update_command(one, CommandUpdate(drive={one.spec.drive.keys[0]: 1.0}))
        for _ in range(5):
            world.step()
        assert world.recovery_log.put_back == 0
        assert np.isfinite(np.asarray(world.one_world()[1].qpos)).all()


@pytest.mark.parametrize("value", ["1e6", "-1e6", "1e-9"])
@pytest.mark.parametrize("key", ["Mean", "Sigma", "Precision"])
def test_the_largest_settings_can_still_be_reported(world, key, value):
    """Who edits must not end the server: a number that is not finite cannot be sent."""
    client = Client(world, "tests")
    client.robot = robot(world, "R1")
    with contextlib.suppress(UsageError):
        edit(world, f"name=R1 class=INS {key}={value}")
    for _ in range(30):
        world.step()
        world.observe([client.robot])
    client.report()
    assert b"{Type INS}" in client.session.data_to_send()


def test_compiled_worlds_say_that_they_cannot():
    world = StillWorld()
    world.spawn(ROBOTS.get(CLASS), "R1", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    with pytest.raises(UsageError, match="R1 is compiled: only in a world of engine c"):
        edit(world, "name=R1 msgTimer=1")
