"""Which of the casters is in use: the one place that decides, and that says so."""

from functools import cache
from importlib.util import find_spec
from typing import Literal

import jax

CasterName = Literal["warp", "pallas", "jax"]


@cache
def caster_in_use() -> CasterName:
    """Return what casts rays here: `warp` (`raycast_warp`), `pallas` (`raycast_gpu`) or `jax` (`raycast`).

    On GPUs it is Warp where that is installed, else Pallas, whose backend for them JAX will remove; on
    anything else plain JAX.
    """
    if jax.default_backend() != "gpu":
        return "jax"
    return "pallas" if find_spec("jax.experimental.pallas.triton") is not None else "warp"
