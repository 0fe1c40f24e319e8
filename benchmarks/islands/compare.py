"""Errors of accelerations against C MuJoCo's, island by island."""

# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

GRAVITY = 9.81
LEAST = 1e-6
"""Least square of an acceleration in the norm of the mass matrix that errors are relative to."""


class Norms:
    """Squares of accelerations in the norm of the mass matrix, by kinematic tree.

    Args:
        model: The model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._row = np.repeat(np.arange(model.nv), model.M_rownnz)
        self._column = model.M_colind[: len(self._row)]
        self._twice = np.where(self._row == self._column, 1.0, 2.0)
        self._of_tree = np.eye(model.ntree)[model.dof_treeid[self._row]]

    def by_tree(self, mass: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the squares (states, trees).

        Args:
            mass: Mass matrices as C MuJoCo has them (states, numbers).
            values: Accelerations (states, nv).
        """
        parts = mass * self._twice * values[:, self._row] * values[:, self._column]
        return parts @ self._of_tree


def islands_of(model: mujoco.MjModel, data: Any) -> np.ndarray:  # noqa: ANN401 - as of `rows.data_of`
    """Return the number of the island of each tree (trees,)."""
    count = int(data.efc_J_rownnz[: data.nefc].sum())
    rows = np.repeat(np.arange(data.nefc), data.efc_J_rownnz[: data.nefc])
    trees = model.dof_treeid[data.efc_J_colind[:count]]
    size = data.nefc + model.ntree
    pairs = coo_matrix((np.ones(count), (rows, data.nefc + trees)), shape=(size, size))
    return connected_components(pairs, directed=False)[1][data.nefc :]


def errors(model: mujoco.MjModel, solved: Sequence[Any], found: np.ndarray) -> np.ndarray:
    """Return the largest error of an island of each state (states,).

    It is the length of the difference to C MuJoCo's accelerations, relative to the longer of the
    accelerations with and without constraints; lengths are the island's, in the norm of its mass matrix.

    Args:
        model: The model.
        solved: States after C MuJoCo's forward dynamics, as of `rows.data_of`.
        found: Accelerations (states, nv).
    """
    norms, mass = Norms(model), np.stack([data.M for data in solved])
    right = np.stack([data.qacc for data in solved])
    smooth = np.stack([data.qacc_smooth for data in solved])
    squares = [norms.by_tree(mass, value) for value in (found - right, right, smooth)]
    worst = np.zeros(len(solved))
    for k, data in enumerate(solved):
        island = islands_of(model, data)
        wrong, one, other = (np.bincount(island, square[k]) for square in squares)
        worst[k] = np.sqrt(np.nan_to_num(wrong / np.maximum(np.maximum(one, other), LEAST), nan=np.inf)).max()
    return worst


def root_errors(model: mujoco.MjModel, solved: Sequence[Any], found: np.ndarray) -> np.ndarray:
    """Return the largest error of the linear acceleration of a free body of each state (states,).

    It is relative to that acceleration or gravity, whichever is more. The motors of a robot have no part in
    it, unlike in `errors`. Arguments as there.
    """
    free = model.jnt_dofadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE][:, None] + np.arange(3)
    right = np.stack([data.qacc for data in solved])[:, free]
    size = np.maximum(np.linalg.norm(right, axis=-1), GRAVITY)
    wrong = np.linalg.norm(found[:, free] - right, axis=-1) / size
    return np.nan_to_num(wrong, nan=np.inf).max(-1, initial=0.0)
