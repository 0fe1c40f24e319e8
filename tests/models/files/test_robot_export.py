"""Robots written as MJCF, URDF and SDF: MuJoCo's loader, our reader and ElementTree find the same robot."""

import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest

from tests.models.files.test_import_mjcf import composed
from usarmjx.base.errors import UsageError
from usarmjx.models import load_robot
from usarmjx.models.drives import NoDrive
from usarmjx.models.files.robot_export import export_robot, rpy_of
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import Motor, Part, RobotSpec
from usarmjx.models.types.shapes import Mesh, Shape

NAMES = ("P2AT", "Sedan", "Kenaf", "AirRobot")
MASS_RTOL = 1e-9  # numbers are written with all digits
MJCF_RTOL = 1e-4  # MuJoCo writes six digits, of which an inertia has cubes and squares
PLACE_ATOL = 1e-6  # m: MuJoCo's mesh corners are single precision
CORNERS = np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.1, 0], [0, 0, 0.15]])
ODD = RobotSpec(
    name="Odd",
    dimensions=(0, 0, 0),
    mass=0.0,
    origin_height=0.0,
    drive=NoDrive(),
    chassis=(
        Shape(kind="mesh", mesh=Mesh(CORNERS), mass=2.0, rotation=(0.1, 0.2, 0.3), at=(0.0, 0.1, 0.2)),
        Shape(kind="ellipsoid", size=(0.1, 0.05, 0.02), mass=0.5, at=(0.3, 0, 0)),
    ),
    parts=(
        Part(
            name="lift",
            joint="slide",
            axis=(0.0, 0.0, -1.0),
            rotation=(0.2, -0.3, 0.4),
            at=(0.1, 0.2, -0.3),
            limits=(-0.1, 0.2),
            motor=Motor(max_speed=0.3, torque=40.0, stiffness=100.0, damping=10.0),
            shapes=(Shape(kind="capsule", size=(0.03, 0.1), mass=0.4),),
        ),
        Part(
            name="tip",
            parent="lift",
            geared="lift",
            gear_ratio=2.0,
            gear_offset=0.1,
            shapes=(Shape(kind="sphere", size=(0.02,), mass=0.1),),
        ),
    ),
)


@pytest.fixture(params=[*NAMES, "Odd"])
def robot(request):
    return ODD if request.param == "Odd" else ROBOTS.get(request.param)


def joints_of(model):
    return {
        model.joint(i).name: i for i in range(model.njnt) if model.jnt_type[i] != mujoco.mjtJoint.mjJNT_FREE
    }


def places(model):
    """Positions of bodies and solids at rest, in the chassis' axes."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root = model.body("chassis").id
    mat, pos = data.xmat[root].reshape(3, 3), data.xpos[root]
    return {model.body(i).name: (data.xpos[i] - pos) @ mat for i in range(root, model.nbody)}


@pytest.mark.parametrize("form", ["mjcf", "urdf"])
def test_mujocos_own_loader_finds_the_same_robot(robot, form, tmp_path):
    path = tmp_path / f"robot.{form}"
    export_robot(robot, path, form)
    ours, theirs = composed(robot), mujoco.MjModel.from_xml_path(str(path))
    exact = form == "urdf"
    assert theirs.body_mass.sum() == pytest.approx(
        ours.body_mass.sum(), rel=MASS_RTOL if exact else MJCF_RTOL
    )
    assert joints_of(theirs).keys() == joints_of(ours).keys()
    for name, number in joints_of(theirs).items():
        other = joints_of(ours)[name]
        assert theirs.jnt_type[number] == ours.jnt_type[other]
        assert theirs.jnt_axis[number] == pytest.approx(ours.jnt_axis[other], abs=PLACE_ATOL)
        if ours.jnt_limited[other]:
            assert theirs.jnt_range[number] == pytest.approx(
                ours.jnt_range[other], abs=1e-9 if exact else 1e-5
            )
    here, there = places(ours), places(theirs)
    assert here.keys() == there.keys()
    for name, place in here.items():
        assert there[name] == pytest.approx(place, abs=PLACE_ATOL if exact else 1e-5), name
        one, two = ours.body(name), theirs.body(name)
        assert np.sort(two.inertia) == pytest.approx(np.sort(one.inertia), rel=1e-6 if exact else MJCF_RTOL)


@pytest.mark.parametrize("form", ["urdf", "sdf"])
def test_our_reader_finds_the_same_robot(robot, form, tmp_path):
    path = tmp_path / f"robot.{form}"
    export_robot(robot, path, form)
    back = load_robot(path, name="Back").robot
    ours, theirs = composed(robot), composed(back)
    assert back.mass == pytest.approx(ours.body_mass.sum(), rel=1e-6)
    assert {part.name for part in back.parts} == joints_of(ours).keys()
    if form == "urdf" and ours.neq:  # the reader of SDF has no mimic joints
        assert theirs.neq == ours.neq
        assert theirs.eq_data[0, :2] == pytest.approx(ours.eq_data[0, :2])


def test_the_sdf_has_the_same_masses_places_and_joints(robot, tmp_path):
    path = tmp_path / "robot.sdf"
    result = export_robot(robot, path, "sdf")
    model = ET.parse(path).getroot().find("model")
    ours = composed(robot)
    assert sum(float(m.text) for m in model.iter("mass")) == pytest.approx(
        ours.body_mass.sum(), rel=MASS_RTOL
    )
    here = places(ours)
    for link in model.findall("link"):
        pose = [float(word) for word in link.find("pose").text.split()]
        assert pose[:3] == pytest.approx(here[link.get("name").removesuffix("_link")], abs=PLACE_ATOL)
    kinds = {joint.get("name"): joint.get("type") for joint in model.findall("joint")}
    assert {name for name, kind in kinds.items() if kind != "fixed"} == joints_of(ours).keys()
    followers = {part.name for part in robot.parts if part.geared is not None}
    # libsdformat reads a <mimic> of an axis: one that is deeper has no effect.
    found = {one.get("name") for one in model.findall("joint") if one.find("axis/mimic") is not None}
    assert found == followers
    for name in {uri.text for uri in model.iter("uri")}:
        assert path.with_name(name) in result.files


@pytest.mark.parametrize("angles", [(0.3, -0.4, 1.2), (0.5, np.pi / 2, 0.0), (0.5, -np.pi / 2, 0.2)])
def test_angles_are_those_of_mujocos_urdf(angles):
    quat = np.zeros(4)
    mujoco.mju_euler2Quat(quat, np.array(angles), "XYZ")
    mat, back = np.zeros(9), np.zeros(4)
    mujoco.mju_quat2Mat(mat, quat)
    mujoco.mju_euler2Quat(back, rpy_of(mat.reshape(3, 3)), "XYZ")
    assert abs(quat @ back) == pytest.approx(1.0, abs=1e-12)


def test_other_formats_are_refused(tmp_path):
    with pytest.raises(UsageError, match="format 'usd'; known: mjcf, urdf, sdf"):
        export_robot(ODD, tmp_path / "a.usd", "usd")
