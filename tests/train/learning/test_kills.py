"""Killed twenty times at any moment, and resumed each time: the run is the one that nobody killed.

`test_resume.py` has one kill, on a toy; this is `usarmjx train` on the smallest task.
"""

import random
import signal
import sys
import time
from contextlib import suppress

import pytest

from tests.train.runs import PATIENCE, checksums, lines, started
from usarmjx.train.learning.checkpoint import Checkpoints

KILLS = 20
SEED = 7
ITERATIONS = 80
SETTINGS = {
    "rollout_length": 8,
    "num_minibatches": 2,
    "num_epochs": 1,
    "hidden_sizes": "8",
    "critic_hidden_sizes": "8",
    "episode_steps": 30,
    "checkpoint_interval": 1,
    "keep_checkpoints": 1000,
}
COMMAND = [
    "-m",
    "usarmjx",
    "train",
    "--task",
    "drive-to-goal",
    "--engine",
    "c",
    "--worlds",
    "4",
    "--quiet",
]
COMMAND += ["--steps", str(ITERATIONS * 4 * 8)]
COMMAND += [word for name, value in SETTINGS.items() for word in ("--set", f"{name}={value}")]


def written(folder):
    """How many iterations are written down, but for a line that was cut off."""
    file = folder / "metrics.jsonl"
    return file.read_bytes().count(b"\n") if file.exists() else 0


def kill(process, folder, moment):
    """Kill a run: while it starts, or after an iteration or two, somewhere in the next or its checkpoint."""
    if moment.random() < 0.25:
        with suppress(Exception):
            process.wait(moment.uniform(0.0, 8.0))
    else:
        until, wanted = time.monotonic() + PATIENCE, written(folder) + moment.randint(1, 3)
        while written(folder) < wanted and process.poll() is None:
            assert time.monotonic() < until, "nothing was written"
            time.sleep(0.001)
        time.sleep(moment.uniform(0.0, 0.4))
    process.send_signal(signal.SIGKILL)
    assert process.wait(60) == -signal.SIGKILL, process.communicate()


def half_written(folder):
    """What the kill cut off."""
    names = [path.name for path in (folder / "checkpoints").glob("*.partial")]
    file = folder / "metrics.jsonl"
    cut = file.exists() and file.read_bytes()[-1:] not in (b"", b"\n")
    return names + ["half a line"] * cut


@pytest.mark.slow
def test_twenty_kills_at_any_moment_leave_no_trace(cache, tmp_path):
    whole, folder, moment = tmp_path / "whole", tmp_path / "killed", random.Random(SEED)
    with started([sys.executable, *COMMAND, "--out", str(whole)], cache) as process:
        output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, output
    for number in range(KILLS):
        resume = ["--resume"] * (folder / "config.json").exists()
        with started([sys.executable, *COMMAND, "--out", str(folder), *resume], cache) as process:
            kill(process, folder, moment)
        there = Checkpoints(folder).all()
        last = int(there[-1].name) if there else 0
        print(f"kill {number + 1}: after checkpoint {last}, {written(folder)} lines", *half_written(folder))
        if there:
            assert checksums(folder) == checksums(whole, str(last))
    with started([sys.executable, *COMMAND, "--out", str(folder), "--resume"], cache) as process:
        output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, output
    assert lines(folder) == lines(whole)
    assert [path.name for path in Checkpoints(folder).all()] == [f"{i + 1:08d}" for i in range(ITERATIONS)]
    for i in range(ITERATIONS):
        assert checksums(folder, str(i + 1)) == checksums(whole, str(i + 1))
    assert not [path for path in folder.rglob("*") if ".partial" in path.name]
