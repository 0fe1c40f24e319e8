"""Points of traces in pictures: where they are, how large, and what hides them."""

import math

import numpy as np
import pytest

from usarmjx.cameras.lenses import MIRROR_DISTANCE, omni, untiled
from usarmjx.cameras.mounts import cameras_of
from usarmjx.models.robots import ROBOTS
from usarmjx.server.dots import RADIUS, Eye, paint
from usarmjx.transforms import mat_from_angles

WIDTH, HEIGHT = 160, 120
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
PLACE = np.array([1.0, 2.0, 3.0])


def ahead(away, left=0.0, up=0.0):
    """A place seen from an eye that has not turned."""
    return PLACE + np.array([away, left, up])


def eye(robot="P2AT", fov=1.0, angles=(0.0, 0.0, 0.0)):
    turn = mat_from_angles(*(np.array(angle) for angle in angles))
    return Eye(place=PLACE, turn=turn, fov=fov, camera=cameras_of(ROBOTS.get(robot))[0])


def painted(eye, places, colors=(RED,), depth=np.inf):
    """The picture of balls in front of a black wall at a depth [m]."""
    rgb = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    paint(rgb, np.full((HEIGHT, WIDTH), depth), eye, np.array(places, float), np.array(colors))
    return rgb


def middle(mask):
    """Row and column of what is painted, of pixels' middles."""
    return np.argwhere(mask).mean(0) + 0.5


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.3, -0.2, 2.0)])
@pytest.mark.parametrize(("away", "left", "up"), [(1.0, 0.0, 0.0), (1.0, 0.2, 0.1), (0.5, -0.15, -0.1)])
def test_a_pinhole_shows_a_ball_where_it_is_and_as_large_as_it_is(angles, away, left, up):
    here = eye(angles=angles)
    picture = painted(here, [PLACE + here.turn @ (away, left, up)])
    focal = WIDTH / 2 / math.tan(0.5)
    found = picture[..., 0] == 255
    expected = [HEIGHT / 2 - focal * up / away, WIDTH / 2 - focal * left / away]
    np.testing.assert_allclose(middle(found), expected, atol=0.5)  # pixels are whole
    area = math.pi * (focal * RADIUS / away) ** 2
    assert found.sum() == pytest.approx(area, rel=0.2), "a disc of about 60 or 240 pixels"
    assert not picture[..., 1:].any()


def test_what_is_nearer_hides_it():
    here = eye()
    ball = [ahead(2.0, 0.0, 0.0)]
    assert painted(here, ball, depth=2.1).any()
    assert painted(here, ball, depth=2.0).any(), "half of it looks out of a wall"
    assert not painted(here, ball, depth=1.9).any()
    assert not painted(here, [PLACE - (2.0, 0.0, 0.0)]).any(), "behind the camera"
    assert not painted(here, [PLACE]).any()


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_nearer_ball_hides_a_farther_one(order):
    balls = [(ahead(away, 0.0, 0.0), color) for away, color in ((1.0, RED), (2.0, BLUE))]
    picture = painted(eye(), *zip(*(balls[i] for i in order), strict=True))
    assert (picture[..., 0] == 255).sum() > 50
    assert not picture[..., 2].any()


def test_a_far_ball_is_at_least_a_pixel_and_one_at_the_edge_is_cut():
    assert 1 <= painted(eye(), [ahead(50.0, 0.0, 0.0)]).any(2).sum() <= 4
    edge = painted(eye(), [ahead(1.0, math.tan(0.5), 0.0)])
    assert edge[:, 0].any()
    assert not edge[:, 10:].any()


@pytest.mark.parametrize(("row", "column"), [(60, 100), (30, 60), (80, 70), (60, 130)])
def test_a_mirror_shows_a_ball_where_its_ray_goes(row, column):
    """The ball is put where the renderer's own ray of a pixel passes."""
    here = eye("OmniP2DX", fov=cameras_of(ROBOTS.get("OmniP2DX"))[0].default, angles=(0.1, -1.5, 0.7))
    assert here.camera.lens == "omni"
    along = np.asarray(untiled(omni(WIDTH, HEIGHT, np.float32(1.0)).along, WIDTH, HEIGHT))[row, column]
    ball = PLACE + here.turn @ (np.array([MIRROR_DISTANCE, 0.0, 0.0]) + 0.8 * along)
    picture = painted(here, [ball])
    # The disc is drawn round; where the mirror squeezes it along the radius it is off by a part of a pixel.
    np.testing.assert_allclose(middle(picture[..., 0] == 255), [row + 0.5, column + 0.5], atol=0.75)
    assert not painted(here, [ball], depth=0.7).any()


def test_nothing_is_drawn_outside_of_the_mirror():
    here = eye("OmniP2DX", fov=cameras_of(ROBOTS.get("OmniP2DX"))[0].default)
    assert not painted(here, [ahead(3.0, 0.1, 0.0)]).any(), "behind the mirror"
