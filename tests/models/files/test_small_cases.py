"""One made file for each kind of fault that files of others showed, with the values that are right.

Files of robots are in `test_robot_files`; the picture that a sweep counts is in `tests.sweeps.test_contents`.
"""

import logging
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from usarmjx.base.errors import ArenaFileError
from usarmjx.models.files.load import load_arena, read_arena
from usarmjx.models.ini.robots import load_robots
from usarmjx.models.roads import read_mdf, read_rndf
from usarmjx.models.robots import ROBOTS
from usarmjx.sim.configure import settings_by_kind

CASES = Path(__file__).parent / "cases"


def robots_of(name):
    """The content of an ini file, and its robots by name."""
    loaded = load_robots([CASES / name], ROBOTS, settings=settings_by_kind())
    return loaded, {robot.name: robot for robot in loaded.robots}


def test_exit_after_waypoints_rndf_is_a_lane_of_two_points_with_a_warning(caplog):
    network = read_rndf(CASES / "exit_after_waypoints.rndf")
    (lane,) = network.segments[0].lanes
    assert lane.waypoints == ((40.0, -75.0), (40.0001, -75.0))
    assert lane.exits == ((2, (1, 1, 1)),)
    assert "exit_after_waypoints.rndf:11: exit is behind points" in caplog.text
    arena = load_arena(CASES / "exit_after_waypoints.rndf")
    # 0.0001 degrees of latitude are 11.12 m on a sphere of 6371 km.
    (kerb,) = arena.shapes
    assert 2 * kerb.size[0] == pytest.approx(1e-4 * np.radians(1) * 6.371e6, rel=5e-3)
    assert arena.starts[0].at[:2] == pytest.approx((-kerb.size[0], 0.0), abs=1e-6)


def test_no_end_mdf_is_a_mission_with_two_warnings(caplog):
    mission = read_mdf(CASES / "no_end.mdf")
    assert (mission.name, mission.rndf, mission.checkpoints) == ("tour", "small", (1,))
    assert [(one.id, one.low, one.high) for one in mission.speed_limits] == [(1, 0.0, 15.0)]
    said = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    assert [text.partition("no_end.mdf:")[2] for text in said] == [
        "11: end_speed_limits is missing",
        "11: end_file is missing",
    ]


def test_millimetres_stl_is_doubted_with_the_scale_that_helps():
    arena, (note,) = read_arena(CASES / "millimetres.stl")
    low, high = np.array(arena.extent).T
    assert high - low == pytest.approx((802, 602)), "800 x 600, with a margin of 1 m"
    assert "800 x 600 x 300 m, over 200 m" in note
    assert "scale: 0.001" in note


def test_plan_of_walls_png_is_taken_neither_for_hills_nor_for_walls():
    with pytest.raises(
        ArenaFileError, match=r"has the grey values 0, 255 only, as a map of walls: for walls"
    ):
        load_arena(CASES / "plan_of_walls.png")


def filled(arena, shape, cell):
    """Which cells of a grid from the origin have their middle in a solid of an arena (rows, columns)."""
    y, x = (np.indices(shape) + 0.5) * cell
    found = np.zeros(shape, bool)
    for solid in arena.shapes:
        near = np.abs(x - solid.at[0]) < solid.size[0], np.abs(y - solid.at[1]) < solid.size[1]
        found |= near[0] & near[1]
    return found


@pytest.mark.parametrize(("name", "cell"), [("walls", 0.1), ("specks", 0.05)])
def test_walls_yaml_and_specks_yaml_have_a_solid_where_their_pictures_are_dark(name, cell):
    """`specks` needs more than 2000 boxes."""
    picture = {"walls": "plan_of_walls", "specks": "specks"}[name]
    pixels = np.asarray(Image.open(CASES / f"{picture}.png"))[::-1]  # rows from the lowest y on
    arena, _ = read_arena(CASES / f"{name}.yaml")
    np.testing.assert_array_equal(filled(arena, pixels.shape, cell), pixels < 0.35 * 255)
    assert arena.extent == ((0.0, pixels.shape[1] * cell), (0.0, pixels.shape[0] * cell))


def test_unreal_array_signs_ini_adds_one_sensor_and_takes_all_away():
    _, robots = robots_of("unreal_array_signs.ini")
    before = ROBOTS.get("P2AT").sensors
    assert len(before) == 21
    assert robots["P2AT"].sensors[:-1] == before
    added = robots["P2AT"].sensors[-1]
    assert (added.kind, added.name) == ("Sonar", "Z1")
    assert robots["P2DX"].sensors == ()


def test_later_version_ini_mounts_what_means_the_same_and_names_the_rest():
    loaded, robots = robots_of("later_version.ini")
    front = robots["P2AT"].sensors[-1]
    assert (front.kind, front.name, front.at) == ("RangeScanner", "Front", (0.2, 0.0, -0.2))
    assert dict(front.all_options)["MaxRange"] == 20.0, "the SICK's section, not the scanner's"
    assert "SomeOtherRobot" not in robots
    assert sum("SomeOtherRobot" in note for note in loaded.warnings) == 1
