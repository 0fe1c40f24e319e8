"""Standings of methods in a suite: tables per task and over all tasks, and the leaderboard page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import (
    Estimate,
    Resampler,
    Table,
    improvement_interval,
    interquartile_interval,
    mean_interval,
    profile_intervals,
)
from usarmjx.base.files import atomic_write
from usarmjx.base.settings.files import shown
from usarmjx.sweeps.design import DRIVERS
from usarmjx.sweeps.drivers import RANDOM, policy_of_run, runs_code
from usarmjx.sweeps.play import BatchWork, play_batch
from usarmjx.sweeps.report import aligned, as_words
from usarmjx.sweeps.spec import find_suite
from usarmjx.sweeps.store import CellRecord
from usarmjx.sweeps.suite import BenchmarkSuite, RunResult, load_suite, read_results, run_digest

THRESHOLDS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Normalised scores at which tables give the performance profile."""
NOT_COMPARED = (*DRIVERS, "episodes", "arena.count")
"""Settings that cells of one place in a suite may differ in."""
SettingKey = str
"""Settings of a cell that methods share, as text."""
INTRODUCTION = """# Leaderboard

`usarmjx suite leaderboard` writes this page from the results files in [leaderboard](../leaderboard). Each
file is one run of a method in a suite, with commit, card, versions, settings, seeds and all scores. To add a
method, play it on split `test`, put the files of all its runs into that folder, write the page anew
and open a pull request:

```console
$ usarmjx suite run my-method runs/mine-0 runs/mine-1 runs/mine-2 --split test --out leaderboard
$ usarmjx suite leaderboard leaderboard --out docs/leaderboard.md
```

Use split `validation` to choose settings and checkpoints. All runs of a method count, not the best. Policies
must be in the checkout or in the package, so that `usarmjx suite replay FILE` can play three buildings of
each entry again. [sweeps.md](sweeps.md#suites) explains the columns.
"""


@dataclass(frozen=True, kw_only=True)
class TaskStanding:
    """Result of a method in a task.

    Attributes:
        task: The task.
        method: The method.
        scores: Scores as the task gives them (runs, settings, buildings).
        shares: Scores as shares between those that count as 0 and 1; None: these have no results.
        metrics: Means of the reported metrics, by name.
        seconds: Time of an episode, without compilation [s].
    """

    task: str
    method: str
    scores: Table
    shares: Table | None
    metrics: Mapping[str, float]
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Standings:
    """Results of a suite.

    Attributes:
        suite: Name of the suite.
        split: Split of the buildings.
        rows: A row for each task and method.
        notes: Remarks for readers.
        missing: Methods that count as 0 or 1 and have no results here.
    """

    suite: str
    split: str
    rows: tuple[TaskStanding, ...]
    notes: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()

    @property
    def tasks(self) -> list[str]:
        """The tasks."""
        return list(dict.fromkeys(row.task for row in self.rows))

    @property
    def methods(self) -> list[str]:
        """The methods."""
        return list(dict.fromkeys(row.method for row in self.rows))

    def tables(self, method: str) -> list[Table] | None:
        """Return the normalised scores of a method in all tasks; None: it lacks one, or they are unknown."""
        mine = {row.task: row.shares for row in self.rows if row.method == method}
        tables = [mine.get(task) for task in self.tasks]
        return [one for one in tables if one is not None] if all(one is not None for one in tables) else None


def standings_of(results: Sequence[RunResult], suite: BenchmarkSuite) -> Standings:
    """Return the standings of results of one suite and split.

    Cells that a method lacks are left out for all methods of the task.

    Raises:
        UsageError: Results of several splits or of another version of the suite; names the first.
    """
    for one in results:
        # Another version of a suite has other tasks or buildings, so its scores do not compare.
        if (one.suite, one.suite_digest) != (suite.name, suite.digest):
            raise UsageError(
                f"{one.method}, run {one.run}: results of suite {one.suite} ({one.suite_digest}), "
                f"expected {suite.name} ({suite.digest})"
            )
    splits = sorted({one.split for one in results})
    if len(splits) != 1:
        raise UsageError(f"results of the splits {' and '.join(splits)}: give those of one")
    rows: list[TaskStanding] = []
    for task in dict.fromkeys(cell.settings["task"] for one in results for cell in one.cells):
        rows += _of_task(task, results, suite)
    anchors = [one for one in (suite.file.zero, suite.file.one) if isinstance(one, str)]
    return Standings(
        suite=suite.name,
        split=splits[0],
        rows=tuple(rows),
        notes=_notes(results),
        missing=tuple(one for one in anchors if one not in {row.method for row in rows}),
    )


def _notes(results: Sequence[RunResult]) -> tuple[str, ...]:
    found = [f"{one.method}: {one.note}" for one in results if one.note]
    found += [cell.note for one in results for cell in one.cells if cell.note]
    for what in ("commit", "card"):
        kinds = sorted({getattr(one, what) for one in results})
        if len(kinds) > 1:
            found.append(f"computed with more than one {what}: {', '.join(kinds)}")
    # Many cells of a run carry the same note.
    return tuple(dict.fromkeys(found))


def _of_task(task: str, results: Sequence[RunResult], suite: BenchmarkSuite) -> list[TaskStanding]:
    by_method: dict[str, list[dict[SettingKey, CellRecord]]] = {}
    for one in results:
        cells = {key_of_settings(cell): cell for cell in one.cells if cell.settings["task"] == task}
        if cells:
            by_method.setdefault(one.method, []).append(cells)
    first, *others = (set(run) for runs in by_method.values() for run in runs)
    shared = first.intersection(*others)
    if not shared:
        raise UsageError(f"{task}: the methods have no settings in common")
    # Sorted: a set of texts has another order in each process, and with it the tables.
    keys = sorted(shared)
    tables = {method: _table(runs, keys) for method, runs in by_method.items()}
    # As many buildings as all have, from the first on: the order of buildings is fixed, so these are the
    # same.
    width = min(table.shape[2] for table in tables.values())
    tables = {method: table[..., :width] for method, table in tables.items()}
    anchors = [_anchor(getattr(suite.file, name), task, tables) for name in ("zero", "one")]
    rows: list[TaskStanding] = []
    for method, runs in by_method.items():
        cells = [run[key] for run in runs for key in keys]
        rows.append(
            TaskStanding(
                task=task,
                method=method,
                scores=tables[method],
                shares=_shares(task, tables[method], anchors),
                metrics=_metrics(cells),
                seconds=float(np.mean([_seconds(cell) for cell in cells])),
            )
        )
    return rows


def key_of_settings(cell: CellRecord) -> SettingKey:
    """Return the settings of a cell that methods share, as text."""
    return repr(sorted((name, one) for name, one in cell.settings.items() if name not in NOT_COMPARED))


def _table(runs: Sequence[Mapping[SettingKey, CellRecord]], keys: Sequence[SettingKey]) -> Table:
    """Return the scores of runs (runs, settings, buildings); NaN where the physics failed."""
    width = min(len(run[key].scores) for run in runs for key in keys)
    # NaN, not left out: tables keep their shape, and means skip it.
    return np.array(
        [[np.where(run[key].bad, np.nan, run[key].scores)[:width] for key in keys] for run in runs], float
    )


def _anchor(given: str | Mapping[str, float], task: str, tables: Mapping[str, Table]) -> np.ndarray | None:
    """Return the score that counts as 0 or 1 (settings, 1); None: it is not known."""
    if isinstance(given, str):
        # Over runs and buildings, but for each setting: settings differ in difficulty.
        return np.nanmean(tables[given], (0, 2))[:, None] if given in tables else None
    return np.array([[float(given[task])]]) if task in given else None


def _shares(task: str, table: Table, anchors: Sequence[np.ndarray | None]) -> Table | None:
    zero, one = anchors
    if zero is None or one is None:
        return None
    if (one == zero).any():
        raise UsageError(f"{task}: the scores for 0 and 1 are alike, so no share lies between them")
    return (table - zero) / (one - zero)


def _metrics(cells: Sequence[CellRecord]) -> dict[str, float]:
    first, *others = (set(cell.metrics) for cell in cells)
    names = first.intersection(*others)
    return {
        name: float(np.mean([np.mean([cell.metrics[name][i] for i in cell.good]) for cell in cells]))
        for name in sorted(names)
    }


def _seconds(cell: CellRecord) -> float:
    # Compilation depends on the cache and on the batch's other cells.
    return max(cell.seconds - cell.compile_seconds, 0.0) / max(len(cell.scores), 1)


def standings_report(found: Standings, how: Resampler | None = None) -> str:
    """Return the standings as Markdown tables."""
    lines = [f"{found.suite}, split {found.split}", *(f"note: {note}" for note in found.notes)]
    for task in found.tasks:
        lines += ["", f"**{task}**", "", *_task_table([one for one in found.rows if one.task == task], how)]
    tables = {method: own for method in found.methods if (own := found.tables(method)) is not None}
    if not tables:
        why = f"no results of {' and '.join(found.missing)}" if found.missing else "no method has all tasks"
        return "\n".join([*lines, "", f"no normalised scores: {why}"])
    ranked = sorted(tables, key=lambda method: -interquartile_interval(tables[method], how).value)
    head = ["method", "runs", "interquartile mean", "mean", *(f"above {one:g}" for one in THRESHOLDS)]
    rows = [_total_row(method, tables[method], how) for method in ranked]
    lines += ["", "**all tasks**, normalised", "", *aligned(head, rows)]
    if pairs := list(combinations(ranked, 2)):
        rows = [
            [one, other, as_words(improvement_interval(tables[one], tables[other], how))]
            for one, other in pairs
        ]
        lines += ["", *aligned(["method", "against", "probability of improvement"], rows)]
    return "\n".join(lines)


def _task_table(rows: Sequence[TaskStanding], how: Resampler | None) -> list[str]:
    names = sorted({name for row in rows for name in row.metrics})
    head = ["method", "runs", "settings", "buildings", "score", "normalised", *names, "s an episode"]
    body: list[list[str]] = []
    for row in sorted(rows, key=lambda row: -float(np.nanmean(row.scores))):
        share = "" if row.shares is None else as_words(interquartile_interval([row.shares], how))
        metrics = [f"{row.metrics[name]:.3g}" if name in row.metrics else "" for name in names]
        counts = [str(count) for count in row.scores.shape]
        score = as_words(interquartile_interval([row.scores], how))
        body.append([row.method, *counts, score, share, *metrics, f"{row.seconds:.2g}"])
    return aligned(head, body)


def _total_row(method: str, tables: Sequence[Table], how: Resampler | None) -> list[str]:
    found: list[Estimate] = [interquartile_interval(tables, how), mean_interval(tables, how)]
    found += profile_intervals(tables, THRESHOLDS, how)
    return [method, str(min(one.shape[0] for one in tables)), *map(as_words, found)]


def standings_record(found: Standings, how: Resampler | None = None) -> dict[str, Any]:
    """Return the standings as JSON can hold them."""
    rows = [
        {
            "task": row.task,
            "method": row.method,
            "runs": row.scores.shape[0],
            "settings": row.scores.shape[1],
            "buildings": row.scores.shape[2],
            "score": vars(interquartile_interval([row.scores], how)),
            "normalised": None if row.shares is None else vars(interquartile_interval([row.shares], how)),
            "metrics": dict(row.metrics),
            "seconds_per_episode": row.seconds,
        }
        for row in found.rows
    ]
    totals = {
        method: vars(interquartile_interval(tables, how))
        for method in found.methods
        if (tables := found.tables(method)) is not None
    }
    return {"suite": found.suite, "split": found.split, "rows": rows, "all": totals, "notes": found.notes}


def leaderboard_page(results: Sequence[RunResult]) -> str:
    """Return the page of results, suite by suite; split `test` only.

    Raises:
        UnknownNameError: A suite that is not bundled.
        UsageError: Results of another version of a suite.
    """
    lines = [INTRODUCTION.rstrip()]
    # Scores on split `validation` may have been chosen by, and do not count.
    played = [one for one in results if one.split == "test"]
    for name in sorted({one.suite for one in played}):
        own, suite = [one for one in played if one.suite == name], load_suite(find_suite(name))
        text = standings_report(standings_of(own, suite))
        # The report's first line names suite and split, which the heading does here.
        lines += ["", f"## {name}", "", suite.file.about, "", *text.splitlines()[1:], "", "**runs**", ""]
        head = ["method", "run", "commit", "card", "jax", "when", "policies"]
        lines += aligned(head, [_run_row(one) for one in own])
    return "\n".join(lines) + "\n"


def _run_row(one: RunResult) -> list[str]:
    # A policy for all tasks has the same hash in each of them.
    hashes = ", ".join(dict.fromkeys(one.policies.values()))
    jax = str(one.versions.get("jax", ""))
    return [one.method, f"`{one.run}`", one.commit, one.card, jax, one.when[:10], hashes]


def write_leaderboard(folder: Path, page: Path) -> None:
    """Write the page of the results in a folder.

    Raises:
        UsageError: See `leaderboard_page` and `results.read_results`.
        WriteError: The page cannot be written.
    """
    text = leaderboard_page(read_results([folder]))
    with atomic_write(page) as fresh:
        fresh.write_text(text, encoding="utf-8")


@dataclass(frozen=True, kw_only=True)
class ReplayedCell:
    """Episodes of a cell that were played again.

    Attributes:
        task: The task.
        settings: Those of the cell.
        before: Scores in the results (episodes,).
        after: Scores now (episodes,).
        same_buildings: Whether the buildings are the same.
    """

    task: str
    settings: dict[str, object]
    before: np.ndarray
    after: np.ndarray
    same_buildings: bool

    @property
    def largest(self) -> float:
        """Largest difference of an episode's scores."""
        return float(np.max(np.abs(self.after - self.before)))


def check_origin(result: RunResult, suite: BenchmarkSuite, run: str | None = None) -> None:
    """Refuse a result that does not fit its suite or its policies, or names code that the user has not named.

    Other people write results: a function or a client in a result is their code.

    Args:
        result: The result.
        suite: Its suite.
        run: Run that the user has named; None: none.

    Raises:
        UsageError: Says what does not fit, or names the option for the run.
    """
    if result.suite_digest != suite.digest:
        raise UsageError(f"{result.method}: results of suite {result.suite_digest}, this is {suite.digest}")
    # By a policy that needs no file: only the tasks are wanted.
    tasks = {cell["task"] for cell in suite.spec(result.split, result.method, [RANDOM]).cells}
    for cell in result.cells:
        task = cell.settings["task"]
        if task not in tasks:
            raise UsageError(f"{result.method}: suite {suite.name} has no task {shown(task)}")
        # `replay` plays the policy of the cell; the checks below look at the policy of the run.
        if cell.settings["policy"] != policy_of_run(result.run, task):
            raise UsageError(f"{result.method}, {task}: is not played by the run {shown(result.run)}")
    for task in dict.fromkeys(cell.settings["task"] for cell in result.cells):
        policy = policy_of_run(result.run, task)
        # A result is written by others: it must not choose which code runs on this machine.
        if run != result.run and runs_code(policy):
            raise UsageError(
                f"{result.method}: names the run {shown(result.run)}, whose code it does not run by itself; "
                f"if you trust that code, name it: --run {shown(result.run)}"
            )
        if result.policies.get(task) != run_digest(result.run, task):
            raise UsageError(f"{result.method}, {task}: the policy of {shown(result.run)} has changed")


def replay(
    result: RunResult,
    suite: BenchmarkSuite,
    episodes: int = 3,
    cells: Sequence[int] | None = None,
    run: str | None = None,
) -> list[ReplayedCell]:
    """Play the first episodes of a run again.

    Args:
        result: The run.
        suite: Its suite.
        episodes: Number of episodes of each cell.
        cells: Numbers of the cells; None: the first cell of each task.
        run: The run, if that is a function or a client; None: results do not run code.

    Raises:
        UsageError: See `check_origin`; or a cell fails.
    """
    check_origin(result, suite, run)
    tasks = [cell.settings["task"] for cell in result.cells]
    chosen = [tasks.index(task) for task in dict.fromkeys(tasks)] if cells is None else list(cells)
    found: list[ReplayedCell] = []
    for number in chosen:
        cell = result.cells[number]
        settings: dict[str, Any] = {**cell.settings, "episodes": min(episodes, len(cell.scores))}
        work = BatchWork(
            group=f"replay {cell.key}",  # a compiled group is kept by this name
            cells=((cell.key, settings),),
            kin=(settings,),
            size=1,
            engine=cell.engine,
        )
        (now,) = play_batch(work)
        if now.failed is not None:
            raise UsageError(f"{result.method}, {settings['task']}: {now.failed}")
        count: int = settings["episodes"]
        # Scores compare in the same buildings only, and a newer generator may draw others.
        found.append(
            ReplayedCell(
                task=settings["task"],
                settings=settings,
                before=np.array(cell.scores[:count], float),
                after=np.array(now.scores, float),
                same_buildings=tuple(cell.buildings[:count]) == tuple(now.buildings),
            )
        )
    return found
