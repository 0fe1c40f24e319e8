"""The benchmarks of compilation and of memory: their records, at toy size."""

import json
import os
from dataclasses import replace

import jax
import numpy as np
import pytest

from benchmarks import compiling
from benchmarks.cases import BaselineOptions, CompileCase, MemoryCase, SceneCase
from benchmarks.compiling import STAGES, measure_compile, measure_start
from benchmarks.memory import bytes_per_world, measure_memory, size_of
from benchmarks.scenes import batch_of, cells_for, scene_of
from tests.benchmarks.records import faults
from usarmjx.base.errors import UsageError
from usarmjx.models.compile.physics import PHYSICS

KEY = jax.dtypes.prng_key
SCENE = {"worlds": 2, "roster": "AirRobot", "arena": "soccer", "engine": "c", "substeps": 2}


@pytest.mark.thorough
def test_the_stages_to_the_first_step_are_told_cold_and_cached(tmp_path, monkeypatch):
    folders, found = [], []

    def here(case, cache):  # in this process, and once: another would only import the same once more
        folders.append((cache, os.path.isdir(cache)))
        found.append(measure_start(case.scene) if not found else {**found[0], "import_s": 9.0})
        return found[-1]

    monkeypatch.setattr(compiling, "_in_a_process", here)
    monkeypatch.setattr(jax.config, "update", lambda name, value: None)
    file = tmp_path / "compile.jsonl"
    text = measure_compile(CompileCase(**SCENE), BaselineOptions(json=file, baselines="none"))
    record = json.loads(file.read_text())
    assert faults(record) == []
    (cold, there), (cached, _) = folders
    assert cold == cached
    assert there
    for stages in record["stages"].values():
        assert [*stages] == [*STAGES]
        assert stages["trace_s"] is None, "engine c is not traced"
        assert stages["first_step_s"]["median"] > 0.0
    assert record["stages"]["cached"]["import_s"] == {"median": 9.0, "values": [9.0]}
    assert record["stages"]["cold"]["import_s"] == {
        "median": found[0]["import_s"],
        "values": [found[0]["import_s"]],
    }
    assert "first step" in text


def test_a_process_that_takes_too_long_is_told():
    with pytest.raises(UsageError, match=r"a process was not done after 0\.05 s"):
        compiling._in_a_process(CompileCase(**SCENE, limit=0.05), "")


@pytest.mark.slow
def test_processes_start_cold_and_with_a_cache(tmp_path):
    file = tmp_path / "compile.jsonl"
    case = CompileCase(**{**SCENE, "engine": "planar"})
    measure_compile(case, BaselineOptions(json=file, baselines="none"))
    cold, cached = (json.loads(file.read_text())["stages"][name] for name in ("cold", "cached"))
    assert cached["compile_s"]["median"] < cold["compile_s"]["median"]
    with pytest.raises(UsageError, match="Dalek"):
        compiling._in_a_process(CompileCase(**{**SCENE, "roster": "Dalek"}), "")


def test_generated_arenas_grow_with_the_team():
    """Teams of 1, 16, 64 and 128, each with a start pose of its own and as much room for a robot."""
    assert [cells_for(robots) for robots in (1, 16, 64, 128)] == [(8, 6), (8, 6), (16, 12), (23, 17)]
    many = {"worlds": 1, "roster": "P2AT:30", "arena": "maze", "generated": 2}
    scene = scene_of(SceneCase(**{**SCENE, **many}))
    assert scene.num_robots == 30
    assert scene.arenas.states.starts.shape[1] >= 30
    own = scene_of(SceneCase(worlds=1, roster="P2AT", arena="maze", generated=2, size="5x4", engine="c"))
    assert own.arena.extent == ((0.0, 6.0), (0.0, 4.8))


def test_another_solver_and_step_replace_those_of_the_physics():
    """A control step stays 50 ms."""
    other = {"solver": "Newton", "timestep": 0.005}
    case = SceneCase(roster="P2AT", arena="field", engine="c", physics="fast", **other)
    assert scene_of(case).physics == replace(PHYSICS.get("fast"), **other, substeps=10)
    assert case.replaced(PHYSICS.get("fast")).period == PHYSICS.get("fast").period


def test_the_memory_of_worlds_is_that_of_their_arrays(tmp_path):
    file = tmp_path / "memory.jsonl"
    fields = {name: value for name, value in SCENE.items() if name != "worlds"}
    case = MemoryCase(**fields, counts=[3, 1])
    text = measure_memory(case, BaselineOptions(json=file, baselines="none"))
    record = json.loads(file.read_text())
    assert faults(record) == []
    one, three = record["rows"]
    assert (one["worlds"], three["worlds"]) == (1, 3)
    assert sum(one["parts"].values()) == one["state_bytes"]
    batch = batch_of(case.scene_case(1), scene_of(case))
    state = batch.reset()
    arrays = [
        jax.random.key_data(x) if jax.dtypes.issubdtype(x.dtype, KEY) else x for x in jax.tree.leaves(state)
    ]
    assert one["state_bytes"] == sum(np.asarray(x).nbytes for x in arrays)
    assert record["bytes_per_world"] == pytest.approx((three["state_bytes"] - one["state_bytes"]) / 2)
    assert f"{record['bytes_per_world']:14,.0f} bytes" in text
    assert record["case"]["roster"] == SCENE["roster"]
    assert record["case"]["worlds"] == [1, 3]


def test_sizes_of_trees():
    assert size_of({"a": np.zeros((3, 2), np.float32), "b": (np.zeros(5, bool), None, 3)}) == 29
    rows = [{"worlds": 2, "state_bytes": 10}, {"worlds": 4, "state_bytes": 30}]
    assert bytes_per_world(rows) == 10
    assert bytes_per_world(rows[:1]) == 5
