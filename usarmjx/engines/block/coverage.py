"""Scenes that solver `block` covers."""

import mujoco

MOST_TREES = 4095
"""Most kinematic trees of a world."""


def why_not(model: mujoco.MjModel) -> str | None:
    """Return what a model has that the solver does not cover, or None."""
    option = model.opt
    uncovered = {
        "tendons": model.ntendon,
        "flexes": model.nflex,
        "noslip iterations": option.noslip_iterations,
        "sleeping trees": option.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP,
        f"more than {MOST_TREES} kinematic trees": model.ntree > MOST_TREES,
        "integrator RK4": option.integrator == mujoco.mjtIntegrator.mjINT_RK4,
        "the discrete integrator": int(option.integrator) > int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
    }
    return next((name for name, present in uncovered.items() if present), None)
