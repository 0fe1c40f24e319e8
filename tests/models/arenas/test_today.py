"""Yellow, orange and red of today: which elements they have, how high those are, and who gets over them."""

import math

import numpy as np
import pytest

from tests.terrain import heights
from usarmjx.models.arenas import ARENAS
from usarmjx.models.arenas.league_hall import BACK, BOX_LENGTH, EYES, HOLE, SLOT, victim_box
from usarmjx.models.arenas.orange import HALL, ORANGE_2025
from usarmjx.models.arenas.red import RED_2025
from usarmjx.models.arenas.yellow import YELLOW, YELLOW_2025
from usarmjx.models.check import check_arena
from usarmjx.models.compile.victims import rest_height
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import START_ELEVATION, StartPose
from usarmjx.sim.trials import Trial

TODAY = (YELLOW_2025, ORANGE_2025, RED_2025)
RAMP = math.tan(math.radians(15))
ATOL = 2e-4


@pytest.mark.parametrize("arena", TODAY, ids=lambda arena: arena.name)
def test_they_ship_and_suit_the_robots_that_they_recommend(arena):
    assert ARENAS.get(arena.name.removeprefix("DM-USAR_")) is arena
    for robot in arena.robots:
        assert check_arena(arena, robot) == []
    assert len(arena.starts) >= 16
    assert len(arena.victims) == 3
    assert len(arena.shapes) <= 230
    assert {shape.kind for shape in arena.shapes} == {"box"}, "every engine runs it"
    signs = [s for s in arena.shapes if s.surface == "fixture"]
    assert {s.texture.partition(":")[0] for s in signs} == {"chart", "hazmat", "tag", "qr"}


def test_the_floor_of_yellow_is_one_continuous_wave():
    x = np.arange(2.501, 12.0, 0.3)
    expected = np.abs((x - 2.4 + 1.2) % 2.4 - 1.2) * RAMP
    for y in (0.67, 5.47):
        found = heights(YELLOW_2025, [(v, y) for v in x])
        bare = found < 1.4  # the others are on walls
        np.testing.assert_allclose(found[bare], expected[bare], atol=ATOL)
        assert bare.sum() > len(x) / 2
    walls = sum(s.size[2] == s.at[2] == 0.75 for s in YELLOW_2025.shapes)
    assert walls == len(YELLOW.shapes) - 14 - 4, "those of yellow, but for its 14 obstacles and 4 effects"


LANES = {
    "crossing ramps": (1, [2.4 + 0.1, 2.4 + 0.5, 3.0 + 0.3], np.array([0.3, 0.3, 0.3]) * RAMP),
    "hurdles": (3, [4.2 - 0.021, 7.8 - 0.021], [0.1, 0.1]),
    "stairs": (5, [3.65, 3.9, 5.0], [0.18, 0.36, 0.9]),
    "pipe steps": (6, [3.9, 4.5, 6.0], [0.2, 0.4, 0.4]),
    "a gap": (7, [5.89, 5.91, 6.09, 6.11], [0.3, 0.0, 0.0, 0.3]),
}


@pytest.mark.parametrize(("row", "at", "expected"), LANES.values(), ids=LANES)
def test_lanes_of_orange(row, at, expected):
    y = HALL.at(0, row)[1] - (0.3 if row == 1 else 0.0)
    np.testing.assert_allclose(heights(ORANGE_2025, [(x, y) for x in at]), expected, atol=2e-3)


def test_posts_of_red_are_cubic_and_its_ceiling_low():
    found = heights(RED_2025, [(x, y) for x in np.arange(3.65, 8.4, 0.1) for y in np.arange(1.25, 2.4, 0.1)])
    assert set(np.round(found, 3)) == {0.0, 0.1, 0.2, 0.3, 0.4}
    assert heights(RED_2025, [(6.0, 9.0)]) == pytest.approx([0.85], abs=ATOL)


def test_a_victim_is_seen_through_the_hole_of_its_box_only():
    boxes = victim_box((0.0, 0.0), 0.0)
    front = BOX_LENGTH - BACK
    holes = []
    for z in np.arange(0.05, 0.95, 0.05):
        for y in np.arange(-0.3, 0.31, 0.05):
            hit = any(
                abs(front - 0.01 - s.at[0]) <= s.size[0]
                and abs(y - s.at[1]) <= s.size[1]
                and abs(z - s.at[2]) <= s.size[2]
                for s in boxes
            )
            if not hit:
                holes.append((round(y, 2), round(z, 2)))
    above = [(y, z) for y, z in holes if z > SLOT]
    assert above
    assert all(abs(y) <= HOLE / 2 and abs(z - EYES) <= HOLE / 2 for y, z in above)
    assert 0.6 < EYES - rest_height("sitting") + 0.12 < 0.9, "the head's height"


def follow(arena, robot, row, columns=(1.6, 8.4)):
    """Drive a robot through a lane of a hall."""
    start = StartPose(tag="S", at=(*HALL.at(1, row), START_ELEVATION))
    trial = Trial(arena, ROBOTS.get(robot))
    trial.reset_to(start)
    return trial.follow([HALL.at(column, row) for column in columns], 60.0)


@pytest.mark.parametrize("row", [3, 5])
def test_a_talon_gets_over_hurdles_and_stairs_of_orange(row):
    assert follow(ORANGE_2025, "Talon", row, (1.6, 7.9)).fault == ""


def test_a_p2at_does_not_get_onto_the_stairs():
    assert follow(ORANGE_2025, "P2AT", 5).fault.startswith("stuck")
