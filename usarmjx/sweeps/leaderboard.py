"""The leaderboard page of results files, and the replay of entries."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.settings.files import shown
from usarmjx.sweeps.drivers import RANDOM, policy_of_run, runs_code
from usarmjx.sweeps.play import BatchWork, play_batch
from usarmjx.sweeps.report import aligned
from usarmjx.sweeps.results import RunResult, read_results, run_digest
from usarmjx.sweeps.spec import find_suite
from usarmjx.sweeps.standings import standings_of, standings_report
from usarmjx.sweeps.suite import BenchmarkSuite, load_suite

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


def leaderboard_page(results: Sequence[RunResult]) -> str:
    """Return the page of results, suite by suite; split `test` only.

    Raises:
        UnknownNameError: A suite that is not bundled.
        UsageError: Results of another version of a suite.
    """
    lines = [INTRODUCTION.rstrip()]
    played = [one for one in results if one.split == "test"]
    for name in sorted({one.suite for one in played}):
        own, suite = [one for one in played if one.suite == name], load_suite(find_suite(name))
        text = standings_report(standings_of(own, suite))
        lines += ["", f"## {name}", "", suite.file.about, "", *text.splitlines()[1:], "", "**runs**", ""]
        head = ["method", "run", "commit", "card", "jax", "when", "policies"]
        lines += aligned(head, [_run_row(one) for one in own])
    return "\n".join(lines) + "\n"


def _run_row(one: RunResult) -> list[str]:
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
    tasks = {cell["task"] for cell in suite.spec(result.split, result.method, [RANDOM]).cells}
    for cell in result.cells:
        task = cell.settings["task"]
        if task not in tasks:
            raise UsageError(f"{result.method}: suite {suite.name} has no task {shown(task)}")
        if cell.settings["policy"] != policy_of_run(result.run, task):
            raise UsageError(f"{result.method}, {task}: is not played by the run {shown(result.run)}")
    for task in dict.fromkeys(cell.settings["task"] for cell in result.cells):
        policy = policy_of_run(result.run, task)
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
