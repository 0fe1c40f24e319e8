"""A suite: tasks and settings in which methods are compared on fixed buildings; results files.

A suite's file is that of a sweep without policies. A method is one or more runs; each run plays all cells of
the suite, and its scores make one results file. `validation` is the split to choose by, `test`
the one to report.
"""

import hashlib
import json
import platform
import re
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, TextIO

import jax
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.settings import Setting, default_reader, read_file
from usarmjx.base.settings.files import is_list, is_mapping
from usarmjx.base.settings.json_file import kept_text, read_kept
from usarmjx.recording.inputs import versions
from usarmjx.sweeps.contents import key_name, policy_digest
from usarmjx.sweeps.drivers import find_driver, policy_of_run, rename_run, script_of
from usarmjx.sweeps.resolve import resolve
from usarmjx.sweeps.run import run_sweep
from usarmjx.sweeps.spec import SPLITS_OF_SUITES, SweepSpec, read_spec, rename_keys, rename_tasks
from usarmjx.sweeps.store import CellRecord
from usarmjx.sweeps.workers import Workers
from usarmjx.train.task_names import newest_name, recorded_name

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
        # Names of methods may hold anything, but not all of it is allowed in names of files.
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
    # Versions stand once in the whole result, and `run_suite` refuses cells that failed.
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
    # Results come from others: a fault shows here with its file, not in a table later.
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
        # Sorted, as the order of a folder differs between machines.
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
        # Many systems name no processor.
        "processor": platform.processor() or platform.machine(),
        "versions": versions(),
    }


def commit_here() -> str:
    """Return the commit of this package's code, with `+` if it has changes; `unknown` without a checkout."""
    # Of the code's folder, not the working directory, which may be another checkout.
    git = ["git", "-C", str(Path(__file__).parent)]
    try:
        # -uno: files that git does not know, as results, are no change of the code.
        words = [
            subprocess.run([*git, *more], capture_output=True, text=True, check=True, timeout=10).stdout
            for more in (("rev-parse", "--short=12", "HEAD"), ("status", "--porcelain", "-uno"))
        ]
    except (OSError, subprocess.SubprocessError):
        # An installed package is in no repository, and a machine may have no git.
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
    # Planners and clients have neither weights nor code of their own: their names count.
    if driver.source is None and script_of(policy) is None:
        kept = rename_tasks({"policy": policy}, key_name)["policy"]
        code = hashlib.sha256(repr(kept).encode()).hexdigest()
    return code[:HASH_LENGTH]


@dataclass(frozen=True, kw_only=True)
class SuiteEpisodes:
    """Episodes of each cell, by split.

    Attributes:
        validation: Episodes of split `validation`.
        test: Episodes of split `test`.
    """

    validation: Annotated[int, Setting(ge=1)] = 24
    test: Annotated[int, Setting(ge=1)] = 48


@dataclass(frozen=True, kw_only=True)
class SuiteFile:
    """A suite's file.

    Attributes:
        about: Purpose of the suite, in a sentence.
        episodes: Episodes of each cell, by split.
        common: Settings of all cells, as in a sweep.
        product: Values by setting, of which all combinations are played.
        list: Settings of cells, one after the other.
        zero: Score by task that counts as 0, or the method whose results count as 0.
        one: Score by task that counts as 1, or the method whose results count as 1.
    """

    about: str = ""
    episodes: SuiteEpisodes = field(default_factory=SuiteEpisodes)
    common: Any = None
    product: Any = None
    list: Any = None
    zero: str | Mapping[str, float]
    one: str | Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class BenchmarkSuite:
    """A suite.

    Attributes:
        name: Name of its file.
        digest: Hash of its contents: results of another suite of that name do not compare.
        file: Contents of its file.
    """

    name: str
    digest: str
    file: SuiteFile

    def spec(self, split: str, method: str, runs: Sequence[str], **common: Any) -> SweepSpec:  # noqa: ANN401
        """Return the sweep in which a method plays the suite.

        Args:
            split: `validation` or `test`.
            method: Name of the method.
            runs: Its runs, see `drivers.policy_of_run`.
            common: Settings that replace those of all cells, as `engine`.

        Raises:
            UsageError: Another split, no run, or settings that do not go together.
        """
        if split not in SPLITS_OF_SUITES:
            raise UsageError(f"split {split!r}, expected one of {', '.join(SPLITS_OF_SUITES)}")
        if not runs:
            raise UsageError(f"method {method} has no run")
        file, episodes = self.file, getattr(self.file.episodes, split)
        data: dict[str, Any] = {
            "about": file.about,
            "common": {
                **(file.common or {}),
                "episodes": episodes,
                "split": split,
                "method": {"name": method, "runs": [rename_run(run) for run in runs]},
            },
        }
        data |= {name: one for name in ("product", "list") if (one := getattr(file, name))}
        spec = read_spec(data, self.name, common)
        return replace(spec, cells=tuple(_cell(cell, episodes) for cell in spec.cells))


def _cell(settings: dict[str, Any], episodes: int) -> dict[str, Any]:
    """Return a cell whose buildings do not depend on how many of its episodes are played."""
    whole = {**settings, "policy": policy_of_run(str(settings["policy"]), settings["task"])}
    # By a policy that needs no file: only the number of levels is wanted.
    levels = resolve({**whole, "policy": "random", "episodes": 1}).levels
    # Rounded up: each level has at least as many buildings as episodes.
    return {**whole, "arena.count": -(-episodes // levels)}


def load_suite(path: Path) -> BenchmarkSuite:
    """Read a suite's file.

    Raises:
        UsageError: It cannot be read, or something in it is not allowed; names file, line, key and limits.
    """
    given = read_file(path)
    plain: dict[str, Any] = given.plain()
    # Of the contents with old names of tasks, so that renaming one leaves the digest.
    text = json.dumps(_with_key_names(plain), sort_keys=True, default=str)
    file = default_reader().from_data(SuiteFile, given)
    file = replace(file, **{name: rename_keys(getattr(file, name), newest_name) for name in ("zero", "one")})
    # As plain data: `spec` joins them with settings that have no lines of a file.
    parts = {name: plain.get(name) for name in ("common", "product", "list")}
    digest = hashlib.sha256(text.encode()).hexdigest()[:12]
    return BenchmarkSuite(name=path.stem, digest=digest, file=replace(file, **parts))


def _with_key_names(data: Any) -> Any:  # noqa: ANN401 - whatever YAML has
    """Return a suite's contents with the names of tasks that its digest has, see `contents.key_name`."""
    if is_mapping(data):
        return {_with_key_names(key): _with_key_names(value) for key, value in data.items()}
    if is_list(data):
        return [_with_key_names(one) for one in data]
    return key_name(data) if isinstance(data, str) else data


def _cells_name(suite: BenchmarkSuite, split: str, method: str, origin: Mapping[str, Any]) -> str:
    """Return the name of the folder in which a method's cells of a suite are kept."""
    # Cells are kept by code and machine: results name one of each, so they hold no cell of another.
    kept = hashlib.sha256(json.dumps(origin, sort_keys=True).encode()).hexdigest()[:12]
    # A folder for each method, so that two can be played at once: a sweep's list of cells is one file.
    apart = hashlib.sha256(method.encode()).hexdigest()[:12]
    return f"{suite.name}-{split}-{kept}-{apart}"


def run_suite(  # noqa: PLR0913 - all but four may be left out
    suite: BenchmarkSuite,
    split: str,
    method: str,
    runs: Sequence[str],
    folder: Path,
    *,
    workers: Workers | None = None,
    say: Callable[[str], None] | None = None,
    stream: TextIO | None = None,
    note: str = "",
    **common: Any,  # noqa: ANN401 - settings of any kind
) -> list[Path]:
    """Play a method through a suite, and write a results file for each of its runs.

    Args:
        suite: The suite.
        split: `validation` or `test`.
        method: Name of the method in tables.
        runs: Its runs, see `BenchmarkSuite.spec`.
        folder: Folder of the results files; cells that are played are kept below, in `cells`.
        workers: Place to play it; None: here.
        say: Receives the lines of the plan.
        stream: Stream of progress; None: none.
        note: Remark for readers of the results.
        common: Settings that replace those of all cells. They stand in the results.

    Returns:
        The files, in the order of the runs.

    Raises:
        UsageError: See `BenchmarkSuite.spec`; or a cell failed: names the first.
        WriteError: The folder cannot be written to.
    """
    spec = suite.spec(split, method, runs, **common)
    origin = provenance()
    place = folder / "cells" / _cells_name(suite, split, method, origin)
    found = run_sweep(spec, place, workers, say=say, stream=stream)
    if failed := [one for one in found.records if one.failed is not None]:
        raise UsageError(f"{len(failed)} of {len(spec.cells)} cells failed, the first: {failed[0].failed}")
    files: list[Path] = []
    for number, run in enumerate(map(rename_run, runs)):
        own = records_of_run(found.finished, run)
        result = RunResult(
            suite=suite.name,
            suite_digest=suite.digest,
            split=split,
            method=method,
            run=run,
            note=note,
            when=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            policies={task: run_digest(run, task) for task in {one.settings["task"] for one in own}},
            cells=tuple(own),
            **origin,
        )
        files.append(folder / result.file_name(number))
        result.write(files[-1])
    return files


def records_of_run(records: Sequence[CellRecord], run: str) -> list[CellRecord]:
    """Return the cells that a run of a method played."""
    return [one for one in records if one.settings["policy"] == policy_of_run(run, one.settings["task"])]
