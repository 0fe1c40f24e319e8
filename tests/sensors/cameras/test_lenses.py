"""Where pixels look, against closed forms."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.sensors.cameras.lenses import (
    MIRROR_RIM_ANGLE,
    from_tiles,
    omni_rays,
    pinhole_rays,
    pixel_offsets,
    to_tiles,
)

SINGLE = 2e-6  # float32 rounding of unit vectors and of angles up to pi


@pytest.mark.oracle
@pytest.mark.parametrize(("width", "height", "fov"), [(64, 64, 0.8727), (30, 21, 2.0944), (320, 240, 0.3491)])
def test_a_pinholes_pixels_look_where_their_middles_are(width, height, fov):
    rays = pinhole_rays(width, height, jnp.float32(fov))
    along, depth = (np.asarray(from_tiles(x, width, height)) for x in (rays.direction, rays.depth_scale))
    focal = width / 2 / math.tan(fov / 2)
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    x, y = column + 0.5 - width / 2, height / 2 - row - 0.5
    expected = np.stack([np.full(x.shape, focal), -x, y], -1)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    np.testing.assert_allclose(along, expected, atol=SINGLE)
    np.testing.assert_allclose(depth, expected[..., 0], atol=SINGLE)
    # The field of view is horizontal, between the outer edges of the outermost pixels.
    edge = math.atan((width / 2) / focal)
    assert 2 * edge == pytest.approx(fov)


def test_pixels_come_in_tiles_and_go_back():
    for width, height in ((16, 8), (17, 9), (5, 30)):
        right, up = pixel_offsets(width, height)
        assert len(right) % 64 == 0
        picture = np.asarray(from_tiles(jnp.stack([jnp.asarray(right), jnp.asarray(up)], -1), width, height))
        column, row = np.meshgrid(np.arange(width), np.arange(height))
        np.testing.assert_allclose(picture[..., 0], column + 0.5 - width / 2)
        np.testing.assert_allclose(picture[..., 1], height / 2 - row - 0.5)
    numbers = np.arange(16 * 24).reshape(16, 24)
    cut = to_tiles(numbers)
    np.testing.assert_array_equal(cut[:64], numbers[:8, :8].ravel())
    np.testing.assert_array_equal(from_tiles(jnp.asarray(cut), 24, 16), numbers)


@pytest.mark.oracle
def test_an_omnidirectional_pixel_looks_where_the_paraboloid_throws_it():
    """A ray along the axis, reflected at the mirror's own slope, goes away from its focus."""
    size = 41
    rays = omni_rays(size, size, jnp.float32(1.0))
    along, inside = (np.asarray(from_tiles(x, size, size)) for x in (rays.direction, rays.inside))
    rim, h = math.tan(MIRROR_RIM_ANGLE / 2), 1.0
    for row, column in ((20, 20), (20, 30), (3, 20), (10, 8), (33, 35)):
        x, y = (column + 0.5 - size / 2) / (size / 2) * rim, (size / 2 - row - 0.5) / (size / 2) * rim
        r = math.hypot(x, y)
        # In the picture's axes: right, up, and z towards the camera; the focus is in the origin.
        point = np.array([x, y, (h * h - r * r) / (2 * h)])
        normal = np.array([x / h, y / h, 1.0])  # gradient of z - (h^2 - r^2) / (2 h)
        normal /= np.linalg.norm(normal)
        ray = np.array([0.0, 0.0, -1.0])
        back = ray - 2 * (ray @ normal) * normal
        np.testing.assert_allclose(np.cross(back, point), 0.0, atol=1e-12)  # away from the focus
        expected = np.array([-back[2], -back[0], back[1]])  # forward is away from the camera, y to the left
        np.testing.assert_allclose(along[row, column], expected, atol=SINGLE)
        assert inside[row, column] == (r <= rim)


@pytest.mark.oracle
def test_known_directions_have_known_radii_in_the_mirror():
    size = 400
    rays = omni_rays(size, size, jnp.float32(1.0))
    along, inside = (np.asarray(from_tiles(x, size, size)) for x in (rays.direction, rays.inside))
    row = along[200, 200:]  # half a pixel below the middle
    angle = np.degrees(np.arccos(np.clip(-row[:, 0], -1, 1)))
    radius = (np.hypot(np.arange(200) + 0.5, 0.5)) / 200
    for seen in (30.0, 60.0, 90.0):
        expected = math.tan(math.radians(seen) / 2) / math.tan(MIRROR_RIM_ANGLE / 2)
        found = np.interp(seen, angle, radius)
        assert found == pytest.approx(expected, abs=1e-4)  # the step of the radius is 0.005, curvature small
    # Outside of the circle there is nothing: 1 - pi / 4 of the square, up to the pixels on the circle.
    assert 1 - inside.mean() == pytest.approx(1 - math.pi / 4, abs=2 * math.pi * 200 / size**2)
    zoomed = omni_rays(size, size, jnp.float32(0.5))
    share = np.asarray(zoomed.inside).mean()
    assert share == pytest.approx(math.pi / 16, abs=0.01), "half as large, a quarter of the circle"
