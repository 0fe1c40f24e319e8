"""A depth camera against C MuJoCo's rays and the later versions' formulas."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.models.ini.texts import load_texts
from tests.sensors.blocks import c_rays, random_blocks
from usarmjx.base.backend import numpy_backend
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, options
from usarmjx.sensors.rays.raycast import cast_rays
from usarmjx.sensors.suite import suite_of
from usarmjx.sensors.swept import KinectSettings, strip_directions
from usarmjx.server.gamebots.sensors import configuration, sensor_report
from usarmjx.server.protocol.grammar import format_message
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim import Batch, build_scene

RANGE_ATOL = 1e-4  # m: single precision over a room
UNREAL = 65536 / (2 * np.pi)  # Unreal's units of angle in a radian
SMALL = dict(Frames=4, VerticalFOV=0.8, VerticalResolution=0.08, HorizontalFOV=0.6, HorizontalResolution=0.1)
ROWS, COLUMNS = 3, 7  # 0.8 / 4 of strip in steps of 0.08; 0.6 in steps of 0.1
NOSE = (0.2, 0.0, -0.3)


def robot(**keys):
    mount = Mount(kind="Kinect", name="Eye", at=NOSE, options=options(**keys))
    return replace(P2AT, name="With a depth camera", sensors=(mount,))


def test_its_beams_are_those_of_the_later_versions():
    """The loops of KinectDepth.uc over whole Unreal units, with its figures."""
    settings = KinectSettings()
    step, wide, high = int(0.0015625 * UNREAL), int(0.75 * UNREAL), int(1.0 * UNREAL)
    for frame in (0, 17, 59):
        start = int(-high / 2 + high * frame / 60)
        up = np.arange(start, start + high / 60, step) / UNREAL
        right = np.arange(int(-wide / 2), wide / 2 + 1e-9, step) / UNREAL
        up, right = np.meshgrid(up, right, indexing="ij")
        expected = np.stack([np.cos(up) * np.cos(right), -np.cos(up) * np.sin(right), np.sin(up)], -1)
        with numpy_backend():
            found = strip_directions(settings, np.int32(frame))
        assert settings.shape == up.shape == (11, 489)
        # Whole Unreal units are within 1e-4 rad.
        np.testing.assert_allclose(found, expected.reshape(-1, 3), atol=2e-4)


def strip_lines(frame):
    """Directions of a strip of the small camera, from the lowest row, each from left to right."""
    up = 0.8 * (frame / 4 - 0.5) + 0.08 * np.arange(ROWS)
    up, left = np.meshgrid(up, 0.3 - 0.1 * np.arange(COLUMNS), indexing="ij")
    lines = np.stack([np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up)], -1)
    return lines.reshape(-1, 3)


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(2))
def test_a_picture_has_the_depths_that_c_mujoco_meets(make_bench, make_arena, seed):
    """Strips from the bottom to the top, each as the robot stands at its moment, until the last."""
    bench, rng = make_bench(robot(MaxRange=3.0, **SMALL)), np.random.default_rng(seed)
    blocks = random_blocks(seed)
    cast = jax.jit(partial(bench.suite.hits, partial(cast_rays, make_arena(boxes=blocks))))
    inputs = bench.inputs()
    memory = bench.start(inputs)
    _, (idle,) = bench.read(inputs, memory)
    assert not idle.fresh, "nothing before a SCAN"
    assert bench.suite.handle_set(0, "Zoom", (), inputs, memory) is None
    memory = bench.suite.handle_set(0, "SCAN", (), inputs, memory)
    nearer = 0
    for frame in range(4):
        at, angles = np.array([*rng.uniform(-0.3, 0.3, 2), 0.9]), tuple(rng.uniform(-0.3, 0.3, 3))
        now = bench.inputs(time=0.2 * frame, at=at, angles=angles)
        hits = cast(now.bodies, jnp.int32(0), own=memory.own)
        memory, (heard,) = bench.read(now.replace(hits=hits), memory)
        mat = mat_from_angles(*angles)
        origin = at + mat @ (NOSE[0], -NOSE[1], -NOSE[2])
        met = c_rays(blocks, origin, strip_lines(frame) @ mat.T)
        assert heard.fresh
        assert heard.value[0] == frame
        np.testing.assert_allclose(heard.value[1:], np.minimum(met, 3.0), atol=RANGE_ATOL)
        nearer += (met < 3.0).sum()
        _, (same,) = bench.read(now.replace(hits=hits), memory)
        assert not same.fresh, "a strip for each interval"
    assert nearer > 10
    _, (after,) = bench.read(bench.inputs(time=1.0), memory)
    assert not after.fresh, "the picture is complete"


def test_a_served_world_sends_a_picture_strip_by_strip():
    """A P2AT on a floor: a beam that points down by a meets it at the height of the camera / sin a."""

    world = DynamicWorld(FLAT, max_robots=1)
    own = robot(ScanInterval=0.1, MaxRange=2.0, **SMALL)
    client = world.spawn(own, "R1", (0.0, 0.0, 0.3), (0.0, 0.0, 0.0))

    def heard(seconds):
        """Readings of some time, by the control step."""
        found = []
        for _ in range(round(seconds / world.period)):
            world.step()
            world.observe([client])
            if 0 in client.pending:
                found.append(client.pending.pop(0))
        return found

    assert heard(0.6) == []
    assert not world.operate_sensor(client, 0, "Zoom", ())
    assert world.operate_sensor(client, 0, "SCAN", ())
    strips = heard(1.0)
    assert [strip[0] for strip in strips] == [0, 1, 2, 3]
    bodies = world.bodies(client)
    height = float(bodies.pos[0, 2]) - NOSE[2]
    for frame, strip in enumerate(strips):
        # The robot stands still to within a millimetre, and leans by less than 1e-3 rad.
        np.testing.assert_allclose(strip[1:], floor_depths(frame, height), rtol=6e-3)
    assert (strips[0][1:] < 2.0).any()
    assert heard(0.6) == []
    assert world.operate_sensor(client, 0, "SCAN", ())
    assert [strip[0] for strip in heard(1.0)] == [0, 1, 2, 3], "another picture"


def floor_depths(frame, height):
    """Depths of a strip above a floor, of a camera that stands level [m]."""
    down = -strip_lines(frame)[:, 2]
    return np.minimum(np.where(down > 0, height / np.maximum(down, 1e-9), np.inf), 2.0)


def test_worlds_of_a_batch_measure_strips_of_their_own():
    own = replace(robot(MaxRange=2.0, **SMALL), cameras=(), effecters=())
    batch = Batch(build_scene(FLAT, [own]), 2, engine="c")
    state = batch.reset()
    (team,) = state.worlds.groups
    armed, numbers = jnp.ones_like(team.memory.armed), jnp.array([[0], [3]], jnp.int32)
    memory = team.memory.replace(armed=armed, own=(numbers,))
    state = batch.with_group(state, 0, team.replace(memory=memory))
    root = batch.scene.groups[0].indices[0].root_qposadr
    heights = np.asarray(batch.physics(state).qpos)[:, root + 2] - NOSE[2]
    state, ((reading,),) = batch.observe(state)
    after = state.worlds.groups[0].memory
    np.testing.assert_array_equal(after.own[0], [[1], [0]])
    np.testing.assert_array_equal(after.armed, [[[True]], [[False]]])
    for world, frame in enumerate((0, 3)):
        heard = np.asarray(reading.value)[world, 0]
        assert heard[0] == frame
        np.testing.assert_allclose(heard[1:], floor_depths(frame, heights[world]), rtol=6e-3)


def test_a_client_hears_strips_in_whole_centimetres():
    (kinect,) = suite_of(robot()).sensors
    value = np.array([12.0, 1.2399, 3.0, 0.004])
    assert format_message(sensor_report(kinect, value, 2.0, stamped=True)) == (
        "SEN {Time 2.0000} {Type Kinect} {Name Eye} {Frame 12} {Range 123,300,0}"
    )
    (conf,) = configuration(P2AT, [kinect], [1.0] * len(P2AT.cameras), "Kinect", "")
    assert format_message(conf) == (
        "CONF {Type Kinect} {Name Eye} {MaxRange 3.0000} {MinRange 0.1000}"
        " {Resolution 0.0015,0.0015} {Fov 0.7500,1.0000}"
    )


def test_a_file_of_the_later_versions_mounts_one(tmp_path):
    part = "AddParts=(ItemClass=class'USARSensor.KinectDepth',ItemName=Eye,Position=(X=0.2,Y=0,Z=0))"
    section = "[USARSensor.KinectDepth]\nScanInterval=0.1\nMaxRange=4.0\n"
    loaded = load_texts(tmp_path, [f"{section}[USARBot.P3AT]\n{part}\n"], (P2AT,))
    (mounted,) = [one for one in loaded.robots if one.name == "P2AT"]
    (kinect,) = [one for one in suite_of(mounted).sensors if one.kind == "Kinect"]
    assert (kinect.settings[0].scan_interval, kinect.max_distance) == (0.1, 4.0)
