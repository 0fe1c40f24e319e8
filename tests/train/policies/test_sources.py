"""Policies from runs, files, the package and by hand; evaluations as JSON; the command that makes them."""

import json
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from typer.testing import CliRunner

import usarmjx
from tests.train.handmade import policy_file
from tests.train.toys import LineToy
from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.estimates import estimate_groups
from usarmjx.cli.app import app
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.env import AgentGroup
from usarmjx.train.envs.task import TASKS, Policy
from usarmjx.train.evaluation.evaluate import as_record, evaluate_episodes
from usarmjx.train.learning.checkpoint import read_policy
from usarmjx.train.make import make_task
from usarmjx.train.policies import FOLDER, POLICIES, policies_in, sources
from usarmjx.train.policies.policy_file import NumpyPolicy
from usarmjx.train.policies.sources import PolicySource, baseline, load_policy, task_settings
from usarmjx.train.tasks.team import PERFECT_RADIO

GOAL_GROUP = AgentGroup("P2AT", ("P2AT0",), 4, 2)


def env_with(*groups):
    """What a policy is compared with."""
    return SimpleNamespace(name="drive-to-goal", groups=groups)


def test_a_policy_from_a_file_acts_as_numpy_says(tmp_path):
    file = policy_file(tmp_path / "goal.npz")
    policy, told = load_policy(str(file)).policy(env_with(GOAL_GROUP)), NumpyPolicy(file)
    obs = np.random.default_rng(0).uniform(-1, 1, (5, 1, 4)).astype(np.float32)
    _, (actions,) = policy.act(policy.initial_carry(5), (obs,), jax.random.key(0))
    expected, _ = told.act(0, obs, told.initial_carry(0, 5, 1))
    np.testing.assert_allclose(actions, expected, atol=1e-5)  # single precision, three sums of a few terms
    by_hand = np.tanh(1.5 * obs[..., 0] - 2.5 * obs[..., 1])
    np.testing.assert_allclose(actions[..., 0], by_hand, atol=1e-5)


def test_the_policy_of_a_run_acts_as_its_checkpoint(reference):
    found = load_policy(str(reference), "last")
    policy, params, record = read_policy(reference, "last")
    assert found.task == record.task
    assert found.checkpoint.startswith(f"checkpoint 10 of {reference}, the last: ")
    driver, obs = (
        found.policy(env_with(*record.groups)),
        tuple(np.full((3, len(group.agents), group.obs_size), 0.3, np.float32) for group in record.groups),
    )
    _, actions = driver.act(driver.initial_carry(3), obs, jax.random.key(0))
    expected, _ = policy.act(params, obs, policy.initial_carry(3), deterministic=True)
    for one, other in zip(actions, expected, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("command", ["eval", "play"])
def test_who_tries_a_run_is_told_which_checkpoint_that_is_and_why(command, reference, monkeypatch):
    def stop(source, *how, **more):
        raise UsageError("its worlds are not built here")

    monkeypatch.setattr(PolicySource, "env", stop)
    notes = [json.loads(file.read_text()) for file in (reference / "checkpoints").glob("*/meta.json")]
    best = max(notes, key=lambda note: note["score"])
    last = max(notes, key=lambda note: note["iteration"])
    reasons = {"best": (best, "the best by score in training"), "last": (last, "the last")}
    for which, (note, why) in {**reasons, str(last["iteration"]): (last, "as asked for")}.items():
        done = CliRunner().invoke(app, [command, str(reference), "--checkpoint", which])
        assert done.exit_code == 2
        assert done.stderr.splitlines()[-2].startswith(
            f"usarmjx: checkpoint {note['iteration']} of {reference}, {why}: {note['score']:.4g} after "
            f"{note['agent_steps']:,} agent steps"
        )


def test_a_policy_for_other_robots_is_refused(tmp_path):
    found = load_policy(str(policy_file(tmp_path / "goal.npz")))
    with pytest.raises(UsageError, match=r"P2AT.*4, 2.*has \[\('P2AT', 20, 2\)\]"):
        found.policy(env_with(AgentGroup("P2AT", ("P2AT0",), 20, 2)))


def test_packaged_policies_are_found_by_their_task(tmp_path, monkeypatch):
    policy_file(tmp_path / "drive-to-goal.npz")
    monkeypatch.setattr(sources, "POLICIES", policies_in(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert load_policy("Drive-To-Goal").task == "drive-to-goal"
    with pytest.raises(UnknownNameError, match=r"chess is no folder .* one; packaged: drive-to-goal"):
        load_policy("chess")


COARSE = ["trained with physics=coarse; here it is the reference's"]
TOLD = dict.fromkeys(
    ("explore-v2", "explore-v3", "relay-chain-v1", "relay-chain-v3", "soccer-v2", "victim-search-v3"), COARSE
)
"""What users of a packaged policy are told: under which other physics it was trained."""


def test_every_packaged_policy_is_for_the_task_that_it_is_named_after():
    assert len(POLICIES) == len(list(FOLDER.glob("*.npz")))
    for name, file in POLICIES:
        assert name in TASKS
        assert NumpyPolicy(file).task == name
        assert file.stat().st_size < 1_000_000


LIGHTEST = "drive-to-goal"


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name == LIGHTEST else pytest.mark.thorough) for name in POLICIES.names()],
)
def test_the_task_of_a_packaged_policy_is_still_the_one_that_it_was_trained_for(name):
    env, _, notes = load_policy(name).env(engine="c")  # refused if the task is another one now
    # In its own arenas, and a warning says that it was trained in them.
    seen = [note for note in notes if "scores of policies count on split test" in note]
    assert (env.name, [note for note in notes if note not in seen]) == (name, TOLD.get(name, []))
    assert len(seen) == bool(env.levels)


def test_the_packaged_policy_of_goals_drives_forwards():
    """Camera and laser look ahead. A policy that backs up to its goals reaches as many."""
    env = usarmjx.make("drive-to-goal", worlds=12, engine="c", episode_steps=60)
    policy = load_policy("drive-to-goal").policy(env)
    act, carry, state = jax.jit(policy.act), policy.initial_carry(12), env.reset(7)
    speeds, going = [], np.ones(12, bool)
    for step in range(60):
        carry, (wheels,) = act(carry, state.obs, jax.random.key(step))
        speeds.append(np.where(going, np.asarray(wheels)[:, 0].mean(-1), 0.0))
        state = env.step(state, (wheels,))
        going &= ~np.asarray(state.done)
    assert (np.sum(speeds, 0) > 1.0).all()
    assert going.sum() <= 3


def test_an_oracle_plays_the_task_in_which_it_knows_all(monkeypatch):
    def made(name, **fields):
        del fields["worlds"], fields["engine"], fields["seed"]
        return SimpleNamespace(
            name=name, task=make_task(name, **fields), scene=SimpleNamespace(arenas=None, arena="")
        )

    monkeypatch.setattr(sources, "make", made)
    monkeypatch.setattr(sources, "building_label", lambda arena: "")
    limits = ["byte_rate=64", "talk=none"]
    env, _, notes = baseline("oracle", "explore-v3").env(["count=2", *limits])
    assert (env.task.oracle, env.task.radio, env.task.count, notes) == (True, PERFECT_RADIO, 2, [])
    assert (env.task.byte_rate, env.task.talk) == (None, "all")
    env, _, _ = baseline("courier", "explore-v3").env()
    assert not env.task.oracle
    with pytest.raises(UsageError, match="only tasks whose robots choose goals have an oracle"):
        baseline("oracle", "wander").env()
    with pytest.raises(UsageError, match="which robots of explore-v3 do only with oracle=true"):
        BASELINES.get("oracle")(env)


def test_settings_of_the_training_come_back_and_those_that_cannot_are_told():
    trained = {"radius": "0.8", "ranges": "Sonar,IR", "vary": "Variation(mass=(0.9, 1.1))"}
    found, notes = task_settings("drive-to-goal", trained, ["radius=0.4"])
    assert found == {"radius": 0.4, "ranges": ("Sonar", "IR")}
    (note,) = notes
    assert "vary=Variation(mass=(0.9, 1.1)), which is not read back" in note
    with pytest.raises(UnknownNameError, match="DriveToGoal has no setting 'wheels'"):
        task_settings("drive-to-goal", {}, ["wheels=3"])
    with pytest.raises(UnknownNameError, match=r"known: .*drive-to-goal"):
        baseline("chess")


def still(share):
    return Policy(
        initial_carry=lambda worlds: np.zeros(worlds),
        act=lambda memory, obs, key: (memory, (jax.numpy.full((*obs[0].shape[:2], 2), share),)),
    )


def test_each_episode_has_a_row_with_its_world_and_turn():
    """A toy robot that stands still scores the sum of its x over the six steps of an episode.

    World k begins at (k + 1) / 8, a sixteenth farther in the next episode; a seed counts as that many worlds.
    """
    env = LineToy(worlds=2, robots=1, mixed=False)
    record = as_record(evaluate_episodes(env, still(0.0), 4, seeds=(0, 3)))
    rows = {(row["seed"], row["world"], row["episode"]): row for row in record["episodes"]}
    assert sorted(rows) == [(seed, world, turn) for seed in (0, 3) for world in (0, 1) for turn in (0, 1)]
    for (seed, world, turn), row in rows.items():
        assert row["steps"] == 6
        assert row["score"] == pytest.approx(6 * ((seed + world + 1) / 8 + turn / 16), rel=1e-5)
    means = [one["mean"] for one in record["seeds"]]
    assert record["score"]["mean"] == pytest.approx(np.mean(means))
    assert json.loads(json.dumps(record)) == record


def test_an_interval_of_which_nothing_is_known_is_null():
    env = LineToy(worlds=1, robots=1, mixed=False)
    record = as_record(evaluate_episodes(env, still(0.0), 1))
    assert record["score"]["low"] is None
    assert record["score"]["high"] is None


def test_eval_tells_the_mean_of_its_rows_and_writes_them(tmp_path):
    """A policy that heads for the goal in sight; 25 actions of 0.2 s take it at most 3.5 m."""
    file, out = policy_file(tmp_path / "goal.npz", {"ranges": ""}), tmp_path / "eval.json"
    command = ["eval", str(file), "--episodes", "6", "--worlds", "3", "--engine", "c", "--json", str(out)]
    done = CliRunner().invoke(app, [*command, "--set", "episode_steps=25", "--set", "pose=GroundTruth"])
    assert done.exit_code == 0, done.output
    record = json.loads(out.read_text())
    scores = [row["score"] for row in record["episodes"]]
    assert len(scores) == 6
    assert set(scores) <= {0.0, 1.0}
    found = estimate_groups(np.array(scores), shares=True)
    assert record["score"]["mean"] == pytest.approx(found.value)
    assert record["score"]["method"] == "Wilson"
    told = (
        f"score {found.value:.3f}, 95 % interval {found.low:.3f} to {found.high:.3f} by Wilson (6 episodes)"
    )
    assert told in done.output
    late = [row for row in record["episodes"] if row["score"] == 0.0]
    assert all(row["steps"] == 25 for row in late)
    assert record["settings"] == ["episode_steps=25", "pose=GroundTruth"]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ([], "name either"),
        (["x.npz", "--baseline", "wander"], "name either"),
        (["nothing-there"], "is no folder of a run"),
        (["--baseline", "chess"], "unknown baseline"),
    ],
)
def test_eval_of_nothing_is_refused(words, complaint):
    done = CliRunner().invoke(app, ["eval", *words])
    assert done.exit_code == 2
    assert complaint in done.output
