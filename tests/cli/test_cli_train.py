"""`usarmjx train` and `usarmjx export`, on the smallest robot task."""

import errno
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from typer.main import get_command
from typer.testing import CliRunner

from usarmjx.base.errors import UsageError, WriteError
from usarmjx.cli.app import app
from usarmjx.cli.common import ErrorExit, say
from usarmjx.cli.train import _served
from usarmjx.cli.train_plan import TrainOptions, check_curriculum, recorded_engine
from usarmjx.train.learning.config import (
    Config,
    EnvArguments,
    RunRecord,
    save_seeds,
    seed_folder,
    task_config,
    training_engine,
)
from usarmjx.train.learning.trainer import TrainResult
from usarmjx.train.policies.policy_file import NumpyPolicy

SMALL = ["--task", "drive-to-goal", "--engine", "c", "--worlds", "2", "--steps", "8", "--quiet"]
SETTINGS = {
    "rollout_length": 2,
    "num_minibatches": 1,
    "num_epochs": 1,
    "hidden_sizes": 4,
    "critic_hidden_sizes": 4,
    "episode_steps": 7,  # of the task
    "ranges": "",
    "pose": "GroundTruth",
}


def invoke(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def test_a_run_is_trained_and_exported(tmp_path):
    """Two iterations; settings of the training and of the task both take effect."""
    out = tmp_path / "run"
    told = [word for name, value in SETTINGS.items() for word in ("--set", f"{name}={value}")]
    result = invoke("train", *SMALL, *told, "--out", out)
    assert result.exit_code == 0, result.output
    assert result.output.startswith("8 agent steps, score")
    settings = json.loads((out / "config.json").read_text())
    assert (settings["task"], settings["engine"], settings["episode_steps"]) == ("drive-to-goal", "c", 7)
    assert (recorded_engine(out), recorded_engine(tmp_path)) == ("c", "auto")
    assert settings["overrides"] == {"episode_steps": "7", "ranges": "", "pose": "GroundTruth"}
    assert settings["config"]["hidden_sizes"] == [4]
    assert [json.loads(line)["iteration"] for line in (out / "metrics.jsonl").open()] == [1, 2]
    result = invoke("export", out, "--out", tmp_path / "policy.npz", "--checkpoint", "last")
    assert result.exit_code == 0, result.output
    policy = NumpyPolicy(tmp_path / "policy.npz")
    group = policy.groups[policy.group("P2AT")]
    actions, _ = policy.act(0, np.zeros(group["obs_size"]), policy.initial_carry(0))
    assert actions.shape == (2,)  # Left and Right of DRIVE


def test_a_run_is_in_a_folder_of_its_task_and_goes_on_with_its_settings(tmp_path, monkeypatch):
    """What it was started with need not be typed again, and what is typed holds."""
    asked = []

    def train(env, config, out, resume, *, origin, **_):
        asked.append((config, out, resume, origin))
        return TrainResult(out, 1, 8, {})

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("usarmjx.train.learning.trainer.train", train)
    assert invoke("train", "drive-to-goal").exit_code == 0
    config, folder, _, origin = asked.pop()
    assert (config, folder) == (task_config("drive-to-goal"), Path("runs/drive-to-goal"))
    assert origin == EnvArguments(training_engine("drive-to-goal", "auto"))
    assert (
        invoke("train", "drive-to-goal", "--resume").exit_code == 0
    )  # nothing is there: left to the trainer
    assert asked.pop() == (config, folder, True, EnvArguments("auto"))
    before = Config(num_worlds=3, num_minibatches=3, seed=5, gru_size=7)
    shape = {"groups": (), "privileged_size": 0, "episode_steps": 7, "period": 0.2, "processes": 1}
    folder.mkdir(parents=True)
    RunRecord(
        task="drive-to-goal", engine="c", overrides={"episode_steps": "7"}, config=before, **shape
    ).save(folder)
    assert invoke("train", "drive-to-goal", "--resume", "--steps", 12).exit_code == 0
    assert asked.pop() == (
        replace(before, total_steps=12),
        folder,
        True,
        EnvArguments("c", {"episode_steps": "7"}),
    )
    more = ["--seed", 6, "--set", "rollout_length=3", "--set", "episode_steps=8", "--engine", "jax"]
    assert invoke("train", "drive-to-goal", "--resume", *more).exit_code == 0
    config, _, _, origin = asked.pop()  # which the trainer refuses
    assert (config, origin) == (
        replace(before, seed=6, rollout_length=3),
        EnvArguments("jax", {"episode_steps": "8"}),
    )


@pytest.mark.parametrize(
    ("words", "engine", "fields"),
    [
        (["explore-v2"], "planar", {"physics": "coarse"}),
        (["explore-v2", "--set", "physics=fast"], "planar", {"physics": "fast"}),
        (["explore-v2", "--engine", "c"], "c", {}),
        (["wander"], "planar", {}),
    ],
)
def test_some_tasks_have_an_engine_of_their_own(words, engine, fields, tmp_path, monkeypatch):
    asked = []

    def train(env, config, out, resume, *, origin, **_):
        asked.append(origin)
        return TrainResult(out, 1, 8, {})

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("usarmjx.train.learning.trainer.train", train)
    result = invoke("train", *words)
    assert result.exit_code == 0
    assert asked == [EnvArguments(engine, fields)]
    told = f"usarmjx: {words[0]} trains on engine planar unless another is named"
    assert (told in result.stderr) == ("--engine" not in words)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["train", "--task", "drive", "--out", "x"], "unknown task"),
        (
            ["train", "--task", "drive-to-goal", "--out", "x", "--set", "lr=1"],
            "have no setting 'lr'; they have: ",
        ),
        (
            ["train", "--task", "drive-to-goal", "--out", "x", "--set", "num_epochs=a"],
            "--set: num_epochs is 'a', expected a whole number from 1",
        ),
        (["train", "--task", "drive-to-goal", "--out", "x", "--resume"], "nothing to resume in x"),
        (
            ["export", "nowhere", "--out", "x.npz"],
            "nowhere is no folder of a run, no exported policy, nor a packaged one; packaged: drive-to-goal",
        ),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = invoke(*words)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (OSError(errno.ENOSPC, "as Python has it"), "usarmjx: the output: No space left on device\n"),
        (OSError(errno.EROFS, "", "runs/x"), "usarmjx: runs/x: Read-only file system\n"),
    ],
)
def test_a_disk_that_refuses_what_a_command_shows_is_one_line(error, told, capsys):
    with pytest.raises(typer.Exit) as caught, ErrorExit():
        raise error
    assert caught.value.exit_code == 2
    assert capsys.readouterr().err == told
    with pytest.raises(FileNotFoundError), ErrorExit():
        Path("nowhere/x").read_text()  # a fault of ours, with its trace


def test_a_command_goes_on_when_nobody_can_hear_what_it_does(monkeypatch):
    """Its error stream goes to a file, and the disk is full."""
    with open("/dev/full", "w", buffering=1) as full:
        monkeypatch.setattr(sys, "stderr", full)
        say("compiling")
        with pytest.raises(typer.Exit), ErrorExit():
            raise WriteError("and this is not heard either")
        monkeypatch.undo()
        with pytest.raises(OSError, match="No space left"):
            full.close()


def test_what_was_trained_but_cannot_be_kept_is_the_exit_code(monkeypatch, tmp_path):
    def train(*_, **__):
        raise WriteError("cannot write x: No space left on device; the last checkpoint is missing")

    monkeypatch.setattr("usarmjx.train.learning.trainer.train", train)
    result = invoke("train", *SMALL, "--set", "num_minibatches=1", "--out", tmp_path / "x")
    assert result.exit_code == 2
    assert result.stderr.splitlines()[-1].endswith("No space left on device; the last checkpoint is missing")


def test_several_processes_run_the_same_command(monkeypatch):
    """Each is told who it is by its environment, and so does not start others."""
    called = []
    monkeypatch.setattr(
        "usarmjx.train.learning.launch.spawn", lambda count, command: called.append((count, command)) or 3
    )
    monkeypatch.setattr(sys, "argv", ["usarmjx", "train", "--processes", "2"])
    result = invoke("train", "--task", "drive-to-goal", "--out", "x", "--processes", "2")
    assert result.exit_code == 3
    assert called == [(2, [sys.executable, "-m", "usarmjx", "train", "--processes", "2"])]
    assert "USARMJX_PROCESS" not in os.environ


def test_the_world_of_a_run_is_served_at_the_ports_that_were_asked_for(monkeypatch, tmp_path):
    """By `play`, whose own options these are."""
    started = []

    def train(*_, **__):
        raise WriteError("enough")

    def start(command, **_):
        started.append(command)
        return SimpleNamespace(wait=lambda: 0)

    monkeypatch.setattr("usarmjx.train.learning.trainer.train", train)
    monkeypatch.setattr("usarmjx.cli.train.subprocess.Popen", start)
    own = ("--set", "num_minibatches=1", "--out", tmp_path / "x")
    invoke("train", *SMALL, *own, "--serve", "--port", "3001", "--port-offset", "100")
    ((*_, name, run, serve, follow, port, number, offset, ports),) = started
    assert (name, run, serve, follow) == ("play", str(tmp_path / "x"), "--serve", "--follow")
    assert (port, number, offset, ports) == ("--port", "3001", "--port-offset", "100")
    play = get_command(app).commands["play"]
    read = play.make_context("play", [run, serve, follow, port, number, offset, ports]).params
    assert (read["serve"], read["follow"], read["port"], read["port_offset"]) == (True, True, 3001, 100)


def test_a_system_without_posix_pipes_is_told_how_to_serve_a_run(monkeypatch):
    with monkeypatch.context() as there:
        there.setattr(os, "name", "nt")
        refused = pytest.raises(UsageError, match=r"run `usarmjx play runs/x --serve --follow` beside it")
        with refused, _served("runs/x", "drive-to-goal", 3000, True):
            pass


def test_several_seeds_are_runs_in_one_folder_and_go_on_with_their_settings(tmp_path, monkeypatch):
    """Numbered from --seed on; what they were started with need not be typed again."""
    asked = []

    def train(env, config, out, seeds, resume, *, origin, **_):
        asked.append((config.seed, config.num_worlds, out, seeds, resume, origin.engine))
        return [TrainResult(seed_folder(out, seed), 1, 8, {"score": 0.25}) for seed in seeds]

    monkeypatch.setattr("usarmjx.train.learning.seed_runs.train_seeds", train)
    out = tmp_path / "runs"
    result = invoke("train", *SMALL, "--set", "num_minibatches=1", "--seeds", 2, "--seed", 5, "--out", out)
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines() == [
        f"8 agent steps, score 0.25: {out / 'seed-5'}",
        f"8 agent steps, score 0.25: {out / 'seed-6'}",
    ]
    assert asked.pop() == (5, 2, out, (5, 6), False, "c")
    shape = {"groups": (), "privileged_size": 0, "episode_steps": 7, "period": 0.2, "processes": 1}
    for seed in (9, 4):
        seed_folder(out, seed).mkdir(parents=True)
        config = Config(num_worlds=3, num_minibatches=3, seed=seed)
        RunRecord(task="drive-to-goal", engine="c", config=config, **shape).save(seed_folder(out, seed))
    save_seeds(out, (9, 4))
    assert invoke("train", "drive-to-goal", "--resume", "--out", out).exit_code == 0
    assert asked.pop() == (9, 3, out, (9, 4), True, "c")
    assert invoke("train", "drive-to-goal", "--resume", "--seeds", 3, "--out", out).exit_code == 0
    assert asked.pop()[3] == (9, 10, 11)  # which the trainer refuses


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--processes", 2], "several seeds train in one process: leave out --processes, or --seeds"),
        (["--serve"], "--serve shows a single seed: leave it out, or --seeds"),
        (["--view"], "--view shows a single seed: leave it out, or --seeds"),
        (["--record", "x.mcap"], "--record shows a single seed: leave it out, or --seeds"),
        (["--clips", 5], "--clips shows a single seed: leave it out, or --seeds"),
        (["--wandb", "x"], "--wandb shows a single seed: leave it out, or --seeds"),
        (["--set", "curriculum=0.5"], "curriculum is 0.5: seeds that train together have none"),
    ],
)
def test_what_is_for_a_single_seed_is_refused_in_a_line(words, message, tmp_path):
    result = invoke("train", "drive-to-goal", "--seeds", 2, "--out", tmp_path / "x", *words)
    assert result.exit_code == 2
    assert result.stderr == f"usarmjx: {message}\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "typed", "refused"),
    [
        ("curriculum: 0.5\n", [], True),
        ("curriculum: 0.5\n", ["curriculum=0"], False),
        ("curriculum: 0\n", ["curriculum=1"], True),
        ("gamma: 0.9\n", [], False),
        ("curriculum: hard\n", [], False),  # refused as no number, with file and line
    ],
)
def test_a_curriculum_of_several_seeds_is_seen_in_the_file_of_settings_too(text, typed, refused, tmp_path):
    file = tmp_path / "s.yaml"
    file.write_text(text)
    options = TrainOptions(out=tmp_path / "x", engine="auto", config=file, given={}, pairs=typed)
    if not refused:
        check_curriculum(options)
        return
    with pytest.raises(UsageError, match=r"^curriculum is (0\.5|1\.0): seeds that train together have none$"):
        check_curriculum(options)


def test_a_curriculum_of_several_seeds_is_refused_before_jax_is_imported():
    words = ["usarmjx", "train", "drive-to-goal", "--seeds", "2", "--set", "curriculum=0.5"]
    code = f"import atexit, runpy, sys; sys.argv = {words}\n"
    code += "atexit.register(lambda: print('jax' in sys.modules))\n"
    code += "runpy.run_module('usarmjx', run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert done.stderr == "usarmjx: curriculum is 0.5: seeds that train together have none\n"
    assert done.stdout == "False\n"
