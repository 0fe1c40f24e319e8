"""What of the GPU's kernels is in use here: the one place that decides, and that says so."""

from functools import cache
from importlib.util import find_spec
from typing import Literal

import jax

CasterName = Literal["pallas", "warp", "jax"]
PREFERRED: tuple[CasterName, ...] = ("pallas", "warp")
"""Casters for GPUs, the fastest first."""
ROADS = {"pallas": "jax.experimental.pallas.triton", "warp": "warp"}
"""The modules they stand on. JAX has announced that it will remove the first."""


def _there(name: str) -> bool:
    try:
        return find_spec(ROADS[name]) is not None
    except ModuleNotFoundError:  # a package above it is gone
        return False


@cache
def caster_in_use() -> CasterName:
    """Return what casts rays here: `pallas` (`raycast_gpu`), `warp` (`raycast_warp`) or `jax` (`raycast`).

    On GPUs it is the first of `PREFERRED` that is there; on anything else, and without either, plain JAX.
    """
    if jax.default_backend() != "gpu":
        return "jax"
    return next((name for name in PREFERRED if _there(name)), "jax")


@cache
def counts_on_warp() -> bool:
    """Return whether the radio counts walls on Warp here: on GPUs where that is installed."""
    return jax.default_backend() == "gpu" and _there("warp")
