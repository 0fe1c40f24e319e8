"""Tasks of a user's own: named by file and class, imported, found again; what is said when they are not."""

import importlib
import json
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

import usarmjx
from tests.train.handmade import policy_file
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.sweeps.contents import key_of
from usarmjx.sweeps.drivers import find_driver
from usarmjx.sweeps.resolve import resolve
from usarmjx.sweeps.spec import complete
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.env import AgentGroup
from usarmjx.train.envs.task import Policy
from usarmjx.train.learning import checkpoint
from usarmjx.train.learning.config import Config, RunRecord, load_record
from usarmjx.train.learning.ppo import teacher_of
from usarmjx.train.make import find_task
from usarmjx.train.policies.sources import baseline, load_policy
from usarmjx.train.task_names import full_name

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_task.py"
HALF = """
import beside
from usarmjx.train.envs.task import Task

class Half(Task):
    robots = ("P2AT",)

def helper():
    pass

NUMBER = 3
"""


def invoke(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A folder with a task of one's own, which is where the commands run."""
    shutil.copy(EXAMPLE, tmp_path / "my_task.py")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_an_environment_of_an_own_task_has_the_whole_path_as_its_name(own):
    env = usarmjx.make("my_task.py:Meet", worlds=2, engine="c", near=1.5)
    assert (env.name, env.task.near) == (f"{own}/my_task.py:Meet", 1.5)
    assert [(group.name, group.obs_size) for group in env.groups] == [("P2DX", 2)]
    assert isinstance(teacher_of(env), Policy), "what the class has by hand is there to be imitated"
    with pytest.raises(UsageError, match=r"my_task.py:Meet has no field far; it has: .*near"):
        usarmjx.make("my_task.py:Meet", far=1.0)


def test_a_task_is_imported_once_for_each_content_of_its_file(own):
    first = find_task("my_task.py:Meet")
    assert type(find_task(f"{own}/my_task.py:Meet")) is type(first)
    file = own / "my_task.py"
    file.write_text(file.read_text().replace("near: float = 0.8", "near: float = 0.5"))
    assert find_task("my_task.py:Meet").near == 0.5


def test_a_task_of_an_installed_module_is_named_by_that(own, monkeypatch):
    monkeypatch.syspath_prepend(str(own))
    importlib.invalidate_caches()
    assert type(find_task("my_task:Meet")).__module__ == "my_task"
    assert full_name("my_task:Meet") == "my_task:Meet"
    with pytest.raises(UsageError, match=r"cannot import nowhere: ModuleNotFoundError"):
        find_task("nowhere:Meet")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("none.py:Meet", "", r"task none.py:Meet: there is no file /.*none\.py"),
        ("my_task.py:Nope", None, r"my_task.py has no 'Nope'; its tasks: Meet"),
        ("my_task.py", None, r"name its class, as my_task.py:Meet"),
        ("half.py:helper", HALF, r"of type function, expected a class that extends usarmjx.*Task"),
        ("half.py:NUMBER", HALF, r"of type int, expected a class"),
        ("half.py:Half", HALF, r"cannot be made without arguments: .*abstract"),
        ("bad.py:X", "one = 1\ntwo = one / 0\n", r"bad\.py, line 2: ZeroDivisionError: division by zero"),
        ("bad.py:X", "one = 1\n\ndef two(:\n", r"bad\.py, line 3: SyntaxError"),
        ("bad.py:X", "import nothing_of_that_name\n", r"bad\.py, line 1: ModuleNotFoundError: No module"),
        (
            "bad.py:X",
            "import usarmjx\nusarmjx.ROBOTS.get('No')\n",
            r"line 2: UnknownNameError: unknown robot",
        ),
        ("bad.py:X", "import sys\nsys.exit('enough')\n", r"line 2: SystemExit: enough"),
    ],
)
def test_what_is_wrong_with_an_own_task_is_one_line(own, name, text, message):
    (own / "beside.py").write_text("")
    if text:
        (own / name.partition(":")[0]).write_text(text)
    with pytest.raises(UsageError, match=message):
        find_task(name)
    done = invoke("train", name, "--out", "run", "--engine", "c")
    assert done.exit_code == 2
    assert done.stderr.count("\n") == 1
    assert not (own / "run").exists()


def test_a_run_finds_its_task_again_or_says_what_is_missing(own):
    kept = full_name("my_task.py:Meet")
    policy_file(own / "run.npz", task=kept, overrides={"near": "0.6"})
    source = load_policy("run.npz")
    assert source.task == kept
    for find in (source.env, lambda: source.count_arenas((), None)):
        with pytest.raises(UsageError, match=r"whose code it does not run by itself; .*--task '.*py:Meet'$"):
            find()
    env = SimpleNamespace(name=kept, groups=usarmjx.make(kept, engine="c").groups)
    assert source.count_arenas((), None) == 0, "the task is imported, as the user has named it"
    with pytest.raises(UsageError, match=r"is for robots .*P2AT.*P2DX"):
        source.policy(env)  # found, and compared
    (own / "my_task.py").rename(own / "moved.py")
    for command in ("eval", "play"):
        done = invoke(command, own / "run.npz")
        assert done.exit_code == 2
        assert done.stderr.splitlines()[-1] == (
            f"usarmjx: {own}/run.npz is for the task Meet of {own}/my_task.py, which does not exist; if it "
            "has moved, add --task FILE.py:Meet"
        )
    from usarmjx.cli.task_options import PolicyOptions

    moved = PolicyOptions(policy="run.npz", task="moved.py:Meet").source()
    assert (moved.task, moved.overrides) == ("moved.py:Meet", {"near": "0.6"}), "as it was trained"
    other = PolicyOptions(policy="run.npz", task="wander").source()
    assert (other.task, other.overrides) == ("wander", {})


@pytest.mark.parametrize("command", ["eval", "play"])
@pytest.mark.parametrize("task", ["helpers.py:Task", "helpers:Task"])
def test_a_policy_runs_no_code_that_only_it_names(own, monkeypatch, command, task):
    """Neither of a file nor of a module that Python would find in the folder."""
    monkeypatch.syspath_prepend(str(own))
    monkeypatch.delitem(sys.modules, "helpers", raising=False)
    (own / "helpers.py").write_text("open('RAN', 'w').close()\n")
    policy_file(own / "evil.npz", task=task)
    for more in ((), ("--set", "repeat=2"), ("--print-config",)):
        done = invoke(command, "evil.npz", *more)
        assert done.exit_code == 2
        assert done.stderr.splitlines()[-1] == (
            f"usarmjx: evil.npz names the task '{task}', whose code it does not run by itself; if you trust "
            f"that code, name it: --task '{task}'"
        )
        assert not (own / "RAN").exists()
    done = invoke(command, "evil.npz", "--task", task)
    assert (own / "RAN").exists(), "it was named"


@pytest.mark.parametrize("command", ["eval", "play"])
@pytest.mark.parametrize("task", ["helpers.py:Task", "helpers:Task"])
def test_nor_does_a_run_whose_settings_name_it(own, monkeypatch, command, task):
    monkeypatch.syspath_prepend(str(own))
    monkeypatch.delitem(sys.modules, "helpers", raising=False)
    (own / "helpers.py").write_text("open('RAN', 'w').close()\n")
    group = AgentGroup("P2AT", ("P2AT0",), 4, 2)
    about = {"groups": (group,), "privileged_size": 0, "episode_steps": 100, "period": 0.2}
    RunRecord(task=task, **about, processes=1, config=Config()).save(own / "run")
    # The weights do not matter here.
    monkeypatch.setattr(checkpoint, "read_policy", lambda path, which: (None, None, load_record(path)))
    monkeypatch.setattr(checkpoint.Checkpoints, "describe", lambda self, which: "")
    done = invoke(command, "run")
    assert done.exit_code == 2
    assert f"run names the task '{task}', whose code it does not run by itself" in done.stderr
    assert not (own / "RAN").exists()
    invoke(command, "run", "--task", task)
    assert (own / "RAN").exists(), "it was named"


def test_an_own_task_brings_its_baseline(own):
    source = baseline("my_task.py:Meet")
    assert (source.name, source.task) == (full_name("my_task.py:Meet"),) * 2
    assert source.name in BASELINES
    elsewhere = own / "plain.py"
    elsewhere.write_text(EXAMPLE.read_text().partition("    @staticmethod")[0])
    with pytest.raises(UsageError, match=r"plain.py:Meet has no baseline: .* baseline\(env\)"):
        baseline("plain.py:Meet")
    (own / "older.py").write_text(EXAMPLE.read_text().replace("def baseline(env)", "def by_hand(env)"))
    with pytest.warns(DeprecationWarning, match="older.py:Meet: `by_hand` is called `baseline`"):
        assert baseline("older.py:Meet").name in BASELINES
    done = invoke("play", "--task", "my_task.py:Meet")
    assert "no policy is packaged for my_task.py:Meet: name a run's folder" in done.stderr


def test_a_sweep_plays_own_tasks_and_tells_their_versions_apart(own):
    settings = complete({"task": "my_task.py:Meet", "fields.near": 1.0, "roster": ["P2AT"]}, "cell")
    found = resolve(settings)
    assert (found.task.near, found.task.robot) == (1.0, "P2AT")
    assert find_driver("baseline", "my_task.py:Meet").make is not None
    before = key_of(settings)
    file = own / "my_task.py"
    file.write_text(file.read_text().replace("2.0 * met", "3.0 * met"))
    assert key_of(settings) != before, "what an earlier version came to does not count"


@pytest.mark.slow
def test_an_own_task_is_trained_resumed_tried_and_drawn(own, monkeypatch):
    small = [
        "--worlds",
        4,
        "--engine",
        "c",
        "--quiet",
        "--set",
        "rollout_length=4",
        "--set",
        "num_minibatches=1",
    ]
    train = ["train", "my_task.py:Meet", "--out", "run", *small, "--set", "imitation_steps=32"]
    assert invoke(*train, "--steps", 32).exit_code == 0
    assert json.loads((own / "run" / "config.json").read_text())["task"] == f"{own}/my_task.py:Meet"
    monkeypatch.chdir("/")
    train[1], train[3] = own / "my_task.py:Meet", own / "run"
    assert invoke(*train, "--steps", 64, "--resume").exit_code == 0, "from another folder, too"
    done = invoke("eval", own / "run", "--episodes", 2, "--worlds", 2, "--engine", "c")
    assert f"{own}/my_task.py:Meet, {own}/run: score" in done.output
    assert invoke("play", own / "run", "--out", own / "one.png", "--seconds", 1).exit_code == 0
    assert (own / "one.png").stat().st_size > 1000
