"""Obstacles on routes: nobody gets round them, they are sized to the robot, and more is more."""

import itertools

import numpy as np
import pytest

from usarmjx.models.build.reach import DEFAULT_SLOPE, footprint_of, reach_map
from usarmjx.models.generate import KINDS, Difficulty, generate
from usarmjx.models.generate.draw import RandomStream
from usarmjx.models.generate.obstacles import OBSTACLES, obstacle_height
from usarmjx.models.generate.plan import CELL
from usarmjx.models.robots import ROBOTS

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
