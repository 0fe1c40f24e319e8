from dataclasses import replace

import pytest

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, field_name, options, resolve_settings
from usarmjx.sensors.cameras.mounts import CameraSettings
from usarmjx.sensors.motion import InsSettings, OdometrySettings
from usarmjx.sensors.ranging import ScannerSettings, SonarSettings
from usarmjx.sensors.suite import suite_of
from usarmjx.server.gamebots.sensors import configuration


@pytest.mark.parametrize(
    ("key", "field"),
    [
        ("MaxRange", "max_range"),
        ("bWithTimeStamp", "with_time_stamp"),
        ("HiddenSensor", "hidden_sensor"),
        ("ScanFov", "scan_fov"),
        ("ScanFOV", "scan_fov"),
        ("bPitch", "pitch"),
        ("Sigma", "sigma"),
        ("EncoderResolution", "encoder_resolution"),
        ("LeftTire", "left_tire"),
        ("BeamAngle", "beam_angle"),
    ],
)
def test_ini_keys_name_fields(key, field):
    assert field_name(key) == field


def test_defaults_are_the_manuals():
    """Manual 10.2.2, 10.3.2, 10.4.2, 10.6; MinRange from captured CONF lines."""
    sonar = resolve_settings(SonarSettings, (), "Sonar F1")
    assert (sonar.max_range, sonar.beam_angle, sonar.noise, sonar.weight) == (5.0, 0.3491, 0.05, 0.4)
    assert sonar.with_time_stamp
    scanner = resolve_settings(ScannerSettings, (), "RangeScanner S")
    assert (scanner.max_range, scanner.scan_interval, scanner.noise) == (1000.0, 0.5, 0.0)
    # Unreal's units: 65536 are a turn; 800 and 32768.
    assert scanner.resolution == pytest.approx(0.0767, abs=1e-4)
    assert scanner.scan_fov == pytest.approx(3.14159, abs=1e-5)
    assert (scanner.yaw, scanner.pitch) == (True, False)
    odometry = resolve_settings(OdometrySettings, (), "Odometry O")
    assert (odometry.scan_interval, odometry.encoder_resolution) == (0.2, 0.01)
    assert (odometry.left_tire, odometry.right_tire) == ("LeftFWheel", "RightFWheel")
    ins = resolve_settings(InsSettings, (), "INS I")
    assert (ins.scan_interval, ins.drifting, ins.precision, ins.sigma) == (0.2, False, 1000, 0.1)


def test_a_mount_overrides_what_it_names():
    mine = resolve_settings(SonarSettings, options(MaxRange=3.0, bWithTimeStamp=False), "Sonar F1")
    assert (mine.max_range, mine.with_time_stamp, mine.noise) == (3.0, False, 0.05)


def test_unknown_key_names_the_owner_and_lists_the_known_ones():
    with pytest.raises(
        UnknownNameError,
        match=r"Sonar F1: SonarSettings has no setting 'Range'; did you mean 'min_range'[?] It has: .*angle",
    ) as caught:
        resolve_settings(SonarSettings, options(Range=3.0), "Sonar F1")
    assert "max_range" in str(caught.value)


@pytest.mark.parametrize("bad", [{"MaxRange": True}, {"HiddenSensor": 1}, {"HiddenSensor": "yes"}])
def test_truth_values_and_numbers_are_not_mixed_up(bad):
    with pytest.raises(UsageError, match=f"Sonar F1: {next(iter(bad))} is "):
        resolve_settings(SonarSettings, options(**bad), "Sonar F1")


def test_a_whole_number_is_told_with_decimals_as_any_other():
    """`MaxRange=5` of a file: CONF has 5.0000 in captured lines, whatever was written."""
    mount = Mount(kind="RangeScanner", name="S", options=options(MaxRange=5))
    robot = replace(P2AT, sensors=(mount,), cameras=())
    (told,) = configuration(robot, suite_of(robot).sensors, (), "RangeScanner", "S")
    assert told.get("MaxRange") == "5.0000"
    fov = resolve_settings(CameraSettings, options(CameraDefFov=1), "Camera C").camera_def_fov
    assert isinstance(fov, float), "of cameras too"
