"""Contents of all that a cell reads, as the key of its result: a changed picture is another cell.

Whatever is resolved is hashed as it was resolved: buildings, arenas with their meshes and pictures, robots,
weights of policies. Scripts, which are code, are hashed with the modules beside them that they import.
"""

import ast
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.program_cache import fingerprint
from usarmjx.models.files.load import find_arena
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import RobotSpec
from usarmjx.recording.inputs import PACKAGES, versions
from usarmjx.sweeps.drivers import argument_of, script_of
from usarmjx.sweeps.resolve import Resolved, resolve
from usarmjx.sweeps.spec import EARLIER_POLICIES, CellSettings, rename_policy, rename_tasks
from usarmjx.train.envs.recipe import resolve_arenas, spec_of
from usarmjx.train.make import file_of
from usarmjx.train.task_names import RECORDED, newest_name

KEY_FORMAT = 2
"""Another number stands for other rules of what a cell plays: no result of earlier rules is found."""
KEY_LENGTH = 20
KEY_POLICIES = {name: earlier for earlier, name in EARLIER_POLICIES.items()}
"""Names of policies in keys, which are the earlier ones: results keep their keys."""
KEY_TASKS = {name: earlier for earlier, name in RECORDED.items()}
"""Names of tasks in keys, likewise."""


@dataclass(frozen=True)
class KnownDigests:
    """Digests that earlier cells computed.

    Attributes:
        named: Digests of policies and named arenas, by their names.
        robots: Teams and their digests: comparing a team is faster than hashing it.
    """

    named: dict[str, str] = field(default_factory=dict[str, str])
    robots: list[tuple[Sequence[str | RobotSpec], str]] = field(
        default_factory=list[tuple[Sequence[str | RobotSpec], str]]
    )


def key_name(task: str) -> str:
    """Return the name of a task in keys."""
    full = newest_name(task)
    return KEY_TASKS.get(full, full)


def key_of(settings: CellSettings, cell: Resolved | None = None, known: KnownDigests | None = None) -> str:
    """Return the name of a cell's result: a hash of its settings and of the contents of all that it reads.

    Args:
        settings: The settings; the name of a method is no part of the key.
        cell: Their meaning; None: it is resolved.
        known: Digests of earlier cells; those of this cell are added.

    Raises:
        UsageError: See `resolve`.
    """
    cell = resolve(settings) if cell is None else cell
    # The name of a method groups results, and changes none of them.
    own = rename_tasks({name: value for name, value in settings.items() if name != "method"}, key_name)
    own["policy"] = rename_policy(own["policy"], KEY_POLICIES)
    contents = cell_contents(cell, KnownDigests() if known is None else known)
    # Sorted: the order of settings in a file does not matter.
    text = json.dumps([KEY_FORMAT, own, contents], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:KEY_LENGTH]


def cell_contents(cell: Resolved, known: KnownDigests) -> dict[str, Any]:
    """Return digests of all that a cell reads, by what it is, and the versions of what computes it.

    Args:
        cell: The cell.
        known: Digests of earlier cells; those of this cell are added.

    Raises:
        UsageError: An arena that cannot be read.
    """
    task = cell.task
    found: dict[str, Any] = {
        "versions": {name: version for name, version in versions().items() if name in PACKAGES},
        "robots": _robots_digest(task.robots, known),
        "arena": list(cell.labels) or _arena_digest(task.arena, known.named, len(task.robots)),
        "policy": _policy_digest(cell, known),
    }
    own = file_of(cell.settings["task"])
    if own is not None and own.is_file():
        found["task"] = script_digest(own)
    return found


def _robots_digest(robots: Sequence[str | RobotSpec], known: KnownDigests) -> str:
    for team, digest in known.robots:
        if team == robots:
            return digest
    digest = fingerprint([spec_of(robot) for robot in robots])
    known.robots.append((robots, digest))
    return digest


def _policy_digest(cell: Resolved, known: KnownDigests) -> str:
    policy = cell.settings["policy"]
    # A word such as packaged stands for another policy in each task.
    name = f"policy: {cell.settings['task']}: {policy!r}"
    if name not in known.named:
        known.named[name] = policy_digest(policy, cell.driver.weights)
    return known.named[name]


def policy_digest(policy: object, weights: Any) -> str:  # noqa: ANN401 - a tree of arrays
    """Return a hash of what drives: weights, or the code of a function with the files of its argument.

    Args:
        policy: Setting `policy` of a cell.
        weights: Weights of a trained policy, as `find_driver` returns them.

    Raises:
        UsageError: A file cannot be read.
    """
    script, argument = script_of(policy), argument_of(policy)
    if script is None:
        leaves, tree = jax.tree.flatten(jax.tree.map(np.asarray, weights))
        return fingerprint(str(tree), leaves)
    # An empty argument would be the working folder, which exists.
    if not Path(argument).exists() or not argument:
        return script_digest(script)
    return hashlib.sha256((script_digest(script) + _files_digest(Path(argument))).encode()).hexdigest()


def _files_digest(place: Path) -> str:
    """Return a hash of a file, or of the files in a folder."""
    # Sorted, as file systems list files in orders of their own.
    files = sorted(one for one in place.rglob("*") if one.is_file()) if place.is_dir() else [place]
    try:
        rows = [(one.name, hashlib.sha256(one.read_bytes()).hexdigest()) for one in files]
    except OSError as error:
        raise UsageError(f"{place}: {error.strerror or error}") from error
    return hashlib.sha256(repr(rows).encode()).hexdigest()


def _arena_digest(arena: Any, known: dict[str, str], robots: int) -> str:  # noqa: ANN401 - a name or a spec
    if not isinstance(arena, str):
        return fingerprint(arena)
    if arena not in known:
        # The class counts for generated arenas only, which have labels.
        found = resolve_arenas(arena, "P2AT", robots)
        known[arena] = fingerprint(found if isinstance(found, ArenaSpec) else find_arena(arena))
    return known[arena]


def script_digest(path: Path) -> str:
    """Return a hash of a Python file and of those beside it that it imports, and so on.

    Raises:
        UsageError: It cannot be read.
    """
    found: dict[Path, str] = {}
    _read_script(path.absolute(), found)
    # Relative paths: the digest stays when the folder moves.
    rows = [(str(file.relative_to(path.absolute().parent)), text) for file, text in sorted(found.items())]
    return hashlib.sha256(repr(rows).encode()).hexdigest()


def _read_script(path: Path, found: dict[Path, str], top: Path | None = None) -> None:
    """Add the hash of a file, and of those in its folder that it imports."""
    top = path.parent if top is None else top
    if path in found:
        return
    try:
        source = path.read_bytes()
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror or error}") from error
    # Noted before its imports are followed: files that import each other would be read forever.
    found[path] = hashlib.sha256(source).hexdigest()
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):
        return  # importing it says so
    for node in ast.walk(tree):
        for name in _imports(node, path, top):
            parts = name.split(".")
            # Importing `a.b` runs `a/__init__.py`, too.
            for count in range(1, len(parts) + 1):
                base = top.joinpath(*parts[:count])
                for file in (base.with_suffix(".py"), base / "__init__.py"):
                    if file.is_file():
                        _read_script(file, found, top)


def _imports(node: ast.AST, path: Path, top: Path) -> list[str]:
    """Return the modules that a statement imports, by their names from the folder `top`."""
    if isinstance(node, ast.Import):
        return [one.name for one in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    base = node.module or ""
    if node.level:
        # One dot is the file's own folder, so the file's name is the first part to go.
        parents = path.relative_to(top).parts[: -node.level]
        base = ".".join([*parents, *([base] if base else [])])
    # A name that is imported from a package may be one of its modules.
    names = [f"{base}.{one.name}" if base else one.name for one in node.names]
    return [base, *names] if base else names
