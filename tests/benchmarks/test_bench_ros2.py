"""The record of the cost of a ROS 2 node: rates are the inverses of measured costs, and fit the schema."""

import pytest

from benchmarks import ros2
from tests.benchmarks.records import check_rates, check_refusals, measured

COSTS = {"off": 0.2, "dds": 0.4, "zenoh": 0.5}


@pytest.fixture
def record(tmp_path, monkeypatch):
    def measure(kind, robots, seconds, *, reads):
        assert (robots, seconds) == (3, 2.0)
        read = {"messages_per_s": 100.0, "topics_heard": 9, "topics": 9} if reads else {}
        counts = {"dropped": 0, "sent": 5} if kind != "off" else {}
        return {"cpu_per_simulated_s": COSTS[kind], "realtime_factor": 1.0, **read, **counts}

    return measured(ros2, measure, tmp_path, monkeypatch, "zenoh: 0.500, 100 messages/s")


def test_a_record_fits_the_schema_and_its_rates_are_inverse_costs(record):
    check_rates(record, {"off": 5.0, "dds": 2.5, "dds_unread": 2.5, "zenoh": 2.0, "zenoh_unread": 2.0})


def test_the_schema_refuses_a_record_that_lacks_a_transport_or_a_cost(record):
    check_refusals(record, "zenoh")
