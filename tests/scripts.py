"""The examples as modules: they are scripts, and not part of the package."""

import importlib.util
import sys
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


def load(name):
    """Import an example by path, once; the others find the client library in `sys.modules`."""
    if name not in sys.modules:
        if name != "usarsim_client":
            load("usarsim_client")
        spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]
