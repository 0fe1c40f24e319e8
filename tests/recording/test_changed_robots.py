"""Robots that take the place of others between two frames: readings and paths are those of the right one."""

import json
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader

from tests.recording.missions import HEIGHT, SCOUT, mission_world
from usarmjx.models.types.robot import Mount
from usarmjx.recording.reader import Recording
from usarmjx.recording.tables import rows_of
from usarmjx.sim.control import CommandUpdate

BLIND = replace(SCOUT, name="Blind", sensors=(Mount(kind="GPS", name="Place"),))
"""Fewer sensors than a scout has."""
FRAMES = 10
"""Control steps between two frames."""
JOINS = 20


def spawn(world, robot, name, x=-1.0):
    return world.spawn_at(robot, name, [((x, 0.0, HEIGHT), (0.0, 0.0, 0.0))])


def step(world, steps):
    for _ in range(steps):
        world.step()
        world.observe([*world.robots.values()])


def messages(path, topic):
    """The messages of a topic as Foxglove reads them, with their times [s]."""
    with path.open("rb") as file:
        found = make_reader(file).iter_messages(topics=[topic])
        return [(message.log_time / 1e9, json.loads(message.data)) for _, _, message in found]


@pytest.fixture
def replaced(tmp_path):
    """The recording of a robot whose place another takes, with more sensors, between two frames."""
    path = tmp_path / "replaced.mcap"
    world, file = mission_world(path)
    blind = spawn(world, BLIND, "Blind")
    step(world, FRAMES + 3)
    world.remove(blind)
    scout = spawn(world, SCOUT, "Scout")
    assert scout.slot == blind.slot
    step(world, 6 * FRAMES)
    file.close()
    assert world.recorder.file.left_out == 0
    return path, world.time


def test_a_robot_with_more_sensors_in_a_place_that_is_still_another_s(replaced):
    """The writer looked up a sensor that the robot before had not, and the recording ended there."""
    path, end = replaced
    states = [*Recording(path).messages(["states"])]
    assert len(states) == round(end / 0.02)
    assert states[-1].value.time == pytest.approx(end)
    scans = messages(path, "/scan/Scout_Scanner1")
    assert len(scans) >= 2
    assert {scan["frame_id"].partition("/")[0] for _, scan in scans} == {"Scout"}
    assert min(time for time, _ in scans) > (FRAMES + 3) * 0.02


def test_readings_have_the_names_of_those_who_took_them(replaced):
    """Until its first frame the second robot is in no drawing: those readings have no row."""
    path, _ = replaced
    kinds = {"Blind": {"GPS"}, "Scout": {"RangeScanner", "VictSensor"}}
    rows = [*rows_of(Recording(path), "readings")]
    assert {(row[2], row[3]) for row in rows} == {(name, kind) for name in kinds for kind in kinds[name]}
    left = (FRAMES + 3) * 0.02
    assert max(row[0] for row in rows if row[2] == "Blind") <= left + 1e-6
    assert min(row[0] for row in rows if row[2] == "Scout") > left


def test_who_comes_back_begins_a_new_path(tmp_path):
    path = tmp_path / "paths.mcap"
    world, file = mission_world(path)
    for x in (-1.0, 0.5):
        robot = spawn(world, SCOUT, "Scout", x)
        world.update_command(robot, CommandUpdate(drive={"Left": 5.0, "Right": 5.0}))
        step(world, 12 * FRAMES)
        world.remove(robot)
        step(world, FRAMES)
    file.close()
    trails = [trail["poses"] for _, trail in messages(path, "/trail/Scout")]
    starts = np.array([poses[0]["position"]["x"] for poses in trails])
    assert set(starts.round(1)) == {-1.0, 0.5}
    assert max(map(len, trails)) > 1


def test_paths_of_robots_that_left_are_not_kept(tmp_path):
    """Each had up to 200 poses, 0.2 MB, as long as the server ran."""
    world, file = mission_world(tmp_path / "many.mcap")
    kept = world.recorder._messages._trails._trails
    for number in range(JOINS):
        robot = spawn(world, BLIND, f"Guest{number}")
        step(world, FRAMES)
        world.remove(robot)
    step(world, FRAMES)
    file.close()
    assert len(kept) == 0
