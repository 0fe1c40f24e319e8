"""Films of recordings: pictures against the cameras' raycaster, files, and refusals."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from tests.recording.missions import HEIGHT, ROOM, SCOUT
from usarmjx.cli.app import app
from usarmjx.engines.c.camera_rays import CCameraRays
from usarmjx.plots.films.film import FilmPlan, Shots, caption, picture_times, save_film
from usarmjx.plots.films.picture import FilmScene
from usarmjx.plots.films.raster import Canvas, FilmView, clip_near
from usarmjx.plots.gallery import SUN
from usarmjx.plots.render import Lighting, lit_scene
from usarmjx.recording.reader import Recording
from usarmjx.recording.source import RecordingSource
from usarmjx.sensors.cameras.picture import pinhole_viewpoint
from usarmjx.sensors.rays.targets import Geoms
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.views import geom_colors_of
from usarmjx.view.viewpoint import FOV, fit_box

SIZE = (160, 100)


def run(*words):
    return CliRunner().invoke(app, ["film", *map(str, words)])


def oneline(result):
    return " ".join(result.output.split())


def test_the_nearest_triangle_wins_each_pixel_whose_centre_it_covers():
    canvas = Canvas(8, 6)
    square = np.array([[[1, 1], [5, 1], [5, 5]], [[1, 1], [5, 5], [1, 5]]], float)
    canvas.draw(square, np.full((2, 3), 0.5), np.array([0, 1]))
    slope = np.array([[[-9.0, -9.0], [30.0, -9.0], [-9.0, 30.0]]])
    near = 0.1 * (slope[..., 0] + 9.0) + 0.1  # nearer to the right: x = 0.5 has 1.05
    canvas.draw(slope, near / 4, np.array([2]))
    triangle, nearness = (column.reshape(6, 8) for column in canvas.surface())
    x, y = np.meshgrid(np.arange(8) + 0.5, np.arange(6) + 0.5)
    inside = (x > 1) & (x < 5) & (y > 1) & (y < 5)
    behind = (0.1 * (x + 9.0) + 0.1) / 4
    expected = np.where(inside & (behind < 0.5), np.where(x > y, 0, 1), 2)
    decided = ~inside | (np.abs(x - y) > 0.01)  # on the diagonal either half may win
    assert (triangle == expected)[decided].all()
    assert np.allclose(nearness, np.where(inside, np.maximum(behind, 0.5), behind), atol=1e-6)


def test_triangles_across_the_camera_are_cut():
    corners = np.array(
        [[[0, 0, 1.0], [1, 0, -1.0], [-1, 0, -1.0]], [[0, 0, -1.0], [2, 0, 1.0], [-2, 0, 1.0]]]
    )
    parts, number = clip_near(corners, np.array([5, 6]))
    assert number.tolist() == [5, 6, 6]
    assert (parts[..., 2] > 0).all()
    area = 0.5 * np.linalg.norm(np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0]), axis=-1)
    # Above the camera's plane is a quarter of the first, and three quarters of the second: 0.5 and 3.
    assert area[0] == pytest.approx(0.5, rel=0.07)
    assert area[1:].sum() == pytest.approx(3.0, rel=0.03)


@pytest.fixture(scope="module")
def still():
    """A world, its drawing and its frame."""
    world = DynamicWorld(ROOM, max_robots=3, seed=5)
    world.spawn_at(SCOUT, "First", [((-1.0, 0.0, HEIGHT), (0.0, 0.0, 0.7))])
    for _ in range(30):
        world.step()
    source = ServedSource([world])
    return world, source.drawing(0), source.frame(0)


def test_pictures_are_what_the_cameras_raycaster_sees(still):
    world, drawing, frame = still
    scene = FilmScene(drawing)
    view = FilmView.of(fit_box(*scene.bounds, SIZE[0] / SIZE[1]), *SIZE)
    picture = scene.render(frame, view).astype(int)
    fov = 2 * math.atan(SIZE[0] / SIZE[1] * math.tan(FOV / 2))
    right, up, ahead = view.axes.T
    viewpoint = pinhole_viewpoint(view.eye, np.stack([ahead, -right, up], -1), fov, supersampling=2)
    looks = geom_colors_of(world.scene)
    light = lit_scene(
        Geoms(blocks=(), kinds=(), materials=()),
        looks.appearance,
        Lighting(sun=SUN, checker_size=0.5, checker_extent=ROOM.extent),
    )
    engine = world._single.engine
    seen = CCameraRays(engine.model, engine.data, looks).render(light, viewpoint, *SIZE)
    differ = np.abs(picture - np.asarray(seen.rgb).astype(int)).max(-1)
    # Round solids are 24-sided there, shadows have texels, and edges lie between two samples.
    assert (differ > 24).mean() < 0.04
    assert differ.mean() < 4.0


def test_a_kept_view_gives_the_same_picture_when_something_has_moved(still):
    _, drawing, frame = still
    scene = FilmScene(drawing)
    view = FilmView.of(fit_box(*scene.bounds, SIZE[0] / SIZE[1]), *SIZE)
    scene.render(frame, view, keep=True)
    pos = frame.pos.copy()
    robot = drawing.robots[0]
    pos[robot.body : robot.body + robot.num_bodies] += (0.7, 0.2, 0.0)
    moved = replace(frame, pos=pos)
    kept = scene.render(moved, view, keep=True).astype(int)
    anew = FilmScene(drawing).render(moved, view, keep=True).astype(int)
    assert (kept == anew).all()
    # Without a kept view, pixels within a triangle have one sample in place of four.
    once = FilmScene(drawing).render(moved, view).astype(int)
    assert (np.abs(once - kept).max(-1) > 24).mean() < 0.03


def test_films_have_size_rate_and_length(mission, tmp_path):
    path = tmp_path / "out.gif"
    result = run(
        mission[0], "--out", path, "--size", "160x100", "--rate", "10", "--from", "0.2", "--until", "0.8"
    )
    assert result.exit_code == 0, result.output
    assert "6 pictures" in result.output
    with Image.open(path) as film:
        assert (film.size, film.n_frames) == ((160, 100), 6)
        assert [film.seek(n) or film.info["duration"] for n in range(6)] == [100] * 6
        last = np.array(film.convert("RGB")).astype(int)
    source = RecordingSource(Recording(mission[0]))
    shots = Shots(source, 0, FilmPlan(size=SIZE))
    wanted = shots.picture(0.7).astype(int)  # with the last dot of its trails
    assert np.abs(last - wanted).mean() < 4.0  # of 255 colours


def test_mp4_files_play_thirty_pictures_a_second_behind_a_robot(mission, tmp_path):
    reader = pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "out.mp4"
    plan = FilmPlan(size=SIZE, follow="First", span=(0.2, 0.5))
    assert save_film(Recording(mission[0]), path, plan) == 9
    pictures = reader.read_frames(str(path))
    about = next(pictures)
    assert (about["size"], about["fps"]) == (SIZE, 30.0)
    assert len([*pictures]) == 9


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_a_picture_file_gets_the_first_picture(mission, tmp_path, suffix):
    path = tmp_path / f"out.{suffix}"
    result = run(mission[0], "--out", path, "--size", "160x100", "--from", "0.4")
    assert result.exit_code == 0, result.output
    assert "1 picture," in result.output
    wanted = Shots(RecordingSource(Recording(mission[0])), 0, FilmPlan(size=SIZE)).picture(0.4).astype(int)
    with Image.open(path) as picture:
        apart = np.abs(np.array(picture).astype(int) - wanted)
    assert apart.max() == 0 if suffix == "png" else apart.mean() < 4.0


def test_speed_and_span_choose_the_times():
    times = picture_times(FilmPlan(span=(1.0, 9.0), speed=2.0, rate=10.0), 0.0, 5.0)
    assert np.allclose(times, 1.0 + 0.2 * np.arange(20))


def test_the_line_has_time_and_score(still):
    assert caption(replace(still[2], time=62.25)) == "1:02.2"
    assert caption(replace(still[2], time=5.0, score=3.14)) == "0:05.0   score 3.1"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--out", "x.avi"), "x.avi: films end in .mp4, .gif, .png, .jpg"),
        (("--out", "x.gif", "--size", "wide"), "expected WIDTHxHEIGHT"),
        (("--out", "x.gif", "--size", "10x10"), "64 to 4096 pixels"),
        (("--out", "x.gif", "--follow", "Third"), "no robot 'Third' in that time; known: First, Second"),
        (("--out", "x.gif", "--world", "3"), "has no world 3; it has: 0"),
        (("--out", "x.gif", "--from", "50"), "nothing from 50 to inf s; the recording has 0.02 to 1.2 s"),
    ],
)
def test_refusals_take_one_line(mission, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    result = run(mission[0], *words)
    assert result.exit_code == 2
    assert said in oneline(result)
    assert not [*tmp_path.iterdir()]


def test_an_mp4_without_ffmpeg_names_the_extra(mission, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setenv("PATH", "")
    result = run(mission[0], "--out", tmp_path / "x.mp4")
    assert result.exit_code == 2
    assert "[film]" in result.output
    assert "or write .gif" in oneline(result)
