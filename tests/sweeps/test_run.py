"""Sweeps from file to results: nothing is played twice or lost, and how it is played does not matter."""

import os
import signal
import subprocess
import sys
import time

import jax
import numpy as np
import pytest

import usarmjx
from tests.sweeps.conftest import SMALL, write
from usarmjx.sweeps import run as run_module
from usarmjx.sweeps.batch import GroupRunner
from usarmjx.sweeps.resolve import resolve
from usarmjx.sweeps.run import prepare, run_sweep
from usarmjx.sweeps.spec import load_spec
from usarmjx.sweeps.store import CELLS, read_sweep
from usarmjx.sweeps.workers import Workers

BROKEN = """
def raises(env):
    raise RuntimeError("no good today")


def none(env):
    return None
"""


def results(found):
    """What came of each cell, to the bit."""
    return {
        record.key: (record.failed, record.scores, record.steps, record.bad, record.metrics)
        for record in found.records
    }


def times(folder):
    # Not the dot files that are still being written: they vanish between the listing and the look at them.
    return {file.name: file.stat().st_mtime_ns for file in (folder / CELLS).glob("[!.]*.json")}


def test_cells_that_differ_in_data_are_played_with_one_compilation(whole):
    _, found, said = whole
    assert said == ["12 cells in 6 batches of 2, 1 compilation: the cells differ in data only"]
    assert [record.failed for record in found.records] == [None] * 12
    ways = [record.metrics["distance"] for record in found.records]
    assert len(set(ways)) >= 10, "seeds and weights matter, and the walls to who meets one"
    record = found.records[0]
    assert record.versions["mujoco"]
    assert (record.settings["seed"], record.engine) == (0, "c")


@pytest.mark.thorough
def test_a_cell_is_the_same_alone_as_in_a_batch(whole):
    _, found, _ = whole
    record = found.records[11]
    cell = resolve(record.settings)
    (alone,) = GroupRunner([cell], 1, "c").run([cell])
    assert alone.metrics["distance"].tolist() == list(record.metrics["distance"])
    assert alone.scores.tolist() == list(record.scores)
    assert alone.steps.tolist() == list(record.steps)


@pytest.mark.parametrize("place", ["processes", pytest.param("ray", marks=pytest.mark.tools)])
def test_other_processes_and_ray_play_the_same_to_the_bit(place, whole, rows, tmp_path):
    """Two batches of a cell each, on a worker."""
    file = write(tmp_path, list=rows[:1], worlds=2, product={"arena.level": [0.9], "seed": [0, 1]})
    said = []
    found = run_sweep(load_spec(file), tmp_path / "out", Workers(place=place, count=1), say=said.append)
    assert said == ["2 cells in 2 batches of 1, 1 compilation: the cells differ in data only"]
    here = results(whole[1])
    assert results(found) == {key: here[key] for key in found.keys}
    assert all(record.failed is None for record in found.records)
    first, second = (record.compile_seconds for record in found.records)
    assert first > 0.0 == second, "the second batch plays what the first one compiled"


@pytest.mark.parametrize(
    "place",
    [
        pytest.param("here", marks=pytest.mark.thorough),
        pytest.param("processes", marks=pytest.mark.tools),
        pytest.param("ray", marks=pytest.mark.tools),
    ],
)
def test_a_killed_sweep_goes_on_and_comes_to_the_same(place, whole, rows, tmp_path):
    file, folder = write(tmp_path, list=rows), tmp_path / "out"
    workers = Workers(place=place, count=1)
    command = [sys.executable, "-m", "usarmjx", "sweep", str(file), "--out", str(folder), "--quiet"]
    command += ["--run-on", place, "--workers", "1"]
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        while not times(folder) and running.poll() is None:
            time.sleep(0.005)
        os.kill(running.pid, signal.SIGKILL)
    finally:
        running.kill()
        assert running.wait() == -signal.SIGKILL, "it ended before it could be killed"
    before = times(folder)
    assert 1 <= len(before) < 12
    found = run_sweep(load_spec(file), folder, workers)
    assert results(found) == results(whole[1])
    after = times(folder)
    assert {name: after[name] for name in before} == before, "what was there is not played again"


def test_of_a_changed_file_only_what_changed_is_played_and_broken_cells_stop_nobody(whole, rows, tmp_path):
    folder = tmp_path / "out"
    (folder / CELLS).mkdir(parents=True)
    for kept in (whole[0] / CELLS).glob("[!.]*.json"):
        os.link(kept, folder / CELLS / kept.name)
    before = times(folder)
    (tmp_path / "broken.py").write_text(BROKEN)
    own = [f"{tmp_path}/broken.py:{name}" for name in ("raises", "none")]
    policies = [*own, "lost.npz", "packaged", rows[1]["policy"]]
    cells = [{"policy": policy, "seed": 7} for policy in policies]
    cells += [{"policy": rows[1]["policy"], "seed": seed} for seed in (1, 2)]
    product = {"arena.level": [0.9], "vary.friction": [1.0]}
    file, said = write(tmp_path, list=cells, product=product), []
    found = run_sweep(load_spec(file), folder, say=said.append)
    assert said[0] == "2 of 7 cells are there already"
    assert {name: at for name, at in times(folder).items() if name in before} == before
    reasons = [record.failed for record in found.records]
    assert "no good today" in reasons[0]
    assert "returned NoneType, expected usarmjx's Policy" in reasons[1]
    assert "lost.npz is no folder of a run" in reasons[2]
    assert "is for robots" in reasons[3]
    assert reasons[4:] == [None] * 3
    assert results(found)[found.keys[5]] == results(whole[1])[found.keys[5]]
    there = times(folder)
    run_sweep(load_spec(file), folder)
    assert times(folder) == there, "what has failed is not tried again"
    (tmp_path / "broken.py").write_text(BROKEN.replace("no good today", "no good either"))
    again = run_sweep(load_spec(write(tmp_path, list=cells[:1], product=product)), folder)
    assert "no good either" in again.records[0].failed, "another file is another policy"


@pytest.mark.parametrize("count", [1, 5, 13])
def test_each_cell_is_in_one_part_whatever_is_there(whole, tmp_path, rows, count, monkeypatch):
    monkeypatch.setattr(run_module, "forget_resolved", lambda: None)  # no file changes meanwhile
    spec = load_spec(write(tmp_path, list=rows))
    parts = [prepare(spec, tmp_path / "out", part=(number + 1, count)) for number in range(count)]
    keys = [key for one in parts for key, _ in one.cells]
    assert keys == list(parts[0].keys), "in their order, each once"
    sizes = [len(one.cells) for one in parts]
    assert max(sizes) - min(sizes) <= 1
    assert {one.keys for one in parts} == {parts[0].keys}, "all write the same sweep"
    there = prepare(spec, whole[0], part=(1, count))
    assert (len(there.cells), there.known) == (0, sizes[0])


def test_in_python_a_sweep_is_a_table(whole, rows, monkeypatch):
    small = {**SMALL, "list": rows}
    table = usarmjx.sweep(small, whole[0])
    assert len(table) == 12
    np.testing.assert_array_equal(table["good"], 2)
    assert set(table["arena.level"]) == {0.1, 0.9}
    monkeypatch.setitem(sys.modules, "pandas", None)
    plain = usarmjx.sweep(small, whole[0])
    assert plain[3]["metric.distance"] == table["metric.distance"][3]


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="about machines without a GPU")
def test_engine_auto_is_c_where_there_is_only_a_cpu(tmp_path):
    """As in training: engine jax steps a few worlds on a CPU many times slower."""
    common = {**SMALL["common"], "engine": "auto"}
    prepared = prepare(load_spec(write(tmp_path, common=common)), tmp_path / "out")
    assert {settings["engine"] for _, settings in prepared.cells} == {"c"}


def test_a_folder_without_a_sweep_is_named(tmp_path):
    with pytest.raises(usarmjx.UsageError, match=r"holds no sweep: it has no sweep.json"):
        read_sweep(tmp_path)
