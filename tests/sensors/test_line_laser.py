"""A line laser against C MuJoCo's rays and the later versions' lines."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.models.ini.texts import load_texts
from tests.sensors.blocks import c_rays, random_blocks
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, options
from usarmjx.sensors.suite import suite_of
from usarmjx.server.gamebots.sensors import configuration, sensor_report
from usarmjx.server.protocol.grammar import format_message

POINT_ATOL = 2e-4  # m: single precision over a room, as of ranges
BEAMS = 119  # Resolution 120: the loop of LineLaser.uc ends before the last one
LONG = 2.75  # m: shorter than some beams of each room
NOSE = (0.2, 0.1, -0.1)  # the wire's axes


def robot(**keys):
    mount = Mount(kind="LineLaser", name="Line", at=NOSE, options=options(**keys))
    return replace(P2AT, name="With a line laser", sensors=(mount,))


@pytest.fixture(scope="module")
def bench(make_bench):
    return make_bench(robot(MaxRange=LONG))


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(3))
def test_a_line_has_the_points_that_c_mujoco_meets(bench, make_arena, seed):
    """From left to right in steps of FOV / (Resolution - 1), in world axes, from a robot turned any way."""
    rng = np.random.default_rng(seed)
    blocks, angles = random_blocks(seed), tuple(rng.uniform(-0.5, 0.5, 3))
    at, mat = np.array([0.3, -0.2, 0.9]), mat_from_angles(*angles)
    origin = at + mat @ (NOSE[0], -NOSE[1], -NOSE[2])
    left = 1.570796 * (0.5 - np.arange(BEAMS) / 119)
    lines = np.stack([np.cos(left), np.sin(left), 0 * left], -1) @ mat.T
    met = c_rays(blocks, origin, lines)
    value = bench.once("LineLaser", "Line", at=at, angles=angles, geoms=make_arena(boxes=blocks))
    np.testing.assert_allclose(value[0], origin, atol=1e-5)
    np.testing.assert_allclose(value[1], angles, atol=1e-5)
    expected = origin + np.minimum(met, LONG)[:, None] * lines
    np.testing.assert_allclose(value[2:], expected, atol=POINT_ATOL)
    assert 0 < (met <= LONG).sum() < BEAMS, "some beams meet something, some do not"


def test_pictures_show_in_red_what_the_last_scan_met(bench, make_arena):
    inputs = bench.inputs(geoms=make_arena(boxes=[((2.0005, 5.0, 1.0), (0.0005, 5.0, 1.0), 0.0)]))
    memory, readings = bench.read(inputs, bench.start(inputs))
    (laser,) = bench.suite.sensors
    assert laser.has_overlay
    drawn, value = laser.overlay(memory.own[0]), np.asarray(readings[0].value)
    shown = np.asarray(drawn.shown)
    np.testing.assert_array_equal(drawn.start, value[2:])
    np.testing.assert_array_equal(drawn.start, drawn.end)
    np.testing.assert_allclose(np.asarray(drawn.start)[shown][:, 0], 2.0, atol=POINT_ATOL)
    assert shown[10]
    assert not shown[-10:].any(), "the wall ends on the left side"
    assert set(map(tuple, np.asarray(drawn.rgb)[shown].tolist())) == {(1.0, 0.0, 0.0)}


def test_a_client_hears_pose_and_points_in_the_axes_of_the_wire():
    (laser,) = suite_of(robot()).sensors
    value = np.array([[4.5, 1.9, 0.3], [0.0, 0.0, 0.5], [5.5, 2.9, 0.0625], [4.5, -2.9, 0.3]])
    assert format_message(sensor_report(laser, value, 2.0, stamped=True)) == (
        "SEN {Time 2.0000} {Type LineLaser} {Name Line} {Location 4.5000,-1.9000,-0.3000}"
        " {Orientation 0.0000,0.0000,5.7831} {Points [5.500,-2.900,-0.062][4.500,2.900,-0.300]}"
    )
    assert 5.7831 < math.tau - 0.5 < 5.7832
    (conf,) = configuration(P2AT, [laser], [1.0] * len(P2AT.cameras), "LineLaser", "")
    assert format_message(conf) == (
        "CONF {Type LineLaser} {Name Line} {MaxRange 5.0000} {MinRange 0.1000} {FOV 1.5707} {Resolution 120}"
    )


def test_a_file_of_the_later_versions_mounts_one(tmp_path):
    """The section of their DefaultUSAR.ini, whose Resolution is a number of beams."""
    part = "AddParts=(ItemClass=class'USARSensor.LineLaser',ItemName=Line,Position=(X=0.2,Y=0,Z=0))"
    section = "[USARSensor.Linelaser]\nScanInterval=0.1\nsquareSize=5\nFOV=1.2\nResolution=60\nMaxRange=4.0\n"
    loaded = load_texts(tmp_path, [f"{section}[USARBot.P3AT]\n{part}\n"], (P2AT,))
    (mounted,) = [one for one in loaded.robots if one.name == "P2AT"]
    (laser,) = [one for one in suite_of(mounted).sensors if one.kind == "LineLaser"]
    assert (laser.settings[0].beams, laser.settings[0].fov, laser.max_distance) == (60, 1.2, 4.0)
    assert sum("squareSize is ignored" in text for text in loaded.warnings) == 1
