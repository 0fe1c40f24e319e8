"""A suite: tasks and settings in which methods are compared, on buildings that are fixed.

A suite's file is that of a sweep without policies. A method is one or more runs; each run plays all cells of
the suite, and its scores make one results file (`results`). `validation` is the split to choose by, `test`
the one to report.
"""

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, TextIO

from usarmjx.base.errors import UsageError
from usarmjx.base.settings import Setting, default_reader, read_file
from usarmjx.base.type_guards import is_list, is_mapping
from usarmjx.sweeps.contents import key_name
from usarmjx.sweeps.drivers import policy_of_run, rename_run
from usarmjx.sweeps.resolve import resolve
from usarmjx.sweeps.results import RunResult, provenance, run_digest
from usarmjx.sweeps.run import run_sweep
from usarmjx.sweeps.spec import SPLITS_OF_SUITES, SweepSpec, read_spec, rename_keys
from usarmjx.sweeps.store import CellRecord
from usarmjx.sweeps.workers import Workers
from usarmjx.train.task_names import newest_name

USUAL_SUITE = "teams-v1"


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
    levels = resolve({**whole, "policy": "random", "episodes": 1}).levels
    return {**whole, "arena.count": -(-episodes // levels)}


def load_suite(path: Path) -> BenchmarkSuite:
    """Read a suite's file.

    Raises:
        UsageError: It cannot be read, or something in it is not allowed; names file, line, key and limits.
    """
    given = read_file(path)
    plain: dict[str, Any] = given.plain()
    text = json.dumps(_with_key_names(plain), sort_keys=True, default=str)
    file = default_reader().from_data(SuiteFile, given)
    file = replace(file, **{name: rename_keys(getattr(file, name), newest_name) for name in ("zero", "one")})
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
    # Cells are kept by code and machine: results name one of each, so they hold no cell of another.
    kept = hashlib.sha256(json.dumps(origin, sort_keys=True).encode()).hexdigest()[:12]
    place = folder / "cells" / f"{suite.name}-{split}-{kept}"
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
