"""IRScanner and RangeScanner3D against C MuJoCo's rays and closed forms (manual 10.3)."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.sensors.blocks import c_rays, random_blocks
from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, options, resolve_settings
from usarmjx.sensors.ranging import IrScannerSettings, Scanner3DSettings, grid_directions
from usarmjx.server.gamebots.sensors import configuration, sensor_report
from usarmjx.server.protocol.grammar import format_message

RANGE_ATOL = 1e-4  # m: float32 over a room, the raycaster's own tolerance
RANGE_RTOL = 1e-5  # float32 beams that meet a surface 20 m away, flatly
HEIGHT = 0.26  # m: a P2AT on the floor
NOSE = (0.2, 0.0, -0.1)  # the wire's axes
HALF_TURN = options(MaxRange=20.0, Resolution=math.pi / 180, ScanFov=math.pi)


def scanner(kind: str, name: str, *more: tuple, **keys: object) -> Mount:
    return Mount(kind=kind, name=name, at=NOSE, options=(*more, *options(**keys)))


SMALL = dict(VerticalFOV=0.8, VerticalResolution=0.1, HorizontalFOV=1.2, HorizontalResolution=0.1)


@pytest.fixture(scope="module")
def bench(make_bench):
    mounts = (
        scanner("RangeScanner", "Laser", *HALF_TURN, ScanInterval=0.02),
        scanner("IRScanner", "Infrared", *HALF_TURN, ScanInterval=0.02),
        scanner("IRScanner", "Told", *HALF_TURN, ScanInterval=0.0),
        scanner("RangeScanner3D", "Solid", MaxRange=20.0, **SMALL),
        scanner("RangeScanner3D", "Noisy", MaxRange=3.0, MinRange=1.0, Noise=0.1, **SMALL),
        scanner("RangeScanner3D", "Told3D", MaxRange=20.0, ScanInterval=0.0, **SMALL),
    )
    return make_bench(replace(P2AT, name="ScannerBench", sensors=mounts))


def wall(x: float) -> tuple:
    """A wide wall ahead whose face is at x."""
    return ((x + 0.5, 0.0, 1.0), (0.5, 60.0, 30.0), 0.0)


# --- IRScanner --------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_an_infrared_scan_is_a_laser_scan_without_its_last_beam(bench, make_arena, seed):
    geoms = make_arena(boxes=random_blocks(seed))
    laser, infrared = (
        bench.once(kind, name, geoms=geoms, angles=(0, 0, 1.0))
        for kind, name in (("RangeScanner", "Laser"), ("IRScanner", "Infrared"))
    )
    assert (laser < 20).sum() > 20
    np.testing.assert_array_equal(infrared, laser[:-1])


def test_an_infrared_scan_runs_from_right_to_left(bench, make_arena):
    on_the_right = ((NOSE[0], -2.5, 1.0), (0.5, 0.5, 2.0), 0.0)
    scan = bench.once("IRScanner", "Infrared", geoms=make_arena(boxes=[on_the_right]))
    assert scan.shape == (180,)
    np.testing.assert_allclose(scan[:15], 2.0 / np.cos(np.radians(np.arange(15))), atol=RANGE_ATOL)
    assert set(scan[15:].tolist()) == {20.0}


@pytest.mark.parametrize(
    ("resolution", "fov", "beams"), [(math.pi / 180, math.pi, 180), (0.1, 1.0, 10), (0.3, 1.0, 4)]
)
def test_the_end_of_its_field_of_view_has_no_beam(resolution, fov, beams):
    """0.3 rad do not end there anyway: four beams, as the range scanner has."""
    assert IrScannerSettings(resolution=resolution, scan_fov=fov).beams == beams


def test_an_infrared_scanner_has_exactly_one_plane(make_bench):
    mount = scanner("IRScanner", "Flat", bYaw=True, bPitch=True)
    with pytest.raises(SpecError, match="exactly one of bYaw and bPitch"):
        make_bench(replace(P2AT, name="Wrong", sensors=(mount,)))


# --- RangeScanner3D ---------------------------------------------------------------------------


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(4))
def test_every_beam_of_a_3d_scan_meets_what_c_mujoco_meets(bench, make_arena, seed):
    """Rows from the top down, each from right to left, of a robot that is turned any way."""
    rng = np.random.default_rng(seed)
    blocks, angles = random_blocks(seed), tuple(rng.uniform(-0.6, 0.6, 3))
    at = np.array([0.3, -0.2, 0.9])
    mat = mat_from_angles(*angles)
    up, left = np.meshgrid(0.4 - 0.1 * np.arange(9), -0.6 + 0.1 * np.arange(13), indexing="ij")
    lines = np.stack([np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up)], -1)
    origin = at + mat @ (NOSE[0], -NOSE[1], -NOSE[2])
    expected = c_rays(blocks, origin, lines.reshape(-1, 3) @ mat.T).reshape(9, 13)
    scan = bench.once("RangeScanner3D", "Solid", at=tuple(at), angles=angles, geoms=make_arena(boxes=blocks))
    # Beams past an edge by less than float32 can tell may go either way: none of these seeds has one.
    np.testing.assert_allclose(scan, np.minimum(expected, 20.0), rtol=RANGE_RTOL, atol=RANGE_ATOL)
    assert (expected < 20).sum() > 20


def test_a_3d_scan_of_a_wall_on_the_floor(bench, make_arena):
    """Closed form: the wall at g/(cos up cos left), the floor at h/sin down, whichever is nearer."""
    scan = bench.once("RangeScanner3D", "Solid", geoms=make_arena(boxes=[wall(2.0)]))
    up, left = np.meshgrid(0.4 - 0.1 * np.arange(9), -0.6 + 0.1 * np.arange(13), indexing="ij")
    ahead = (2.0 - NOSE[0]) / (np.cos(up) * np.cos(left))
    with np.errstate(divide="ignore"):
        floor = np.where(up < -1e-9, (HEIGHT - NOSE[2]) / -np.sin(up), np.inf)
    np.testing.assert_allclose(scan, np.minimum(ahead, floor), rtol=RANGE_RTOL, atol=RANGE_ATOL)
    assert (floor < ahead)[-1].all()  # the lowest row comes last


def test_noise_of_a_3d_scan_is_every_beams_own_and_stays_in_range(bench, make_arena):
    scan = bench.once("RangeScanner3D", "Noisy", 3, geoms=make_arena(boxes=[wall(2.0)]))
    clean = bench.once("RangeScanner3D", "Solid", 3, geoms=make_arena(boxes=[wall(2.0)]))
    ratio = scan / clean - 1
    assert 0.05 < np.abs(ratio).max() <= 0.1 + 1e-5
    assert len(np.unique(scan)) > 100  # of 117
    near = bench.once("RangeScanner3D", "Noisy", geoms=make_arena(boxes=[wall(0.9)]))
    assert near.min() == 1.0
    assert set(bench.once("RangeScanner3D", "Noisy", at=(0, 0, 50.0)).ravel().tolist()) == {3.0}


def test_defaults_are_ardabots():
    """31 rows of 51 beams, every 0.4 s."""
    settings = resolve_settings(Scanner3DSettings, (), "RangeScanner3D S")
    assert settings.shape == (31, 51)
    assert (settings.scan_interval, settings.max_range) == (0.4, 1000.0)
    lines = grid_directions(settings)
    assert lines.shape == (31, 51, 3)
    np.testing.assert_allclose(np.linalg.norm(lines, axis=-1), 1, rtol=1e-6)
    assert math.asin(lines[0, 25, 2]) == pytest.approx(0.4363 / 2, abs=1e-6)
    assert math.atan2(lines[15, 0, 1], lines[15, 0, 0]) == pytest.approx(-1.0472 / 2, abs=1e-6)


# --- both -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "name"), [("IRScanner", "Told"), ("RangeScanner3D", "Told3D")])
def test_in_manual_mode_they_scan_once_for_each_command(bench, make_arena, kind, name):
    place = bench.suite.find(kind, name)
    inputs = bench.inputs(geoms=make_arena(boxes=[wall(2.0)]))
    memory, readings = bench.read(inputs, bench.start(inputs))
    assert not readings[place].fresh
    assert bench.suite.handle_set(place, "RESET", (), inputs, memory) is None
    memory = bench.suite.handle_set(place, "SCAN", (), inputs, memory)
    memory, readings = bench.read(inputs, memory)
    assert readings[place].fresh
    assert (np.asarray(readings[place].value) < 20).mean() > 0.5
    _, readings = bench.read(inputs, memory)
    assert not readings[place].fresh


def line_of(bench, name: str, value: np.ndarray) -> str:
    sensor = next(s for s in bench.suite.sensors if s.mounts[0].name == name)
    return format_message(sensor_report(sensor, value, 5608.85))


def test_lines_on_the_wire(bench):
    assert line_of(bench, "Infrared", np.array([11.3059, 20.0])) == (
        "SEN {Time 5608.85} {Type IRScanner} {Name Infrared} {Resolution 0.0174} {FOV 3.1415}"
        " {Range 11.3059,20.0000}"
    )
    assert line_of(bench, "Solid", np.array([[1.0, 2.0], [3.0, 4.0]])) == (
        "SEN {Time 5608.85} {Type RangeScanner3D} {Name Solid} {Resolution 0.1000,0.1000} {FOV 0.8000,1.2000}"
        " {Range 1.0000,2.0000,3.0000,4.0000}"
    )


@pytest.mark.parametrize(
    ("kind", "name", "fields"),
    [
        ("IRScanner", "Infrared", "{Resolution 0.0174} {Fov 3.1415} {Paning True} {Tilting False}"),
        ("RangeScanner3D", "Solid", "{Resolution 0.1000,0.1000} {FOV 0.8000,1.2000}"),
    ],
)
def test_getconf(bench, kind, name, fields):
    (message,) = configuration(
        bench.robot, bench.suite.sensors, (1.0,) * len(bench.robot.cameras), kind, name
    )
    assert format_message(message) == (
        f"CONF {{Type {kind}}} {{Name {name}}} {{MaxRange 20.0000}} {{MinRange 0.1000}} {fields}"
    )
