"""Several seeds in one program: each learns what it learns alone, and none knows of another."""

import dataclasses
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import jax
import jax.extend.core
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.train.runs import CONFIG, array_checksums, lines
from tests.train.toys import DriveToy, MemoryToy, small_config
from usarmjx.base.errors import UsageError
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.task import Policy
from usarmjx.train.learning.checkpoint import Checkpoints, load_train_state, read_policy
from usarmjx.train.learning.config import load_record, load_seeds
from usarmjx.train.learning.learner import Trainer
from usarmjx.train.learning.processes import ProcessGroup
from usarmjx.train.learning.seed_runs import SeedTrainer, of_seed, split_worlds, train_seeds
from usarmjx.train.learning.trainer import StopRequest, train
from usarmjx.train.policies.export import export_run
from usarmjx.train.policies.policy_file import NumpyPolicy

# XLA sums in another order where it multiplies matrices of several seeds at once. Single precision differs by
# some 1e-7 in an update; over the 160 updates of the run that grew to 1.5e-7 of weights and 1e-6 of losses.
ROUNDING = 1e-5
EXACT = ("iteration", "agent_steps", "episodes", "score", "length", "timeouts", "bad", "end/success")
"""Counts of the first rollout, in which nothing is learned yet."""


def rotten(worlds, first):
    return DriveToy(worlds, first, rotten=True, shared=True)


def run(folder, seeds, config=CONFIG, env=rotten, **more):
    return train_seeds(env, config, folder, seeds, progress=False, **more)


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Folder of the uninterrupted runs of the seeds 3 and 7."""
    folder = tmp_path_factory.mktemp("pair") / "runs"
    run(folder, (3, 7))
    return folder


def learners(folder):
    """Checksums of the last checkpoint of a seed's run: its train state."""
    path = Checkpoints(folder).find("last")
    assert [one.name for one in sorted(path.iterdir())] == ["learner_0.npz", "meta.json"]
    return path.name, array_checksums(path / "learner_0.npz")


def worlds(folder):
    path = Checkpoints(folder).find("last")
    assert [one.name for one in sorted(path.iterdir())] == ["meta.json", "worlds_0.npz"]
    return path.name, array_checksums(path / "worlds_0.npz")


def check_same(folder, other, seeds=(3, 7)):
    """The same to the last bit: all lines, all that was learned, all worlds."""
    for seed in seeds:
        one, two = folder / f"seed-{seed}", other / f"seed-{seed}"
        assert lines(one) == lines(two)
        assert learners(one) == learners(two)
    assert worlds(folder) == worlds(other)


def plain(leaf):
    return jax.random.key_data(leaf) if jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key) else leaf


def assert_equal(one, other):
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert_array_equal(plain(a), plain(b))


def assert_close(one, other):
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert_allclose(plain(a), plain(b), rtol=ROUNDING, atol=ROUNDING)


def test_networks_and_worlds_begin_as_those_of_a_run_alone():
    """Bit for bit: weights, statistics, and the worlds with their random keys."""
    seeds = (3, 2**40 + 7)
    many = SeedTrainer(rotten(64, 0), CONFIG, ProcessGroup(), seeds)
    train_state, rollout_state = many.start()
    for k, seed in enumerate(seeds):
        alone = Trainer(rotten(32, 0), replace(CONFIG, seed=seed), ProcessGroup()).start()
        assert_equal(of_seed(train_state, k), alone[0])
        assert_equal(of_seed(split_worlds(rollout_state, 2), k), alone[1])


def check_learned_alone(seeds_folder, seed, folder):
    """A seed learned what it learned alone, but for rounding."""
    train(rotten, replace(CONFIG, seed=seed), folder, progress=False)
    first, alone_first = lines(seeds_folder)[0], lines(folder)[0]
    assert [first[name] for name in EXACT] == [alone_first[name] for name in EXACT]
    for one, alone in zip(lines(seeds_folder), lines(folder), strict=True):
        assert one.keys() == alone.keys()
        for name in one:
            assert_allclose(one[name], alone[name], rtol=ROUNDING, atol=ROUNDING, err_msg=name)
    (_, one, _), (_, alone, _) = load_train_state(seeds_folder, "last"), load_train_state(folder, "last")
    assert_close(one, alone)


def test_a_seed_learns_what_it_learns_alone(pair, tmp_path):
    check_learned_alone(pair / "seed-7", 7, tmp_path / "alone")


@pytest.mark.thorough
def test_a_single_seed_learns_what_a_run_learns(tmp_path):
    run(tmp_path / "runs", (3,))
    check_learned_alone(tmp_path / "runs" / "seed-3", 3, tmp_path / "alone")


def test_a_seed_knows_nothing_of_the_others(pair, tmp_path):
    """With another one beside it, and in another place, it learns the same, bit for bit."""
    run(tmp_path / "runs", (9, 3))
    folder, other = tmp_path / "runs" / "seed-3", pair / "seed-3"
    assert lines(folder) == lines(other)
    assert learners(folder) == learners(other)
    assert lines(folder) != lines(pair / "seed-7")


@pytest.mark.parametrize("traceable", [True, pytest.param(False, marks=pytest.mark.thorough)])
def test_memory_and_adaptive_rates_are_each_seeds_own(traceable):
    """Iteration by iteration from the same states, also in worlds that are stepped by the host."""
    config = small_config(num_worlds=8, rollout_length=7, num_minibatches=2, lr_schedule="adaptive")
    seeds = (1, 2)
    many = SeedTrainer(MemoryToy(16, traceable=traceable), config, ProcessGroup(), seeds)
    train_state, rollout_state = many.start()
    alone = [
        Trainer(MemoryToy(8, traceable=traceable), replace(config, seed=seed), ProcessGroup())
        for seed in seeds
    ]
    states = [one.start() for one in alone]
    for iteration in range(2):
        train_state, rollout_state, known = many.iterate(train_state, rollout_state, iteration)
        for k, one in enumerate(alone):
            learner, own, numbers = one.iterate(*states[k], iteration)
            states[k] = learner, own
            assert_close(of_seed(train_state, k), learner)
            assert_close(of_seed(split_worlds(rollout_state, 2), k), own)
            assert many.numbers(known)[k] == pytest.approx(
                one.numbers(numbers)[0], rel=ROUNDING, abs=ROUNDING
            )


def straight(env):
    """Go straight to the goal; remember the steps of the episode."""
    del env

    def act(steps, obs, key):
        del key
        return steps + 1, tuple(0.5 * one for one in obs)

    return Policy(initial_carry=lambda worlds: jax.numpy.zeros(worlds, jax.numpy.int32), act=act)


def conditions(jaxpr):
    """Number of conditions in a program, in its inner ones, too."""
    inner = jax.extend.core.jaxprs_in_params
    return sum(
        (one.primitive.name == "cond") + sum(conditions(part) for part in inner(one.params))
        for one in jaxpr.eqns
    )


def test_a_teacher_and_time_outs_are_computed_only_when_they_are_needed(monkeypatch):
    """Mapped over seeds, conditions stay conditions: a mapped one computes both of its branches."""
    monkeypatch.setattr(BASELINES, "_entries", dict(BASELINES._entries))
    BASELINES.add("drive-toy", straight)
    config = replace(CONFIG, num_worlds=8, imitation_steps=1)
    many = SeedTrainer(DriveToy(16), config, ProcessGroup(), (1, 2))
    alone = Trainer(DriveToy(8), config, ProcessGroup())
    counts = [
        conditions(jax.make_jaxpr(one.rollout._scan)(*one.start_shapes()).jaxpr) for one in (many, alone)
    ]
    assert counts == [2, 2]


class Stop(Exception):
    pass


def test_runs_that_broke_off_end_as_those_that_did_not(pair, tmp_path):
    folder = tmp_path / "runs"

    def stop(records):
        assert len(records) == 2
        if records[0]["iteration"] == 4:
            raise Stop

    with pytest.raises(Stop):
        run(folder, (3, 7), watch=stop)
    with (folder / "seed-7" / "metrics.jsonl").open("a") as file:
        file.write('{"iteration": 99, "sco')
    run(folder, (3, 7), resume=True)
    check_same(folder, pair)


@pytest.mark.parametrize("missing", ["", "seed-7"])
def test_a_kill_between_the_parts_of_a_checkpoint_loses_that_one_only(pair, tmp_path, missing):
    """The seeds' parts come first, then that of the worlds, and only then are old ones deleted."""
    folder = tmp_path / "runs"
    shutil.copytree(pair, folder)
    for place in {"", missing}:
        shutil.rmtree(folder / place / "checkpoints" / "00000010")
    run(folder, (3, 7), resume=True)
    check_same(folder, pair)


def test_a_signal_ends_all_with_a_checkpoint(pair, tmp_path):
    config, said = replace(CONFIG, checkpoint_interval=100), list[str]()

    def interrupt(records):
        if records[0]["iteration"] == 3:
            signal.raise_signal(signal.SIGTERM)

    with StopRequest(said.append) as stop:
        ended = run(tmp_path / "runs", (3, 7), config, watch=interrupt, stop=stop)
    assert len(said) == 1
    assert [one.stopped for one in ended] == [True, True]
    for result, seed in zip(ended, (3, 7), strict=True):
        folder = tmp_path / "runs" / f"seed-{seed}"
        assert result.run == folder
        assert 3 <= result.iterations <= 5
        assert [path.name for path in Checkpoints(folder).all()] == [f"{result.iterations:08}"]
        assert lines(folder) == lines(pair / f"seed-{seed}")[: result.iterations]


def test_each_seed_is_a_run_with_its_own_best_checkpoint(pair, tmp_path):
    assert load_seeds(pair) == (3, 7)
    for seed in (3, 7):
        folder = pair / f"seed-{seed}"
        assert load_record(folder).config == replace(CONFIG, seed=seed)
        there = [path.name for path in Checkpoints(folder).all()]
        assert there[-2:] == ["00000009", "00000010"]
        assert len(there) <= 3
        scores = {record["iteration"]: record["score"] for record in lines(folder)}
        best = int(Checkpoints(folder).find("best").name)
        assert scores[best] == max(scores.values())
        export_run(folder, tmp_path / f"{seed}.npz", "last")
        policy = NumpyPolicy(tmp_path / f"{seed}.npz")
        actions, _ = policy.act(0, np.array([0.3, -0.2]), policy.initial_carry(0))
        learned, params, _ = read_policy(folder, "last")
        obs = tuple(np.tile(np.float32([0.3, -0.2]), (1, n, 1)) for n in (2, 1))
        expected, _ = learned.act(params, obs, learned.initial_carry(1), deterministic=True)
        assert_allclose(actions, expected[0][0, 0], atol=ROUNDING)


def test_a_run_can_begin_with_the_networks_of_another(pair, tmp_path):
    from usarmjx.train.learning.fine_tuning import load_trained

    source = load_trained(pair / "seed-3", "last")

    def stop(records):
        raise Stop

    with pytest.raises(Stop):
        run(tmp_path / "runs", (1, 2), source=source, watch=stop)
    for seed in (1, 2):
        folder = tmp_path / "runs" / f"seed-{seed}"
        assert load_record(folder).began_with == source.origin
        _, begun, _ = load_train_state(folder, "0")
        assert_equal(begun.params, source.train_state.params)


def test_what_does_not_fit_is_refused(pair, tmp_path):
    new = tmp_path / "new"
    for seeds in ((), (1, 1)):
        with pytest.raises(UsageError, match=r"^seeds are .*, expected one or more, all different$"):
            run(new, seeds)
    with pytest.raises(UsageError, match=r"^seed -1, expected a whole number"):
        run(new, (-1,))
    with pytest.raises(UsageError, match=r"^curriculum is 0\.5: seeds that train together have none$"):
        run(new, (1, 2), replace(CONFIG, curriculum=0.5))
    needed = r"^the environment has 32 worlds; 32 worlds of each of 2 seeds need 64$"
    with pytest.raises(UsageError, match=needed):
        run(new, (1, 2), env=DriveToy(32))
    with pytest.raises(UsageError, match=r"^nothing to resume in .*new: it has no seeds\.json$"):
        run(new, (1, 2), resume=True)
    assert not new.exists()
    with pytest.raises(UsageError, match="has runs already; resume them"):
        run(pair, (3, 7))
    with pytest.raises(UsageError, match=r"have the seeds \[3, 7\], not \[3, 8\]$"):
        run(pair, (3, 8), resume=True)
    with pytest.raises(UsageError, match=r"gamma: 0\.9 -> 0\.8$"):
        run(pair, (3, 7), replace(CONFIG, gamma=0.8), resume=True)
    with pytest.raises(UsageError, match="seed-3 has a run already"):
        run(copied(pair / "seed-3", new / "seed-3").parent, (3, 4))


def copied(folder, to):
    shutil.copytree(folder, to)
    return Path(to)


def test_a_seed_alone_does_not_go_on_and_the_folder_of_all_is_no_run(pair, tmp_path):
    alone = copied(pair / "seed-3", tmp_path / "seed-3")
    config = dataclasses.replace(CONFIG, seed=3)
    with pytest.raises(
        UsageError, match="seed-3 is one of 2 seeds that train together: resume the folder above"
    ):
        train(rotten, config, alone, resume=True, progress=False)
    with pytest.raises(UsageError, match=r"has the runs of 2 seeds: name one, as .*seed-3$"):
        load_record(pair)


def test_a_seed_that_went_on_alone_is_not_overwritten(pair, tmp_path):
    """Killed before the first checkpoint, its run begins anew alone."""
    folder = copied(pair, tmp_path / "runs")
    for place in ("", "seed-3", "seed-7"):
        shutil.rmtree(folder / place / "checkpoints")
    train(rotten, replace(CONFIG, seed=3), folder / "seed-3", resume=True, progress=False)
    there = Checkpoints(folder / "seed-3").all()
    with pytest.raises(UsageError, match="seed-3 went on alone: resume it alone, or delete its checkpoints"):
        run(folder, (3, 7), resume=True)
    assert Checkpoints(folder / "seed-3").all() == there


def test_the_terminal_shows_all_seeds_together(tmp_path, capsys, monkeypatch):
    """The rate is the sum of the rates, and the score is the mean."""
    monkeypatch.setattr("usarmjx.train.learning.metrics.RateLimitedLog", lambda say: say)
    records = []

    def stop(now):
        records.extend(now)
        raise Stop

    with pytest.raises(Stop):
        train_seeds(rotten, CONFIG, tmp_path / "runs", (3, 7), watch=stop)
    shown = [line for line in capsys.readouterr().err.splitlines() if line.startswith("usarmjx: 1/10")]
    score = np.mean([one["score"] for one in records])
    rate = sum(one["steps_per_s"] for one in records)
    assert len(shown) == 1
    assert f"{rate:,.0f} steps/s" in shown[0]
    assert f"score {score:.3g}" in shown[0]
