"""Constraint rows of contacts beside solver `block`, against those of MuJoCo Warp."""

from importlib import import_module
from typing import Any

import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

from tests.engines.block_rows import random_states
from usarmjx.engines.block import contact_rows
from usarmjx.models.compile.physics import Physics
from usarmjx.sim.scene import build_scene

ROUNDING = 1e-6
"""Relative to the largest number of an array: sums of three products, in single precision."""


def worlds() -> tuple[Any, Any]:
    """Return model and data of two robots that touch sometimes, whose contacts are found."""
    scene = build_scene("yellow", ["P2AT", "P2DX"], Physics(solver="block"))
    model: Any = scene.model
    model.opt.solver = 1
    x, y, _ = scene.arena.starts[0].at
    states = random_states(model, np.array([[x, y, 0.0], [x + 0.45, y + 0.1, 0.0]]), 6, seed=1)
    mjw = import_module("mujoco.mjx.third_party.mujoco_warp")
    model.opt.jacobian = 1  # sparse
    m = mjw.put_model(model)
    d = mjw.make_data(model, nworld=len(states), naconmax=1200, naccdmax=800, njmax=1500)
    d.qpos.assign(np.array([qpos for qpos, *_ in states], np.float32))
    d.qvel.assign(np.random.default_rng(0).normal(size=(len(states), model.nv)).astype(np.float32))
    mjw.kinematics(m, d)
    mjw.com_pos(m, d)
    mjw.collision(m, d)
    return m, d


def rows_of(d: Any, make: Any, m: Any) -> dict[str, np.ndarray]:
    """Return the rows that a function lists, by contact: rows of a world have another order each time."""
    names = ("type", "pos", "margin", "D", "vel", "aref", "frictionloss")
    for name in (*names, "J", "Jqvel"):
        getattr(d.efc, name).fill_(7)
    make(m, d)
    count, found = int(d.nacon.numpy()[0]), {name: [] for name in (*names, "id", "J", "columns")}
    address, world, dim = (x.numpy() for x in (d.contact.efc_address, d.contact.worldid, d.contact.dim))
    columns, jacobian = d.efc.J_colind.numpy(), d.efc.J.numpy()
    start, size = d.efc.J_rowadr.numpy(), d.efc.J_rownnz.numpy()
    for con in range(count):
        for row in address[con, : dim[con]]:
            if row < 0:
                continue
            for name in (*names, "id"):
                found[name].append(getattr(d.efc, name).numpy()[world[con], row])
            span = slice(start[world[con], row], start[world[con], row] + size[world[con], row])
            found["J"] += jacobian[world[con], 0, span].tolist()
            found["columns"] += columns[world[con], 0, span].tolist()
    return {name: np.array(value) for name, value in found.items()}


@pytest.mark.oracle
def test_rows_of_contacts_are_those_of_mujoco_warp():
    m, d = worlds()
    assert contact_rows.covers(m)
    constraint = import_module(contact_rows.CONSTRAINT)
    right = rows_of(d, constraint.make_constraint, m)
    found = rows_of(d, contact_rows.make_constraint, m)
    assert len(right["D"]) > 60
    assert (d.efc.Jqvel.numpy()[:, :1] != 7).all(), "speeds along rows are written, too"
    for name, value in right.items():
        most = ROUNDING * np.abs(value).max()
        np.testing.assert_allclose(
            found[name], value, rtol=1e-5 if name == "D" else 0, atol=most, err_msg=name
        )


def test_what_is_not_covered_is_left_to_mujoco_warp(monkeypatch: pytest.MonkeyPatch):
    """Pyramids, six rows of a contact, and all contacts if the kernel is switched off."""
    m, _ = worlds()
    for change in ({"nmaxcondim": 6}, {"is_sparse": False}, {"flg_adhesion": True}):
        for name, value in change.items():
            before = getattr(m, name)
            setattr(m, name, value)
            assert not contact_rows.covers(m)
            setattr(m, name, before)
    assert contact_rows.covers(m)
    monkeypatch.setattr(contact_rows, "ALONE", False)
    assert not contact_rows.covers(m)
