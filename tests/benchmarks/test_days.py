"""`benchmarks.days`: an old world and a fresh one in the same state, and what the comparison finds."""

import json

import jax
import numpy as np
import pytest

import dev
from benchmarks import days
from tests.benchmarks.records import validator
from usarmjx.engines import ENGINES
from usarmjx.models.compile.physics import Physics

PHYSICS = Physics(timestep=0.01, substeps=10)
CLOCKS = {".step", ".groups[0].battery_start", ".groups[0].memory.due"}


@pytest.fixture(scope="module")
def day():
    return days.Day("c", PHYSICS)


@pytest.fixture(scope="module")
def old(day):
    state, _ = day.run(day.batch.reset(0), 12, print)
    return state


def test_an_old_world_and_a_fresh_one_in_its_state_read_the_same(day, old):
    found = days.compare(day, old, day.batch.reset(0))
    assert found["differ"] == []
    assert (found["old_step"], found["fresh_step"]) == (12 * day.steps, days.YOUNG * day.steps)
    assert set(found["clocks"]) > CLOCKS
    assert all(count > 1 for count in found["measurements"].values()), "each sensor is due again and again"
    assert 0.2 < found["way_m"] < 2.0


def test_a_clock_that_is_forgotten_is_found(day, old, monkeypatch):
    for name in ("due", "battery_start"):
        monkeypatch.setattr(days, "CLOCKS", frozenset({"step", "battery_start", "due"} - {name}))
        assert days.compare(day, old, day.batch.reset(0))["differ"], name


def test_one_bit_is_a_difference():
    one, other = [(np.float32([0.0]), {"a": np.arange(3)})], [(np.float32([-0.0]), {"a": np.arange(3)})]
    assert days.differences(one, jax.tree.map(np.copy, one)) == []
    assert days.differences(one, other) == ["step 0: [0]"]


def test_the_records_have_whole_days_without_a_difference():
    lines = (dev.ROOT / "benchmarks" / "results" / "days.jsonl").read_text(encoding="utf-8").splitlines()
    records = [json.loads(line) for line in lines]
    assert {record["case"]["engine"] for record in records} == set(ENGINES.names())
    for record in records:
        validator().validate(record)
        assert record["differ"] == []
        assert record["case"]["hours"] == 24.0
