"""Robots of several classes, driven at random for a long time, and whether the server grows meanwhile.

Figures of the server come from its own metrics.
"""

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
from prometheus_client.parser import text_string_to_metric_families
from scipy.stats import theilslopes

from benchmarks.chaos.onlookers import Onlookers
from benchmarks.chaos.target import Target
from benchmarks.serving.clients import Connection, Crowd, RobotClient
from benchmarks.tools import append_record, record_header
from usarmjx.base.errors import UsageError
from usarmjx.models.compile.parts import joint_names
from usarmjx.models.robots import ROBOTS

CLASSES = ("P2AT", "P2DX", "Zerg", "Talon", "ATRVJr", "Kenaf")
"""Who drives: all have Left and Right."""
SPEED = 0.3
"""Largest share of its full speed that a robot is driven with."""
OUT = (0.5, 3.0)
"""It goes for so long, and then back for as long [s of the clock]."""
JOINT = 0.5
"""Joints are moved to at most this, either way [rad]."""
VISIT = (60.0, 600.0)
"""So long a robot stays before another comes in its place [s]."""
PATIENCE = 60.0
"""A robot that is not there by then is asked for once more [s]."""
QUESTIONS = (
    "GETGEO {Type Sonar}",
    "GETCONF {Type RangeScanner}",
    "GETSTARTPOSES",
    "SET {Type Odometry} {Name Odometry} {Opcode RESET}",
    "SET {Type INS} {Name INS} {Opcode POSE} {Params 0,0,0,0,0,0}",
    "DRIVE {Light True}",
)
TURN = 0.05
"""Commands are given so often [s]."""
SETTLED = 0.25
"""The first part of the samples is left out of the slopes: programs and caches fill."""
HOUR, MEGABYTE = 3600.0, 1e6
SCRAPE_LIMIT = 30.0
"""How long the metrics may take [s]."""
SHOWN = {
    "memory_bytes": "usarmjx_process_resident_memory_bytes",
    "descriptors": "usarmjx_process_open_fds",
    "processor_s": "usarmjx_process_cpu_seconds_total",
    "simulated_s": "usarmjx_simulated_seconds_total",
    "clients": "usarmjx_clients",
    "robots": "usarmjx_robots",
    "faults": "usarmjx_faults_total",
    "put_back": "usarmjx_robots_put_back_total",
    "world_resets": "usarmjx_world_resets_total",
    "recording_lag_s": "usarmjx_recording_lag_seconds",
    "frames_left_out": "usarmjx_recording_frames_left_out_total",
}
"""What a sample has of the metrics, all worlds together."""

TOTALS = (
    *("visits", "hung_up", "faults", "put_back", "world_resets", "frames_left_out"),
    *("onlooker_visits", "onlookers_lost", "onlooker_MB"),
)
"""Counters of a sample that a result has as they are in the end."""


@dataclass(frozen=True, kw_only=True)
class SoakCase:
    """Duration and company.

    Attributes:
        target: The server; it must have metrics.
        seconds: For how long [s].
        clients: Number of robots.
        every: Length of the intervals of which each has a sample, at a random moment [s].
        seed: Of what they do.
        onlookers: Number of websocket clients at the page and at rosbridge.
    """

    target: Target
    seconds: float
    clients: int = 12
    every: float = 30.0
    seed: int = 0
    onlookers: int = 0


class SoakDriver:
    """Drives one robot after another, each of them out and back.

    Args:
        crowd: Whose loop reads its client.
        random: Chooses.
        first: Index of its first class.

    Attributes:
        visits: Number of robots it has had.
        hung_up: Number of connections that the server closed.
    """

    def __init__(self, crowd: Crowd, random: np.random.Generator, first: int) -> None:
        self._crowd, self._random, self._class = crowd, random, first
        self._client: RobotClient | None = None
        self._goes = self._acts = 0.0
        self._way = ""
        self.visits = self.hung_up = 0

    def act(self, now: float) -> None:
        """Do what it is time for [s]."""
        if self._client is None or now >= self._goes or self._is_late(now):
            self._come(now)
        elif now >= self._acts:
            self._client.say(*self._orders(now))

    def longest_gap(self) -> float:
        """Return the longest time between two reports since the last call [s]; 0 if there were none."""
        if self._client is None:
            return 0.0
        came = [arrival for arrival, _ in self._client.reports]
        del self._client.reports[:-1]
        return float(np.diff(came).max(initial=0.0))

    def lose(self, client: Connection) -> None:
        """Note that the server has closed a connection, if it is its own."""
        if self._client is client:
            self.hung_up += 1
            self._client = None

    def _is_late(self, now: float) -> bool:
        assert self._client is not None
        return not self._client.reports and now > self._client.began + PATIENCE

    def _come(self, now: float) -> None:
        if self._client is not None:
            self._crowd.leave(self._client)
        self._client = self._crowd.robot()
        self._robot = ROBOTS.get(CLASSES[self._class % len(CLASSES)])
        self._class += 1
        self.visits += 1
        self._client.say(f"INIT {{ClassName USARBot.{self._robot.name}}}")
        self._goes = now + self._random.uniform(*VISIT)
        self._acts, self._way = now, ""

    def _orders(self, now: float) -> list[str]:
        """Return what to say now: back if it went out, else out again, and perhaps something else."""
        if self._way:
            way, self._way = self._way, ""
            self._acts += self._out
            return [way]
        full = self._robot.drive.full_scale["Left"] * SPEED
        left, right = self._random.uniform(-full, full, 2)
        self._out = self._random.uniform(*OUT)
        self._acts = now + self._out
        self._way = f"DRIVE {{Left {-left:.3f}}} {{Right {-right:.3f}}}"
        return [f"DRIVE {{Left {left:.3f}}} {{Right {right:.3f}}}", *self._extra()]

    def _extra(self) -> list[str]:
        joints = joint_names(self._robot)
        if joints and self._random.random() < 0.3:
            joint, value = self._random.choice(joints), self._random.uniform(-JOINT, JOINT)
            return [f"DRIVE {{Name {joint}}} {{Order 0}} {{Value {value:.3f}}}"]
        return [str(self._random.choice(QUESTIONS))]


def soak(
    case: SoakCase, file: Path | None = None, say: Callable[[str], None] = lambda text: None
) -> dict[str, Any]:
    """Drive robots for a long time; return what became of the server, with its growth per hour.

    Args:
        case: Duration and company.
        file: A line of JSON for each sample is appended to it, and one for the result.
        say: Is told each sample.

    Raises:
        UsageError: The server has no metrics, or ends.
    """
    random = np.random.default_rng(case.seed)
    drivers: list[SoakDriver] = []

    def lose(client: Connection) -> None:
        for driver in drivers:
            driver.lose(client)

    samples: list[dict[str, float]] = []
    moments = sample_times(case.seconds, case.every, case.seed)
    began = time.perf_counter()
    with (
        Crowd(case.target.port, lose) as crowd,
        Onlookers(case.target, case.onlookers, case.seed) as onlookers,
    ):
        drivers += [SoakDriver(crowd, random, i) for i in range(case.clients)]
        while (elapsed := time.perf_counter() - began) < case.seconds:
            if len(samples) < len(moments) and elapsed >= moments[len(samples)]:
                samples.append({"elapsed_s": elapsed} | _sample(case.target, drivers, onlookers))
                _append(samples[-1], file, say)
            for driver in drivers:
                driver.act(time.perf_counter())
            crowd.pump(TURN)
        elapsed = time.perf_counter() - began
        samples.append({"elapsed_s": elapsed} | _sample(case.target, drivers, onlookers))
    result = record_header("soak", host=True) if file is not None else {}
    result |= {"clients": case.clients, "onlookers": case.onlookers, **summarise(samples)}
    _append(result, file, say)
    return result


def sample_times(seconds: float, every: float, seed: int = 0) -> list[float]:
    """Return when to take samples [s]: at the beginning, and at a random moment of each further interval.

    A server cleans up at regular times. Regular samples would beat with that, which looks like growth.

    Args:
        seconds: Duration of the soak [s].
        every: Length of an interval [s].
        seed: Seed of the moments.
    """
    begins = np.arange(every, seconds, every)
    return [0.0, *(begins + np.random.default_rng((seed, 1)).uniform(0.0, every, len(begins))).tolist()]


def summarise(samples: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    """Return what samples come to: growth per hour with its 95 % interval, and totals.

    Growth is the median of the slopes of all pairs of samples (Theil and Sen), the first quarter left out.

    Raises:
        UsageError: There are too few.
    """
    first = next(
        (i for i, sample in enumerate(samples) if sample["elapsed_s"] >= SETTLED * samples[-1]["elapsed_s"]),
        0,
    )
    late = samples[first:]
    if len(late) < 3:
        raise UsageError(f"{len(samples)} samples are too few to tell growth: let it last longer")
    hours = [sample["elapsed_s"] / HOUR for sample in late]
    found: dict[str, Any] = {"seconds": samples[-1]["elapsed_s"], "samples": len(samples)}
    for name, unit in (("memory_bytes", MEGABYTE), ("descriptors", 1.0)):
        values = [sample[name] / unit for sample in late]
        slope = theilslopes(values, hours)
        label = name.replace("_bytes", "_MB")
        found[f"{label}_per_hour"] = {"median": slope.slope, "low": slope.low_slope, "high": slope.high_slope}
        found[label] = {
            "first": samples[0][name] / unit,
            "settled": values[0],
            "last": values[-1],
            "most": max(values),
        }
    simulated = samples[-1]["simulated_s"] - samples[0]["simulated_s"]
    found["simulated_s"] = simulated
    found["cpu_per_simulated_s"] = (samples[-1]["processor_s"] - samples[0]["processor_s"]) / max(
        simulated, 1e-9
    )
    for name in ("longest_gap_s", "recording_lag_s"):
        found[name] = max(sample[name] for sample in samples)
    return found | {name: samples[-1][name] for name in TOTALS}


def _sample(target: Target, drivers: Sequence[SoakDriver], onlookers: Onlookers) -> dict[str, float]:
    own = {
        "visits": sum(driver.visits for driver in drivers),
        "hung_up": sum(driver.hung_up for driver in drivers),
        "longest_gap_s": max(driver.longest_gap() for driver in drivers),
        "onlooker_visits": onlookers.visits,
        "onlookers_lost": onlookers.lost,
        "onlooker_MB": onlookers.received / MEGABYTE,
    }
    return own | read_metrics(target)


def read_metrics(target: Target) -> dict[str, float]:
    """Return what a server's metrics say, all its worlds together, by the names of `SHOWN`.

    Raises:
        UsageError: It has none, or does not answer.
    """
    if target.metrics_port is None:
        raise UsageError(
            "a soak needs the server's metrics: start it with --metrics-port, and name that here"
        )
    address = f"http://{target.host}:{target.metrics_port}/metrics"
    try:
        with urlopen(address, timeout=SCRAPE_LIMIT) as answer:
            families = text_string_to_metric_families(answer.read().decode())
    except OSError as error:
        raise UsageError(f"{address}: {error}") from error
    totals: dict[str, float] = {}
    for family in families:
        for sample in family.samples:
            totals[sample.name] = totals.get(sample.name, 0.0) + sample.value
    return {name: totals.get(metric, math.nan) for name, metric in SHOWN.items()}


def _append(found: Mapping[str, Any], file: Path | None, say: Callable[[str], None]) -> None:
    rounded = {key: round(value, 3) if isinstance(value, float) else value for key, value in found.items()}
    say(json.dumps(rounded))
    append_record(rounded, file)
