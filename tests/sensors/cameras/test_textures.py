"""What is on surfaces in pictures: patterns and signs, against scalar references."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.sensors.cameras.stages import stage_of, wall
from tests.viewpoints import viewpoint_at
from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsarmjxError
from usarmjx.models.files.load import load_arena
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import (
    CODE_STRIDE,
    SIGNS,
    TEXTURES,
    Shape,
    texture_code,
    texture_names,
    texture_problem,
)
from usarmjx.sensors.cameras.paint import ARENA_LABEL
from usarmjx.sensors.cameras.shading import (
    BRICK,
    BRICK_CONTRAST,
    LANDOLT_RINGS,
    MORTAR_SHADE,
    TILE,
    apply_textures,
    noise,
    shade,
)
from usarmjx.sensors.rays.raycast import EXCLUDE_NONE
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.scene import build_scene

GREY = 0.5
NOWHERE = np.full(1, 9.0, np.float32)


def pattern(name, across, up):
    """The factor on a grey surface's colour at places [m] (n,)."""
    across, up = np.broadcast_arrays(np.float32(across), np.float32(up))
    shape, across, up = across.shape, across.ravel(), up.ravel()
    code, rgb = np.full(len(across), texture_code(name)), np.full((3, len(across)), GREY, np.float32)
    away = np.broadcast_to(NOWHERE, across.shape)
    with numpy_backend():
        seen = apply_textures({name}, code, rgb, (across, up), (away, away))
    return (seen[0] / GREY).reshape(shape)


def sign(texture, u, v):
    """The colours of a sign at places from -1 to 1, to the right and up (n,): (n, 3)."""
    u, v = (np.float32(np.atleast_1d(x)) for x in (u, v))
    code, rgb = np.full(len(u), texture_code(texture)), np.full((3, len(u)), GREY, np.float32)
    with numpy_backend():
        return apply_textures(texture_names(code), code, rgb, (u, v), (u, v)).T


def grid(step=0.01):
    return np.meshgrid(np.arange(-1 + step / 2, 1, step), np.arange(-1 + step / 2, 1, step))


def test_noise_is_even_and_tells_places_apart():
    i, j = np.meshgrid(np.arange(-100, 100), np.arange(-100, 100))
    values = noise(i, j, 3)
    counts = np.histogram(values, 10, (0, 1))[0]
    # 4000 in each of ten parts, good to their deviation of 60: five times that.
    assert np.abs(counts - 4000).max() < 300
    for shifted in (values[1:], values[:, 1:].T):
        before = values[:-1] if shifted.shape == values[1:].shape else values[:, :-1].T
        assert abs(np.corrcoef(shifted.ravel(), before.ravel())[0, 1]) < 0.03
    assert abs(np.corrcoef(values.ravel(), noise(i, j, 4).ravel())[0, 1]) < 0.03
    np.testing.assert_array_equal(np.asarray(noise(jnp.asarray(i), jnp.asarray(j), 3)), values)


@pytest.mark.oracle
def test_bricks_have_joints_every_brick_and_each_row_is_shifted_by_half_a_brick():
    length, height = BRICK
    for row in (-3, 0, 1, 4):
        middle = (row + 0.5) * height
        at = np.arange(-2, 3) * length - 0.5 * (row % 2) * length
        assert pattern("brick", at + 0.005, middle) == pytest.approx(MORTAR_SHADE)
        bricks = pattern("brick", at + length / 2, middle)
        assert (bricks > MORTAR_SHADE).all()
        assert len(np.unique(bricks.round(3))) == len(bricks), "each has its own shade"
        assert pattern("brick", at + length / 2, row * height + 0.005) == pytest.approx(MORTAR_SHADE)


@pytest.mark.oracle
def test_tiles_have_joints_every_tile_both_ways():
    at = np.arange(-3, 4) * TILE
    middle, joint = pattern("tiles", at + TILE / 2, TILE / 2), pattern("tiles", at + 0.004, TILE / 2)
    assert (joint < middle).all()
    np.testing.assert_allclose(joint, joint[0])
    np.testing.assert_allclose(pattern("tiles", TILE / 2, at + 0.004), joint[0])


@pytest.mark.parametrize("name", [name for name in TEXTURES if name not in SIGNS])
def test_patterns_have_features_at_every_scale_and_keep_the_colour(name):
    """A surface of half a metre is about as bright as its colour, and differs within 5 cm as well."""
    x, y = np.meshgrid(np.arange(0, 1.5, 0.005), np.arange(0, 1.5, 0.005))
    seen = pattern(name, x, y)
    assert 0.6 < seen.mean() < 1.1
    small = seen.reshape(30, 10, 30, 10).std((1, 3))
    assert (small > 0.01).mean() > 0.8
    assert seen.reshape(3, 100, 3, 100).std((1, 3)).min() > 0.05


@pytest.mark.oracle
@pytest.mark.parametrize("number", [0, 7])
def test_a_chart_has_nested_rings_of_landolt(number):
    """Five strokes wide, one the ring and one its gap (ISO 8596), each half as large as the one around it."""
    for ring in range(LANDOLT_RINGS):
        outer = 0.95 * 0.5**ring
        angle = np.arange(0, 2 * math.pi, 0.01)
        dark = sign(f"chart:{number}", 0.8 * outer * np.cos(angle), 0.8 * outer * np.sin(angle))[:, 0] < 0.5
        # A gap of a stroke's width, 0.4 of the radius, is seen from the middle under 2 asin(0.2 / 0.8).
        gap = (~dark).mean() * 2 * math.pi
        assert gap == pytest.approx(2 * math.asin(0.2 / 0.8), abs=0.03)
        middle = np.angle(np.exp(1j * angle[~dark]).sum()) / (math.pi / 4)
        assert abs(middle - round(middle)) < 0.05
        for radius, black in ((1.02, False), (0.98, True), (0.62, True), (0.58, False)):
            behind = middle * math.pi / 4 + math.pi
            u, v = radius * outer * math.cos(behind), radius * outer * math.sin(behind)
            assert (sign(f"chart:{number}", u, v)[0, 0] < 0.5) == black


@pytest.mark.oracle
def test_a_tag_is_the_marker_of_its_number():
    """Cells of numbers 0 and 7 of ArUco's DICT_4X4_50, white as 1, within a black and a white border."""
    bits = {0: "1011 0101 0011 0010", 7: "1100 0100 1111 0010"}
    middles = (np.arange(8) + 0.5) / 4 - 1
    for number, rows in bits.items():
        u, v = np.meshgrid(middles, middles[::-1])  # rows from the top
        seen = sign(f"tag:{number}", u.ravel(), v.ravel()).reshape(8, 8, 3)[..., 0] > 0.5
        expected = np.ones((8, 8), bool)
        expected[1:-1, 1:-1] = False
        expected[2:-2, 2:-2] = [[bit == "1" for bit in row] for row in rows.split()]
        np.testing.assert_array_equal(seen, expected)


@pytest.mark.oracle
@pytest.mark.parametrize("number", [1, 3, 5])
def test_a_hazmat_label_is_a_diamond_with_as_many_bars_as_its_class(number):
    u = np.arange(-0.5, 0.5, 0.002)
    row = sign(f"hazmat:{number}", u, np.full(u.shape, -0.35))[:, 0] < 0.5
    assert (np.diff(row.astype(int)) == 1).sum() == number
    upper, lower, rim, beside = sign(f"hazmat:{number}", [0.0, 0.0, 0.0, 0.8], [0.7, -0.1, 0.92, 0.8])
    assert upper.max() - upper.min() > 0.4, "coloured"
    assert lower.tolist() == [1.0, 1.0, 1.0]
    assert rim.max() < 0.1
    assert beside.min() > 0.7
    others = {tuple(sign(f"hazmat:{n}", 0.0, 0.7)[0]) for n in range(1, 6)}
    assert len(others) == 5


def turned(texture, **more):
    """A box that looks at the camera by its left side: 2 x 1.2 m seen, a sign of 1.2 m in its middle."""
    box = Shape(kind="box", at=(3.1, 0.2, 1.0), size=(1.0, 0.1, 0.6), rotation=(0, 0, math.pi / 2), **more)
    return replace(box, surface="wall", texture=texture, rgba=(GREY, GREY, GREY, 1.0))


ARENA_OF_ONE = ArenaSpec(
    name="hall",
    shapes=(turned("tag:7"),),
    starts=(StartPose(tag="A", at=(0.0, -3.0, 0.188)),),
    extent=((-4.0, 5.0), (-4.0, 4.0)),
)


def test_a_served_picture_shows_a_tag_upright_on_the_middle_of_a_face():
    """Of a world on C MuJoCo: the centre of each cell of the marker, by the pinhole's formula."""
    world, size = DynamicWorld(ARENA_OF_ONE), 96
    view = viewpoint_at(np.array([0.0, 0.2, 1.0]), 0.0, 0.0).replace(fov=np.float32(0.6))
    picture = world._single.sight().render(world._single.render_scene(), view, size, size)
    focal, middles = size / 2 / math.tan(0.3), 0.6 * ((np.arange(8) + 0.5) / 4 - 1)
    columns, rows = np.meshgrid(
        size / 2 + focal * middles / 3.0 - 0.5, size / 2 + focal * middles / 3.0 - 0.5
    )
    seen = np.asarray(picture.rgb)[rows.round().astype(int), columns.round().astype(int), 0] > 80
    inner = [[bit == "1" for bit in row] for row in ("1100", "0100", "1111", "0010")]
    np.testing.assert_array_equal(seen[2:-2, 2:-2], inner)
    assert not seen[1, 1:-1].any()
    assert seen[0].all()


def test_compiled_pictures_show_the_same_and_what_has_no_texture_has_its_bricks():
    stage = stage_of(
        wall((2.1, 0.0, 1.0), (0.1, 1.0, 0.6), (GREY,) * 3),
        wall((2.1, 3.0, 1.0), (0.1, 1.0, 0.6), (GREY,) * 3),
    )
    codes = np.array([texture_code("tag:0"), 0], np.int32)
    look = stage.appearance.replace(texture=codes, textures=texture_names(codes))
    places = np.array([[2.0, 0.6 * -u, 1.0 + 0.6 * v] for v in (0.375, -0.375) for u in (-0.375, 0.125)])
    places = np.concatenate([places, [[2.0, 3.3, 1.1], [2.0, 3.3, 1.3]]])
    along = places - [0.0, 0.0, 1.0]
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    start = jnp.tile(jnp.array([0.0, 0.0, 1.0]), (len(along), 1))
    seen = jax.jit(shade)(
        stage.replace(appearance=look), start, jnp.asarray(along, jnp.float32), jnp.asarray(EXCLUDE_NONE)
    )
    rgb = np.asarray(seen.rgb)[:, 0]
    # Cells (row, column) of number 0: (0, 0) is 1, (0, 2) is 1, (3, 0) is 0, (3, 2) is 1.
    assert (rgb[:4] > rgb[4]).tolist() == [True, True, False, True]
    assert rgb[4] / rgb[5] == pytest.approx((1 - BRICK_CONTRAST) / (1 + BRICK_CONTRAST), rel=1e-4)
    assert (np.asarray(seen.label) == ARENA_LABEL).all()


def test_a_file_names_textures_and_wrong_ones_are_refused_with_what_there_is(tmp_path):
    text = "name: T\nstarts: [{{tag: A, at: [0, 0, 0.188]}}]\n"
    text += "shapes: [{{kind: box, size: [1, 1, 1], texture: {}}}]\n"
    path = tmp_path / "t.yaml"
    path.write_text(text.format("chart:4"))
    assert load_arena(path).shapes[0].texture == "chart:4"
    for wrong in ("marble", "brick:2", "tag:10", "hazmat:x"):
        path.write_text(text.format(wrong))
        with pytest.raises(UsarmjxError, match=r"no texture '.*'; known: brick, tiles, wood, concrete, "):
            load_arena(path)
    crate = replace(ARENA_OF_ONE, shapes=(turned("marble"),))
    with pytest.raises(UsarmjxError, match=r"no texture 'marble'; known"):
        build_scene(crate, [])
    assert [texture_problem(name) for name in ("", *TEXTURES)] == [""] * (1 + len(TEXTURES))
    assert texture_code("tag:7") == TEXTURES.index("tag") + 1 + 7 * CODE_STRIDE
