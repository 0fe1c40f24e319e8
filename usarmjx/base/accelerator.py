"""What of the GPU's kernels is in use here: the one place that decides, and that says so."""

from functools import cache
from importlib.util import find_spec
from typing import Literal

import jax

CasterName = Literal["warp", "pallas", "jax"]
PREFERRED: tuple[CasterName, ...] = ("warp", "pallas")
"""Casters for GPUs, about as fast. JAX has announced that it will remove what `pallas` stands on, and Warp
compiles its kernels in seconds, once for all scenes, where Pallas takes seconds to a minute for each."""
ROADS = {"pallas": "jax.experimental.pallas.triton", "warp": "warp"}
"""The modules they stand on."""


def _there(name: str) -> bool:
    try:
        return find_spec(ROADS[name]) is not None
    except ModuleNotFoundError:  # a package above it is gone
        return False


@cache
def caster_in_use() -> CasterName:
    """Return what casts rays here: `warp` (`raycast_warp`), `pallas` (`raycast_gpu`) or `jax` (`raycast`).

    On GPUs it is the first of `PREFERRED` that is there; on anything else, and without either, plain JAX.
    """
    if jax.default_backend() != "gpu":
        return "jax"
    here: list[CasterName] = [name for name in PREFERRED if _there(name)]
    return here[0] if here else "jax"


@cache
def warp_in_use() -> bool:
    """Return whether kernels of Warp do here what JAX does elsewhere: on GPUs where that is installed.

    They count the radio's walls, find ways over maps and what is around robots of engine `planar`, and keep
    these apart.
    """
    return jax.default_backend() == "gpu" and _there("warp")
