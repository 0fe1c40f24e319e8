"""Benchmark of training: speed with all waits, and the time until the baseline's score is reached."""

import subprocess
import sys
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import Any

import numpy as np

from benchmarks.baselines import PHYSICS_NAMES, missing, physics_baselines
from benchmarks.cases import BaselineOptions, TrainCase
from benchmarks.report.tables import wait_texts
from benchmarks.scenes import sizes
from benchmarks.tools import append_record, record_header, spread_of
from usarmjx.base.errors import UsageError, UsarmjxError
from usarmjx.plots.training_plots import Curve, curve_of_run
from usarmjx.train.learning.config import RunRecord, differences, load_record, on_gpu, task_config
from usarmjx.train.learning.metrics import read_lines
from usarmjx.train.make import make_task
from usarmjx.train.policies.sources import task_settings

USUAL = BaselineOptions()
STEPS, REPEATS = 5, 3
"""Control steps of a repeat, and repeats, of what is measured beside a run."""
SAMPLE_INTERVAL = 2.0
"""Interval at which the GPU's utilisation is sampled [s]."""
DIGITS = 4
"""Decimals of scores in a record; times have one."""


def time_to_score(curve: Curve, score: float) -> float | None:
    """Return when a run's score first was that high [s]; None: never."""
    there = np.flatnonzero(curve.score >= score)
    return float(curve.seconds[there[0]]) if there.size else None


def _between_ends(lines: Sequence[object]) -> slice:
    """Return which iterations of a run have times of their own; all but the first, or all, of a short run."""
    if len(lines) > 2:
        return slice(1, -1)
    return slice(1, None) if len(lines) > 1 else slice(None)


def training_speed(lines: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the speed of a run's iterations between the first, which compiles, and the last.

    Where a call that starts an iteration waits for the one before, a line has the time of the next iteration,
    and the last line none: both ends would be wrong.

    Returns:
        `mean`: agent steps over seconds, with all that the training waits for. `median`: of the iterations.
        `waits`: shares of these seconds that the host waited, by reason, see `train.learning.learner`; of
        records without waits, none.
    """
    steps = np.diff([0, *(line["agent_steps"] for line in lines)])
    rates = np.array([line["steps_per_s"] for line in lines])
    later = _between_ends(lines)
    seconds = float((steps / rates)[later].sum())
    # An iteration's line is written while the next one is at work: its own waits for checkpoint and log are
    # in the line after it, so the first line's are not among the sums.
    waits: dict[str, float] = {}
    for line in list(lines)[later]:
        for reason, waited in line.get("waits", {}).items():
            waits[reason] = waits.get(reason, 0.0) + waited
    return {
        "mean": float(steps[later].sum()) / seconds,
        "median": median(rates[later].tolist()),
        "waits": {reason: round(waited / seconds, DIGITS) for reason, waited in waits.items()},
    }


def train_record(
    folder: Path,
    baseline: float | None = None,
    note: str = "",
    baselines: str = "none",
    gpu_busy: float | None = None,
) -> dict[str, Any]:
    """Return the record of a run, made on this machine and by this version.

    Args:
        folder: Of the run.
        baseline: Score of the task's baseline.
        note: Remarks for readers of the record.
        baselines: Baselines to measure in the task's scene beside it, of `cases.BASELINES`.
        gpu_busy: Share of the time in which the GPU was busy; None: unknown.

    Raises:
        UsageError: The folder is no run, or no episode has ended in it.
    """
    run, curve, lines = load_record(folder), curve_of_run(folder), read_lines(folder / "metrics.jsonl")
    rates, speed = [line["steps_per_s"] for line in lines][_between_ends(lines)], training_speed(lines)
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
        "rates": {"training": spread_of("agent-steps/s", rates) | {"rate": speed["mean"]}},
        "task": run.task,
        "engine": run.engine,
        "worlds": run.config.num_worlds,
        "processes": run.processes,
        "seed": run.config.seed,
        "settings": {"task": run.overrides, "training": changed},
        "config": asdict(run.config),
        "agent_steps": lines[-1]["agent_steps"],
        "seconds": round(float(curve.seconds[-1]), 1),
        "agent_steps_per_s": speed["mean"],
        "median_agent_steps_per_s": speed["median"],
        "waits": speed["waits"],
        "gpu_busy": gpu_busy,
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


def record_run(
    folder: Path, baseline: float | None, options: BaselineOptions, gpu_busy: float | None = None
) -> str:
    """Append the record of a run to a file; return it in a line.

    Raises:
        UsageError: See `train_record`; or no such word for baselines.
    """
    options.check()
    record = train_record(folder, baseline, options.note, options.baselines, gpu_busy)
    append_record(record, options.json)
    reached, text = record["baseline_reached_s"], ""
    if baseline is not None:
        text = f"; baseline {baseline:g} " + ("not reached" if reached is None else f"after {reached:.0f} s")
    return (
        f"{record['task']}, seed {record['seed']}, {record['worlds']} worlds on {record['device']}: "
        f"{record['agent_steps']:,} agent steps in {record['seconds']:.0f} s "
        f"({record['agent_steps_per_s']:,.0f} agent steps/s with all waits, median of the iterations "
        f"{record['median_agent_steps_per_s']:,.0f}{_waits_text(record)}), score {record['score']:.3f}{text}"
    )


def _waits_text(record: Mapping[str, Any]) -> str:
    """Return the shares of waits, and of the time in which the GPU was busy."""
    shares = wait_texts(record["waits"])
    if record["gpu_busy"] is not None:
        shares.append(f"GPU busy {record['gpu_busy']:.0%}")
    return "".join(f", {share}" for share in shares)


def measure_training(case: TrainCase, baseline: float | None, options: BaselineOptions = USUAL) -> str:
    """Train in a process of its own, append the record of the run to a file, and return it in a line.

    Raises:
        UsageError: The training did not come to its end; says why.
    """
    with TemporaryDirectory(prefix="usarmjx-bench-") as folder:
        run = Path(folder) / "run"
        command: Sequence[str] = [sys.executable, "-m", "usarmjx", *case.words(run)]
        with _gpu_samples(run / "metrics.jsonl") as samples:
            done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            said = [line for line in done.stderr.splitlines() if line.strip()]
            raise UsageError(f"the training failed: {said[-1] if said else done.returncode}")
        return record_run(run, baseline, options, sum(samples) / len(samples) if samples else None)


@contextmanager
def _gpu_samples(log: Path) -> Generator[list[float]]:
    """Yield a list that fills with the GPU's utilisation from a run's first iteration on (0 to 1)."""
    ended, samples = Event(), list[float]()
    command = ["nvidia-smi", "--query-gpu=utilization.gpu", "--format=csv,noheader,nounits"]

    def sample() -> None:
        while not ended.wait(SAMPLE_INTERVAL):
            if not log.exists() or not log.stat().st_size:
                continue
            try:
                answer = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)
                samples.append(float(answer.stdout.split()[0]) / 100)
            except (OSError, ValueError, IndexError, subprocess.SubprocessError):
                return  # a machine without a GPU

    thread = Thread(target=sample, name="GPU utilisation", daemon=True)
    thread.start()
    try:
        yield samples
    finally:
        ended.set()
        thread.join()
