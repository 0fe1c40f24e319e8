"""A short training by the command line, for `usarmjx bench train --task`: a run like any other."""

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from usarmjx.base.errors import UsageError
from usarmjx.bench.train import record_run

STEPS = 200_000
"""Agent steps unless told."""


@dataclass(frozen=True, kw_only=True)
class TrainCase:
    """A training.

    Attributes:
        task: What is learned.
        worlds: Worlds; None: those of the task.
        steps: Agent steps.
        engine: Of the physics.
        seed: Of all random numbers.
        settings: Of the training or the task, as `key=value`.
    """

    task: str
    worlds: int | None = None
    steps: int = STEPS
    engine: str = "auto"
    seed: int = 0
    settings: tuple[str, ...] = ()

    def words(self, out: Path) -> list[str]:
        """Return its command line."""
        words = ["train", self.task, "--out", str(out), "--steps", str(self.steps), "--quiet"]
        words += ["--engine", self.engine, "--seed", str(self.seed)]
        words += [] if self.worlds is None else ["--worlds", str(self.worlds)]
        return [*words, *(word for setting in self.settings for word in ("--set", setting))]


def measure_training(
    case: TrainCase, baseline: float | None, file: Path | None, note: str = "", baselines: str = "all"
) -> str:
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
        return record_run(run, baseline, file, note, baselines)
