"""GPS against the manual's text (10.5), closed forms of what a wall hides, and C MuJoCo's rays."""

import math
from dataclasses import replace

import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.sensors.blocks import c_rays, random_blocks
from usarmjx.base.errors import SpecError
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, options, resolve_settings
from usarmjx.sensors.gps import (
    ELEVATION_MASK,
    GpsSettings,
    geographic_coordinates,
    largest_error,
    satellite_directions,
)
from usarmjx.server.gamebots.sensors import configuration, sensor_report
from usarmjx.server.protocol.grammar import format_message

MOUNT = (0.1, 0.2, -0.3)  # the wire's axes
HEIGHT = 0.26  # m: a P2AT on the floor
DEGREE_ATOL = 1e-9  # 0.1 mm
DRAWS = 300


@pytest.fixture(scope="module")
def bench(make_bench):
    mounts = (
        Mount(kind="GPS", name="GPS", at=MOUNT, options=options(maxNoise=0.0, minNoise=0.0)),
        Mount(kind="GPS", name="Noisy", at=MOUNT),
    )
    return make_bench(replace(P2AT, name="SatelliteBench", sensors=mounts))


def over(x: float, y: float, half: tuple, height: float, yaw: float = 0.0) -> tuple:
    return ((x, y, height), half, yaw)


ROOF = over(0.0, 0.0, (50.0, 50.0, 0.1), 3.0)


# --- satellites -------------------------------------------------------------------------------


def test_the_sky_has_twelve_satellites_all_around_and_above_the_mask():
    directions = satellite_directions()
    assert directions.shape == (12, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, rtol=1e-6)
    assert directions[:, 2].min() > math.sin(ELEVATION_MASK)
    quarter = np.floor(np.arctan2(directions[:, 1], directions[:, 0]) / (math.pi / 2))
    assert sorted(np.unique(quarter)) == [-2, -1, 0, 1]


@pytest.mark.parametrize("angles", [(0, 0, 0), (0, 0, 2.0), (math.pi, 0, 0), (0.3, -0.4, 0)])
def test_in_the_open_it_sees_all_of_them_however_it_is_turned(bench, angles):
    assert bench.once("GPS", "GPS", at=(3.0, -4.0, 1.0), angles=angles)[2] == 12


@pytest.mark.parametrize(("distance", "top"), [(1.0, 0.6), (1.0, 1.0), (1.0, 4.0), (3.0, 1.5)])
@pytest.mark.parametrize("side", [1, -1])
def test_a_long_wall_hides_the_satellites_behind_it(bench, make_arena, side, distance, top):
    """Those on its side whose line passes below its top."""
    x, z = MOUNT[0], HEIGHT - MOUNT[2]
    face = x + side * distance
    wall = over(face + side * 0.5, 0.0, (0.5, 1e3, 10.0), z + top - 10.0)
    ahead, _, up = (
        side * satellite_directions().T[0],
        satellite_directions().T[1],
        satellite_directions().T[2],
    )
    hidden = (ahead > 0) & (up * distance < top * np.maximum(ahead, 1e-9))
    value = bench.once("GPS", "GPS", at=(0.0, 0.0, HEIGHT), geoms=make_arena(boxes=[wall]))
    assert 0 < hidden.sum() < 12
    assert value[2] == 12 - hidden.sum()


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(6))
def test_what_it_sees_among_blocks_is_what_c_mujoco_sees(bench, make_arena, seed):
    blocks = random_blocks(seed)
    origin = (MOUNT[0], -MOUNT[1], HEIGHT - MOUNT[2])
    seen = np.isinf(c_rays(blocks, origin, satellite_directions())).sum()
    value = bench.once("GPS", "GPS", at=(0.0, 0.0, HEIGHT), geoms=make_arena(boxes=blocks))
    assert value[2] == seen < 12


def test_under_a_roof_there_is_no_position(bench, make_arena):
    assert bench.once("GPS", "GPS", at=(5.0, 5.0, HEIGHT), geoms=make_arena(boxes=[ROOF])).tolist() == [
        0,
        0,
        0,
    ]


# --- noise ------------------------------------------------------------------------------------


def test_the_position_is_that_of_the_mount(bench):
    value = bench.once("GPS", "GPS", at=(10.0, -20.0, 1.0), angles=(0, 0, math.pi / 2))
    # Turned left by a quarter: ahead is left, and what is on the right is ahead.
    np.testing.assert_allclose(value[:2], [10.0 + MOUNT[1], -20.0 + MOUNT[0]], atol=1e-5)


@pytest.mark.parametrize(("satellites", "error"), [(4, 2.5), (8, 1.625), (12, 0.75)])
def test_the_largest_error_is_linear_in_the_satellites(satellites, error):
    assert largest_error(GpsSettings(), satellites) == pytest.approx(error)


def test_errors_grow_with_fewer_satellites_and_never_exceed_the_largest(bench, make_arena):
    """Normal, cut off at three standard deviations, which takes 1.3 % off the deviation."""
    walls = [over(side * 1.5, 0.0, (0.5, 20.0, 1.0), 0.0) for side in (1, -1)]

    def draw(geoms) -> tuple[np.ndarray, float]:
        inputs = bench.inputs(geoms=geoms)
        memory = bench.start(inputs)
        values = np.array(
            [bench.value(bench.read(inputs, memory, seed)[1], "GPS", "Noisy") for seed in range(DRAWS)]
        )
        assert len(set(values[:, 2])) == 1
        return values[:, :2] - (MOUNT[0], -MOUNT[1]), values[0, 2]

    for geoms in (bench.open, make_arena(boxes=walls)):
        errors, satellites = draw(geoms)
        largest = 2.5 - 1.75 * (satellites - 4) / 8
        assert np.abs(errors).max() <= largest
        # The deviation of 600 draws is 3 % off, their mean 4 % of a deviation: four times that.
        assert errors.std() == pytest.approx(0.987 * largest / 3, rel=0.12)
        assert abs(errors.mean()) < 0.16 * largest / 3
        assert abs(np.corrcoef(errors.T)[0, 1]) < 0.25  # north and east have errors of their own
    assert 4 <= satellites < 12


# --- degrees ----------------------------------------------------------------------------------


def located(latitude: tuple, longitude: tuple) -> GpsSettings:
    """Settings whose origin lies at (degree, minute) twice."""
    return GpsSettings(
        zero_zero_location=options(
            LatitudeDegree=latitude[0],
            LatitudeMinute=latitude[1],
            LongitudeDegree=longitude[0],
            LongitudeMinute=longitude[1],
        )
    )


def test_x_is_north_and_the_wires_y_is_east():
    """111200 m a degree of latitude, 71670 m one of longitude (GPSSensor.uc)."""
    equator = located((0, 0), (0, 0))
    assert geographic_coordinates(equator, (111200.0, 0.0)) == pytest.approx((1.0, 0.0), abs=DEGREE_ATOL)
    assert geographic_coordinates(equator, (0.0, -71670.0)) == pytest.approx(
        (0.0, 1.0), abs=DEGREE_ATOL
    )  # y is left here


@pytest.mark.parametrize(
    ("degree", "minute", "expected"),
    [(77, 30, 77.5), (-77, -30, -77.5), (-77, 30, -77.5), (0, -30, -0.5), (-359, 59.9996, 0.0004 / 60)],
)
def test_negative_degrees_and_minutes_are_south_and_west(degree, minute, expected):
    """The last is the manual's own example, 0.0004 minutes east of Greenwich."""
    _, longitude = geographic_coordinates(located((0, 0), (degree, minute)), (0.0, 0.0))
    assert longitude == pytest.approx(expected, abs=DEGREE_ATOL)
    latitude, _ = geographic_coordinates(located((max(degree, -80), minute), (0, 0)), (0.0, 0.0))
    assert latitude == pytest.approx(
        max(expected, -80.0) if degree > -80 else -80 - minute / 60, abs=DEGREE_ATOL
    )


@pytest.mark.parametrize("pole", [1, -1])
def test_past_a_pole_the_latitude_turns_back(pole):
    """The manual's example: at 89 degrees and 59.9 minutes, 0.1 minutes short of the pole."""
    settings = located((pole * 89, pole * 59.9), (30, 0))
    short = 111200 * 0.1 / 60
    for driven in (0.0, 0.5, 0.99, 1.01, 1.5, 3.0):
        latitude, longitude = geographic_coordinates(settings, (pole * driven * short, 0.0))
        assert latitude == pytest.approx(pole * (90 - abs(1 - driven) * 0.1 / 60), abs=DEGREE_ATOL)
        assert longitude == pytest.approx(30, abs=DEGREE_ATOL)


@pytest.mark.parametrize("east", [1, -1])
def test_past_180_degrees_east_and_west_change(east):
    settings = located((10, 0), (east * 179, east * 59.9))
    short = 71670 * 0.1 / 60
    for driven in (0.0, 0.5, 1.5, 3.0):
        _, longitude = geographic_coordinates(settings, (0.0, -east * driven * short))
        turned = 180 + (driven - 1) * 0.1 / 60
        assert longitude == pytest.approx(east * (turned if driven < 1 else turned - 360), abs=DEGREE_ATOL)


@pytest.mark.parametrize(
    ("location", "message"),
    [
        (options(LatitudeDegrees=39), r"no \['latitudedegrees'\]; it has: LatitudeDegree, LatitudeMinute, "),
        (options(LongitudeMinute="8W"), "LongitudeMinute is '8W', expected a number"),
    ],
)
def test_a_wrong_location_is_refused_when_the_scene_is_built(make_bench, location, message):
    mount = Mount(kind="GPS", name="GPS", options=options(ZeroZeroLocation=location))
    with pytest.raises(SpecError, match=message):
        make_bench(replace(P2AT, name="Lost", sensors=(mount,)))


def test_the_arenas_reference_comes_before_that_of_the_settings():
    """Manual 10.5.2: an object in the map, else the ini file, else the default."""
    settings = located((1, 0), (2, 0))
    assert geographic_coordinates(settings, (0.0, 0.0), (34.5, -117.25)) == (34.5, -117.25)
    assert geographic_coordinates(settings, (0.0, 0.0)) == (1.0, 2.0)
    north, east = geographic_coordinates(
        GpsSettings(), (0.0, 0.0)
    )  # GPSSensor.uc: 39,8.0273,N and 77,12.9980,W
    assert (north, east) == pytest.approx((39 + 8.0273 / 60, -77 - 12.998 / 60), abs=DEGREE_ATOL)


# --- the wire ---------------------------------------------------------------------------------


def line(bench, name: str, value: list, time: float = 1.0) -> str:
    sensor = next(s for s in bench.suite.sensors if s.mounts[0].name == name)
    return format_message(sensor_report(sensor, np.array(value, np.float32), time))


def test_the_origin_reads_as_the_default_reference(bench):
    assert line(bench, "GPS", [0.0, 0.0, 12.0]) == (
        "SEN {Type GPS} {Name GPS} {Latitude 39,8.0273,N} {Longitude 77,12.9980,W} {Fix 1} {Satellites 12}"
    )


def test_a_captured_line_comes_from_12_6_m_north_and_2_5_m_west(bench):
    """0.0068 minutes of latitude and 0.0021 of longitude from the default reference."""
    north, west = 0.00685 / 60 * 111200, 0.00215 / 60 * 71670
    assert line(bench, "GPS", [north, west, 11.0]) == (
        "SEN {Type GPS} {Name GPS} {Latitude 39,8.0341,N} {Longitude 77,13.0001,W} {Fix 1} {Satellites 11}"
    )


def test_an_arena_that_says_where_it_is_is_believed(bench):
    sensor = next(s for s in bench.suite.sensors if s.mounts[0].name == "GPS")
    report = sensor_report(sensor, np.array([0.0, 0.0, 12.0], np.float32), 1.0, (34.587, -117.367))
    assert "{Latitude 34,35.2200,N} {Longitude 117,22.0200,W}" in format_message(report)


def test_with_fewer_than_four_satellites_there_is_no_fix(bench):
    assert line(bench, "GPS", [0.0, 0.0, 3.0]) == "SEN {Type GPS} {Name GPS} {Fix 0} {Satellites 3}"
    assert "{Fix 1} {Satellites 4}" in line(bench, "GPS", [0.0, 0.0, 4.0])


def test_getconf_tells_the_scan_interval(bench):
    (message,) = configuration(
        bench.robot, bench.suite.sensors, (1.0,) * len(bench.robot.cameras), "GPS", "gps"
    )
    assert format_message(message) == "CONF {Type GPS} {Name GPS} {ScanInterval 0.20}"  # captured


def test_defaults():
    """No time stamp (captured lines); the numbers of GPSSensor.uc."""
    settings = resolve_settings(GpsSettings, (), "GPS G")
    assert (settings.with_time_stamp, settings.scan_interval) == (False, 0.2)
    assert (settings.max_noise, settings.min_noise) == (2.5, 0.75)
    mine = resolve_settings(GpsSettings, options(maxNoise=5.0, minNoise=1.0, bWithTimeStamp=True), "GPS G")
    assert (mine.max_noise, mine.min_noise, mine.with_time_stamp) == (5.0, 1.0, True)


# --- on the ellipsoid ---------------------------------------------------------------------------

FLATNESS = 1e-3  # of the way: 500 m north shorten a degree of longitude by 1e-4 tan(latitude)


def on_the_ellipsoid(origin: tuple, north: float, west: float) -> tuple[float, float]:
    latitude, longitude, _ = pymap3d.enu2geodetic(-west, north, 0.0, *origin, 0.0)
    return float(latitude), float(longitude)


def metres_a_degree(latitude: float) -> tuple[float, float]:
    """Of latitude and of longitude on WGS84."""
    step = 1e-3
    east, _, _ = pymap3d.geodetic2enu(latitude, step, 0.0, latitude, 0.0, 0.0)
    _, north, _ = pymap3d.geodetic2enu(latitude + step, 0.0, 0.0, latitude, 0.0, 0.0)
    return float(north) / step, float(east) / step


def way_between(mine: GpsSettings, origin: tuple, north: float, west: float) -> float:
    """How far apart our place and the ellipsoid's are [m]."""
    found = geographic_coordinates(mine, (north, west), origin)
    east, up, _ = pymap3d.geodetic2enu(*found, 0.0, *on_the_ellipsoid(origin, north, west), 0.0)
    return math.hypot(float(east), float(up))


@pytest.mark.oracle
@settings(deadline=None)
@given(bearing=st.floats(0, 2 * math.pi), far=st.floats(1.0, 500.0), longitude=st.floats(-179.9, 179.9))
def test_the_originals_scales_are_those_of_the_ellipsoid_at_50_degrees_north(bearing, far, longitude):
    north, west = far * math.cos(bearing), far * math.sin(bearing)
    assert way_between(GpsSettings(), (50.0, longitude), north, west) < FLATNESS * far


@pytest.mark.oracle
@settings(deadline=None)
@given(
    latitude=st.floats(-75.0, 75.0),
    longitude=st.floats(-179.9, 179.9),
    bearing=st.floats(0, 2 * math.pi),
    far=st.floats(1.0, 500.0),
)
def test_with_scales_of_its_own_any_place_is_that_of_the_ellipsoid(latitude, longitude, bearing, far):
    scales = metres_a_degree(latitude)
    mine = GpsSettings(latitude_scale=scales[0], longitude_scale=scales[1])
    north, west = far * math.cos(bearing), far * math.sin(bearing)
    assert way_between(mine, (latitude, longitude), north, west) < FLATNESS * far


def test_negative_scales_turn_the_axes_round():
    """Manual 10.13.1."""
    plain, turned = GpsSettings(), GpsSettings(latitude_scale=-111200.0, longitude_scale=-71670.0)
    for north, west in ((100.0, 0.0), (0.0, 100.0), (-30.0, 70.0)):
        assert geographic_coordinates(turned, (north, west), (10.0, 20.0)) == pytest.approx(
            geographic_coordinates(plain, (-north, -west), (10.0, 20.0)), abs=DEGREE_ATOL
        )


@settings(deadline=None)
@given(
    degree=st.integers(-720, 720),
    minute=st.floats(-59.9999, 59.9999),
    north=st.floats(-3e7, 3e7),
    west=st.floats(-3e7, 3e7),
)
def test_every_place_has_a_latitude_and_a_longitude(degree, minute, north, west):
    """Around the earth and over its poles: within 90 degrees, and in [-180, 180)."""
    mine = located((degree % 90, minute), (degree, minute))
    latitude, longitude = geographic_coordinates(mine, (north, west))
    assert -90 <= latitude <= 90
    assert -180 <= longitude < 180
    _, around = geographic_coordinates(mine, (north, west + 360 * 71670.0))
    assert abs((around - longitude + 180) % 360 - 180) < 1e-6  # a turn later it is the same place
