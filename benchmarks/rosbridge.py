"""Cost of rosbridge for a served world: processor time, messages and their lateness, as JSON and as CBOR.

`python -m benchmarks.rosbridge --json benchmarks/results/rosbridge.jsonl` serves robots with all sensors in
this process, and reads all their topics but pictures by one websocket in another process. On a busy machine
only processor times count.
"""

import asyncio
import json
import re
import subprocess
import sys
import time
from typing import Any

import numpy as np

from benchmarks.cases import BaselineOptions
from benchmarks.ros2 import (
    SETTLING,
    measure_by_command,
    serve_robots,
    speeds_of,
    summary_of,
    topics_without_pictures,
)
from benchmarks.tools import run_case
from usarmjx.models.files.load import find_arena
from usarmjx.models.robots import ROBOTS
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.rosbridge.net import RosbridgeServer, RosSettings
from usarmjx.server.worlds.dynamic_world import DynamicWorld

CASES = {"off": None, "unread": "", "json": "none", "cbor": "cbor"}
"""Compression that the reader of each case asks for: '' subscribes to nothing, None does not connect."""
TOPIC = re.compile(rb'"topic": "([^"]+)"|etopic(?:[\x60-\x77]|x.)([ -~]+?)cmsg', re.DOTALL)
"""A frame's topic, in JSON or as CBOR's text of 5 and text of 3 characters with a text in between."""
QUANTILES = {"lateness_p50_s": 0.5, "lateness_p99_s": 0.99}
"""Figures of the lateness, beyond the message that came soonest."""


def topic_of(frame: str | bytes) -> str:
    """Return the topic of a frame of `publish`, or '' for other frames."""
    head = frame[:160].encode() if isinstance(frame, str) else frame[:160]
    found = TOPIC.search(head)
    return (found[1] or found[2]).decode() if found else ""


def stamp_of(frame: str | bytes) -> float:
    """Return the time that a frame with an odometry is stamped with [s]."""
    if isinstance(frame, str):
        message = json.loads(frame)
    else:
        from cbor2 import loads

        message = loads(frame)
    stamp = message["msg"]["header"]["stamp"]
    return stamp["sec"] + stamp["nanosec"] * 1e-9


async def read_topics(port: int, compression: str, topics: list[str], seconds: float) -> dict[str, Any]:
    """Subscribe to topics, and return counts; runs in the reader's process.

    Args:
        port: The rosbridge port, on this machine.
        compression: As clients write it; '' subscribes to nothing.
        topics: Their names.
        seconds: Duration, after the time to settle.
    """
    from websockets.asyncio.client import connect

    ages, heard, messages, size = list[float](), set[str](), 0, 0
    async with connect(f"ws://127.0.0.1:{port}", max_size=None, ping_interval=None) as link:
        for name in topics if compression else ():
            wanted = {"op": "subscribe", "id": name, "topic": name, "compression": compression}
            await link.send(json.dumps(wanted))
        begin, used = time.time() + SETTLING, None
        while (now := time.time()) < begin + seconds:
            if used is None and now >= begin:
                used, messages, size = time.process_time(), 0, 0
                ages.clear()
            try:
                frame = await asyncio.wait_for(link.recv(), 0.1)
            except TimeoutError:
                continue
            topic = topic_of(frame)
            messages, size = messages + 1, size + len(frame)
            heard.add(topic)
            if topic.endswith("/odom"):
                ages.append(time.time() - stamp_of(frame))
        used = time.process_time() - (used or 0.0)
    found: dict[str, Any] = {"reader_cpu_share": used / seconds}
    if compression:
        late = np.array(ages) - min(ages)
        found |= {name: float(np.quantile(late, share)) for name, share in QUANTILES.items()}
        found |= {"messages_per_s": messages / seconds, "bytes_per_s": size / seconds}
        found |= {"topics_heard": len(heard & {*topics}), "topics": len(topics)}
    return found


def measure(compression: str | None, robots: int, seconds: float) -> dict[str, Any]:
    """Return the figures of one case of `CASES`."""
    world = DynamicWorld(find_arena("field"), max_robots=robots)
    world.prepare(ROBOTS.get("P2AT"))
    service = RosbridgeServer(world, RosSettings(port=0))
    server = BotServer(world, BotServerSettings(port=0), [service])
    service.server = server

    def work() -> dict[str, Any]:
        process = None
        if compression is not None:
            words = [sys.executable, "-m", "benchmarks.rosbridge", "--read", str(service.port), compression]
            process = subprocess.Popen(
                [*words, str(seconds)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            assert process.stdin is not None
            process.stdin.write(json.dumps([name for name, _ in topics_without_pictures(world)]) + "\n")
            process.stdin.flush()
        time.sleep(SETTLING)
        used, began = time.process_time(), world.time
        time.sleep(seconds)
        found: dict[str, Any] = {
            "cpu_per_simulated_s": (time.process_time() - used) / (world.time - began),
            "realtime_factor": (world.time - began) / seconds,
        }
        if process is not None:
            out, _ = process.communicate(timeout=60.0)
            found |= json.loads(out)
        return found

    return asyncio.run(serve_robots(server, robots, work))


def run(robots: int, seconds: float, repeats: int, options: BaselineOptions) -> str:
    """Measure all cases in turn, append the record, and return a summary."""
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in CASES}
    for _ in range(repeats):
        for name, compression in CASES.items():
            rows[name].append(measure(compression, robots, seconds))
            print(name, json.dumps(rows[name][-1]), flush=True)

    def record() -> dict[str, Any]:
        costs = {name: speeds_of(found) for name, found in rows.items()}
        about = {"class": "P2AT", "arena": "field", "seconds": seconds, "repeats": repeats}
        return {
            "case": {"robots": robots, **about},
            "scene": None,
            "rates": {name: cost for name, cost in costs.items() if name != "off"},
            "baselines": {"off": costs["off"]},
            "rows": rows,
        }

    return run_case("rosbridge", options, record, summary_of, host=True)


def main() -> None:
    """Read the command line, and measure."""

    def read(port: str, compression: str, seconds: str) -> None:
        topics = json.loads(sys.stdin.readline())
        print(json.dumps(asyncio.run(read_topics(int(port), compression, topics, float(seconds)))))

    measure_by_command(__doc__, "port, compression, seconds", read, run)


if __name__ == "__main__":
    main()
