"""Control of a world on NumPy: as on JAX, robots at once as one by one, nothing traced."""

import time
from functools import cache, partial

import jax
import numpy as np
import pytest

from tests.sim.on_numpy import as_numpy, assert_same, nothing_compiled, row
from usarmjx.base.backend import numpy_backend
from usarmjx.base.transforms import GRAVITY
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.drives.base import RobotState
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.sim.control import (
    CommandUpdate,
    ControlMode,
    DriveConditions,
    RobotCommand,
    compute_actuation,
    idle_command,
    update_command,
)

PERIOD = 0.02  # s
ROWS = 12
"""Robots at once; every state and order below comes up among them."""
ROUNDING = 1e-5
"""Of the largest number of a row: single precision is 1e-7, sums have about ten terms, and XLA fuses them."""
CLOSE = 1e-4
"""A speed from the difference of two angles of up to 3 rad in a control step [rad/s]: 3e-7 rad over 20 ms."""
SERVED = 8
"""Robots of a class in a served world, at most about."""
BUDGET = 1e-3
"""Their control takes 0.1 ms; ten times that is left for a loaded machine [s]."""
EVERY_ROBOT = pytest.mark.parametrize("name", ROBOTS.names())


@cache
def on_jax(name):
    """The control function of a class, compiled for a group."""
    run = partial(compute_actuation, kinematic_tree_of(ROBOTS.get(name)), period=PERIOD)
    return jax.jit(jax.vmap(run))


def drawn(name, rows=ROWS):
    """What `compute_actuation` takes of random robots: some flip, some have no power, some orders are bad."""
    robot, rng = ROBOTS.get(name), np.random.default_rng(7)
    plan = kinematic_tree_of(robot)
    joints, keys = len(plan.parts) - 1, len(robot.drive.keys)

    def numbers(*shape, scale=1.0):
        return rng.normal(0.0, scale, (rows, *shape)).astype(np.float32)

    def with_bad(values):
        return np.where(rng.random(values.shape) < 0.1, rng.choice([np.nan, np.inf], values.shape), values)

    state = RobotState(
        pos=numbers(3),
        quat=numbers(4),
        linear=numbers(3),
        angular=numbers(3),
        joint_pos=numbers(joints),
        joint_vel=numbers(joints),
    )
    setpoint = rng.uniform(-1, 1, (rows, keys)) * robot.drive.limits
    command = RobotCommand(
        target=with_bad(numbers(joints, scale=3.0)).astype(np.float32),
        mode=rng.integers(0, 3, (rows, joints)).astype(np.int32),
        setpoint=with_bad(setpoint).astype(np.float32),
        flip_until=rng.choice([0, 100], rows).astype(np.int32),
        light=rng.random(rows) < 0.5,
    )
    conditions = DriveConditions(
        step=np.full(rows, 50, np.int32),
        powered=rng.random(rows) < 0.8,
        depth=numbers(),
        torque=rng.uniform(0.5, 1.5, rows).astype(np.float32),
        speed=rng.uniform(0.5, 1.5, rows).astype(np.float32),
        hold=rng.integers(0, 2, (rows, len(plan.actuated))).astype(np.float32),
    )
    return plan, (command, state, numbers(len(plan.actuated)), conditions)


def assert_rounded(plan, ours, theirs):
    """Actuator inputs are the same but for rounding, forces measured by the largest, weight among them."""
    largest = np.abs(np.asarray(theirs.wrench)).max(-1, keepdims=True) + plan.mass * GRAVITY
    np.testing.assert_allclose(ours.wrench / largest, theirs.wrench / largest, atol=ROUNDING)
    assert_same(*(told.replace(wrench=np.zeros(0)) for told in (ours, theirs)), rtol=ROUNDING, atol=CLOSE)
    assert ours.wrench.dtype == np.float32


@pytest.mark.every_run("AirRobot", "ComStation", "ERS", "Hummer", "OmniP2AT", "P2AT", "Talon", "Submarine")
@pytest.mark.oracle
@EVERY_ROBOT
def test_motors_are_told_the_same_on_both_libraries(name):
    plan, args = drawn(name)
    with numpy_backend():
        ours = compute_actuation(plan, *args, PERIOD)
    theirs = on_jax(name)(*args)
    assert_rounded(plan, ours, theirs)
    if plan.robot.drive.is_wheeled:
        assert ours.wrench.any(-1).sum() not in (0, ROWS), "some are righted"
    assert (ours.refused > 0).any() or not len(plan.actuated)


@EVERY_ROBOT
def test_robots_at_once_are_told_what_each_is_told_alone(name):
    plan, (command, state, act, conditions) = drawn(name)
    for factors in (conditions, conditions.replace(torque=None, speed=None)):
        with numpy_backend():
            ours = compute_actuation(plan, command, state, act, factors, PERIOD)
            alone = [
                compute_actuation(plan, *row((command, state, act, factors), i), PERIOD) for i in range(ROWS)
            ]
        assert_rounded(plan, ours, jax.tree.map(lambda *rows: np.stack(rows), *alone))


def test_without_anyone_to_right_the_group_is_told_the_same():
    """On NumPy nothing is computed for robots that need no righting, if there are no others."""
    plan, (command, *rest) = drawn("P2DX")
    still = command.replace(flip_until=np.zeros(ROWS, np.int32))
    with numpy_backend():
        ours = compute_actuation(plan, still, *rest, PERIOD)
    assert not ours.wrench.any()
    assert_rounded(plan, ours, on_jax("P2DX")(still, *rest))


@pytest.mark.every_run("AirRobot", "ComStation", "ERS", "Hummer", "OmniP2AT", "P2AT", "Talon", "Submarine")
@pytest.mark.oracle
@EVERY_ROBOT
def test_robots_are_told_the_same_on_both_libraries(name):
    """Angles of cars' wheels are arc tangents, whose last places differ."""
    plan, (command, *_) = drawn(name)
    robot, rng = plan.robot, np.random.default_rng(3)
    command = command.replace(target=np.nan_to_num(command.target), setpoint=np.nan_to_num(command.setpoint))
    numbers = dict.fromkeys([*robot.drive.keys, *plan.parts[1:]], 0.0)
    numbers = {key: rng.normal(0, 2, ROWS).astype(np.float32) for key in numbers}
    update = CommandUpdate(
        drive={key: numbers[key] for key in robot.drive.keys},
        joints={joint: numbers[joint] for joint in plan.parts[1:3]},
        mode=ControlMode.TORQUE,
        light=True,
        flip_until=150,
    )
    for where in (None, rng.random(ROWS) < 0.5):
        with numpy_backend():
            ours = update_command(plan, command, update, where)
            idle = idle_command(robot)
        assert_same(ours, update_command(plan, command, update, where), rtol=1e-6, atol=1e-6)
        assert_same(idle, idle_command(robot))


def test_controlling_a_group_traces_nothing_and_takes_a_fraction_of_a_step():
    jax.clear_caches()  # what JAX has compiled it would not tell of
    for name in ("P2AT", "Hummer", "AirRobot", "Submarine"):
        plan, args = drawn(name, SERVED)
        with nothing_compiled():
            compute_actuation(plan, *args, PERIOD)
            update_command(plan, args[0], CommandUpdate(drive=dict.fromkeys(plan.robot.drive.keys, 0.1)))
    plan, args = drawn("P2AT", SERVED)
    args = jax.tree.map(np.nan_to_num, (idle_rows(SERVED), *args[1:]))
    with numpy_backend():
        times = []
        for _ in range(20):
            start = time.perf_counter()
            compute_actuation(plan, *args, PERIOD)
            times.append(time.perf_counter() - start)
    assert min(times) < BUDGET


def idle_rows(rows):
    """The commands of robots that have not been told anything."""
    return jax.tree.map(lambda x: np.broadcast_to(as_numpy(x), (rows, *x.shape)), idle_command(P2AT))


def test_what_jax_compiles_is_noticed():
    with pytest.raises(AssertionError), nothing_compiled():
        jax.jit(lambda x: x + 1)(np.zeros(ROWS, np.float32)).block_until_ready()
