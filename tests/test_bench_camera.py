"""The camera benchmark's record."""

import json

import numpy as np
import pytest

from usarmjx.bench_camera import CameraCase, measure_camera
from usarmjx.errors import UnknownNameError


def test_the_record_says_what_was_measured_where(tmp_path):
    file = tmp_path / "new" / "camera.jsonl"
    case = CameraCase(worlds=2, robots=2, arena="soccer", width=16, height=8, engine="c", steps=2, repeats=2)
    summary = measure_camera(case, file)
    record = json.loads(file.read_text())
    assert record["benchmark"] == "camera"
    assert record["device"]
    assert (record["case"]["width"], record["case"]["height"]) == (16, 8)
    assert record["frames_per_s"] == pytest.approx(2 * 2 * 2 / np.median(record["times_s"]))
    assert record["pixels_per_s"] == pytest.approx(record["frames_per_s"] * 16 * 8)
    assert len(record["times_s"]) == 2
    # The field is 45 solids, the ball one, and the two robots have 9 each.
    assert record["scene"] == {"geoms": 45 + 1 + 18, "materials": {"opaque": 64}, "lit_by": "4 lamps"}
    assert f"{record['frames_per_s']:,.1f} /s" in summary
    assert "geoms         64, lit by 4 lamps" in summary


def test_a_robot_without_a_camera_is_refused_by_name():
    with pytest.raises(UnknownNameError, match="ComStation has no camera"):
        measure_camera(CameraCase(worlds=1, robot="ComStation", arena="soccer", engine="c"))
