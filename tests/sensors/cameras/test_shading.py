"""Colours of known things in known light, by closed forms."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.sensors.cameras.stages import PLANE, solid, stage_of, wall
from usarmjx.models.types.arena import Light
from usarmjx.sensors.cameras.paint import GLASS_TRANSPARENCY, MIRROR_REFLECTANCE, ROBOT_LABEL, SKY_LABEL
from usarmjx.sensors.cameras.shading import (
    AMBIENT,
    AMBIENT_GRADIENT,
    BRICK_CONTRAST,
    CHECKER_RGB,
    DIFFUSE,
    HEADLIGHT_BRIGHTNESS,
    INDOOR_AMBIENT,
    NIGHT_RGB,
    SKY_RGB,
    SPOT_INNER_ANGLE,
    SPOT_OUTER_ANGLE,
    Headlights,
    point_lights,
    shade,
)
from usarmjx.sensors.rays.raycast import EXCLUDE_NONE

EXACT = 2e-5  # float32 distances of some metres, squared
OFF = 5e-3  # shares: rays to a light start LIFT off the surface, 0.5 mm of some decimetres
RED, GREEN, BLUE = (0.5, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 0.5)
_shade = jax.jit(shade)


def look(stage, start, *targets, viewer=EXCLUDE_NONE):
    """What rays from one place to others see: 64 of them, so that one program does for all."""
    to = np.array(targets, float)
    along = np.tile(to - start, (64 // len(to) + 1, 1))[:64]
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    starts = np.broadcast_to(np.float32(start), (64, 3))
    seen = _shade(stage, jnp.asarray(starts), jnp.asarray(along, jnp.float32), jnp.asarray(viewer))
    return jax.tree.map(lambda x: np.asarray(x)[: len(to)], seen)


def everywhere(normal, ambient=AMBIENT):
    return ambient * (1 + np.dot(normal, AMBIENT_GRADIENT))


def brick(x, z):
    """Closed form of the pattern on a wall that looks along -x: y is along it."""
    return 1 + BRICK_CONTRAST * (1 - 2 * ((math.floor(x / 0.5) + math.floor(z / 0.25)) % 2))


@pytest.mark.oracle
def test_a_wall_in_the_sun_has_the_colour_that_lambert_gives_it():
    sun = np.array([-0.6, 0.0, 0.8])
    stage = stage_of(wall((2.0, 0.0, 1.0), (0.1, 3.0, 1.0), (0.5, 0.4, 0.3)), sun=sun)
    places = [(1.9, 0.3, 0.1), (1.9, 0.3, 0.3), (1.9, -0.7, 0.9)]
    seen = look(stage, (-1.0, 0.0, 0.5), *places)
    light = everywhere((-1, 0, 0)) + DIFFUSE * 0.6
    for place, rgb in zip(places, seen.rgb, strict=True):
        # Along a wall with the normal (-1, 0, 0) the pattern's coordinate is y nx - x ny = -y.
        expected = np.array([0.5, 0.4, 0.3]) * brick(-place[1], place[2]) * light
        np.testing.assert_allclose(rgb, expected, atol=EXACT)
    assert len({brick(-p[1], p[2]) for p in places}) == 2, "both kinds of bricks were looked at"
    distance = [math.dist(place, (-1.0, 0.0, 0.5)) for place in places]
    np.testing.assert_allclose(seen.distance, distance, rtol=1e-6)


@pytest.mark.oracle
def test_a_box_throws_a_shadow_on_the_checkered_floor():
    stage = stage_of(
        solid((0, 0, 0), (0, 0, 1), RED, kind=PLANE), solid((0.0, 0.0, 1.0), (0.2, 0.2, 0.2), RED)
    )
    places = [(0.1, 0.1, 0.0), (0.6, 0.1, 0.0), (0.3, 0.1, 0.0)]
    seen = look(stage, (2.0, 2.0, 0.5), *places)
    lit, dark = everywhere((0, 0, 1)) + DIFFUSE, everywhere((0, 0, 1))
    np.testing.assert_allclose(seen.rgb[0], CHECKER_RGB[0] * dark, atol=EXACT)  # below the box
    np.testing.assert_allclose(seen.rgb[1], np.minimum(CHECKER_RGB[1] * lit, 1), atol=EXACT)
    np.testing.assert_allclose(seen.rgb[2], np.minimum(CHECKER_RGB[0] * lit, 1), atol=EXACT)
    up = look(stage, (2.0, 2.0, 0.5), (2.0, 3.0, 2.0))
    np.testing.assert_allclose(up.rgb[0], SKY_RGB, atol=EXACT)
    assert np.isinf(up.distance[0])
    assert up.label[0] == SKY_LABEL


@pytest.mark.oracle
def test_lamps_replace_the_sun_and_fall_off_with_the_square_of_the_distance():
    lamps = point_lights([Light(at=(0.0, 0.0, 2.0), brightness=0.8, rgb=(1.0, 0.5, 0.25))], 0.5)
    floor, hat = solid((0, 0, 0), (9, 9, 0.01), (0.4, 0.4, 0.4)), solid((3.0, 0, 1.5), (0.3, 0.3, 0.01), RED)
    seen = look(
        stage_of(floor, hat, lamps=lamps), (1.0, 3.0, 1.0), (0, 0, 0.01), (2, 0, 0.01), (7.5, 0, 0.01)
    )
    base = everywhere((0, 0, 1), INDOOR_AMBIENT)
    for x, rgb in zip((0.0, 2.0), seen.rgb, strict=False):
        away = math.hypot(x, 2.49)
        light = base + 0.8 * np.array([1.0, 0.5, 0.25]) * (2.49 / away) / away**2
        np.testing.assert_allclose(rgb, 0.4 * light, rtol=OFF)
    np.testing.assert_allclose(seen.rgb[2], 0.4 * base, atol=EXACT)  # in the shadow of the hat
    night = look(stage_of(floor, lamps=lamps), (1.0, 3.0, 1.0), (1.0, 3.0, 9.0))
    np.testing.assert_allclose(night.rgb[0], NIGHT_RGB, atol=EXACT)


@pytest.mark.oracle
def test_each_point_is_lit_by_the_lamp_that_gives_it_most():
    """With equal lamps at x = 0 and x = 4, 2 m up, that is the nearer one."""
    lights = [Light(at=(x, 0.0, 2.0), brightness=0.5, rgb=rgb) for x, rgb in ((0, (1, 0, 0)), (4, (0, 0, 1)))]
    floor = solid((0, 0, -0.01), (9, 9, 0.01), (0.4, 0.4, 0.4))
    seen = look(stage_of(floor, lamps=point_lights(lights, 0.0)), (2.0, 3.0, 1.0), (1.5, 0, 0), (2.5, 0, 0))
    base, away = everywhere((0, 0, 1), INDOOR_AMBIENT), math.hypot(1.5, 2.0)
    more = 0.5 * (2.0 / away) / away**2
    np.testing.assert_allclose(seen.rgb[0], 0.4 * (base + np.array([more, 0, 0])), rtol=OFF)
    np.testing.assert_allclose(seen.rgb[1], 0.4 * (base + np.array([0, 0, more])), rtol=OFF)


@pytest.mark.oracle
def test_a_mirror_shows_things_at_their_image_points():
    """The mirror is the plane x = 1: what is at (x, y, z) is seen at (2 - x, y, z)."""
    mirror = solid((1.05, 0.0, 1.0), (0.05, 3.0, 1.0), (0.2, 0.2, 0.2), material="mirror")
    thing = solid((-1.0, 1.0, 1.0), (0.1, 0.1, 0.1), GREEN)
    stage = stage_of(mirror, thing)
    eye = (-1.0, -1.0, 1.0)
    on, beside = np.array([2.9, 1.08, 1.0]), np.array([2.9, 1.12, 1.0])  # of the face towards the mirror
    seen = look(stage, eye, on, beside, (1.0, 2.9, 1.0))
    own, shown = everywhere((-1, 0, 0)), everywhere((1, 0, 0))  # the sun stands above: sides have none
    mixed = (1 - MIRROR_REFLECTANCE) * 0.2 * own + MIRROR_REFLECTANCE * np.array([0, 0.5 * shown, 0])
    np.testing.assert_allclose(seen.rgb[0], mixed, atol=EXACT)
    sky = (1 - MIRROR_REFLECTANCE) * 0.2 * own + MIRROR_REFLECTANCE * SKY_RGB
    np.testing.assert_allclose(seen.rgb[1], sky, atol=EXACT)  # 2 cm beside its edge
    np.testing.assert_allclose(seen.rgb[2], sky, atol=EXACT)
    toward = on - eye
    assert seen.distance[0] == pytest.approx(np.linalg.norm(toward * 2.0 / toward[0]), rel=1e-5), (
        "the mirror's"
    )


@pytest.mark.oracle
def test_what_looks_is_seen_in_a_mirror_but_not_by_itself():
    mirror = solid((1.05, 0.0, 1.0), (0.05, 3.0, 1.0), (0.2, 0.2, 0.2), material="mirror")
    body = solid((0.0, 0.0, 1.0), (0.1, 0.1, 0.1), BLUE, owner=7)
    seen = look(stage_of(mirror, body), (0.0, 0.0, 1.0), (1.0, 0.0, 1.0), viewer=7)
    assert seen.distance[0] == pytest.approx(1.0, rel=1e-5)
    expected = (1 - MIRROR_REFLECTANCE) * 0.2 * everywhere((-1, 0, 0)) + MIRROR_REFLECTANCE * np.array(
        [0, 0, 0.5 * everywhere((1, 0, 0))]
    )
    np.testing.assert_allclose(seen.rgb[0], expected, atol=EXACT)


@pytest.mark.oracle
def test_glass_tints_what_is_behind_it_and_neither_hides_nor_darkens_it():
    pane = solid((1.0, 0.0, 1.0), (0.01, 1.0, 1.0), GREEN, material="glass")
    roof = solid((3.0, 0.0, 2.5), (2.0, 2.0, 0.01), GREEN, material="glass")
    thing = solid((3.0, 0.0, 1.0), (0.5, 0.5, 0.5), RED, label=ROBOT_LABEL + 3)
    sun = np.array([-0.6, 0.0, 0.8])
    seen = look(stage_of(pane, roof, thing, sun=sun), (-1.0, 0.0, 1.0), (2.5, 0.0, 1.0))
    own = everywhere((-1, 0, 0)) + DIFFUSE * 0.6
    expected = (
        GLASS_TRANSPARENCY * np.array([0.5, 0, 0]) * own
        + (1 - GLASS_TRANSPARENCY) * np.array([0, 0.5, 0]) * own
    )
    np.testing.assert_allclose(seen.rgb[0], expected, atol=EXACT)
    assert seen.distance[0] == pytest.approx(3.5, rel=1e-6)
    assert seen.label[0] == ROBOT_LABEL + 3


def beam_stage(on, *more):
    floor = solid((0, 0, -0.01), (20, 20, 0.01), (0.1, 0.1, 0.1))
    screen = solid((4.0, 0.0, 2.0), (0.01, 4.0, 2.0), (0.1, 0.1, 0.1))
    lights = Headlights(
        pos=np.float32([[0.0, 0.0, 1.0]]),
        direction=np.float32([[1.0, 0.0, 0.0]]),
        on=np.array([on]),
        label=np.array([ROBOT_LABEL]),
    )
    return stage_of(floor, screen, *more, headlights=lights)


@pytest.mark.oracle
def test_a_headlight_shines_in_its_cone_only_and_falls_off():
    lamp, face = np.array([0.0, 0.0, 1.0]), 3.99
    eye, angles = (0.0, -0.2, 1.2), np.radians([0.0, 10.0, 19.0, 25.0, 29.0, 31.0, 40.0])
    places = [(face, face * math.tan(angle), 1.0) for angle in angles]
    places += [(2.5, 0.0, 0.0), (1.2, 0.0, 0.0)]
    with_it, without = (look(beam_stage(on), eye, *places).rgb[:, 0] for on in (True, False))
    for place, gain in zip(places, with_it - without, strict=True):
        way = lamp - place
        away = np.linalg.norm(way)
        normal = (-1, 0, 0) if place[0] == face else (0, 0, 1)
        off = math.acos(np.dot(-way / away, (1, 0, 0)))
        share = np.clip(
            (math.cos(off) - math.cos(SPOT_OUTER_ANGLE))
            / (math.cos(SPOT_INNER_ANGLE) - math.cos(SPOT_OUTER_ANGLE)),
            0,
            1,
        )
        share = share**2 * (3 - 2 * share)
        expected = 0.1 * HEADLIGHT_BRIGHTNESS * share * np.dot(normal, way / away) / away**2
        assert gain == pytest.approx(expected, rel=OFF, abs=1e-5), place  # steep at its edge
    # Straight ahead all of it arrives: as much as the square of the distance leaves.
    assert (with_it - without)[0] == pytest.approx(0.1 * HEADLIGHT_BRIGHTNESS / face**2, rel=OFF)
    gains = dict(zip((*np.degrees(angles).round(), "lit", "below"), with_it - without, strict=True))
    assert min(gains[29.0], gains["lit"]) > 0
    assert gains[31.0] == gains[40.0] == gains["below"] == 0


@pytest.mark.oracle
def test_a_headlight_does_not_shine_through_things_but_its_own_robot_is_not_in_its_way():
    other = solid((2.0, 0.0, 1.0), (0.1, 0.3, 0.3), BLUE, label=ROBOT_LABEL + 1)
    own = solid((0.0, 0.0, 1.0), (0.2, 0.2, 0.2), BLUE, label=ROBOT_LABEL)
    eye, behind, beside = (0.0, -2.0, 1.5), (3.99, 0.3, 1.0), (3.99, 1.0, 1.0)
    gains = [
        np.subtract(*(look(beam_stage(on, *more), eye, behind, beside).rgb[:, 0] for on in (True, False)))
        for more in ((), (own,), (own, other))
    ]
    np.testing.assert_allclose(gains[1], gains[0], atol=1e-6)
    np.testing.assert_allclose(gains[2], [0.0, gains[0][1]], atol=1e-6)
    assert gains[0].min() > 5e-3


def test_no_colour_leaves_its_range():
    bright = point_lights([Light(at=(0.0, 0.0, 0.3), brightness=50.0)], 0.0)
    floor = solid((0, 0, -0.01), (9, 9, 0.01), (1.0, 1.0, 1.0))
    seen = look(stage_of(floor, lamps=bright), (0.5, 0.5, 1.0), (0, 0, 0), (0.1, 0, 0), (5, 5, 0))
    assert np.isfinite(seen.rgb).all()
    assert seen.rgb.max() == 1.0
    assert seen.rgb.min() >= 0.0


def test_the_program_leaves_out_mirrors_and_glass_where_there_are_none():
    """They cost casts of their own: a stage of opaque solids has no third one."""
    plain, both = (
        stage_of(solid((0, 0, 0), (1, 1, 1), RED)),
        stage_of(solid((0, 0, 0), (1, 1, 1), RED), solid((3, 0, 0), (1, 1, 1), RED, material="mirror")),
    )
    rays = jnp.ones((64, 3))
    loops = [
        str(jax.make_jaxpr(shade)(one, rays, rays, jnp.asarray(0))).count("scan[") for one in (plain, both)
    ]
    assert loops[0] < loops[1]
