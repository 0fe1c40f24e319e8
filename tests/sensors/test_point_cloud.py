"""A point cloud scanner against C MuJoCo's rays and the later versions' figures."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.models.ini.texts import load_texts
from tests.sensors.blocks import c_rays, random_blocks
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, options
from usarmjx.sensors.rays.raycast import cast_rays
from usarmjx.sensors.suite import suite_of
from usarmjx.sensors.swept import PointCloudSettings
from usarmjx.server.gamebots.sensors import sensor_report
from usarmjx.server.protocol.dialects import UDK
from usarmjx.server.protocol.grammar import format_message

POINT_ATOL = 2e-4  # m: single precision over a room
LONG = 2.75  # m: shorter than some beams
BEAMS, WIDE, HIGH, ROWS = 21, 2.094395, 0.785398, 5  # 1 s a sweep, 0.2 s a row
NOSE = (0.2, 0.1, -0.1)  # the wire's axes


def robot(**keys):
    mount = Mount(kind="PCL", name="Cloud", at=NOSE, options=options(**keys))
    return replace(P2AT, name="With a point cloud scanner", sensors=(mount,))


def pitched(row):
    """Directions of a row: beams in a level plane, from left to right, which is then pitched up."""
    left = np.linspace(WIDE / 2, -WIDE / 2, BEAMS)
    level = np.stack([np.cos(left), np.sin(left), 0 * left], -1)
    return level @ mat_from_angles(0.0, HIGH * (0.5 - row / ROWS), 0.0).T  # pitch is positive nose down


@pytest.mark.oracle
def test_rows_have_the_points_that_c_mujoco_meets_and_rise_until_a_sweep_begins_again(make_bench, make_arena):
    bench, rng = make_bench(robot(MaxRange=LONG, NumberOfBeams=BEAMS)), np.random.default_rng(1)
    blocks = random_blocks(1)
    cast = jax.jit(partial(bench.suite.hits, partial(cast_rays, make_arena(boxes=blocks))))
    memory, nearer = bench.start(bench.inputs()), 0
    for number in range(ROWS + 2):
        at, angles = np.array([*rng.uniform(-0.3, 0.3, 2), 0.9]), tuple(rng.uniform(-0.3, 0.3, 3))
        now = bench.inputs(time=0.2 * number, at=at, angles=angles)
        memory, (heard,) = bench.read(
            now.replace(hits=cast(now.bodies, jnp.int32(0), own=memory.own)), memory
        )
        mat, lines = mat_from_angles(*angles), pitched(number % ROWS)
        met = c_rays(blocks, at + mat @ (NOSE[0], -NOSE[1], -NOSE[2]), lines @ mat.T)
        assert heard.fresh
        np.testing.assert_allclose(heard.value, np.minimum(met, LONG)[:, None] * lines, atol=POINT_ATOL)
        nearer += (met < LONG).sum()
    assert 0 < nearer < BEAMS * (ROWS + 2), "some beams meet something, some do not"


def test_a_client_hears_points_in_the_axes_of_the_wire():
    """Two decimals, as UnrealScript writes vectors; in the later dialect the same."""
    (scanner,) = suite_of(robot()).sensors
    value = np.array([[1.5, 0.25, -0.125], [4.0, -2.0, 0.5]])
    message = sensor_report(scanner, value, 2.0, stamped=True)
    (heard,) = UDK.translate(message)
    assert format_message(heard) == (
        "SEN {Time 2.0000} {Type PCL} {Name Cloud} {Points 1.50,-0.25,0.12;4.00,2.00,-0.50}"
    )


def test_a_file_of_the_later_versions_mounts_one(tmp_path):
    """The section of their DefaultUSAR.ini: the values that a scanner has without it, too."""
    kind = "RotatingPointCloudScanner"
    part = f"AddParts=(ItemClass=class'USARSensor.{kind}',ItemName=Cloud,Position=(X=0.2,Y=0,Z=0))"
    keys = "numberOfBeams=256\nHFieldOfView=2.094395\nVFieldOfView=0.785398\nmaxRange=40\nscanRate=0.2"
    keys += "\nspinRate=1"
    found = []
    for section in ("", f"[USARSensor.{kind}]\n{keys}\n"):
        loaded = load_texts(tmp_path, [f"{section}[USARBot.P3AT]\n{part}\n"], (P2AT,))
        (mounted,) = [one for one in loaded.robots if one.name == "P2AT"]
        found += [one.settings[0] for one in suite_of(mounted).sensors if one.kind == "PCL"]
    assert found == [PointCloudSettings()] * 2
    assert sum("scanRate is ignored" in text for text in loaded.warnings) == 1
