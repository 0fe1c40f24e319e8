"""Policies that are a user's own function: `FILE.py:FUNCTION` or `MODULE:FUNCTION`, also with `@ARGUMENT`.

The function takes an environment and returns a `Policy`; with an argument, as the folder of a run, it takes
that text too. The folder of the file is searched for modules that it imports.
"""

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from usarmjx.base.errors import UsageError
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import Policy


def is_own_policy(what: str) -> bool:
    """Return whether a name is that of a function in a file."""
    return ".py:" in what


def split_own_policy(what: str) -> tuple[str, str, str]:
    """Return file or module, name of the function, and argument; the last is empty without one."""
    name, _, argument = what.partition("@")
    place, _, function = name.rpartition(":")
    return place, function, argument


def own_policy(what: str, env: Env) -> Policy:
    """Return the policy that a user's function makes for an environment.

    Raises:
        UsageError: There is no such function, or it returns something else.
    """
    function, (_, _, argument) = _function(what), split_own_policy(what)
    made = function(env, argument) if argument else function(env)
    if not isinstance(made, Policy):
        raise UsageError(f"policy {what} returned {type(made).__name__}, expected usarmjx's Policy")
    return made


def check_own_policy(what: str) -> None:
    """Import the function that a name stands for.

    Raises:
        UsageError: There is none.
    """
    _function(what)


def _function(what: str) -> Callable[..., object]:
    place, name, _ = split_own_policy(what)
    try:
        module = _module(place)
    except Exception as error:
        raise UsageError(f"policy {what}: cannot be imported: {error}") from error
    function = getattr(module, name, None)
    if not callable(function):
        raise UsageError(f"policy {what}: {place} has no function {name!r}")
    return function


def _module(place: str) -> ModuleType:
    if not place.endswith(".py"):
        return importlib.import_module(place)
    known = f"usarmjx_policy_{hashlib.sha256(Path(place).read_bytes()).hexdigest()[:16]}"
    if known not in sys.modules:
        folder = str(Path(place).resolve().parent)
        if folder not in sys.path:
            sys.path.append(folder)  # last, so that it hides no module
        spec = importlib.util.spec_from_file_location(known, place)
        assert spec is not None  # as the name ends in .py
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[known] = module  # dataclasses look their module up
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[known]
            raise
    return sys.modules[known]
