"""Results files: scores of one run of a method in a suite, and all that is needed to play it again."""

import hashlib
import platform
import re
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.settings import default_reader
from usarmjx.base.settings.json_file import kept_text, read_kept
from usarmjx.recording.inputs import versions
from usarmjx.sweeps.contents import key_name, policy_digest
from usarmjx.sweeps.drivers import find_driver, policy_of_run, rename_run, script_of
from usarmjx.sweeps.spec import rename_keys, rename_tasks
from usarmjx.sweeps.store import CellRecord
from usarmjx.train.task_names import recorded_name

FORMAT = 1
MOST_RESULT_BYTES = 64_000_000
REPORTED = ("contacts", "bytes")
"""Metrics that results keep beside the score, of tasks that have them."""
DIGITS = 6
"""Significant digits of kept numbers."""
HASH_LENGTH = 16
"""Hexadecimal digits of a policy's hash."""
SUFFIX = ".result.json"


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """Scores of one run of a method in a suite.

    Attributes:
        suite: Name of the suite.
        suite_digest: Hash of its contents.
        split: Split of the buildings.
        method: Name of the method.
        run: The run, as it was named; `{task}` stands for the task of each cell.
        note: Remark for readers.
        when: Time of the end, in UTC.
        commit: Commit of the code, if it is a checkout; else `unknown`.
        card: Device that JAX computed on.
        processor: Processor.
        versions: Versions of what computed it.
        policies: Hash of the policy's weights or code, by task.
        cells: Scores of the cells.
    """

    suite: str
    suite_digest: str
    split: str
    method: str
    run: str
    note: str = ""
    when: str = ""
    commit: str = "unknown"
    card: str = ""
    processor: str = ""
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    policies: Mapping[str, str] = field(default_factory=dict[str, str])
    cells: tuple[CellRecord, ...] = ()

    def file_name(self, number: int) -> str:
        """Return the usual name of its file.

        Args:
            number: Number of the run among those of the method.
        """
        words = "-".join([self.suite, self.split, self.method, str(number)])
        return re.sub(r"[^a-z0-9.]+", "-", words.lower()).strip("-") + SUFFIX

    def write(self, file: Path) -> None:
        """Write it to a file.

        Raises:
            WriteError: It cannot be written.
        """
        content = {**vars(self), "format": FORMAT, "cells": [_kept(one) for one in self.cells]}
        with atomic_write(file) as fresh:
            fresh.write_text(kept_text(content, indent=None), encoding="utf-8")


def _kept(one: CellRecord) -> dict[str, Any]:
    """Return a cell as results keep it: the metrics in `REPORTED`, numbers with `DIGITS` digits."""
    row = asdict(one)
    row["scores"] = _short(one.scores)
    row["metrics"] = {name: _short(values) for name, values in one.metrics.items() if name in REPORTED}
    row["seconds"], row["compile_seconds"] = _short([one.seconds, one.compile_seconds])
    return {name: value for name, value in row.items() if name not in ("versions", "failed")}


def _short(values: Sequence[float]) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in values]


def read_result(file: Path) -> RunResult:
    """Read a results file.

    Raises:
        UsageError: It is missing, damaged, or no results file; names it.
    """
    content = read_kept(file, most=MOST_RESULT_BYTES)
    if content.pop("format", None) != FORMAT:
        raise UsageError(f"{file}: is no results file of this version (format {FORMAT})")
    found = default_reader().from_data(RunResult, content, where=str(file))
    result = replace(
        found,
        run=rename_run(found.run, recorded_name),
        policies=rename_keys(found.policies, recorded_name),
        cells=tuple(replace(one, settings=rename_tasks(one.settings, recorded_name)) for one in found.cells),
    )
    for number, one in enumerate(result.cells, 1):
        if fault := _fault(one):
            raise UsageError(f"{file}: cell {number}: {fault}")
    return result


def _fault(one: CellRecord) -> str:
    """Return what is wrong with a cell of a results file; empty: nothing."""
    if not isinstance(one.settings.get("task"), str) or "policy" not in one.settings:
        return "has no task or policy"
    rows = [one.steps, one.bad, *one.metrics.values(), *([one.buildings] if one.buildings else [])]
    if any(len(column) != len(one.scores) for column in rows):
        return "its rows have different numbers of episodes"
    return "" if np.isfinite(one.scores).all() else "a score is not finite"


def read_results(places: Sequence[Path]) -> list[RunResult]:
    """Return the results in files and folders, those of a folder by name.

    Raises:
        UsageError: No results there, or a broken file.
    """
    files: list[Path] = []
    for place in places:
        files += sorted(place.rglob(f"*{SUFFIX}")) if place.is_dir() else [place]
    if not files:
        raise UsageError(f"no results (*{SUFFIX}) in {', '.join(map(str, places))}")
    return [read_result(file) for file in files]


def provenance() -> dict[str, Any]:
    """Return commit, card, processor and versions of this computation."""
    (first, *_) = jax.devices()
    return {
        "commit": commit_here(),
        "card": first.device_kind,
        "processor": platform.processor() or platform.machine(),
        "versions": versions(),
    }


def commit_here() -> str:
    """Return the commit of this package's code, with `+` if it has changes; `unknown` without a checkout."""
    git = ["git", "-C", str(Path(__file__).parent)]
    try:
        words = [
            subprocess.run([*git, *more], capture_output=True, text=True, check=True, timeout=10).stdout
            for more in (("rev-parse", "--short=12", "HEAD"), ("status", "--porcelain", "-uno"))
        ]
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return words[0].strip() + ("+" if words[1].strip() else "")


def run_digest(run: str, task: str) -> str:
    """Return a hash of what drives in a task: weights, code, or the name of a planner or client.

    Raises:
        UsageError: There is no such policy.
    """
    policy = policy_of_run(run, task)
    driver = find_driver(policy, task)
    code = policy_digest(policy, driver.weights)
    if driver.source is None and script_of(policy) is None:
        kept = rename_tasks({"policy": policy}, key_name)["policy"]
        code = hashlib.sha256(repr(kept).encode()).hexdigest()
    return code[:HASH_LENGTH]
