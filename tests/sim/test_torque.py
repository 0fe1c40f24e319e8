"""Torque orders: exact as long as a joint is slow, at most MaxSpeed, all of the torque when it is stuck."""

import mujoco
import numpy as np
import pytest

from tests.rig import PERIOD, Rig
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.kinematic_tree import servos_of
from usarmjx.models.compile.parts import part_name, parts_of
from usarmjx.models.robots import ROBOTS
from usarmjx.sim.batch import Batch
from usarmjx.sim.control import ControlMode
from usarmjx.sim.scene import build_scene

MARGIN = 1.1
"""A joint may be this much faster than MaxSpeed: the others of its robot jerk at it, once a control step."""
WHEEL_MARGIN = 1.2
"""The same for wheels: a tracked robot's outer ones lose the ground as it jerks forward. Told the speed
instead of a torque, they get to 1.27 times it."""
MOVED = 0.02
"""How far links that turn may move a robot that stands [m]: cameras jerk no more than tyres give."""
STUCK_RTOL = 0.01
"""How exactly a joint that cannot move exerts what it was told: servos are of single precision."""
BUILT_UP = 1.2
"""Within this time a joint that is stuck is pushed with all of its torque [s]; AirRobot's tilt is slowest."""
SETTLED_RTOL = 0.01
"""How near to its top speed a free joint is after 2 s."""
UNMOVED = 1e9
"""Inertia of a joint that is stuck [kg m2 or kg]: in a second a car's 3000 N m get it to 3e-6 rad/s."""
STOPPED = 1e-5
"""Speed of a joint that is stuck [rad/s or m/s]; see `UNMOVED`."""
PAN = "CameraPanTilt_Link1"
PAN_SPEED = 0.17  # rad/s, manual 9.3

MOVING = [name for name in ROBOTS.names() if any(servos_of(ROBOTS.get(name)).speed)]
WHEELED = [name for name in MOVING if any(part.is_wheel for part in parts_of(ROBOTS.get(name)))]
LINKED = [name for name in MOVING if ROBOTS.get(name).packages]


def links_of(name):
    """Which joints are links of mission packages (joints,)."""
    robot = ROBOTS.get(name)
    links = {part_name(package, link) for package in robot.packages for link in package.links}
    return np.array([part.name in links for part in parts_of(robot)])


def forced(rig, share, which=True):
    """Tell joints that move a share of their motors' torque; return which they are, and their orders."""
    servos = servos_of(rig.robot)
    joints = np.flatnonzero((servos.speed > 0) & which)
    names = [parts_of(rig.robot)[joint].name for joint in joints]
    orders = share * servos.torque[joints]
    rig.move(dict(zip(names, orders.tolist(), strict=True)), ControlMode.TORQUE)
    return joints, orders


def fastest(rig, joints, seconds):
    """Return the highest speed of each joint, in units of its top speed, at the ends of control steps."""
    dofs, speed = np.array(rig.indices[0].dofadr)[joints], servos_of(rig.robot).speed[joints]
    peak = np.zeros(len(joints))
    for _ in range(round(seconds / PERIOD)):
        rig.step()
        peak = np.maximum(peak, np.abs(rig.data.qvel[dofs]) / speed)
    return peak


def weightless(name):
    """A robot in the air, without gravity."""
    rig = Rig(name, height=5.0)
    rig.model.opt.gravity[:] = 0.0
    return rig


@pytest.mark.every_run(
    *("1.0-P2AT", "1.0-AirRobot", "1.0-Talon", "1.0-Hummer", "1.0-ERS", "-0.25-Submarine", "-0.25-OmniP2AT")
)
@pytest.mark.parametrize("name", MOVING)
@pytest.mark.parametrize("share", [1.0, -0.25])
def test_no_joint_gets_faster_than_its_top_speed(name, share):
    rig = weightless(name)
    joints, _ = forced(rig, share)
    assert fastest(rig, joints, 3.0).max() <= MARGIN


@pytest.mark.every_run("1.0-AirRobot", "1.0-P2AT", "0.25-Talon", "0.25-Submarine")
@pytest.mark.parametrize("name", LINKED)
@pytest.mark.parametrize("share", [1.0, 0.25])
def test_links_under_torque_leave_the_robot_where_it_stands(name, share):
    """A P2AT's camera at a quarter of its torque once turned at 580 rad/s and threw the robot about."""
    rig = Rig(name)
    rig.run(0.5)
    start = rig.data.qpos[:3].copy()
    joints, _ = forced(rig, share, links_of(name))
    peak = fastest(rig, joints, 3.0)
    assert (peak <= MARGIN).all()
    assert np.linalg.norm(rig.data.qpos[:3] - start) < MOVED
    assert rig.up[0] > 0.99


@pytest.mark.parametrize("name", WHEELED)
def test_driven_wheels_keep_their_top_speed(name):
    rig = Rig(name)
    wheels = np.array([part.is_wheel for part in parts_of(rig.robot)])
    joints, _ = forced(rig, 1.0, wheels)
    assert fastest(rig, joints, 1.5).max() <= WHEEL_MARGIN
    assert np.hypot(*rig.data.qpos[:2]) > 0.1, "it drives"


@pytest.mark.every_run("1.0-AirRobot", "1.0-P2AT", "-0.25-Talon", "1.0-Hummer", "-0.25-ERS")
@pytest.mark.oracle
@pytest.mark.parametrize("name", MOVING)
@pytest.mark.parametrize("share", [1.0, -0.25])
def test_a_stuck_joint_exerts_what_it_is_told(name, share):
    """Statics: nothing moves, so that the actuators' force is the order, whatever the engine makes of it."""
    rig = weightless(name)
    servos, index = servos_of(rig.robot), rig.indices[0]
    joints, orders = forced(rig, share)
    dofs, qpos = np.array(index.dofadr)[joints], np.array(index.qposadr)[joints]
    rig.model.dof_armature[dofs] = UNMOVED
    mujoco.mj_setConst(rig.model, rig.data)
    low, high = servos.low[joints], servos.high[joints]
    limited = np.isfinite(low)
    rig.data.qpos[qpos[limited]] = (low[limited] + high[limited]) / 2
    rig.run(BUILT_UP)
    np.testing.assert_allclose(rig.data.qfrc_actuator[dofs], orders, rtol=STUCK_RTOL)
    assert np.abs(rig.data.qvel[dofs]).max() < STOPPED


@pytest.mark.oracle
def test_a_limp_joint_keeps_its_spin():
    """Newton's first law: at torque 0 nothing brakes a camera that pans, be it faster than its MaxSpeed."""
    rig = weightless("P2AT").move({PAN: 0.0}, ControlMode.TORQUE)
    dof = rig.indices[0].dofadr[rig.plan.joint_index(PAN)]
    rig.data.qvel[dof] = 5 * PAN_SPEED
    rig.run(1.0)
    assert rig.data.qvel[dof] == pytest.approx(5 * PAN_SPEED, rel=1e-3)


@pytest.mark.parametrize("mode", [ControlMode.VELOCITY, ControlMode.POSITION])
def test_after_a_torque_a_joint_goes_on_from_where_it_is(mode):
    """Its servo has no target left from before; from one elsewhere the camera would whip back."""
    rig = weightless("P2AT").move({PAN: 0.05}, ControlMode.TORQUE)
    joint = np.array([rig.plan.joint_index(PAN)])
    rig.run(4.0)
    there = rig.joint(PAN)
    assert there > 2.5 * PAN_SPEED
    rig.move({PAN: 0.0}, mode)
    assert fastest(rig, joint, 1.0).max() <= MARGIN
    moved = rig.joint(PAN) - there
    if mode == ControlMode.VELOCITY:
        assert 0 <= moved < 0.1 * PAN_SPEED, "it brakes"
    else:
        assert moved == pytest.approx(-PAN_SPEED, rel=0.2), "it goes home at MaxSpeed"


def test_a_joint_comes_to_rest_at_the_end_of_its_range():
    rig = weightless("Kurt3D").move({"ScannerSides": 20.0}, ControlMode.TORQUE)
    rig.run(3.0)
    (end,) = (part.limits[1] for part in parts_of(rig.robot) if part.name == "ScannerSides")
    assert rig.joint("ScannerSides") == pytest.approx(end, abs=1e-3)
    joint = np.array([rig.plan.joint_index("ScannerSides")])
    assert fastest(rig, joint, 0.5).max() < 0.01


def test_a_batch_remembers_what_held_a_joint():
    """Two worlds: full torque, and one that is exact as long as the camera is slow."""
    batch = Batch(build_scene(ARENAS.get("field"), ["P2AT"]), 2, engine="c")
    torques = np.array([[20.0], [0.05]], np.float32)
    state = batch.move(batch.reset(), 0, {PAN: torques}, ControlMode.TORQUE)
    group = batch.scene.groups[0]
    pan = int(np.flatnonzero(group.plan.actuated == group.plan.joint_index(PAN))[0])
    for steps, held in ((2, [1, 0]), (98, [1, 1])):
        state = batch.run(state, steps)
        np.testing.assert_array_equal(state.worlds.groups[0].hold[:, 0, pan], held)
    turning = batch.physics(state).qvel[:, group.dofadr[0, pan]]
    np.testing.assert_allclose(turning, PAN_SPEED, rtol=SETTLED_RTOL)
