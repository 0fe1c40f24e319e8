"""MJX prints nothing when Warp is missing: the standard output belongs to commands."""

import builtins
import subprocess
import sys

import pytest

import dev
from tests.scripts import python_path
from usarmjx.base.errors import MissingExtraError, extra

WITHOUT_WARP = """
import os, sys, builtins
sys.modules["warp"] = None
usual = builtins.print
{imports}
from mujoco.mjx.warp import WARP_INSTALLED
assert not WARP_INSTALLED and builtins.print is usual
print("said")
"""


IMPORTS = {
    "MJX": "import usarmjx.engines.mjx",
    "a library of a training": """from usarmjx.base.errors import extra
with extra("train"):
    from brax.training.distribution import NormalTanhDistribution""",
}


@pytest.mark.parametrize("imports", IMPORTS.values(), ids=IMPORTS)
def test_nothing_is_printed_where_warp_is_missing(imports):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_WARP.format(imports=imports)],
        capture_output=True,
        text=True,
        env={"PYTHONPATH": python_path(dev.ROOT), "JAX_PLATFORMS": "cpu", "NPROC": "8"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "said\n"


def test_imports_that_overlap_or_fail_leave_print_as_it_was(capsys):
    usual = builtins.print
    one, other = extra("train"), extra("rl")
    one.__enter__()
    other.__enter__()
    one.__exit__(None, None, None)
    print("Failed to import warp: gone")
    print("kept")
    other.__exit__(None, None, None)
    assert builtins.print is usual
    assert capsys.readouterr().out == "kept\n"
    with pytest.raises(MissingExtraError), extra("train"):
        import no_such_library  # noqa: F401 # pyright: ignore[reportMissingImports, reportUnusedImport]
    assert builtins.print is usual
