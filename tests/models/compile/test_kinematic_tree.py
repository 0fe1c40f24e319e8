"""The body plan's own kinematics against C MuJoCo."""

from dataclasses import replace
from functools import partial

import jax
import mujoco
import numpy as np
import pytest

from usarmjx.base.backend import numpy_backend
from usarmjx.models.compile.compose import add_robot, index_robot, new_spec
from usarmjx.models.compile.kinematic_tree import (
    forward_kinematics,
    geom_poses,
    kinematic_tree_of,
    robot_state,
)
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots.pioneer import P2AT, P2DX
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import Link, MissionPackage
from usarmjx.models.types.shapes import Shape

KINEMATICS_ATOL = 1e-5  # float32 at room scale: positions up to 5 m round to 5e-7, times some products
HEIGHT_ATOL = 1e-6  # float64 in the compiled model
STATES = 40

NOWHERE = ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0)))
# A lift on a turntable with a tilted arm: what neither Pioneer has is a joint that slides.
LIFT = replace(
    P2AT,
    name="Lift",
    packages=(
        MissionPackage(
            name="Lift",
            links=tuple(
                Link(
                    number=number,
                    parent=parent,
                    location=(0.1, 0.05 * number, -0.2),
                    orientation=(0.3 * number, -0.2, 0.5),
                    max_speed=1.0,
                    max_torque=10.0,
                    min_range=1.0,
                    max_range=0.0,
                    joint=joint,
                    shapes=(Shape(kind="capsule", size=(0.02, 0.1), rotation=(0.4, 0.1, 0), mass=0.2),),
                )
                for number, parent, joint in (
                    (1, -1, "Revolute"),
                    (2, 1, "Prismatic"),
                    (3, 2, "Revolute"),
                )
            ),
        ),
    ),
)


@pytest.mark.oracle
@pytest.mark.parametrize("robot", [P2AT, P2DX, LIFT], ids=lambda robot: robot.name)
def test_poses_at_random_states_match_c_mujoco(robot):
    spec = new_spec(NOWHERE, Physics())
    # A second robot behind it, so that indices that ignore the prefix would show.
    add_robot(spec, P2DX, "other/", (3.0, 0.0, 1.0))
    add_robot(spec, robot, "it/", (0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    plan, index = kinematic_tree_of(robot), index_robot(model, robot, "it/")
    rng = np.random.default_rng(7)
    qpos = rng.uniform(-3, 3, (STATES, model.nq))  # quaternions too: both sides normalise them
    qvel = np.zeros(model.nv)

    @partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})  # runs once
    @jax.vmap
    def poses(q):
        bodies = forward_kinematics(plan, robot_state(index, q, qvel))
        return bodies, geom_poses(plan, bodies)

    bodies, (geom_pos, geom_mat) = poses(qpos.astype(np.float32))
    of_it = [g for g in range(model.ngeom) if model.geom_bodyid[g] in index.body_ids]
    near = partial(np.testing.assert_allclose, atol=KINEMATICS_ATOL)
    for i, q in enumerate(qpos):
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        near(bodies.pos[i], data.xpos[list(index.body_ids)])
        near(bodies.mat[i], data.xmat[list(index.body_ids)].reshape(-1, 3, 3))
        near(geom_pos[i], data.geom_xpos[of_it])
        near(geom_mat[i], data.geom_xmat[of_it].reshape(-1, 3, 3))
    assert (plan.geom_type == model.geom_type[of_it]).all()
    near(plan.geom_size, model.geom_size[of_it])
    # All at once, as leading axes, and on NumPy: the same.
    with numpy_backend():
        grid = qpos.astype(np.float32).reshape(2, -1, model.nq)
        every = forward_kinematics(plan, robot_state(index, grid, np.zeros((*grid.shape[:2], model.nv))))
        shapes = geom_poses(plan, every)
    for ours, mapped in zip(
        (every.pos, every.mat, *shapes), (bodies.pos, bodies.mat, geom_pos, geom_mat), strict=True
    ):
        assert ours.dtype == np.float32
        near(ours.reshape(mapped.shape), mapped)


def test_robot_state_picks_its_own_numbers():
    spec = new_spec(NOWHERE, Physics())
    add_robot(spec, P2DX, "other/", (3.0, 0.0, 1.0))
    add_robot(spec, P2AT, "it/", (0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos, data.qvel = np.arange(model.nq), 100 + np.arange(model.nv)
    state = robot_state(index_robot(model, P2AT, "it/"), data.qpos, data.qvel)
    np.testing.assert_array_equal([*state.pos, *state.quat], data.joint("it/root").qpos)
    np.testing.assert_array_equal([*state.linear, *state.angular], data.joint("it/root").qvel)
    names = kinematic_tree_of(P2AT).parts[1:]
    np.testing.assert_array_equal(state.joint_pos, [data.joint(f"it/{n}").qpos[0] for n in names])
    np.testing.assert_array_equal(state.joint_vel, [data.joint(f"it/{n}").qvel[0] for n in names])


@pytest.mark.oracle
@pytest.mark.parametrize("robot", [P2AT, P2DX, LIFT], ids=lambda robot: robot.name)
def test_the_inertia_is_that_of_c_mujocos_mass_matrix(robot):
    spec = new_spec(NOWHERE, Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    data, plan = mujoco.MjData(model), kinematic_tree_of(robot)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    # The block of the free joint's rotation is about the chassis' origin.
    centre = np.array(plan.centre_of_mass)
    moved = plan.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    np.testing.assert_allclose(plan.inertia, full[3:6, 3:6] - moved, atol=KINEMATICS_ATOL)
    chassis = index_robot(model, robot, "").body_ids[0]
    np.testing.assert_allclose(plan.chassis_centre, model.body_ipos[chassis], atol=HEIGHT_ATOL)


@pytest.mark.parametrize(("robot", "height"), [(P2AT, 0.26), (P2DX, 0.20)])
def test_clearance_is_the_manuals_start_height(robot, height):
    assert kinematic_tree_of(robot).clearance == pytest.approx(height, abs=HEIGHT_ATOL)  # manual 5.3.6
    assert robot.origin_height == height


@pytest.mark.parametrize(
    ("shape", "reach"),
    [  # how far each reaches below its centre, turned by 30 degrees about y
        (Shape(kind="sphere", size=(0.3,)), 0.3),
        (Shape(kind="capsule", size=(0.1, 0.3)), 0.1 + 0.3 * np.cos(np.pi / 6)),
        (Shape(kind="cylinder", size=(0.1, 0.3)), 0.1 * 0.5 + 0.3 * np.cos(np.pi / 6)),
        (Shape(kind="box", size=(0.1, 0.2, 0.3)), 0.1 * 0.5 + 0.3 * np.cos(np.pi / 6)),
    ],
    ids=lambda value: getattr(value, "kind", ""),
)
def test_clearance_knows_every_shape(shape, reach):
    low = replace(shape, at=(0.0, 0.0, 0.5), rotation=(0.0, np.pi / 6, 0.0), mass=1.0)
    robot = replace(P2AT, name="Keel", chassis=(low,))
    assert kinematic_tree_of(robot).clearance == pytest.approx(0.5 + reach, abs=HEIGHT_ATOL)
