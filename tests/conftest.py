"""What all tests share: the pool size that keeps jax alive, and why a test is skipped."""

import gc
import os
import shutil
from collections.abc import Iterator

import pytest

# Before jax starts: on two cores two batched factorisations deadlock in its pool of two threads.
os.environ.setdefault("NPROC", "8")
# Most of the time of the tests goes into compiling for a CPU; unoptimised code is there a quarter sooner.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")

import jax

MUCH = 2.5e9
"""A process of tests shall not hold much more memory than this [bytes]."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip slow tests unless `-m` names them, and GPU tests where there is no GPU."""
    expression = config.getoption("markexpr")
    slow_wanted = "slow" in expression
    gpu_here = shutil.which("nvidia-smi") is not None
    for item in items:
        if item.get_closest_marker("slow") and not slow_wanted:
            item.add_marker(pytest.mark.skip(reason="slow; run with -m slow"))
        if item.get_closest_marker("gpu") and not gpu_here:
            item.add_marker(pytest.mark.skip(reason="no NVIDIA GPU on this machine"))


def resident() -> float:
    """Return the memory that this process holds [bytes]; 0 where the system does not tell."""
    try:
        with open("/proc/self/statm") as file:
            return float(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0.0


@pytest.fixture(autouse=True, scope="module")
def forget_what_is_compiled() -> Iterator[None]:
    """Drop what JAX has compiled when a process has grown large: all of it together takes 5 GB."""
    yield
    if resident() > MUCH:
        jax.clear_caches()
        gc.collect()
