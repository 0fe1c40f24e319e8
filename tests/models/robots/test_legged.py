"""QRIO and ERS: as the manual has them, on their feet, and every joint in all three orders."""

import math
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.rig import Rig
from usarmjx.models.compile.kinematic_tree import servos_of
from usarmjx.models.compile.parts import joint_names
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import Shape
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.control import ControlMode

ROOT = Path(__file__).resolve().parents[3]
BOTH = pytest.mark.parametrize("name", ["ERS", "QRIO"])
SIZE_ATOL = 0.003  # m: the manual gives the ERS in millimetres, its data sheet 317 mm for 319
EXACT = 1e-6
DRIFT = 1e-3  # m in 60 s: measured 4e-6; a hundredth of the creep that would matter to a controller
SAG = 0.01  # rad: a third of a paw's load on a servo of 30 N m/rad makes 0.003
ARRIVED = 0.01  # rad: without load a servo has no error but the last step's
SPEED_RTOL = 0.03  # of a mean speed over 0.4 s: the servo's lag is the same at both ends
TORQUE_RTOL = 0.05
GRAVITY = 9.81

LEGS = ("LeftF", "RightF", "LeftR", "RightR")
SIDES = ("Left", "Right")
QRIO_LEG = ("HipYaw", "HipRoll", "HipPitch", "Knee", "AnklePitch", "AnkleRoll")
QRIO_ARM = ("ShoulderPitch", "ShoulderRoll", "Elbow")


def names_of(name):
    return joint_names(ROBOTS.get(name))


def floating(name):
    """A robot far from the ground, without weight: what its joints do, they do to each other."""
    rig = Rig(name, height=5.0)
    rig.model.opt.gravity[:] = 0.0
    return rig


def joints(rig):
    """Positions and velocities of all joints (joints,)."""
    index = rig.indices[0]
    return rig.data.qpos[list(index.qposadr)].copy(), rig.data.qvel[list(index.dofadr)].copy()


def limits(name):
    servos = servos_of(ROBOTS.get(name))
    return servos.low, servos.high


def farther(name):
    """The limit of each joint that is farther from where it stands."""
    low, high = limits(name)
    return np.where(high > -low, high, low)


def bounds(rig):
    """Lower and upper corner of all geoms' boxes [m]."""
    mujoco.mj_kinematics(rig.model, rig.data)
    mine = np.isin(rig.model.geom_bodyid, rig.indices[0].body_ids)
    mat = np.abs(rig.data.geom_xmat[mine].reshape(-1, 3, 3))
    sphere = rig.model.geom_type[mine] == mujoco.mjtGeom.mjGEOM_SPHERE
    half = np.where(sphere[:, None], rig.model.geom_size[mine][:, :1], rig.model.geom_size[mine])
    reach = np.where(sphere[:, None], half, np.einsum("gij,gj->gi", mat, half))
    pos = rig.data.geom_xpos[mine]
    return (pos - reach).min(0), (pos + reach).max(0)


def test_joints_are_those_that_the_manual_counts():
    ers = {f"{leg}{joint}" for leg in LEGS for joint in ("Rotator", "Elevator", "Knee")}
    assert set(names_of("ERS")) == ers | {"HeadTilt", "HeadPan", "HeadNod"}
    qrio = {f"{side}{joint}" for side in SIDES for joint in (*QRIO_LEG, *QRIO_ARM)}
    assert set(names_of("QRIO")) == qrio | {"HeadPan", "HeadTilt", "BodyPan", "BodyTilt"}


@pytest.mark.parametrize(("name", "mass"), [("ERS", 1.6), ("QRIO", 7.0)])
def test_size_and_mass_are_the_reported_ones(name, mass):
    rig = Rig(name)
    low, high = bounds(rig)
    assert high - low == pytest.approx(ROBOTS.get(name).dimensions, abs=SIZE_ATOL)
    assert rig.plan.mass == pytest.approx(mass, abs=EXACT)
    assert rig.plan.clearance == pytest.approx(rig.robot.origin_height, abs=EXACT)


@BOTH
def test_both_sides_mirror_each_other(name):
    """Every left joint at a pose and every right joint at the same: the bodies mirror each other."""
    rig = Rig(name)
    low, high = limits(name)
    for joint, lowest, highest in zip(names_of(name), low, high, strict=True):
        if not joint.endswith("Pan"):
            rig.data.joint(f"r0/{joint}").qpos = 0.3 * lowest + 0.4 * highest
    mujoco.mj_kinematics(rig.model, rig.data)
    lefts = [joint for joint in names_of(name) if joint.startswith("Left")]
    assert len(lefts) >= 6
    for left in lefts:
        geoms = [
            rig.data.geom_xpos[rig.model.geom_bodyid == rig.data.body(f"r0/{joint}").id]
            for joint in (left, left.replace("Left", "Right"))
        ]
        np.testing.assert_allclose(geoms[0], geoms[1] * (1, -1, 1), atol=EXACT)


@pytest.mark.parametrize(
    ("name", "joint", "part", "way"),
    [
        ("ERS", "LeftFRotator", "LeftFKnee", (1, 0, 0)),
        ("ERS", "RightRRotator", "RightRKnee", (1, 0, 0)),
        ("ERS", "LeftFElevator", "LeftFKnee", (0, 1, 0)),
        ("ERS", "RightRElevator", "RightRKnee", (0, -1, 0)),
        ("ERS", "LeftFKnee", "LeftFKnee", (1, 0, 0)),
        ("ERS", "RightRKnee", "RightRKnee", (-1, 0, 0)),
        ("QRIO", "LeftHipPitch", "LeftKnee", (1, 0, 0)),
        ("QRIO", "RightHipRoll", "RightKnee", (0, -1, 0)),
        ("QRIO", "LeftKnee", "LeftKnee", (-1, 0, 0)),
        ("QRIO", "LeftShoulderPitch", "LeftElbow", (1, 0, 0)),
        ("QRIO", "RightShoulderRoll", "RightElbow", (0, -1, 0)),
        ("QRIO", "LeftElbow", "LeftElbow", (1, 0, 0)),
    ],
)
def test_positive_joints_go_where_the_description_says(name, joint, part, way):
    """The mass of `part` moves `way` (x forward, y left, z up) when `joint` turns by 0.1 rad."""
    rig = Rig(name)
    mujoco.mj_kinematics(rig.model, rig.data)
    before = rig.data.body(f"r0/{part}").xipos.copy()
    rig.data.joint(f"r0/{joint}").qpos = 0.1
    mujoco.mj_kinematics(rig.model, rig.data)
    moved = rig.data.body(f"r0/{part}").xipos - before
    assert moved @ way > 0.8 * np.linalg.norm(moved) > 0.002


@pytest.mark.parametrize(
    ("name", "joint", "part", "ahead"),
    [
        ("ERS", "HeadTilt", "HeadNod", (0, 0, 1)),
        ("ERS", "HeadNod", "HeadNod", (0, 0, 1)),
        ("ERS", "HeadPan", "HeadNod", (0, 1, 0)),
        ("QRIO", "HeadTilt", "HeadTilt", (0, 0, 1)),
        ("QRIO", "HeadPan", "HeadTilt", (0, 1, 0)),
        ("QRIO", "BodyPan", "HeadTilt", (0, 1, 0)),
        ("QRIO", "BodyTilt", "HeadTilt", (0, 0, 1)),
        ("QRIO", "LeftHipYaw", "LeftAnkleRoll", (0, 1, 0)),
        ("QRIO", "RightHipYaw", "RightAnkleRoll", (0, -1, 0)),
        ("QRIO", "RightAnklePitch", "RightAnkleRoll", (0, 0, 1)),
    ],
)
def test_positive_heads_and_feet_look_where_the_description_says(name, joint, part, ahead):
    """What looked ahead looks a little to `ahead` (x forward, y left, z up), too."""
    rig = Rig(name)
    rig.data.joint(f"r0/{joint}").qpos = 0.1
    mujoco.mj_kinematics(rig.model, rig.data)
    assert rig.mat(part)[:, 0] @ ahead == pytest.approx(math.sin(0.1), abs=EXACT)


@pytest.mark.every_run("ERS")
@BOTH
def test_it_stands_for_a_minute_without_creeping(name):
    rig = Rig(name)
    rig.run(1.0)
    start = rig.data.qpos[:3].copy()
    log = rig.run(60.0)
    assert np.linalg.norm(log[:, :3] - start, axis=1).max() < DRIFT
    assert rig.up[0] > math.cos(math.radians(0.5))
    assert start[2] == pytest.approx(rig.robot.origin_height, abs=2e-3)
    assert np.abs(joints(rig)[0]).max() < SAG


@BOTH
def test_at_rest_only_its_feet_touch_the_ground(name):
    rig = Rig(name)
    rig.run(1.0)
    feet = {rig.model.body(rig.model.geom_bodyid[max(pair)]).name for pair in rig.data.contact.geom}
    soles = [f"{leg}Knee" for leg in LEGS] if name == "ERS" else [f"{side}AnkleRoll" for side in SIDES]
    assert feet == {f"r0/{sole}" for sole in soles}


def push(rig, impulse, way, seconds=0.1):
    """Push the chassis by an impulse [N s] in a direction [deg]; return how upright it stayed."""
    dof = rig.indices[0].root_dofadr
    force = impulse / seconds
    rig.data.qfrc_applied[dof : dof + 2] = (
        force * math.cos(math.radians(way)),
        force * math.sin(math.radians(way)),
    )
    rig.run(seconds)
    rig.data.qfrc_applied[:] = 0.0
    return min(rig.up[0] for _ in range(100) if rig.step() is None)


@pytest.mark.parametrize(("name", "impulse"), [("ERS", 1.0), ("QRIO", 3.0)])
@pytest.mark.parametrize("way", [0, 45, 90, 180])
def test_a_push_does_not_throw_it_over(name, impulse, way):
    """The ERS gets 0.6 m/s from it, and rocks by up to 8 degrees."""
    rig = Rig(name)
    rig.run(0.5)
    start = rig.data.qpos[:2].copy()
    assert push(rig, impulse, way) > math.cos(math.radians(12))
    rig.run(2.0)
    assert rig.up[0] > math.cos(math.radians(0.5))
    assert np.linalg.norm(rig.data.qpos[:2] - start) < 0.02
    assert np.abs(rig.data.qvel[:6]).max() < 1e-3


def test_a_hard_push_does_throw_it_over():
    rig = Rig("ERS")
    rig.run(0.5)
    push(rig, 3.0, 90)
    rig.run(2.0)
    assert rig.up[0] < 0.8


@BOTH
@pytest.mark.parametrize("share", [0.5, -0.5, 2.0, -2.0])
def test_all_joints_reach_positions_and_no_farther_than_their_limits(name, share):
    """Half of a limit is reached; twice the limit is clamped to it."""
    low, high = limits(name)
    goal = abs(share) * (high if share > 0 else low)
    rig = floating(name).move(dict(zip(names_of(name), goal, strict=True)))
    rig.run(3.0)
    q, v = joints(rig)
    np.testing.assert_allclose(q, np.clip(goal, low, high), atol=ARRIVED)
    assert np.abs(v).max() < 0.01


@BOTH
def test_all_joints_follow_velocities_and_stop_at_their_limits(name):
    """Each is told the speed that takes it to its farther limit in one second."""
    far = farther(name)
    assert (np.abs(far) < servos_of(ROBOTS.get(name)).speed).all()
    rig = floating(name).move(dict(zip(names_of(name), far, strict=True)), ControlMode.VELOCITY)
    rig.run(0.4)
    before, _ = joints(rig)
    rig.run(0.4)
    after, _ = joints(rig)
    np.testing.assert_allclose((after - before) / 0.4, far, rtol=SPEED_RTOL)
    rig.run(1.5)
    q, v = joints(rig)
    np.testing.assert_allclose(q, far, atol=ARRIVED)
    assert np.abs(v).max() < 0.01


@BOTH
def test_no_joint_is_faster_than_its_servo(name):
    """Oracle: the way to the farther limit at full speed takes this long at least."""
    speed, far = servos_of(ROBOTS.get(name)).speed, farther(name)
    rig = floating(name).move(dict(zip(names_of(name), 99.0 * far, strict=True)), ControlMode.VELOCITY)
    for _ in range(50):
        rig.step()
        q, _ = joints(rig)
        assert (np.abs(q) <= 1.02 * speed * rig.data.time + ARRIVED).all()
    np.testing.assert_allclose(q, far, atol=ARRIVED)


@BOTH
@pytest.mark.parametrize("share", [0.5, -0.5, 3.0, -3.0])
def test_all_joints_exert_the_torque_they_are_told(name, share):
    """Oracle: statics. An equal torque against it from outside holds every joint where it is, a tenth less
    or more lets it move forward or back; three times what a servo can is what it can."""
    low, high = limits(name)
    names, most = names_of(name), servos_of(ROBOTS.get(name)).torque
    exerted = np.clip(share, -1, 1) * most
    for balance, sense in ((1.0, 0), (0.9, 1), (1.1, -1)):
        rig = floating(name)
        rig.data.qpos[list(rig.indices[0].qposadr)] = middle = (low + high) / 2
        rig.move(dict(zip(names, share * most, strict=True)), ControlMode.TORQUE)
        rig.data.qfrc_applied[list(rig.indices[0].dofadr)] = -balance * exerted
        rig.run(0.04)
        moved = (joints(rig)[0] - middle) * np.sign(share)
        if sense:
            assert (moved * sense > 1e-4).all()
        else:
            dofs = list(rig.indices[0].dofadr)
            np.testing.assert_allclose(rig.data.qfrc_actuator[dofs], exerted, rtol=TORQUE_RTOL)
            assert np.abs(moved).max() < 1e-4


# What hangs on a joint: kilograms, metres forward (or outward) and up from its axis, at joint position 0.
HEAD_OF_ERS = ((0.04, 0.0, 0.04), (0.04, 0.0, 0.08), (0.20, 0.025, 0.089))
HEAD_OF_QRIO = ((0.60, 0.0, 0.0575),)
ARM_OF_QRIO = ((0.20, 0.0, -0.045), (0.20, 0.0, -0.145))


@pytest.mark.parametrize(
    ("name", "joint", "angle", "masses"),
    [
        ("ERS", "HeadTilt", -0.8, HEAD_OF_ERS),
        ("QRIO", "HeadTilt", -0.6, HEAD_OF_QRIO),
        ("QRIO", "LeftShoulderRoll", 1.0, ARM_OF_QRIO),
        ("QRIO", "RightShoulderRoll", 1.4, ARM_OF_QRIO),
        ("QRIO", "LeftShoulderPitch", 1.5, ARM_OF_QRIO),
    ],
)
def test_a_held_mass_takes_m_g_l_sin(name, joint, angle, masses):
    """Closed form of the torque that holds head or arm; told that torque, the joint goes on holding it."""
    levers = [(m, ahead * math.cos(angle) - up * math.sin(angle)) for m, ahead, up in masses]
    torque = GRAVITY * sum(m * lever for m, lever in levers)
    rig = Rig(name).move({joint: angle})
    rig.run(2.0)
    assert rig.data.joint(f"r0/{joint}").qfrc_actuator[0] == pytest.approx(torque, rel=TORQUE_RTOL)
    held = rig.joint(joint)
    rig.move({joint: torque}, ControlMode.TORQUE).run(0.5)
    assert rig.joint(joint) == pytest.approx(held, abs=0.05)
    rig.move({joint: 0.0}, ControlMode.TORQUE).run(0.5)
    assert (rig.joint(joint) - held) * torque < -0.05 * abs(torque), "without torque it sinks"


def test_ers_feels_its_paws_and_sees_a_wall_ahead():
    """Near and far infrared measure to the wall's face, within their noise of 5 % (manual 10.2.2)."""
    face = 1.0
    wall = Shape(kind="box", size=(0.05, 2.0, 0.5), at=(face + 0.05, 0.0, 0.5), surface="wall")
    arena = ArenaSpec(name="wall", starts=(), extent=((-2, 2), (-2, 2)), shapes=(wall,))
    world = DynamicWorld(arena, Physics(), 0, max_robots=1)
    robot = world.spawn(ROBOTS.get("ERS"), "It", (0.0, 0.0, 0.2), (0.0, 0.0, 0.0))

    def read(**positions):
        target = robot.command.target.copy()
        for joint, position in positions.items():
            target[robot.plan.joint_index(joint)] = position
        world.set_command(robot, robot.command.replace(target=target))
        for _ in range(50):
            world.step()
        world.observe([robot])
        readings = [
            robot.pending[robot.suite.find(*item)] for item in (("Touch", "PawLeftF"), ("IR", "IRNear"))
        ]
        return [reading.tolist() for reading in readings]

    paws, (near, far) = read()
    assert paws == [1.0, 1.0, 1.0, 1.0]
    assert near == pytest.approx(0.50), "nothing within its range"
    assert far == pytest.approx(face - 0.0675 - 0.081, rel=0.06)
    assert read(LeftRKnee=0.8, LeftRRotator=0.4)[0] == [1.0, 1.0, 0.0, 1.0]
    assert read(LeftRKnee=0.0, LeftRRotator=0.0)[0] == [1.0, 1.0, 1.0, 1.0]


JAX = """
from tests.arenas import FLAT
from usarmjx.engines import make_engine
from usarmjx.sim.scene import build_scene
scene = build_scene(FLAT, ["ERS", "QRIO", "P2AT", "P2DX"])
print(make_engine("jax", scene.spec, scene.physics, 1).name)
"""


@pytest.mark.thorough
def test_the_jax_engine_takes_both_beside_wheeled_robots():
    """It refuses pairs such as a wheel and a round paw that could touch each other."""
    done = subprocess.run([sys.executable, "-c", JAX], capture_output=True, text=True, timeout=300, cwd=ROOT)
    assert done.stdout == "jax\n", done.stderr
