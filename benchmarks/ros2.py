"""Cost of a ROS 2 node for a served world: processor time, messages and their lateness, over DDS and Zenoh.

`python -m benchmarks.ros2 --json benchmarks/results/ros2.jsonl` serves robots with all sensors in this
process, and reads all their topics but pictures in another one. On a busy machine only processor times count.
"""

import argparse
import asyncio
import json
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import BaselineOptions
from benchmarks.tools import run_case, spread_of
from usarmjx.base.errors import UsageError
from usarmjx.models.files.load import find_arena
from usarmjx.models.robots import ROBOTS
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.ros2.server import Ros2Server, Ros2Settings
from usarmjx.server.ros2.transport import DEFAULT, LATCHED, Transport
from usarmjx.server.rosbridge.services import RosRobots, read_spawn
from usarmjx.server.rosbridge.topics import IMAGE, RAW_IMAGE, WorldTopics
from usarmjx.server.runtime.loop import ServerLoop
from usarmjx.server.worlds.dynamic_world import DynamicWorld

DOMAIN = 94
SETTLING = 3.0
"""Time before a measurement, for discovery [s]."""


def open_transport(kind: str, endpoint: str, *, serves: bool) -> Transport:
    """Return a transport, of Zenoh between this process and its reader without a router."""
    if kind == "dds":
        from usarmjx.server.ros2.dds_transport import DdsTransport

        return DdsTransport(DOMAIN, is_local=True)
    from usarmjx.server.ros2.zenoh_transport import ZenohTransport

    return ZenohTransport(DOMAIN, (), (endpoint,)) if serves else ZenohTransport(DOMAIN, (endpoint,))


def read_topics(kind: str, endpoint: str, seconds: float) -> None:
    """Read the topics that standard input names, and print counts as JSON; runs in the reader's process."""
    topics: list[tuple[str, str]] = json.loads(sys.stdin.readline())
    counts, ages = dict.fromkeys((name for name, _ in topics), 0), list[float]()

    def take(name: str, kind: str, data: bytes) -> None:
        counts[name] += 1
        if kind == "nav_msgs/Odometry":
            seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
            ages.append(time.time() - seconds - nanoseconds * 1e-9)

    transport = open_transport(kind, endpoint, serves=False)
    for name, its in topics:
        latched = name.endswith(("static", "map", "description"))
        transport.subscription(name, its, LATCHED if latched else DEFAULT, partial(take, name, its))
    transport.announce()
    time.sleep(SETTLING)
    before, used, began = sum(counts.values()), time.process_time(), time.time()
    ages.clear()
    time.sleep(seconds)
    late = np.array(ages) - min(ages) if ages else np.zeros(1)
    about = {
        "messages_per_s": (sum(counts.values()) - before) / (time.time() - began),
        "topics_heard": sum(count > 0 for count in counts.values()),
        "topics": len(counts),
        "lateness_p50_s": float(np.quantile(late, 0.5)),
        "lateness_p99_s": float(np.quantile(late, 0.99)),
        "reader_cpu_share": (time.process_time() - used) / seconds,
    }
    print(json.dumps(about), flush=True)
    transport.close()


async def serve_robots(server: BotServer, robots: int, work: Callable[[], Any]) -> Any:  # noqa: ANN401
    """Serve a world with robots while some work is done in a thread; return its result."""
    loop = ServerLoop([server], 1.0)
    running = asyncio.create_task(loop.run())
    while not loop.listening and not running.done():
        await asyncio.sleep(0.01)
    guests = RosRobots(server, "benchmark")
    for number in range(robots):
        row, column = divmod(number, 4)
        pose = {"position": {"x": 1.5 * column, "y": 1.5 * row, "z": 0.4}, "orientation": {"w": 1.0}}
        guests.spawn(*read_spawn({"class": "P2AT", "name": f"R{number}", "pose": pose}))
        await asyncio.sleep(0.1)
    try:
        return await asyncio.get_running_loop().run_in_executor(None, work)
    finally:
        loop.stop()
        await running


def topics_without_pictures(world: DynamicWorld) -> list[tuple[str, str]]:
    """Return name and type of each topic that a world publishes, but for pictures."""
    listed = WorldTopics(world, (320, 240)).all().values()
    return [
        (one.name, one.type)
        for one in listed
        if not one.is_listened_to and one.type not in (IMAGE, RAW_IMAGE)
    ]


def measure(kind: str, robots: int, seconds: float, *, reads: bool) -> dict[str, Any]:
    """Return the figures of one transport, or of none: `off`."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    world = DynamicWorld(find_arena("field"), max_robots=robots)
    world.prepare(ROBOTS.get("P2AT"))
    opening = partial(open_transport, kind, endpoint, serves=True)
    service = None if kind == "off" else Ros2Server(world, Ros2Settings(transport=kind), opening)
    server = BotServer(world, BotServerSettings(port=0), [service] if service else [])
    if service is not None:
        service.server = server

    def work() -> dict[str, Any]:
        found: dict[str, Any] = {}
        process = None
        if reads:
            topics = topics_without_pictures(world)
            words = [sys.executable, "-m", "benchmarks.ros2", "--read", kind, endpoint, str(seconds)]
            process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            assert process.stdin is not None
            process.stdin.write(json.dumps(topics) + "\n")
            process.stdin.flush()
        time.sleep(SETTLING)
        used, began = time.process_time(), world.time
        time.sleep(seconds)
        found["cpu_per_simulated_s"] = (time.process_time() - used) / (world.time - began)
        found["realtime_factor"] = (world.time - began) / seconds
        if process is not None:
            out, _ = process.communicate(timeout=60.0)
            found |= json.loads(out)
        if service is not None:
            found["dropped"] = service.counts.dropped
            found["sent"] = service.counts.sent
        return found

    return asyncio.run(serve_robots(server, robots, work))


def run(robots: int, seconds: float, repeats: int, options: BaselineOptions) -> str:
    """Measure all cases in turn, append the record, and return a summary."""
    cases: dict[str, tuple[str, bool]] = {
        "off": ("off", False),
        "dds_unread": ("dds", False),
        "dds": ("dds", True),
        "zenoh_unread": ("zenoh", False),
        "zenoh": ("zenoh", True),
    }
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in cases}
    for _ in range(repeats):
        for name, (kind, reads) in cases.items():
            rows[name].append(measure(kind, robots, seconds, reads=reads))
            print(name, json.dumps(rows[name][-1]), flush=True)

    def record() -> dict[str, Any]:
        costs = {name: speeds_of(found) for name, found in rows.items()}
        return {
            "case": {
                "robots": robots,
                "class": "P2AT",
                "arena": "field",
                "seconds": seconds,
                "repeats": repeats,
            },
            "scene": None,
            "rates": {name: cost for name, cost in costs.items() if name != "off"},
            "baselines": {"off": costs["off"]},
            "rows": rows,
        }

    return run_case("ros2", options, record, summary_of, host=True)


def speeds_of(found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return how much time is simulated by a second of processor time, over the repeats of a case."""
    return spread_of("simulated-s/CPU s", [1.0 / one["cpu_per_simulated_s"] for one in found])


def summary_of(record: Mapping[str, Any]) -> str:
    """Return the costs and rates of all cases as lines for people."""
    lines = [f"{record['case']['robots']} P2AT, CPU s per simulated s:"]
    for name, found in record["rows"].items():
        costs = [one["cpu_per_simulated_s"] for one in found]
        rates = [one["messages_per_s"] for one in found if "messages_per_s" in one]
        more = f", {np.median(rates):.0f} messages/s" if rates else ""
        lines.append(f"{name}: {np.median(costs):.3f}{more}")
    return "\n".join(lines)


def measure_by_command(
    about: str | None, reader: str, read: Callable[[str, str, str], None], run: Callable[..., str]
) -> None:
    """Read the command line of a benchmark of served robots, and measure, or read in a process of its own.

    Args:
        about: Description of the command.
        reader: Words of a reader's process, the last of which is its time [s].
        read: Reads topics, as these words say.
        run: Measures robots for some seconds, some times.

    Raises:
        UsageError: No robots or repeats.
    """
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--read", nargs=3, help=f"the reader's process: {reader}")
    parser.add_argument("--robots", type=int, default=16)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--note", default="")
    parser.add_argument("--json", type=Path, default=None)
    given = parser.parse_args()
    if given.read:
        read(*given.read)
        return
    if given.robots < 1 or given.repeats < 1:
        raise UsageError("--robots and --repeats are at least 1")
    print(run(given.robots, given.seconds, given.repeats, BaselineOptions(json=given.json, note=given.note)))


def main() -> None:
    """Read the command line, and measure."""

    def read(transport: str, endpoint: str, seconds: str) -> None:
        read_topics(transport, endpoint, float(seconds))

    measure_by_command(__doc__, "transport, endpoint, seconds", read, run)


if __name__ == "__main__":
    main()
