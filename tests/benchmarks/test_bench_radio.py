"""The radio benchmark's record, and that its walls are counted in."""

import json

import jax
import numpy as np
import pytest

from benchmarks.cases import AllBaselineOptions, RadioCase
from benchmarks.radio import ARENA_SIDE, measure_radio, random_walls
from tests.benchmarks.records import faults
from tests.comms.solids import Geom, Solids, slab_count


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    """A tiny run: (record, summary)."""
    file = tmp_path_factory.mktemp("bench") / "new" / "radio.jsonl"
    summary = measure_radio(
        RadioCase(worlds=3, roster="P2AT:4", walls=10, steps=2, repeats=2), AllBaselineOptions(json=file)
    )
    (line,) = file.read_text().splitlines()
    return json.loads(line), summary


def test_the_record_says_what_was_measured_where(outcome):
    record, _ = outcome
    assert record["benchmark"] == "radio"
    assert record["device"]
    assert record["versions"]["jax"]
    assert record["case"] == {"worlds": 3, "robots": 4, "walls": 10, "steps": 2, "repeats": 2, "seed": 0}
    assert record["links_per_evaluation"] == 3 * 6


def test_the_rates_follow_from_the_times(outcome):
    record, _ = outcome
    for rate, times in (("links_per_s", "times_s"), ("links_per_s_shared_walls", "shared_walls_times_s")):
        assert len(record[times]) == 2
        assert record[rate] == pytest.approx(2 * 18 / np.median(record[times]))
    assert record["wall_tests_per_s"] == pytest.approx(10 * record["links_per_s"])
    # Compiled once, outside of the measured repeats, which are thousands of times shorter.
    assert max(record["times_s"]) < record["compile_s"]["own"]


def test_the_summary_has_the_figures(outcome):
    record, summary = outcome
    assert f"{record['links_per_s']:,.0f} links/s" in summary
    assert f"{record['links_per_s_shared_walls']:,.0f} links/s" in summary
    assert record["device"] in summary


def test_the_walls_stand_in_the_way():
    """A hundred of them are far more than the cap takes: five and more on a long link."""
    block = random_walls(jax.random.key(1), 100).blocks[0]
    pos, mat, size = (np.asarray(x, float) for x in (block.pos, block.mat, block.size))
    walls = Solids(np.full(100, int(Geom.mjGEOM_BOX)), pos, mat, size)
    assert (np.abs(pos[:, :2]) <= ARENA_SIDE / 2).all()
    np.testing.assert_allclose(pos[:, 2], size[:, 2])  # they stand on the floor
    np.testing.assert_allclose(mat @ mat.transpose(0, 2, 1), np.tile(np.eye(3), (100, 1, 1)), atol=1e-6)
    ends = np.random.default_rng(0).uniform((-10, -10, 0.3), (10, 10, 1), (2, 500, 3))
    counts = walls.count(*ends)
    np.testing.assert_array_equal(counts, slab_count(walls, *ends))
    assert counts.mean() > 3


def test_the_record_has_the_form_of_all(outcome):
    record, _ = outcome
    assert faults(record) == []
    on_cpu = record["baselines"]["mj_multiray"]
    assert on_cpu["rate"] == pytest.approx(3 * 6 / np.median(on_cpu["times_s"]))
