"""Learning curves over agent steps and over time: from benchmark records and folders of runs."""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from usarmjx.base.errors import UsageError
from usarmjx.base.settings.files import is_mapping
from usarmjx.base.settings.json_file import read_json_lines
from usarmjx.plots.style import (
    FEWEST_FOR_LINE,
    MOST_PANELS,
    PALETTE,
    check_figure,
    figure_style,
    numbered,
    panels_of,
    save_figure,
)
from usarmjx.train.learning.config import load_record, overridden_fields
from usarmjx.train.learning.metrics import read_lines
from usarmjx.train.task_names import recorded_name

MEAN, BASELINE = "mean of the runs", "baseline"
"""Names in the legend."""
PALE = 0.35
"""Opacity of single runs beside their mean."""
TITLE_LETTERS = 32
"""Letters of a line above a panel: three panels are beside each other on a page."""
MILLION = 1e6
MOST_POINTS = 100
"""More would be noise: where few worlds are, few episodes end in an iteration."""


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Learning curve of one run.

    Attributes:
        task: Task.
        seed: Of the run.
        steps: Agent steps so far (points,).
        seconds: Time so far [s] (points,).
        score: Mean score of the episodes that ended since the point before (points,).
        baseline: Score of the baseline; None: not known.
        engine: Engine of the run as named; empty: not known.
        fields: Overridden fields of the task, as `advice=false`.
        worlds: Number in the batch.
        device: That trained; empty: not known.
    """

    task: str
    seed: int
    worlds: int
    steps: np.ndarray
    seconds: np.ndarray
    score: np.ndarray
    baseline: float | None = None
    engine: str = ""
    fields: str = ""
    device: str = ""

    @property
    def title(self) -> str:
        """Task, engine and device, in a few words."""
        task = " ".join(filter(None, [self.task, plain_fields(self.fields)]))
        engine = f" on {self.engine}" if self.engine else ""
        about = ", ".join(filter(None, [f"{self.worlds} worlds", self.device]))
        return f"{task}{engine} ({about})"


Axis = Callable[[Curve], np.ndarray]
"""Values of a curve along x (points,)."""


def plain_fields(fields: str) -> str:
    """Return overridden fields of a task in words: `advice=false` as `without advice`."""
    words: list[str] = []
    for field in filter(None, fields.split(", ")):
        name, _, value = field.partition("=")
        plain = {"false": "without {}", "true": "with {}"}.get(value.lower(), "with {} {}")
        words.append(plain.format(name, value))
    return ", ".join(words)


def fields_of_record(record: Mapping[str, Any]) -> str:
    """Return the overridden fields of the task in a benchmark record; the oldest have words for them."""
    settings = record.get("settings", {})
    fields: dict[str, Any] = settings.get("task", {}) if is_mapping(settings) else {}
    return overridden_fields(recorded_name(record["task"]), record.get("engine", ""), fields)


def curve_of_record(record: dict[str, Any]) -> Curve:
    """Return the curve of a benchmark record, `"benchmark": "train"`.

    Rows of its `curve` are agent steps and score, and time [s] if that was written down; if not, it is
    reckoned with the record's `agent_steps_per_s`.
    """
    rows, task = np.array(record["curve"], float), recorded_name(str(record["task"]))
    seconds = rows[:, 2] if rows.shape[1] > 2 else rows[:, 0] / record["agent_steps_per_s"]
    return Curve(
        task=task,
        seed=record["seed"],
        worlds=record["worlds"],
        steps=rows[:, 0],
        seconds=seconds,
        score=rows[:, 1],
        baseline=record.get("baseline"),
        engine=record.get("engine", ""),
        fields=fields_of_record(record),
        device=record["device"],
    )


def seconds_so_far(steps: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return the time at the end of each iteration [s] (iterations,), given agent steps so far and rates."""
    # By each iteration's own rate, as a run's file has no times; pauses between runs do not count.
    return np.cumsum(np.diff(steps, prepend=0.0) / rates)


def curve_of_run(folder: Path) -> Curve:
    """Return the curve of a run, from what it has written down.

    Iterations in which no episode ended are left out. Time is that of the iterations, the first of which also
    compiles; what was between them is not in it.

    Raises:
        UsageError: The folder is no run, or no episode has ended in it.
    """
    settings, lines = load_record(folder), read_lines(folder / "metrics.jsonl")
    steps = np.array([line["agent_steps"] for line in lines], float)
    rates = np.array([line["steps_per_s"] for line in lines], float)
    score = np.array([line["score"] for line in lines], float)  # None becomes NaN
    there, config = np.isfinite(score), settings.config
    if not there.any():
        raise UsageError(f"no episode has ended yet in the run in {folder}")
    return Curve(
        task=settings.task,
        seed=config.seed,
        worlds=config.num_worlds,
        steps=steps[there],
        seconds=seconds_so_far(steps, rates)[there],
        score=score[there],
        engine=settings.engine,
        fields=overridden_fields(settings.task, settings.engine, settings.overrides),
    )


def read_curves(source: Path) -> list[Curve]:
    """Return the curves of a file of benchmark records, or of a run's folder.

    Raises:
        UsageError: There is neither, or no curve.
    """
    if source.is_dir():
        return [curve_of_run(source)]
    if not source.is_file():
        raise UsageError(f"{source} is neither a file of benchmark records nor the folder of a run")
    try:
        records = read_json_lines(source, UsageError)
        found = [curve_of_record(record) for _, record in records if record["benchmark"] == "train"]
    # Any JSON may be in the file: fields of a record may be missing, or of any other form.
    except (UsageError, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        reason = str(error) if isinstance(error, UsageError) else repr(error)
        raise UsageError(f"{source} is no file of benchmark records: {reason}") from error
    if not found:
        raise UsageError(f"{source} has no records of training")
    return found


def curves_by_task(curves: Iterable[Curve]) -> dict[str, list[Curve]]:
    """Return the curves that belong together, by the title of the last; of several of a seed the last one.

    These are of one task, with the same overrides, on one engine in as many worlds.
    """
    # A dict keeps the last of equal keys: a repeated seed replaces the earlier one.
    last = {(one.task, one.fields, one.engine, one.worlds, one.seed): one for one in curves}
    found: dict[str, list[Curve]] = {}
    # A dict without values is a set that keeps its order.
    for kind in dict.fromkeys(key[:-1] for key in last):
        rows = [last[key] for key in sorted(last) if key[:-1] == kind]
        devices = " and ".join(sorted({one.device for one in rows} - {""}))
        found[replace(rows[-1], device=devices).title] = rows
    return found


def thinned(curve: Curve) -> Curve:
    """Return a curve of at most `MOST_POINTS` points, each the mean of as many that follow each other."""
    # Parts of nearly equal size, and none of them empty.
    parts = np.array_split(np.arange(len(curve.steps)), min(len(curve.steps), MOST_POINTS))
    means = {
        name: np.array([getattr(curve, name)[part].mean() for part in parts])
        for name in ("steps", "seconds", "score")
    }
    return replace(curve, **means)


def mean_curve(curves: Sequence[Curve], along: Axis) -> tuple[np.ndarray, np.ndarray]:
    """Return places along an axis and the mean score there, as far as all curves reach (points,)."""
    start, end = max(along(one)[0] for one in curves), min(along(one)[-1] for one in curves)
    places = np.unique(np.concatenate([along(one) for one in curves]))
    # Beyond, the mean would jump where a run ends.
    places = places[(start <= places) & (places <= end)]
    return places, np.mean([np.interp(places, along(one), one.score) for one in curves], axis=0)


def _millions(curve: Curve) -> np.ndarray:
    return curve.steps / MILLION


def _seconds(curve: Curve) -> np.ndarray:
    return curve.seconds


AXES: dict[str, tuple[str, Axis]] = {
    "steps": ("agent steps [million]", _millions),
    "time": ("time [s]", _seconds),
}
"""Horizontal axes of scores: label and values."""


def draw_task(axes: Axes, curves: Sequence[Curve], along: Axis) -> None:
    """Draw the curves of a task over an axis: each thin, over steps their mean thick, and the baseline.

    Over time there is none: seeds that waited longer for compilations or for others would pull it aside.
    """
    curves = [thinned(curve) for curve in curves]
    for curve in curves:
        fewer: dict[str, Any] = {"alpha": PALE, "lw": 0.8} if len(curves) > 1 else {"lw": 1.2}
        few: dict[str, Any] = {"marker": ".", "ls": "none"} if len(curve.steps) < FEWEST_FOR_LINE else {}
        axes.plot(along(curve), curve.score, color=PALETTE[0], **fewer, **few)
    if len(curves) > 1 and along is _millions:
        axes.plot(*mean_curve(curves, along), color=PALETTE[0], lw=1.6, label=MEAN)
    if curves[-1].baseline is not None:
        axes.axhline(curves[-1].baseline, color=PALETTE[1], ls="--", lw=1.2, label=BASELINE)
    # From 0, so that heights compare; lower only where scores are negative.
    axes.set(xlim=(0, None), ylim=(min(0.0, *(curve.score.min() for curve in curves)), None))


def panel_title(title: str, runs: int) -> str:
    """Return the title of curves in short lines: task and engine, then worlds, runs and devices."""
    # Taken apart again: titles are the keys by which curves belong together.
    what, _, about = title.removesuffix(")").partition(" (")
    worlds, *devices = about.split(", ")
    names = ", ".join(devices).replace("NVIDIA ", "").replace(" 80GB HBM3", "").replace("x86_64", "CPU")
    lines = [what, ", ".join(filter(None, [worlds, f"{runs} run{'s' * (runs > 1)}", names]))]
    return "\n".join(part for line in lines for part in wrap(line, TITLE_LETTERS))


def _legend(figure: Figure, panels: Sequence[Axes]) -> None:
    """Draw one legend for all panels, below them, where it covers no curve."""
    # One handle for each label: panels repeat them.
    there = {
        label: handle
        for panel in panels
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    if MEAN in there:
        # First in the legend; single runs have no label, or each would stand there.
        there = {"a run": Line2D([], [], color=PALETTE[0], alpha=PALE, lw=0.8), **there}
    if there:
        figure.legend([*there.values()], [*there], loc="outside lower center", ncols=len(there))


def draw_curves(curves: Iterable[Curve], along: str = "steps") -> list[Figure]:
    """Draw scores of trainings, a panel for each task: figures of at most `MOST_PANELS` panels.

    Args:
        curves: The curves.
        along: Abscissa, of `AXES`.

    Raises:
        UsageError: Another axis; names those there are.
    """
    if along not in AXES:
        raise UsageError(f"curves over {along!r}: expected {', '.join(AXES)}")
    (label, axis), tasks = AXES[along], list(curves_by_task(curves).items())
    figures: list[Figure] = []
    with figure_style():
        for start in range(0, len(tasks), MOST_PANELS):
            part = tasks[start : start + MOST_PANELS]
            figure, panels = panels_of(len(part))
            for panel, (task, found) in zip(panels, part, strict=True):
                draw_task(panel, found, axis)
                panel.set_title(panel_title(task, len(found)))
                panel.set_xlabel(label)
            panels[0].set_ylabel("score")
            _legend(figure, panels)
            figures.append(figure)
    return figures


def plot_curves(sources: Sequence[Path], out: Path, along: str = "steps") -> list[Path]:
    """Draw the curves of records and runs into files, and return these; the folder is made if need be.

    Args:
        sources: Files of records, folders of runs.
        out: PNG, PDF, SVG or EPS file; further figures have numbers: `x.pdf`, `x-2.pdf`.
        along: `steps` or `time`.

    Raises:
        UsageError: A source without curves, or another suffix.
        WriteError: A file cannot be written.
    """
    check_figure(out)
    curves = [curve for source in sources for curve in read_curves(source)]
    files: list[Path] = []
    for number, figure in enumerate(draw_curves(curves, along)):
        files.append(numbered(out, number))
        save_figure(figure, files[-1])
    return files
