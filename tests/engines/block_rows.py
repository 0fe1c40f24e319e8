"""Random states, errors and trajectories for the tests of the solver `block`."""

import mujoco
import numpy as np
import warp as wp

from benchmarks.islands.rows import data_of, jacobian, model_of, solved_alone
from usarmjx.engines.block.islands import THREADS
from usarmjx.engines.block.solver import CLASSES, islands_kernel, make_problem

State = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Positions, velocities, controls and accelerations of the last step."""


def scattered(
    model: mujoco.MjModel, places: np.ndarray, rng: np.random.Generator, gap: float = 0.02
) -> np.ndarray:
    """Return qpos with each robot over one of the places (places, 3), turned at random.

    Args:
        model: The model.
        places: Points relative to the arena's floor.
        rng: Source of the turns.
        gap: Largest height of a robot's lowest point above its place [m].
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    robots = [j for j in free if model.tree_dofnum[model.dof_treeid[model.jnt_dofadr[j]]] > 6]
    qpos, floor = model.qpos0.copy(), data.geom("floor").xpos[2]
    for joint, place in zip(robots, places, strict=False):
        root, at = model.jnt_bodyid[joint], model.jnt_qposadr[joint]
        touching = (model.geom_contype | model.geom_conaffinity) != 0
        geoms = touching & (model.body_rootid[model.geom_bodyid] == root)
        turn = data.geom_xmat[geoms].reshape(-1, 3, 3)
        middle = data.geom_xpos[geoms] + (turn @ model.geom_aabb[geoms, :3, None])[..., 0]
        low = (middle - (np.abs(turn) @ model.geom_aabb[geoms, 3:, None])[..., 0])[:, 2].min()
        qpos[at : at + 3] = place
        qpos[at + 2] = floor + place[2] + model.qpos0[at + 2] - low + rng.uniform(0.0, gap)
        yaw = rng.uniform(-np.pi, np.pi)
        qpos[at + 3 : at + 7] = np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)
    return qpos


def random_states(
    model: mujoco.MjModel, places: np.ndarray, count: int, seed: int, steps: int = 20, force: float = 3.0
) -> list[State]:
    """Return states under random controls from the places on, `steps` physics steps apart."""
    rng, data, found = np.random.default_rng(seed), mujoco.MjData(model), []
    data.qpos[:] = scattered(model, places, rng)
    for _ in range(count):
        data.ctrl[:] = rng.uniform(-force, force, model.nu)
        mujoco.mj_step(model, data, steps)
        found.append((data.qpos.copy(), data.qvel.copy(), data.ctrl.copy(), data.qacc_warmstart.copy()))
    return found


def solve_in_c(model: mujoco.MjModel, state: State) -> mujoco.MjData:
    """Return the data of a state after C MuJoCo's forward dynamics."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:], data.qacc_warmstart[:] = state
    mujoco.mj_forward(model, data)
    return data


def error(model: mujoco.MjModel, data: mujoco.MjData, found: np.ndarray) -> float:
    """Return the error of accelerations in the norm of the mass matrix.

    It is relative to the largest of the accelerations with constraints, without them, and a tenth of that
    from the force of any single row: opposite forces of robots in each other exceed their sum by far.
    """
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)

    def norm(value: np.ndarray) -> float:
        return float(np.sqrt(value @ mass @ value))

    pushed = jacobian(model, data) * data.efc_force[:, None]
    single = np.sqrt((pushed * np.linalg.solve(mass, pushed.T).T).sum(1)).max(initial=0.0)
    return norm(found - data.qacc) / max(norm(data.qacc), norm(data.qacc_smooth), 0.1 * single)


def roll_out(
    model: mujoco.MjModel, qpos: np.ndarray, ctrl: np.ndarray, steps: int, block: bool
) -> mujoco.MjData:
    """Return C MuJoCo's data after some steps, whose constraint forces solver `block` finds if asked.

    Positions and velocities then follow from its accelerations.
    """
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = qpos, ctrl
    for _ in range(steps):
        if not block:
            mujoco.mj_step(model, data)
            continue
        mujoco.mj_forward(model, data)
        found = solved_alone(model, [data]).qacc.numpy()[0]
        data.qacc[:] = data.qacc_warmstart[:] = found
        mujoco.mj_Euler(model, data)
    return data


def islands_of(model: mujoco.MjModel, solved: list[mujoco.MjData]) -> np.ndarray:
    """Return the first tree of the island that each tree belongs to (worlds, trees)."""
    problem = make_problem(model_of(model), data_of(model, solved))
    wp.launch(islands_kernel(CLASSES), dim=len(solved) * THREADS, inputs=[problem], block_dim=THREADS)
    return problem.roots.numpy().reshape(len(solved), model.ntree)
