"""roslibpy, a client of rosbridge that others have written; skipped where it is not installed."""

import queue
import threading

import pytest

from tests.arenas import FLAT
from tests.server.peers import PATIENCE
from tests.server.rosbridge.test_net import serving_ros
from usarmjx.server.worlds.dynamic_world import DynamicWorld

roslibpy = pytest.importorskip("roslibpy", reason="roslibpy is not installed")


def asked(function, *args):
    """The answer of a call that takes callbacks."""
    answers = queue.Queue()
    function(*args, callback=answers.put, errback=lambda error: answers.put(AssertionError(error)))
    answer = answers.get(timeout=PATIENCE)
    assert not isinstance(answer, AssertionError), answer
    return answer


def test_roslibpy_asks_drives_and_hears():
    with serving_ros(DynamicWorld(FLAT), 1.0) as (port, _):
        ros = roslibpy.Ros("127.0.0.1", port)
        ros.run(timeout=PATIENCE)
        spawn = roslibpy.Service(ros, "/simulator/spawn", "usarmjx_msgs/Spawn")
        request = roslibpy.ServiceRequest({"class": "P2AT", "name": "R1"})
        assert spawn.call(request, timeout=PATIENCE)["name"] == "R1"
        assert ros.get_time()["secs"] >= 0
        assert asked(ros.get_nodes)["nodes"] == ["/usarmjx"]
        assert ros.get_service_type("/simulator/spawn") == "usarmjx_msgs/Spawn"
        assert "/R1/odom" in asked(ros.get_topics_for_type, "nav_msgs/Odometry")["topics"]
        details = asked(ros.get_message_details, "geometry_msgs/Twist")
        assert details["typedefs"][0]["fieldnames"] == ["linear", "angular"]
        for part, fields in (("request", ["class", "name", "pose", "start"]), ("response", ["name"])):
            ask = getattr(ros, f"get_service_{part}_details")
            assert ask("usarmjx_msgs/Spawn")["typedefs"][0]["fieldnames"] == fields
        assert "P2AT" in roslibpy.Param(ros, "/R1/robot_description").get(timeout=PATIENCE)
        mine = roslibpy.Param(ros, "/mine")
        mine.set([1, 2], timeout=PATIENCE)
        assert mine.get(timeout=PATIENCE) == [1, 2]
        moves, found = threading.Event(), []
        odom = roslibpy.Topic(ros, "/R1/odom", "nav_msgs/Odometry")

        def hear(message):
            found.append(message)
            if message["twist"]["twist"]["linear"]["x"] > 0.1:
                moves.set()

        odom.subscribe(hear)
        wheels = roslibpy.Topic(ros, "/R1/cmd_vel", "geometry_msgs/Twist")
        wheels.publish(roslibpy.Message({"linear": {"x": 0.3}}))
        assert moves.wait(PATIENCE)
        assert found[0]["header"]["frame_id"] == "R1/odom"
        ros.close()
