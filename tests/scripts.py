"""Programs that tests start: their search path, and the examples, scripts outside the package, as modules."""

import importlib
import importlib.util
import os
import sys
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
IN_PACKAGE = {"usarsim_client": "usarmjx.client", "wander": "usarmjx.client.wander"}


def python_path(*folders):
    """PYTHONPATH with these folders before what this process was given, which may hold our dependencies."""
    return os.pathsep.join([*map(str, folders), *filter(None, [os.environ.get("PYTHONPATH")])])


def load(name):
    """Import an example by path, once; the client library and its controller are the package's.

    One of a folder, `marl/ippo`, is known by its last name, as those beside it import it.
    """
    if name in IN_PACKAGE:
        return importlib.import_module(IN_PACKAGE[name])
    known = Path(name).name
    if known not in sys.modules:
        spec = importlib.util.spec_from_file_location(known, EXAMPLES / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        sys.modules[known] = module
        spec.loader.exec_module(module)
    return sys.modules[known]
