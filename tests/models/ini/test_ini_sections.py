"""Class sections reach the robots that are there already (manual 10.3.2, 10.14.2), file after file."""

from dataclasses import replace

import pytest

from usarmjx.base.errors import SpecError
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, options
from usarmjx.sensors.cameras.mounts import cameras_of, resolve_camera
from usarmjx.sensors.suite import suite_of
from usarmjx.sim.configure import configure

MANUAL_CAMERA = """[USARBot.RobotCamera]
Weight=0.4
CameraDefFov={}
CameraMinFov={}
CameraMaxFov={}
"""


@pytest.fixture
def read(monkeypatch, tmp_path):
    """Configure with texts as files, in one call; what they change leaves with the test."""
    monkeypatch.setattr(ROBOTS, "_entries", dict(ROBOTS._entries))

    def from_texts(*texts):
        paths = []
        for text in texts:
            paths.append(tmp_path / f"{len(list(tmp_path.iterdir()))}.ini")
            paths[-1].write_text(text)
        return configure(paths)

    return from_texts


def scanners(kind="RangeScanner"):
    """Settings of all robots' scanners, by robot and item."""
    return {
        (name, mount.name): settings
        for name, robot in ROBOTS
        for sensor in suite_of(robot).sensors
        for mount, settings in zip(sensor.mounts, sensor.settings, strict=True)
        if mount.kind == kind
    }


def cameras():
    return {(name, camera.mount.name): camera for name, robot in ROBOTS for camera in cameras_of(robot)}


def test_a_class_section_reaches_the_scanners_of_all_robots(read):
    before = scanners()
    warnings = read("[USARBot.RangeScanner]\nMaxRange=5\n").warnings
    after = scanners()
    assert after.keys() == before.keys() != set()
    assert {one.max_range for one in after.values()} == {5.0}
    assert not [text for text in warnings if "MaxRange" in text]
    assert {key: one.resolution for key, one in after.items()} == {
        key: one.resolution for key, one in before.items()
    }, "what it does not name stays as captured"


def test_a_class_section_reaches_the_cameras_of_all_robots(read):
    before = cameras()
    read("[USARBot.RobotCamera]\nCameraDefFov=1.2\n")
    assert cameras().keys() == before.keys() != set()
    assert {(c.min_fov, c.default_fov, c.max_fov) for c in cameras().values()} == {(0.3491, 1.2, 2.0944)}


@pytest.mark.parametrize(("section", "wanted"), [
    ((0.7854, 1.0, 1.0), (1.0, 1.0, 1.0)),
    ((0.7854, 0.9, 2.0944), (0.9, 0.9, 2.0944)),
    ((1.9, 0.3491, 1.5), (0.3491, 1.5, 1.5)),
])  # fmt: skip
def test_equal_limits_make_a_fixed_camera_and_the_default_is_brought_within_them(read, section, wanted):
    read(MANUAL_CAMERA.format(*section))
    camera = cameras()["P2AT", "Camera"]
    assert (camera.min_fov, camera.default_fov, camera.max_fov) == pytest.approx(wanted)
    assert float(camera.clamp(2.0)) == pytest.approx(min(2.0, wanted[2]))
    assert float(camera.clamp(0.0)) == pytest.approx(wanted[1])


def test_a_cameras_own_field_of_view_is_not_bent():
    bent = Mount(kind="Camera", name="C", options=options(CameraMinFov=1.0, CameraMaxFov=1.0))
    assert resolve_camera(bent, "C").camera_def_fov == 1.0
    own = Mount(kind="Camera", name="C", options=options(CameraDefFov=0.5, CameraMinFov=1.0))
    with pytest.raises(SpecError, match="expected 0 < CameraMinFov <= CameraDefFov"):
        resolve_camera(own, "C")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[USARBot.RobotCamera]\nCameraMinFov=2\nCameraMaxFov=1\n", "fields of view are 2 to 1"),
        ("[USARBot.RobotCamera]\nCameraMaxFov=4\n", "expected 0 < CameraMinFov"),
        ("[USARBot.RangeScanner]\nMaxRange=0.01\n", "MaxRange"),
        ("[USARBot.RangeScanner]\nMaxRange=5\n[USARBot.P2AT]\nMaxTorque=much\n", "MaxTorque is 'much'"),
    ],
)
def test_a_section_that_is_wrong_changes_nothing(read, text, says):
    read("[USARBot.RangeScanner]\nMaxRange=6\n")
    before = dict(ROBOTS)
    with pytest.raises(SpecError, match=says):
        read(text)
    assert all(ROBOTS.get(name) is robot for name, robot in before.items())
    assert len(before) == len(ROBOTS)
    read("[USARBot.SonarSensor]\nMaxRange=4\n")
    assert scanners()["P2AT", "Scanner1"].max_range == 6.0, "the file before is still in force"


OWN = "AddSensors=(ItemClass=class'USARBot.RangeScanner',ItemName=Scanner1,MaxRange=8.0)"


@pytest.mark.parametrize("calls", [1, 3])
def test_the_mount_wins_over_the_section_and_the_later_file_over_the_earlier(read, calls):
    texts = (
        f"[USARBot.P2AT]\n{OWN}\n[USARBot.RangeScanner]\nMaxRange=5\nMinRange=0.2\n",
        "[USARBot.RangeScanner]\nMaxRange=7\n",
        "[USARBot.P2DX]\nMaxTorque=50\n[USARBot.RangeScanner]\nMinRange=0.3\n",
    )
    if calls == 1:
        warnings = read(*texts).warnings
    else:
        warnings = tuple(text for part in texts for text in read(part).warnings)
    found = scanners()
    assert found["P2AT", "Scanner1"].max_range == 8.0
    assert {one.max_range for key, one in found.items() if key[0] != "P2AT"} == {7.0}
    assert {one.min_range for one in found.values()} == {0.3}
    assert (
        len([text for text in warnings if "leaves alone those that have their own: P2AT Scanner1" in text])
        >= 1
    )
    assert len(set(warnings)) == len(warnings), "each is told once"


def test_an_item_of_a_later_file_has_what_an_earlier_one_said_of_its_class(read):
    read("[USARBot.RFIDReleaser]\nNumTags=20\n")
    told = read("[USARBot.P2AT]\nAddEffecters=(ItemClass=class'USARBot.RFIDReleaser',ItemName=Gun)\n")
    assert [robot.name for robot in told.robots] == ["P2AT"]
    assert ROBOTS.get("P2AT").effecters[-1].all_options == (("NumTags", 20),)


def test_figures_of_two_calls_are_not_multiplied(read):
    """MotorTorque 40 is twice the class's own 20 (manual 14.4.2.3), however often it is said."""

    def torque():
        return next(part.motor.torque for part in ROBOTS.get("Tarantula").parts if part.name == "FRFlipper")

    before = torque()
    for _ in range(2):
        read("[USARBot.Tarantula]\nMotorTorque=40\nSteerTorque=500\n[USARBot.Cooper]\nSuspStiffness=300\n")
    assert torque() == pytest.approx(2 * before)
    read("[USARBot.Tarantula]\nMotorTorque=20\n")
    assert torque() == pytest.approx(before)


def test_a_robot_of_a_file_can_be_told_more_by_a_later_call(read):
    read("[USARBot.Small]\nBaseClass=P2AT\nPayload=3\n")
    small = read("[USARBot.Small]\nbatteryLife=60\n").robots
    assert [(robot.name, robot.payload, robot.battery_life) for robot in small] == [("Small", 3.0, 60.0)]


def test_files_come_on_top_of_a_robot_that_was_replaced_since(read):
    read("[USARBot.P2AT]\nPayload=3\n")
    ROBOTS.replace("P2AT", replace(P2AT, payload=9.0))
    read("[USARBot.P2AT]\nbatteryLife=60\n")
    assert (ROBOTS.get("P2AT").payload, ROBOTS.get("P2AT").battery_life) == (9.0, 60.0)


def test_each_file_has_the_scale_of_its_call(read, tmp_path):
    place = "AddSensors=(ItemClass=class'USARBot.INS',ItemName={},Position=(X={}))"
    read()
    for name, scale in (("Old", 52.5), ("New", 250.0)):
        path = tmp_path / f"{name}.ini"
        path.write_text(f"[USARBot.P2AT]\nbMountByUU=True\n{place.format(name, scale)}")
        configure([path], scale)
    xs = [mount.at[0] for mount in ROBOTS.get("P2AT").sensors if mount.name in ("Old", "New")]
    assert xs == pytest.approx([1.0, 1.0])
