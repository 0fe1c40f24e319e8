"""Reports of a run: a line of JSON per iteration, TensorBoard, a bar in the terminal."""

import itertools
import json
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from usarmjx.base.errors import UsageError, WriteError, quoted
from usarmjx.base.files import AppendedFile, atomic_write, writing
from usarmjx.base.progress import RateLimitedLog
from usarmjx.base.settings.files import shown
from usarmjx.base.settings.json_file import read_json_lines

IterationWatch = Callable[[dict[str, Any]], None]
"""Receives the record of each iteration."""


def find_wandb() -> Any:  # noqa: ANN401 - a package that may be missing
    """Return the module wandb.

    Raises:
        UsageError: It is missing.
    """
    try:
        import wandb  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise UsageError("Weights & Biases needs wandb: pip install wandb") from error
    return wandb


def wandb_watch(
    project: str, name: str, settings: Mapping[str, Any], say: Callable[[str], None]
) -> IterationWatch:
    """Return a watch that sends iterations to a project. A later failure is reported once.

    Args:
        project: Project of Weights & Biases.
        name: Name of the run; a resumed run continues under it.
        settings: Settings of the run.
        say: Takes a line.

    Raises:
        UsageError: wandb is missing, or cannot begin.
    """
    module = find_wandb()
    try:
        run = module.init(project=project, id=name, name=name, config=dict(settings), resume="allow")
    except Exception as error:  # of a service elsewhere
        raise UsageError(f"Weights & Biases: {quoted(error)}") from error
    failed: list[str] = []

    def watch(line: dict[str, Any]) -> None:
        numbers = {key: value for key, value in line.items() if value is not None}
        try:
            run.log(numbers, step=line["agent_steps"])
        except Exception as error:  # the training is worth more than its curve
            if not failed:
                say(f"note: Weights & Biases: {quoted(error)}; training goes on")
            failed.append(quoted(error))

    return watch


PER_EPISODE = ("return", "score", "length")


REQUIRED = ("iteration", "agent_steps", "steps_per_s")
"""Numbers above 0 that each record has; `score` is a number or None."""


def summary(sums: dict[str, float], world_steps: int) -> dict[str, float | None]:
    """Return means from sums over an iteration; None where no episode ended.

    Args:
        sums: As `Rollout` counts them, and the update's own numbers (`loss/...`).
        world_steps: Steps of all worlds in the iteration.
    """
    episodes = sums["episodes"]

    def mean(value: float) -> float | None:
        return value / episodes if episodes else None

    record: dict[str, float | None] = {"episodes": episodes}
    for name in PER_EPISODE:
        record[name] = mean(sums[name])
    record["timeouts"] = mean(sums["timeouts"])
    record["bad"] = sums["bad"] / world_steps
    for name, value in sorted(sums.items()):
        if name.startswith("end/"):
            record[name] = mean(value)
        elif name.startswith("step/"):
            record[name] = value / world_steps
        elif name.startswith(("loss/", "league/")):
            record[name] = value
    # JSON has neither NaN nor infinity, and strict readers refuse the words that Python writes.
    return {key: None if one is None or not math.isfinite(one) else one for key, one in record.items()}


def read_lines(file: Path) -> list[dict[str, Any]]:
    """Return the records of a run, without a last line that was cut off; none, if there is no file.

    Raises:
        UsageError: A line is no record of an iteration; names file and line.
    """
    records = read_json_lines(file, UsageError, cut=True) if file.exists() else []
    for place, record in records:
        for name in REQUIRED:
            value = record.get(name)
            # A bool is an int in Python, but no number of a record.
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
                raise UsageError(f"{place}: {name} is {shown(value)}, expected a number above 0")
        score = record.get("score", "missing")
        if score is not None and (isinstance(score, bool) or not isinstance(score, int | float)):
            raise UsageError(f"{place}: score is {shown(score)}, expected a number or null")
    return [record for _, record in records]


def _kept_aside(file: Path) -> Path:
    """Rename the records of a run that begins anew, and return their new place.

    Raises:
        WriteError: They cannot be renamed.
    """
    numbers = (file.with_stem(f"{file.stem}-{number}") for number in itertools.count(1))
    place = next(path for path in numbers if not path.exists())
    with writing(place):
        file.rename(place)
    return place


class MetricsLog:
    """Log of iterations. Lines that the disk refuses wait for the next one; the failure is reported once.

    Args:
        folder: Folder of the run.
        iterations: Iterations of the run.
        after: Iterations that are done already; records of later ones are dropped.
        bar: Show a bar in the terminal; where there is none, a line now and then.
        console: Console to write to; None: the standard error stream.

    Raises:
        WriteError: The folder cannot be written to.
    """

    def __init__(
        self, folder: Path, iterations: int, after: int = 0, bar: bool = True, console: Console | None = None
    ) -> None:
        file = folder / "metrics.jsonl"
        records = read_lines(file)
        kept = [record for record in records if record["iteration"] <= after]
        earlier = _kept_aside(file) if records and not kept else None
        # Rewritten whole: iterations after the checkpoint are made again, and would stand there twice.
        with atomic_write(file) as fresh:
            fresh.write_text("".join(json.dumps(record) + "\n" for record in kept))
        behind = kept[-1]["agent_steps"] if kept else 0
        from usarmjx.train.learning.tensorboard import TensorBoardLog  # readers need no TensorBoard

        self._lines, self._board = AppendedFile(file), TensorBoardLog(folder / "tensorboard", behind)
        self._faults: dict[Path, WriteError] = {}
        self._shown: dict[str, float] = {}
        self._bar = Progress(
            TextColumn("{task.completed}/{task.total}"),
            BarColumn(),
            TextColumn("{task.description}"),
            TimeRemainingColumn(),
            console=console or Console(stderr=True),
            disable=not bar,
        )
        # A file or a pipe gets a line now and then instead: a bar would fill it with control characters.
        shown = bar and not self._bar.console.is_terminal
        self._line_log, self._total = RateLimitedLog(self.say) if shown else None, iterations
        if earlier is not None:
            self.say(
                f"no checkpoint in {folder}: training begins anew; {earlier.name} keeps the lines of before"
            )
        self._task: TaskID = self._bar.add_task("compiling", total=iterations, completed=after)

    def __enter__(self) -> "MetricsLog":
        """Begin."""
        self._bar.start()
        if self._line_log is not None:
            self.say(f"{self._bar.tasks[self._task].completed:.0f}/{self._total} iterations, compiling")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the files."""
        with suppress(OSError):  # what it is shown on may be a file, and the disk full
            self._bar.stop()
        self._lines.close()
        self._board.close()

    def write(self, record: dict[str, Any], shown: Mapping[str, Any] | None = None) -> None:
        """Write down an iteration: `iteration`, `agent_steps`, `steps_per_s` and what `summary` returns.

        Args:
            record: The iteration.
            shown: Numbers for the terminal; None: those of the record.
        """
        iteration, line = record["iteration"], json.dumps(record) + "\n"
        numbers = {
            name: value
            for name, value in record.items()
            if isinstance(value, int | float) and name not in ("iteration", "agent_steps")
        }
        self._try(self._lines, lambda: self._lines.append(line.encode()))
        self._try(self._board, lambda: self._board.show(record["agent_steps"], numbers))
        known = numbers if shown is None else {name: one for name, one in shown.items() if one is not None}
        # An iteration in which no episode ended has no score: the bar keeps the latest one.
        self._shown |= known
        names = ("steps_per_s", "return", "score", "bad")
        latest = {name: self._shown.get(name, math.nan) for name in names}
        text = "{steps_per_s:,.0f} steps/s  return {return:.3g}  score {score:.3g}  bad worlds {bad:.2%}"
        with suppress(OSError):
            # The bar may go to a file on a full disk, which must not end the training.
            self._bar.update(self._task, completed=iteration, description=text.format(**latest))
        if self._line_log is not None:
            self._line_log(f"{iteration}/{self._total} iterations  {text.format(**latest)}")

    def _try(self, file: AppendedFile, write: Callable[[], None]) -> None:
        try:
            write()
        except WriteError as error:
            if file.path not in self._faults:
                self.say(f"{error}; training goes on, and it is tried again after each iteration")
            self._faults[file.path] = error
        else:
            if self._faults.pop(file.path, None):
                self.say(f"{file.path} is written to again, and whole")

    def say(self, text: str) -> None:
        """Print a line on the terminal."""
        with suppress(OSError):
            self._bar.console.print(f"usarmjx: {text}", markup=False, highlight=False, soft_wrap=True)

    def check_whole(self) -> None:
        """Refuse to end well when something of the run is missing in `metrics.jsonl`.

        Raises:
            WriteError: Says how much.
        """
        if self._lines.waiting:
            raise WriteError(f"{self._faults[self._lines.path]}; {self._lines.waiting} lines are missing")
