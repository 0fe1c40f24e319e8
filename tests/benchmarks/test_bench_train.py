"""The benchmark of training: what it is told is trained, and the scene of a task stands beside its rate."""

import time
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from benchmarks import train
from benchmarks.cases import TrainCase
from benchmarks.report.records import BenchRecord
from benchmarks.report.tables import train_table
from benchmarks.train import _gpu_samples, measure_training, training_speed
from tests.benchmarks.records import faults
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.train.learning.config import DEFAULT_ENGINE


def test_a_task_is_trained_as_the_command_line_would(tmp_path):
    case = TrainCase(task="explore-v1", worlds=8, steps=100, engine="c", seed=3, settings=["a=1", "b=2"])
    assert case.words(tmp_path) == [
        "train", "explore-v1", "--out", str(tmp_path), "--steps", "100", "--quiet", "--engine", "c",
        "--seed", "3", "--worlds", "8", "--set", "a=1", "--set", "b=2",
    ]  # fmt: skip


@pytest.mark.parametrize("task", ["wander", "stairs", "explore-v2"])
def test_a_task_is_trained_on_the_engine_that_train_takes(task, monkeypatch, tmp_path):
    """What `usarmjx train` is told ends in the same engine and fields as the bare command."""
    taken = []
    monkeypatch.setattr("usarmjx.train.learning.trainer.train", lambda *given, **more: taken.append(more))
    for words in (TrainCase(task=task).words(tmp_path / "a"), ["train", task, "--out", str(tmp_path / "b")]):
        CliRunner().invoke(app, words)
    measured, bare = (more["origin"] for more in taken)
    assert measured == bare
    assert (measured.engine == "planar") == (task in DEFAULT_ENGINE)


def test_a_training_that_fails_says_why():
    with pytest.raises(UsageError, match=r"the training failed: .*unknown task 'dance'"):
        measure_training(TrainCase(task="dance"), None)


def test_either_runs_or_a_task():
    for words in ([], ["x", "--task", "explore-v1"]):
        result = CliRunner().invoke(app, ["bench", "train", *words])
        assert result.exit_code == 2
        assert "name folders of runs, or a task to train: --task TASK" in result.output


def test_the_physics_of_a_tasks_scene_is_measured_beside_its_rate(monkeypatch):
    monkeypatch.setattr(train, "STEPS", 1)
    monkeypatch.setattr(train, "REPEATS", 1)
    config = SimpleNamespace(num_worlds=2)
    run = SimpleNamespace(task="drive-to-goal", overrides={"physics": "fast"}, config=config)
    found = train._scene_beside(run, "cpu")
    assert found["scene"]["robots"] == 1
    assert found["baselines"]["mujoco_rollout"]["rate"] > 0.0
    assert found["baselines"]["bare_mjx"] == {"missing": "not asked for"}
    whole = {"benchmark": "train", "rates": {}, **found}
    assert not [fault for fault in faults(whole) if "scene" in fault or "baselines" in fault]


LINES = (
    {"agent_steps": 100, "steps_per_s": 10.0, "waits": {"arenas": 0.0, "device": 9.0}},  # 10 s: compiles
    {"agent_steps": 200, "steps_per_s": 100.0, "waits": {"arenas": 0.0, "device": 0.9}},  # 1 s
    {"agent_steps": 300, "steps_per_s": 100.0, "waits": {"arenas": 0.0, "device": 0.9}},  # 1 s
    {"agent_steps": 400, "steps_per_s": 50.0, "waits": {"arenas": 1.2, "device": 0.6}},  # 2 s
    {"agent_steps": 500, "steps_per_s": 1e6, "waits": {"arenas": 0.0, "device": 0.0}},  # was over already
)


def test_the_speed_of_a_training_is_the_mean_with_all_waits():
    speed = training_speed(LINES)
    assert speed["mean"] == pytest.approx(300 / 4)
    assert speed["median"] == 100.0
    assert speed["waits"] == {"arenas": 0.3, "device": 0.6}


def test_records_of_older_runs_have_no_waits():
    lines = [{"agent_steps": line["agent_steps"], "steps_per_s": line["steps_per_s"]} for line in LINES]
    assert training_speed(lines) == {"mean": 75.0, "median": 100.0, "waits": {}}
    assert training_speed(lines[:2]) == {"mean": 100.0, "median": 100.0, "waits": {}}
    assert training_speed(lines[:1]) == {"mean": 10.0, "median": 10.0, "waits": {}}


def test_the_table_tells_mean_and_median_apart():
    data = {
        "benchmark": "train", "when": "2026-01-01T00:00:00+00:00", "device": "GPU", "commit": "abc",
        "task": "t",
        "engine": "c", "worlds": 1, "seed": 0, "agent_steps": 400, "score": 1.0, "baseline": None,
        "settings": {"task": {}, "training": []},
    }  # fmt: skip
    older = BenchRecord("train.jsonl", {**data, "agent_steps_per_s": 100.0})
    speed = {"agent_steps_per_s": 75.0, "median_agent_steps_per_s": 100.0, "waits": {"arenas": 0.3}}
    newer = BenchRecord("train.jsonl", {**data, **speed, "gpu_busy": 0.5})
    rows = train_table([older, newer]).splitlines()
    assert "| - | 100 | - | - |" in rows[-2]
    assert "| 75 | 100 | arenas 30% | 50% |" in rows[-1]


@pytest.mark.parametrize(("printed", "seen"), [("echo 37", {0.37}), ("exit 9", set())])
def test_a_gpu_is_sampled_from_the_first_iteration_on(printed, seen, tmp_path, monkeypatch):
    program = tmp_path / "nvidia-smi"
    program.write_text(f"#!/bin/sh\ntouch {tmp_path}/asked\n{printed}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setattr(train, "SAMPLE_INTERVAL", 0.01)
    log, asked = tmp_path / "metrics.jsonl", tmp_path / "asked"
    with _gpu_samples(log) as samples:
        time.sleep(0.1)
        assert not asked.exists()
        log.write_text("{}\n")
        until = time.monotonic() + 60
        while time.monotonic() < until and not (samples if seen else asked.exists()):
            time.sleep(0.01)
    assert set(samples) == seen
