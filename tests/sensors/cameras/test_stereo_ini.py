"""isStereo and stereoSpacing of a robot's section (manual 3.2.6.2)."""

import numpy as np
import pytest

from usarmjx.base.errors import SpecError
from usarmjx.base.registry import Registry
from usarmjx.models.ini.robots import load_robots
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.cameras.mounts import cameras_of
from usarmjx.sim.configure import settings_by_kind


@pytest.fixture
def load(tmp_path):
    def from_text(text: str):
        path = tmp_path / "USARBot.ini"
        path.write_text(f"[USARBot.P2AT]\n{text}\n")
        robots: Registry[RobotSpec] = Registry("robot")
        robots.add("P2AT", P2AT)
        loaded = load_robots([path], robots, settings=settings_by_kind())
        return (loaded.robots or (P2AT,))[0], loaded.warnings

    return from_text


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("text", "right"),
    [
        ("isStereo=true", (0.0, 0.05, 0.0)),  # the manual's example
        ("isStereo=true\nstereoSpacing=(Y=0.03)", (0.0, 0.03, 0.0)),
        ("isStereo=true\nuuStereoSpacing=(Y=12.5)", (0.0, 0.05, 0.0)),  # 250 to the metre
        ("isStereo=true\nuuStereoSpacing=(Y=12.5)\nstereoSpacing=(Y=0.04,Z=0.01)", (0.0, 0.04, 0.01)),
        ("bMountByUU=True\nisStereo=true\nstereoSpacing=(Y=0.06)", (0.0, 0.06, 0.0)),
    ],
)
def test_the_main_camera_gets_eyes_that_are_that_far_from_its_middle(load, text, right):
    robot, warnings = load(text)
    assert not warnings
    left_eye, right_eye = cameras_of(robot)[0].eye_offsets
    np.testing.assert_allclose(right_eye, np.array(right) * (1, -1, -1), atol=1e-7)  # our y is to the left
    np.testing.assert_allclose(left_eye, -right_eye)
    assert cameras_of(robot)[0].default_fov == cameras_of(P2AT)[0].default_fov


def test_without_the_switch_there_is_one_eye(load):
    for text in ("stereoSpacing=(Y=0.05)", "isStereo=false\nstereoSpacing=(Y=0.05)"):
        robot, _ = load(text)
        np.testing.assert_array_equal(cameras_of(robot)[0].eye_offsets, np.zeros((1, 3)))


def test_a_camera_of_its_own_can_be_stereo_too(load):
    robot, warnings = load(
        "AddCameras=(ItemClass=class'USARBot.RobotCamera',ItemName=\"Two\",Position=(X=0.1,Y=0,Z=-0.3),"
        "IsStereo=True,StereoSpacing=(Y=0.1))"
    )
    assert not warnings
    assert [len(camera.eye_offsets) for camera in cameras_of(robot)] == [1, 2]
    np.testing.assert_allclose(cameras_of(robot)[1].eye_offsets[1], (0.0, -0.1, 0.0), atol=1e-7)


def test_wrong_spacings_are_refused_with_file_and_line(load):
    for text in ("stereoSpacing=(Y=0)", "stereoSpacing=0.05", "isStereo=maybe"):
        with pytest.raises(SpecError, match=r"USARBot\.ini:2"):
            load(text)
