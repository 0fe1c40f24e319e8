"""The later versions' robots for building upon, from the example file: the figures of their classes."""

import math
from pathlib import Path

import pytest

from tests.rig import Rig, steady_speed, steady_spin
from tests.server.still_world import StillWorld
from tests.server.test_object_sensor import say_init
from tests.server.test_world_controller import say
from usarmjx.base.registry import Registry
from usarmjx.models.ini.robots import load_robots
from usarmjx.models.robots import ROBOTS
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.protocol.dialects import UDK

FILE = Path(__file__).parents[3] / "examples" / "basic_robots.ini"
RADIUS, TRACK = 0.128, 2 * 0.576  # m: WheelRadius, and Offset.Y of both sides


@pytest.fixture(autouse=True)
def robots(monkeypatch):
    loaded = load_robots([FILE], Registry("robot"), 250.0)
    assert list(loaded.warnings) == []
    monkeypatch.setattr(ROBOTS, "_entries", dict(ROBOTS._entries))
    for robot in loaded.robots:
        ROBOTS.add(robot.name, robot)


@pytest.mark.parametrize(
    ("name", "base", "mass", "spin"),
    [
        ("BasicSkidRobot", 0.6, 1.0 + 4 * 0.1, 1.4),
        ("CasterSkidRobot", 0.684, 1.0 + 2 * 0.1 + 0.07, 1.5),
        ("BasicAckermanRobot", 0.6, 10.0 + 6 * 1.0, 1.4),
    ],
)
def test_a_client_finds_one_with_the_figures_of_its_class(name, base, mass, spin):
    """Offsets, masses and MaxVelocity of the classes' parts and joints, in the later dialect."""
    client = Client(StillWorld(), "peer", dialect=UDK)
    say_init(client, f"INIT {{ClassName USARBot.{name}}} {{Name R1}} {{Start S0}}")
    (geo,) = say(client, "GETGEO {Type Robot}")
    wheels = ("{WheelRadius 0.1280}", "{WheelSeparation 1.1520}", f"{{WheelBase {base:.4f}}}")
    assert all(pair in geo for pair in (f"{{Name {name}}}", *wheels)), geo
    (conf,) = say(client, "GETCONF {Type Robot}")
    assert f"{{Mass {mass:.4f}}}" in conf
    assert f"{{MaxSpeed {spin * RADIUS:.4f}}}" in conf or f"{{MaxSpeed {spin:.4f}}}" in conf


@pytest.mark.parametrize(("name", "spin"), [("BasicSkidRobot", 1.4), ("CasterSkidRobot", 1.5)])
def test_skid_steered_ones_drive_as_their_wheels_turn(name, spin):
    rig = Rig(name).tell(Left=spin, Right=spin)
    assert steady_speed(rig) == pytest.approx(spin * RADIUS, rel=0.01)
    assert rig.up[0] > 0.9999
    turning = steady_spin(Rig(name).tell(Left=-spin, Right=spin))
    most = 2 * spin * RADIUS / TRACK
    if name == "CasterSkidRobot":  # nothing slides: the caster swivels
        assert turning == pytest.approx(most, rel=0.1)
    else:  # four wheels slide sideways
        assert 0.5 * most < turning < most


def test_a_car_steers_with_its_rear_wheels():
    """At the speed v a turn of v tan(angle) / base, to the right for a rear angle to the left."""
    told = 0.3
    assert steady_speed(Rig("BasicAckermanRobot").tell(Speed=1.4)) == pytest.approx(1.4 * RADIUS, rel=0.01)
    turning = steady_spin(Rig("BasicAckermanRobot").tell(Speed=1.0, RearSteer=told))
    assert abs(turning) == pytest.approx(1.0 * RADIUS * math.tan(told) / 0.6, rel=0.05)
