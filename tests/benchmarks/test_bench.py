"""The benchmark's record: what a reader needs to judge a figure is in it."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.cases import BaselineOptions, StepCase
from benchmarks.scenes import resolved
from benchmarks.step import TOP, measure_step
from tests.benchmarks.records import faults
from usarmjx.base.errors import UsageError


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    """A tiny run: (record, summary)."""
    file = tmp_path_factory.mktemp("bench") / "new" / "results.jsonl"
    case = StepCase(worlds=2, roster="P2AT", engine="c", steps=2, repeats=1, substeps=4, profile=True)
    summary = measure_step(case, BaselineOptions(json=file, note="toy size"))
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
        "worlds": 2, "roster": "P2AT", "arena": "yellow", "generated": 0, "size": None, "engine": "c",
        "radio": False, "physics": "reference", "substeps": 4, "steps": 2, "repeats": 1, "seed": 0,
        "graph": "step", "profile": True, "solver": None, "timestep": None,
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


def test_the_record_has_the_form_of_all(outcome):
    record, summary = outcome
    assert faults(record) == []
    assert record["note"] == "toy size"
    for name in ("bare", "whole", "blind"):
        rate = record["rates"][name]
        assert rate["least"] <= rate["rate"] <= rate["most"]
        assert rate["times_s"] == record[f"{name}_times_s"]
    on_cpu = record["baselines"]["mujoco_rollout"]
    assert on_cpu["worlds"] >= on_cpu["cores"] >= 1
    assert on_cpu["rate"] == pytest.approx(on_cpu["worlds"] * 4 * 2 / on_cpu["times_s"][0])
    assert record["baselines"]["bare_mjx"] == {"missing": "not asked for"}
    assert f"{on_cpu['rate']:,.0f} robot-steps/s" in summary


def test_a_record_has_the_kernels_that_were_asked_for(outcome):
    record, summary = outcome
    assert 0 < len(record["kernels"]["top"]) <= TOP
    assert f"{record['kernels']['calls']:,} kernels took" in summary
    assert record["kernels"]["top"][0]["name"][:90] in summary
    assert faults(record) == []
    wrong = {**record, "kernels": {**record["kernels"], "top": [{"name": "k", "calls": 0, "ms": 1.0}]}}
    assert any("kernels.top" in fault for fault in faults(wrong))


def test_the_record_says_what_the_solver_met(outcome):
    scene = outcome[0]["scene"]
    assert scene["robots"] == 1
    assert scene["geoms"] > scene["touching_geoms"] > 50  # the yellow arena, and what is only seen
    assert scene["contacts"]["mean"] >= 4  # its wheels stand on the floor
    assert scene["constraint_rows"]["mean"] >= 3 * scene["contacts"]["mean"]
    assert 1 <= scene["solver_iterations"]["mean"] <= scene["solver_iterations"]["most"] <= 10
    assert (scene["overflow"], scene["bad_worlds"]) == (0, 0)


def test_the_schema_refuses_what_lacks_something(outcome):
    record, _ = outcome
    for name in ("hardware", "rates", "scene", "baselines", "note", "robot_steps_per_s"):
        short = {key: value for key, value in record.items() if key != name}
        assert any(f"'{name}' is a required property" in fault for fault in faults(short)), name
    rates = {**record["rates"], "whole": {**record["rates"]["whole"], "rate": 0}}
    assert any("rates.whole.rate" in fault for fault in faults({**record, "rates": rates}))
    assert faults({**record, "baselines": {"mujoco_rollout": {}, "bare_mjx": {"missing": "why"}}})


def test_an_unknown_word_for_baselines_is_refused():
    with pytest.raises(UsageError, match="'some' is not one of all, cpu, none"):
        measure_step(StepCase(worlds=1, engine="c"), BaselineOptions(baselines="some"))


def test_a_record_names_the_solver_that_ran():
    """A scene that solver `block` does not cover falls back to another."""
    case = StepCase(engine="warp", roster="P2AT:1", worlds=1, solver="block")
    covered, kept = (SimpleNamespace(engine=SimpleNamespace(solver=name)) for name in ("block", "CG"))
    assert resolved(case)["solver"] == resolved(case, covered)["solver"] == "block"
    assert resolved(case, kept)["solver"] == "CG"
