"""Robots driven through lanes and arenas: what they pass, what stops them, and how that is counted."""

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.terrain import heights
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.models.arenas.lanes import LANES
from usarmjx.models.check import check_arena
from usarmjx.models.files.load import find_arena
from usarmjx.models.generate import Difficulty, generate
from usarmjx.models.generate.obstacles import OBSTACLES
from usarmjx.models.robots import ROBOTS
from usarmjx.sim import trials
from usarmjx.sim.trials import LaneScore, Trial, drive_arena, measure_crossings, run_lane

P2AT, TALON = ROBOTS.get("P2AT"), ROBOTS.get("Talon")
ATOL = 1e-6
RAMP = math.tan(math.radians(15))

# What lanes are like


PROFILES = {
    "continuous": ([0.0001, 0.6, 1.2, 1.8, 2.4, 3.6], np.array([0, 0.6, 1.2, 0.6, 0, 1.2]) * RAMP),
    "flat": ([0.0, 4.8], [0.0, 0.0]),
    "hurdles_20": ([1.0, 1.179, 3.579], [0.0, 0.2, 0.2]),
    "hurdles_10": ([1.179, 3.579], [0.1, 0.1]),
    "incline_30": ([1.2, 2.4, 4.0], np.array([1.2, 2.4, 2.4]) * math.tan(math.radians(30))),
    "gap_20": ([2.29, 2.31, 2.49, 2.51], [0.3, 0.0, 0.0, 0.3]),
    "pipe_steps": ([0.3, 0.9, 1.5, 2.1, 3.0], [0.2, 0.4, 0.6, 0.8, 0.8]),
    "stairs": ([-0.01, 0.05, 0.3, 2.0], [0.0, 0.18, 0.36, 1.26]),
}


@pytest.mark.parametrize("name", PROFILES)
def test_a_lane_is_as_high_as_its_method_says(name):
    at, expected = PROFILES[name]
    found = heights(LANES.get(name).arena, [(x, 0.01) for x in at])
    np.testing.assert_allclose(found, expected, atol=2e-4)


def test_crossing_ramps_cross():
    """Half ramps of 60 cm beside and behind each other climb along x and along y by turns."""
    ramped = [s for s in LANES.get("crossing").arena.shapes if s.surface == "ground"]
    ways = [round(math.degrees(s.rotation[2])) % 360 for s in ramped]
    assert sorted(ways) == sorted([0, 90, 180, 270] * 4)
    assert {round(-math.degrees(s.rotation[1]), 6) for s in ramped} == {15.0}


def test_lanes_are_arenas_by_name_and_a_robot_stands_on_both_ends():
    for name, lane in LANES:
        assert find_arena(f"lane_{name}") is lane.arena
        faults = [fault for fault in check_arena(lane.arena) if "no nearer" not in fault]
        assert faults == []


# Scores


def test_a_talon_crosses_hurdles_of_20_cm():
    talon = run_lane(LANES.get("hurdles_20"), TALON, 0.5, max_repetitions=1)
    assert talon.repetitions == 1
    assert talon.faults == ()


def test_a_lap_counts_there_and_back_where_the_method_says_so():
    lane = LANES.get("incline_15")
    score = run_lane(lane, P2AT, 1.0, max_repetitions=1)
    assert score.repetitions == 1
    assert score.metres_per_minute == pytest.approx(2 * lane.length * 60 / score.seconds)
    assert lane.length * 2 / score.seconds < P2AT.drive.top_speed


def test_a_score_is_repetitions_and_metres_per_minute():
    score = LaneScore(LANES.get("continuous"), "P2AT", 90.0, 6, ("stuck at 1, 2",))
    assert (score.per_minute, score.metres_per_minute) == (4.0, pytest.approx(4.0 * 4.8))
    assert str(score) == (
        "lane_continuous (ASTM E2826), P2AT: 6 repetitions in 1.5 min, 4.00/min, 19.20 m/min, 1 faults"
    )


def test_a_drive_ends_where_the_physics_breaks(monkeypatch):
    trial, sound = Trial(LANES.get("flat").arena, P2AT), iter([True, False])
    monkeypatch.setattr(trial, "advance", lambda seconds: next(sound))
    run = trial.follow([(100.0, 0.0)], 60.0)
    assert (run.reached, run.fault.split(" at ")[0]) == (0, "was recovered")


def test_who_flies_is_in_no_lane():
    with pytest.raises(UsageError, match="AirRobot is not steered on the ground"):
        Trial(LANES.get("flat").arena, ROBOTS.get("AirRobot"))


# Obstacles and whole arenas


@pytest.mark.every_run("bars", "ridge")
@pytest.mark.parametrize("kind", OBSTACLES.names())
def test_the_highest_obstacles_sized_to_a_robot_are_crossed(kind):
    found = measure_crossings(kind, P2AT, 1.0, tries=1)
    assert (found.crossed, found.tries) == (1, 1)


def test_obstacles_three_times_as_high_are_not():
    assert measure_crossings("posts", P2AT, 1.0, tries=1, scale=4.0).crossed == 0


def test_obstacles_take_longer_the_rougher_they_are():
    slow, fast = (measure_crossings("bars", P2AT, level, tries=1).seconds for level in (1.0, 0.0))
    assert slow > fast > 0.0


def test_a_robot_is_driven_to_all_starts_of_an_arena_with_obstacles():
    arena = generate("steps", (3, 3), 2, Difficulty(obstacles=1.0, clutter=0.0, roughness=1.0))
    tour = drive_arena(arena, P2AT)
    assert tour.faults == ()
    assert tour.success == 1.0
    assert tour.segments == len(arena.starts) - 1 + len(arena.victims)
    assert tour.metres / tour.seconds < P2AT.drive.top_speed


def test_driving_finds_what_the_plan_does_not_see():
    lane = LANES.get("hurdles_20").arena
    assert check_arena(lane) == []
    result = CliRunner().invoke(app, ["arena", "check", "lane_hurdles_20", "--drive"])
    assert result.exit_code == 1
    assert "driven: 0 of 1 ways" in result.output
    assert "start 'FarEnd': a driven P2AT is stuck at 0.8" in result.output


def test_the_commands_of_lanes(tmp_path):
    listed = CliRunner().invoke(app, ["arena", "lanes"])
    assert listed.exit_code == 0
    assert "| stairs | ASTM E2804 | Stairs of 35 degrees, 7 rises of 18 cm |" in listed.output
    run = CliRunner().invoke(app, ["arena", "lane", "flat", "--minutes", "0.1", "--speed", "0.5"])
    assert "lane_flat (ASTM E2829), P2AT: 0 repetitions in 0.1 min" in run.output
    wrong = CliRunner().invoke(app, ["arena", "lane", "swamp"])
    assert wrong.exit_code == 2
    assert "unknown lane 'swamp'" in wrong.output


def test_measured_success_goes_into_a_file_that_keeps_other_classes(tmp_path, monkeypatch):
    monkeypatch.setattr(trials, "LEVELS", (0.3, 4.0))
    monkeypatch.setattr(OBSTACLES, "names", lambda: ["posts"])
    path = tmp_path / "crossings.json"
    path.write_text('{"classes": {"Talon": {"bars": [[0.3, 1.0]]}}}')
    run = CliRunner().invoke(app, ["arena", "obstacles", "--tries", "1", "--write", str(path)])
    assert run.exit_code == 0, run.output
    kept = json.loads(path.read_text())["classes"]
    assert kept == {"P2AT": {"posts": [[0.3, 1.0], [4.0, 0.0]]}, "Talon": {"bars": [[0.3, 1.0]]}}
    path.write_text("[]")
    wrong = CliRunner().invoke(app, ["arena", "obstacles", "--write", str(path)])
    assert "holds no measured success" in wrong.output
