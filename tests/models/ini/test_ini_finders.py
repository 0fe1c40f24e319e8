"""Sensors for victims and tags from ini files: the manual's excerpts (10.9.2, 10.10.2, 10.11.2, 10.12.2)."""

from pathlib import Path

import pytest

from usarmjx.base.registry import Registry
from usarmjx.models.ini.robots import load_robots
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.sensors.rfid import RfidSettings
from usarmjx.sensors.suite import suite_of
from usarmjx.sensors.victim import HumanMotionSettings, SoundSettings, VictSensorSettings
from usarmjx.sim.configure import settings_by_kind

CURVE = "OutputCurve=(Points=((InVal=0.000000,OutVal=0.000000),(InVal=1000.000000,OutVal=1000.000000)))"
EXCERPTS = {
    "RFID": (
        "RFIDSensor",
        """SensingMode=Obstacle
MaxRange=2
MaxSingleShotRange=5
dBmTXPower=30
dBmRXSensibility=-80
dBObstacleAttenuation=4
bTraceRFIDs=true
bAlwaysReadRFIDmem=true
HiddenSensor=false
bWithTimeStamp=true
Weight=0.5""",
        RfidSettings(
            sensing_mode="Obstacle",
            max_range=2.0,
            max_single_shot_range=5.0,
            tx_power_dbm=30.0,
            rx_sensitivity_dbm=-80.0,
            obstacle_attenuation_db=4.0,
            trace_rfids=True,
            always_read_rfid_mem=True,
            hidden_sensor=False,
            with_time_stamp=True,
            weight=0.5,
        ),
    ),
    "VictSensor": (
        "VictSensor",
        """HiddenSensor=true
Distance=4
HorizontalFOV=0.6981317
HorizontalStep=0.0698131
VerticalFOV=0.5
VerticalStep=0.05
bWithTimeStamp=false
bShowResults=true
Mean=0.1
Sigma=0.05""",
        VictSensorSettings(
            distance=4.0,
            vertical_fov=0.5,
            vertical_step=0.05,
            with_time_stamp=False,
            show_results=True,
            mean=0.1,
            sigma=0.05,
        ),
    ),
    "Sound": (
        "SoundSensor",
        f"HiddenSensor=True\nWeight=0.4\nNoise=0.1\n{CURVE}",
        SoundSettings(noise=0.1, output_curve=((0.0, 0.0), (1000.0, 1000.0))),
    ),
    "HumanMotion": (
        "HumanMotionSensor",
        f"HiddenSensor=True\nWeight=0.4\nMaxRange=100\nFOV=90\nNoise=0.2\n{CURVE}",
        HumanMotionSettings(
            max_range=100.0, fov=90.0, noise=0.2, output_curve=((0.0, 0.0), (1000.0, 1000.0))
        ),
    ),
}


@pytest.mark.parametrize("kind", EXCERPTS)
def test_the_manuals_keys_set_what_they_say(tmp_path, kind):
    section, keys, expected = EXCERPTS[kind]
    file = tmp_path / "USARBot.ini"
    mount = f"AddSensors=(ItemClass=class'USARBot.{section}',ItemName=\"Item\",Position=(X=0.1))"
    file.write_text(f"[USARBot.{section}]\n{keys}\n[USARBot.P2AT]\n{mount}\n")
    robots: Registry = Registry("robot")
    robots.add(P2AT.name, P2AT)
    loaded = load_robots([file], robots, 250.0, settings_by_kind())
    assert not loaded.warnings
    (robot,) = loaded.robots
    (sensor,) = (sensor for sensor in suite_of(robot).sensors if sensor.mounts[0].name == "Item")
    assert (sensor.kind, sensor.settings) == (kind, (expected,))


def test_the_rescue_example_mounts_all_finders_on_a_p2at():
    """The victim sensor sits on the camera, as captured (and as manual 10.10.1 wants it)."""
    file = Path(__file__).parents[3] / "examples" / "rescue.ini"
    stock_only: Registry = Registry("robot")
    stock_only.add(P2AT.name, P2AT)
    loaded = load_robots([file], stock_only, 250.0, settings_by_kind())
    assert not loaded.warnings
    (robot,) = loaded.robots
    suite_of(robot)
    stock, added = robot.sensors[: len(P2AT.sensors)], robot.sensors[len(P2AT.sensors) :]
    assert stock == P2AT.sensors
    assert [mount.kind for mount in added] == ["VictSensor", "Sound", "HumanMotion", "CO2Sensor"]
    assert (added[0].parent, added[0].at) == ("CameraPanTilt_Link2", (0.06, 0.0, -0.0087))


def test_the_full_suite_example_has_every_sensor_of_the_benchmark():
    file = Path(__file__).parents[3] / "examples" / "full_suite.ini"
    stock_only: Registry = Registry("robot")
    stock_only.add(P2AT.name, P2AT)
    loaded = load_robots([file], stock_only, 250.0, settings_by_kind())
    assert not loaded.warnings
    kinds = {sensor.kind for sensor in suite_of(loaded.robots[0]).sensors}
    assert {"Sonar", "RangeScanner", "Odometry", "INS", "Encoder", "Touch", "RFID", "VictSensor"} <= kinds


def test_plus_adds_to_the_sensors_of_the_class(tmp_path):
    path = tmp_path / "signs.ini"
    zero = "(X=0,Y=0,Z=0)"
    item = f"(ItemClass=class'USARBot.SonarSensor',ItemName=\"Z1\",Position={zero},Direction={zero})"
    path.write_text(f"[USARBot.P2AT]\n+Sensors={item}\n")
    (robot,) = load_robots([path], ROBOTS).robots
    assert [mount.name for mount in robot.sensors] == [*(m.name for m in ROBOTS.get("P2AT").sensors), "Z1"]
    path.write_text(f"[USARBot.P2AT]\nSensors={item}\n")
    (robot,) = load_robots([path], ROBOTS).robots
    assert [mount.name for mount in robot.sensors] == ["Z1"]
