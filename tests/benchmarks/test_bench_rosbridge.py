"""The record of the cost of rosbridge: rates are inverse costs; frames are known by topic."""

import pytest

from benchmarks import rosbridge
from tests.benchmarks.records import check_rates, check_refusals, measured
from usarmjx.server.rosbridge.definitions import RosVersion
from usarmjx.server.rosbridge.encodings import Compression, publication

COSTS = {None: 0.2, "": 0.25, "none": 0.5, "cbor": 0.4}


@pytest.fixture
def record(tmp_path, monkeypatch):
    def measure(compression, robots, seconds):
        assert (robots, seconds) == (3, 2.0)
        read = {"messages_per_s": 100.0, "topics_heard": 9, "topics": 9} if compression else {}
        return {"cpu_per_simulated_s": COSTS[compression], "realtime_factor": 1.0, **read}

    return measured(rosbridge, measure, tmp_path, monkeypatch, "cbor: 0.400, 100 messages/s")


def test_a_record_fits_the_schema_and_its_rates_are_inverse_costs(record):
    check_rates(record, {"off": 5.0, "unread": 4.0, "json": 2.0, "cbor": 2.5})


def test_the_schema_refuses_a_record_that_lacks_an_encoding_or_a_cost(record):
    check_refusals(record, "cbor")


@pytest.mark.parametrize("compression", [Compression.NONE, Compression.CBOR])
@pytest.mark.parametrize("topic", ["/R1/odom", "/a/much/longer/name/of/a/robot/odom", "/tf"])
def test_the_reader_knows_the_topic_and_stamp_of_a_frame(topic, compression):
    version, kind = RosVersion.ROS2, "sensor_msgs/Range"
    header = {"stamp": {"sec": 12, "nanosec": 250000000}, "frame_id": "odom"}
    message = {**dict.fromkeys(version.fields(kind), 0), "header": header}
    frame = publication(topic, kind, message, version, compression, 0.0)
    assert rosbridge.topic_of(frame) == topic
    assert rosbridge.stamp_of(frame) == 12.25
    reply = '{"op": "service_response", "id": "x"}'
    assert rosbridge.topic_of(reply if isinstance(frame, str) else reply.encode()) == ""
