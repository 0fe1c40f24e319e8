"""What becomes of the light behind a lens: distortion, exposure, noise and supersampling, by closed forms."""

import math
from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.sensors.cameras.stages import solid, stage_of
from tests.sensors.cameras.test_annotation import eye
from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsarmjxError
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.kit import camera
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import Light
from usarmjx.models.types.robot import options
from usarmjx.sensors.cameras.lenses import from_tiles, pinhole_rays
from usarmjx.sensors.cameras.mounts import box_filter, cameras_of, quantize
from usarmjx.sensors.cameras.picture import camera_viewpoint, render_picture
from usarmjx.sensors.cameras.shading import INDOOR_GAIN, point_lights, shadow_gain, tone_mapped
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.served_world import CameraRequest
from usarmjx.sim.configure import configure

WIDTH, HEIGHT, FOV = 64, 48, 1.5
PIXEL = 1e-3  # pixels


def pixel_of(along, k1, k2):
    """Where Brown's formula puts a direction in the camera's axes: columns to the right, rows down."""
    focal = WIDTH / 2 / math.tan(FOV / 2)
    x, y = -along[..., 1] / along[..., 0], -along[..., 2] / along[..., 0]
    square = x * x + y * y
    bend = 1 + k1 * square + k2 * square**2
    return focal * x * bend, focal * y * bend


@pytest.mark.oracle
@pytest.mark.parametrize(("k1", "k2"), [(-0.1, 0.0), (0.3, 0.1), (-0.15, 0.05), (0.0, 0.0)])
def test_each_pixel_looks_where_the_lens_shows_what_is_there(k1, k2):
    with numpy_backend():
        rays = pinhole_rays(WIDTH, HEIGHT, np.float32(FOV), np.float32([k1, k2]))
    along = from_tiles(rays.direction, WIDTH, HEIGHT).astype(float)
    right, down = pixel_of(along, k1, k2)
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)
    np.testing.assert_allclose(right, columns, atol=PIXEL)
    np.testing.assert_allclose(down, rows, atol=PIXEL)
    np.testing.assert_allclose(np.linalg.norm(along, axis=-1), 1.0, atol=1e-6)
    corner = np.abs(along[0, 0, 1] / along[0, 0, 0]) / math.tan(FOV / 2)
    assert (corner > 1) == (k1 < 0) or k1 == 0, "a lens that bulges shows more at the edges"


def test_a_lens_that_bulges_has_an_edge_beyond_which_there_is_nothing():
    """r (1 - 0.2 r2) is at most 2 / 3 sqrt(1 / 0.6), 0.861, where r is sqrt(1 / 0.6)."""
    with numpy_backend():
        rays = pinhole_rays(WIDTH, HEIGHT, np.float32(FOV), np.float32([-0.2, 0.0]))
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)
    seen = np.hypot(columns, rows) / (WIDTH / 2 / math.tan(FOV / 2))
    inside, edge = from_tiles(rays.inside, WIDTH, HEIGHT), 2 / 3 * math.sqrt(1 / 0.6)
    np.testing.assert_array_equal(inside[abs(seen - edge) > 0.01], (seen < edge)[abs(seen - edge) > 0.01])
    assert 0.5 < inside.mean() < 0.95
    assert np.isfinite(rays.direction).all()


def test_a_straight_lens_has_the_same_rays_with_and_without_coefficients():
    with numpy_backend():
        plain = pinhole_rays(WIDTH, HEIGHT, np.float32(FOV))
        bent = pinhole_rays(WIDTH, HEIGHT, np.float32(FOV), np.zeros(2, np.float32))
    np.testing.assert_allclose(plain.direction, bent.direction, atol=1e-6)


def test_indoors_what_is_dark_is_brightened_and_nothing_is_lost():
    lamps, none = point_lights((Light(at=(0.0, 0.0, 2.0)),), 0.0), point_lights((), 0.0)
    with numpy_backend():
        assert (shadow_gain(lamps), shadow_gain(none)) == (INDOOR_GAIN, 1.0)
        value = np.linspace(0, 1, 101, dtype=np.float32)
        bright = tone_mapped(value, INDOOR_GAIN)
        np.testing.assert_array_equal(tone_mapped(value, 1.0), value)
    assert (bright[0], bright[-1]) == (0.0, 1.0)
    assert (np.diff(bright) > 0).all(), "what differs still does"
    assert bright[1] / value[1] == pytest.approx(INDOOR_GAIN, rel=0.02)
    assert bright[25] == pytest.approx(2.5 * 0.25 / (1 + 1.5 * 0.25))


def test_the_yellow_arena_is_no_longer_dark():
    """Of what a P2AT sees there that is not the black sky: 94 of 255 on average before, at this start."""
    world = DynamicWorld(ARENAS.get("yellow"))
    start = world.scene.arena.starts[0]
    robot = world.spawn(ROBOTS.get("P2AT"), "R1", start.at, (0.0, 0.0, start.yaw))
    (picture,) = world.snapshot([CameraRequest(robot, 0, 64, 48)])()
    there = np.asarray(picture.segmentation) > 0
    mean = np.asarray(picture.rgb)[there].mean()
    assert 120 < mean < 170
    assert (np.asarray(picture.rgb)[there] == 255).all(-1).mean() < 0.02


def test_noise_is_as_large_as_it_says_and_another_one_for_each_moment_and_robot():
    grey = np.full((60, 80, 3), 0.5, np.float32)
    with numpy_backend():
        plain = quantize(grey, None, 0, 0)
        loud = [
            quantize(grey, np.float32(6.0), seed, slot) for seed, slot in ((1, 0), (1, 0), (2, 0), (1, 1))
        ]
    assert (plain == 128).all()
    error = loud[0].astype(float) - 127.5
    # 14,400 numbers: the deviation is good to 0.6 %, with 1/12 for rounding; four times that.
    assert error.std() == pytest.approx(math.sqrt(36 + 1 / 12), rel=0.024)
    assert abs(error.mean()) < 4 * 6 / math.sqrt(error.size) + 0.01
    np.testing.assert_array_equal(loud[0], loud[1])
    assert all((loud[0] != other).mean() > 0.9 for other in loud[2:])
    with numpy_backend():
        white = quantize(np.ones((9, 9, 3), np.float32), np.float32(50.0), 1, 0)
    assert white.max() == 255


def test_an_edge_through_a_pixel_is_as_bright_as_its_share():
    """A wall ends a third of a pixel beside the middle of the picture: of two rays one meets it, of four
    three in a row's half; labels and depths are those of a ray near the middle of the pixel."""
    values = np.arange(16.0).reshape(4, 4)
    with numpy_backend():
        np.testing.assert_array_equal(box_filter(values, 2), [[2.5, 4.5], [10.5, 12.5]])
    white, black = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
    focal = 16 / 2 / math.tan(0.6)
    edge = 0.6 * 5.0 / focal  # to the left, of what is 5 m away: the edge is 0.6 pixels left of the middle
    stage = stage_of(
        solid((5.5, edge + 9.0, 1.0), (0.5, 9.0, 9.0), white), solid((7.5, 0, 1.0), (0.5, 30, 30), black)
    ).replace(exposure=1.0)
    views = [eye(fov=1.2).replace(supersampling=times, exposure=np.float32(50.0)) for times in (1, 4)]
    render = jax.jit(render_picture, static_argnames=("width", "height"))
    rough, fine = (jax.tree.map(np.asarray, render(stage, view, 16, 16)) for view in views)
    assert set(np.unique(rough.rgb[:, 7])) <= {0, 255}
    # Pixel 7 goes from 1 to 0 pixels left of the middle; its rays are 7/8, 5/8, 3/8 and 1/8 of it.
    assert set(np.unique(fine.rgb[:, 7])) == {128}
    assert (fine.rgb[:, 6] == 255).all()
    assert (fine.rgb[:, 8] == 0).all()
    assert fine.depth.shape == fine.segmentation.shape == (16, 16)
    np.testing.assert_allclose(fine.depth[:, 6], 5.0, rtol=1e-5)
    np.testing.assert_allclose(fine.depth[:, 8], 7.0, rtol=1e-5)


def test_a_section_sets_how_cameras_take_pictures(monkeypatch, tmp_path):
    monkeypatch.setattr(ROBOTS, "_entries", dict(ROBOTS._entries))
    keys = "Exposure=1.5\nDistortionK1=-0.2\nImageNoise=3.0\nSupersampling=2\n"
    (tmp_path / "a.ini").write_text(f"[USARBot.RobotCamera]\n{keys}")
    assert cameras_of(ROBOTS.get("P2AT"))[0].imaging == (1.0, None, None, 1)
    configure([tmp_path / "a.ini"])
    own = cameras_of(ROBOTS.get("P2AT"))[0]
    bodies = BodyPoses(pos=np.zeros((9, 3)), mat=np.tile(np.eye(3), (9, 1, 1)))
    view = camera_viewpoint(own, bodies, np.int32(0), np.float32(1.0))
    assert (float(view.exposure), float(view.noise), view.supersampling) == (1.5, 3.0, 2)
    np.testing.assert_allclose(view.distortion, [-0.2, 0.0])


@pytest.mark.parametrize("wrong", [{"Exposure": 0.0}, {"DistortionK1": -0.5}, {"Supersampling": 9}])
def test_settings_beyond_their_limits_are_refused_by_name(wrong):
    mount = replace(camera(), options=options(**wrong))
    with pytest.raises(UsarmjxError, match=next(iter(wrong))):
        cameras_of(replace(P2AT, name="Wrong", cameras=(mount,)))
