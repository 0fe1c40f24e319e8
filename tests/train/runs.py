"""A small run that many tests look at, also as a program: python -m tests.train.runs FOLDER [--resume]."""

import json
import os
import shutil
import signal
import subprocess
import sys
import zipfile
from contextlib import contextmanager, suppress
from pathlib import Path

from usarmjx.train.learning.config import Config

ROOT = Path(__file__).parents[2]
PROGRAM = ("-m", "tests.train.runs")
"""This module as a program, for Python in the folder of the project."""

CONFIG = Config(
    total_steps=24_000,  # 10 iterations of 25 steps of 32 worlds of 3 robots
    num_worlds=32,
    rollout_length=25,
    lr_schedule="linear",  # `adaptive` decides by thresholds: rounding could tip it
    learning_rate=1e-3,
    gamma=0.9,
    hidden_sizes=(32, 32),
    critic_hidden_sizes=(32, 32),
    checkpoint_interval=1,
    keep_checkpoints=2,
)
NOT_REPEATABLE = ("steps_per_s", "waits")
PATIENCE = 600
"""Longest that a test waits for processes [s]."""


def run(folder, config=CONFIG, resume=False, watch=None, stop=None):
    """Train on the toy of several robots, in which some worlds go wrong."""
    from tests.train.toys import DriveToy
    from usarmjx.train.learning.trainer import train

    def make(worlds, first):
        return DriveToy(worlds, first, rotten=True, shared=True)

    return train(make, config, folder, resume, progress=False, watch=watch, stop=stop)


@contextmanager
def started(command, cache):
    """A program with what it starts, all of which is ended afterwards; they share what they compile."""
    environment = {
        **os.environ,
        "JAX_PLATFORMS": "cpu",
        "JAX_COMPILATION_CACHE_DIR": str(cache),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        env=environment,
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait(10)


def lines(folder):
    """What was written of the iterations, but for times."""
    text = (Path(folder) / "metrics.jsonl").read_text()
    records = [json.loads(line) for line in text.splitlines()]
    return [{k: v for k, v in record.items() if k not in NOT_REPEATABLE} for record in records]


def checksums(folder, name="last"):
    """Content of a checkpoint, by its checksums: train state and worlds of the first process."""
    from usarmjx.train.learning.checkpoint import Checkpoints

    path = Checkpoints(folder).find(name)
    return path.name, [array_checksums(path / f"{part}_0.npz") for part in ("learner", "worlds")]


def array_checksums(file):
    """Checksum of each array of an npz file, with its type and shape."""
    with zipfile.ZipFile(file) as arrays:
        return {one.filename: (one.CRC, one.file_size) for one in arrays.infolist()}


def check_goes_on(env, config, whole, folder, left):
    """Resume a copy of a run that was left after some iterations: it ends as the whole one, bit by bit."""
    from usarmjx.train.learning.checkpoint import Checkpoints
    from usarmjx.train.learning.trainer import train

    shutil.copytree(whole, folder)
    for path in Checkpoints(folder).all()[left:]:
        shutil.rmtree(path)
    train(env, config, folder, resume=True, progress=False)
    assert lines(folder) == lines(whole)
    assert checksums(folder) == checksums(whole)


if __name__ == "__main__":
    from usarmjx.train.learning.processes import initialize

    initialize()
    run(sys.argv[1], resume="--resume" in sys.argv)
