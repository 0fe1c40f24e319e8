"""Drivers of a cell's robots: baselines, trained policies, a user's own functions, or clients over TCP."""

import importlib.util
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from usarmjx.base.errors import UsageError
from usarmjx.base.settings.files import is_mapping
from usarmjx.sweeps.spec import rename_policy
from usarmjx.train.baselines import BASELINES, PLANNERS
from usarmjx.train.baselines.planners import ORACLE
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import Policy
from usarmjx.train.evaluation.yardsticks import random_policy
from usarmjx.train.make import find_baseline
from usarmjx.train.policies import POLICIES
from usarmjx.train.policies.sources import (
    PolicySource,
    check_own_policy,
    load_policy,
    own_policy,
    split_own_policy,
)
from usarmjx.train.task_names import is_own, newest_name, policy_name

BASELINE, PACKAGED, RANDOM = "baseline", "packaged", "random"
KINDS = ("baseline", "run", "file", "python", "client")
"""Keys of a policy that is a mapping."""
PREFIXES = ("baseline", "client", "run")
"""Kinds that a policy given as text may begin with, as `baseline:explore-v2`."""


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
        knows: Whether the robots know the building and hear all, see `planners.knowing`.
    """

    shape: Hashable
    make: Callable[[Env, Any], Policy] | None = None
    weights: Any = field(default=())
    command: str | None = None
    speed: float = 1.0
    source: PolicySource | None = None
    knows: bool = False


def parse_policy(text: str) -> str | dict[str, str]:
    """Return a sweep's setting `policy` of a run: with `client:`, `baseline:` or `run:` a mapping."""
    kind, colon, rest = text.partition(":")
    return {kind: rest} if colon and kind in PREFIXES and rest else text


def rename_run(run: str, rename: Callable[[str], str] = newest_name) -> str:
    """Return a method's run with the full name of a task that it names."""
    kind, colon, rest = run.partition(":")
    return f"{kind}:{rename(rest)}" if colon and kind == BASELINE else policy_name(run, rename)


def policy_of_run(run: str, task: str) -> str | dict[str, str]:
    """Return the setting `policy` of a method's run in a task, whose name replaces `{task}`."""
    return parse_policy(run.replace("{task}", task))


def _said(policy: object) -> tuple[str, str, Mapping[str, Any]]:
    """Return kind and argument of a setting `policy`, and its further entries.

    Raises:
        UsageError: It is none.
    """
    policy = rename_policy(policy)
    if isinstance(policy, str):
        if policy in (BASELINE, PACKAGED, RANDOM):
            return policy, "", {}
        if policy in PLANNERS:
            return BASELINE, policy, {}
        if ".py:" in policy:
            return "python", policy, {}
        return ("run" if Path(policy).is_dir() else "file"), policy, {}
    if is_mapping(policy) and (kind := str(next(iter(policy), ""))) in KINDS:
        more = {str(key): value for key, value in policy.items() if key != kind}
        allowed = {"run": ("checkpoint",), "client": ("speed",)}.get(kind, ())
        if isinstance(policy[kind], str) and set(more) <= set(allowed):
            return kind, policy[kind], more
    raise UsageError(
        f"policy is {policy!r}, expected {BASELINE}, {PACKAGED}, {RANDOM}, {', '.join(PLANNERS)}, a run's "
        f"folder, an exported file, file.py:function, or one of {', '.join(KINDS)} as {{kind: which}}"
    )


def runs_code(policy: object) -> bool:
    """Return whether a setting `policy` names a program, or a module to import.

    Raises:
        UsageError: See `find_driver`.
    """
    kind, what, _ = _said(policy)
    return kind in ("client", "python") or (kind == BASELINE and is_own(what))


def find_driver(policy: object, task: str) -> CellDriver:
    """Return the driver that a setting `policy` names.

    Args:
        policy: The setting.
        task: Name of the cell's task.

    Raises:
        UsageError: There is none, or it is broken.
    """
    kind, what, more = _said(policy)
    task = newest_name(task)
    if kind == "client":
        speed = more.get("speed", 1.0)
        # To Python True is a number: it must not pass for a speed of 1.
        if isinstance(speed, bool) or not isinstance(speed, int | float) or speed <= 0:
            raise UsageError(f"policy: speed is {speed!r}, expected simulated seconds per second, above 0")
        return CellDriver(shape=("client", what), command=what, speed=float(speed))
    if kind == "python":
        check_own_policy(what)  # so that a plan says what is missing
        return CellDriver(shape=("python", what), make=lambda env, _: own_policy(what, env))
    if kind == RANDOM:
        return CellDriver(shape=RANDOM, make=lambda env, _: random_policy(env))
    if kind == BASELINE:
        name = find_baseline(what or task)
        baseline = BASELINES.get(name)
        # Names ignore case, and two spellings of a baseline share what is compiled.
        shape = ("baseline", name.lower())
        return CellDriver(shape=shape, make=lambda env, _: baseline(env), knows=name.lower() == ORACLE)
    if kind == PACKAGED and task not in POLICIES:
        raise UsageError(f"no policy for {task} comes with the package; known: {', '.join(POLICIES.names())}")
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

    shape = ("trained", learned.groups, learned.layers, learned.memory, learned.kind)
    return CellDriver(shape=shape, make=make, weights=weights, source=source)


def script_of(policy: object) -> Path | None:
    """Return the Python file of a policy that is a function; None: it is none, or in a package.

    Raises:
        UsageError: See `find_driver`.
    """
    kind, what, _ = _said(policy)
    if kind != "python":
        return None
    place, _, _ = split_own_policy(what)
    if place.endswith(".py"):
        return Path(place)
    # `find_spec` would import the package that a dotted name is in.
    found = importlib.util.find_spec(place) if "." not in place else None
    return None if found is None or found.origin is None else Path(found.origin)


def argument_of(policy: object) -> str:
    """Return the argument of a policy that is a function; empty: it has none, or is no function.

    Raises:
        UsageError: See `find_driver`.
    """
    kind, what, _ = _said(policy)
    return split_own_policy(what)[2] if kind == "python" else ""
