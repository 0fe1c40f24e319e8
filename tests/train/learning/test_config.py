"""Settings: what they may be, and how they are typed."""

import json
import math
import warnings
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.settings import RenamedSettingWarning, default_reader, describe
from usarmjx.engines import ENGINES, choose_engine, engine_class
from usarmjx.train.learning.config import (
    DEFAULT_ENGINE,
    DEFAULT_PHYSICS,
    GOAL_TASKS,
    GPU_SETTINGS,
    HYPERPARAMETERS,
    Config,
    from_record,
    on_gpu,
    task_config,
    training_engine,
    training_fields,
    turn_settings,
    wheel_settings,
)
from usarmjx.train.learning.metrics import MetricsLog, read_lines, summary
from usarmjx.train.learning.rollout import Rollout
from usarmjx.train.task_names import recorded_name
from usarmjx.train.tasks import TASKS

ROOT = Path(__file__).parents[3]


def test_settings_are_read_with_their_type():
    texts = {
        "total_steps": "1_000", "gamma": "0.5", "hidden_sizes": "32,16", "stagger_resets": "no",
        "lr_schedule": "linear", "critic_hidden_sizes": "[8]", "num_worlds": "1e3",
    }  # fmt: skip
    assert default_reader().text_values(Config, texts) == {
        "total_steps": 1000, "gamma": 0.5, "hidden_sizes": (32, 16), "stagger_resets": False,
        "lr_schedule": "linear", "critic_hidden_sizes": (8,), "num_worlds": 1000,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("total_steps", "many", "a whole number from 1"),
        ("stagger_resets", "perhaps", "true or false"),
        ("hidden_sizes", "a,b", "a whole number from 1"),
        ("hidden_sizes", "64.7,64", "a whole number from 1"),
    ],
)
def test_texts_that_are_no_values_of_a_setting_are_refused(name, text, expected):
    with pytest.raises(UsageError, match=rf"^--set: {name}.* is .*, expected {expected}"):
        default_reader().text_values(Config, {name: text}, where="--set")


def test_unknown_settings_list_the_known_ones():
    with pytest.raises(UnknownNameError, match=r"no setting 'lr'; .* has: .*learning_rate"):
        task_config("drive-to-goal", lr=1)


def test_names_of_the_version_before_are_accepted_with_a_warning():
    """On command lines and in Python with a warning, in records of runs silently."""
    with pytest.warns(RenamedSettingWarning, match="discount of Config is called gamma now"):
        assert task_config("drive-to-goal", discount=0.5).gamma == 0.5
    old = {alias for one in describe(Config) for alias in one.note.aliases}
    assert len(old) == 25
    assert not old & {one.name for one in describe(Config)}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert from_record({"worlds": 8, "layers": [3], "value": 1.0}) == Config(
            num_worlds=8, hidden_sizes=(3,), value_coef=1.0
        )


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"total_steps": 0}, "total_steps is 0, expected a whole number from 1"),
        ({"gamma": 1.5}, "gamma is 1.5, expected a number from 0 to 1"),
        ({"gamma": math.nan}, "gamma is nan, expected a number from 0 to 1"),
        ({"clip_epsilon": 0.0}, "clip_epsilon is 0.0, expected a number above 0"),
        ({"imitation_std": 0.0}, "imitation_std is 0.0, expected a number above 0"),
        ({"lr_schedule": "cosine"}, "constant, linear, adaptive"),
        ({"hidden_sizes": ()}, "hidden_sizes is .*, expected a list of at least 1"),
        ({"critic_hidden_sizes": ()}, "critic_hidden_sizes is .*, expected a list of at least 1"),
        ({"gru_size": -1}, "gru_size is -1, expected a whole number from 0"),
        ({"num_worlds": 10, "num_minibatches": 4}, "10 worlds cannot be divided into 4"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, words):
    with pytest.raises(UsageError, match=words):
        Config(**settings)


def test_the_table_of_hyper_parameters_is_of_tasks_and_settings_that_there_are():
    for task in HYPERPARAMETERS:
        assert task in TASKS
        for gpu, more in ((False, {}), (True, GPU_SETTINGS[task])):
            found, given = asdict(task_config(task, gpu=gpu)), {**HYPERPARAMETERS[task], **more}
            assert {name: found[name] for name in given} == given
    ours = {name.lower() for name, task in TASKS if type(task).__module__.startswith("usarmjx.")}
    assert set(HYPERPARAMETERS) == ours == set(GPU_SETTINGS)
    assert task_config("Drive-To-Goal", gamma=0.5).gamma == 0.5
    assert task_config("trek") == Config()


@pytest.mark.parametrize(("task", "worlds"), [("explore-v1", 2048), ("victim-search-v1", 1024)])
def test_a_bare_command_has_the_settings_of_the_runs_that_are_told_of(task, worlds):
    """As their records say what was set otherwise then: benchmarks/results/train.jsonl."""
    records = map(json.loads, (ROOT / "benchmarks/results/train.jsonl").read_text().splitlines())
    name = task.removesuffix("-v1")
    runs = [r for r in records if r["task"] == name and r["when"] == "2026-11-22T12:15:00+00:00"]
    assert len(runs) == 5
    config = task_config(task, gpu=True)
    for run in runs:
        assert run["settings"]["training"] == [
            f"minibatches: 4 -> {config.num_minibatches}",
            f"imitate: 0 -> {config.imitation_steps}",
            f"checkpoint_every: 20 -> {config.checkpoint_interval}",
        ]
        assert run["worlds"] == config.num_worlds == worlds
    longest = max(run["agent_steps"] for run in runs)
    assert 0 <= longest - config.total_steps < 0.02 * longest  # the last iteration is a whole one
    assert (config.gamma, config.gae_lambda, config.hidden_sizes) == (0.97, 0.9, (256, 128))


def runs_of(task, engine):
    """The runs of a task on an engine whose settings are kept: benchmarks/results/train.jsonl."""
    records = map(json.loads, (ROOT / "benchmarks/results/train.jsonl").read_text().splitlines())
    kept = [run for run in records if "config" in run]
    return [run for run in kept if (recorded_name(run["task"]), run["engine"]) == (task, engine)]


@pytest.mark.parametrize(
    ("task", "engine", "fields", "seeds"),
    [
        ("drive-to-goal", "planar", {}, set(range(11))),
        ("explore-v1", "planar", {"physics": "coarse"}, {0, 1, 2, 3, 4}),
        ("victim-search-v1", "planar", {}, {0, 1, 2, 3, 4}),
        ("victim-search-v1", "planar", {"physics": "coarse"}, {0, 1, 2}),
        ("explore-v2", "planar", {"physics": "coarse"}, {0, 1, 2, 3, 4, 5, 6}),
        ("explore-v2", "planar", {"physics": "coarse", "advice": "false"}, {0, 1, 2}),
        ("victim-search-v2", "planar", {}, {0, 1, 2, 3, 4, 5, 6}),
        ("victim-search-v2", "planar", {"physics": "coarse"}, {0, 1, 2, 3, 4}),
        ("relay-chain-v1", "planar", {"physics": "coarse"}, {0, 1, 2}),
        ("hover-inspect", "planar", {}, {0, 1, 2}),
        ("wander", "planar", {}, {0, 1, 2}),
        ("convoy", "planar", {}, {0, 1, 2}),
        ("hover-inspect", "warp", {}, {0}),
        ("wander", "warp", {}, {0}),
        ("relay-chain-v1", "warp", {}, {0}),
        ("convoy", "warp", {}, {1, 2}),
        ("stairs", "warp", {}, {0, 1, 2}),
        ("soccer-v1", "warp", {}, {0, 1, 2}),
        ("victim-search-v2", "warp", {}, {0}),
    ],
)
def test_the_runs_on_gpus_that_are_told_of_had_the_settings_of_a_bare_command(task, engine, fields, seeds):
    """The last of each seed on a GPU; how often they were kept decides nothing of what is learned."""
    runs = {
        run["seed"]: run
        for run in runs_of(task, engine)
        if run["device"].startswith("NVIDIA") and run["settings"]["task"] == fields
    }
    assert set(runs) == seeds
    for seed, run in runs.items():
        kept = run["config"].get("checkpoint_every") or run["config"]["checkpoint_interval"]
        config = task_config(task, gpu=True, seed=seed, checkpoint_interval=kept)
        assert from_record(run["config"]) == config


@pytest.mark.parametrize(
    ("task", "engine"),
    [("convoy", "planar"), ("hover-inspect", "planar"), ("wander", "planar"), ("stairs", "c")],
)
def test_the_runs_of_small_tasks_that_are_told_of_were_bare_commands(task, engine):
    """Three seeds, of which nothing but the seed was set: benchmarks/results/train.jsonl."""
    runs = {run["seed"]: run for run in runs_of(task, engine) if not run["device"].startswith("NVIDIA")}
    assert set(runs) == {0, 1, 2}
    for seed, run in runs.items():
        assert from_record(run["config"]) == task_config(task, seed=seed)
        assert run["settings"]["task"] == {}


def test_tasks_have_a_usual_engine_that_can_run_them_and_others_may_be_named():
    for task, engine in DEFAULT_ENGINE.items():
        assert training_engine(task.upper(), "auto") == engine
        assert training_engine(task, "c") == "c"
        assert training_fields(task, "c") == {}
        assert task in TASKS
        assert not TASKS.get(task).needs_solver
    assert set(DEFAULT_PHYSICS) <= set(DEFAULT_ENGINE)
    assert training_fields("Explore-V2", "planar") == {"physics": "coarse"}
    assert (
        training_engine("stairs", "auto") == training_engine("trek", "auto") == choose_engine("auto", "train")
    )
    with pytest.raises(UnknownNameError):
        training_engine("wander", "flat")


@pytest.mark.parametrize("task", sorted(set(HYPERPARAMETERS) - {"drive-to-goal"}))
def test_new_settings_see_to_the_end_of_an_episode(task):
    """What comes at its end counts 1/e at its start, but where figures are told of a shorter sight."""
    config, steps = task_config(task), TASKS.get(task).episode_steps
    if TASKS.get(task) in {TASKS.get(short) for short in ("explore-v1", "victim-search-v1", "explore-v2")}:
        assert config.gamma**steps < 0.01
    elif task in (*GOAL_TASKS, "relay-chain-v1", "victim-search-v2", "soccer-v2"):
        assert (config.gamma, config.gae_lambda) == (0.99, 0.95)
    else:
        assert config.gamma**steps == pytest.approx(math.exp(-1), rel=0.01)
        assert 1 / (1 - config.gamma * config.gae_lambda) == pytest.approx(steps / 10)


def test_minibatches_that_nobody_set_divide_the_worlds():
    assert task_config("explore-v1", gpu=True, num_worlds=24).num_minibatches == 8
    assert task_config("explore-v1", num_worlds=3).num_minibatches == 1
    with pytest.raises(UsageError, match="3 worlds cannot be divided into 2 minibatches"):
        task_config("explore-v1", num_worlds=3, num_minibatches=2)


def test_robots_that_choose_in_turns_keep_an_action_for_a_turn():
    """As long a rollout, imitation and training as without turns, and as much discount a second."""
    usual, turns = task_config("explore-v3"), turn_settings("explore-v3", 4)
    assert turns["action_repeat"] == 4
    for name in ("rollout_length", "imitation_steps", "total_steps"):
        assert turns[name] * 4 == getattr(usual, name) * usual.action_repeat
    for name in ("gamma", "gae_lambda"):
        assert turns[name] ** 2 == pytest.approx(getattr(usual, name), abs=1e-6)
    assert turn_settings("explore-v3", 0) == turn_settings("explore-v3", 8) == {}
    env = SimpleNamespace(task=SimpleNamespace(turn_length=4), worlds=4)
    with pytest.raises(UsageError, match="action_repeat is 8, but robots choose goals and messages in turns"):
        Rollout(cast(Any, env), cast(Any, None), usual)


def test_robots_of_goals_that_are_driven_by_wheels_get_a_network_over_all_numbers():
    usual, own = task_config("explore-v3"), wheel_settings("explore-v3", discrete=False)
    assert (own["network"], own["action_repeat"]) == ("mlp", 1)
    assert own["gamma"] ** usual.action_repeat == pytest.approx(usual.gamma, abs=1e-5)
    assert own["gae_lambda"] ** usual.action_repeat == pytest.approx(usual.gae_lambda, abs=1e-5)
    assert wheel_settings("explore-v3", discrete=True) == wheel_settings("explore-v2", discrete=False) == {}


def test_engines_that_need_no_gpu_use_none(monkeypatch):
    monkeypatch.setattr("jax.default_backend", lambda: "gpu")
    on_host = {name for name in ENGINES.names() if not engine_class(name).traceable}
    assert {name for name in ENGINES.names() if not on_gpu(name)} == on_host == {"c"}
    assert on_gpu("auto")
    monkeypatch.setattr("jax.default_backend", lambda: "cpu")
    assert not on_gpu("auto")


def test_settings_come_back_from_json():
    config = Config(hidden_sizes=(3, 4), gru_size=5)
    assert (
        from_record({k: list(v) if isinstance(v, tuple) else v for k, v in asdict(config).items()}) == config
    )


@pytest.mark.parametrize(
    ("worlds", "minibatches", "blocks", "expected"),
    [(64, 4, 8, 8), (8, 4, 8, 2), (96, 4, 8, 8), (28, 4, 8, 7)],
)
def test_blocks_divide_the_worlds_of_a_minibatch(worlds, minibatches, blocks, expected):
    assert (
        Config(num_worlds=worlds, num_minibatches=minibatches, shuffle_blocks=blocks).shuffled_blocks
        == expected
    )


def test_means_of_an_iteration():
    """4 of 20 world-steps were bad; two episodes ended, one of them by time-out."""
    sums = {
        "episodes": 2.0, "return": 3.0, "score": 1.0, "length": 9.0, "timeouts": 1.0, "bad": 4.0,
        "end/way": 5.0, "step/way": 10.0, "loss/value": 0.25,
    }  # fmt: skip
    assert summary(sums, 20) == {
        "episodes": 2.0, "return": 1.5, "score": 0.5, "length": 4.5, "timeouts": 0.5, "bad": 0.2,
        "end/way": 2.5, "step/way": 0.5, "loss/value": 0.25,
    }  # fmt: skip
    none = summary({**sums, "episodes": 0.0, "loss/value": float("nan")}, 20)
    assert [none[name] for name in ("score", "return", "loss/value")] == [None] * 3


def test_the_log_drops_what_is_done_again_and_shows_a_bar(tmp_path):
    """As after a kill behind the last checkpoint."""
    shown = SimpleNamespace(text="")
    from rich.console import Console

    class Sink:
        def write(self, text):
            shown.text += text

        def flush(self):
            pass

    line = {"agent_steps": 1, "steps_per_s": 1234.0, "return": 0.5, "score": 0.25, "bad": 0.125}
    with MetricsLog(tmp_path, 5, bar=False) as log:
        for iteration in (1, 2, 3):
            log.write({"iteration": iteration, **line})
    with MetricsLog(
        tmp_path, 5, after=1, console=Console(file=Sink(), force_terminal=True, width=120)
    ) as log:
        log.write({"iteration": 2, **line, "score": 0.75})
    assert [(r["iteration"], r["score"]) for r in read_lines(tmp_path / "metrics.jsonl")] == [
        (1, 0.25),
        (2, 0.75),
    ]
    for words in ("2/5", "1,234 steps/s", "return 0.5", "score 0.75", "bad worlds 12.50%"):
        assert words in shown.text


def test_a_log_with_a_broken_line_in_the_middle_is_refused(tmp_path):
    (tmp_path / "metrics.jsonl").write_text('{"iteration": 1}\n{"iter\n{"iteration": 3}\n')
    with pytest.raises(UsageError, match=r"metrics\.jsonl:2: is no JSON"):
        read_lines(tmp_path / "metrics.jsonl")
