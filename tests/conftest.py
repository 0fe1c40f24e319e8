"""What all tests share: the pool size that keeps jax alive, and why a test is skipped."""

import os
import shutil

import pytest

# Before jax starts: on two cores two batched factorisations deadlock in its pool of two threads.
os.environ.setdefault("NPROC", "8")


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
