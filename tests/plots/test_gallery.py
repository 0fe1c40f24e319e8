"""Pictures of arenas: things have their colours where they are."""

import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread

from usarmjx.models.compile.compose import new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.types.arena import (
    ArenaSpec,
    Door,
    FalseAlarm,
    Light,
    LooseObject,
    StartPose,
    Tag,
    Victim,
    Water,
)
from usarmjx.models.types.shapes import HeightField, Shape
from usarmjx.plots import floor_plan, gallery, picture, render
from usarmjx.plots.render import camera_rays
from usarmjx.sensors.cameras.paint import MIRROR_REFLECTANCE

RED, GREEN, BLUE = (0.8, 0.0, 0.0, 1.0), (0.0, 0.8, 0.0, 1.0), (0.0, 0.0, 0.8, 1.0)


def box(at: tuple, size: tuple, **more) -> Shape:
    return Shape(kind="box", at=at, size=size, **{"surface": "wall", **more})


ROOM = ArenaSpec(
    name="Room",
    about="A room with one of everything.",
    floor=-1.5,
    shapes=(
        box((3.0, 0.0, 0.5), (0.1, 2.0, 0.5)),
        box((-1.0, 1.5, 0.5), (0.5, 0.05, 0.5), material="glass"),
        box((1.0, 1.5, 0.5), (0.5, 0.05, 0.5), material="mirror"),
        box((0.0, -1.7, 0.1), (0.4, 0.2, 0.1), surface="ground"),
        box((0.0, 0.0, 8.0), (9.0, 9.0, 0.1), material="sky"),
        box((-1.5, -1.0, 2.5), (0.3, 0.3, 0.1)),
    ),
    starts=(StartPose(tag="A", at=(-1.5, 0.5, 0.188)),),
    extent=((-2.0, 4.0), (-2.0, 2.0)),
    loose=(
        LooseObject(name="crate", at=(2.0, -1.2, 0.2), shapes=(box((0, 0, 0), (0.2, 0.2, 0.2), mass=1.0),)),
    ),
    doors=(Door(name="door", at=(1.0, -0.6, 0.0), yaw=math.pi / 2),),
    waters=(Water(low=(3.2, -1.8, 0.0), high=(3.9, -1.0, 0.2)),),
    victims=(Victim(name="one", at=(0.0, 0.5, 0.2)),),
    false_alarms=(FalseAlarm(part="Head", at=(-0.5, -1.2, 0.2)),),
    tags=(Tag(at=(3.5, 1.5, 0.0)),),
    lights=(Light(at=(3.5, 0.5, 2.0)),),
)
EVERYWHERE = {
    picture.WALL: (3.0, 0.7),
    picture.STYLES["glass"]["facecolor"]: (-1.0, 1.5),
    picture.STYLES["mirror"]["facecolor"]: (1.0, 1.5),
    picture.PAPER: (-1.5, -1.0),  # below what is overhead
    floor_plan.WATER: (3.5, -1.4),
    floor_plan.DOOR: (1.0, -0.2),
    floor_plan.VICTIM: (0.0, 0.5),
    floor_plan.ALARM: (-0.5, -1.2),
    floor_plan.TAG: (3.5, 1.5),
    floor_plan.LAMP: (3.5, 0.5),
    floor_plan.START: (-1.5, 0.5),
}


def drawn(arena: ArenaSpec, **options) -> tuple[np.ndarray, object]:
    """The plan in pixels from the top, and what turns places into pixels from the bottom."""
    figure = Figure(figsize=(9, 6), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    floor_plan.draw_plan(axes, arena, **options)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3] / 255, axes.transData


def test_everything_has_its_colour_where_it_is_on_the_plan():
    image, pixels = drawn(ROOM)
    for colour, place in EVERYWHERE.items():
        column, row = pixels.transform(place)
        found = image[image.shape[0] - 1 - round(row), round(column)]
        assert found == pytest.approx(to_rgb(colour), abs=0.02), place


def test_higher_ground_is_darker_and_terrain_has_contours():
    low, high = (box((x, 0.0, z / 2), (0.3, 0.3, z / 2), surface="ground") for x, z in ((0, 0.1), (1, 1.0)))
    image, pixels = drawn(replace(ROOM, shapes=(low, high), victims=()))
    bright = []
    for x in (0.0, 1.0):
        column, row = pixels.transform((x, 0.15))
        bright.append(image[image.shape[0] - 1 - round(row), round(column)].sum())
    assert bright[1] < bright[0] - 0.2
    slope = np.tile(np.linspace(0.0, 1.0, 9), (9, 1))
    hill = Shape(kind="hfield", size=(2.0, 1.0, 0.1), heights=HeightField(slope), surface="ground")
    image, pixels = drawn(ArenaSpec(name="hill", starts=(), extent=ROOM.extent, shapes=(hill,)))
    column, row = pixels.transform((0.0, 0.0))
    line = image[image.shape[0] - 1 - round(row)]
    left, right = (round(pixels.transform((x, 0.0))[0]) for x in (-1.8, 1.8))
    assert line[left].sum() > line[right].sum() + 0.2, "the hill rises along x"


def test_words_can_be_left_out():
    with_words, pixels = drawn(ROOM)
    without, _ = drawn(ROOM, words=False)
    differ = np.argwhere(np.abs(with_words - without).max(-1) > 0.2)
    near = [
        (np.abs(differ - (len(without) - 1 - pixels.transform(at)[1], pixels.transform(at)[0])).max(-1) < 60)
        for at in (ROOM.tags[0].at[:2], ROOM.starts[0].at[:2])
    ]
    assert all(one.sum() > 10 for one in near)


def test_the_file_has_a_legend_of_what_is_there(tmp_path: Path):
    path = tmp_path / "new" / "plan.png"
    floor_plan.floor_plan_picture(ROOM, path)
    assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    image = imread(path)[..., :3]
    legend = image[-80:]
    for colour in (floor_plan.VICTIM, floor_plan.ALARM, floor_plan.WATER, picture.WALL):
        assert (np.abs(legend - to_rgb(colour)).max(-1) < 0.02).sum() > 50, colour
    floor_plan.floor_plan_picture(replace(ROOM, victims=(), false_alarms=()), path)
    legend = imread(path)[-80:, :, :3]
    assert not (np.abs(legend - to_rgb(floor_plan.VICTIM)).max(-1) < 0.02).any()


STAGE = replace(
    ROOM,
    shapes=(
        box((1.5, 1.0, 0.5), (0.3, 0.3, 0.5), rgba=RED),
        box((1.5, 0.2, 0.6), (0.6, 0.02, 0.6), material="glass", rgba=GREEN),
        box((-1.0, 1.5, 0.6), (0.8, 0.05, 0.6), material="mirror", rgba=GREEN),
        box((-0.4, 0.0, 0.4), (0.3, 0.3, 0.4), rgba=BLUE),
    ),
    victims=(),
    false_alarms=(),
    loose=(),
    doors=(),
    waters=(),
)
EYE, TARGET, WIDTH, HEIGHT = np.array([0.5, -7.0, 1.2]), np.array([0.3, 0.5, -1.0]), 60, 40


@pytest.mark.oracle
@pytest.mark.thorough
def test_glass_shows_what_is_behind_it_and_mirrors_what_they_reflect():
    """Every pixel against C MuJoCo's rays: straight on, through the glass, and thrown back by the mirror."""
    model = new_spec(STAGE, Physics()).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    glass, mirror = (model.geom(f"arena/{i}").id for i in (1, 2))
    pixels = render.render_picture(gallery.arena_render_geoms(STAGE), EYE, TARGET, WIDTH, HEIGHT).reshape(
        -1, 3
    )
    colours = {model.geom(f"arena/{i}").id: k for i, k in ((0, 0), (1, 1), (3, 2))}
    hit, normal, seen = np.zeros(1, np.int32), np.zeros(3), []
    for ray, found in zip(camera_rays(EYE, TARGET, WIDTH, HEIGHT).astype(float), pixels, strict=True):
        way = mujoco.mj_ray(model, data, EYE, ray, None, 1, -1, hit, normal)
        first, point = int(hit[0]), EYE + way * ray
        if first == glass:
            mujoco.mj_ray(model, data, point + 0.06 * ray, ray, None, 1, -1, hit, None)
        elif first == mirror:
            back = ray - 2 * (ray @ normal) * normal
            mujoco.mj_ray(model, data, point + 1e-3 * back, back, None, 1, -1, hit, None)
        kind = (first, int(hit[0]))
        if first in colours and first != glass:
            assert found[colours[first]] > 0.3
            assert np.delete(found, colours[first]) == pytest.approx([0, 0], abs=1e-6)
        elif first == glass and kind[1] in colours:
            assert found[0] > 0.1, "the red box behind the pane, perhaps in shadow"
            assert found[1] > 0.05, "the pane is green"
            assert found[2] == pytest.approx(0, abs=1e-6)
        elif first == mirror and kind[1] in colours:
            assert found[2] > 0.2, "the blue box"
            assert found[1] == pytest.approx((1 - MIRROR_REFLECTANCE) * 0.8 * 0.8, abs=0.15), (
                "and a little of its own green"
            )
        seen.append(kind)
    for wanted in ((glass, model.geom("arena/0").id), (mirror, model.geom("arena/3").id)):
        assert seen.count(wanted) > 5, "the test looks at both"


def test_victims_water_doors_and_loose_objects_are_in_the_view():
    room = replace(ROOM, shapes=ROOM.shapes[:1])
    shown = gallery.arena_render_geoms(room)
    bare = gallery.arena_render_geoms(
        replace(room, victims=(), false_alarms=(), doors=(), loose=(), waters=())
    )
    # A victim's head, chest, pelvis, and its arms, hands, legs and feet; one more head, door, crate, water.
    assert len(shown) == len(bare) + (7 + 5 + 2 + 2 * (2 + 3 + 2 + 3)) + 7 + 1 + 1 + 1
    assert len(bare) == 2, "floor and wall"
    assert len(gallery.arena_render_geoms(ROOM)) == len(shown) + len(ROOM.shapes) - 2, "the sky is not seen"


@pytest.mark.thorough
def test_pictures_show_victims_water_doors_and_loose_objects():
    room = replace(ROOM, shapes=ROOM.shapes[:1])
    shown = gallery.arena_render_geoms(room)
    bare = gallery.arena_render_geoms(
        replace(room, victims=(), false_alarms=(), doors=(), loose=(), waters=())
    )
    eye, target = gallery._eye(ROOM, 1.5)
    with_them, without = (render.render_picture(solids, eye, target, 90, 60) for solids in (shown, bare))
    for place in ((0.0, 0.5, 0.2), (2.0, -1.2, 0.4), (3.5, -1.2, 0.2), (1.0, -0.2, 0.6)):
        column, row = pixel(np.add(place, (0, 0, ROOM.floor)), eye, target, 90, 60)
        assert np.abs(with_them - without)[row - 1 : row + 2, column - 1 : column + 2].max() > 0.1, place


def pixel(place: np.ndarray, eye: np.ndarray, target: np.ndarray, width: int, height: int) -> tuple[int, int]:
    """Column and row of a place, from the definition of a pinhole 32 degrees high."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    way = place - eye
    step = 2 * math.tan(math.radians(16)) / height * (way @ forward)
    x, y = way @ right / step, way @ np.cross(right, forward) / step
    return round(x + (width - 1) / 2), round((height - 1) / 2 - y)


@pytest.mark.parametrize("extent", [((-2.0, 4.0), (-2.0, 2.0)), ((0, 1), (0, 40)), ((-200, 200), (-9, 9))])
def test_the_whole_arena_fills_the_picture(extent: tuple):
    arena = replace(ROOM, extent=extent, shapes=())
    eye, target = gallery._eye(arena, 1.5)
    corners = [(x, y, ROOM.floor) for x in extent[0] for y in extent[1]]
    places = np.array([pixel(np.array(corner), eye, target, 1500, 1000) for corner in corners])
    assert (places >= 0).all()
    assert (places[:, 0] < 1500).all()
    assert (places[:, 1] < 1000).all()
    assert (np.ptp(places, axis=0) / (1500, 1000)).max() > 0.85


@pytest.mark.thorough
def test_a_picture_does_not_depend_on_how_it_is_cut_into_chunks(monkeypatch: pytest.MonkeyPatch):
    solids = gallery.arena_render_geoms(STAGE)
    whole = render.render_picture(solids, EYE, TARGET, WIDTH, HEIGHT)
    monkeypatch.setattr(render, "CHUNK", 700)
    parts = render.render_picture(solids, EYE, TARGET, WIDTH, HEIGHT)
    # Another program rounds differently: at outlines a ray may meet the other side.
    assert np.isclose(parts, whole, atol=1e-3).mean() > 0.99


def test_only_a_roof_over_everything_is_left_out():
    canopy = box((0.0, 0.0, 2.5), (1.0, 0.5, 0.05))
    roof = box((1.0, 0.0, 2.5), (2.5, 2.0, 0.05))
    wall, sky = ROOM.shapes[0], ROOM.shapes[4]
    assert gallery.without_roof(replace(ROOM, shapes=(wall, canopy))) == (wall, canopy)
    assert gallery.without_roof(replace(ROOM, shapes=(canopy, sky))) == (canopy, sky)
    assert gallery.without_roof(replace(ROOM, shapes=(wall, canopy, roof))) == (wall,)


def test_sheets_show_all_arenas(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "new" / "sheet.png"
    purple = np.broadcast_to(np.array([0.5, 0.0, 0.5]), (29, 42, 3))
    monkeypatch.setattr(gallery, "perspective", lambda arena, **size: purple)
    other = replace(ROOM, name="Other", shapes=ROOM.shapes[:1])
    gallery.plan_sheet([ROOM, other], path, columns=2)
    image = imread(path)[..., :3]
    halves = np.split(image[:, : image.shape[1] // 2 * 2], 2, axis=1)
    for half in halves:
        assert (np.abs(half - to_rgb(floor_plan.VICTIM)).max(-1) < 0.05).sum() > 20
    gallery.both_sheet([other], path, columns=2)
    left, right = np.split(imread(path)[:, : image.shape[1] // 2 * 2, :3], 2, axis=1)
    assert (np.abs(left - to_rgb(floor_plan.VICTIM)).max(-1) < 0.05).sum() > 20
    assert (np.abs(right - purple[0, 0]).max(-1) < 0.02).mean() > 0.5
