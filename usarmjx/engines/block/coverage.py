"""Scenes that solver `block` covers."""

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
