"""Constraint rows of C MuJoCo in the arrays of MuJoCo Warp, for the solver `block` alone."""

from importlib import import_module
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import warp as wp

from usarmjx.engines.block.islands import THREADS
from usarmjx.engines.block.solver import WARP_TYPES, islands_kernel, make_problem, solve

State = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Positions, velocities, controls and accelerations of the last step."""


def exact(model: mujoco.MjModel) -> mujoco.MjModel:
    """Make C MuJoCo's Newton solver converge to 1e-10."""
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    model.opt.iterations, model.opt.tolerance = 200, 1e-10
    model.opt.ls_iterations, model.opt.ls_tolerance = 100, 1e-6
    model.opt.disableflags |= (
        mujoco.mjtDisableBit.mjDSBL_ISLAND
    )  # with islands, the states of rows are in their order
    return model


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


def _array(rows: list[Any], kind: type = np.float32, size: int | None = None) -> Any:
    """Stack arrays of all worlds, with zeros behind those that are shorter than `size`."""
    rows = [np.asarray(row) for row in rows]
    length = max(1, size if size is not None else max(len(row) for row in rows))
    whole = np.zeros((len(rows), length, *rows[0].shape[1:]), kind)
    for mine, row in zip(whole, rows, strict=True):
        mine[: len(row)] = row
    return wp.array(whole, dtype=float if kind is np.float32 else int)


def model_of(model: mujoco.MjModel, sparse: bool = True) -> SimpleNamespace:
    """Return what the solver reads of MuJoCo Warp's model."""
    whole = {
        "dof_treeid": model.dof_treeid, "tree_dofadr": model.tree_dofadr, "tree_dofnum": model.tree_dofnum,
        "M_rownnz": model.M_rownnz, "M_rowadr": model.M_rowadr, "M_colind": model.M_colind,
    }  # fmt: skip
    arrays = {name: wp.array(np.asarray(value, np.int32), dtype=int) for name, value in whole.items()}
    impedance = wp.array(np.array([model.opt.impratio**-0.5], np.float32), dtype=float)
    option = SimpleNamespace(impratio_invsqrt=impedance, disableflags=model.opt.disableflags)
    return SimpleNamespace(**arrays, opt=option, ntree=model.ntree, nv=model.nv, is_sparse=sparse)


def data_of(model: mujoco.MjModel, solved: list[mujoco.MjData], sparse: bool = True) -> SimpleNamespace:
    """Return what the solver reads and writes of MuJoCo Warp's data, a world for each solved state."""
    rows = max(max(data.nefc for data in solved), 1)
    first = np.cumsum([0, *(data.ncon for data in solved)])
    dense = [jacobian(model, data) for data in solved]
    size = [(row != 0.0).sum(1) for row in dense]
    contacts = [contact for data in solved for contact in data.contact]
    ids = [
        np.where(
            data.efc_type >= int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS), data.efc_id + begin, 0
        )
        for data, begin in zip(solved, first, strict=False)
    ]
    addresses = np.array([contact.efc_address for contact in contacts] or [0], np.int32)
    frictions = np.array([contact.friction for contact in contacts] or [np.ones(5)], np.float32)
    values = [row[row != 0.0] for row in dense]
    efc = SimpleNamespace(
        type=_array([data.efc_type for data in solved], np.int32, rows),
        id=_array(ids, np.int32, rows),
        J_rownnz=_array(size, np.int32, rows),
        J_rowadr=_array([np.cumsum([0, *n])[:-1] for n in size], np.int32, rows),
        J_colind=wp.array(
            _array([np.nonzero(row)[1] for row in dense], np.int32).numpy()[:, None], dtype=int
        ),
        J=wp.array(_array(values).numpy()[:, None], dtype=float) if sparse else _array(dense, size=rows),
        D=_array([data.efc_D for data in solved], size=rows),
        aref=_array([data.efc_aref for data in solved], size=rows),
        frictionloss=_array([data.efc_frictionloss for data in solved], size=rows),
        force=_array([np.full(rows, np.nan)] * len(solved)),
        state=_array([np.full(rows, -1)] * len(solved), np.int32),
        Ma=_array([np.full(model.nv, np.nan)] * len(solved)),
    )
    contact = SimpleNamespace(
        dim=wp.array(np.array([contact.dim for contact in contacts] or [1], np.int32), dtype=int),
        efc_address=wp.array(addresses[:, None].copy(), dtype=int),
        friction=wp.array(frictions, dtype=import_module(WARP_TYPES).vec5),
    )
    return SimpleNamespace(
        nworld=len(solved),
        njmax=rows,
        nefc=wp.array(np.array([data.nefc for data in solved], np.int32), dtype=int),
        efc=efc,
        contact=contact,
        M=_array([data.M for data in solved]),
        qacc_smooth=_array([data.qacc_smooth for data in solved]),
        qfrc_smooth=_array([data.qfrc_smooth for data in solved]),
        qacc_warmstart=_array([data.qacc_warmstart for data in solved]),
        qacc=_array([np.full(model.nv, np.nan)] * len(solved)),
        qfrc_constraint=_array([np.full(model.nv, np.nan)] * len(solved)),
        solver_niter=wp.array(np.full(len(solved), -1, np.int32), dtype=int),
    )


def jacobian(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the dense Jacobian of the constraints (nefc, nv)."""
    dense = np.zeros((data.nefc, model.nv))
    if not mujoco.mj_isSparse(model):
        return data.efc_J.reshape(data.nefc, model.nv).copy()
    for k, (start, size) in enumerate(zip(data.efc_J_rowadr, data.efc_J_rownnz, strict=True)):
        dense[k, data.efc_J_colind[start : start + size]] = data.efc_J[start : start + size]
    return dense


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


def solved_alone(model: mujoco.MjModel, solved: list[mujoco.MjData], sparse: bool = True) -> SimpleNamespace:
    """Return the data of the worlds after the solver."""
    data = data_of(model, solved, sparse)
    solve(model_of(model, sparse), data)
    return data


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
    wp.launch(islands_kernel(), dim=len(solved) * THREADS, inputs=[problem], block_dim=THREADS)
    return problem.roots.numpy().reshape(len(solved), model.ntree)
