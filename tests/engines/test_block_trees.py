"""Factor and solve of the mass matrix beside solver `block`, against the matrix of C MuJoCo."""

from importlib import import_module
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

import warp as wp

from tests.engines.block_rows import random_states
from usarmjx.engines.block import trees
from usarmjx.sim.scene import build_scene

_MUJOCO: Any = mujoco  # more of it than its stubs have
ERROR = 1e-4
"""Of the product of the matrix and the solution, relative to the largest number of a world's right side:
single precision; inertias of a robot are some thousand times those of its camera."""


def worlds_of(model: mujoco.MjModel, robots: int) -> tuple[Any, Any, list[np.ndarray]]:
    """Return MuJoCo Warp's model and data of states of some robots, and C MuJoCo's mass matrices."""
    states = random_states(model, np.zeros((robots, 3)), 4, seed=2)
    mjw = import_module("mujoco.mjx.third_party.mujoco_warp")
    m, d = mjw.put_model(model), mjw.make_data(model, nworld=len(states))
    d.qpos.assign(np.array([qpos for qpos, *_ in states], np.float32))
    mjw.kinematics(m, d)
    mjw.com_pos(m, d)
    mjw.crb(m, d)
    masses = []
    for qpos, *_ in states:
        data, mass = mujoco.MjData(model), np.zeros((model.nv, model.nv))
        data.qpos[:] = qpos
        _MUJOCO.mj_fwdPosition(model, data)
        _MUJOCO.mj_fullM(model, data, mass)
        masses.append(mass)
    return m, d, masses


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("roster", "fits"), [(["P2AT", "P2DX"], True), (["Kenaf", "P2AT"], False)], ids=["small", "large"]
)
def test_solutions_are_those_of_the_matrix_of_c(roster: list[str], fits: bool):
    model = build_scene("yellow", roster).model
    m, d, masses = worlds_of(model, len(roster))
    assert trees.fits(m, d.qLD) == fits
    right = np.random.default_rng(0).normal(size=(len(masses), model.nv)).astype(np.float32)
    found = wp.zeros((len(masses), model.nv), dtype=float)
    trees.factor_solve(m, d, d.M, d.qLD, d.qLDiagInv, found, wp.array(right))
    for mass, solution, given in zip(masses, found.numpy().astype(float), right, strict=True):
        np.testing.assert_allclose(mass @ solution, given, atol=ERROR * np.abs(given).max())
