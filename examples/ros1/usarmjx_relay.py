"""A node of ROS 1 that hands topics of `usarmjx serve --rosbridge-port` on to ROS 1, and commands back.

It needs rospy, websockets and cbor2. On Debian 12 these are packages:

    apt-get install python3-rospy python3-rosmaster python3-sensor-msgs python3-nav-msgs python3-tf2-msgs \
        python3-websockets python3-cbor2
    rosmaster --core &
    usarmjx serve --arena yellow --rosbridge-port 9090 --ros-version 1 &
    /usr/bin/python3 usarmjx_relay.py _url:=ws://127.0.0.1:9090 _robot:=P2AT _name:=R1

It waits until the master and the server listen. Messages come as ROS 1's own bytes (`cbor-raw`). A topic
whose message package is not installed is left out with a warning. Simulated time is in /clock: set
/use_sim_time before other nodes start.
"""
# pyright: reportMissingImports=false

import asyncio
import json
import time
from typing import Any

import cbor2
import rosgraph
import rospy
from geometry_msgs.msg import Twist
from roslib.message import get_message_class
from websockets import connect

LATCHED = ("/map", "/tf_static", "/robot_description")
"""Ends of topics whose last message goes to late subscribers, too."""
INTERVAL = 0.2
"""Interval between two attempts to reach the master or the server [s]."""


def twist_fields(twist: Twist) -> dict[str, Any]:
    """Return a Twist as JSON."""
    parts = {"linear": twist.linear, "angular": twist.angular}
    return {name: {axis: getattr(part, axis) for axis in "xyz"} for name, part in parts.items()}


class Relay:
    """The node's work: private parameters `url`, `robot` (a class; empty: none appears) and `name`."""

    def __init__(self, socket: Any) -> None:
        self.socket = socket
        self.loop = asyncio.get_running_loop()
        self.topics: dict[str, tuple[rospy.Publisher, type]] = {}

    async def say(self, op: str, **more: Any) -> None:
        """Send a message."""
        await self.socket.send(json.dumps({"op": op, **more}))

    async def call(self, service: str, args: dict[str, Any]) -> dict[str, Any]:
        """Return what a service answers.

        Raises:
            RuntimeError: It failed.
        """
        await self.say("call_service", service=service, args=args)
        while True:
            answer = json.loads(await self.socket.recv())
            if answer["op"] == "service_response":
                if not answer["result"]:
                    raise RuntimeError(f"{service}: {answer['values']}")
                return answer["values"]

    async def begin(self) -> None:
        """Let the robot appear, and hand on every topic whose type ROS has here."""
        robot = rospy.get_param("~robot", "P2AT")
        if robot:
            await self.call("/simulator/spawn", {"class": robot, "name": rospy.get_param("~name", "R1")})
        listed = await self.call("/rosapi/topics", {})
        for topic, kind in zip(listed["topics"], listed["types"], strict=True):
            message = get_message_class(kind)
            if message is None:
                rospy.logwarn("%s is left out: no package of %s here", topic, kind)
            elif topic.endswith("/cmd_vel"):
                rospy.Subscriber(topic, Twist, self.command, topic)
            elif not topic.endswith("/joint_trajectory"):
                latched = topic.endswith(LATCHED)
                publisher = rospy.Publisher(topic, message, queue_size=10, latch=latched)
                self.topics[topic] = publisher, message
                await self.say("subscribe", topic=topic, type=kind, queue_length=10, compression="cbor-raw")

    def command(self, twist: Twist, topic: str) -> None:
        """Hand a command on to a robot; rospy calls this in a thread of its own."""
        said = self.say("publish", topic=topic, msg=twist_fields(twist))
        asyncio.run_coroutine_threadsafe(said, self.loop)

    async def run(self) -> None:
        """Hand on what comes, until the server closes the connection or ROS ends."""
        async for frame in self.socket:
            if rospy.is_shutdown():
                return
            said = cbor2.loads(frame) if isinstance(frame, bytes) else json.loads(frame)
            if said["op"] == "publish":
                publisher, message = self.topics[said["topic"]]
                publisher.publish(message().deserialize(said["msg"]["bytes"]))
            elif said["op"] == "status":
                rospy.logwarn(said["msg"])


async def connected(url: str) -> Any:
    """Return a connection to the server, as soon as that listens."""
    while not rospy.is_shutdown():
        try:
            # Without pings: a server that compiles a robot answers none.
            return await connect(url, max_size=None, ping_interval=None)
        except OSError:
            await asyncio.sleep(INTERVAL)
    raise rospy.ROSInterruptException


async def relay() -> None:
    """Connect, and hand on."""
    socket = await connected(rospy.get_param("~url", "ws://127.0.0.1:9090"))
    try:
        node = Relay(socket)
        await node.begin()
        await node.run()
    finally:
        await socket.close()


def main() -> None:
    """Run the node, as soon as there is a master."""
    while not rosgraph.is_master_online():
        time.sleep(INTERVAL)
    rospy.init_node("usarmjx_relay")
    asyncio.run(relay())


if __name__ == "__main__":
    main()
