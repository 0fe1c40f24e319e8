"""The benchmark's record: what a reader needs to judge a figure is in it."""

import json

import numpy as np
import pytest

from usarmjx.bench.step import StepCase, measure_step


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    """A tiny run: (record, summary)."""
    file = tmp_path_factory.mktemp("bench") / "new" / "results.jsonl"
    case = StepCase(worlds=2, roster="P2AT", engine="c", steps=2, repeats=1, substeps=4)
    summary = measure_step(case, file)
    (line,) = file.read_text().splitlines()
    return json.loads(line), summary


def test_the_record_says_what_was_measured_where(outcome):
    record, _ = outcome
    assert record["benchmark"] == "step"
    assert record["device"]
    assert record["when"][:2] == "20"
    assert {"python", "jax", "jaxlib", "mujoco", "mujoco-mjx", "usarmjx"} <= set(record["versions"])
    assert record["versions"]["mujoco"] == "3.17.0"
    assert record["case"] == {
        "worlds": 2, "roster": "P2AT", "arena": "yellow", "generated": 0, "engine": "c", "radio": False,
        "physics": "reference", "substeps": 4, "steps": 2, "repeats": 1, "seed": 0,
    }  # fmt: skip
    for word in ("contacts", "sensors", "resets of 1%", "no radio"):
        assert word in record["in_the_step"]
    # A P2AT casts 181 beams, 9 lines for each of its 16 sonars, and one to each of the 16 nearest tags.
    assert record["rays_when_all_are_due"] == 2 * (181 + 9 * 16 + 16)


def test_the_rates_follow_from_the_times(outcome):
    record, _ = outcome
    work = 2 * 1 * 4 * 2  # worlds, robots, substeps, steps
    assert record["bare_robot_steps_per_s"] == pytest.approx(work / record["bare_times_s"][0])
    assert record["robot_steps_per_s"] == pytest.approx(work / record["whole_times_s"][0])
    assert record["whole_to_bare"] == pytest.approx(
        record["robot_steps_per_s"] / record["bare_robot_steps_per_s"]
    )
    assert record["cpu_mujoco_robot_steps_per_s"] > 0
    assert record["robots_in_real_time"] == pytest.approx(record["robot_steps_per_s"] * record["timestep"])
    assert not any(record["faults"].values())


def test_the_summary_has_the_figures(outcome):
    record, summary = outcome
    assert f"{record['robot_steps_per_s']:,.0f} robot-steps/s" in summary
    assert record["in_the_step"] in summary
    assert record["device"] in summary


def test_the_sensors_share_is_that_of_the_step_without_them(outcome):
    record, _ = outcome
    blind, whole = np.median(record["blind_times_s"]), np.median(record["whole_times_s"])
    assert record["sensors_share"] == pytest.approx(1 - blind / whole)
    assert "Sonar" in record["sensors"]["P2AT"]
