"""Driving by hand: who wants to go ahead, to the left or up gets there, whatever the keys of DRIVE are."""

import numpy as np
import pytest

from tests.arenas import FLAT
from usarmjx.base.rotations import mat_from_quat
from usarmjx.models.drives.base import can_climb, drive_values
from usarmjx.models.robots import ROBOTS
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.control import CommandUpdate

GROUND = ("P2DX", "Hummer", "Lisa")
AIR = ("AirRobot", "Passarola")
HEIGHT = 5.0  # m


def way_of(name, **order):
    """How far ahead, to the left and up a robot goes in its own axes [m], and its turn to the left [rad]."""
    world = DynamicWorld(FLAT)
    spec = ROBOTS.get(name)
    robot = world.spawn(spec, "R", (0.0, 0.0, HEIGHT if name in AIR else 0.1), (0.0, 0.0, 0.0))
    for _ in range(20):
        world.step()
    before = world.state(robot)
    world.update_command(robot, CommandUpdate(drive=drive_values(spec.drive.full_scale, **order)))
    for _ in range(70):
        world.step()
    after = world.state(robot)
    way = mat_from_quat(np.asarray(before.quat)).T @ (np.asarray(after.pos) - np.asarray(before.pos))
    heading = mat_from_quat(np.asarray(before.quat)).T @ mat_from_quat(np.asarray(after.quat))[:, 0]
    return *way, np.arctan2(heading[1], heading[0])


@pytest.mark.parametrize("name", [*GROUND, *AIR])
def test_ahead_is_ahead_and_left_is_left(name):
    ahead, left, _, turn = way_of(name, ahead=1.0, speed=0.5)
    assert ahead > 0.1
    assert abs(left) < 0.05
    assert abs(turn) < 0.05
    *_, turn = way_of(name, ahead=1.0, left=1.0, speed=0.5)
    assert turn > 0.1


@pytest.mark.parametrize("name", AIR)
def test_up_is_up_and_down_is_down(name):
    assert can_climb(ROBOTS.get(name).drive.full_scale)
    assert way_of(name, up=1.0)[2] > 0.3
    assert way_of(name, up=-1.0)[2] < -0.3
    assert abs(way_of(name, ahead=1.0)[2]) < 0.1


def test_a_submarine_steers_by_rudder_and_plane():
    """Manual 9.4: a positive rudder turns to the right; a plane that is up lifts the bow."""
    full = ROBOTS.get("Submarine").drive.full_scale
    values = drive_values(full, ahead=1.0, left=1.0, up=1.0, speed=0.5)
    assert values == {"Propeller": 3.14, "Rudder": -full["Rudder"], "SternPlane": full["SternPlane"]}


@pytest.mark.parametrize("name", ROBOTS.names())
def test_no_robot_is_told_more_than_it_can_and_all_stand_when_told_nothing(name):
    full = ROBOTS.get(name).drive.full_scale
    assert not any(drive_values(full).values())
    for order in np.array(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1])).T.reshape(-1, 3):
        values = drive_values(full, *map(float, order))
        assert values.keys() == full.keys()
        assert all(abs(value) <= full[key] for key, value in values.items())
