"""Solver `block` of engine `warp`: each group of robots and objects that touch is solved to convergence.

`why_not` says which scenes it covers; MuJoCo Warp's solver takes the others. `islands` sorts the constraint
rows of a world by the kinematic trees that they couple, and `newton` solves each of these islands: both are
native code, for a GPU's threads and for a CPU. `solver` makes kernels of them and launches them. Begin with
`solver.solve`, which takes the place of MuJoCo Warp's function of that name. `broad_phase` finds the pairs of
geoms that may touch.
"""

import mujoco

MOST_TREES = 4095
"""Most kinematic trees of a world."""


def why_not(model: mujoco.MjModel) -> str | None:
    """Return what a model has that the solver does not cover, or None."""
    option = model.opt
    uncovered = {
        "tendons": model.ntendon > 0,
        "flexes": model.nflex > 0,
        "noslip iterations": option.noslip_iterations > 0,
        "sleeping trees": bool(option.enableflags & int(mujoco.mjtEnableBit.mjENBL_SLEEP)),
        f"more than {MOST_TREES} kinematic trees": model.ntree > MOST_TREES,
        "an integrator other than Euler's": option.integrator != int(mujoco.mjtIntegrator.mjINT_EULER),
    }
    return next((name for name, present in uncovered.items() if present), None)
