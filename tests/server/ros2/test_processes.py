"""Discovery and traffic between this process and another one that has no code of usarmjx."""

import contextlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.arenas import FLAT
from tests.server.peers import PATIENCE, looping
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.network.ports import bound_socket
from usarmjx.server.ros2.server import Ros2Server, Ros2Settings
from usarmjx.server.ros2.transport import message_hash, service_hash
from usarmjx.server.worlds.dynamic_world import DynamicWorld

HERE = Path(__file__).parent
DOMAIN = 93


@contextlib.contextmanager
def serving(settings, opening=None):
    world = DynamicWorld(FLAT)
    service = Ros2Server(world, settings, opening)
    server = service.server = BotServer(world, BotServerSettings(port=0), [service])
    with looping([server], 1.0):
        yield service


def client(name, *args):
    done = subprocess.run(
        [sys.executable, str(HERE / name), *args], capture_output=True, text=True, timeout=2 * PATIENCE
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_another_participant_of_dds_finds_all_and_drives():
    pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
    with serving(Ros2Settings(domain=DOMAIN, size=(32, 24))) as service:
        found = client("dds_client.py", str(DOMAIN))
        sent = service.counts
    assert found["reply"] == [77, 5, 1, "R1"], "the request's own identity, and OK"
    assert found["nodes"] == ["usarmjx"]
    assert found["clock"] > 0.0
    assert found["urdf"].startswith('<?xml version="1.0"?>\n<robot name="P2AT">')
    assert found["odom"][:2] == ["R1/odom", "R1/base_link"]
    published = found["published"]
    assert found["writers"] == len(published)
    for topic, kind in (
        ("/clock", "rosgraph_msgs/Clock"),
        ("/tf", "tf2_msgs/TFMessage"),
        ("/R1/scan", "sensor_msgs/LaserScan"),
        ("/R1/battery_state", "sensor_msgs/BatteryState"),
        ("/R1/Camera/camera_info", "sensor_msgs/CameraInfo"),
    ):
        package, name = kind.split("/")
        said = [f"{package}::msg::dds_::{name}_", f"typehash={message_hash(kind)};"]
        assert published[f"rt{topic}"] == said
    kind, said = published["rr/spawn_entityReply"]
    assert kind == "simulation_interfaces::srv::dds_::SpawnEntity_Response_"
    assert said.startswith("serviceid=")
    assert said.endswith(f";typehash={service_hash('simulation_interfaces/srv/SpawnEntity')};")
    assert sent.received == 2
    assert sent.sent > 10


def test_another_session_of_zenoh_finds_all_and_drives():
    pytest.importorskip("zenoh", reason="the extra ros2 is not installed")
    from usarmjx.server.ros2.zenoh_transport import ZenohTransport

    with bound_socket("127.0.0.1", 0) as bound:
        endpoint = f"tcp/127.0.0.1:{bound.getsockname()[1]}"

    with serving(
        Ros2Settings(domain=5, transport="zenoh", size=(32, 24)),
        lambda: ZenohTransport(5, listen=(endpoint,)),
    ):
        found = client("zenoh_client.py", endpoint)
    assert found["reply"] == [1, "R1", ""]
    assert found["answered"] == [9, True, 33], "the request's number and client"
    assert found["clock"][1:] == [33, 16]
    assert found["urdf"].startswith('<?xml version="1.0"?>\n<robot name="P2AT">')
    tokens = [token.split("/", 4)[4] for token in found["tokens"]]
    assert "0/NN/%/%/usarmjx" in tokens
    bare = {token.split("/", 1)[1] for token in tokens}
    scan = message_hash("sensor_msgs/LaserScan")
    assert f"MP/%/%/usarmjx/%R1%scan/sensor_msgs::msg::dds_::LaserScan_/{scan}/::,5:,:,:,," in bare
    empty = service_hash("std_srvs/srv/Empty")
    assert f"SS/%/%/usarmjx/%reset/std_srvs::srv::dds_::Empty_/{empty}/::,10:,:,:,," in bare
