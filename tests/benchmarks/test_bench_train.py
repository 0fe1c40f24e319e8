"""The benchmark of training: what it is told is trained, and the scene of a task stands beside its rate."""

from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from benchmarks import train
from benchmarks.cases import TrainCase
from benchmarks.train import measure_training
from tests.benchmarks.records import faults
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.train.learning.config import DEFAULT_ENGINE


def test_a_task_is_trained_as_the_command_line_would(tmp_path):
    case = TrainCase(task="explore", worlds=8, steps=100, engine="c", seed=3, settings=["a=1", "b=2"])
    assert case.words(tmp_path) == [
        "train", "explore", "--out", str(tmp_path), "--steps", "100", "--quiet", "--engine", "c",
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
    for words in ([], ["x", "--task", "explore"]):
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
