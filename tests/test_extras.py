"""What the base installation does without, and what is said where that is not enough."""

import json
import re
import subprocess
import sys
import tomllib

import numpy as np
import pytest

import dev
from usarmjx.base.errors import MissingExtraError, UsageError, extra
from usarmjx.base.installation import install_command
from usarmjx.train.envs.env import AgentGroup
from usarmjx.train.learning.distributions import mode_action
from usarmjx.train.learning.networks import LearnedPolicy
from usarmjx.train.policies import POLICIES
from usarmjx.train.policies.export import export_run
from usarmjx.train.policies.policy_file import NumpyPolicy

WITHOUT = """
import sys

class NotThere:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in %r:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NotThere())
"""
"""A program's beginning, after which some libraries are not installed."""
ALL = {"brax", "optax", "tensorboardX", "gymnasium", "pettingzoo", "jaxmarl", "gymnax", "warp"}
"""Modules that only extras bring."""
USE = """
import json, os
import jax.numpy as jnp
from typer.testing import CliRunner
from usarmjx.cli.app import app
from usarmjx.plots import play
from usarmjx.train.evaluation import evaluate
from usarmjx.train.policies.sources import load_policy

def command(*words):
    done = CliRunner().invoke(app, list(words))
    return done.exit_code, done.output

policy, params = load_policy("drive-to-goal").learned
acting = policy.as_policy(params)
_, (actions,) = acting.act(acting.initial_carry(2), (jnp.full((2, 1, 20), 0.5),), None)
told = {"actions": actions.tolist()}
with open("runs.jsonl", "w") as file:
    file.write("")
for name, words in {
    "export": ["export", "drive-to-goal", "--out", "goal.npz"],
    "curves": ["curves", "runs.jsonl"],
    "train": ["train", "--task", "drive-to-goal", "--out", "run", "--worlds", "2"],
    "export a run": ["export", "run", "--out", "run.npz"],
}.items():
    os.makedirs("run", exist_ok=True)
    told[name] = command(*words)
for module in ("gymnasium", "pettingzoo", "jaxmarl", "brax"):
    try:
        __import__(f"usarmjx.train.adapters.{module}")
    except ImportError as error:
        told[module] = str(error)
print(json.dumps(told))
"""


def test_training_names_the_extra_before_it_builds_anything():
    """Of its needs, optax is there all the same, as flax brings it."""
    code = WITHOUT % (ALL - {"optax"}) + "import usarmjx.train.learning.trainer"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stderr.endswith(f"this needs brax: {install_command('train')}\n")


def test_a_start_on_planar_imports_neither_brax_nor_mjx():
    """Brax imports MJX, and that Warp's kernels for MuJoCo: two seconds that only what is traced may take."""
    code = """
import sys
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.trainer import Trainer
from usarmjx.train.make import make
from usarmjx.train.learning.processes import ProcessGroup

sizes = {"hidden_sizes": (4,), "critic_hidden_sizes": (4,)}
config = Config(num_worlds=2, num_minibatches=1, shuffle_blocks=1, **sizes)
env = make("drive-to-goal", worlds=2, engine="planar", ranges=(), pose="GroundTruth")
Trainer(env, config, ProcessGroup()).start()
print([name for name in ("brax", "mujoco.mjx") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "[]\n", done.stderr


def test_the_base_installation_runs_packaged_policies_and_names_the_extra_for_the_rest(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT % ALL + USE], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    packaged = NumpyPolicy(POLICIES.get("drive-to-goal"))
    same, _ = packaged.act(0, np.full((2, 1, 20), 0.5), packaged.initial_carry(0, 2, 1))
    assert np.allclose(told["actions"], same, atol=1e-5)
    assert told["export"][0] == 0
    assert (tmp_path / "goal.npz").exists()
    status, said = told["curves"]
    assert (status, "pip" in said) == (2, False), said  # it looked into the file, and there is nothing
    for name in ("train", "export a run"):
        status, said = told[name]
        line = said.strip().splitlines()[-1]
        assert status == 2, said
        assert line.startswith("usarmjx: this needs "), said
        assert line.endswith(f'-e "{dev.ROOT}[train]"'), said  # its folder is another one
        assert "Traceback" not in said
    assert told["gymnasium"].endswith(f'-e "{dev.ROOT}[rl]"')
    assert told["gymnasium"].startswith("this needs gymnasium: pip install ")
    assert told["pettingzoo"].endswith(f'-e "{dev.ROOT}[rl]"')
    assert told["pettingzoo"].startswith("this needs gymnasium: pip install ")
    assert told["jaxmarl"].endswith(f'-e "{dev.ROOT}[rl]"')
    assert told["jaxmarl"].startswith("this needs jaxmarl: pip install ")
    assert told["brax"].endswith(f'-e "{dev.ROOT}[train]"')
    assert told["brax"].startswith("this needs brax: pip install ")


def test_what_is_missing_of_ours_is_not_blamed_on_an_extra():
    with pytest.raises(ModuleNotFoundError, match=r"usarmjx\.nothing"), extra("rl"):
        import usarmjx.nothing  # noqa: F401
    said = f"^{re.escape('this needs no_such: ' + install_command('rl'))}$"
    with pytest.raises(MissingExtraError, match=said), extra("rl"):
        import no_such.thing  # noqa: F401
    assert issubclass(MissingExtraError, UsageError)


def test_the_likeliest_action_is_the_mode_of_the_distribution_that_training_draws_from():
    logits = np.random.default_rng(1).normal(size=(5, 6)).astype(np.float32)
    kind = LearnedPolicy((AgentGroup("P2AT", ("R1",), 4, 3),), (8,)).distribution(0)
    assert np.array_equal(mode_action(logits), kind.mode(logits))


def test_the_extras_that_are_named_exist():
    declared = tomllib.loads((dev.ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = set()
    for file in (dev.ROOT / "usarmjx").rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        named |= {part.partition('"')[0] for part in text.split('with extra("')[1:]} - {"train: import optax"}
    assert {"train", "rl"} <= named <= declared.keys()


@pytest.mark.parametrize("half", [False, True])
def test_a_packaged_policy_is_exported_as_it_is(half, tmp_path):
    export_run("explore-v1", tmp_path / "explore.npz", half=half)
    mine, packaged = NumpyPolicy(tmp_path / "explore.npz"), NumpyPolicy(POLICIES.get("explore-v1"))
    assert (mine.task, mine.groups, mine.period) == (packaged.task, packaged.groups, packaged.period)
    first = [policy.weights[0]["layer_0"]["kernel"] for policy in (mine, packaged)]
    exact = first[1].astype(np.float16).astype(np.float32) if half else first[1]
    assert np.array_equal(first[0], exact)
    assert np.array_equal(mine.mean[0], packaged.mean[0])
