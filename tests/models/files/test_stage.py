"""World files of Stage as arenas: definitions, includes, bitmaps, blocks, robots."""

import math

import numpy as np
import pytest
from PIL import Image

from tests.models.files.worlds import write
from usarmjx.base.errors import ArenaFileError
from usarmjx.models.files.load import load_arena, read_arena
from usarmjx.models.files.stage import stage_content

EXACT = 1e-9  # m

INC = """# what rooms are
define wall model ( color "gray30" size [1 0.1 2] )
define thick wall ( size [1 0.5 2] obstacle_return 1 )
"""
WORLD = """include "walls.inc"
window ( size [600 400] scale 20 )
resolution 0.02
thick ( name "a" pose [1 2 0 90] mass 5 )
wall ( pose [4 0 0.5 0] model ( size [0.2 0.2 0.3] pose [0.3 0 0 0] ) )
define pioneer position ( size [0.44 0.38 0.22] ranger ( pose [0 0 0 0] ) )
pioneer ( name "r0" pose [-2 -1 0 45] )
pioneer ( pose [-3 -1 0 0] )
fiducial ( pose [0 0 0 0] )
"""


def test_definitions_add_up_and_robots_become_start_poses(tmp_path):
    write(tmp_path / "walls.inc", INC)
    arena, notes = read_arena(write(tmp_path / "a.world", WORLD))
    thick, wall, child = arena.shapes
    assert thick.size == pytest.approx((0.5, 0.25, 1))
    assert thick.at == pytest.approx((1, 2, 1))
    assert thick.rotation == pytest.approx((0, 0, math.pi / 2))
    assert thick.rgba[:3] == pytest.approx((77 / 255,) * 3)
    assert wall.at == pytest.approx((4, 0, 1.5))
    assert child.at == pytest.approx((4.3, 0, 2.65))  # on top of the wall, as Stage stacks
    assert [(start.tag, start.at[:2]) for start in arena.starts] == [("r0", (-2, -1)), ("robot1", (-3, -1))]
    assert arena.starts[0].yaw == pytest.approx(math.pi / 4)
    assert [note.rpartition("a.world:")[2] for note in notes] == [
        "7: robot pioneer 'r0' becomes the start pose r0",
        "8: robot pioneer 'robot1' becomes the start pose robot1",
        "9: models of other types are left out: fiducial",
        "3: properties are left out: resolution, mass",
    ]


def test_the_dark_pixels_of_a_bitmap_span_the_size(tmp_path):
    pixels = np.full((6, 10), 255, np.uint8)
    pixels[1, 1:9] = pixels[4, 1:9] = pixels[1:5, 1] = 0  # 8 x 4 dark pixels: two lines and a side
    Image.fromarray(pixels).save(tmp_path / "plan.png")
    text = (
        'define floorplan model ( boundary 0 )\nfloorplan ( bitmap "plan.png" size [8 4 1.5] pose [1 0 0 0] )'
    )
    content = stage_content(write(tmp_path / "a.world", text))
    filled = np.zeros((4, 8), int)
    for shape in content.shapes:
        low, high = (np.rint(np.array(shape.at) + s * np.array(shape.size) - (-3, -2, 0)) for s in (-1, 1))
        (x0, y0, z0), (x1, y1, z1) = low.astype(int).tolist(), high.astype(int).tolist()
        assert (z0, shape.size[2]) == (0, 0.75)
        assert z1 == 2  # 1.5 rounded
        filled[y0:y1, x0:x1] += 1
    np.testing.assert_array_equal(filled[::-1] > 0, pixels[1:5, 1:9] == 0)
    assert "plan.png, 8 x 4 of 10 x 6, span the size" in content.warnings[0]


def test_blocks_are_scaled_to_the_size_and_cut_into_convex_ones(tmp_path):
    """An L of three unit squares that fills 4 x 4 m."""
    points = "points 6 " + " ".join(
        f"point[{i}] [{x} {y}]" for i, (x, y) in enumerate([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)])
    )
    text = f'model ( size [4 4 1] color "blue" block ( {points} z [0 2] ) )'
    shapes = stage_content(write(tmp_path / "a.world", text)).shapes
    assert len(shapes) == 2
    area = 0.0
    for shape in shapes:
        if shape.kind == "box":
            area += 4 * shape.size[0] * shape.size[1]
        else:
            x, y = shape.mesh.vertices[: len(shape.mesh.vertices) // 2, :2].T
            area += abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
        assert shape.at[2] == pytest.approx(0.5)
    assert area == pytest.approx(12)


def test_blocks_of_older_versions_are_properties_of_their_model(tmp_path):
    corners = " ".join(f"block[0].point[{i}] [{x} {y}]" for i, (x, y) in enumerate([(0, 0), (1, 0), (0, 1)]))
    text = (
        f'model ( size [2 2 1] blocks 1 block[0].points 3 {corners} block[0].z [0 1] block[0].color "blue" )'
    )
    (shape,) = stage_content(write(tmp_path / "a.world", text)).shapes
    assert shape.rgba == (0, 0, 1, 1)
    np.testing.assert_allclose(shape.mesh.vertices[:3, :2] + shape.at[:2], [[-1, -1], [1, -1], [-1, 1]])


def test_a_boundary_is_four_walls_within_the_size(tmp_path):
    walls = stage_content(write(tmp_path / "a.world", "model ( size [6 4 1] boundary 1 )")).shapes
    corners = np.array([np.abs(wall.at[:2]) + wall.size[:2] for wall in walls])
    assert len(walls) == 4
    np.testing.assert_allclose(corners.max(0), (3, 2), atol=EXACT)


def test_old_poses_and_units(tmp_path):
    text = 'unit_length "cm"\nunit_angle "radians"\nmodel ( size [200 100] pose [300 0 1.5] )'
    (shape,) = stage_content(write(tmp_path / "a.world", text)).shapes
    assert shape.size == pytest.approx((1, 0.5, 0.5))
    assert shape.at == pytest.approx((3, 0, 0.5))
    assert shape.rotation[2] == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("model ( size [1 2 3]", r"a.world:1: the file ends within brackets"),
        ("\nmodel ( pose [1 2] )", r"a.world:2: pose is '1.0 2.0', expected 3 or 4 numbers"),
        ('include "gone.inc"', r"a.world:1: includes 'gone.inc', which is not there"),
        ('include "a.world"', "a.world includes itself"),
        ('model ( bitmap "gone.png" )', r"a.world:1: the bitmap 'gone.png' is not there"),
        ("define a a ( )\na ( )", "places no solids and no robots; it has: a"),
        ("model ( block ( points 3 point[0] [0 0] point[2] [1 0] ) )", r"has no point\[1\]; points is 3"),
        ("model ( size [1 0 3] )", r"size \[1.0, 0.0, 3.0\]: wants lengths above 0"),
        ("model ( @ )", "'@ [)]' is no part of a world file"),
        ("name", "name has no value"),
        ("define a model ( )", "places no solids and no robots; it has: no models"),
    ],
)
def test_a_mistake_is_named(text, says, tmp_path):
    with pytest.raises(ArenaFileError, match=says):
        load_arena(write(tmp_path / "a.world", text))


def test_what_nothing_meets_is_left_out_and_ghosts_are_seen(tmp_path):
    text = "model ( obstacle_return 0 ranger_return -1 laser_return 0 )\nmodel ( obstacle_return 0 )"
    content = stage_content(write(tmp_path / "a.world", text))
    (ghost,) = content.shapes
    assert ghost.surface == "fixture"
    assert "a.world:1: model is no obstacle and no ranger sees it: left out" in content.warnings[0]
