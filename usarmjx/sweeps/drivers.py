"""Drivers of a cell's robots: baselines, trained policies, a user's own functions, or clients over TCP."""

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any

from usarmjx.base.errors import UsageError
from usarmjx.sweeps.spec import rename_policy
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import Policy
from usarmjx.train.evaluation.yardsticks import random_policy
from usarmjx.train.make import find_baseline
from usarmjx.train.policies import POLICIES
from usarmjx.train.policies.sources import PolicySource, load_policy

BASELINE, PACKAGED, RANDOM = "baseline", "packaged", "random"
KINDS = ("baseline", "run", "file", "python", "client")
"""Keys of a policy that is a mapping."""


@dataclass(frozen=True, kw_only=True)
class CellDriver:
    """Driver of the robots of a cell.

    Attributes:
        shape: Properties that are alike in a batch: all but the weights.
        make: Returns a policy for an environment, given the weights.
        weights: Of a trained policy: a tree of arrays; else empty.
        command: Of a client over TCP: how it is started; None: the policy acts in the batch.
        speed: Of a client: simulated seconds per second.
        source: Of a trained policy: where it comes from, and what it was trained on.
    """

    shape: Hashable
    make: Callable[[Env, Any], Policy] | None = None
    weights: Any = field(default=())
    command: str | None = None
    speed: float = 1.0
    source: PolicySource | None = None


def _said(policy: object) -> tuple[str, str, Mapping[str, Any]]:
    """Return kind and argument of a setting `policy`, and its further entries.

    Raises:
        UsageError: It is none.
    """
    policy = rename_policy(policy)
    if isinstance(policy, str):
        if policy in (BASELINE, PACKAGED, RANDOM):
            return policy, "", {}
        if ".py:" in policy:
            return "python", policy, {}
        return ("run" if Path(policy).is_dir() else "file"), policy, {}
    if isinstance(policy, Mapping) and (kind := str(next(iter(policy), ""))) in KINDS:
        more = {str(key): value for key, value in policy.items() if key != kind}
        allowed = {"run": ("checkpoint",), "client": ("speed",)}.get(kind, ())
        if isinstance(policy[kind], str) and set(more) <= set(allowed):
            return kind, policy[kind], more
    raise UsageError(
        f"policy is {policy!r}, expected {BASELINE}, {PACKAGED}, {RANDOM}, a run's folder, an exported file, "
        f"file.py:function, or one of {', '.join(KINDS)} as {{kind: which}}"
    )


def find_driver(policy: object, task: str) -> CellDriver:
    """Return the driver that a setting `policy` names.

    Args:
        policy: The setting.
        task: Name of the cell's task.

    Raises:
        UsageError: There is none, or it is broken.
    """
    kind, what, more = _said(policy)
    if kind == "client":
        speed = more.get("speed", 1.0)
        if isinstance(speed, bool) or not isinstance(speed, int | float) or speed <= 0:
            raise UsageError(f"policy: speed is {speed!r}, expected simulated seconds per second, above 0")
        return CellDriver(shape=("client", what), command=what, speed=float(speed))
    if kind == "python":
        _function(what)  # so that a plan says what is missing
        return CellDriver(shape=("python", what), make=lambda env, _: _own(what, env))
    if kind == RANDOM:
        return CellDriver(shape=RANDOM, make=lambda env, _: random_policy(env))
    if kind == BASELINE:
        name = find_baseline(what or task)
        baseline = BASELINES.get(name)
        return CellDriver(shape=("baseline", name.lower()), make=lambda env, _: baseline(env))
    if kind == PACKAGED and task not in POLICIES:
        raise UsageError(
            f"no policy for {task} comes with the package; there are: {', '.join(POLICIES.names())}"
        )
    checkpoint = str(more.get("checkpoint", "best"))
    source = load_policy(str(POLICIES.get(task)) if kind == PACKAGED else what, checkpoint)
    if kind == PACKAGED:
        source = replace(source, name=f"packaged policy of {task}")
    if source.learned is None:
        raise UsageError(
            f"policy {what}: a cell has one policy for all robots; a policy for each class is played by "
            "usarmjx eval and play"
        )
    learned, weights = source.learned

    def make(env: Env, weights: Any) -> Policy:  # noqa: ANN401 - a tree of arrays
        source.policy(env)  # which refuses other robots
        return learned.as_policy(weights)

    shape = ("trained", learned.groups, learned.layers, learned.memory)
    return CellDriver(shape=shape, make=make, weights=weights, source=source)


def _own(what: str, env: Env) -> Policy:
    made = _function(what)(env)
    if not isinstance(made, Policy):
        raise UsageError(f"policy {what} returned {type(made).__name__}, expected usarmjx's Policy")
    return made


def _function(what: str) -> Callable[[Env], object]:
    """Return the function that `file.py:function` or `module:function` names.

    Raises:
        UsageError: There is none.
    """
    place, _, name = what.rpartition(":")
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
    known = f"usarmjx_sweep_{hashlib.sha256(Path(place).read_bytes()).hexdigest()[:16]}"
    if known not in sys.modules:
        spec = importlib.util.spec_from_file_location(known, place)
        assert spec is not None  # as the name ends in .py
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        sys.modules[known] = module
    return sys.modules[known]


def script_of(policy: object) -> Path | None:
    """Return the Python file of a policy that is a function; None: it is none, or in a package.

    Raises:
        UsageError: See `find_driver`.
    """
    kind, what, _ = _said(policy)
    if kind != "python":
        return None
    place = what.rpartition(":")[0]
    if place.endswith(".py"):
        return Path(place)
    found = importlib.util.find_spec(place) if "." not in place else None
    return None if found is None or found.origin is None else Path(found.origin)
