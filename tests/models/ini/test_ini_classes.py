"""Item classes that ini files derive from others, and keys of items that mean nothing."""

from dataclasses import replace

import pytest

from tests.models.ini.texts import load_texts
from usarmjx.base.errors import SpecError
from usarmjx.models.robots.pioneer import P2AT, P2DX
from usarmjx.sensors.cameras.mounts import carried_weight
from usarmjx.sensors.suite import suite_of
from usarmjx.server.gamebots.sensors import configuration
from usarmjx.server.protocol.grammar import format_message

BARE = replace(P2AT, sensors=(), cameras=())


@pytest.fixture
def load(tmp_path):
    return lambda *texts: load_texts(tmp_path, texts, (BARE, P2DX))


def robot_of(loaded):
    return {robot.name: robot for robot in loaded.robots}["P2AT"]


def only_settings(loaded):
    (sensor,) = suite_of(robot_of(loaded)).sensors
    return sensor.settings[0]


MINE = """
[USARBot.MyScanner]
BaseClass=class'USARBot.RangeScanner'
MaxRange=8.0
Resolution=0.0349
ScanFov=1.5708
Weight=1.1
"""
MOUNT = "[USARBot.P2AT]\nSensors=(ItemClass=class'USARBot.MyScanner',ItemName=Small{more})"


def test_a_scanner_with_other_numbers_is_a_class_of_its_own(load):
    loaded = load(MINE + MOUNT.format(more=""))
    assert loaded.warnings == ()
    (mount,) = robot_of(loaded).sensors
    assert (mount.kind, mount.name) == ("RangeScanner", "Small"), "an ItemType is inherited"
    settings = only_settings(loaded)
    assert (settings.max_range, settings.resolution, settings.scan_fov) == (8.0, 0.0349, 1.5708)
    assert settings.scan_interval == 0.5, "what it says nothing of is the base's (manual 10.3.2)"
    assert settings.beams == 46
    assert carried_weight(robot_of(loaded)) == pytest.approx(1.1)
    (line,) = configuration(robot_of(loaded), suite_of(robot_of(loaded)).sensors, (), "RangeScanner", "")
    assert "{Name Small} {MaxRange 8.0000}" in format_message(line)


def test_a_mount_overrides_its_class_which_overrides_the_bases_section(load):
    bases = "[USARBot.RangeScanner]\nMaxRange=30\nNoise=0.2\n"
    settings = only_settings(load(bases + MINE + MOUNT.format(more=",Weight=2.5")))
    assert (settings.max_range, settings.noise, settings.weight) == (8.0, 0.2, 2.5)


def test_classes_can_be_based_on_each_other_in_any_order_and_file(load):
    tiny = "[USARBot.Tiny]\nBaseClass=MyScanner\nScanFov=0.5\n"
    mount = MOUNT.format(more="").replace("MyScanner", "tiny")
    for texts in ((mount, tiny, MINE), (MINE + tiny + mount,), (tiny + mount, MINE)):
        settings = only_settings(load(*texts))
        assert (settings.max_range, settings.scan_fov) == (8.0, 0.5)
    later = "[USARBot.MyScanner]\nMaxRange=5.0\n"
    assert only_settings(load(MINE + MOUNT.format(more=""), later)).max_range == 5.0


def test_effecters_and_cameras_have_classes_too(load):
    text = """
[USARBot.Gun]
BaseClass=RFIDReleaser
Weight=0.7
[USARBot.Wide]
BaseClass=RobotCamera
CameraDefFov=1.2
[USARBot.P2AT]
Effecters=(ItemClass=class'USARBot.Gun',ItemName=Gun)
Cameras=(ItemClass=class'USARBot.Wide',ItemName=Eye)
"""
    robot = robot_of(load(text))
    assert (robot.effecters[0].kind, robot.cameras[0].kind) == ("RFIDReleaser", "Camera")
    assert dict(robot.cameras[0].options)["CameraDefFov"] == 1.2
    assert carried_weight(robot) == pytest.approx(0.7 + 0.4)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "[USARBot.A]\nBaseClass=Radar\nMaxRange=3",
            r"a\.ini:2: unknown BaseClass 'Radar'; .* item class",
        ),
        ("[USARBot.A]\nBaseClass=B\n[USARBot.B]\nBaseClass=A", r"a\.ini:\d: [AB] is based on itself"),
        (
            MINE.replace("8.0", "-8.0"),
            r"a\.ini:4: RangeScanner: MaxRange is -8\.0, expected a number",
        ),
        (MOUNT.format(more=""), r"a\.ini:2: unknown ItemClass 'MyScanner'; expected one of SonarSensor"),
        (
            MINE + MOUNT.format(more="").replace("MyS", "YourS"),
            "unknown ItemClass 'YourScanner'.*myscanner",
        ),
    ],
)
def test_a_class_that_cannot_be_says_why(load, text, says):
    with pytest.raises(SpecError, match=says):
        load(text)


def test_a_key_that_the_base_does_not_have_is_a_warning(load):
    (warning,) = load(MINE + "Range=3\n" + MOUNT.format(more="")).warnings
    assert "a.ini:8: unknown key: RangeScanner: ScannerSettings has no setting 'Range'" in warning


def test_an_ins_is_told_of_its_tire_in_vain_and_says_so(load):
    (warning,) = load("[USARBot.INS]\nRightTire=RightFWheel").warnings
    assert "a.ini:2: RightTire is ignored: an INS has no wheels" in warning
