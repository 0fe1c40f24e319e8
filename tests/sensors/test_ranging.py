"""Sonar and range scanner against closed forms: flat walls, posts and floors."""

import math
from dataclasses import replace

import numpy as np
import pytest

from usarmjx.base.errors import SpecError
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT, P2AT_SCANNER
from usarmjx.models.types.robot import Mount, options
from usarmjx.sensors.ranging import (
    Scanner3DSettings,
    ScannerSettings,
    SonarSettings,
    beam_directions,
    fan_directions,
)
from usarmjx.sensors.suite import suite_of
from usarmjx.sim.configure import configure

RANGE_ATOL = 1e-4  # m: float32 over a room, the raycaster's own tolerance
RANGE_RTOL = 1e-5  # float32 beams that meet a wall 20 m away, flatly
HEIGHT = 0.26  # m: a P2AT on the floor
SONAR_X = 0.24
BEAM = 0.3491  # rad, manual 10.2.2
DRAWS = 60


def wall(x: float) -> tuple:
    """A wide wall ahead whose face is at x."""
    return ((x + 0.5, 0.0, 1.0), (0.5, 60.0, 3.0), 0.0)


@pytest.mark.parametrize("distance", [0.15, 1.0, 4.9])
def test_sonar_reads_the_distance_of_a_wall(bench, make_arena, distance):
    geoms = make_arena(boxes=[wall(SONAR_X + distance)])
    assert bench.once("Sonar", "Clean", geoms=geoms) == pytest.approx(distance, abs=RANGE_ATOL)


@pytest.mark.parametrize("side", [-1, 1])
def test_sonar_takes_the_shortest_line_of_its_cone(bench, make_arena, side):
    """Turned by half its beam the axis is oblique, but a line on the cone meets the wall squarely."""
    yaw = side * BEAM / 2
    reading = bench.once("Sonar", "Clean", angles=(0, 0, yaw), geoms=make_arena(boxes=[wall(2.0)]))
    assert reading == pytest.approx(2.0 - SONAR_X * math.cos(yaw), abs=RANGE_ATOL)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("bearing", "seen"), [(9.0, True), (14.0, False)])
def test_sonar_sees_a_post_inside_its_cone_only(bench, make_arena, side, bearing, seen):
    far, radius, angle = 1.5, 0.05, math.radians(bearing)
    centre = (SONAR_X + far * math.cos(angle), side * far * math.sin(angle), 1.0)
    reading = bench.once("Sonar", "Clean", geoms=make_arena(posts=[(centre, radius, 1.0)]))
    beside = BEAM / 2 - angle  # between the cone's line and the post's centre
    expected = far * math.cos(beside) - math.sqrt(max(0, radius**2 - (far * math.sin(beside)) ** 2))
    assert reading == pytest.approx(expected if seen else 5.0, abs=RANGE_ATOL)


def test_beam_lines_fill_the_cone_and_no_more():
    lines = beam_directions(BEAM)
    np.testing.assert_allclose(np.linalg.norm(lines, axis=-1), 1, rtol=1e-6)
    off_axis = np.arccos(np.clip(lines[:, 0], -1, 1))
    assert off_axis.max() == pytest.approx(BEAM / 2, abs=1e-4)
    np.testing.assert_allclose(lines[:, 1:].sum(0), 0, atol=1e-6)  # nothing is preferred
    assert len(np.unique(lines.round(5), axis=0)) == len(lines) > 5


def test_sonars_of_a_level_robot_in_the_open_hear_nothing(bench):
    """As in captured sessions, which read up to 5 m; a P2AT's are deaf to what they meet flatly."""
    inputs = bench.inputs()
    _, readings = bench.read(inputs, bench.start(inputs))
    rings = [f"{ring}{i}" for ring in "FR" for i in range(1, 9)]
    values = [bench.value(readings, "Sonar", name) for name in rings]
    assert values == [5.0] * 16  # MaxRange exactly, though these are noisy


def test_a_sonar_by_itself_hears_the_floor_where_its_cone_meets_it(bench):
    """Manual 10.2.1 knows no angle at which a surface is silent; the lowest line is the shortest."""
    floor = HEIGHT / math.sin(BEAM / 2)
    assert floor == pytest.approx(1.497, abs=1e-3)
    assert bench.once("Sonar", "Keen") == pytest.approx(floor, abs=RANGE_ATOL)


@pytest.mark.parametrize(("name", "heard"), [("Keen", True), ("Clean", False)])
def test_a_wall_met_at_a_grazing_angle_echoes_unless_max_incidence_forbids_it(bench, make_arena, name, heard):
    """The beam's line nearest to the wall meets it at 80 degrees from its normal; MaxIncidence is 75."""
    yaw = math.radians(80) + BEAM / 2
    at = (2.0 - 0.4 - SONAR_X * math.cos(yaw), 0.0, 2.0)  # so high that no line ends on the floor within 5 m
    reading = bench.once("Sonar", name, at=at, angles=(0.0, 0.0, yaw), geoms=make_arena(boxes=[wall(2.0)]))
    expected = 0.4 / math.cos(math.radians(80))
    assert reading == pytest.approx(expected if heard else 5.0, abs=1e-3)


def test_with_a_max_incidence_the_floor_is_silent_because_of_its_angle_only(bench):
    """Nose down by 20 degrees the steepest line meets the floor at 30 degrees: 60 from its normal."""
    down = math.radians(20)
    at = (0.0, 0.0, HEIGHT + SONAR_X * math.sin(down))
    for name in ("Clean", "Keen"):
        reading = bench.once("Sonar", name, at=at, angles=(0.0, down, 0.0))
        assert reading == pytest.approx(HEIGHT / math.sin(down + BEAM / 2), abs=RANGE_ATOL)


def test_only_a_sonar_with_a_max_incidence_asks_for_angles(bench, make_bench):
    """They cost a normal for each ray: nobody pays who does not need them."""
    plain = make_bench(replace(P2AT, name="Plain", sensors=(Mount(kind="Sonar", name="F1"),)))
    assert not plain.suite.sensors[0].needs_incidence
    assert bench.suite.sensors[bench.suite.index("Sonar")].needs_incidence


def test_every_sonar_of_the_rings_looks_where_it_is_mounted(bench, make_arena):
    """One small post after the other at 1 m before each sonar: that one reads 1 m, within its noise."""
    for ring in "FR":
        for i in range(1, 9):
            mount = next(m for m in P2AT.sensors if m.name == f"{ring}{i}")
            x, y, _ = mount.at
            yaw = mount.direction[2]
            # The wire's y is to the right, its yaw clockwise.
            centre = (x + 1.05 * math.cos(yaw), -(y + 1.05 * math.sin(yaw)), 1.0)
            reading = bench.once("Sonar", mount.name, geoms=make_arena(posts=[(centre, 0.05, 1.0)]))
            assert reading == pytest.approx(1.0, rel=0.05 + 1e-5)


@pytest.mark.parametrize(
    ("kind", "pick"),
    [("Sonar", lambda value: value), ("RangeScanner", lambda value: value[90])],
    ids=["sonar", "scanner"],
)
def test_noise_is_on_hits_only_and_stays_in_range(bench, make_arena, kind, pick):
    """MinRange 1 m, MaxRange 3 m; noise 30 % for the sonar, 10 % for the scanner."""
    start_x = SONAR_X if kind == "Sonar" else P2AT_SCANNER[0]
    noise = 0.3 if kind == "Sonar" else 0.1

    def draws(distance: float) -> np.ndarray:
        inputs = bench.inputs(geoms=make_arena(boxes=[wall(start_x + distance)]))
        memory = bench.start(inputs)
        readings = (bench.read(inputs, memory, seed)[1] for seed in range(DRAWS))
        return np.array([pick(bench.value(r, kind, "Noisy")) for r in readings])

    middle = draws(2.0)
    assert len(set(middle.tolist())) > DRAWS * 0.9
    assert np.abs(middle / 2.0 - 1).max() <= noise + 1e-5
    assert np.abs(middle / 2.0 - 1).max() > noise * 0.8
    near, far = draws(1.02), draws(2.95)
    assert near.min() == 1.0
    assert far.max() == 3.0
    assert len(set(far.tolist())) > 1
    assert set(draws(0.5).tolist()) == {1.0}  # nearer than MinRange
    assert set(draws(3.05).tolist()) == {3.0}  # beyond MaxRange: no hit, no noise


def test_distortion_comes_last(bench, make_arena):
    for distance, distorted in ((1.0, 0.5), (3.0, 3.0)):
        geoms = make_arena(boxes=[wall(SONAR_X + distance)])
        assert bench.once("Sonar", "Curved", geoms=geoms) == pytest.approx(distorted, abs=2 * RANGE_ATOL)
    assert bench.once("Sonar", "Curved") == 0.0  # MaxRange lies outside the curve's points


def expected_scan(face: float, yaw: float) -> np.ndarray:
    """Distances to a wall at x = face of a scan's 181 beams, right to left, of a robot at the origin."""
    beam = yaw + np.radians(np.arange(-90, 91))
    gap = face - P2AT_SCANNER[0] * math.cos(yaw)
    with np.errstate(divide="ignore"):
        distance = np.where(np.cos(beam) > 1e-9, gap / np.cos(beam), np.inf)
    return np.where(distance < 20.0, distance, 20.0)


@pytest.mark.parametrize("yaw", [0.0, 0.7, -0.7])
def test_scan_of_a_wall(bench, make_arena, yaw):
    scan = bench.once("RangeScanner", "Clean", angles=(0, 0, yaw), geoms=make_arena(boxes=[wall(3.0)]))
    expected = expected_scan(3.0, yaw)
    assert scan.shape == (181,)
    assert (expected < 20).sum() > 100
    np.testing.assert_allclose(scan, expected, rtol=RANGE_RTOL, atol=RANGE_ATOL)
    assert set(scan[expected == 20.0].tolist()) <= {20.0}  # no return: MaxRange exactly


def test_scan_runs_from_right_to_left(bench, make_arena):
    on_the_right = ((P2AT_SCANNER[0], -2.5, 1.0), (0.5, 0.5, 2.0), 0.0)
    scan = bench.once("RangeScanner", "Clean", geoms=make_arena(boxes=[on_the_right]))
    seen = np.flatnonzero(scan < 20)
    assert seen.tolist() == list(range(15))  # atan(0.5 / 2.0) is 14.04 degrees
    np.testing.assert_allclose(scan[:15], 2.0 / np.cos(np.radians(np.arange(15))), atol=RANGE_ATOL)


def test_tilting_scan_runs_from_the_floor_up(bench, make_arena):
    scan = bench.once("RangeScanner", "Tilted", geoms=make_arena(boxes=[wall(3.0)]))
    height = HEIGHT - P2AT_SCANNER[2]  # the wire's z points down
    angle = np.radians(np.arange(-90, 91))
    gap = 3.0 - P2AT_SCANNER[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = np.where(angle < -1e-9, height / -np.sin(angle), np.inf)
        top = np.arctan2(4.0 - height, gap)  # the wall ends 4 m above the floor
        ahead = np.where((np.cos(angle) > 1e-9) & (angle < top), gap / np.cos(angle), np.inf)
    expected = np.minimum(np.minimum(floor, ahead), 20.0)
    assert scan[0] == pytest.approx(height, abs=RANGE_ATOL)
    np.testing.assert_allclose(scan, expected, rtol=RANGE_RTOL, atol=RANGE_ATOL)


def test_fan_of_the_manuals_default_scanner():
    """800 of 65536 units a step, 32768 wide: 41 beams, from -90 degrees (manual 10.3.2)."""
    settings = ScannerSettings()
    lines = fan_directions(settings)
    assert len(lines) == settings.beams == 41
    np.testing.assert_allclose(lines[0], [0, -1, 0], atol=1e-6)
    step = np.arccos(np.clip((lines[1:] * lines[:-1]).sum(-1), -1, 1))
    np.testing.assert_allclose(step, math.radians(800 / 65536 * 360), atol=1e-3)


@pytest.mark.parametrize(
    ("resolution", "fov", "beams"),
    [(math.pi / 180, math.pi, 181), (0.1, 1.0, 11), (0.3, 1.0, 4), (0.0174, 3.1415, 181)],
)
def test_both_ends_of_the_field_of_view_have_a_beam(resolution, fov, beams):
    assert ScannerSettings(resolution=resolution, scan_fov=fov).beams == beams


@pytest.mark.parametrize("resolution", [math.pi / 180, 2 * math.pi / 7, 0.0174533, math.pi / 2])
def test_a_full_turn_has_every_direction_once(resolution):
    settings = ScannerSettings(resolution=resolution, scan_fov=2 * math.pi)
    lines = fan_directions(settings)
    assert len(lines) == round(2 * math.pi / resolution)
    apart = lines @ lines.T - 2 * np.eye(len(lines))
    assert apart.max() < math.cos(resolution) + 1e-4, "no two beams have one direction"
    rows, columns = Scanner3DSettings(
        vertical_fov=0.4,
        vertical_resolution=0.2,
        horizontal_fov=2 * math.pi,
        horizontal_resolution=resolution,
    ).shape
    assert (rows, columns) == (3, len(lines))


@pytest.mark.parametrize("both", [True, False])
def test_a_scanner_has_exactly_one_plane(bench, make_bench, both):
    mount = Mount(kind="RangeScanner", name="Flat", options=options(bYaw=both, bPitch=both))
    with pytest.raises(SpecError, match="exactly one of bYaw and bPitch"):
        make_bench(replace(P2AT, name="Wrong", sensors=(mount,))).start(bench.inputs())


def test_the_rings_of_built_in_robots_are_deaf_to_the_floor_unless_a_section_says_otherwise(
    monkeypatch, tmp_path
):
    def limits():
        suite = suite_of(ROBOTS.get("P2AT"))
        return {one.max_incidence for one in suite.sensors[suite.index("Sonar")].settings}

    monkeypatch.setattr(ROBOTS, "_entries", dict(ROBOTS._entries))
    assert SonarSettings().max_incidence == math.pi / 2
    assert limits() == {1.309}
    (tmp_path / "a.ini").write_text("[USARBot.SonarSensor]\nMaxIncidence=1.5708\n")
    configure([tmp_path / "a.ini"])
    assert limits() == {1.5708}
