"""Constraint rows of C MuJoCo in the arrays of MuJoCo Warp, for the solver `block` alone."""

# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import warp as wp

from usarmjx.engines.block.solver import WARP_TYPES, solve

ROW_FIELDS = (
    "type",
    "id",
    "D",
    "aref",
    "frictionloss",
    "force",
    "state",
    "J",
    "J_rownnz",
    "J_rowadr",
    "J_colind",
)
CONTACT_FIELDS = ("dim", "efc_address", "friction")
DOF_FIELDS = ("M", "qacc", "qacc_smooth", "qfrc_smooth", "qfrc_constraint", "qacc_warmstart")


def exact(model: mujoco.MjModel) -> mujoco.MjModel:
    """Make C MuJoCo's Newton solver converge to 1e-10, with sparse Jacobians."""
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    model.opt.iterations, model.opt.tolerance = 200, 1e-10
    model.opt.ls_iterations, model.opt.ls_tolerance = 100, 1e-6
    # With islands, the states of rows are in their order.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    return model


def keep(data: mujoco.MjData) -> SimpleNamespace:
    """Return copies of what `data_of` reads of a state after C MuJoCo's forward dynamics."""
    kept = {f"efc_{name}": getattr(data, f"efc_{name}").copy() for name in ROW_FIELDS}
    contact = {name: np.array(getattr(data.contact, name)) for name in CONTACT_FIELDS}
    dofs = {name: getattr(data, name).copy() for name in DOF_FIELDS}
    return SimpleNamespace(nefc=data.nefc, ncon=data.ncon, **kept, contact=SimpleNamespace(**contact), **dofs)


def _array(rows: Sequence[Any], kind: type = np.float32, size: int | None = None) -> Any:  # noqa: ANN401
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


def _jacobians(model: mujoco.MjModel, solved: Sequence[Any], sparse: bool, rows: int) -> dict[str, Any]:
    """Return the arrays of the Jacobians, with room for some rows."""
    worlds = len(solved)
    if sparse:
        values = {
            "J_rownnz": _array([data.efc_J_rownnz for data in solved], np.int32, rows),
            "J_rowadr": _array([data.efc_J_rowadr for data in solved], np.int32, rows),
            "J_colind": _array([data.efc_J_colind for data in solved], np.int32),
            "J": _array([data.efc_J for data in solved]),
        }
        return values | {name: values[name].reshape((worlds, 1, -1)) for name in ("J_colind", "J")}
    empty = wp.zeros((worlds, rows), dtype=int)
    columns = wp.zeros((worlds, 1, 1), dtype=int)
    dense = _array([jacobian(model, data) for data in solved], size=rows)
    return {"J_rownnz": empty, "J_rowadr": empty, "J_colind": columns, "J": dense}


def data_of(model: mujoco.MjModel, solved: Sequence[Any], sparse: bool = True) -> SimpleNamespace:
    """Return what the solver reads and writes of MuJoCo Warp's data.

    Args:
        model: A model that `exact` changed.
        solved: A world each: C MuJoCo's data, or what `keep` returned.
        sparse: Whether the Jacobian is.
    """
    worlds, rows = len(solved), max(1, *(data.nefc for data in solved))
    first = np.cumsum([0, *(data.ncon for data in solved)])
    of_contact = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS)
    ids = [
        np.where(data.efc_type >= of_contact, data.efc_id + begin, 0)
        for data, begin in zip(solved, first, strict=False)
    ]
    contacts = {
        name: np.concatenate(
            [np.asarray(getattr(data.contact, name)) for data in solved if data.ncon] or [one]
        )
        for name, one in (("dim", [1]), ("efc_address", [0]), ("friction", np.ones((1, 5))))
    }
    efc = SimpleNamespace(
        **_jacobians(model, solved, sparse, rows),
        type=_array([data.efc_type for data in solved], np.int32, rows),
        id=_array(ids, np.int32, rows),
        D=_array([data.efc_D for data in solved], size=rows),
        aref=_array([data.efc_aref for data in solved], size=rows),
        frictionloss=_array([data.efc_frictionloss for data in solved], size=rows),
        force=_array([np.full(rows, np.nan)] * worlds),
        state=_array([np.full(rows, -1)] * worlds, np.int32),
        Ma=_array([np.full(model.nv, np.nan)] * worlds),
    )
    contact = SimpleNamespace(
        dim=wp.array(contacts["dim"].astype(np.int32), dtype=int),
        efc_address=wp.array(contacts["efc_address"].astype(np.int32)[:, None].copy(), dtype=int),
        friction=wp.array(contacts["friction"].astype(np.float32), dtype=import_module(WARP_TYPES).vec5),
    )
    inputs = ("M", "qacc_smooth", "qfrc_smooth", "qacc_warmstart")
    return SimpleNamespace(
        nworld=worlds,
        njmax=rows,
        nefc=wp.array(np.array([data.nefc for data in solved], np.int32), dtype=int),
        efc=efc,
        contact=contact,
        **{name: _array([getattr(data, name) for data in solved]) for name in inputs},
        qacc=_array([np.full(model.nv, np.nan)] * worlds),
        qfrc_constraint=_array([np.full(model.nv, np.nan)] * worlds),
        solver_niter=wp.array(np.full(worlds, -1, np.int32), dtype=int),
    )


def jacobian(model: mujoco.MjModel, data: Any) -> np.ndarray:  # noqa: ANN401 - as of `data_of`
    """Return the dense Jacobian of the constraints (nefc, nv)."""
    dense = np.zeros((data.nefc, model.nv))
    rows = np.repeat(np.arange(data.nefc), data.efc_J_rownnz)
    dense[rows, data.efc_J_colind[: len(rows)]] = data.efc_J[: len(rows)]
    return dense


def solved_alone(model: mujoco.MjModel, solved: Sequence[Any], sparse: bool = True) -> SimpleNamespace:
    """Return the data of the worlds after the solver; arguments as of `data_of`."""
    data = data_of(model, solved, sparse)
    solve(model_of(model, sparse), data)
    return data
