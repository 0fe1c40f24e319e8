"""A bare name of a task: the newest version for whoever types it, version 1 in files of earlier releases."""

import json

import gymnasium
import numpy as np
import pytest
from typer.testing import CliRunner

import usarmjx
from tests.train.handmade import policy_file
from usarmjx.base.errors import UnknownNameError
from usarmjx.base.registry import Registry
from usarmjx.cli.app import app
from usarmjx.cli.known_names import full_name as command_line_name
from usarmjx.cli.tables import LISTINGS
from usarmjx.plots.training_plots import curve_of_record
from usarmjx.sweeps.spec import SUITES, complete, read_spec
from usarmjx.sweeps.store import CellRecord, read_cell, read_sweep, write_cell, write_sweep
from usarmjx.sweeps.suite import RunResult, load_suite, read_result, run_digest
from usarmjx.train import make as making
from usarmjx.train.adapters import gymnasium as adapter
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.env import AgentGroup
from usarmjx.train.evaluation import radio_matters, yardsticks
from usarmjx.train.learning.config import (
    Config,
    RunRecord,
    load_record,
    task_config,
    training_engine,
    training_fields,
)
from usarmjx.train.policies import POLICIES
from usarmjx.train.policies.export import export_run
from usarmjx.train.policies.policy_file import NumpyPolicy
from usarmjx.train.policies.sources import baseline, load_policy
from usarmjx.train.task_names import RECORDED, full_name, recorded_name
from usarmjx.train.tasks import TASKS

BARE = sorted(RECORDED)
OF_TEAMS = [bare for bare in BARE if bare != "soccer"]
"""Those whose scores have parts, which `teams` and `radio_matters` take, and that have packaged policies."""


class BuiltError(Exception):
    """Stands for the worlds that a command builds; its text is the name that they get."""


@pytest.fixture
def builds(monkeypatch):
    """Names that environments get, none of which is built."""

    def build(task, worlds, *, name, **how):
        assert TASKS.get(name).__class__ is task.__class__
        raise BuiltError(name)

    for module in (making, yardsticks, radio_matters):
        monkeypatch.setattr(module, "build_env", build)


def newest(bare):
    """The highest version, counted here by itself."""
    return max(
        (n for n in TASKS.names() if n.startswith(f"{bare}-v")), key=lambda n: int(n.rpartition("v")[2])
    )


def test_versions_are_those_of_numbers_and_a_name_of_its_own_goes_before():
    digs = Registry("dig", versioned=True)
    for number, name in enumerate(["Dig-v9", "dig-v10", "dig-deep", "fill-v1", "fill"]):
        digs.add(name, number)
    assert (digs.full_name("DIG"), digs.get("dig"), digs.get("fill")) == ("dig-v10", 1, 4)
    assert digs.aliases() == ["dig"]
    assert "dig" in digs
    assert "dig-v2" not in digs
    assert digs.copy().get("dig") == 1
    digs.replace("dig", 7)
    assert digs.get("dig-v10") == 7
    plain = Registry("dig")
    plain.add("dig-v1", 0)
    with pytest.raises(UnknownNameError, match="unknown dig 'dig'; did you mean 'dig-v1'"):
        plain.full_name("dig")


@pytest.mark.parametrize("bare", BARE)
def test_a_bare_name_is_the_newest_version_in_python(bare, builds):
    name = newest(bare)
    assert TASKS.get(bare) is TASKS.get(bare.upper()) is TASKS.get(name)
    assert BASELINES.get(bare) is BASELINES.get(name)
    assert full_name(bare) == full_name(name) == name
    assert adapter.id_of(bare) == f"usarmjx/{name}"
    assert task_config(bare, gpu=True) == task_config(name, gpu=True)
    engine = training_engine(bare, "auto")
    assert training_fields(bare, engine) == training_fields(name, engine) == {"physics": "coarse"}
    assert (baseline(bare).name, baseline(bare).task) == (name, name)
    by_teams = (
        lambda: yardsticks.measure_teams(bare, 3, engine="c", teams=["baseline"]),
        lambda: radio_matters.main([bare, "--worlds", "3", "--engine", "c"]),
    )
    for build in (
        lambda: usarmjx.make(bare, engine="c"),
        lambda: gymnasium.make(f"usarmjx/{bare}", engine="c"),
        lambda: gymnasium.make_vec(f"usarmjx/{bare}", num_envs=2, engine="c"),
        lambda: baseline(bare).env(engine="c"),
        *(by_teams if bare in OF_TEAMS else ()),
    ):
        with pytest.raises(BuiltError, match=f"^{name}$"):
            build()


@pytest.mark.parametrize("bare", BARE)
def test_a_bare_name_is_the_newest_version_on_the_command_line(bare, builds, tmp_path, monkeypatch):
    name = newest(bare)
    monkeypatch.chdir(tmp_path)
    assert command_line_name("task", bare) == command_line_name("baseline", bare.upper()) == name
    for words in (
        f"train {bare} --engine c --quiet",
        *([f"teams {bare} baseline --engine c"] if bare in OF_TEAMS else []),
        f"eval --baseline {bare} --engine c --worlds 3 --episodes 3",
        f"play --baseline {bare}",
        f"play --agent random --task {bare}",
    ):
        done = CliRunner().invoke(app, words.split())
        assert isinstance(done.exception, BuiltError), (words, done.output)
        assert str(done.exception) == name, words
    helped = CliRunner().invoke(app, ["train", bare, "--help"])
    assert f"Settings of the task {name}" in helped.output
    assert bare not in [row[0] for row in LISTINGS["tasks"]().rows]
    assert name in [row[0] for row in LISTINGS["tasks"]().rows]


def test_a_bare_name_of_a_policy_is_that_of_the_newest_version_or_refused():
    assert load_policy("explore").name == load_policy("explore-v3").name
    assert load_policy("explore").task == "explore-v3"
    assert load_policy("victim-search").task == "victim-search-v3"
    assert yardsticks.packaged_name("explore") == "explore-v3"
    assert load_policy("relay-chain").task == "relay-chain-v3"


def test_a_bare_name_is_refused_if_only_an_older_version_is_packaged(monkeypatch):
    monkeypatch.delitem(POLICIES._entries, "relay-chain-v3")
    for word in ("eval", "play", "export"):
        done = CliRunner().invoke(app, [word, "relay-chain", "--out", "x.npz"][: 4 if word != "eval" else 2])
        assert done.exit_code == 2
        assert "relay-chain-v3 is no folder of a run" in done.stderr
        assert "did you mean 'relay-chain-v1'" in done.stderr


@pytest.mark.parametrize("bare", BARE)
def test_sweeps_and_suites_take_bare_names_for_the_newest_versions(bare, tmp_path):
    name = newest(bare)
    for given, kept in ((bare, name), ({"baseline": bare}, {"baseline": name}), ("baseline", "baseline")):
        cell = complete({"task": bare, "policy": given}, "cell")
        assert (cell["task"], cell["policy"]) == (name, kept)
    both = read_spec(
        {"product": {"task": [bare]}, "normalise": {"zero": {bare: 1.0}, "one": "baseline"}, "common": {}}
    )
    assert [one["task"] for one in both.cells] == [name]
    assert both.normalise == {"zero": {name: 1.0}, "one": "baseline"}
    if bare not in OF_TEAMS:
        return  # suites play splits of generated arenas
    file = tmp_path / "mine.yaml"
    digests = []
    for task in (bare, name, f"{bare}-v1"):
        file.write_text(f"list: [{{task: {task}}}]\nzero: {{{task}: 1.0}}\none: baseline\n")
        suite = load_suite(file)
        digests.append(suite.digest)
        (cell,) = suite.spec("validation", "mine", [f"baseline:{task}"], engine="c").cells
        assert cell["task"] == full_name(task)
        assert cell["policy"] == {"baseline": full_name(task)}
        assert suite.file.zero == {full_name(task): 1.0}
    assert digests[0] == digests[1], "both are the same suite"
    assert (digests[2] == digests[0]) is (name == f"{bare}-v1")


def test_the_bundled_suite_and_runs_of_its_planners_are_what_their_results_say():
    """Digests of the release that had `relay-chain` for `relay-chain-v1`."""
    assert load_suite(SUITES / "teams-v1.yaml").digest == "5b6ac3a94d34"
    assert run_digest("baseline:explore-v1", "explore-v1") == "b67b4bcb951bc7cc"
    assert run_digest("baseline:{task}", "relay-chain-v1") == "a9aebd5cefe9dd06"


# Files of earlier releases


@pytest.mark.parametrize("bare", OF_TEAMS)
def test_a_policy_with_a_bare_name_is_of_version_1_and_a_new_file_says_so(bare, tmp_path):
    old = policy_file(tmp_path / "old.npz", task=bare)
    assert NumpyPolicy(old).task == load_policy(str(old)).task == f"{bare}-v1"
    with np.load(POLICIES.get(f"{bare}-v1")) as kept:
        assert json.loads(str(kept["about"]))["task"] == bare, "an earlier release wrote it"
    export_run(f"{bare}-v1", tmp_path / "new.npz")
    with np.load(tmp_path / "new.npz") as written:
        assert json.loads(str(written["about"]))["task"] == f"{bare}-v1"
    export_run(f"{bare}-v1", tmp_path / "new.policy")
    assert json.loads((tmp_path / "new.policy" / "config.json").read_text())["task"] == f"{bare}-v1"
    assert NumpyPolicy(policy_file(tmp_path / "later.npz", task=f"{bare}-v2")).task == f"{bare}-v2"


@pytest.mark.parametrize("bare", BARE)
def test_a_run_with_a_bare_name_is_of_version_1(bare, tmp_path):
    record = RunRecord(
        task=bare,
        groups=(AgentGroup("P2AT", ("P2AT0",), 4, 2),),
        privileged_size=0,
        episode_steps=3,
        period=0.2,
        processes=1,
        config=Config(),
        began_with={"run": "runs/a", "task": bare},
    )
    record.save(tmp_path)
    found = load_record(tmp_path)
    assert found.task == found.began_with["task"] == f"{bare}-v1"
    found.save(tmp_path)
    assert json.loads((tmp_path / "config.json").read_text())["task"] == f"{bare}-v1"


@pytest.mark.parametrize("bare", BARE)
def test_results_of_sweeps_and_suites_with_bare_names_are_of_version_1(bare, tmp_path):
    settings = {"task": bare, "policy": {"baseline": bare}}
    cell = CellRecord(key="1f", settings=settings, scores=(0.5,), steps=(3,), bad=(False,))
    write_sweep(tmp_path, "mine", "", (), ("1f",), normalise={"zero": {bare: 1.0}, "one": "baseline"})
    write_cell(tmp_path, cell)
    full = {"task": f"{bare}-v1", "policy": {"baseline": f"{bare}-v1"}}
    assert read_cell(tmp_path, "1f").settings == full
    sweep = read_sweep(tmp_path)
    assert [one.settings for one in sweep.records] == [full]
    assert sweep.normalise == {"zero": {f"{bare}-v1": 1.0}, "one": "baseline"}
    old = RunResult(
        suite="s",
        suite_digest="0",
        split="test",
        method="m",
        run=f"baseline:{bare}",
        policies={bare: "0"},
        cells=(cell,),
    )
    old.write(tmp_path / "old.result.json")
    found = read_result(tmp_path / "old.result.json")
    assert (found.run, dict(found.policies)) == (f"baseline:{bare}-v1", {f"{bare}-v1": "0"})
    assert [one.settings for one in found.cells] == [full]


def test_curves_of_earlier_records_are_of_version_1():
    record = {"task": "relay-chain", "seed": 0, "worlds": 2, "device": "GPU", "curve": [[1, 2.0]]}
    curve = curve_of_record(
        {**record, "agent_steps_per_s": 1.0, "engine": "planar", "settings": {"task": {}}}
    )
    assert curve.task == "relay-chain-v1"


def test_names_of_files_that_stay():
    for name in (*TASKS.names(), "my_task.py:Meet", "chess"):
        assert recorded_name(name) == name
    assert recorded_name("Explore") == "explore-v1"
