"""A run that begins with the networks of another one acts as that did, on any engine; and goes on alone."""

import json
import shutil
from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from typer.testing import CliRunner

from tests.train.runs import CONFIG, check_goes_on, lines
from tests.train.toys import DriveToy, MemoryToy
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.cli.train_plan import TrainOptions, plan_run, recorded_engine
from usarmjx.train.evaluation.evaluate import play_episodes
from usarmjx.train.learning.checkpoint import Checkpoints, load_train_state, read_policy
from usarmjx.train.learning.config import load_record, task_config
from usarmjx.train.learning.fine_tuning import load_trained
from usarmjx.train.learning.ppo import MIN_LEARNING_RATE
from usarmjx.train.learning.trainer import train

KEPT = replace(CONFIG, keep_checkpoints=100)
NO_LEARNING = replace(KEPT, total_steps=4800, lr_schedule="constant", learning_rate=1e-30)
"""Steps that no weight resolves."""
TAKEN = ("params", "obs_statistics", "privileged_statistics", "return_statistics")


def assert_same(one, other):
    for left, right in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert_array_equal(left, right)


@cache
def toy():
    return DriveToy(32)


def scores(run, which):
    """Of an episode of each world, with most probable actions."""
    policy, params, _ = read_policy(run, which)
    return play_episodes(toy(), policy.as_policy(params), 32, seed=3).scores


def tuned(folder, source, config=KEPT, **how):
    def make(worlds, first):
        return DriveToy(worlds, first, rotten=True)

    return train(make, config, folder, source=source, progress=False, **how)


@pytest.mark.thorough
def test_it_begins_with_everything_that_was_learned_and_acts_as_its_source(reference, tmp_path):
    """And where nothing is learned it stays that; Adam's moments and the count of iterations are new."""
    trained = load_trained(reference)
    tuned(tmp_path / "run", trained, NO_LEARNING)
    assert [path.name for path in Checkpoints(tmp_path / "run").all()] == [f"{i:08d}" for i in range(3)]
    _, begun, _ = load_train_state(tmp_path / "run", "0")
    _, source, _ = load_train_state(reference, "best")
    for name in TAKEN:
        assert_same(getattr(begun, name), getattr(source, name))
    assert int(begun.iteration) == 0
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(begun.opt_state))
    assert any(np.any(leaf) for leaf in jax.tree.leaves(source.opt_state))
    assert_array_equal(scores(tmp_path / "run", "0"), scores(reference, "best"))
    _, ended, _ = load_train_state(tmp_path / "run", "last")
    assert int(ended.iteration) == 2
    assert_same(ended.params, source.params)


@pytest.mark.thorough
def test_it_goes_on_carefully(reference, tmp_path):
    """At the rate of a random network its first update changed the policy by 0.037."""
    config = replace(KEPT, lr_schedule="adaptive", learning_rate=3e-3, num_minibatches=8, total_steps=2400)
    tuned(tmp_path / "run", load_trained(reference, "last"), config)
    (first,) = lines(tmp_path / "run")
    assert 0.0 < first["loss/divergence"] < 3 * config.target_kl
    tuned(tmp_path / "steady", load_trained(reference), replace(config, lr_schedule="constant"))
    (first,) = lines(tmp_path / "steady")
    assert first["loss/rate"] == pytest.approx(3e-3)


def test_imitation_of_what_begins_so_keeps_its_learning_rate(reference):
    """At the lowest one it would teach nothing."""
    source, config = load_trained(reference), replace(KEPT, lr_schedule="adaptive")
    fresh = source.train_state.replace(learning_rate=np.float32(2e-3))
    for imitate, rate in ((0, MIN_LEARNING_RATE), (2400, 2e-3)):
        begun = source.begin(fresh, replace(config, imitation_steps=imitate))
        assert float(begun.learning_rate) == pytest.approx(rate)


@pytest.mark.thorough
def test_its_first_rollout_is_that_of_a_trained_policy(reference, tmp_path):
    """The source's first iterations, with the same worlds and random numbers, scored less."""
    tuned(tmp_path / "run", load_trained(reference, "last"), replace(CONFIG, total_steps=4800))
    first = [line["score"] for line in lines(reference)[:2]]
    assert sum(line["score"] for line in lines(tmp_path / "run")) > sum(first)


@pytest.mark.thorough
def test_a_run_that_began_so_is_resumed_without_its_source(reference, tmp_path):
    source = tmp_path / "source"
    shutil.copytree(reference, source)
    tuned(tmp_path / "whole", load_trained(source))
    shutil.rmtree(source)
    for left in (1, 4):  # nothing but what it began with; and three iterations
        check_goes_on(
            lambda worlds, first: DriveToy(worlds, first, rotten=True),
            KEPT,
            tmp_path / "whole",
            tmp_path / f"left_{left}",
            left,
        )
        origin = load_record(tmp_path / f"left_{left}").began_with
        assert (origin["run"], origin["task"]) == (str(source), "drive-toy")
    shutil.rmtree(tmp_path / "left_1" / "checkpoints")
    with pytest.raises(UsageError, match="stopped before it had kept the networks that it was to begin with"):
        tuned(tmp_path / "left_1", None, resume=True)


class Blinkered(DriveToy):
    """Sees half of it."""

    groups = tuple(replace(group, obs_size=1) for group in DriveToy.groups)

    def see(self, x, time):
        obs, privileged = super().see(x, time)
        return tuple(one[..., :1] for one in obs), privileged


@pytest.mark.parametrize(
    ("env", "settings", "words"),
    [
        (Blinkered, {}, r"robots: .* that see 2 and do 2, .* that see 1 and do 2"),
        (MemoryToy, {}, r"numbers that only critics see: \d -> 1"),
        (DriveToy, {"hidden_sizes": (16,)}, r"do not fit: hidden_sizes: \(32, 32\) -> \(16,\)$"),
        (
            DriveToy,
            {"critic_hidden_sizes": (8,), "gru_size": 4},
            r"critic_hidden_sizes: .* gru_size: 0 -> 4$",
        ),
    ],
)
def test_networks_that_do_not_fit_are_named_and_nothing_is_written(env, settings, words, reference, tmp_path):
    with pytest.raises(UsageError, match=words):
        train(
            lambda worlds, first: env(worlds, first),
            replace(CONFIG, **settings),
            tmp_path / "run",
            source=load_trained(reference),
            progress=False,
        )
    assert not (tmp_path / "run" / "config.json").exists()


def test_a_folder_that_has_checkpoints_is_refused(reference, tmp_path):
    shutil.copytree(reference / "checkpoints", tmp_path / "run" / "checkpoints")
    with pytest.raises(UsageError, match="has checkpoints already: choose another folder"):
        tuned(tmp_path / "run", load_trained(reference))


def invoke(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture(scope="module", params=["c", pytest.param("planar", marks=pytest.mark.thorough)])
def short_run(request, tmp_path_factory):
    """A short training with settings of its own; `c` compiles fastest, `planar` is another engine."""
    folder = tmp_path_factory.mktemp(request.param) / "run"
    told = (
        "rollout_length=2",
        "num_minibatches=1",
        "num_epochs=1",
        "hidden_sizes=4,3",
        "critic_hidden_sizes=4",
        "episode_steps=7",
        "ranges=",
        "pose=GroundTruth",
        *(["physics=coarse"] if request.param == "planar" else []),
    )
    pairs = [word for pair in told for word in ("--set", pair)]
    small = ("--worlds", 2, "--steps", 8, "--quiet")
    result = invoke("train", "drive-to-goal", "--engine", request.param, "--out", folder, *small, *pairs)
    assert result.exit_code == 0, result.output
    return folder


def test_a_run_has_the_networks_and_fields_of_another_but_its_own_engine_and_physics(short_run, tmp_path):
    out, engine = tmp_path / "tuned", recorded_engine(short_run)
    small = (
        "--worlds",
        2,
        "--steps",
        8,
        "--quiet",
        "--set",
        "rollout_length=2",
        "--set",
        "num_minibatches=1",
    )
    result = invoke("train", "drive-to-goal", "--engine", "c", "--out", out, "--from", short_run, *small)
    assert result.exit_code == 0, result.output
    assert f"of {short_run}: drive-to-goal on engine {engine}, 8 agent steps; " in result.stderr
    settings = json.loads((out / "config.json").read_text())
    taken = {"episode_steps": "7", "ranges": "", "pose": "GroundTruth"}
    assert (settings["engine"], settings["overrides"]) == ("c", taken)
    assert (settings["config"]["hidden_sizes"], settings["config"]["critic_hidden_sizes"]) == ([4, 3], [4])
    found = settings["began_with"]
    assert found["run"] == str(short_run)
    assert (found["checkpoint"], found["engine"], found["agent_steps"]) == (2, engine, 8)
    assert_same(read_policy(out, "0")[1], read_policy(short_run)[1])
    assert [json.loads(line)["iteration"] for line in (out / "metrics.jsonl").open()] == [1, 2]
    result = invoke("train", "drive-to-goal", "--out", out, "--resume", "--steps", 12, "--quiet")
    assert result.exit_code == 0, result.output
    assert json.loads((out / "config.json").read_text())["began_with"] == found


def test_nobody_is_imitated_unless_asked_for(short_run, tmp_path):
    """Of another task fields are its own, and what is typed holds."""
    wanted = {"out": tmp_path / "x", "engine": "c", "source": short_run, "given": {}}
    plan = plan_run("wander", TrainOptions(**wanted, pairs=[]))
    assert (plan.config.imitation_steps, plan.overrides, plan.config.hidden_sizes) == (0, {}, (4, 3))
    assert task_config("wander").imitation_steps > 0
    plan = plan_run("wander", TrainOptions(**wanted, pairs=["imitation_steps=7", "hidden_sizes=5"]))
    assert (plan.config.imitation_steps, plan.config.hidden_sizes) == (7, (5,))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--from", "explore-v1"), "explore-v1 is no folder of a run; an exported policy has neither critic"),
        (("--from", "RUN", "--checkpoint", "77"), "no checkpoint '77' in "),
        (("--from", "RUN", "--resume"), "leave out --from or --resume"),
        (("--checkpoint", "last"), "--checkpoint says which one of the run that --from names"),
    ],
)
def test_a_source_that_is_none_is_one_line(words, told, short_run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = [str(short_run) if word == "RUN" else word for word in words]
    result = invoke("train", "drive-to-goal", "--engine", "c", "--out", "x", *words)
    assert result.exit_code == 2
    assert told in result.stderr
    assert not (tmp_path / "x").exists()
