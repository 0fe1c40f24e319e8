"""The camera benchmark's record."""

import json

import mujoco
import numpy as np
import pytest

from benchmarks.camera import measure_camera, with_camera
from benchmarks.cases import AllBaselineOptions, CameraCase
from tests.benchmarks.records import faults
from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.cameras.mounts import camera_index, cameras_of
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene


def test_the_record_says_what_was_measured_where(tmp_path):
    file = tmp_path / "new" / "camera.jsonl"
    case = CameraCase(worlds=2, roster="P2AT:2", arena="soccer", size="16x8", engine="c", steps=2, repeats=2)
    summary = measure_camera(case, AllBaselineOptions(json=file))
    record = json.loads(file.read_text())
    assert record["benchmark"] == "camera"
    assert record["device"]
    assert faults(record) == []
    on_cpu = record["baselines"]["mj_multiray"]
    assert on_cpu["rate"] == pytest.approx(on_cpu["worlds"] / np.median(on_cpu["times_s"]))
    assert (record["case"]["width"], record["case"]["height"]) == (16, 8)
    assert record["frames_per_s"] == pytest.approx(2 * 2 * 2 / np.median(record["times_s"]))
    assert record["pixels_per_s"] == pytest.approx(record["frames_per_s"] * 16 * 8)
    assert len(record["times_s"]) == 2
    # The field is 45 solids, the ball one, and each of the two robots what it is drawn as.
    count = 45 + 1 + 2 * len(kinematic_tree_of(ROBOTS.get("P2AT")).visuals.solids.kind)
    assert record["scene"] == {"geoms": count, "materials": {"opaque": count}, "lit_by": "4 lamps"}
    assert f"{record['frames_per_s']:,.1f} /s" in summary
    assert f"geoms         {count}, lit by 4 lamps" in summary


@pytest.mark.thorough
def test_the_peer_looks_from_the_same_place_at_the_same_scene():
    scene = build_scene("soccer", ["P2AT"])
    batch, robot = Batch(scene, 1, engine="c"), scene.groups[0].robot
    state, camera = batch.reset(), cameras_of(robot)[camera_index(robot)]
    model = with_camera(scene, camera, (16, 8))
    data = mujoco.MjData(model)
    data.qpos[:] = np.asarray(batch.physics(state).qpos[0])
    mujoco.mj_forward(model, data)
    right, up, back = data.cam_xmat[0].reshape(3, 3).T
    seen, own = batch.render_robot(state, 0, 0, None, 16, 8), set(scene.groups[0].indices[0].body_ids)
    angle = np.radians(model.cam_fovy[0]) / 2
    for row, column in ((5, 3), (6, 8), (7, 13)):
        across = (2 * (column + 0.5) - 16) / 8 * np.tan(angle)
        along = -back + across * right + (1 - 2 * (row + 0.5) / 8) * np.tan(angle) * up
        length = np.linalg.norm(along)
        met, geom = 0.0, np.zeros(1, np.int32)
        while True:  # past the robot's own parts: ours hides those that cover the lens, the peer back faces
            start = data.cam_xpos[0] + met * along / length
            met += mujoco.mj_ray(model, data, start, along / length, None, 1, -1, geom)
            if model.geom_bodyid[geom[0]] not in own:
                break
            met += 1e-6
        assert seen.depth[row, column] == pytest.approx(met / length, abs=1e-3)


def test_cameras_that_the_peer_does_not_have_are_refused():
    scene = build_scene("soccer", ["OmniP2DX"])
    with pytest.raises(UsageError, match="needs a pinhole camera"):
        with_camera(scene, cameras_of(scene.groups[0].robot)[0], (16, 8))


@pytest.mark.thorough
def test_the_record_has_the_peers_figures(tmp_path):
    pytest.importorskip("warp", reason="needs warp-lang")
    case = CameraCase(worlds=1, arena="soccer", size="16x8", engine="c", steps=1, repeats=1, peer=True)
    summary = measure_camera(case, AllBaselineOptions(json=tmp_path / "camera.jsonl"))
    peers = json.loads((tmp_path / "camera.jsonl").read_text())["peer"]
    assert [peer["shadows"] for peer in peers] == [True, False]
    for peer in peers:
        assert peer["geoms"] == 45 + 1 + 9
        assert 0.4 < peer["pixels_that_see_something"] < 1.0, "half of it is sky"
        assert f"{peer['frames_per_s']:,.1f} /s, 55 geoms" in summary


def test_a_robot_without_a_camera_is_refused_by_name():
    with pytest.raises(UnknownNameError, match="ComStation has no camera"):
        measure_camera(CameraCase(worlds=1, roster="ComStation", arena="soccer", engine="c"))
