"""The record of the cost of a ROS 2 node: rates are the inverses of measured costs, and fit the schema."""

import copy
import json

import pytest

from benchmarks import ros2
from benchmarks.cases import BaselineOptions
from tests.benchmarks.records import faults

COSTS = {"off": 0.2, "dds": 0.4, "zenoh": 0.5}


@pytest.fixture
def record(tmp_path, monkeypatch):
    def measure(kind, robots, seconds, *, reads):
        assert (robots, seconds) == (3, 2.0)
        read = {"messages_per_s": 100.0, "topics_heard": 9, "topics": 9} if reads else {}
        counts = {"dropped": 0, "sent": 5} if kind != "off" else {}
        return {"cpu_per_simulated_s": COSTS[kind], "realtime_factor": 1.0, **read, **counts}

    monkeypatch.setattr(ros2, "measure", measure)
    file = tmp_path / "ros2.jsonl"
    summary = ros2.run(3, 2.0, 2, BaselineOptions(json=file, note=""))
    assert "zenoh: 0.500, 100 messages/s" in summary
    (line,) = file.read_text().splitlines()
    return json.loads(line)


def test_a_record_fits_the_schema_and_its_rates_are_inverse_costs(record):
    assert faults(record) == []
    rates = record["rates"] | record["baselines"]
    assert {name: one["rate"] for name, one in rates.items()} == {
        "off": 5.0, "dds": 2.5, "dds_unread": 2.5, "zenoh": 2.0, "zenoh_unread": 2.0
    }  # fmt: skip
    assert {one["repeats"] for one in rates.values()} == {2}


def test_the_schema_refuses_a_record_that_lacks_a_transport_or_a_cost(record):
    for name in ("rates", "rows"):
        lacking = copy.deepcopy(record)
        del lacking[name]["zenoh"]
        assert any("'zenoh' is a required property" in fault for fault in faults(lacking))
    del record["rows"]["off"][0]["cpu_per_simulated_s"]
    assert any("'cpu_per_simulated_s' is a required property" in fault for fault in faults(record))
