"""A training's programs are kept from one start to the next, and are those of its settings."""

import warnings
from dataclasses import replace

import jax
import numpy as np
import pytest

from usarmjx.base import program_cache
from usarmjx.base.compilation import PROGRAMS_FOLDER
from usarmjx.train.envs.env import Env
from usarmjx.train.learning import train_state
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.learner import Trainer
from usarmjx.train.learning.processes import ProcessGroup
from usarmjx.train.learning.rollout import Rollout
from usarmjx.train.learning.trainer import compiling
from usarmjx.train.make import make_task

CONFIG = Config(
    num_worlds=2, num_minibatches=1, rollout_length=2, hidden_sizes=(4,), critic_hidden_sizes=(4,)
)
TASK = make_task("drive-to-goal", ranges=(), pose="GroundTruth")


def trained(engine, config=CONFIG):
    trainer = Trainer(Env(TASK, 2, engine=engine), config, ProcessGroup())
    with compiling(trainer):
        learner, worlds = trainer.start()
    for iteration in range(2):
        learner, worlds, known = trainer.iterate(learner, worlds, iteration)
    return jax.tree.map(np.asarray, (learner, known))


TRACED = {
    Rollout: ("_scan", "_choose_actions", "_record_step", "_rollout_ends"),
    Trainer: ("_update_shards",),
    train_state: ("_initial",),
}


def not_to_be_traced(name):
    def traced(*_):
        raise RuntimeError("it was traced")

    traced.__name__ = name  # by which it was kept
    return traced


@pytest.mark.parametrize("engine", ["c", pytest.param("planar", marks=pytest.mark.thorough)])
def test_the_second_start_traces_nothing_and_learns_the_same(engine, tmp_path, monkeypatch):
    monkeypatch.setenv(PROGRAMS_FOLDER, str(tmp_path))
    monkeypatch.setattr(program_cache, "_sources", lambda: "as they are")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nothing of it is not kept
        first = trained(engine)

        for owner, names in TRACED.items():
            for name in names:
                monkeypatch.setattr(owner, name, not_to_be_traced(name))
        jax.tree.map(np.testing.assert_array_equal, first, trained(engine))
        with pytest.raises(RuntimeError, match="it was traced"):
            trained(engine, replace(CONFIG, gamma=0.9))


@pytest.mark.thorough
def test_programs_are_those_of_any_seed(tmp_path, monkeypatch):
    """What another seed has kept does what the seed's own would do."""
    monkeypatch.setattr(program_cache, "_sources", lambda: "as they are")
    other = replace(CONFIG, seed=1)
    monkeypatch.setenv(PROGRAMS_FOLDER, str(tmp_path / "own"))
    own = trained("c", other)
    monkeypatch.setenv(PROGRAMS_FOLDER, str(tmp_path / "of seed 0"))
    first = trained("c")
    for owner, names in TRACED.items():
        for name in names:
            monkeypatch.setattr(owner, name, not_to_be_traced(name))
    found = trained("c", other)
    jax.tree.map(np.testing.assert_array_equal, own, found)
    pairs = zip(jax.tree.leaves(first[0].params), jax.tree.leaves(found[0].params), strict=True)
    assert any((one != another).any() for one, another in pairs)


@pytest.mark.parametrize("fails", [False, True])
def test_what_is_done_meanwhile_begins_once_the_rollout_is_with_xla(fails, monkeypatch):
    """Also where it could not be traced: its first call tells why."""
    trainer, order = Trainer(Env(TASK, 2, engine="planar"), CONFIG, ProcessGroup()), []

    def compile_ahead(*shapes, tell):
        order.append("traced")
        if fails:
            raise RuntimeError("it cannot be traced")
        tell(())
        order.append("compiled")

    monkeypatch.setattr(trainer.rollout, "compile_ahead", compile_ahead)
    monkeypatch.setattr(trainer, "compile_update", lambda *_: order.append("update"))
    with compiling(trainer):
        assert order[0] == "traced"
        order.append("meanwhile")
    assert sorted(order[1:]) == sorted(["meanwhile"] + ([] if fails else ["compiled", "update"]))
