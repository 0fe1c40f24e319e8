"""Robots from files as people have them, against the file and MuJoCo's own reader."""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.models.files.test_import_mjcf import compare, composed
from usarmjx.base.errors import ArenaFileError, SpecError, UsageError
from usarmjx.models import load_robot
from usarmjx.models.check import settling_distance
from usarmjx.models.compile.compose import add_robot
from usarmjx.models.drives import Ackermann, NoDrive, RotaryWing, SkidSteer
from usarmjx.models.files import reader_child, reader_process
from usarmjx.models.files.load import load_arena
from usarmjx.models.types.robot import CHASSIS

CASES = Path(__file__).parent / "cases"
MASS_ATOL = 1e-6  # kg, as of single precision
SIZE_ATOL = 2e-6  # m: 1.5708 in the files is not quite a quarter turn
WHEEL = """<link name="{0}"><inertial><mass value="1"/>
  <inertia ixx=".003" iyy=".005" izz=".003" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin rpy="1.5707963 0 0"/><geometry><cylinder radius=".1" length=".05"/></geometry>
  </collision></link>"""
BASE = """<link name="base"><inertial><mass value="10"/>
  <inertia ixx=".2" iyy=".3" izz=".4" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="0 0 .1"/><geometry><box size=".6 .4 .1"/></geometry></collision></link>"""


def hinge(name, child, at, axis="0 1 0", parent="base", kind="continuous", more=""):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}"/><axis xyz="{axis}"/>{more}</joint>'
    )


def cart(more="", axis="0 1 0", limit=""):
    wheels = WHEEL.format("wl") + WHEEL.format("wr")
    joints = hinge("L", "wl", "0 .25 0", axis, more=limit) + hinge("R", "wr", "0 -.25 0", axis, more=limit)
    return f'<robot name="cart">{BASE}{wheels}{joints}{more}</robot>'


@pytest.fixture
def load(tmp_path):
    def from_text(text, name="robot.urdf", **options):
        (tmp_path / name).write_text(text)
        return load_robot(tmp_path / name, **options)

    return from_text


def test_stated_inertia_makes_no_solid():
    robot = load_robot(CASES / "placeholder_inertia.urdf").robot
    assert robot.mass == pytest.approx(8 + 2 * 0.5, abs=MASS_ATOL)
    assert robot.dimensions == pytest.approx((0.4, 0.44, 0.205), abs=SIZE_ATOL)
    assert robot.origin_height == pytest.approx(0.08 - 0.05, abs=SIZE_ATOL)
    assert [shape.kind for shape in robot.chassis] == ["box"]
    compare(CASES / "placeholder_inertia.urdf", robot)


def test_a_solid_without_inertial_weighs_nothing():
    robot = load_robot(CASES / "collision_without_inertial.urdf").robot
    assert robot.mass == pytest.approx(12 + 2 * 1, abs=MASS_ATOL)
    model = composed(robot)
    assert model.body("chassis").inertia == pytest.approx((0.3, 0.6, 0.8))


def test_round_meshes_on_wheels_become_cylinders():
    robot = load_robot(CASES / "mesh_wheels.urdf").robot
    assert isinstance(robot.drive, SkidSteer)
    assert (robot.drive.left, robot.drive.right) == (("FL", "RL"), ("FR", "RR"))
    assert [shape.kind for part in robot.parts for shape in part.shapes] == ["cylinder"] * 4
    assert robot.wheel_radius == pytest.approx(0.1, rel=0.02)
    assert robot.origin_height == pytest.approx(0.1, rel=0.02)
    assert robot.mass == pytest.approx(14, abs=MASS_ATOL)


def test_square_collision_meshes_of_wheels_give_way_to_round_looks(load, tmp_path):
    (tmp_path / "tyre.stl").write_bytes((CASES / "wheel.stl").read_bytes())
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.02, 0.02) for z in (-0.1, 0.1)])
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    faces += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (tmp_path / "square.obj").write_text("\n".join(lines) + "\n")
    square = '<collision><geometry><mesh filename="square.obj"/></geometry></collision>'
    text = (CASES / "mesh_wheels.urdf").read_text()
    wheel = '<collision><geometry><mesh filename="wheel.stl"/></geometry></collision>'
    look = wheel.replace("collision", "visual").replace("wheel.stl", "tyre.stl")
    loaded = load(text.replace(wheel, square + look))
    assert [shape.kind for part in loaded.robot.parts for shape in part.shapes] == ["cylinder"] * 4
    assert loaded.robot.wheel_radius == pytest.approx(0.1, rel=0.02)
    assert "not round: its round <visual> collides instead" in loaded.notes[0]


def test_speeds_of_a_file_win():
    robot = load_robot(CASES / "fast_wheels.xml").robot
    assert [part.motor.max_speed for part in robot.parts] == [24.0, 24.0]
    assert robot.drive.max_spin == 24.0
    assert robot.chassis[1].surface == "caster"


def test_meshes_of_packages_are_found_above_and_in_named_folders(load, tmp_path, monkeypatch):
    near = CASES / "pack_description" / "urdf" / "mesh_of_a_package.urdf"
    hull = load_robot(near).robot.chassis[0]
    assert (hull.kind, np.ptp(hull.mesh.vertices, 0)) == ("mesh", pytest.approx([0.2, 0.2, 0.2]))
    text = near.read_text()
    with pytest.raises(SpecError, match=r"robot.urdf:2: mesh 'package://pack_desc.*--packages DIR"):
        load(text)
    assert load(text, packages=[CASES]).robot.chassis[0] == hull
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(CASES.parent))
    assert load(text).robot.chassis[0] == hull


def test_limits_of_effort_and_speed_reach_the_motors(load):
    loaded = load(cart(limit='<limit effort="3" velocity="12"/>'))
    assert [(p.motor.torque, p.motor.max_speed) for p in loaded.robot.parts] == [(3.0, 12.0)] * 2
    assert loaded.robot.drive.max_spin == 12.0
    assert loaded.robot.max_torque == 3.0
    assert loaded.notes == ()


def test_wheels_roll_ahead_whichever_way_their_axes_point(load):
    robot = load(cart(axis="0 -1 0")).robot
    assert [part.axis for part in robot.parts] == [(0.0, -1.0, 0.0)] * 2


def test_an_axis_left_out_is_x_as_mujoco_has_it(load, tmp_path):
    text = cart(WHEEL.format("arm") + hinge("swing", "arm", "0 0 .2").replace('<axis xyz="0 1 0"/>', ""))
    robot = load(text).robot
    assert robot.parts[-1].axis == (1.0, 0.0, 0.0)
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.urdf"))
    assert theirs.joint("swing").axis.tolist() == [1.0, 0.0, 0.0]
    compare(tmp_path / "robot.urdf", robot)


def test_unbalanced_inertias_are_mended_with_a_warning(load):
    loaded = load(cart().replace('izz=".4"', 'izz=".9"'))
    (note,) = loaded.notes
    assert "robot.urdf:1: link 'base': no body has the moments of inertia 0.2, 0.3, 0.9" in note
    assert composed(loaded.robot).body("chassis").inertia == pytest.approx((0.2, 0.3, 0.5))


def test_joints_follow_the_ones_they_mimic(load):
    limit = '<limit lower="-1" upper="1" effort="2" velocity="1"/>'
    mimic = '<mimic joint="one" multiplier="-.5" offset=".1"/>'
    more = (
        WHEEL.format("f1")
        + WHEEL.format("f2")
        + hinge("one", "f1", ".3 0 0", kind="revolute", more=limit)
        + hinge("two", "f2", ".3 .1 0", kind="revolute", more=limit + mimic)
    )
    robot = load(cart(more)).robot
    one, two = robot.parts[2:]
    assert (one.motor.torque, two.motor) == (2.0, None)
    model = composed(robot)
    assert model.eq_data[0, :2] == pytest.approx((0.1, -0.5))
    with pytest.raises(SpecError, match="joint 'two' follows 'three', which is no joint that moves"):
        load(cart(more.replace('mimic joint="one"', 'mimic joint="three"')))


def test_xacro_files_are_expanded_without_ros(load, tmp_path):
    package = tmp_path / "cart_description"
    package.mkdir()
    (package / "wheel.xacro").write_text(
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="wheel" params="name y">'
        + WHEEL.format("${name}")
        + hinge("${name}_joint", "${name}", "0 ${y * 0.5} 0")
        + "</xacro:macro></robot>"
    )
    text = (
        '<robot name="cart" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="half" default=".5"/>'
        '<xacro:include filename="$(find cart_description)/wheel.xacro"/>'
        f'{BASE}<xacro:wheel name="wl" y="$(arg half)"/><xacro:wheel name="wr" y="-$(arg half)"/></robot>'
    )
    robot = load(text, "cart.urdf.xacro").robot
    assert robot.wheel_separation == pytest.approx(0.5)
    wide = load(text, "cart.urdf.xacro", arguments={"half": "0.8"}).robot
    assert wide.wheel_separation == pytest.approx(0.8)
    with pytest.raises(
        SpecError, match=r"no folder 'lost' is above it, in --packages, or in ROS_PACKAGE_PATH"
    ):
        load(text.replace("find cart_description", "find lost"), "cart.urdf.xacro")


COLLADA = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="0.01" name="centimetre"/><up_axis>Z_UP</up_axis></asset><library_geometries>
<geometry id="g"><mesh><source id="p"><float_array id="a" count="24">
-10 -10 -10 10 -10 -10 10 10 -10 -10 10 -10 -10 -10 10 10 -10 10 10 10 10 -10 10 10</float_array>
<technique_common><accessor source="#a" count="8" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="12">
<input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 3 2 4 5 6 4 6 7 0 1 5 0 5 4 1 2 6 1 6 5 2 3 7
2 7 6 3 0 4 3 4 7</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s">
<node><translate>100 0 0</translate><instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def test_collada_meshes_have_their_unit_and_place(load, tmp_path):
    (tmp_path / "box.dae").write_text(COLLADA)
    text = cart().replace('<box size=".6 .4 .1"/>', '<mesh filename="box.dae" scale="1 2 1"/>')
    robot = load(text).robot
    hull = robot.chassis[0]
    assert np.sort(np.ptp(hull.mesh.vertices, 0)) == pytest.approx([0.2, 0.2, 0.4])
    # From the box, 1 m ahead, to the wheels' rear; the box is 0.4 m wide, less than the wheels.
    assert robot.dimensions == pytest.approx((1.2, 0.55, 0.3), abs=1e-6)
    model = composed(robot)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert data.geom("chassis/0").xpos == pytest.approx((1.0, 0.0, 0.1), abs=1e-6)


@pytest.mark.parametrize("kind", ["ply", "glb"])
def test_meshes_of_scanners_and_web_pages_are_read(load, tmp_path, kind):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((0.2, 0.3, 0.4)).export(tmp_path / f"box.{kind}")
    text = cart().replace('<box size=".6 .4 .1"/>', f'<mesh filename="box.{kind}"/>')
    hull = load(text).robot.chassis[0]
    assert np.ptp(hull.mesh.vertices, 0) == pytest.approx([0.2, 0.3, 0.4])
    (tmp_path / f"box.{kind}").write_bytes((tmp_path / f"box.{kind}").read_bytes()[5:])
    with pytest.raises(SpecError, match=rf"box.{kind}: does not read as a mesh: it is no "):
        load(text)


def test_collada_is_a_solid_of_arenas_too(tmp_path):
    (tmp_path / "box.dae").write_text(COLLADA)
    (tmp_path / "a.yaml").write_text("meshes: {file: box.dae}\nstarts: []\n")
    (box,) = load_arena(tmp_path / "a.yaml").shapes
    assert np.ptp(box.mesh.vertices, 0) == pytest.approx([0.2, 0.2, 0.2])
    assert box.at + box.mesh.vertices.mean(0) == pytest.approx([1.0, 0.0, 0.0])


PLUGINS = """<gazebo reference="base"><mu1>0.05</mu1><kp>1e6</kp>
<sensor type="gpu_ray" name="front laser"><pose>.3 0 .2 0 0 0</pose><update_rate>20</update_rate>
<ray><scan><horizontal><samples>181</samples><min_angle>-1.5707963</min_angle><max_angle>1.5707963</max_angle>
</horizontal></scan><range><min>.2</min><max>8</max></range></ray></sensor>
<sensor type="camera" name="cam"><camera><horizontal_fov>1.2</horizontal_fov></camera></sensor>
<sensor type="imu" name="imu"/><sensor type="thermometer" name="hot"/></gazebo>
<gazebo><plugin name="drive" filename="libgazebo_ros_diff_drive.so"><leftJoint>L</leftJoint>
<rightJoint>R</rightJoint><wheelSeparation>.5</wheelSeparation><wheelDiameter>.2</wheelDiameter></plugin>
<plugin name="other" filename="libother.so"/></gazebo>"""


def test_gazebo_plugins_become_drive_and_mounts(load):
    loaded = load(cart(PLUGINS))
    robot = loaded.robot
    assert (robot.drive.left, robot.drive.right, robot.drive.radius) == (("L",), ("R",), 0.1)
    scanner, imu = robot.sensors[:2]
    assert (scanner.kind, scanner.name, scanner.at) == ("RangeScanner", "front_laser", (0.3, 0.0, -0.2))
    options = dict(scanner.options)
    assert (options["MinRange"], options["MaxRange"], options["ScanInterval"]) == (0.2, 8.0, 0.05)
    assert options["ScanFov"] / options["Resolution"] == pytest.approx(180)
    assert imu.kind == "IMU"
    assert dict(robot.cameras[0].options)["CameraDefFov"] == 1.2
    said = "\n".join(loaded.notes)
    for words in (
        "'hot' of type 'thermometer' is left out",
        "plugin other (libother.so) is left out",
        ": kp",
    ):
        assert words in said
    assert "robot.urdf:" in loaded.notes[0]
    assert robot.chassis[0].surface == "caster"


KNUCKLE = """<link name="{}"><inertial><mass value=".2"/>
  <inertia ixx=".001" iyy=".001" izz=".001" ixy="0" ixz="0" iyz="0"/></inertial></link>"""


def steered(side, y, kind="revolute", turn=""):
    """A wheel on a knuckle; with `turn`, the knuckle's frame lies on its side and its axis is x there."""
    limit = '<limit lower="-.5" upper=".5" effort="4" velocity="2"/>'
    steer = hinge(
        f"steer{side}", f"k{side}", f".4 {y} 0", "-1 0 0" if turn else "0 0 1", kind=kind, more=limit
    )
    wheel = hinge(f"F{side}", f"f{side}", "0 0 0", parent=f"k{side}")
    if turn:
        steer = steer.replace("<origin", '<origin rpy="0 1.5707963 0"')
        wheel = wheel.replace("<origin", '<origin rpy="0 -1.5707963 0"')
    return f"{KNUCKLE.format('k' + side)}{WHEEL.format('f' + side)}{steer}{wheel}"


@pytest.mark.parametrize(("kind", "turn"), [("revolute", ""), ("revolute", "side"), ("continuous", "")])
def test_wheels_on_steering_joints_make_a_car(load, kind, turn):
    loaded = load(cart(steered("l", 0.25, turn=turn) + steered("r", -0.25, kind, turn)))
    assert any("joint 'steerr' is continuous and has limits" in note for note in loaded.notes) == (
        kind == "continuous"
    )
    drive = loaded.robot.drive
    assert isinstance(drive, Ackermann)
    assert drive.max_front_steer == 0.5
    assert {wheel.joint: wheel.steer for wheel in drive.wheels} == {
        "L": "",
        "R": "",
        "Fl": "steerl",
        "Fr": "steerr",
    }


def test_steered_wheels_of_one_axle_skid(load):
    wheels = steered("l", 0.25) + steered("r", -0.25)
    drive = load(f'<robot name="swerve">{BASE}{wheels}</robot>').robot.drive
    assert isinstance(drive, SkidSteer)
    assert (drive.left, drive.right) == (("Fl",), ("Fr",))


def test_motors_that_bear_legs_are_no_wheels_and_wheels_with_rollers_are(load):
    knees = "".join(
        KNUCKLE.format(f"s{side}") + hinge(f"K{side}", f"s{side}", "0 0 -.1", axis, parent=f"w{side}")
        for side, axis in (("l", "{0}"), ("r", "{0}"))
    )
    assert load(cart(knees.format("0 1 0"))).robot.drive == NoDrive()
    assert isinstance(load(cart(knees.format("1 0 .5"))).robot.drive, SkidSteer)


def c_shape(path):
    """Write a C of 0.3 x 0.3 x 0.1 m, whose gap of 0.1 m opens to the head."""
    outline = [(0, -0.15), (0.3, -0.15), (0.3, -0.05), (0.1, -0.05), (0.1, 0.05), (0.3, 0.05), (0.3, 0.15)]
    corners = [(x, y, z) for z in (0, 0.1) for x, y in [*outline, (0, 0.15)]]
    cap = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 7), (4, 5, 6), (4, 6, 7)]
    faces = [face[::-1] for face in cap] + [tuple(i + 8 for i in face) for face in cap]
    for i in range(8):
        j = (i + 1) % 8
        faces += [(i, j, j + 8), (i, j + 8, i + 8)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")


def touched_in_gap(robot, radius):
    """Return whether a ball in the middle of the C's gap touches it."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=[0.2, 0, 0.05])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data.ncon > 0


def test_coacd_leaves_the_gap_of_a_concave_mesh_free(load, tmp_path, monkeypatch):
    pytest.importorskip("coacd")
    c_shape(tmp_path / "c.obj")
    text = """<robot name="c"><link name="base"><inertial><mass value="2"/>
      <inertia ixx=".02" iyy=".03" izz=".04" ixy="0" ixz="0" iyz="0"/></inertial>
      <collision><geometry><mesh filename="c.obj"/></geometry></collision></link></robot>"""
    assert touched_in_gap(load(text).robot, 0.01)
    robot = load(text, pieces=8).robot
    assert [shape.kind for shape in robot.chassis] == ["mesh"] * 3
    assert not touched_in_gap(robot, 0.049)  # the gap has 0.05 m on both sides
    assert touched_in_gap(robot, 0.051)
    assert robot.mass == pytest.approx(2, abs=MASS_ATOL)
    assert robot.dimensions == pytest.approx((0.3, 0.3, 0.1), abs=1e-4)  # coacd's pieces are off by less
    monkeypatch.setenv("USARMJX_MESH_PIECES", "0")
    with pytest.raises(UsageError, match="'0', expected a whole number from 1 to 64"):
        load(text)


def test_driven_wheels_without_friction_grip(load):
    ice = '<gazebo reference="wl"><mu1>0</mu1><mu2>0</mu2></gazebo>'
    loaded = load(cart(ice))
    assert [shape.surface for part in loaded.robot.parts for shape in part.shapes] == ["wheel"] * 2
    assert "driven wheels L have no friction: here they grip" in loaded.notes[-1]


def test_rotors_on_sites_make_it_fly(load):
    rotors = "".join(
        f'<site name="s{i}" pos="{x} {y} 0"/>'
        for i, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    )
    motors = "".join(f'<motor site="s{i}" gear="0 0 1 0 0 .1" ctrlrange="0 6"/>' for i in range(4))
    text = (
        f'<mujoco><worldbody><body name="q"><freejoint/><geom type="box" size=".2 .2 .05" mass="1"/>{rotors}'
        f"</body></worldbody><actuator>{motors}</actuator></mujoco>"
    )
    drive = load(text, "quad.xml").robot.drive
    assert isinstance(drive, RotaryWing)
    assert (drive.mass, drive.max_thrust) == (pytest.approx(1.0), pytest.approx(24.0))


def test_cameras_and_sensors_of_mjcf_are_mounts_and_the_rest_is_named_with_its_line(load, tmp_path):
    loaded = load(
        """<mujoco><worldbody><light name="sun"/>
<body name="q"><freejoint/><geom type="box" size=".2 .2 .05" mass="1"/>
<site name="a-b" pos=".1 0 0"/><site name="a_b"/><site name="tip"/>
<body pos="0 0 .3"><geom size=".1" mass="1"/><camera name="mast" fovy="45"/></body></body></worldbody>
<sensor><gyro site="a-b"/><accelerometer site="a-b"/><gyro site="a_b"/>
<touch site="a_b" name="feel"/></sensor>
<keyframe><key name="up"/></keyframe></mujoco>""",
        "mast.xml",
    )
    robot, file = loaded.robot, tmp_path / "mast.xml"
    (camera,) = robot.cameras
    assert (camera.name, camera.parent, camera.at) == ("mast", CHASSIS, (0.0, 0.0, -0.3))
    imus = [(one.name, one.at) for one in robot.sensors if one.kind == "IMU"]
    assert imus == [("a_b", (0.1, 0.0, 0.0)), ("a_b2", (0.0, 0.0, 0.0))]
    assert loaded.notes == (
        f"{file}:6: 1 sensors are left out: feel",
        f"{file}:3: 1 sites are left out: tip",
        f"{file}: 1 keyframes are left out: up",
        f"{file}:1: 1 lights are left out: sun",
    )


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<robot name='r'>", r"robot.urdf:1: is no XML"),
        ("<robot name='r'/>", "no link is the root"),
        (
            cart().replace('child link="wr"', 'child link="wl"'),
            "robot.urdf:.*'R': link 'wl' hangs on 'L' too",
        ),
        (
            cart().replace('child link="wr"', 'child link="x"'),
            "its child 'x' is no link; known: base, wl, wr",
        ),
        (
            cart().replace('type="continuous"', 'type="rolling"'),
            "'L' has the type 'rolling'; known: revolute",
        ),
        (cart().replace('axis xyz="0 1 0"', 'axis xyz="0 0 0"'), "'L' has an axis of length 0"),
        (cart().replace('radius=".1"', 'radius="-1"'), "expected lengths above zero"),
        (cart().replace("<box", "<torus"), "a solid is a <torus>; allowed: box"),
        (cart().replace('mass value="10"', 'mass value="nan"'), "expected a number"),
    ],
)
def test_faults_are_refused_with_file_and_line(load, text, says):
    with pytest.raises(SpecError, match=says):
        load(text)


def test_files_that_only_some_readers_take_are_mended(load):
    """Commas, too many numbers, friction in an attribute, arguments without a macro, a blank line first."""
    text = cart(
        '<gazebo reference="base"><mu1 value="0.01"/></gazebo><link name="mast"/>'
        '<joint name="m" type="fixed"><parent link="base"/><child link="mast"/>'
        '<origin xyz="$(optenv MAST 0 0 1)" rpy="0, 0, 0 0"/></joint>'
    )
    loaded = load(text)
    assert loaded.robot.chassis[0].surface == "caster"
    assert [note.partition(": <")[2] for note in loaded.notes] == ["origin rpy> has commas: 0 0 0 counts"]
    plain = load('\n<?xml version="1.0"?>\n' + text.replace("$(optenv MAST 0 0 1)", "0 0 1 7"))
    assert "robot.urdf:11: <origin xyz> has 4 numbers: 0 0 1 counts" in plain.notes[0]


def test_a_heavy_robot_drives_as_fast_as_its_wheels(load):
    """The gains of a motor fit the robot that it moves, not the wheel alone: 120 kg on light wheels."""
    from tests.arenas import FLAT
    from usarmjx.sim.trials import Trial

    light = (
        WHEEL.replace('mass value="1"', 'mass value=".3"').replace(".003", ".0006").replace(".005", ".001")
    )
    heavy = BASE.replace('mass value="10"', 'mass value="120"')
    rear = WHEEL.format("cl") + WHEEL.format("cr")
    text = cart(rear + hinge("RL", "cl", "-.2 .25 0") + hinge("RR", "cr", "-.2 -.25 0"))
    text = text.replace(WHEEL.format("wl"), light.format("wl")).replace(
        WHEEL.format("wr"), light.format("wr")
    )
    robot = load(text.replace(BASE, heavy)).robot
    trial = Trial(FLAT, robot, 0.5)
    trial.advance(0.5)
    trial.command(1.0, 0.0)
    trial.advance(2.0)
    start = trial.pose()[0][0]
    trial.advance(1.0)
    assert trial.pose()[0][0] - start == pytest.approx(0.5 * robot.drive.top_speed, rel=0.02)


def test_links_without_mass_leave_the_robot_its_own(load):
    """MuJoCo needs a mass for what moves: together a ten-millionth of the robot's."""
    text = cart().replace('<mass value="10"/>', '<mass value="0"/>')
    loaded = load(text)
    assert loaded.robot.mass == pytest.approx(2, rel=1e-6)
    said = (
        "no link that is fixed to the root 'base' has a mass: it gets its part of 1e-07 of the robot's mass"
    )
    assert said in loaded.notes[0]
    loaded = load(text.replace('<mass value="1"/>', '<mass value="0"/>', 1))
    assert loaded.robot.mass == pytest.approx(1, rel=1e-6)
    assert "link 'wl' has a joint and no mass: it gets its part of 1e-07" in "".join(loaded.notes)


def test_legs_and_casters_and_springs_are_no_driven_wheels(load):
    """Joints that turn without end: hips high above the ground, wheels of casters; a slide under a wheel."""
    legs = cart().replace('xyz="0 .25 0"', 'xyz="0 .25 .5"').replace('xyz="0 -.25 0"', 'xyz="0 -.25 .5"')
    assert isinstance(load(legs).robot.drive, NoDrive)
    wheel = WHEEL.replace('radius=".1"', 'radius=".04"')
    moments = '<inertia ixx=".001" iyy=".001" izz=".001" ixy="0" ixz="0" iyz="0"/>'
    light = f'<inertial><mass value=".2"/>{moments}</inertial>'
    casters = "".join(
        f'<link name="f{y}">{light}</link>{wheel.format(f"c{y}")}'
        + hinge(f"fork{y}", f"f{y}", f"-.2 {y} 0", "0 0 1")
        + hinge(f"roll{y}", f"c{y}", "0 0 -.06", parent=f"f{y}")
        for y in (0.15, -0.15)
    )
    drive = load(cart(casters)).robot.drive
    assert (drive.left, drive.right, drive.radius) == (("L",), ("R",), 0.1)
    springs = "".join(
        f'<link name="s{y}">{light}</link>{WHEEL.format(f"w{y}")}'
        + hinge(f"spring{y}", f"s{y}", f".2 {y} 0", "0 0 1", kind="prismatic",
                more='<limit lower="-.01" upper=".01" effort="1" velocity="1"/>')
        + hinge(f"drive{y}", f"w{y}", "0 0 0", parent=f"s{y}")
        for y in (0.25, -0.25)
    )  # fmt: skip
    drive = load(cart(springs)).robot.drive
    assert isinstance(drive, SkidSteer)
    assert (len(drive.left), len(drive.right)) == (2, 2)


def test_long_chains_of_links_are_no_recursion(load):
    joints = "".join(hinge(f"j{i}", f"l{i + 1}", "0 0 1", parent=f"l{i}", kind="fixed") for i in range(3000))
    links = "".join(f'<link name="l{i}"/>' for i in range(3001))
    with pytest.raises(SpecError, match=r"robot.urdf:1: link 'l201' hangs on a chain of 201 joints"):
        load(f'<robot name="chain">{links}{joints}</robot>')


def test_a_missing_library_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "collada", None)
    said, _ = reader_child.answer(json.dumps(["mesh", "box.dae"]).encode())
    assert said == {"error": "collada is not installed", "extra": "robots"}
    monkeypatch.setattr(reader_process._READER, "_ask", lambda request: (said, b""))
    with pytest.raises(ArenaFileError, match=r"collada is not installed: pip install .*\[robots\]"):
        reader_process.read_mesh_objects(Path("box.dae"))


def test_what_does_not_drive_stands(load):
    robot = load(f'<robot name="stone">{BASE}</robot>').robot
    assert isinstance(robot.drive, NoDrive)
    assert robot.mass == pytest.approx(10)


LEG = """<link name="{0}thigh">{1}</link><link name="{0}shank">{1}<collision>
  <origin rpy="1.5707963 0 0"/><geometry><cylinder radius=".05" length=".04"/></geometry></collision>
  <collision><origin xyz="0 0 -.3"/><geometry><sphere radius=".02"/></geometry></collision></link>"""
LIMB = """<inertial><origin xyz="0 0 -.15"/><mass value=".5"/>
  <inertia ixx=".004" iyy=".004" izz=".0002" ixy="0" ixz="0" iyz="0"/></inertial>"""
WIDE = '<limit lower="-9" upper="9" effort="60" velocity="10"/>'


def walker(limit=WIDE, kind="revolute"):
    legs = "".join(
        LEG.format(name, LIMB)
        + hinge(f"{name}hip", f"{name}thigh", f"{x} {y} .05", kind=kind, more=limit)
        + hinge(
            f"{name}knee", f"{name}shank", ".05 0 -.3", parent=f"{name}thigh", kind="revolute", more=limit
        )
        for name, x, y in (("a", 0.25, 0.2), ("b", 0.25, -0.2), ("c", -0.3, 0.2), ("d", -0.3, -0.2))
    )
    return f'<robot name="walker">{BASE}{legs}</robot>'


def test_legs_hold_their_robot_by_the_files_motors(load):
    """Joints with two limits have motors however far these are apart; gains fit what stands on the legs."""
    robot = load(walker()).robot
    assert isinstance(robot.drive, NoDrive)
    assert not robot.wheels, "a knee's drum is no wheel, though the foot below it reaches the ground"
    assert [part.motor.torque for part in robot.parts] == [60.0] * 8
    assert settling_distance(robot) < 0.005
    # A quarter of 14 kg stands on each leg, 0.3 m and 0.6 m below its joints and 0.05 m before the hip.
    knee, hip = robot.parts[1].motor, robot.parts[0].motor
    share = 14 / 4
    assert knee.stiffness / 667 == pytest.approx(share * 0.32**2, rel=0.2), "and what the leg itself weighs"
    assert hip.stiffness / 667 == pytest.approx(share * (0.62**2 + 0.05**2), rel=0.2)


def test_a_chassis_that_reaches_the_ground_beside_its_wheels_slides(load):
    """A hull between the wheels that is as low as they are would hold the robot."""
    from tests.arenas import FLAT
    from usarmjx.sim.trials import Trial

    loaded = load(cart().replace('xyz="0 0 .1"/><geometry><box', 'xyz="0 0 -.05"/><geometry><box'))
    assert loaded.robot.chassis[0].surface == "caster"
    assert "1 of the chassis' solids that are not round reach the ground beside its" in loaded.notes[-1]
    higher = load(cart().replace('xyz="0 0 .1"/><geometry><box', 'xyz="0 0 -.045"/><geometry><box'))
    assert higher.robot.chassis[0].surface == "hull", "5 mm above the ground"
    trial = Trial(FLAT, loaded.robot, 0.5)
    trial.advance(0.5)
    trial.command(1.0, 0.0)
    trial.advance(2.0)
    start = trial.pose()[0][0]
    trial.advance(1.0)
    assert trial.pose()[0][0] - start == pytest.approx(0.5 * loaded.robot.drive.top_speed, rel=0.02)


def test_a_robot_with_an_arm_stays_where_it_is_put(load):
    """Motors hold their joints before the first command: an arm does not sink and push its robot about."""
    rear = WHEEL.format("cl") + WHEEL.format("cr")
    heavy = LIMB.replace("0 0 -.15", "-.3 0 0").replace('value=".5"', 'value="3"')
    limit = '<limit lower="-2" upper="2" effort="30" velocity="2"/>'
    arm = f'<link name="arm">{heavy}</link>' + hinge(
        "shoulder", "arm", ".1 0 .3", kind="revolute", more=limit
    )
    more = rear + hinge("RL", "cl", "-.2 .25 0") + hinge("RR", "cr", "-.2 -.25 0") + arm
    assert settling_distance(load(cart(more)).robot) < 0.005
    assert settling_distance(load(cart(more).replace(limit, "")).robot) > 0.005, "it falls without a motor"
