"""MJX prints nothing when Warp is missing: the standard output belongs to commands."""

import subprocess
import sys

import dev
from tests.scripts import python_path

WITHOUT_WARP = """
import os, sys, builtins
sys.modules["warp"] = None
usual = builtins.print
import usarmjx.engines.mjx
from mujoco.mjx.warp import WARP_INSTALLED
assert not WARP_INSTALLED and builtins.print is usual
print("said")
"""


def test_nothing_is_printed_where_warp_is_missing():
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_WARP],
        capture_output=True,
        text=True,
        env={"PYTHONPATH": python_path(dev.ROOT), "JAX_PLATFORMS": "cpu", "NPROC": "8"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "said\n"
