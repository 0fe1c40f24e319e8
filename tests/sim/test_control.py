"""What the motors are told: clamps, refusals, and orders carried out by C MuJoCo."""

import math
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tests.rig import Rig
from usarmjx.base.clock import wrapped_step
from usarmjx.base.errors import UnknownNameError
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of, servos_of
from usarmjx.models.compile.parts import LINK_STIFFNESS
from usarmjx.models.drives import DRY_DEPTH
from usarmjx.models.drives.base import RobotState
from usarmjx.models.robots.pioneer import P2AT, P2AT_MOTOR
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.sim.control import (
    ControlMode,
    DriveConditions,
    compute_actuation,
    idle_command,
    righting_wrench,
    set_drive,
)
from usarmjx.sim.scene import build_scene

PERIOD = 0.02  # s
FLOAT32_ATOL = 1e-5  # a position difference of 1e-7 rad over a period of 0.02 s
PAN, TILT = 4, 5  # places of the joints
CAMERA_SPEED = 0.17  # rad/s, manual 9.3
TILT_RANGE = (-0.16, 0.40)  # rad, manual 9.3
OVERSHOOT = 0.005  # rad: how far a C MuJoCo servo may end from its target
SPEED_MARGIN = 1.1  # of a joint's speed over MaxSpeed: the servo catches up after its start

NOWHERE = ArenaSpec(
    name="nowhere",
    starts=(StartPose(tag="only", at=(0.0, 0.0, 0.188)),),
    extent=((0, 0), (0, 0)),
)


@pytest.fixture(scope="module")
def run():
    """`drive` of a P2AT, compiled once, as a function of plain numbers, at 1 s."""
    compiled = jax.jit(partial(compute_actuation, kinematic_tree_of(P2AT), period=PERIOD))

    def call(target, order, joint_pos=(0.0,) * 6, joint_vel=(0.0,) * 6, act=None, **lying):
        act = joint_pos if act is None else act
        command = idle_command(P2AT).replace(
            target=jnp.asarray(target, jnp.float32),
            mode=jnp.asarray(order, jnp.int32),
            flip_until=jnp.int32(round(lying.get("until", 0.0) / PERIOD)),
        )
        state = RobotState(
            pos=jnp.zeros(3),
            quat=jnp.asarray(lying.get("quat", (1, 0, 0, 0)), jnp.float32),
            linear=jnp.zeros(3),
            angular=jnp.zeros(3),
            joint_pos=jnp.asarray(joint_pos, jnp.float32),
            joint_vel=jnp.asarray(joint_vel, jnp.float32),
        )
        now = DriveConditions(
            step=jnp.int32(lying.get("step", round(1.0 / PERIOD))),
            powered=jnp.asarray(lying.get("powered", True)),
            depth=jnp.float32(DRY_DEPTH),
        )
        return compiled(command, state, jnp.asarray(act, jnp.float32), now)

    call.compiled = compiled
    return call


WHEELS_TURN = [ControlMode.VELOCITY] * 4 + [ControlMode.POSITION] * 2
ALL_TURN = [ControlMode.VELOCITY] * 6


def test_speeds_are_clamped_to_what_the_joints_can_do(run):
    told = run([1.0, -99.0, 99.0, 5.0, 9.0, -9.0], ALL_TURN)
    top = P2AT.drive.max_speed
    np.testing.assert_allclose(told.ctrl, [1.0, -top, top, 5.0, CAMERA_SPEED, -CAMERA_SPEED])
    assert told.refused == 0


def test_positions_are_approached_at_most_at_full_speed_and_met_exactly(run):
    step = CAMERA_SPEED * PERIOD
    told = run([0, 0, 0, 0, 3.0, 0.1 + step / 4], WHEELS_TURN, joint_pos=[0, 0, 0, 0, 0, 0.1])
    assert told.ctrl[PAN] == pytest.approx(CAMERA_SPEED)
    assert told.ctrl[TILT] == pytest.approx(CAMERA_SPEED / 4, abs=FLOAT32_ATOL)


@pytest.mark.parametrize(
    ("target", "at", "goes_to"),
    [(9.0, 0.399, TILT_RANGE[1]), (-9.0, -0.159, TILT_RANGE[0]), (9.0, 0.45, TILT_RANGE[1])],
)
@pytest.mark.parametrize("order", [ControlMode.POSITION, ControlMode.VELOCITY])
def test_ranges_are_kept(run, order, target, at, goes_to):
    told = run([0, 0, 0, 0, 0, target], [ControlMode.VELOCITY] * 5 + [order], joint_pos=[0] * 5 + [at])
    after = at + float(told.ctrl[TILT]) * PERIOD
    assert after == pytest.approx(goes_to, abs=1e-6)


def test_a_torque_ends_at_the_range(run):
    told = run([0] * 5 + [9.0], [ControlMode.VELOCITY] * 5 + [ControlMode.TORQUE], joint_pos=[0] * 5 + [0.5])
    assert told.hold[TILT] == 1.0
    assert told.act[TILT] == pytest.approx(TILT_RANGE[1]), "beyond its range the servo pulls it back"
    inward = run(
        [0] * 5 + [-0.1], [ControlMode.VELOCITY] * 5 + [ControlMode.TORQUE], joint_pos=[0] * 5 + [0.5]
    )
    assert inward.hold[TILT] == 0.0, "a torque may bring it back itself"


def test_an_unlimited_joint_turns_on_and_on(run):
    told = run([0, 0, 0, 0, 0.1, 0], ALL_TURN, joint_pos=[0, 0, 0, 0, 100.0, 0])
    assert told.ctrl[PAN] == pytest.approx(0.1)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_counts_as_zero_and_is_counted(run, bad):
    told = run([bad, 1.0, bad, -1.0, bad, 0.1], WHEELS_TURN)
    assert told.refused == 3
    assert np.isfinite(told.ctrl).all()
    np.testing.assert_allclose(told.ctrl[:5], [0, 1, 0, -1, 0])


@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_a_servos_target_leads_its_joint_by_what_full_torque_at_its_speed_needs(run, speed):
    slack = servos_of(P2AT).windup_limit
    motor = P2AT_MOTOR
    told = run(
        [0] * 6,
        WHEELS_TURN,
        joint_pos=np.full(6, 0.2),
        joint_vel=np.full(6, speed),
        act=[9, -9, 0.2, 0.2, 9, -9],
    )
    # Stiffness times lead, less damping times speed, is the torque.
    pull = motor.stiffness * (told.act[:2] - 0.2) - motor.damping * speed
    np.testing.assert_allclose(pull, [motor.torque, -motor.torque], rtol=1e-5)
    if not speed:
        np.testing.assert_allclose(told.act[2:], [0.2, 0.2, 0.2 + slack[4], 0.2 - slack[5]], rtol=1e-6)


def test_only_a_tilted_robot_is_righted_and_only_for_its_time(run):
    on_its_side = (np.cos(np.pi / 4), np.sin(np.pi / 4), 0.0, 0.0)  # left side up: rolled to the right
    still = [0.0] * 6
    assert not run(still, WHEELS_TURN, quat=on_its_side, until=0.5).wrench.any()  # it is 1.0 s now
    assert not run(still, WHEELS_TURN, until=2.0).wrench.any()
    wrench = run(still, WHEELS_TURN, quat=on_its_side, until=2.0).wrench
    assert not wrench[:3].any()
    # Back about the axis that it fell over (its length), with twice what tips its cross-section over an edge.
    twice = 2 * P2AT.mass * 9.81 * math.hypot(*P2AT.dimensions[1:]) / 2
    assert wrench[3] == pytest.approx(-twice, abs=1e-3)
    # In full: it begins to turn about that axis alone, although it is no axis of its inertia.
    change = np.linalg.solve(kinematic_tree_of(P2AT).inertia, np.array(wrench[3:])[[0, 2, 1]] * (1, 1, -1))
    np.testing.assert_allclose(change[1:] / change[0], 0.0, atol=1e-5)


def test_a_count_that_has_wrapped_around_rights_nobody(run):
    """After 2^31 steps the count is negative, and the idle command's 0 lies ahead of it."""
    on_its_side = (np.cos(np.pi / 4), np.sin(np.pi / 4), 0.0, 0.0)
    for step in (-(2**31) + 5, -1000):
        assert not run([0.0] * 6, WHEELS_TURN, quat=on_its_side, step=step).wrench.any()
    assert wrapped_step(2**31 + 5) == -(2**31) + 5


@pytest.mark.parametrize("roll", [np.pi, np.pi / 2])
def test_righting_gets_a_robot_back_on_its_wheels(roll):
    scene = build_scene(NOWHERE, ["P2AT"])
    data, group = mujoco.MjData(scene.model), scene.groups[0]
    data.qpos[group.root_qposadr[0]] = [0, 0, 0.3, np.cos(roll / 2), np.sin(roll / 2), 0, 0]
    push = jax.jit(partial(righting_wrench, kinematic_tree_of(P2AT), period=PERIOD))
    for _ in range(300):  # 6 s, twice FlipTime: one push to the feet, and time to come to rest
        root, dof = data.qpos[group.root_qposadr[0]], data.qvel[group.root_dofadr[0]]
        state = RobotState(
            pos=root[:3], quat=root[3:], linear=dof[:3], angular=dof[3:], joint_pos=None, joint_vel=None
        )  # fmt: skip
        data.xfrc_applied[group.chassis[0]] = push(state) if data.time < 3.0 else 0.0
        for _ in range(4):
            mujoco.mj_step(scene.model, data)
    assert data.body("r0/chassis").xmat.reshape(3, 3)[2, 2] > 0.999
    assert abs(data.body("r0/chassis").xpos[2] - 0.26) < 0.005


def test_an_idle_robot_brakes_and_holds(run):
    command = idle_command(P2AT)
    assert command.mode.tolist() == WHEELS_TURN
    told = run(command.target, command.mode, joint_pos=[3, 4, 5, 6, 0, 0])
    assert not told.ctrl.any()
    assert not command.light


def test_sides_drive_their_wheels():
    told = set_drive(P2AT, idle_command(P2AT), {"Left": 1.0, "Right": 2.0})
    assert told.target.tolist() == [1, 2, 1, 2, 0, 0]
    assert told.mode.tolist() == WHEELS_TURN
    assert set_drive(P2AT, told, {"Right": -3.0}).target.tolist() == [1, -3, 1, -3, 0, 0]


def test_drive_values_are_broadcast_over_robots_and_clipped():
    command = jax.tree.map(lambda x: jnp.broadcast_to(x, (2, 3, *x.shape)), idle_command(P2AT))
    told = set_drive(P2AT, command, {"Left": jnp.zeros((2, 3)), "Right": jnp.full((2, 3), 99.0)})
    assert told.target.shape == (2, 3, 6)
    np.testing.assert_allclose(told.target[1, 2], [0, 5.385, 0, 5.385, 0, 0], rtol=1e-6)


def test_a_key_of_another_drive_is_refused_with_those_there_are():
    with pytest.raises(UnknownNameError, match=r"P2AT's DRIVE has no key Speed; it has: Left, Right"):
        set_drive(P2AT, idle_command(P2AT), {"Speed": 1.0})


def test_a_drive_takes_its_wheels_back_from_orders_to_single_joints():
    told = idle_command(P2AT)
    told = told.replace(target=told.target.at[0].set(0.7), mode=told.mode.at[0].set(ControlMode.POSITION))
    again = set_drive(P2AT, told, {"Left": 1.0})
    assert again.mode.tolist() == WHEELS_TURN
    assert again.target[0] == 1.0


def test_without_power_a_robot_brakes(run):
    told = run([5.0] * 6, ALL_TURN, powered=False)
    assert not told.ctrl.any()
    told = run([0.0] * 6, [ControlMode.POSITION] * 6, joint_pos=[0, 0, 0, 0, 0.5, 0.2], powered=False)
    assert not told.ctrl.any(), "it does not go home either"


def test_a_torque_is_pulled_with_and_nothing_holds(run):
    """Stiffness times target is the torque, clamped to what the motor can do."""
    told = run([1.0, -9.0, 0, 0, 0.1, 0], [ControlMode.TORQUE] * 6, joint_pos=np.full(6, 0.3))
    motor = P2AT_MOTOR
    np.testing.assert_allclose(told.act[:2] * motor.stiffness, [1.0, -motor.torque], rtol=1e-5)
    np.testing.assert_allclose(told.act[4] * LINK_STIFFNESS, 0.1, rtol=1e-4)
    assert not told.hold[:5].any()
    assert not told.ctrl.any()


@pytest.mark.oracle
def test_a_free_joint_under_a_torque_turns_as_newton_says():
    """A P2AT's camera pans about the vertical: speed = torque / inertia x time as long as that is below
    MaxSpeed, the body being 90 times heavier to turn."""
    rig = Rig("P2AT").move({"CameraPanTilt_Link1": 0.02}, ControlMode.TORQUE)
    dof = rig.indices[0].dofadr[PAN]
    inertia = np.zeros((rig.model.nv, rig.model.nv))
    mujoco.mj_forward(rig.model, rig.data)
    mujoco.mj_fullM(rig.model, rig.data, inertia)
    rig.run(0.14)
    assert rig.data.qvel[dof] == pytest.approx(0.02 / inertia[dof, dof] * 0.14, rel=0.03)


@pytest.mark.oracle
def test_the_servo_is_mujocos_integrated_velocity_servo(run):
    """Force = kp (target - position) - kv velocity within the motor's torque, in C MuJoCo."""
    rig = Rig("P2AT").tell(Left=3.0, Right=3.0)
    rig.run(0.3)
    index, data = rig.indices[0], rig.data
    mujoco.mj_forward(rig.model, data)
    act, q, v = (
        x[list(i)][:4]
        for x, i in ((data.act, index.actadr), (data.qpos, index.qposadr), (data.qvel, index.dofadr))
    )
    motor = P2AT_MOTOR
    expected = np.clip(motor.stiffness * (act - q) - motor.damping * v, -motor.torque, motor.torque)
    np.testing.assert_allclose(data.qfrc_actuator[list(index.dofadr)][:4], expected, atol=1e-9)


@pytest.mark.oracle
def test_a_position_order_is_carried_out_at_max_speed_by_c_mujoco(run):
    scene = build_scene(NOWHERE, ["P2AT"])
    data, group = mujoco.MjData(scene.model), scene.groups[0]
    data.qpos[2] = 0.26
    goal = np.array([0, 0, 0, 0, 0.5, 9.0])  # the tilt's is out of its range
    fastest, arrived = 0.0, None
    for step in range(250):
        told = run(goal, WHEELS_TURN, joint_pos=data.qpos[group.qposadr[0]], act=data.act[group.actadr[0]])
        data.ctrl[group.actuator_ids[0]], data.ctrl[group.hold_actuator_ids[0]] = told.ctrl, told.hold
        data.act[group.actadr[0]] = told.act
        for _ in range(4):
            mujoco.mj_step(scene.model, data)
        fastest = max(fastest, np.abs(data.qvel[group.dofadr[0, PAN:]]).max())
        if arrived is None and abs(data.qpos[group.qposadr[0, PAN]] - 0.5) < OVERSHOOT:
            arrived = (step + 1) * PERIOD
    camera = data.qpos[group.qposadr[0, PAN:]]
    np.testing.assert_allclose(camera, [0.5, TILT_RANGE[1]], atol=OVERSHOOT)
    assert fastest <= CAMERA_SPEED * SPEED_MARGIN
    assert arrived == pytest.approx(0.5 / CAMERA_SPEED, abs=0.2)


def test_drive_is_compiled_once(run):
    run(np.zeros(6), WHEELS_TURN)
    run(np.ones(6), ALL_TURN, joint_pos=np.ones(6))
    assert run.compiled._cache_size() == 1
