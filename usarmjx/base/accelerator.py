"""The choice between kernels of Warp and plain JAX, made in one place and logged."""

import logging
from functools import cache
from importlib.util import find_spec

import jax

from usarmjx.base.installation import install_command

log = logging.getLogger(__name__)


@cache
def warp_in_use() -> bool:
    """Return whether kernels of Warp replace plain JAX: on GPUs where Warp is installed.

    They cast rays, count the radio's walls, find ways over maps and what is around robots of engine `planar`,
    and keep these apart.
    """
    if jax.default_backend() != "gpu":
        return False
    if find_spec("warp") is None:
        log.warning(
            "Warp is not installed: plain JAX casts rays on this GPU, which is slow; %s installs it",
            install_command("cuda"),
        )
        return False
    return True
