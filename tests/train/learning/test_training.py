"""Whole runs on toys: they learn, what they must not learn from is left out, and nothing compiles twice."""

import json
import struct
from contextlib import contextmanager
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tensorboardX.proto.event_pb2 import Event

from tests.listening import COMPILED, compilations
from tests.train.runs import CONFIG, lines
from tests.train.toys import DriveToy, EndlessToy, MemoryToy, small_config
from usarmjx.base.errors import UsageError
from usarmjx.train.learning import trainer as iterations_module
from usarmjx.train.learning import trainer as trainer_module
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.learner import Trainer
from usarmjx.train.learning.processes import ProcessGroup
from usarmjx.train.learning.trainer import StopRequest, compiling, train


def test_three_robots_of_two_classes_learn_to_drive_to_their_goals(reference):
    """In 24000 agent steps from under 20 % of the episodes to over 80 %."""
    records = lines(reference)
    assert [record["iteration"] for record in records] == list(range(1, 11))
    assert records[-1]["agent_steps"] == 24_000
    assert records[0]["score"] < 0.2
    assert records[-1]["score"] > 0.8
    assert records[-1]["return"] > records[0]["return"] + 1.0
    # A goal is 0.84 away on average (of uniform places, 0.3 and 1 wide) and a step at most 0.28.
    assert records[-1]["length"] < 15 < records[0]["length"]


def test_what_is_written_of_a_run(reference):
    """The settings, and for each iteration the same numbers in both logs."""
    settings = json.loads((reference / "config.json").read_text())
    assert settings["task"] == "drive-toy"
    assert settings["config"]["seed"] == CONFIG.seed
    assert [group["name"] for group in settings["groups"]] == ["A", "B"]
    record = lines(reference)[-1]
    assert (record["level"], record["loss/skipped"]) == (1.0, 0.0)
    assert record["end/success"] == record["score"]
    shown = on_the_board(reference)
    for line in lines(reference):
        del line["iteration"]
        number = line.pop("agent_steps")
        told = {name: value for name, value in line.items() if value is not None}
        assert told == {name: pytest.approx(shown[name, number]) for name in told}
    assert ("steps_per_s", 24_000) in shown


def on_the_board(folder):
    """What TensorBoard shows of a run, by name and agent steps.

    Its files are records of length, checksum of that, an event, checksum of that (TFRecord).
    """
    found = {}
    for file in (folder / "tensorboard").iterdir():
        data, at = file.read_bytes(), 0
        while at < len(data):
            (size,) = struct.unpack_from("<Q", data, at)
            event = Event.FromString(data[at + 12 : at + 12 + size])
            found |= {(one.tag, event.step): one.simple_value for one in event.summary.value}
            at += size + 16
    return found


def test_worlds_that_go_wrong_are_counted_and_do_no_harm(reference):
    """A robot that goes too far to the right makes its world NaN: nothing of that gets into the networks."""
    records = lines(reference)
    assert records[-1]["bad"] > 0.01
    for record in records:
        assert all(value is not None for name, value in record.items() if name.startswith("loss/"))


@pytest.fixture(scope="module")
def both():
    """The same run with one compiled rollout, and step by step: compilations, what was first collected."""
    found = {}
    config = Config(
        num_worlds=4,
        num_minibatches=2,
        rollout_length=4,
        hidden_sizes=(4,),
        critic_hidden_sizes=(4,),
        gru_size=3,
    )
    with compilations(COMPILED) as compiled:
        for traceable in (True, False):
            trainer = Trainer(DriveToy(4, traceable=traceable), config, ProcessGroup())
            train_state, worlds = trainer.start()
            found["looks", traceable] = looks = []
            trainer.rollout.look = looks.append
            first, counts = trainer.rollout.collect(train_state, worlds, trainer._key), []
            for iteration in range(3):
                train_state, worlds, known = trainer.iterate(train_state, worlds, iteration)
                jax.device_get(known)
                counts.append(len(compiled))
            found[traceable] = (counts, first)
    return found


@pytest.mark.parametrize("traceable", [True, False])
def test_nothing_is_compiled_after_the_first_iteration(both, traceable):
    counts, _ = both[traceable]
    assert counts[0] > 0
    assert counts == counts[:1] * 3


def test_a_first_rollout_finds_what_was_compiled_beside_the_making_of_worlds():
    group = ProcessGroup()
    with compilations(COMPILED) as compiled:
        trainer = Trainer(DriveToy(4), small_config(num_worlds=4, rollout_length=2), group)
        with compiling(trainer):
            train_state, worlds = trainer.start()
        before = len(compiled)
        jax.block_until_ready(trainer.rollout.collect(train_state, worlds, trainer._key))
    assert before > 0
    assert len(compiled) == before
    trainer.iterate(train_state, worlds, 0)
    for program in (trainer.rollout._collect_at_once, trainer._update):
        assert program._ready is not None, "what was compiled is what is called"


def test_an_iteration_of_worlds_that_the_host_steps_has_its_own_time():
    """None waits for the next one to be over, and the last two are not read at one moment."""

    def iterate(train_state, worlds, number):
        return train_state, worlds, {"number": number}

    def read(traceable):
        trainer = SimpleNamespace(
            iterations=4,
            iterate=iterate,
            config=Config(checkpoint_interval=2),
            env=SimpleNamespace(traceable=traceable),
            process_group=SimpleNamespace(count=2),
        )
        stop = StopRequest(print)
        return [
            [one.number for one in ready] for ready in iterations_module._iterations(trainer, (0, 0, 0), stop)
        ]

    assert read(traceable=False) == [[1], [2], [3], [4]]
    assert read(traceable=True) == [[], [1], [2], [3, 4]]


def test_the_time_of_the_first_iteration_is_from_when_it_compiled(tmp_path, monkeypatch):
    """Records tell when a score was reached: what was waited for before the first rollout is in it."""
    clock = SimpleNamespace(now=0.0)

    def tick():
        clock.now += 1.0
        return clock.now

    @contextmanager
    def slow(*_):
        clock.now += 100.0
        yield

    for module in (trainer_module, iterations_module):
        monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=tick))
    monkeypatch.setattr(trainer_module, "compiling", slow)
    config = small_config(total_steps=144, num_worlds=4, rollout_length=4)  # three iterations of 48
    told = []
    train(DriveToy(4), config, tmp_path / "run", progress=False, watch=told.append)
    steps = told[0]["agent_steps"]
    assert [steps / line["steps_per_s"] for line in told] == [101.0, *[1.0] * (len(told) - 1)]
    assert len(told) == 3


def test_who_looks_sees_the_worlds_after_each_action_or_each_compiled_rollout(both):
    config_rollout, rollouts = 4, 4
    assert len(both["looks", True]) == rollouts
    assert len(both["looks", False]) == rollouts * config_rollout
    lengths = [np.asarray(state.length).sum() for state in both["looks", False]]
    assert len(set(lengths[:config_rollout])) > 1


def test_a_rollout_step_by_step_is_that_in_one_piece(both):
    """As with an engine that cannot be traced; rounding may differ by what XLA fuses."""
    one_piece, by_step = (jax.tree.leaves(both[traceable][1]) for traceable in (True, False))
    for one, other in zip(one_piece, by_step, strict=True):
        if jax.numpy.issubdtype(one.dtype, jax.dtypes.prng_key):
            assert_array_equal(jax.random.key_data(one), jax.random.key_data(other))
        else:
            assert_allclose(one, other, atol=1e-5)


def memory_score(tmp_path, memory):
    """Return what share of the lights was told right in the last iterations."""
    config = Config(
        total_steps=40_000,
        num_worlds=64,
        rollout_length=20,
        learning_rate=3e-3,
        gamma=0.99,
        hidden_sizes=(16,),
        critic_hidden_sizes=(16,),
        gru_size=memory,
        checkpoint_interval=1000,
    )
    train(lambda worlds, first: MemoryToy(worlds, first), config, tmp_path / str(memory), progress=False)
    return np.mean([record["score"] for record in lines(tmp_path / str(memory))[-5:]])


@pytest.mark.thorough
def test_what_was_seen_before_is_used_by_a_policy_with_memory(tmp_path):
    """And by no other: what it sees at the end says nothing of the light, so 1/2 is all it can get.

    In 5 iterations 1280 lights were told: 0.57 is five deviations from 1/2.
    """
    assert memory_score(tmp_path, 0) < 0.57
    assert memory_score(tmp_path, 8) > 0.95


@pytest.mark.oracle
@pytest.mark.thorough
def test_a_time_limit_is_no_end(tmp_path):
    """A reward of 1 for ever is worth 1 / (1 - discount) = 5, though episodes are cut after 4 steps.

    Without the critic's opinion of the last state it would be 1 to 2.95, depending on the time.
    """
    config = Config(
        total_steps=60_000, num_worlds=16, rollout_length=16, gamma=0.8,
        learning_rate=3e-3,
        lr_schedule="constant",
        hidden_sizes=(8,),
        critic_hidden_sizes=(8,),
        entropy_coef=0.0,
    )  # fmt: skip
    trainer = Trainer(EndlessToy(16), config, ProcessGroup())
    train_state, worlds = trainer.start()
    for iteration in range(60):
        train_state, worlds, _ = trainer.iterate(train_state, worlds, iteration)
    _, steps, _, _ = trainer.rollout.collect(train_state, worlds, jax.random.key(0))
    assert np.asarray(steps.truncated).any()
    assert_allclose(steps.value[0], 5.0, rtol=0.03)
    assert_allclose(np.asarray(steps.bootstrap_value[0])[np.asarray(steps.truncated)], 5.0, rtol=0.03)


def test_first_episodes_begin_at_random_times():
    """So that not all time-outs come at once; the same for a world in whichever process."""
    config = Config(num_worlds=32, hidden_sizes=(4,), critic_hidden_sizes=(4,))
    _, worlds = Trainer(DriveToy(32), config, ProcessGroup()).start()
    lengths = np.asarray(worlds.env_state.length)
    assert lengths.min() < 5
    assert 19 < lengths.max() < DriveToy.episode_steps


def test_worlds_that_do_not_fit_are_refused(tmp_path):
    with pytest.raises(UsageError, match="16 worlds; 32 worlds of 1 processes need 32"):
        Trainer(DriveToy(16), CONFIG, ProcessGroup())
    assert not (tmp_path / "run").exists()
