"""Points of traces in pictures: where they are, how large, and what hides them."""

import math

import numpy as np
import pytest

from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.cameras.lenses import MIRROR_DISTANCE, from_tiles, omni_rays
from usarmjx.sensors.cameras.mounts import cameras_of
from usarmjx.sensors.cameras.picture import camera_viewpoint
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.server.pictures.views import BALL_RADIUS, draw_overlay

WIDTH, HEIGHT = 160, 120
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
PLACE = np.array([1.0, 2.0, 3.0])


def ahead(away, left=0.0, up=0.0):
    """A place seen from an eye that has not turned."""
    return PLACE + np.array([away, left, up])


def eye(robot="P2AT", fov=1.0, angles=(0.0, 0.0, 0.0)):
    turn = mat_from_angles(*(np.array(angle) for angle in angles))
    bodies = BodyPoses(pos=np.zeros((99, 3)), mat=np.zeros((99, 3, 3)))
    return camera_viewpoint(cameras_of(ROBOTS.get(robot))[0], bodies, 0, fov).replace(pos=PLACE, mat=turn)


def painted(eye, places, colors=(RED,), depth=np.inf):
    """The picture of balls in front of a black wall at a depth [m]."""
    rgb = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    places, shown = np.array(places, float), np.ones(len(places), bool)
    balls = OverlayLines(start=places, end=places, rgb=np.array(colors), shown=shown)
    draw_overlay(rgb, np.full((HEIGHT, WIDTH), depth), eye, balls)
    return rgb


def middle(mask):
    """Row and column of what is painted, of pixels' middles."""
    return np.argwhere(mask).mean(0) + 0.5


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.3, -0.2, 2.0)])
@pytest.mark.parametrize(("away", "left", "up"), [(1.0, 0.0, 0.0), (1.0, 0.2, 0.1), (0.5, -0.15, -0.1)])
def test_a_pinhole_shows_a_ball_where_it_is_and_as_large_as_it_is(angles, away, left, up):
    here = eye(angles=angles)
    picture = painted(here, [PLACE + here.mat @ (away, left, up)])
    focal = WIDTH / 2 / math.tan(0.5)
    found = picture[..., 0] == 255
    expected = [HEIGHT / 2 - focal * up / away, WIDTH / 2 - focal * left / away]
    np.testing.assert_allclose(middle(found), expected, atol=0.5)  # pixels are whole
    area = math.pi * (focal * BALL_RADIUS / away) ** 2
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
    here = eye("OmniP2DX", fov=cameras_of(ROBOTS.get("OmniP2DX"))[0].default_fov, angles=(0.1, -1.5, 0.7))
    assert here.lens == "omni"
    along = np.asarray(from_tiles(omni_rays(WIDTH, HEIGHT, np.float32(1.0)).direction, WIDTH, HEIGHT))[
        row, column
    ]
    ball = PLACE + here.mat @ (np.array([MIRROR_DISTANCE, 0.0, 0.0]) + 0.8 * along)
    picture = painted(here, [ball])
    # The disc is drawn round; where the mirror squeezes it along the radius it is off by a part of a pixel.
    np.testing.assert_allclose(middle(picture[..., 0] == 255), [row + 0.5, column + 0.5], atol=0.75)
    assert not painted(here, [ball], depth=0.7).any()


def lined(eye, start, end, depth=np.inf):
    """The picture of a red line in front of a black wall at a depth [m]: where it is red."""
    rgb = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    line = OverlayLines(
        start=np.array([start], float),
        end=np.array([end], float),
        rgb=np.array([RED]),
        shown=np.ones(1, bool),
    )
    draw_overlay(rgb, np.broadcast_to(np.asarray(depth, float), (HEIGHT, WIDTH)), eye, line)
    assert not rgb[..., 1:].any()
    return rgb[..., 0] == 255


@pytest.mark.parametrize("fov", [0.4, 1.0, 2.0])
@pytest.mark.parametrize(
    ("start", "end"),
    [
        ((2.0, 0.5, 0.1), (1.0, -0.3, -0.2)),
        ((0.1, 0.02, 0.01), (9.0, -3.0, 2.0)),
        ((1.0, 0.1, -0.3), (1.0, 0.12, 0.3)),
    ],
)
def test_a_line_is_straight_and_has_no_gaps(start, end, fov):
    """A pinhole's picture of a straight line is the straight line between its ends' pictures."""
    here = eye(fov=fov, angles=(0.3, -0.2, 2.0))
    focal = WIDTH / 2 / math.tan(fov / 2)
    ends = [
        np.array([WIDTH / 2 - focal * left / away, HEIGHT / 2 - focal * up / away])
        for away, left, up in (start, end)
    ]
    found = lined(here, PLACE + here.mat @ start, PLACE + here.mat @ end)
    way = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    rows, columns = np.nonzero(found)
    off = np.stack([columns + 0.5, rows + 0.5], -1) - ends[0]
    assert (np.abs(off @ (-way[1], way[0])) < 0.75).all(), "a pixel's corner is 0.71 from its middle"
    along = np.clip(off @ way, 0, None)
    assert along.max() < np.linalg.norm(ends[1] - ends[0]) + 0.75
    steep = np.abs(way[1]) > np.abs(way[0])
    covered = np.unique(rows if steep else columns)
    assert (np.diff(covered) == 1).all(), "each row or column on the way has a pixel"
    reach = np.clip([p[int(steep)] for p in ends], 0, HEIGHT if steep else WIDTH)
    if len(covered) > 5:
        assert len(covered) > abs(reach[1] - reach[0]) / 2


def test_a_line_ends_behind_what_is_nearer():
    """It goes away from us to the left, from 1 to 3 m; what is farther than 2 m is hidden."""
    here = eye()
    ends = [PLACE + here.mat @ (1.0, 0.0, 0.0), PLACE + here.mat @ (3.0, 1.2, 0.0)]
    focal = WIDTH / 2 / math.tan(0.5)
    found = np.nonzero(lined(here, *ends, depth=2.0))[1]
    assert found.max() == WIDTH // 2 - 1 or found.max() == WIDTH // 2
    assert abs(found.min() - (WIDTH / 2 - focal * 0.6 / 2.0)) < 1.5, "halfway"
    assert not lined(here, *ends, depth=0.9).any()
    assert not lined(here, PLACE - here.mat[:, 0], PLACE - 3 * here.mat[:, 0]).any(), "behind the camera"
    through = lined(here, PLACE - here.mat[:, 0], PLACE + 2 * here.mat[:, 0])
    assert 1 <= through.sum() <= 4, "along the optical axis it is a point"


def test_a_mirror_bends_a_line():
    """The ends are where the renderer's own rays of two pixels pass; what is painted sees the line."""
    here = eye("OmniP2DX", fov=cameras_of(ROBOTS.get("OmniP2DX"))[0].default_fov, angles=(0.1, -1.5, 0.7))
    along = np.asarray(from_tiles(omni_rays(WIDTH, HEIGHT, np.float32(1.0)).direction, WIDTH, HEIGHT), float)
    focus = PLACE + here.mat @ (MIRROR_DISTANCE, 0.0, 0.0)
    start, end = (focus + here.mat @ (1.5 * along[pixel]) for pixel in ((30, 60), (35, 110)))
    found = lined(here, start, end)
    assert found[30, 60]
    assert found[35, 110]
    # Rays of painted pixels pass the line within a pixel's angle: the mirror's 105 degrees on 60 pixels.
    normal = np.cross(start - focus, end - focus)
    off = along[found] @ here.mat.T @ (normal / np.linalg.norm(normal))
    assert np.abs(np.arcsin(off)).max() < 2 * math.radians(105) / 60
    assert found.sum() >= 50


def test_nothing_is_drawn_outside_of_the_mirror():
    here = eye("OmniP2DX", fov=cameras_of(ROBOTS.get("OmniP2DX"))[0].default_fov)
    assert not painted(here, [ahead(3.0, 0.1, 0.0)]).any(), "behind the mirror"
