"""Records and curves of runs of `examples/marl`: all seeds of each algorithm.

python -m benchmarks.marl runs --json marl.jsonl --plot marl-curves.png
"""

import argparse
import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from benchmarks.tools import record_header
from usarmjx.base.errors import UsageError
from usarmjx.plots.training_plots import seconds_so_far
from usarmjx.train.learning.metrics import read_lines

POINTS = 40
"""Most points of a recorded curve: scores of single iterations would be noise."""
LAST = 0.25
"""Part of a run whose mean is its score."""


def read_run(folder: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the settings and lines of a run.

    Raises:
        UsageError: The folder has no run, or no episode has ended in it.
    """
    try:
        run = json.loads((folder / "run.json").read_text())
    except OSError as error:
        raise UsageError(f"{folder} is no run of examples/marl: {error}") from error
    lines = read_lines(folder / "metrics.jsonl")
    if not any(line["score"] is not None for line in lines):
        raise UsageError(f"no episode has ended yet in the run in {folder}")
    return run, lines


def seed_figures(run: dict[str, Any], lines: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return seed, time, mean score of the last quarter and curve of a run; time has the compilation."""
    steps = np.array([line["agent_steps"] for line in lines], float)
    rates = np.array([line["steps_per_s"] for line in lines], float)
    seconds = seconds_so_far(steps, rates)
    episodes = np.array([line["episodes"] for line in lines], float)
    # Iterations count by their episodes; those without any have no score.
    points = episodes * np.array([line["score"] or 0.0 for line in lines], float)
    late = steps > (1 - LAST) * steps[-1]
    curve = []
    for part in np.array_split(np.arange(len(lines)), min(POINTS, len(lines))):
        if episodes[part].sum():
            score = points[part].sum() / episodes[part].sum()
            curve.append([int(steps[part[-1]]), round(float(score), 2), round(float(seconds[part[-1]]), 1)])
    return {
        "seed": run["flags"]["seed"],
        "agent_steps": int(steps[-1]),
        "seconds": round(float(seconds[-1]), 1),
        "median_agent_steps_per_s": float(np.median(rates)),
        "score": round(float(points[late].sum() / max(episodes[late].sum(), 1.0)), 2),
        "curve": curve,
    }


def _alike(run: dict[str, Any]) -> dict[str, Any]:
    """Return the flags that all seeds of a record share."""
    return {name: value for name, value in run["flags"].items() if name not in ("seed", "out")}


def records_of(folder: Path, note: str = "") -> list[dict[str, Any]]:
    """Return a record for each algorithm and settings of the runs in a folder, made on this machine."""
    found: dict[tuple[str, str], list[tuple[dict[str, Any], list[dict[str, Any]]]]] = defaultdict(list)
    for one in sorted(path.parent for path in folder.glob("*/run.json")):
        run, lines = read_run(one)
        found[run["algorithm"], json.dumps(_alike(run))].append((run, lines))
    if not found:
        raise UsageError(f"{folder} has no runs of examples/marl")
    records = []
    for (algorithm, _), runs in sorted(found.items()):
        flags = _alike(runs[0][0])
        case = {"algorithm": algorithm, "task": flags["task"], "worlds": flags["num_worlds"]}
        seeds = [seed_figures(run, lines) for run, lines in runs]
        header = record_header("marl", note=note)
        empty = {"scene": None, "rates": {}, "baselines": {"planner": {"missing": "not asked for"}}}
        records.append({**header, "case": case, **empty, "flags": flags, "seeds": seeds})
    return records


def plot(records: Sequence[dict[str, Any]], out: Path) -> None:
    """Draw the seeds of each record in a panel of their own."""
    columns = 4
    rows = -(-len(records) // columns)
    figure, panels = plt.subplots(rows, columns, figsize=(11, 2.4 * rows), squeeze=False, layout="tight")
    for panel in panels.flat[len(records) :]:
        panel.axis("off")
    for panel, record in zip(panels.flat, records, strict=False):
        for seed in record["seeds"]:
            curve = np.array(seed["curve"])
            panel.plot(curve[:, 0] / 1e6, curve[:, 1], linewidth=1)
        panel.set_title(f"{record['case']['algorithm']}, {record['case']['task']}", fontsize=9)
        panel.set_xlabel("agent steps [million]", fontsize=8)
        panel.set_ylabel("score", fontsize=8)
    figure.savefig(out, dpi=90)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("runs", type=Path, help="folder of runs, or file of records")
    parser.add_argument("--json", type=Path, help="file to which records are appended")
    parser.add_argument("--plot", type=Path, help="file of a figure")
    parser.add_argument("--note", default="", help="remark for readers of the records")
    args = parser.parse_args(arguments)
    if args.runs.is_file():
        if args.json is not None:
            parser.error("--json is for folders of runs: the records of a file are there already")
        records = [json.loads(line) for line in args.runs.read_text().splitlines()]
    else:
        try:
            records = records_of(args.runs, args.note)
        except UsageError as error:
            parser.error(str(error))
    if args.json is not None:
        with args.json.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(record) + "\n" for record in records)
    if args.plot is not None:
        plot(records, args.plot)
    for record in records:
        scores = [seed["score"] for seed in record["seeds"]]
        minutes = [round(seed["seconds"] / 60, 1) for seed in record["seeds"]]
        print(
            f"{record['case']['algorithm']:10} {record['case']['task']:12} scores {scores}, minutes {minutes}"
        )


if __name__ == "__main__":
    main()
