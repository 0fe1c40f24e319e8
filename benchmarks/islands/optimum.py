"""MuJoCo's constraint problem in double precision, for states in which solvers differ.

It says whether an error is the solver's or that of rows in single precision.
"""

# pyright: reportAttributeAccessIssue=false

from typing import Any

import mujoco
import numpy as np

from benchmarks.islands.rows import jacobian

MOST_ITERATIONS = 200
_ROW = mujoco.mjtConstraint


class Problem:
    """Accelerations that minimise the deviation from the unconstrained ones plus the costs of constraints.

    Args:
        model: A model that `rows.exact` changed.
        data: State after C MuJoCo's forward dynamics, as of `rows.data_of`.
        single: Whether all numbers are rounded to single precision, as the solver gets them.
    """

    def __init__(self, model: mujoco.MjModel, data: Any, single: bool) -> None:  # noqa: ANN401
        def taken(value: Any) -> np.ndarray:  # noqa: ANN401
            return np.asarray(value, np.float32 if single else float).astype(float)

        self.mass = np.zeros((model.nv, model.nv))
        rows = np.repeat(np.arange(model.nv), model.M_rownnz)
        columns = model.M_colind[: len(rows)]
        self.mass[rows, columns] = self.mass[columns, rows] = taken(data.M)
        self.smooth, self.rows = taken(data.qfrc_smooth), taken(jacobian(model, data))
        self.weight, self.aim, self.bound = (
            taken(getattr(data, f"efc_{name}")) for name in ("D", "aref", "frictionloss")
        )
        kind = np.asarray(data.efc_type)
        self._two_sided = kind == int(_ROW.mjCNSTR_EQUALITY)
        self._rubs = (kind == int(_ROW.mjCNSTR_FRICTION_DOF)) | (kind == int(_ROW.mjCNSTR_FRICTION_TENDON))
        elliptic = np.flatnonzero(kind == int(_ROW.mjCNSTR_CONTACT_ELLIPTIC))
        self._plain = np.setdiff1d(np.arange(len(kind)), elliptic)
        friction, dim = taken(data.contact.friction), np.asarray(data.contact.dim)
        self._cones = []
        for contact in np.unique(np.asarray(data.efc_id)[elliptic]):
            rows = elliptic[np.asarray(data.efc_id)[elliptic] == contact]
            mu = float(taken(friction[contact, 0] * taken(model.opt.impratio**-0.5)))
            self._cones.append((rows, mu, np.array([mu, *friction[contact, : dim[contact] - 1]])))

    def _terms(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the cost of the constraints, their forces and the Hessian, given J a - aref."""
        rows = self._plain
        value, stiff, most = x[rows], self.weight[rows], self.bound[rows]
        slides = self._rubs[rows] & (np.abs(stiff * value) > most)
        idle = ~self._two_sided[rows] & ~self._rubs[rows] & (value >= 0.0)
        force, hessian = np.zeros_like(x), np.zeros((len(x), len(x)))
        force[rows] = np.where(idle, 0.0, np.where(slides, -np.sign(value) * most, -stiff * value))
        hessian[rows, rows] = np.where(idle | slides, 0.0, stiff)
        linear = most * (np.abs(value) - 0.5 * most / stiff)
        cost = np.where(idle, 0.0, np.where(slides, linear, 0.5 * stiff * value**2)).sum()
        for rows, mu, scale in self._cones:
            u, weight = x[rows] * scale, self.weight[rows]
            slip = float(np.linalg.norm(u[1:]))
            if u[0] >= mu * slip:
                continue
            if mu * u[0] + slip <= 0.0:
                force[rows], hessian[rows, rows] = -weight * x[rows], weight
                cost += 0.5 * (weight * x[rows] ** 2).sum()
                continue
            stiff, gap = weight[0] / (mu**2 * (1.0 + mu**2)), u[0] - mu * slip
            along = u[1:] / slip
            down = np.concatenate([[1.0], -mu * along]) * scale
            bend = np.zeros((len(rows), len(rows)))
            bend[1:, 1:] = -mu / slip * (np.eye(len(along)) - np.outer(along, along))
            force[rows] = -stiff * gap * down
            hessian[np.ix_(rows, rows)] = stiff * (np.outer(down, down) + gap * bend * np.outer(scale, scale))
            cost += 0.5 * stiff * gap**2
        return float(cost), force, hessian

    def _cost(self, a: np.ndarray) -> float:
        return float(0.5 * a @ self.mass @ a - self.smooth @ a) + self._terms(self.rows @ a - self.aim)[0]

    def optimum(self, a: np.ndarray) -> np.ndarray:
        """Return the accelerations of least cost (nv,), by Newton's method from some on."""
        for _ in range(MOST_ITERATIONS):
            _, force, hessian = self._terms(self.rows @ a - self.aim)
            slope = self.mass @ a - self.smooth - self.rows.T @ force
            step = -np.linalg.solve(self.mass + self.rows.T @ hessian @ self.rows, slope)
            fall, alpha, cost = float(-slope @ step), 1.0, self._cost(a)
            if not fall > 1e-24 * max(float(a @ self.mass @ a), 1e-6):
                break
            while alpha > 1e-9 and not self._cost(a + alpha * step) < cost - 1e-4 * alpha * fall:
                alpha *= 0.5
            if alpha <= 1e-9:
                a = a + step  # roundings of the cost hide the fall
                if fall < 1e-16 * max(float(a @ self.mass @ a), 1e-6):
                    break
                continue
            a = a + alpha * step
        return a
