"""Obstacles on routes: nobody gets round them, they are sized to the robot, and more is more."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from usarmjx.base.errors import SpecError
from usarmjx.base.random import RandomStream
from usarmjx.models.compile.reachability import DEFAULT_SLOPE, footprint_of, reach_map
from usarmjx.models.generate import KINDS, Difficulty, generate
from usarmjx.models.generate.obstacles import (
    MAX_HEIGHT_RATIO,
    OBSTACLES,
    highest_at,
    highest_obstacle,
    measured_crossings,
    obstacle_height,
)
from usarmjx.models.generate.plan import CELL
from usarmjx.models.robots import ROBOTS
from usarmjx.sim.trials import LEVELS, MIN_SUCCESS

NEED = footprint_of(ROBOTS.get("P2AT"))
NO_STEP, NO_SLOPE = 0.004, np.radians(3)  # m: who climbs nothing, not even the lowest obstacle


def reached(arena, step=NEED.step, slope=DEFAULT_SLOPE):
    """The tags of the starts that are reached from the first."""
    found = reach_map(arena, NEED.radius, step, height=NEED.height, slope=slope, cell=CELL / 18)
    return {start.tag for start in arena.starts if found.reachable(*start.at[:2])}


@pytest.mark.parametrize("kind", KINDS.names())
@pytest.mark.parametrize("roughness", [0.0, 1.0])
def test_routes_lead_over_obstacles_that_the_robot_climbs(kind, roughness):
    arena = generate(kind, (7, 5), 3, Difficulty(obstacles=1.0, roughness=roughness, clutter=0.0))
    everyone = {start.tag for start in arena.starts}
    assert reached(arena) == everyone
    assert len(reached(arena, NO_STEP, NO_SLOPE)) <= len(everyone) - 4


def test_without_being_asked_for_there_are_none_and_the_curricula_do_not_ask():
    assert Difficulty().obstacles == Difficulty.of(1.0).obstacles == 0.0
    arena = generate("maze", (7, 5), 3, Difficulty.of(0.5))
    assert generate("maze", (7, 5), 3, Difficulty(obstacles=1.0)) != arena


def test_more_obstacles_are_the_same_and_more():
    solids = [
        set(generate("rubble", (8, 6), 1, Difficulty(obstacles=share, clutter=0.0)).shapes)
        for share in (0.0, 0.3, 0.6, 1.0)
    ]
    boards = 8 * 6 // 10
    assert all(len(a - b) <= boards for a, b in itertools.pairwise(solids)), "only boards give way"
    assert len(solids[0]) < len(solids[1]) < len(solids[-1])


@pytest.mark.parametrize("kind", OBSTACLES.names())
def test_obstacles_are_as_high_as_the_robot_and_the_roughness_say(kind):
    def top(robot, roughness):
        height = obstacle_height(footprint_of(ROBOTS.get(robot)), roughness)
        shapes = OBSTACLES.get(kind)(RandomStream(1, "test"), (0.0, 0.0), height, 0)
        return max(shape.at[2] + shape.size[2] * np.cos(shape.rotation[1]) for shape in shapes)

    tops = [top("P2AT", roughness) for roughness in (0.0, 0.25, 0.5, 0.75, 1.0)]
    assert tops == sorted(tops)
    assert tops[-1] > 2 * tops[0]
    assert top("P2DX", 1.0) < top("P2AT", 1.0)


def test_no_obstacle_on_a_route_is_higher_than_what_every_drive_got_over():
    for robot, kinds in measured_crossings().items():
        for kind, curve in kinds.items():
            allowed = highest_obstacle(robot, kind, 0.0)
            assert allowed <= MAX_HEIGHT_RATIO
            assert all(share == 1.0 for height, share in curve if height <= allowed)
    assert highest_obstacle("P2DX", "bars", 0.0) < MAX_HEIGHT_RATIO, (
        "a P2DX does not get over the highest bars"
    )
    assert highest_obstacle("Zerg", "bars", 0.0) == MAX_HEIGHT_RATIO
    for robot, kind in (("Lisa", "slabs"), ("Rugbot", "bars"), ("ATRVJr", "bars"), ("UnitLoader", "bars")):
        assert highest_obstacle(robot, kind, 0.0) < MAX_HEIGHT_RATIO, "nor do these"


USUAL = (
    "P2AT",
    "P2DX",
    "ATRVJr",
    "Zerg",
    "Kurt2D",
    "Lisa",
    "UnitLoader",
    "Talon",
    "TeleMax",
    "kenaf",
    "Rugbot",
)


@pytest.mark.parametrize("robot", USUAL)
def test_classes_that_people_take_are_measured_at_all_obstacles(robot):
    curves = measured_crossings()[robot]
    assert set(curves) == set(OBSTACLES.names())
    for curve in curves.values():
        assert [height for height, _ in curve] == list(LEVELS[: len(curve)])
        assert curve[-1][1] <= MIN_SUCCESS or len(curve) == len(LEVELS)
    ROBOTS.get(robot)


def test_the_documents_say_what_was_measured():
    text = (Path(__file__).parents[3] / "docs" / "arenas.md").read_text(encoding="utf-8")
    for robot, curves in measured_crossings().items():
        told = re.search(rf"^\| {robot} ((?:\| [\d.]+, (?:over )?[\d.]+ ){{4}})\|$", text, re.MULTILINE)
        assert told, robot
        numbers = [float(number) for number in re.findall(r"\d+\.\d+", told[1])]
        expected = [highest_at(curves[kind], share) for kind in sorted(curves) for share in (1.0, 0.5)]
        assert numbers == pytest.approx(expected, abs=0.006)


@pytest.mark.parametrize("kind", OBSTACLES.names())
def test_more_risk_is_higher_obstacles_and_less_success(kind):
    curve = measured_crossings()["P2DX"][kind]
    assert curve[0][1] == 1.0
    assert curve[-1][1] <= 0.2, "measured until hardly any drive gets over them"
    heights = [highest_obstacle("P2DX", kind, risk) for risk in (0.0, 0.2, 0.5, 0.8)]
    assert heights == sorted(heights)
    assert heights[2] > heights[0]


def test_a_height_between_two_measured_ones_goes_evenly_and_luck_does_not_count():
    curve = [(0.5, 1.0), (1.0, 0.6), (1.5, 0.8), (2.0, 0.0)]
    assert highest_at(curve, 1.0) == pytest.approx(0.5)
    assert highest_at(curve, 0.8) == pytest.approx(0.75)
    assert highest_at(curve, 0.6) == pytest.approx(1.5)
    assert highest_at(curve, 0.3) == pytest.approx(1.75)


def test_a_risky_arena_has_higher_obstacles_on_the_same_routes():
    def heights(risk):
        level = Difficulty(obstacles=1.0, roughness=1.0, clutter=0.0, risk=risk)
        shapes = generate("rubble", (7, 5), 3, level, robot="P2DX").shapes
        return sum(shape.at[2] + shape.size[2] for shape in shapes if shape.surface == "ground")

    assert heights(0.5) > heights(0.0)
    with pytest.raises(SpecError, match=r"a risk of 0\.5 for ERS: measured are .*P2DX"):
        generate("maze", (7, 5), 3, Difficulty(obstacles=1.0, risk=0.5), robot="ERS")
