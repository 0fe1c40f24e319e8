"""The node of rospy that hands topics on, run with Debian's ROS 1; skipped where that is not installed."""

import contextlib
import json
import os
import subprocess

import pytest

import dev
from tests.arenas import FLAT
from tests.server.peers import PATIENCE
from tests.server.rosbridge.test_net import serving_ros
from usarmjx.server.network.ports import bound_socket
from usarmjx.server.rosbridge.definitions import RosVersion
from usarmjx.server.worlds.dynamic_world import DynamicWorld

PYTHON = "/usr/bin/python3"
RELAY = dev.ROOT / "examples" / "ros1" / "usarmjx_relay.py"
LISTENER = f"""
import json, rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

rospy.init_node("listener", disable_signals=True)
odom = rospy.wait_for_message("/R1/odom", Odometry, {PATIENCE})
scan = rospy.wait_for_message("/R1/Scanner1", LaserScan, {PATIENCE})
clock = rospy.wait_for_message("/clock", Clock, {PATIENCE})
frames = rospy.wait_for_message("/tf", TFMessage, {PATIENCE})
drive = rospy.Publisher("/R1/cmd_vel", Twist, queue_size=1)
command, x = Twist(), odom.pose.pose.position.x
command.linear.x = 0.4
while x < odom.pose.pose.position.x + 0.2:
    drive.publish(command)
    x = rospy.wait_for_message("/R1/odom", Odometry, {PATIENCE}).pose.pose.position.x
print(json.dumps({{
    "frames": [odom.header.frame_id, odom.child_frame_id, scan.header.frame_id],
    "beams": len(scan.ranges), "clock": clock.clock.to_sec(),
    "tf": sorted(t.child_frame_id for t in frames.transforms),
    "moved": x - odom.pose.pose.position.x,
}}))
"""


@contextlib.contextmanager
def running(*words, **more):
    """A process that is ended."""
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **more)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(PATIENCE)


def test_nodes_of_ros_1_hear_a_robot_and_drive_it(tmp_path):
    try:
        subprocess.run(
            [PYTHON, "-c", "import cbor2, rosmaster, rospy, websockets"], check=True, capture_output=True
        )
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no rospy, rosmaster, cbor2 and websockets of the system's Python")
    with bound_socket("127.0.0.1", 0) as free:
        master = free.getsockname()[1]
    keep = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    env = {**keep, "ROS_MASTER_URI": f"http://127.0.0.1:{master}", "ROS_HOSTNAME": "127.0.0.1"}
    env |= {"ROS_HOME": str(tmp_path), "PATH": "/usr/bin:/bin"}
    world = DynamicWorld(FLAT)
    with (
        serving_ros(world, 1.0, version=RosVersion.ROS1) as (port, _),
        running("/usr/bin/rosmaster", "--core", "-p", str(master), env=env),
        running(PYTHON, str(RELAY), f"_url:=ws://127.0.0.1:{port}", env=env),
    ):
        done = subprocess.run(
            [PYTHON, "-c", LISTENER], env=env, capture_output=True, text=True, timeout=6 * PATIENCE
        )
        assert done.returncode == 0, done.stderr
        found = json.loads(done.stdout.splitlines()[-1])
        (robot,) = world.robots.values()
        true = world.state(robot).pos[0]
    assert found["frames"] == ["R1/odom", "R1/base_link", "R1/Scanner1"]
    assert found["beams"] == 181
    assert found["clock"] > 0.0
    assert "R1/base_link" in found["tf"]
    assert 0.2 <= found["moved"] <= true + 0.01, "the start is 0"
