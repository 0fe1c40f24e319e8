"""Figures and equipment of all robots as the manual lists them, and that ini files reach every class."""

import numpy as np
import pytest

from usarmjx.models.compile.kinematic_tree import bounding_box, kinematic_tree_of
from usarmjx.models.ini.robots import load_robots
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.suite import suite_of
from usarmjx.sim.configure import settings_by_kind

# Length, width, height [m], mass and payload [kg] (manual 12), height of the origin [m] (manual 5.3.6); None:
# not given there. ATRVJr: dimensions of manual 9.3's GEO.
FIGURES = {
    "P2AT": (None, 14.0, 40.0, 0.26),
    "P2DX": ((0.44, 0.38, 0.22), 9.0, 20.0, 0.20),
    "ATRVJr": ((0.7744, 0.6318, 0.5754), 50.0, 25.0, 0.39),
    "Hummer": ((3.686, 1.799, 2.059), None, None, None),
    "SnowStorm": ((4.239, 1.720, 1.621), None, None, None),
    "Sedan": ((4.2779, 1.7883, 1.3238), None, None, None),
    "Submarine": ((6.5364, 1.1428, 1.9929), None, None, None),
    "Tarantula": ((0.6778, 0.444, 0.1406), None, None, None),
    "Zerg": ((0.3112, 0.4154, 0.1211), None, None, 0.06),
    "Talon": ((0.9117, 0.5903, 0.3654), 34.0, 45.0, 0.13),
    "ERS": ((0.319, 0.180, 0.278), 1.6, None, None),
    "Soryu": ((1.21, 0.122, 0.145), 10.0, None, None),
    "Kurt2D": ((0.45, 0.29, 0.35), 35.0, None, None),
    "Kurt3D": ((0.45, 0.29, 0.35), 35.0, None, None),
    "TeleMax": ((0.80, 0.40, 0.75), None, None, None),
    "AirRobot": ((0.999, 0.999, 0.194), 1.0, 0.2, None),
    "Passarola": ((4.0, 2.0, 2.0), 3.0, 2.0, None),
    "Rugbot": ((0.385, 0.255, 0.270), 34.0, 45.0, None),
    "Kenaf": ((0.937, 0.429, 0.259), 20.0, None, None),
}
# Sensors (INS is the manual's INU), effecters: manual 12.12, 12.19, 12.22, 12.23.
EQUIPMENT = {
    "Talon": ({"Odometry": 1, "INS": 1}, ["Gripper"], 4),
    "TeleMax": ({"Odometry": 1, "INS": 1}, ["Gripper"], 2),
    "Rugbot": ({"RangeScanner": 1, "Odometry": 1, "INS": 1}, [], 1),
    "Kenaf": ({"RangeScanner": 1, "Encoder": 6}, [], 2),
    "Submarine": ({"Sonar": 1}, [], 1),
}
EXACT = 1e-9
BUILT = 0.005
"""Built against listed dimensions [m]: wheels at the ends of a Kurt reach 1 mm too far each."""


@pytest.mark.parametrize("name", FIGURES)
def test_figures_are_the_manuals(name):
    robot, (dimensions, mass, payload, height) = ROBOTS.get(name), FIGURES[name]
    if dimensions is not None:
        assert robot.dimensions == pytest.approx(dimensions, abs=EXACT)
    if payload is not None:
        assert robot.payload == payload
    if mass is not None:
        assert robot.mass == mass
    assert kinematic_tree_of(robot).mass == pytest.approx(robot.mass, rel=1e-6), "as reported, so built"
    if height is not None:
        assert kinematic_tree_of(robot).clearance == pytest.approx(height, abs=1e-6)


@pytest.mark.parametrize(
    "name", ["Submarine", "Tarantula", "ERS", "Soryu", "Kurt2D", "Kurt3D", "AirRobot", "Passarola"]
)
def test_built_robots_fill_the_manuals_box(name):
    """Of the other classes some sensor or camera stands above it, or a wheel or arm reaches beyond."""
    low, high = bounding_box(ROBOTS.get(name))
    np.testing.assert_allclose(high - low, FIGURES[name][0], atol=BUILT)


@pytest.mark.parametrize("name", ["ATRVJr", "Hummer", "SnowStorm", "Zerg", "Rugbot", "Kenaf"])
def test_built_robots_are_as_long_and_wide_as_the_manual_says(name):
    """Their scanners and cameras stand above the listed height."""
    low, high = bounding_box(ROBOTS.get(name))
    length, width, height = FIGURES[name][0]
    np.testing.assert_allclose((high - low)[:2], (length, width), atol=BUILT)
    assert (high - low)[2] > height + BUILT


def test_single_figures_are_the_manuals():
    assert ROBOTS.get("Submarine").drive.rudder_area == 0.3378
    telemax, kenaf = ROBOTS.get("TeleMax"), ROBOTS.get("Kenaf")
    assert telemax.battery_life == 7200.0
    wheel = next(part for part in telemax.wheels if part.parent == "HARD")
    assert wheel.shapes[0].size == pytest.approx((0.381 / 2, 0.095 / 2), abs=EXACT)
    body = [part for part in kenaf.wheels if part.parent == "HARD"]
    assert 2 * max(part.at[0] + part.shapes[0].size[0] for part in body) == pytest.approx(0.575, abs=1e-6)


@pytest.mark.parametrize("name", EQUIPMENT)
def test_equipment_is_the_manuals(name):
    robot, (sensors, effecters, cameras) = ROBOTS.get(name), EQUIPMENT[name]
    counts = {}
    for sensor in suite_of(robot).sensors:
        counts[sensor.kind] = counts.get(sensor.kind, 0) + len(sensor.mounts)
    assert counts == {"INS": 1, "GroundTruth": 1} | ({} if name == "Submarine" else {"Odometry": 1}) | sensors
    assert [mount.kind for mount in robot.effecters] == effecters
    assert len(robot.cameras) == cameras


@pytest.mark.parametrize("name", ROBOTS.names())
def test_every_class_reads_the_keys_of_a_p2at(name, tmp_path):
    """Manual 12.x.2: "It's the same as the P2AT"."""
    path = tmp_path / "USARBot.ini"
    path.write_text(
        f"[USARBot.{name.upper()}]\nmsgTimer=0.3\nbatteryLife=77\nPayload=3\nWeight=123\nbMountByUU=True\n"
        "AddSensors=(ItemClass=class'USARBot.SonarSensor',ItemName=S,Position=(X=25,Y=50,Z=75),Direction=(Z=8192))\n"
        "AddCameras=(ItemClass=class'USARBot.RobotCamera',ItemName=C)\n"
        "AddEffecters=(ItemClass=class'USARBot.RFIDReleaser',ItemName=E)\n"
    )
    loaded = load_robots([path], ROBOTS, 250.0, settings_by_kind())
    assert loaded.warnings == ()
    (robot,) = loaded.robots
    assert (robot.msg_timer, robot.battery_life, robot.payload, robot.mass) == (0.3, 77.0, 3.0, 123.0)
    sonar = next(mount for mount in robot.sensors if mount.name == "S")
    assert sonar.at == pytest.approx((0.1, 0.2, -0.3), abs=EXACT)
    assert sonar.direction[2] == pytest.approx(3.14159265 / 4, abs=1e-8)
    assert [robot.cameras[-1].name, robot.effecters[-1].kind] == ["C", "RFIDReleaser"]
    suite_of(robot)
