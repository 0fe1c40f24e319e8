"""Cost of the live page: an update of it, what goes to a browser, and the server that has one open."""

import contextlib
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import viser

from benchmarks.baselines import hall_baselines
from benchmarks.cases import BaselineOptions, ViewerCase
from benchmarks.serving.clients import Bounds, Missing, attempt
from benchmarks.serving.load import make_hall, measure_load
from benchmarks.serving.process import OWN_TREE, VIEWER, ServerProcess, SourceTree
from benchmarks.tools import run_case, spread_of
from usarmjx.base.errors import UsageError
from usarmjx.models.files.load import save_arena
from usarmjx.models.robots import ROBOTS
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.control import CommandUpdate
from usarmjx.view.page import UPDATE_PERIOD, ViewerPage

USUAL = BaselineOptions()
TURNING = {"Left": 2.0, "Right": -2.0}
STEPS = 3
"""Control steps between two updates."""
SETTLING = 1.0
"""A browser has taken in the world after so long [s]."""


class Browser:
    """Somebody who looks, in a process of their own: what it costs them is not counted.

    Args:
        port: The page's, on this machine.
    """

    def __init__(self, port: int) -> None:
        words = [sys.executable, "-m", "benchmarks.onlooker", str(port), f"viser-v{viser.__version__}"]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._say_hello()

    @property
    def size(self) -> int:
        """Amount received [bytes]."""
        return int(self._ask("size"))

    def close(self) -> None:
        """Look no more."""
        self._process.communicate()

    def _say_hello(self) -> None:
        self._ask("hello")

    def _ask(self, word: str) -> str:
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(f"{word}\n")
        process.stdin.flush()
        return process.stdout.readline() or "0"


@contextlib.contextmanager
def looking(port: int) -> Iterator[Browser]:
    """Have a browser at a page."""
    browser = Browser(port)
    try:
        yield browser
    finally:
        browser.close()


def measure_viewer(case: ViewerCase, options: BaselineOptions = USUAL) -> str:
    """Measure a case, append its record, and return a summary for people.

    Raises:
        UnknownNameError: No such robot.
    """
    return run_case("viewer", options, lambda: _measure(case, options.baselines), _summary, host=True)


def _measure(case: ViewerCase, baselines: str) -> dict[str, Any]:
    """Return the record of a case, without its header."""
    began = os.getloadavg()
    updates = {f"{robots} robots": _measure_updates(case, robots) for robots in case.robots}
    most = max(case.robots)
    return {
        "case": case.as_record(),
        "scene": {"robots": most},
        "rates": {
            name: spread_of("updates/CPU s", [1e3 / ms for ms in row.pop("process_cpus_ms")])
            for name, row in updates.items()
        },
        "baselines": hall_baselines(case.robot, most, case.windows, baselines),
        "cores": os.cpu_count(),
        "meaning": {
            "update_cpu_ms": "of the thread that steps the world: the world is read, moved bodies are sent",
            "process_cpu_ms": "of the server's whole process for an update, with one browser",
            "bytes_per_s": "to one browser, at 20 updates a second",
        },
        "updates": updates,
        "served": _measure_served(case) if case.served else None,
        "load_average": {"begin": began, "end": os.getloadavg()},
    }


def _measure_updates(case: ViewerCase, robots: int) -> dict[str, Any]:
    world = _turning_world(case.robot, robots)
    page = ViewerPage(ServedSource([world]))
    thread_times, process_times = list[float](), list[float]()
    try:
        with looking(page.server.get_port()) as browser:
            _wait_until_looked_at(page, case.limit)
            for _ in range(5):
                _step(world)
                page.refresh()
            time.sleep(SETTLING)
            before = browser.size
            for _ in range(case.updates):
                _step(world)
                began, thread_began = time.process_time(), time.thread_time()
                page.refresh()
                thread_times.append(time.thread_time() - thread_began)
                time.sleep(UPDATE_PERIOD / 2)  # viser's thread sends meanwhile
                process_times.append(time.process_time() - began)
            size = browser.size - before
    finally:
        page.close()
    return {
        "update_cpu_ms": 1e3 * statistics.median(thread_times),
        "update_cpu_most_ms": 1e3 * max(thread_times),
        "process_cpu_ms": 1e3 * statistics.fmean(process_times),
        "process_cpus_ms": [1e3 * one for one in process_times if one > 0.0],
        "bytes_per_s": size / case.updates / UPDATE_PERIOD,
    }


def _turning_world(robot: str, robots: int) -> DynamicWorld:
    """Return a hall with robots that turn on the spot."""
    arena, spec = make_hall(robots), ROBOTS.get(robot)
    world = DynamicWorld(arena)
    world.prepare(spec)
    for number, start in enumerate(arena.starts[:robots]):
        made = world.spawn(spec, f"robot{number}", start.at, (0.0, 0.0, start.yaw))
        world.update_command(made, CommandUpdate(drive=TURNING))
    return world


def _step(world: DynamicWorld) -> None:
    for _ in range(STEPS):
        world.step()
    world.observe(list(world.robots.values()))


def _wait_until_looked_at(page: ViewerPage, limit: float) -> None:
    end = time.monotonic() + limit
    while not page.viewers:
        if time.monotonic() > end:
            raise UsageError(f"no browser came to the page within {limit:g} s")
        page.update()
        time.sleep(UPDATE_PERIOD)


def _measure_served(case: ViewerCase) -> dict[str, Any]:
    """Return the pace and cost of a server's robots, without a page and with one open."""
    tree = SourceTree(OWN_TREE)
    with TemporaryDirectory(prefix="usarmjx-bench-") as folder:
        arena = save_arena(make_hall(case.served), Path(folder) / "hall.yaml")
        words = ["--arena", str(arena), "--engine", "c", "--viewer-port", "0", *tree.seats(case.served)]
        bounds = Bounds(case.seconds, case.windows, case.limit)
        with ServerProcess(tree, Path(folder), words) as server:
            measure = partial(measure_load, server, case.served, bounds)
            alone = attempt(measure)
            with looking(server.port_said(VIEWER)):
                return {"alone": _driving(alone), "page_open": _driving(attempt(measure))}


def _driving(load: dict[str, Any] | Missing) -> dict[str, Any]:
    found = load if isinstance(load, Missing) else load["driving"]
    if isinstance(found, Missing):
        return {"missing": found.reason}
    names: Sequence[str] = ("realtime_factor", "cpu_per_simulated_s", "jitter_p95_s")
    return {name: statistics.median(found[name]) for name in names}


def _summary(record: dict[str, Any]) -> str:
    lines = [f"the live page on {record['device']}"]
    for robots, row in record["updates"].items():
        lines.append(
            f"{robots:12} {row['update_cpu_ms']:6.2f} ms an update, {row['process_cpu_ms']:.2f} ms with "
            f"sending, {row['bytes_per_s'] / 1024:,.0f} KiB/s to a browser"
        )
    for name, row in (record["served"] or {}).items():
        said = row.get("missing") or (
            f"real-time factor {row['realtime_factor']:.2f}, {row['cpu_per_simulated_s']:.2f} s of CPU"
        )
        lines.append(f"{record['case']['served']} robots served, {name.replace('_', ' ')}: {said}")
    return "\n".join(lines)
