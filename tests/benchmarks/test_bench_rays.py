"""The ray benchmark's record, and that what it measures are scans."""

import json

import numpy as np
import pytest

from benchmarks.cases import AllBaselineOptions, RayCase
from benchmarks.rays import measure_rays
from tests.benchmarks.records import faults
from usarmjx.base.errors import UsageError
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.robots import ROBOTS


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    """A tiny run: (record, summary)."""
    file = tmp_path_factory.mktemp("bench") / "rays.jsonl"
    case = RayCase(worlds=2, roster="P2DX:3", walls=12, steps=2, repeats=2)
    summary = measure_rays(case, AllBaselineOptions(json=file))
    (line,) = file.read_text().splitlines()
    return json.loads(line), summary


def test_the_record_says_what_was_measured(outcome):
    record, _ = outcome
    parts = len(kinematic_tree_of(ROBOTS.get("P2DX")).geom_type)
    assert record["benchmark"] == "rays"
    assert record["geoms_per_world"] == 12 + 1 + 3 * parts
    assert record["rays_per_scan"] == 2 * 3 * 181
    assert record["caster"] == "jax"


def test_the_rates_follow_from_the_times(outcome):
    record, _ = outcome
    for rate, times in (("rays_per_s", "times_s"), ("brute_force_rays_per_s", "brute_force_times_s")):
        assert record[rate] == pytest.approx(2 * record["rays_per_scan"] / np.median(record[times]))


def test_rays_meet_walls_and_as_brute_force_says(outcome):
    record, _ = outcome
    assert 0.1 < record["hits"] < 1
    assert record["different"] == 0


def test_the_summary_has_the_rates(outcome):
    record, summary = outcome
    assert f"{record['rays_per_s']:,.0f}" in summary
    assert f"{record['brute_force_rays_per_s']:,.0f}" in summary


def test_a_robot_without_a_scanner_is_refused():
    with pytest.raises(UsageError, match=r"AirRobot has no range scanner to measure with; it has: "):
        measure_rays(RayCase(worlds=1, roster="AirRobot:16"))


def test_the_record_has_the_form_of_all_and_mujoco_sees_the_same(outcome):
    record, _ = outcome
    assert faults(record) == []
    on_cpu = record["baselines"]["mj_multiray"]
    assert on_cpu["rate"] == pytest.approx(2 * 3 * 181 / np.median(on_cpu["times_s"]))
    assert on_cpu["different"] == 0
