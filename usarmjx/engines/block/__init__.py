"""Solver `block` of engine `warp`: each group of robots and objects that touch is solved to convergence.

`why_not` says which scenes it covers; MuJoCo Warp's solver takes the others. `islands` sorts the constraint
rows of a world by the kinematic trees that they couple, and `newton` solves each of these islands: both are
native code, for a GPU's threads and for a CPU. `solver` makes kernels of them and launches them. Begin with
`solver.solve`, which takes the place of MuJoCo Warp's function of that name. `broad_phase` finds the pairs of
geoms that may touch.
"""

from typing import Any

import mujoco

MOST_TREES = 4095
"""Most kinematic trees of a world."""
ROW_BITS = 16
"""Bits of a row's index in a list of constraints; its number of rows is above them."""


def most_rows(model: mujoco.MjModel) -> int:
    """Return the most constraint rows of a world."""
    m: Any = model  # it has more than MuJoCo's stubs say
    elliptic = m.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    rows = int(max([1, *m.geom_condim, *m.pair_dim])) if elliptic else 1
    # The Hessian of a contact of n rows has n (n + 1) / 2 numbers; their places have `ROW_BITS`.
    return 2 * ((1 << ROW_BITS) - 1) // (rows + 1)


def why_not(model: mujoco.MjModel, rows: int = 0) -> str | None:
    """Return what a model has that the solver does not cover, or None.

    Args:
        model: The model.
        rows: Constraint rows that a world has room for.
    """
    option = model.opt
    uncovered = {
        "tendons": model.ntendon > 0,
        "flexes": model.nflex > 0,
        "noslip iterations": option.noslip_iterations > 0,
        "sleeping trees": bool(option.enableflags & int(mujoco.mjtEnableBit.mjENBL_SLEEP)),
        f"more than {MOST_TREES} kinematic trees": model.ntree > MOST_TREES,
        f"room for more than {most_rows(model)} constraint rows": rows > most_rows(model),
        "an integrator other than Euler's": option.integrator != int(mujoco.mjtIntegrator.mjINT_EULER),
    }
    return next((name for name, present in uncovered.items() if present), None)
