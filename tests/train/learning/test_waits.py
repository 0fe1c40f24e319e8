"""Waits of a training's host: sums by reason, and a part of each iteration's time."""

from types import SimpleNamespace

import pytest

from tests.train.toys import DriveToy, small_config
from usarmjx.train.learning import learner as learner_module
from usarmjx.train.learning.learner import Waits
from usarmjx.train.learning.trainer import train


def test_seconds_add_up_by_reason_and_are_taken_once(monkeypatch):
    clock = iter([0.0, 1.5, 2.0, 2.25, 3.0, 7.0])
    monkeypatch.setattr(learner_module, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
    waits = Waits()
    with waits.timed("arenas"):
        pass
    with waits.timed("arenas"):
        pass
    with pytest.raises(KeyError), waits.timed("log"):
        raise KeyError
    assert waits.take() == {"arenas": 1.75, "device": 0.0, "checkpoint": 0.0, "log": 4.0}
    assert set(waits.take().values()) == {0.0}


def test_an_iterations_waits_are_a_part_of_its_time(tmp_path):
    told = []
    config = small_config(total_steps=480, num_worlds=4, rollout_length=4, checkpoint_interval=2)
    train(DriveToy(4), config, tmp_path / "run", progress=False, watch=told.append)
    steps = told[0]["agent_steps"]
    assert len(told) == 10
    for line in told:
        assert 0.0 < sum(line["waits"].values()) <= steps / line["steps_per_s"] + 1e-5  # rounded to 1e-6
    assert all(line["waits"]["device"] > 0.0 for line in told)
    # The line after a checkpoint has what it took.
    assert sum(line["waits"]["checkpoint"] for line in told[2::2]) > 0.0
