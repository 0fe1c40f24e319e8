"""Six robots search the yellow arena for five minutes: each by its laser, with a client of its own.

    python examples/mission.py --record mission.mcap --json mission.json
    usarmjx view mission.mcap

Two P2ATs look for victims; two P2DXs, a Kurt2D and a Rugbot help to cover the floor. A robot drives where its
laser sees room, and backs off where it is stuck. In the end stands what each has done, which victims were
found, and whether a report was missed. The world is a server of its own, headless and as fast as it can
be, or the one at `--port`. Times are simulated; axes are the server's: x forward, y right, yaw clockwise.
"""

import argparse
import json
import math
import sys
import threading
import time
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path

from own_server import served

try:
    from usarmjx.client import ServerMessage, UsarsimClient
except ImportError:  # in a clone that is not installed
    from usarsim_client import ServerMessage, UsarsimClient

TEAM = ("P2AT", "P2AT", "P2DX", "P2DX", "Kurt2D", "Rugbot")
RESCUE = Path(__file__).with_name("rescue.ini")  # the P2AT's sensors for victims

CRUISE, BACK = 0.4, -0.25  # m/s
TURN = 1.2  # rad/s, if no wheel slipped
MARGIN = 0.12  # m beside the hull that must be free ahead
STOP_AT, GO_AT = 0.35, 0.8  # m free ahead: below the one it turns until there is the other
STUCK_AFTER, BACK_OFF = 3.0, 1.5  # s: moving so long without getting on, and how long it backs off then
GETTING_ON, TURNING_ON = 0.1, 0.4  # m, rad: less is not getting on
LOST_AFTER = 8.0  # s of turning without finding room
CELL = 0.6  # m: the floor is counted in such squares
SAME = 1.0  # m: parts seen nearer to each other are of one victim
REPORT = 0.2  # s between two reports

Place = tuple[float, float, float]  # x, y [m], yaw [rad]


@dataclass
class Log:
    """What a robot has done.

    Attributes:
        name: Its name.
        driven: How far it has come [m].
        cells: The squares of the floor that it has been in.
        stuck: How often it was stuck.
        reports: How many status reports came.
        missed: How many did not.
        victims: Where it has seen parts of victims: x, y [m].
        track: Time [s], x, y [m] of every second.
    """

    name: str
    driven: float = 0.0
    cells: set[tuple[int, int]] = field(default_factory=set)
    stuck: int = 0
    reports: int = 0
    missed: int = 0
    victims: list[tuple[float, float]] = field(default_factory=list)
    track: list[tuple[float, float, float]] = field(default_factory=list)


class Explorer:
    """Drives one robot.

    Args:
        robot: The connection.
        kind: Its class.
        name: Its name.
    """

    def __init__(self, robot: UsarsimClient, kind: str, name: str) -> None:
        self.robot, self.log = robot, Log(name)
        robot.send("INIT", ClassName=f"USARBot.{kind}", Name=name)  # at a free start pose
        geometry = robot.geo("Robot") if self._is_there() else None
        if geometry is None:
            raise ConnectionError(f"{kind} does not report")
        self.length, self.width, _ = geometry.vector("Dimensions")
        self.radius, self.track = (
            float(geometry.value("WheelRadius")),
            float(geometry.value("WheelSeparation")),
        )
        (item,) = robot.geo("RangeScanner").items().values()
        self.scanner = float(item["Location"].split(",")[0])
        self.now = self.began = self.last = -1.0
        self.pose: Place | None = None
        self.turning = 0
        self.turns_since = self.backs_until = -1.0
        self.anchor, self.there_since = (math.nan, math.nan, math.nan), -1.0  # where it has not got on from

    def _is_there(self) -> bool:
        return any(message.kind == "STA" for message in self.robot)

    def run(self, seconds: float) -> None:
        """Explore for so many simulated seconds."""
        for message in self.robot:
            self.take(message)
            if self.began >= 0 and self.now - self.began >= seconds:
                return self.robot.drive(0.0, 0.0)
        raise ConnectionError(f"{self.log.name} is not told anything any more")

    def take(self, message: ServerMessage) -> None:
        """Note what a message says; a scan is answered."""
        kind = message.value("Type") if message.kind == "SEN" else message.kind
        if kind == "STA":
            self._count(message.time() or 0.0)
        elif kind == "GroundTruth":
            self._move(message.pose())
        elif kind == "VictSensor" and self.pose:
            self.log.victims += [self._seen(place) for place in message.values("Location")]
        elif kind == "RangeScanner":
            speed, turn = self.decide(message.scan(), float(message.value("FOV")))
            difference = turn * self.track / 2  # positive is clockwise: the left wheels are faster
            self.robot.drive((speed + difference) / self.radius, (speed - difference) / self.radius)

    def _count(self, now: float) -> None:
        self.began = now if self.began < 0 else self.began
        if self.log.reports:
            self.log.missed += max(0, round((now - self.now) / REPORT) - 1)
        self.log.reports, self.now = self.log.reports + 1, now

    def _move(self, pose: Place) -> None:
        log, (x, y, _) = self.log, pose
        log.driven += math.dist(self.pose[:2], pose[:2]) if self.pose else 0.0
        log.cells.add((math.floor(x / CELL), math.floor(y / CELL)))
        if not log.track or self.now >= log.track[-1][0] + 1.0:
            log.track.append((self.now, x, y))
        self.pose = pose

    def _seen(self, place: str) -> tuple[float, float]:
        """Return where in the world a sensor of the camera sees something, which looks ahead."""
        x, y, yaw = self.pose or (0.0, 0.0, 0.0)
        ahead, beside, _ = (float(number) for number in place.split(","))
        cos, sin = math.cos(yaw), math.sin(yaw)
        return x + ahead * cos - beside * sin, y + ahead * sin + beside * cos

    def decide(self, scan: tuple[float, ...], fov: float) -> tuple[float, float]:
        """Return speed [m/s] and turning rate, clockwise [rad/s], for a scan, from right to left [m]."""
        if self.now >= self.backs_until and self._is_stuck():
            self.log.stuck += 1
            self.backs_until, self.there_since = self.now + BACK_OFF, self.now + BACK_OFF
        if self.now < self.backs_until:
            return BACK, TURN * (0.5 if self.log.stuck % 2 else -0.5)
        angles = [fov / 2 - i * fov / (len(scan) - 1) for i in range(len(scan))]
        points = [
            (r * math.cos(a) + self.scanner, r * math.sin(a)) for r, a in zip(scan, angles, strict=True)
        ]
        lane = self.width / 2 + MARGIN
        ahead = min((x for x, y in points if abs(y) < lane and x > 0), default=9.0) - self.length / 2
        if ahead > (GO_AT if self.turning else STOP_AT):
            self.turning = 0
            balance = sum(math.copysign(min(r, 2.0), a) for r, a in zip(scan, angles, strict=True)) / len(
                scan
            )
            return CRUISE, max(-TURN, min(TURN, balance)) / 2  # towards the side with more room
        if not self.turning:
            self.turns_since = self.now
            self.turning = 1 if sum(min(r, 4.0) * a for r, a in zip(scan, angles, strict=True)) > 0 else -1
        return 0.0, TURN * self.turning

    def _is_stuck(self) -> bool:
        """Return whether it has neither moved nor turned for some time, or turned in vain."""
        x, y, yaw = self.pose or (math.nan,) * 3
        turned = abs(math.remainder(yaw - self.anchor[2], math.tau))
        if not (math.dist((x, y), self.anchor[:2]) < GETTING_ON and turned < TURNING_ON):
            self.anchor, self.there_since = (x, y, yaw), self.now
        is_lost = bool(self.turning) and self.now - self.turns_since > LOST_AFTER
        self.turns_since = self.now if is_lost else self.turns_since
        return is_lost or self.now - self.there_since > STUCK_AFTER


def victims_of(logs: list[Log]) -> list[tuple[float, float]]:
    """Return where victims are, of all parts that have been seen."""
    found: list[list[tuple[float, float]]] = []
    for part in (part for log in logs for part in log.victims):
        near = next((parts for parts in found if math.dist(parts[0], part) < SAME), None)
        found.append([part]) if near is None else near.append(part)
    middles = [(sum(x for x, _ in p) / len(p), sum(y for _, y in p) / len(p)) for p in found if len(p) > 1]
    return sorted(middles)


def explore(port: int, seconds: float, team: tuple[str, ...] = TEAM, host: str = "127.0.0.1") -> list[Log]:
    """Let a team explore for so many simulated seconds; return what each has done.

    Raises:
        RuntimeError: One of them could not go on to the end; says who and why.
    """
    explorers: list[Explorer] = []
    problems: list[str] = []
    robots = [UsarsimClient(host, port, timeout=120.0) for _ in team]
    try:
        for number, (robot, kind) in enumerate(zip(robots, team, strict=True), 1):
            explorers.append(Explorer(robot, kind, f"{kind}_{number}"))

        def run(explorer: Explorer) -> None:
            try:
                explorer.run(seconds)
            except OSError as error:
                problems.append(f"{explorer.log.name}: {error}")

        threads = [threading.Thread(target=run, args=(explorer,)) for explorer in explorers]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        for robot in robots:
            robot.close()
    if problems:
        raise RuntimeError("; ".join(problems))
    return [explorer.log for explorer in explorers]


def account(logs: list[Log], seconds: float, real: float) -> str:
    """Return what the team has done, as a table."""
    lines = ["robot         driven  cells  stuck  reports  missed"]
    for log in logs:
        counts = f"{len(log.cells):6} {log.stuck:6} {log.reports:8} {log.missed:7}"
        lines.append(f"{log.name:10} {log.driven:7.1f} m {counts}")
    cells = len(set().union(*(log.cells for log in logs))) * CELL**2
    places = ", ".join(f"({x:.1f}, {y:.1f})" for x, y in victims_of(logs)) or "none"
    lines.append(f"{cells:.0f} m2 of the floor; victims at {places}")
    lines.append(f"{seconds:.0f} simulated s in {real:.0f} s")
    return "\n".join(lines)


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="Robots search the yellow arena.")
    parser.add_argument("--port", type=int, help="of a server that runs; else one of its own")
    parser.add_argument("--seconds", type=float, default=300.0, help="simulated time to search")
    parser.add_argument("--robots", type=int, default=len(TEAM), choices=range(1, len(TEAM) + 1))
    parser.add_argument("--record", type=Path, help="keep it in this file, .mcap")
    parser.add_argument("--json", type=Path, help="write what each has done to this file")
    options = parser.parse_args()
    record = ("--record", str(options.record)) if options.record else ()
    seats = ("--seats", str(options.robots), "--roster", "", "--realtime-factor", "0")
    own = served("--arena", "yellow", "--ini", str(RESCUE), *seats, *record)
    try:
        with nullcontext(options.port) if options.port else own as port:
            began = time.monotonic()
            logs = explore(port, options.seconds, TEAM[: options.robots])
            print(account(logs, options.seconds, time.monotonic() - began))
    except (OSError, RuntimeError) as error:
        print(f"mission: {error}", file=sys.stderr)
        return 1
    if options.json:
        record = [asdict(log) | {"cells": sorted(log.cells)} for log in logs]
        options.json.write_text(json.dumps(record), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
