"""The benchmark of the live page: its record, and that what it measures is there."""

import json

import pytest

from benchmarks import viewer
from benchmarks.cases import BaselineOptions, ViewerCase
from benchmarks.viewer import measure_viewer
from tests.benchmarks.records import faults
from usarmjx.base.errors import UsageError


def test_the_record_has_what_an_update_costs_and_sends(tmp_path):
    file = tmp_path / "viewer.jsonl"
    summary = measure_viewer(
        ViewerCase(rosters=["P2AT:1", "P2AT:2"], updates=6, served=0), BaselineOptions(json=file)
    )
    record = json.loads(file.read_text())
    assert record["benchmark"] == "viewer"
    assert record["served"] is None
    assert faults(record) == []
    assert record["rates"]["1 robots"]["repeats"] <= 6
    one, two = record["updates"]["1 robots"], record["updates"]["2 robots"]
    for row in (one, two):
        assert 0.0 < row["update_cpu_ms"] <= row["update_cpu_most_ms"]
        assert row["process_cpu_ms"] > 0.0
    assert two["bytes_per_s"] > one["bytes_per_s"] > 200.0  # poses of five bodies, twenty times a second
    assert f"{one['update_cpu_ms']:.2f} ms an update" in summary


def test_a_page_that_nobody_reaches_is_given_up(monkeypatch):
    monkeypatch.setattr(viewer.Browser, "_say_hello", lambda self: None)
    with pytest.raises(UsageError, match=r"no browser came to the page within 0\.2 s"):
        measure_viewer(ViewerCase(rosters=["P2AT"], updates=1, served=0, limit=0.2))


@pytest.mark.slow
def test_a_server_is_measured_alone_and_with_a_page_open(tmp_path):
    file = tmp_path / "viewer.jsonl"
    case = ViewerCase(rosters=["P2AT"], updates=1, served=1, seconds=0.5, windows=1)
    measure_viewer(case, BaselineOptions(json=file))
    served = json.loads(file.read_text())["served"]
    for name in ("alone", "page_open"):
        assert served[name]["realtime_factor"] > 0.0
        assert served[name]["cpu_per_simulated_s"] > 0.0
