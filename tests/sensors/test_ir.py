"""Infrared range sensors against closed forms: flat walls, posts and the floor (manual 10.2)."""

import math
from dataclasses import replace

import numpy as np
import pytest

from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, options, resolve_settings
from usarmjx.sensors.ranging import IrSettings
from usarmjx.server.gamebots.sensors import configuration, sensor_report
from usarmjx.server.protocol.grammar import format_message

RANGE_ATOL = 1e-4  # m: float32 over a room, the raycaster's own tolerance
NOSE = (0.24, 0.0, 0.0)
HEIGHT = 0.26  # m: a P2AT on the floor
CURVE = ((0.0, 0.0), (2.0, 1.0), (4.0, 5.0))
DRAWS = 60


def ir(name: str, at: tuple = NOSE, direction: tuple = (0.0, 0.0, 0.0), **keys: object) -> Mount:
    return Mount(kind="IR", name=name, at=at, direction=direction, options=options(**{"Noise": 0.0} | keys))


@pytest.fixture(scope="module")
def bench(make_bench):
    mounts = (
        ir("Front"),
        ir("Right", direction=(0.0, 0.0, math.pi / 2)),  # the wire's yaw is clockwise
        ir("Down", at=(0.3, 0.0, 0.0), direction=(0.0, -math.pi / 6, 0.0)),  # nose down is negative pitch
        ir("Short", MaxRange=0.8),
        ir("Noisy", Noise=0.3, MinRange=1.0, MaxRange=3.0),
        ir("Curved", OutputCurve=CURVE),
    )
    return make_bench(replace(P2AT, name="InfraredBench", sensors=mounts))


def wall(x: float) -> tuple:
    """A wide wall ahead whose face is at x."""
    return ((x + 0.5, 0.0, 1.0), (0.5, 60.0, 3.0), 0.0)


@pytest.mark.parametrize("yaw", [0.0, 0.6, -0.6])
@pytest.mark.parametrize("face", [0.4, 1.0, 4.0])
def test_the_line_reads_the_distance_of_a_wall_at_any_angle(bench, make_arena, face, yaw):
    """Unlike sound, light comes back from a surface that it meets flatly."""
    reading = bench.once("IR", "Front", angles=(0, 0, yaw), geoms=make_arena(boxes=[wall(face)]))
    assert reading == pytest.approx(face / math.cos(yaw) - NOSE[0], abs=RANGE_ATOL)


def test_without_a_hit_in_range_it_reads_max_range_exactly(bench, make_arena):
    assert bench.once("IR", "Front") == 5.0
    geoms = make_arena(boxes=[wall(NOSE[0] + 0.9)])
    assert bench.once("IR", "Short", geoms=geoms) == np.float32(0.8)
    assert bench.once("IR", "Front", geoms=geoms) == pytest.approx(0.9, abs=RANGE_ATOL)


@pytest.mark.parametrize(("bearing", "seen"), [(0.0, True), (1.8, True), (2.0, False), (-2.0, False)])
def test_one_line_only(bench, make_arena, bearing, seen):
    """A post of 5 cm at 1.5 m covers 1.91 degrees to each side; a sonar's cone would reach 10."""
    far, radius, angle = 1.5, 0.05, math.radians(bearing)
    centre = (NOSE[0] + far * math.cos(angle), far * math.sin(angle), 1.0)
    reading = bench.once("IR", "Front", geoms=make_arena(posts=[(centre, radius, 1.0)]))
    expected = far * math.cos(angle) - math.sqrt(max(0.0, radius**2 - (far * math.sin(angle)) ** 2))
    assert reading == pytest.approx(expected if seen else 5.0, abs=RANGE_ATOL)


def test_each_sensor_of_the_group_looks_where_it_is_mounted(bench, make_arena):
    beside = ((0.0, -2.0, 1.0), (5.0, 0.5, 2.0), 0.0)  # on the right
    geoms = make_arena(boxes=[wall(3.0), beside])
    assert bench.once("IR", "Front", geoms=geoms) == pytest.approx(3.0 - NOSE[0], abs=RANGE_ATOL)
    assert bench.once("IR", "Right", geoms=geoms) == pytest.approx(1.5, abs=RANGE_ATOL)
    assert bench.once("IR", "Down", geoms=geoms) == pytest.approx(2 * HEIGHT, abs=RANGE_ATOL)


def test_noise_is_relative_on_hits_only_and_stays_in_range(bench, make_arena):
    """MinRange 1 m, MaxRange 3 m, noise 30 %."""

    def draws(distance: float) -> np.ndarray:
        geoms = make_arena(boxes=[wall(NOSE[0] + distance)])
        return np.array([bench.once("IR", "Noisy", seed, geoms=geoms) for seed in range(DRAWS)])

    middle = draws(2.0)
    assert 0.3 * 0.8 < np.abs(middle / 2.0 - 1).max() <= 0.3 + 1e-5
    assert len(set(middle.tolist())) > DRAWS * 0.9
    assert draws(1.02).min() == 1.0
    assert draws(2.95).max() == 3.0
    assert set(draws(3.05).tolist()) == {3.0}  # beyond MaxRange: no hit, no noise


def test_distortion_comes_last(bench, make_arena):
    for distance, distorted in ((1.0, 0.5), (3.0, 3.0)):
        geoms = make_arena(boxes=[wall(NOSE[0] + distance)])
        assert bench.once("IR", "Curved", geoms=geoms) == pytest.approx(distorted, abs=2 * RANGE_ATOL)


def test_defaults_are_the_manuals():
    """Manual 10.2.2: a time stamp, 5 m, 5 % noise, no distortion."""
    settings = resolve_settings(IrSettings, (), "IR I")
    assert (settings.with_time_stamp, settings.max_range, settings.noise) == (True, 5.0, 0.05)
    assert (settings.output_curve, settings.scan_interval) == ((), 0.0)
    assert not resolve_settings(IrSettings, options(bWithTimeStamp=False), "IR I").with_time_stamp


def test_all_of_a_robot_come_in_one_line(bench):
    (group,) = bench.suite.sensors
    line = format_message(sensor_report(group, np.array([2.5098, 5, 1, 2, 3, 0.5], np.float32), 45.14))
    assert line == (
        "SEN {Time 45.1400} {Type IR} {Name Front Range 2.5098} {Name Right Range 5.0000}"
        " {Name Down Range 1.0000} {Name Short Range 2.0000} {Name Noisy Range 3.0000}"
        " {Name Curved Range 0.5000}"
    )


def test_getconf_tells_the_ranges(bench):
    (message,) = configuration(
        bench.robot, bench.suite.sensors, (1.0,) * len(bench.robot.cameras), "IR", "Noisy"
    )
    assert format_message(message) == "CONF {Type IR} {Name Noisy} {MaxRange 3.0000} {MinRange 1.0000}"
