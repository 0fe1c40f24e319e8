"""Terrain from grey images, and walls from maps of ROS' map_server."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image

import dev
from tests.models.files.worlds import PYRAMID
from usarmjx.base.errors import ArenaFileError
from usarmjx.models.check import check_arena
from usarmjx.models.compile.compose import new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.files import maps
from usarmjx.models.files.images import read_heights, write_heights
from usarmjx.models.files.load import load_arena, read_arena
from usarmjx.models.files.maps import rectangles, without_specks

EXAMPLES = dev.ROOT / "examples" / "arenas"
EXACT = 1e-9  # m


def write(path, text):
    path.write_text(text)
    return path


@pytest.mark.parametrize(("kind", "white"), [(np.uint8, 255), (np.uint16, 65535)])
def test_grey_values_are_heights(kind, white, tmp_path):
    pixels = np.array([[0, white // 5], [white // 3, white], [0, 0]], kind)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    heights = read_heights(tmp_path / "a.png", 3.0)
    np.testing.assert_allclose(heights, [[0, 0], [1, 3], [0, 0.6]], atol=EXACT)  # the last line is near
    (shape,) = load_arena(tmp_path / "a.png").shapes
    assert shape.size == pytest.approx((0.05, 0.1, 0.1))


def test_heights_are_rounded_to_half_a_step(tmp_path):
    heights = np.random.default_rng(0).uniform(0, 7, (5, 4))
    top = write_heights(tmp_path / "a.png", heights)
    np.testing.assert_allclose(
        read_heights(tmp_path / "a.png", top), heights, atol=top / 65535 * 0.5001, rtol=0
    )


def test_a_broken_image_is_one_line(tmp_path):
    whole = (EXAMPLES / "hill.png").read_bytes()
    (tmp_path / "cut.png").write_bytes(whole[: len(whole) // 2])
    Image.new("RGB", (4, 4)).save(tmp_path / "colour.png")
    Image.new("L", (4, 1)).save(tmp_path / "flat.png")
    for name, says in (("cut", "does not read as an image"), ("colour", "mode RGB"), ("flat", "2 x 2")):
        with pytest.raises(ArenaFileError, match=rf"{name}\.png: .*{says}") as caught:
            load_arena(tmp_path / f"{name}.png")
        assert "\n" not in str(caught.value)


@given(arrays.arrays(bool, st.tuples(st.integers(1, 8), st.integers(1, 8))))
def test_rectangles_cover_what_is_filled_once(filled):
    count = np.zeros(filled.shape, int)
    for r0, r1, c0, c1 in rectangles(filled):
        count[r0:r1, c0:c1] += 1
    np.testing.assert_array_equal(count, filled)


def map_file(folder, pixels, **keys):
    Image.fromarray(np.array(pixels, np.uint8)).save(folder / "map.png")
    lines = [f"{key}: {value}" for key, value in {"image": "map.png", "resolution": 0.5, **keys}.items()]
    return write(folder / "map.yaml", "\n".join(lines))


def cells(path, side=0.5, **wanted):
    """Which cells of a map in one row are walls."""
    more = "".join(f", {key}: {value}" for key, value in wanted.items())
    arena = load_arena(write(path.with_name("a.yaml"), f"map: {{file: {path.name}{more}}}\nstarts: []"))
    walls = set()
    for shape in arena.shapes:
        first, last = ((shape.at[0] + sign * shape.size[0]) / side for sign in (-1, 1))
        walls |= set(range(round(first), round(last)))
    return sorted(walls)


GREYS = [[0, 89, 90, 127, 204, 205, 206, 254, 255]]  # occupied 1, .651, .647, .502, .2, .196, .192, .004, 0


@pytest.mark.parametrize(
    ("keys", "wanted", "walls"),
    [
        ({}, {}, [0, 1]),  # above 0.65
        ({}, {"unknown": "occupied"}, [0, 1, 2, 3, 4, 5]),  # 0.196078 is not below 0.196
        ({"negate": 1}, {}, [4, 5, 6, 7, 8]),
        ({"occupied_thresh": 0.5}, {}, [0, 1, 2, 3]),
        ({"mode": "scale"}, {}, [0, 1, 2, 3]),  # from (.65 + .196) / 2 = .423 on
        ({"mode": "raw"}, {}, [1, 2]),  # 65 to 100; more is unknown
        ({"mode": "raw"}, {"unknown": "occupied"}, [1, 2, 3, 4, 5, 6, 7, 8]),
    ],
)
def test_thresholds_are_map_servers(keys, wanted, walls, tmp_path):
    assert cells(map_file(tmp_path, GREYS, **keys), **wanted) == walls


def test_transparent_cells_of_a_graded_map_are_unknown(tmp_path):
    path = map_file(tmp_path, [[0]], mode="scale")
    pixels = np.array([[(0, 255), (100, 255), (100, 128)]], np.uint8)
    Image.fromarray(pixels, "LA").save(tmp_path / "map.png")
    assert cells(path) == [0, 1]
    assert cells(path, unknown="occupied") == [0, 1, 2]


def test_a_map_lies_where_its_origin_is(tmp_path):
    pixels = [[255] * 40] * 40
    pixels[10] = [255] * 30 + [0] * 10  # the last ten cells of the line 29.5 cells from below
    arena = load_arena(map_file(tmp_path, pixels, origin=[1, 2, np.pi / 2], resolution=0.1))
    (wall,) = arena.shapes
    assert wall.size == pytest.approx((0.5, 0.05, 0.6))
    assert wall.at == pytest.approx((1 - 2.95, 2 + 3.5, 0.6), abs=EXACT)  # turned to the left
    assert wall.rotation == (0, 0, np.pi / 2)
    assert arena.extent == (pytest.approx((-3, 1)), pytest.approx((2, 6)))
    (start,) = arena.starts
    assert start.at[2] == 0.188


def test_the_office_is_the_map():
    arena = load_arena(EXAMPLES / "office-map.yaml")
    rows = [[int(v) for v in line.split()] for line in (EXAMPLES / "office.pgm").read_text().splitlines()[4:]]
    filled = np.zeros((16, 24), int)
    for shape in arena.shapes:
        low, high = (
            np.rint((np.array(shape.at) + sign * np.array(shape.size) - (-3, -2, 0)) / 0.25).astype(int)
            for sign in (-1, 1)
        )
        filled[low[1] : high[1], low[0] : high[0]] += 1
    np.testing.assert_array_equal(filled[::-1], np.array(rows) == 0)
    assert len(arena.shapes) <= 9


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("image: gone.pgm\nresolution: 1", "gone.pgm: cannot be read"),
        ("image: a.yaml\nresolution: 1", "does not read as an image"),
        ("image: a.yaml\nresolution: 0", r"a.yaml:2: resolution is 0, expected a number above 0"),
        (
            "image: a.yaml\nresolution: 1\nmode: odd",
            r"a.yaml:3: mode is 'odd', expected one of trinary, scale, raw",
        ),
        (
            "image: a.yaml\nresolution: 1\nnegate: 2",
            "a.yaml:3: negate is 2, expected a whole number from 0 to 1 or true",
        ),
        ("image: a.yaml\nresolution: 1\nscale: 2", r"a.yaml:3: MapDescription has no setting 'scale'"),
        ("image: a.yaml\nresolution: 1\nfree_thresh: 0.9", "free_thresh 0.9 is above occupied_thresh 0.65"),
    ],
)
def test_a_mistake_in_a_map_is_named(text, says, tmp_path):
    with pytest.raises(ArenaFileError, match=says):
        load_arena(write(tmp_path / "a.yaml", text))


def test_a_map_without_a_free_cell_is_told_and_found_by_the_check(tmp_path, caplog):
    Image.new("L", (30, 20), 0).save(tmp_path / "a.png")
    text = "image: a.png\nresolution: 0.1\norigin: [0, 0, 0]\n"
    (tmp_path / "a.yaml").write_text(text)
    arena = load_arena(tmp_path / "a.yaml")
    assert "no free cell: of 30 x 20, 600 are walls and the others unknown; mind `negate`" in caplog.text
    assert any("is on top of shapes[0]" in fault and "a wall" in fault for fault in check_arena(arena))
    caplog.clear()
    (tmp_path / "b.yaml").write_text(text + "negate: 1\n")
    assert check_arena(load_arena(tmp_path / "b.yaml")) == []
    assert not caplog.text


def test_specks_of_a_map_made_by_slam_are_left_out_and_counted(tmp_path, monkeypatch):
    """Walls all 5 m of 50 x 50 m and 0.4 % of single cells: without a `min_blob` there are too many boxes."""
    cells = np.full((1000, 1000), 254, np.uint8)
    cells[::100] = 0
    clean = len(np.unique(np.nonzero(cells == 0)[0]))
    cells[np.random.default_rng(0).random(cells.shape) < 0.004] = 0
    monkeypatch.setattr(maps, "MAX_MAP_BOXES", 2000)
    Image.fromarray(cells).save(tmp_path / "noisy.png")
    text = "image: noisy.png\nresolution: 0.05\norigin: [0, 0, 0]\n"
    write(tmp_path / "noisy.yaml", text)
    arena = write(tmp_path / "arena.yaml", "name: DM-Noisy\nmap: noisy.yaml\n")
    with pytest.raises(ArenaFileError, match="set min_blob in it"):
        load_arena(arena)
    write(tmp_path / "noisy.yaml", text + "min_blob: 0.3\n")
    walls = load_arena(arena).shapes
    assert clean <= len(walls) < 150
    assert sum(shape.size[0] > 24 for shape in walls) == clean
    write(tmp_path / "noisy.yaml", text + "min_blob: -1\n")
    with pytest.raises(ArenaFileError, match="min_blob is -1"):
        load_arena(arena)


def test_a_group_of_cells_is_as_long_as_its_longer_side():
    wall = np.zeros((6, 9), bool)
    wall[0, 0] = wall[2:4, 2] = wall[3, 3] = True  # a speck, and a group two cells high and wide
    wall[5, 5:9] = True
    left, dropped = without_specks(wall, 3)
    assert dropped == 2
    assert left.sum() == 4
    assert without_specks(wall, 1)[1] == 0


def test_an_origin_of_two_numbers_has_no_yaw(tmp_path):
    pixels = [[0, 255], [255, 255]]
    (wall,) = load_arena(map_file(tmp_path, pixels, origin="[1, 2]", mode="trinary", negate=0)).shapes
    assert wall.at == pytest.approx((1.25, 2.75, 0.6))
    assert wall.rotation == (0, 0, 0)


def test_keys_of_other_tools_are_named_and_a_wrong_scale_too(tmp_path):
    arena, notes = read_arena(map_file(tmp_path, [[0, 255], [255, 255]], resolution=5, name="hall", width=2))
    assert len(arena.shapes) == 1
    assert [note.partition("map.yaml:")[2] for note in notes] == [
        "3: name, width of the map left out",
        "2: a cell is 5 m long; `resolution` is that length in metres, as 0.05",
    ]


def ray_on_grid(wall, side, at, angle, step=1e-4):
    """Distance from a point to the first wall cell along a ray, by small steps [m]."""
    for k in range(1, int(20 / step)):
        x, y = at[0] + k * step * np.cos(angle), at[1] + k * step * np.sin(angle)
        row, column = int(y // side), int(x // side)
        if not (0 <= row < wall.shape[0] and 0 <= column < wall.shape[1]):
            return np.inf
        if wall[row, column]:
            return k * step
    return np.inf


def test_rays_meet_the_cells_of_a_jagged_map(tmp_path):
    """Against steps of 0.1 mm over the cells: boxes are the cells exactly, so rays are exact to a step."""
    rng = np.random.default_rng(3)
    wall = rng.random((60, 60)) < 0.25
    wall[22:39, 22:39] = False
    Image.fromarray(np.where(wall[::-1], 0, 255).astype(np.uint8)).save(tmp_path / "map.png")
    arena = load_arena(write(tmp_path / "a.yaml", "image: map.png\nresolution: 0.1\norigin: [0, 0]\n"))
    assert len(rectangles(wall)) > 300  # they overlap
    model = new_spec(arena, Physics()).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for angle in rng.uniform(0, 2 * np.pi, 40):
        ahead = np.array([np.cos(angle), np.sin(angle), 0.0])
        geom = np.zeros(1, np.int32)
        found = mujoco.mj_ray(model, data, np.array([3.05, 3.05, 0.6]), ahead, None, 1, -1, geom, None)
        wanted = ray_on_grid(wall, 0.1, (3.05, 3.05), angle)
        assert (found if found >= 0 else np.inf) == pytest.approx(wanted, abs=2e-4)


def test_a_picture_of_walls_is_not_taken_for_hills(tmp_path):
    plan = np.full((20, 20), 255, np.uint8)
    plan[5] = 0
    Image.fromarray(plan).save(tmp_path / "plan.png")
    with pytest.raises(ArenaFileError, match=r"plan\.png: has the grey values 0, 255 only.*`image: plan"):
        load_arena(tmp_path / "plan.png")
    Image.fromarray(np.where(plan == 0, 0, 254).astype(np.uint8) + (plan == 3)).save(tmp_path / "slam.png")
    with pytest.raises(ArenaFileError, match=r"as a map of walls"):
        load_arena(tmp_path / "slam.png")
    hills = np.arange(400, dtype=np.uint8).reshape(20, 20)
    Image.fromarray(hills).save(tmp_path / "plan.png")
    assert load_arena(tmp_path / "plan.png").shapes[0].kind == "hfield"
    write(tmp_path / "plan.yaml", "image: plan.png\nresolution: 0.1\n")
    with pytest.raises(ArenaFileError, match=r"is the picture of the map plan\.yaml: load that file"):
        load_arena(tmp_path / "plan.png")
    Image.fromarray(plan).save(tmp_path / "said.png")
    terrain = write(tmp_path / "a.yaml", "heightfield: {file: said.png, size: [2, 2], height: 1}\nstarts: []")
    assert load_arena(terrain).shapes[0].kind == "hfield"  # it is said to be one


def test_a_mesh_in_millimetres_is_doubted(tmp_path):
    write(tmp_path / "a.obj", PYRAMID.replace("1", "1000").replace("f 4 3 2 1000", "f 4 3 2 1"))
    text = (tmp_path / "a.obj").read_text().replace("f 1000 ", "f 1 ").replace(" 1000 5", " 1 5")
    write(tmp_path / "a.obj", text)
    _, notes = read_arena(tmp_path / "a.obj")
    assert "its solids span 1000 x 1000 x 1000 m, over 200 m" in notes[0]
    assert "meshes: [{file: a.obj, scale: 0.001}]" in notes[0]
    assert read_arena(write(tmp_path / "a.yaml", "meshes: {file: a.obj, scale: 0.001}"))[1] == ()
    _, notes = read_arena(write(tmp_path / "a.yaml", "meshes: {file: a.obj, scale: 0.00001}"))
    assert "under 5 cm" in notes[0]
