"""Clients, browsers and ROS clients that come and go leave no objects behind."""

import gc
import json
import threading
import time
from collections import Counter
from functools import partial

from websockets.sync.client import connect

from tests.arenas import FLAT
from tests.server.peers import PATIENCE, Peer, looping, wait_until
from tests.view.visitor import visiting
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.rosbridge.net import RosbridgeServer, RosSettings
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.server.viewing.viewer_service import ViewerService, ViewerSettings
from usarmjx.server.worlds.dynamic_world import DynamicWorld

ROUNDS = 10
"""Visits of each kind in one count."""
SETTLED = 5
"""Visits before the first count: caches fill."""
CLASSES = ("P2AT", "P2DX")


def visit_world(world, port, robot):
    peer = Peer(port, f"INIT {{ClassName USARBot.{robot}}} {{Name {robot}}} {{Location 0,0,0}}")
    assert peer.until(b"STA ")
    peer.say("DRIVE {Left 1.0} {Right 0.5}")
    assert peer.until(b"SEN ")
    peer.close()
    wait_until(lambda: not world.robots)


def visit_page(port):
    with visiting(port) as visitor:
        wait_until(lambda: visitor.heard)


def visit_ros(port):
    with connect(f"ws://127.0.0.1:{port}/", max_size=None) as connection:
        connection.send(json.dumps({"op": "subscribe", "topic": "/clock"}))
        assert connection.recv(timeout=PATIENCE)


def started():
    """Count of threads but for those of pools, which grow and stay."""
    return sum(not thread.name.startswith("ThreadPoolExecutor") for thread in threading.enumerate())


def objects(server, threads):
    """The present objects by type, once all who came have gone."""
    wait_until(lambda: not server._connections and started() <= threads)
    time.sleep(1.0)  # timers and executors let go of what they ran
    gc.collect()
    return Counter(f"{type(one).__module__}.{type(one).__qualname__}" for one in gc.get_objects())


def test_who_came_and_went_leaves_nothing_behind():
    world = DynamicWorld(FLAT, max_robots=2)
    ros = RosbridgeServer(world, RosSettings(port=0))
    page = ViewerService(ServedSource([world]), ViewerSettings())
    server = BotServer(world, BotServerSettings(port=0), [ros, page])
    ros.server = server
    with looping([server]):
        visits = (
            *(partial(visit_world, world, server.port, robot) for robot in CLASSES),
            partial(visit_page, page.port),
            partial(visit_ros, ros.port),
        )
        threads = 0
        counts = []
        gc.freeze()  # there are a million others, which need not be counted
        try:
            for rounds in (SETTLED, ROUNDS, ROUNDS):
                for _ in range(rounds):
                    for visit in visits:
                        visit()
                threads = threads or started()
                counts.append(objects(server, threads))
        finally:
            gc.unfreeze()
    # In both: a thread may hold some at one of the moments.
    left = (counts[1] - counts[0]) & (counts[2] - counts[1])
    # One a visit of one kind would be `ROUNDS`.
    assert {name: count for name, count in left.items() if count >= ROUNDS} == {}
