"""Robots from MJCF and URDF files, against C MuJoCo's own reading of the same files."""

import mujoco
import numpy as np
import pytest

from usarmjx.base.errors import SpecError
from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.drives import NoDrive, SkidSteer
from usarmjx.models.files.robot_file import load_robot, robot_from_mjcf
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import CHASSIS, Motor, Mount
from usarmjx.sensors.cameras.mounts import carried_weight

MASS_ATOL = 1e-6  # kg
POSE_ATOL = 1e-5  # m, and the elements of rotation matrices
INERTIA_RTOL = 1e-6  # of a mass matrix, to its largest element
POSES = 10

WHEEL = '<geom type="cylinder" size=".08 .02" euler="90 0 0" mass=".4"/>'
CAR = f"""
<mujoco>
  <asset><mesh name="nose" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="car" pos="1 2 .2" euler="0 0 30">
      <freejoint/>
      <geom type="box" size=".2 .12 .04" density="600"/>
      <geom type="mesh" mesh="nose" pos="0 0 .05"/>
      <body name="mast" pos="0 0 .1" euler="0 20 0">
        <geom type="capsule" size=".02 .1" mass=".2"/>
        <body name="head" pos=".1 0 .1" euler="10 90 5">
          <joint name="pan" axis="0 .6 .8" pos=".02 .01 0" range="-60 60" ref="10" damping=".1"/>
          <geom type="ellipsoid" size=".05 .03 .02" mass=".1"/>
          <geom type="sphere" size=".1" mass=".01" contype="0" conaffinity="0"/>
          <body name="lens" pos=".05 0 0">
            <joint name="zoom" type="slide" axis="1 0 0" stiffness="5" springref=".02" damping=".3"/>
            <geom type="sphere" size=".02" mass=".05"/>
          </body>
        </body>
      </body>
      <body pos=".15 .15 -.02"><joint name="LF" axis="0 1 0"/>{WHEEL}</body>
      <body pos=".15 -.15 -.02"><joint name="RF" axis="0 1 0"/>{WHEEL}</body>
      <body pos="-.15 .15 -.02"><joint name="LR" axis="0 1 0"/>{WHEEL}</body>
      <body pos="-.15 -.15 -.02"><joint name="RR" axis="0 1 0"/>{WHEEL}</body>
    </body>
  </worldbody>
  <actuator>
    <velocity joint="LF" kv="2" forcerange="-3 3" ctrlrange="-5 5"/>
    <intvelocity joint="RF" kp="40" kv="2" forcerange="-3 3" actrange="-99 99" ctrlrange="-8 8"/>
    <position joint="LR" kp="40" kv="2" forcerange="-1.5 1.5" gear="2"/>
    <motor joint="RR" gear="3" ctrlrange="-1 1"/>
    <position joint="pan" kp="20" kv="1"/>
  </actuator>
</mujoco>
"""
WHEELS = ("LF", "RF", "LR", "RR")
SKID = SkidSteer(left=("LF", "LR"), right=("RF", "RR"), max_spin=5.0, radius=0.08)


def link(name, mass, geometry, off="0 0 .1"):
    inertia = '<inertia ixx=".01" iyy=".01" izz=".003" ixy=".001" ixz="0" iyz="0"/>'
    return f"""
  <link name="{name}">
    <inertial><origin xyz="{off}"/><mass value="{mass}"/>{inertia}</inertial>
    <collision><origin xyz="{off}"/><geometry>{geometry}</geometry></collision>
  </link>"""


def hinge(name, parent, child, kind, place, axis):
    limit = '<limit lower="-1" upper="1.5" effort="5" velocity="2"/>'
    return f"""
  <joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
    <origin {place}/><axis xyz="{axis}"/>{limit}</joint>"""


ROD = '<cylinder radius=".03" length=".2"/>'
ARM = f"""<robot name="arm">
{link("base", 2, '<box size=".2 .2 .1"/>', "0 0 .05")}{link("upper", 1, ROD)}{link("lower", 0.8, ROD)}
{link("tool", 0.3, '<sphere radius=".03"/>', "0 0 0")}
{hinge("turret", "base", "upper", "revolute", 'xyz="0 0 .1" rpy="0 0 .3"', "0 0 1")}
{hinge("telescope", "upper", "lower", "prismatic", 'xyz="0 0 .2" rpy="1.2 .2 0"', "0 .6 .8")}
{hinge("grip", "lower", "tool", "fixed", 'xyz="0 0 .2"', "1 0 0")}
</robot>"""


@pytest.fixture
def write(tmp_path):
    def to_file(text, name="robot.xml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return to_file


def composed(robot):
    spec = new_spec(ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0))), Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    return spec.compile()


def original(path):
    """MuJoCo's own model of the file, whose first body is free."""
    spec = mujoco.MjSpec.from_file(str(path))
    root = spec.worldbody.first_body()
    if not root.joints:
        root.add_freejoint()
    return spec.compile()


def compare(path, robot):
    """Compare masses, and at random poses and joint positions the frames and the mass matrix."""
    theirs, ours = original(path), composed(robot)
    root = ours.body("chassis").id
    assert ours.body_subtreemass[root] == pytest.approx(theirs.body_subtreemass[1], abs=MASS_ATOL)
    assert robot.mass == pytest.approx(theirs.body_subtreemass[1], abs=MASS_ATOL)
    one, two = mujoco.MjData(theirs), mujoco.MjData(ours)
    names = [part.name for part in robot.parts]
    rng = np.random.default_rng(0)
    for _ in range(POSES):
        pose = np.r_[rng.normal(size=3), (turn := rng.normal(size=4)) / np.linalg.norm(turn)]
        one.qpos[:7] = two.qpos[:7] = pose
        for name in names:
            angle, there = rng.uniform(-1, 1), theirs.joint(name)
            one.qpos[there.qposadr[0]] = theirs.qpos0[there.qposadr[0]] + angle
            two.qpos[ours.joint(name).qposadr[0]] = angle
        for model, data in ((theirs, one), (ours, two)):
            mujoco.mj_forward(model, data)
        np.testing.assert_allclose(two.subtree_com[root], one.subtree_com[1], atol=POSE_ATOL)
        for name in names:
            i, j = theirs.joint(name).id, ours.joint(name).id
            np.testing.assert_allclose(two.xanchor[j], one.xanchor[i], atol=POSE_ATOL)
            np.testing.assert_allclose(two.xaxis[j], one.xaxis[i], atol=POSE_ATOL)
            body = theirs.jnt_bodyid[i]
            if i == theirs.body_jntadr[body] + theirs.body_jntnum[body] - 1:  # else its body turns further
                np.testing.assert_allclose(two.xmat[ours.jnt_bodyid[j]], one.xmat[body], atol=POSE_ATOL)
        # Inertias: kinetic energy at random velocities, without what our motors add.
        speed = rng.normal(size=theirs.nv)
        swapped = np.zeros(ours.nv)
        swapped[:6] = speed[:6]
        for name in names:
            swapped[ours.joint(name).dofadr[0]] = speed[theirs.joint(name).dofadr[0]]
        energies = []
        for model, data, v in ((theirs, one, speed), (ours, two, swapped)):
            momentum = np.zeros(model.nv)
            mujoco.mj_mulM(model, data, momentum, v)
            energies.append((v @ momentum - (model.dof_armature * v * v).sum()) / 2)
        assert energies[1] == pytest.approx(energies[0], rel=INERTIA_RTOL)


def test_a_car_has_its_files_masses_and_moves_as_c_mujoco_says(write):
    path = write(CAR)
    robot = robot_from_mjcf(path, name="Car", drive=SKID)
    compare(path, robot)
    assert [part.name for part in robot.parts] == ["pan", "zoom", *WHEELS]
    assert [part.parent for part in robot.parts] == [CHASSIS, "pan", *[CHASSIS] * 4]
    assert (robot.wheel_radius, robot.wheel_separation, robot.wheel_base) == (0.08, 0.3, 0.3)
    # Wheels hang 0.02 below the origin and have a radius of 0.08.
    assert robot.origin_height == pytest.approx(0.1, abs=1e-6)


def test_an_arm_from_urdf_has_its_files_masses_and_moves_as_c_mujoco_says(write):
    path = write(ARM, "arm.urdf")
    motor = Motor(max_speed=1.0, torque=5.0)
    robot = robot_from_mjcf(path, name="Arm", drive=NoDrive(), motors={"turret": motor}, payload=3.0)
    compare(path, robot)
    turret, telescope = robot.parts
    assert turret.motor == motor
    assert (telescope.motor.torque, telescope.motor.max_speed) == (5.0, 2.0), "the file's limits"
    assert (turret.joint, telescope.joint) == ("hinge", "slide")
    assert turret.limits == telescope.limits == (-1.0, 1.5)
    assert robot.payload == 3.0
    assert robot.mass == pytest.approx(2 + 1 + 0.8 + 0.3, abs=MASS_ATOL)


SEVERAL = """<mujoco><worldbody><body name="base" pos="0 0 1"><freejoint/><geom size=".2" mass="3"/>
<body name="shoulder" pos=".1 .2 0" euler="10 20 30">
<joint name="yaw" axis="0 0 1" pos=".01 .02 .03" ref="15"/><joint name="pitch" axis="0 .6 .8" range="-60 60"/>
<joint name="roll" axis="1 0 0" pos="0 0 -.1"/><geom type="capsule" size=".03 .1" mass=".6"/>
<body name="plate" pos="0 0 .2" euler="0 0 20"><geom type="box" size=".05 .05 .01" mass=".1"/>
<body name="wrist" pos="0 .05 .1" euler="40 0 0">
<joint name="out" type="slide" axis=".6 0 .8" range="-.1 .2"/><joint name="twist" axis="0 0 1" pos=".02 0 0"/>
<geom type="capsule" size=".02 .05" pos=".01 0 .05" mass=".2"/></body></body></body></body></worldbody>
<actuator><motor joint="pitch" ctrlrange="-1 1"/><position joint="out" kp="30" kv="2" forcerange="-9 9"/>
</actuator></mujoco>"""


def test_a_body_with_several_joints_is_a_chain_of_parts_that_moves_as_c_mujoco_says(write):
    path = write(SEVERAL)
    robot = load_robot(path, name="Several").robot
    compare(path, robot)
    _, pitch, _, out, _ = robot.parts
    assert [part.name for part in robot.parts] == ["yaw", "pitch", "roll", "out", "twist"]
    assert [part.parent for part in robot.parts] == [CHASSIS, "yaw", "pitch", "roll", "out"]
    assert [part.joint for part in robot.parts] == ["hinge"] * 3 + ["slide", "hinge"]
    assert [len(part.shapes) for part in robot.parts] == [0, 0, 2, 0, 1]
    assert pitch.limits == pytest.approx(np.radians((-60, 60)))
    assert out.limits == pytest.approx((-0.1, 0.2))
    assert [part.motor is not None for part in robot.parts] == [False, True, False, True, False]
    assert out.motor.torque == 9.0


def test_joints_of_one_body_swing_as_c_mujoco_says(write):
    """The same equations of motion: both models, without motors, fall alike for half a second."""
    path = write(SEVERAL.partition("<actuator>")[0] + "</mujoco>")
    robot = load_robot(path, name="Several").robot
    theirs, ours = original(path), composed(robot)
    one, two = mujoco.MjData(theirs), mujoco.MjData(ours)
    for model, data in ((theirs, one), (ours, two)):
        model.opt.timestep, model.opt.integrator = 0.001, mujoco.mjtIntegrator.mjINT_RK4
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        data.qvel[3:6] = 0.5, -0.4, 0.3
        data.joint("roll").qvel[0], data.joint("yaw").qvel[0] = 2.0, -1.0
        mujoco.mj_step(model, data, 500)
    for part in robot.parts:
        swung = one.joint(part.name).qpos[0] - theirs.qpos0[theirs.joint(part.name).qposadr[0]]
        assert two.joint(part.name).qpos[0] == pytest.approx(swung, abs=1e-4), part.name


def test_lags_of_actuators_are_left_out_and_named(write):
    lag = '<actuator><general name="a" joint="j" dyntype="filter" dynprm=".1" gainprm="40" {}/></actuator>'
    loaded = load_robot(write(free(J, lag.format('biastype="affine" biasprm="0 -40 0"'))), name="Lag")
    assert loaded.robot.parts[0].motor.stiffness == 40.0
    assert any("robot.xml:1: 1 lags of actuators are left out: a" in note for note in loaded.notes)
    pushed = load_robot(write(free(J, lag.format('biastype="affine" ctrlrange="-1 1"'))), name="Push")
    assert pushed.robot.parts[0].motor.torque == pytest.approx(40.0), "without a bias it is a motor"


def test_room_for_contacts_that_a_file_asks_for_is_not_taken(write):
    """The legacy keys of this one mean 3.4 GB."""
    text = free(J).replace("<mujoco>", '<mujoco><size njmax="8000" nconmax="4000"/>')
    assert load_robot(write(text), name="Rat").robot.parts


def test_a_chassis_without_mass_weighs_next_to_nothing(write):
    arm = '<body name="arm" pos="0 0 .1"><joint name="j"/><geom size=".1" mass="2"/></body>'
    text = f'<mujoco><worldbody><body name="base">{arm}</body></worldbody></mujoco>'
    loaded = load_robot(write(text), name="Arm")
    assert loaded.robot.mass == pytest.approx(2, rel=1e-6)
    assert "robot.xml:1: body 'base' has no mass: it gets its part of 1e-07" in loaded.notes[0]


def test_solids_stay_and_meshes_become_hulls(write):
    robot = robot_from_mjcf(write(CAR), name="Car", drive=SKID)
    box, nose, mast = robot.chassis
    assert (box.kind, box.size) == ("box", (0.2, 0.12, 0.04))
    assert (mast.kind, mast.size) == ("capsule", (0.02, 0.1))
    assert (nose.kind, nose.surface, len(nose.mesh.vertices)) == ("mesh", "hull", 4)
    assert robot.inertia.mass == pytest.approx(robot.mass - 4 * 0.4 - 0.1 - 0.01 - 0.05)
    wheel = robot.parts[2]
    assert [(shape.kind, shape.surface, shape.mass) for shape in wheel.shapes] == [("cylinder", "wheel", 0.4)]
    assert wheel.is_wheel
    head = robot.parts[0]
    assert [(shape.kind, shape.surface) for shape in head.shapes] == [
        ("ellipsoid", "hull"),
        ("sphere", "fixture"),
    ]


def test_solids_have_the_colour_in_which_mujoco_draws_them(write):
    """That of their material, unless they have one of their own."""
    colours = ("", 'material="m"', 'material="m" rgba="0 0 1 1"', 'material="m" rgba=".5 .5 .5 1"')
    geoms = [f'<geom size=".1" {colour}/>' for colour in colours]
    asset = (
        '<asset><material name="m" rgba="1 0 0 .5"/><mesh name="t" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>'
    )
    mesh = '<geom type="mesh" mesh="t" material="m"/>'
    text = f'<mujoco>{asset}<worldbody><body name="b">{mesh}{"".join(geoms)}</body></worldbody></mujoco>'
    path = write(text)
    model = mujoco.MjModel.from_xml_path(str(path))
    data, scene = mujoco.MjData(model), mujoco.MjvScene(model, len(geoms) + 1)
    mujoco.mj_forward(model, data)
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, scene)
    drawn = {geom.objid: geom.rgba.tolist() for geom in scene.geoms[: scene.ngeom]}
    shapes = load_robot(path, name="Ball").robot.chassis
    assert [shape.rgba for shape in shapes] == [tuple(drawn[i]) for i in range(model.ngeom)]
    assert len({shape.rgba for shape in shapes}) == 3


def test_actuators_become_motors_with_their_gains_and_limits(write):
    robot = robot_from_mjcf(write(CAR), name="Car", drive=SKID, max_speed=7.0)
    pan, zoom, front_left, front_right, rear_left, rear_right = robot.parts
    left, right = front_left.motor, front_right.motor
    assert (left.damping, left.torque, left.max_speed) == (2.0, 3.0, 5.0)
    assert (right.stiffness, right.damping, right.torque, right.max_speed) == (40.0, 2.0, 3.0, 8.0)
    # A gear multiplies force and, at the joint, gains twice.
    geared = rear_left.motor
    assert (geared.stiffness, geared.damping, geared.torque, geared.max_speed) == (160.0, 8.0, 3.0, 7.0)
    assert rear_right.motor.torque == pytest.approx(3.0), "gear times the largest control"
    assert pan.motor.damping == pytest.approx(1.0 + 0.1), "with the joint's own"
    assert pan.limits == pytest.approx(np.radians((-70.0, 50.0))), "from the pose shown, where it reads 10"
    # A spring at rest at 0.02 pulls with 5 x 0.02 N where the file shows it.
    assert (zoom.motor, zoom.spring.stiffness, zoom.spring.damping) == (None, 5.0, 0.3)
    assert zoom.spring.load == pytest.approx(-0.1)


def test_servos_are_stable_in_our_step(write):
    """Explicit gains must not turn a joint round within a step: kv dt / I below 1, kp dt2 / I well below."""
    robot = robot_from_mjcf(write(CAR), name="Car", drive=SKID)
    model, step = composed(robot), Physics().timestep
    for part in robot.parts:
        if part.motor is not None:
            inertia = 1 / model.dof_invweight0[model.joint(part.name).dofadr[0]]
            assert part.motor.damping * step / inertia < 0.51
            assert part.motor.stiffness * step**2 / inertia < 0.11


def test_an_imported_car_drives_and_looks_around(write, monkeypatch):
    from tests.rig import Rig, steady_speed

    sensors = (Mount(kind="INS", name="INS", parent="pan"),)
    wheels = dict.fromkeys(
        WHEELS, Motor(max_speed=5.0, torque=1.0, stiffness=40.0, damping=2.0, armature=0.03)
    )
    robot = robot_from_mjcf(write(CAR), name="Imported", drive=SKID, motors=wheels, sensors=sensors)
    monkeypatch.setattr(ROBOTS, "_entries", dict(ROBOTS._entries))
    ROBOTS.add("Imported", robot)
    assert carried_weight(robot) == 0.1, "an INS (manual 10.6)"
    rig = Rig("Imported").tell(Left=3.0, Right=3.0)
    rig.move({"pan": 0.5})
    assert steady_speed(rig) == pytest.approx(3.0 * 0.08, rel=0.05)
    assert rig.joint("pan") == pytest.approx(0.5, abs=0.02), "0.05 N m of weight on 20 N m/rad is 2.5 mrad"
    assert rig.up[0] > 0.999


def free(child, more=""):
    ball = '<geom size=".1"/>'
    return (
        f'<mujoco><worldbody><body name="b"><freejoint/>{ball}<body name="p">{child}{ball}</body></body>'
        f"</worldbody>{more}</mujoco>"
    )


J = '<joint name="j"/>'
MOTOR = '<motor name="{}" joint="j" ctrlrange="-1 1"/>'


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<mujoco", "does not read"),
        ("<mujoco/>", "no body under the world"),
        (
            free('<joint name="j" type="ball"/>'),
            "robot.xml:1: body 'p' has the joint j, which is of kind ball; parts have hinges and slides",
        ),
        (free('<joint name="root"/>'), "called root: rename"),
        (free('<joint name="j" axis="1e308 0 0"/>'), "robot.xml:1: joint 'j' has no axis"),
        (
            free("<joint/>").replace(' name="p"', ""),
            "robot.xml:1: a joint of body number 2 has no name",
        ),
        (free(f"<joint axis='1 0 0'/>{J}"), "body number 2 has no name: give it one"),
        (
            free(J, '<actuator><damper name="m" joint="j" kv="1" ctrlrange="0 1"/></actuator>'),
            "actuator m is of a kind",
        ),
        (free(J, '<actuator><motor name="a" joint="j"/></actuator>'), "a has no limit; give it a ctrlrange"),
        (free(J, f"<actuator>{MOTOR.format('a')}{MOTOR.format('c')}</actuator>"), "c is the second one of"),
    ],
)
def test_what_a_robot_cannot_have_is_refused_by_name(write, text, says):
    with pytest.raises(SpecError, match=says):
        robot_from_mjcf(write(text), name="Bad", drive=NoDrive())


def test_a_name_that_is_no_text_is_refused(tmp_path):
    text = free(J).replace('name="p"', 'name="p%"')
    (tmp_path / "robot.xml").write_bytes(text.encode().replace(b"%", b"\xe9"))
    with pytest.raises(SpecError, match="does not read: a name in it is no UTF-8"):
        robot_from_mjcf(tmp_path / "robot.xml", name="Bad", drive=NoDrive())


TENDON = (
    '<tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon><actuator>'
    '<motor name="pull" tendon="t" ctrlrange="-1 1"/></actuator>'
    '<sensor><tendonpos name="long" tendon="t"/></sensor>'
)
LOOP = '<equality><connect body1="p" body2="b" anchor="0 0 0" name="loop"/></equality>'
LEFT_OUT = [
    (
        f'<mujoco><worldbody><body name="b">{J}<geom size="1"/></body></worldbody>'
        f"<actuator>{MOTOR.format('a')}</actuator></mujoco>",
        (
            "joints between the world and the chassis, which is free, are left out: j",
            "1 actuators are left out: a",
        ),
    ),
    (
        free(J, TENDON),
        (
            "tendons or of joints that follow another are left out: pull",
            "sensors of tendons are left out: long",
            "1 tendons are left out: t",
        ),
    ),
    (
        free(J, '<equality><joint joint1="j" name="e"/></equality>'),
        ("(closed chains are open) are left out: e",),
    ),
    (free(J, LOOP), ("(closed chains are open) are left out: loop",)),
    (
        free(J).replace('<geom size=".1"/>', '<geom name="g" size=".1" friction=".3"/>', 1),
        ("solids' friction and contact parameters are left out: g",),
    ),
]


@pytest.mark.parametrize(("text", "says"), LEFT_OUT)
def test_what_has_no_place_is_left_out_and_named_with_its_line(write, text, says):
    loaded = load_robot(write(text), name="Rest")
    assert [part.motor for part in loaded.robot.parts] in ([], [None])
    for words in says:
        assert any(words in note and "robot.xml:1: " in note for note in loaded.notes), loaded.notes


def test_linear_couplings_of_joints_follow_their_leader(write):
    second = '<body name="q"><joint name="k"/><geom size=".1"/></body></body></worldbody>'
    coupling = '<equality><joint joint1="k" joint2="j" polycoef=".1 -2 0 0 0"/></equality>'
    path = write(free(J, coupling).replace("</body></worldbody>", second))
    robot = load_robot(path, name="Pair").robot
    assert (robot.parts[1].geared, robot.parts[1].gear_ratio, robot.parts[1].gear_offset) == ("j", -2.0, 0.1)
    ours, theirs = composed(robot), mujoco.MjModel.from_xml_path(str(path))
    assert ours.eq_data[0, :5] == pytest.approx(theirs.eq_data[0, :5])


def test_a_motor_for_a_joint_that_is_not_there_is_refused(write):
    with pytest.raises(SpecError, match="motors for elbow, but joints are turret, telescope"):
        robot_from_mjcf(
            write(ARM, "arm.urdf"),
            name="Arm",
            drive=NoDrive(),
            motors={"elbow": Motor(max_speed=1.0, torque=1.0)},
        )
