"""What is on the solids of shipped arenas: something for cameras to hold on to, and signs to read."""

import math

import numpy as np
import pytest

from tests.sensors.cameras.test_qr_signs import SIDE, text_of
from tests.viewpoints import viewpoint_at
from usarmjx.models.arenas import ARENAS
from usarmjx.models.arenas.lanes import LANES
from usarmjx.models.arenas.league_hall import wall_sign
from usarmjx.models.arenas.pieces import BARE, CELL, WOOD, finished
from usarmjx.models.arenas.yellow import YELLOW_2025
from usarmjx.models.types.shapes import GLASS, Shape
from usarmjx.server.worlds.dynamic_world import DynamicWorld

FINISHED = ["yellow", "orange", "red", "yellow_2025", "orange_2025", "red_2025", "factory", "outdoor", "pool"]


@pytest.mark.parametrize("name", FINISHED)
def test_most_of_what_stands_in_an_arena_has_a_texture(name):
    stands = [s for s in ARENAS.get(name).shapes if s.surface in ("wall", "ground")]
    solids = [s for s in stands if s.kind == "box" and s.rgba[3] == 1.0]  # no terrain, no roof
    area = np.array([max(a * b for a in s.size for b in s.size if a is not b) for s in solids])
    textured = np.array([bool(s.texture) for s in solids])
    assert area[textured].sum() > 0.8 * area.sum()
    assert all(not s.texture for s in ARENAS.get(name).shapes if s.material == GLASS)


def test_the_elements_of_lanes_are_of_wood_or_concrete():
    for _, lane in LANES:
        found = {s.texture for s in lane.arena.shapes if s.rgba == WOOD}
        assert found <= {"wood"}
    assert {s.texture for s in LANES.get("continuous").arena.shapes} == {"wood", "concrete"}


def test_what_has_a_texture_of_its_own_keeps_it():
    plank = Shape(kind="box", size=(1.0, 1.0, 1.0), rgba=WOOD)
    sign = wall_sign((0.0, 0.0), 0.0, "tag:3")
    other = Shape(kind="box", size=(1.0, 1.0, 1.0), rgba=(0.1, 0.2, 0.3, 1.0))
    assert [s.texture for s in finished((plank, sign, other), BARE)] == ["wood", "tag:3", ""]


def test_all_sorts_of_signs_hang_in_todays_arenas():
    for name in ("yellow_2025", "orange_2025", "red_2025"):
        signs = {s.texture.partition(":")[0] for s in ARENAS.get(name).shapes if s.surface == "fixture"}
        assert signs == {"chart", "hazmat", "tag", "qr"}


@pytest.mark.oracle
def test_a_robot_in_yellow_2025_reads_a_code_on_the_wall():
    world, size = DynamicWorld(YELLOW_2025), 240
    at = np.array([0.035 + 1.0, 1.5 * CELL, 0.8])
    view = viewpoint_at(at, math.pi, 0.0).replace(fov=np.float32(0.5))
    picture = world._single.sight().render(world._single.render_scene(), view, size, size)
    focal, cells = size / 2 / math.tan(0.25), 0.15 * (2 * (np.arange(SIDE) + 4.5) / (SIDE + 8) - 1)
    places = (size / 2 + focal * cells - 0.5).round().astype(int)
    seen = np.asarray(picture.rgb)[np.ix_(places, places)].mean(-1)
    assert text_of(seen < seen.max() / 2) == "USARMJX 6"
