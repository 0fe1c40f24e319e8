"""The benchmark of training: what a run was, how fast, and when it was as good as the baseline by hand."""

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.baselines import PHYSICS_NAMES, missing, physics_baselines
from benchmarks.cases import BaselineOptions, TrainCase
from benchmarks.scenes import sizes
from benchmarks.tools import append_record, record_header, spread_of
from usarmjx.base.errors import UsageError, UsarmjxError
from usarmjx.plots.training_plots import Curve, curve_of_run
from usarmjx.train.learning.config import differences, on_gpu, task_config
from usarmjx.train.learning.metrics import read_lines
from usarmjx.train.learning.run_record import RunRecord, load_record
from usarmjx.train.make import make_task
from usarmjx.train.policies.sources import task_settings

USUAL = BaselineOptions()
STEPS, REPEATS = 5, 3
"""Control steps of a repeat, and repeats, of what is measured beside a run."""
DIGITS = 4
"""Decimals of scores in a record; times have one."""


def time_to_score(curve: Curve, score: float) -> float | None:
    """Return when a run's score first was that high [s]; None: never."""
    there = np.flatnonzero(curve.score >= score)
    return float(curve.seconds[there[0]]) if there.size else None


def train_record(
    folder: Path, baseline: float | None = None, note: str = "", baselines: str = "none"
) -> dict[str, Any]:
    """Return the record of a run, made on this machine and by this version.

    Args:
        folder: Of the run.
        baseline: Score of the policy written by hand.
        note: Remarks for readers of the record.
        baselines: What is measured of the task's scene beside it, of `cases.BASELINES`.

    Raises:
        UsageError: The folder is no run, or no episode has ended in it.
    """
    run, curve, lines = load_record(folder), curve_of_run(folder), read_lines(folder / "metrics.jsonl")
    rates = [line["steps_per_s"] for line in lines]
    header = record_header("train", note=note)
    usual = task_config(run.task, gpu=on_gpu(run.engine))
    changed = differences(usual, run.config, but=("total_steps", "num_worlds", "seed"))
    return {
        **header,
        "case": {
            "task": run.task,
            "worlds": run.config.num_worlds,
            "engine": run.engine,
            "seed": run.config.seed,
        },
        **_scene_beside(run, baselines),
        "rates": {"training": spread_of("agent-steps/s", rates[1:] or rates)},
        "task": run.task,
        "engine": run.engine,
        "worlds": run.config.num_worlds,
        "processes": run.processes,
        "seed": run.config.seed,
        "settings": {"task": run.overrides, "training": changed},
        "config": asdict(run.config),
        "agent_steps": lines[-1]["agent_steps"],
        "seconds": round(float(curve.seconds[-1]), 1),
        "agent_steps_per_s": median(rates[1:] or rates),  # the first iteration compiles
        "score": float(curve.score[-1]),
        "bad": float(np.mean([line["bad"] for line in lines])),
        "baseline": baseline,
        "baseline_reached_s": None if baseline is None else time_to_score(curve, baseline),
        "curve": [
            [int(steps), round(float(score), DIGITS), round(float(seconds), 1)]
            for steps, score, seconds in zip(curve.steps, curve.score, curve.seconds, strict=True)
        ],
    }


def _scene_beside(run: RunRecord, baselines: str) -> dict[str, Any]:
    """Return the task's scene and its physics alone, if that is wanted and the task is one of ours."""
    reason = "not asked for"
    if baselines != "none":
        physics = [f"physics={run.overrides['physics']}"] if "physics" in run.overrides else []
        try:
            overrides, _ = task_settings(run.task, run.overrides, physics)
            scene = make_task(run.task, **overrides).scene()
        except UsarmjxError as error:
            reason = str(error)
        else:
            found = physics_baselines(scene, run.config.num_worlds, STEPS, REPEATS, baselines)
            return {"scene": sizes(scene), "baselines": found}
    return {"scene": None, "baselines": {name: missing(reason) for name in PHYSICS_NAMES}}


def record_run(folder: Path, baseline: float | None, options: BaselineOptions) -> str:
    """Append the record of a run to a file; return it in a line.

    Raises:
        UsageError: See `train_record`; or no such word for baselines.
    """
    options.check()
    record = train_record(folder, baseline, options.note, options.baselines)
    append_record(record, options.json)
    reached, text = record["baseline_reached_s"], ""
    if baseline is not None:
        text = f"; baseline {baseline:g} " + ("not reached" if reached is None else f"after {reached:.0f} s")
    return (
        f"{record['task']}, seed {record['seed']}, {record['worlds']} worlds on {record['device']}: "
        f"{record['agent_steps']:,} agent steps in {record['seconds']:.0f} s "
        f"({record['agent_steps_per_s']:,.0f} agent steps/s), score {record['score']:.3f}{text}"
    )


def measure_training(case: TrainCase, baseline: float | None, options: BaselineOptions = USUAL) -> str:
    """Train in a process of its own, append the record of the run to a file, and return it in a line.

    Raises:
        UsageError: The training did not come to its end; says why.
    """
    with TemporaryDirectory(prefix="usarmjx-bench-") as folder:
        run = Path(folder) / "run"
        command: Sequence[str] = [sys.executable, "-m", "usarmjx", *case.words(run)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            said = [line for line in done.stderr.splitlines() if line.strip()]
            raise UsageError(f"the training failed: {said[-1] if said else done.returncode}")
        return record_run(run, baseline, options)
