"""Bad configuration is refused by the name of item and key, whether it comes as data or from an ini file."""

import math
from dataclasses import fields, replace

import pytest

from usarmjx.base.errors import SpecError
from usarmjx.base.settings import describe
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, checked, options, resolve_settings
from usarmjx.sensors.base import SENSORS
from usarmjx.sensors.suite import suite_of
from usarmjx.sim.configure import configure, settings_by_kind

SENSOR_KINDS = sorted(kind for kind, _ in SENSORS)
SECTIONS = {
    "Sonar": "SonarSensor",
    "IR": "IRSensor",
    "Odometry": "OdometrySensor",
    "GPS": "GPSSensor",
    "Encoder": "EncoderSensor",
    "Touch": "TouchSensor",
    "RFID": "RFIDSensor",
    "Sound": "SoundSensor",
    "HumanMotion": "HumanMotionSensor",
}

# Type, keys, and what the message says behind the item's name.
WRONG = [
    ("Sonar", {"MaxRange": -5.0}, "MaxRange is -5.0, expected a number above 0"),
    ("Sonar", {"MaxRange": 0.0}, "MaxRange is 0.0, expected a number above 0"),
    ("Sonar", {"MinRange": -0.1}, "MinRange is -0.1, expected a number from 0"),
    ("Sonar", {"MinRange": 7.0}, "MinRange is 7, expected at most MaxRange, 5"),
    ("Sonar", {"MinRange": 2.0, "MaxRange": 1.0}, "MinRange is 2, expected at most MaxRange, 1"),
    ("Sonar", {"BeamAngle": 4.0}, "BeamAngle is 4.0, expected a number from 0 to 3.1416"),
    ("Sonar", {"BeamAngle": -0.1}, "BeamAngle is -0.1, expected a number from 0 to 3.1416"),
    ("Sonar", {"Noise": -0.05}, "Noise is -0.05, expected a number from 0"),
    ("Sonar", {"Sigma": -0.05}, "Sigma is -0.05, expected a number from 0"),
    ("IR", {"MaxRange": -1.0}, "MaxRange is -1.0, expected a number above 0"),
    ("IR", {"ScanInterval": -1.0}, "ScanInterval is -1.0, expected a number from 0"),
    ("RangeScanner", {"ScanFov": 6.4}, "ScanFov is 6.4, expected a number above 0 to 6.2832"),
    ("RangeScanner", {"ScanFov": 0.0}, "ScanFov is 0.0, expected a number above 0 to 6.2832"),
    ("RangeScanner", {"Resolution": 0.0}, "Resolution is 0.0, expected a number from 1e-05"),
    ("RangeScanner", {"Resolution": 2e-5}, "that makes 157080 beams, expected up to 65536"),
    ("RangeScanner", {"bPitch": True}, "exactly one of bYaw and bPitch must be true"),
    ("IRScanner", {"ScanFov": 7.0}, "ScanFov is 7.0, expected a number above 0 to 6.2832"),
    ("IRScanner", {"Resolution": -0.1}, "Resolution is -0.1, expected a number from 1e-05"),
    ("IRScanner", {"MinRange": 2e3}, "MinRange is 2000, expected at most MaxRange, 1000"),
    ("RangeScanner3D", {"HorizontalFOV": 6.4}, "HorizontalFOV is 6.4, expected a number above 0"),
    ("RangeScanner3D", {"VerticalFOV": 3.2}, "VerticalFOV is 3.2, expected a number from 0 to 3.14"),
    ("RangeScanner3D", {"VerticalResolution": 1e-4, "HorizontalResolution": 1e-3}, "beams, expected up to"),
    ("Odometry", {"EncoderResolution": 0.0}, "EncoderResolution is 0.0, expected a number from 1e-05"),
    ("Odometry", {"ScanInterval": -0.2}, "ScanInterval is -0.2, expected a number from 0"),
    ("Odometry", {"DiameterError": -1.0}, "DiameterError is -1.0, expected a number above -1"),
    ("GPS", {"maxNoise": -1.0}, "maxNoise is -1.0, expected a number from 0"),
    ("GPS", {"minNoise": 3.0}, "minNoise is 3, expected at most maxNoise, 2.5"),
    ("GPS", {"LatitudeScale": 0.0}, "LatitudeScale is 0, expected at least 1 or at most -1"),
    ("GPS", {"ZeroZeroLocation": options(LatitudeDegree=math.nan)}, "LatitudeDegree is nan, expected a n"),
    ("INS", {"Sigma": -0.1}, "Sigma is -0.1, expected a number from 0"),
    ("INS", {"Precision": 0.0}, "Precision is 0.0, expected a number above 0"),
    ("Encoder", {"Resolution": 0.0}, "Resolution is 0.0, expected a number from 1e-05"),
    ("Encoder", {"Noise": -1.0}, "Noise is -1.0, expected a number from 0"),
    ("Touch", {"Diameter": 0.0}, "Diameter is 0.0, expected a number above 0"),
    ("RFID", {"SensingMode": "Magic"}, "'Magic', expected one of Radius, Obstacle, Attenuation"),
    ("RFID", {"MaxRange": -3.0}, "MaxRange is -3.0, expected a number from 0"),
    ("RFID", {"dBObstacleAttenuation": -1.0}, "dBObstacleAttenuation is -1.0, expected a number from 0"),
    ("VictSensor", {"Distance": -6.0}, "Distance is -6.0, expected a number above 0"),
    ("VictSensor", {"HorizontalFOV": 6.4}, "HorizontalFOV is 6.4, expected a number above 0 to 6.2832"),
    ("VictSensor", {"VerticalStep": 0.0}, "VerticalStep is 0.0, expected a number from 1e-05"),
    ("VictSensor", {"VerticalStep": 1e-4, "HorizontalStep": 1e-4}, "beams, expected up to 65536"),
    ("Sound", {"Noise": -0.1}, "Noise is -0.1, expected a number from 0"),
    ("Sound", {"OutputCurve": ((1.0, 0.0), (1.0, 2.0))}, "OutputCurve are .*, expected finite ones with"),
    ("HumanMotion", {"FOV": 0.0}, "FOV is 0.0, expected a number above 0 to 65535"),
    ("HumanMotion", {"MaxRange": -1.0}, "MaxRange is -1.0, expected a number above 0"),
    ("GroundTruth", {"ScanInterval": -0.05}, "ScanInterval is -0.05, expected a number from 0"),
    ("CO2Sensor", {"Noise": -0.1}, "Noise is -0.1, expected a number from 0"),
]  # fmt: skip
IN_FILES = [
    row for row in WRONG if not any(isinstance(value, tuple) or value == 0.0 for value in row[1].values())
]


def robot(kind, keys):
    """A P2AT with one sensor; an encoder sits on a wheel."""
    parent = "LeftFWheel" if kind == "Encoder" else "HARD"
    mount = Mount(kind=kind, name="Mine", parent=parent, options=options(**keys))
    return replace(P2AT, name="Configured", sensors=(mount,))


@pytest.mark.parametrize(("kind", "keys", "says"), WRONG, ids=[f"{k} {v}" for k, v, _ in WRONG])
def test_data_that_makes_no_sense_are_refused_by_item_and_key(kind, keys, says):
    with pytest.raises(SpecError, match=rf"{kind}.*{says}"):
        suite_of(robot(kind, keys))


@pytest.fixture
def own_robots(monkeypatch):
    """What a test puts into the registry of robots leaves with it."""
    monkeypatch.setattr(ROBOTS, "_entries", dict(ROBOTS._entries))
    return ROBOTS


@pytest.mark.parametrize(("kind", "keys", "says"), IN_FILES, ids=[f"{k} {v}" for k, v, _ in IN_FILES])
def test_so_they_are_in_an_ini_file_and_nothing_changes(kind, keys, says, own_robots, tmp_path):
    path, before = tmp_path / "a.ini", dict(own_robots)
    lines = [f"{key}={value}" for key, value in keys.items()]
    section = f"USARBot.{SECTIONS.get(kind, kind)}"
    item = f"AddSensors=(ItemClass=class'{section}',ItemName=Mine,Parent=LeftFWheel)"
    path.write_text("\n".join([f"[{section}]", *lines, "[USARBot.P2AT]", item]))
    with pytest.raises(SpecError, match=rf"a\.ini.*{kind}.*{says}"):
        configure([path])
    assert dict(own_robots) == before


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("kind", SENSOR_KINDS)
def test_no_number_of_any_sensor_may_be_infinite_or_none(kind, bad):
    settings = SENSORS.get(kind).settings_class
    numbers = [f for f in fields(settings) if isinstance(f.default, float)]
    assert numbers
    for field in numbers:
        with pytest.raises(SpecError, match=f"{kind} X: {field.name} is {bad!r}, expected"):
            resolve_settings(settings, ((field.name, bad),), f"{kind} X")


@pytest.mark.parametrize("bad", [6.3e-45, -1e-39, 1.17e-38])
def test_a_number_that_single_precision_may_take_for_zero_is_refused(bad):
    with pytest.raises(
        SpecError,
        match=f"Sonar X: Mean is {bad!r}, expected .* magnitudes from 1.2e-38",
    ):
        resolve_settings(settings_by_kind()["Sonar"], options(Mean=bad), "Sonar X")


@pytest.mark.parametrize("kind", SENSOR_KINDS)
def test_the_defaults_of_every_sensor_are_allowed(kind):
    settings = SENSORS.get(kind).settings_class
    given = tuple((f.name, f.default) for f in fields(settings))
    assert resolve_settings(settings, given, kind) == settings()
    assert {"weight", "scan_interval"} <= {one.name for one in describe(settings) if one.note.ge == 0}, (
        "limits are inherited"
    )


def test_one_key_alone_is_checked_for_itself_only():
    """A file's line may say MinRange=7 before another says MaxRange=9."""
    settings = settings_by_kind()["Sonar"]
    assert checked(settings, options(MinRange=7.0), "Sonar") == {"min_range": 7.0}
    assert resolve_settings(settings, options(MinRange=7.0, MaxRange=9.0), "Sonar").min_range == 7.0
