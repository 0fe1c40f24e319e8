"""A run in Weights & Biases, in whose place a module is that notes what it is told."""

import sys
import types

import pytest

from usarmjx.base.errors import UsageError
from usarmjx.train.learning.metrics import wandb_watch


def test_iterations_are_sent_over_agent_steps_and_a_dead_service_stops_nothing(monkeypatch):
    begun, sent, said = [], [], []

    def log(numbers, step):
        if step > 100:
            raise ConnectionError("nobody\nthere")
        sent.append((numbers, step))

    module = types.ModuleType("wandb")
    module.init = lambda **given: begun.append(given) or types.SimpleNamespace(log=log)
    monkeypatch.setitem(sys.modules, "wandb", module)
    watch = wandb_watch("robots", "goal", {"worlds": 2}, said.append)
    for steps in (50, 100, 150, 200):
        watch({"agent_steps": steps, "score": 0.5, "return": None})
    assert begun == [
        {"project": "robots", "id": "goal", "name": "goal", "config": {"worlds": 2}, "resume": "allow"}
    ]
    assert sent == [({"agent_steps": n, "score": 0.5}, n) for n in (50, 100)]
    assert said == ["note: Weights & Biases: nobody there; training goes on"]


def test_a_missing_or_refusing_service_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(UsageError, match="pip install wandb"):
        wandb_watch("robots", "goal", {}, print)
    module = types.ModuleType("wandb")
    module.init = lambda **given: 1 / 0
    monkeypatch.setitem(sys.modules, "wandb", module)
    with pytest.raises(UsageError, match="Weights & Biases: division by zero"):
        wandb_watch("robots", "goal", {}, print)
