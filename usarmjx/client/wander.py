"""Wander through an arena by sonar, without touching a wall.

    python -m usarmjx serve --arena yellow &
    python -m usarmjx.client.wander --port 3000 --seconds 20 --json log.json

The program uses only `usarsim_client.py`, as any controller does. Times are the server's, so that it does the
same at any speed of the simulation. Axes are the server's too: x forward, y right, yaw clockwise.
"""

import argparse
import json
import math
import sys
import time
from collections import deque
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

try:
    from usarmjx.client.usarsim_client import ServerMessage, UsarsimClient
except ImportError:  # without usarmjx: a copy of its usarsim_client.py lies beside this file
    from usarsim_client import ServerMessage, UsarsimClient

START = (4.5, 1.9, 1.8)  # the manual's start position for DM-USAR_yellow (Table 2)

# The P2AT (its GETGEO and GETCONF say the same).
WHEEL_RADIUS = 0.13  # m
MAX_SPIN = 5.385  # rad/s
HALF_LENGTH, HALF_WIDTH = 0.262, 0.249  # m

CRUISE, CREEP = 0.45, 0.20  # m/s
TURN = 0.7  # m/s between left and right wheels when turning in place
MARGIN = 0.13  # m beside the hull that must be free ahead
MARGIN_OF_MEMORY = 0.03  # m, likewise, but of echoes heard before
STOP_AT = 0.38  # m free ahead: below this, turn in place ...
GO_AT = 0.70  # m ... until this much is free
SLOW_AT = 1.0  # m free ahead: below this, slow down
KEEP_OFF = 0.45  # m beside the hull: closer than this pushes the robot to the other side
STEER = 0.8  # m/s between the wheels per metre of that

FAR = 9.0  # m: nothing there
NEAR, REMEMBER = 1.0, 8.0  # m and s: which echoes are remembered, and how long

Point = tuple[float, float]
"""Point in the robot's axes [m]."""
Pose2D = tuple[float, float, float]
"""x [m], y [m] and yaw [rad], of a sonar on the robot or of the robot."""


def mounts(geo: ServerMessage) -> dict[str, Pose2D]:
    """Return the pose of each sonar in a GEO message."""
    found: dict[str, Pose2D] = {}
    for name, item in geo.items().items():
        x, y, _ = (float(n) for n in item["Location"].split(","))
        found[name] = (x, y, float(item["Orientation"].split(",")[2]))
    return found


def echoes(ranges: dict[str, float], sonars: dict[str, Pose2D]) -> list[Point]:
    """Return the points that the sonars' axes hit, in the robot's axes [m]."""
    points: list[Point] = []
    for name, distance in ranges.items():
        x, y, yaw = sonars[name]
        points.append((x + distance * math.cos(yaw), y + distance * math.sin(yaw)))
    return points


def clearance(points: list[Point]) -> float:
    """Return the distance from the hull to the nearest echo [m]."""
    gaps = [(max(abs(x) - HALF_LENGTH, 0.0), max(abs(y) - HALF_WIDTH, 0.0)) for x, y in points]
    return min(math.hypot(*gap) for gap in gaps)


class Memory:
    """Near echoes of the last seconds, at their positions by the estimated pose.

    A sonar loses a low block once it is close; the echoes on the way there replace it.
    """

    def __init__(self) -> None:
        self.points: deque[tuple[float, float, float]] = deque()  # (time, x, y) in the frame of the pose

    def add(self, now: float, pose: Pose2D, points: list[Point]) -> None:
        """Remember the points that are near and in front; forget old ones."""
        x, y, yaw = pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        for px, py in points:
            if px > HALF_LENGTH and math.hypot(px, py) < NEAR:
                self.points.append((now, x + px * cos - py * sin, y + px * sin + py * cos))
        while self.points and self.points[0][0] < now - REMEMBER:
            self.points.popleft()

    def around(self, pose: Pose2D) -> list[Point]:
        """Return the remembered points in the robot's axes at its present pose."""
        x, y, yaw = pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        offsets = [(px - x, py - y) for _, px, py in self.points]
        return [(dx * cos + dy * sin, dy * cos - dx * sin) for dx, dy in offsets]


def steer(points: list[Point], remembered: list[Point], turning: int = 0) -> tuple[float, float, int]:
    """Decide on wheel speeds from the points that the sonars have hit.

    Args:
        points: Echoes in the robot's axes [m].
        remembered: Earlier echoes in the robot's axes [m].
        turning: Result of the last decision: -1 turning left in place, 1 right, 0 driving.

    Returns:
        Left and right wheel speed [rad/s], and whether it turns in place now.
    """
    ahead = min(room_ahead(points, MARGIN), room_ahead(remembered, MARGIN_OF_MEMORY))
    if ahead < (GO_AT if turning else STOP_AT):
        # The side is kept until the way is free: by the newest echoes alone the robot would swing to and fro.
        turning = turning or freer_side(points)
        speed, difference = 0.0, TURN * turning
    else:
        turning = 0
        speed = min(CRUISE, max(CREEP, CRUISE * (ahead - STOP_AT) / (SLOW_AT - STOP_AT)))
        left, right = room_beside(points, -1), room_beside(points, 1)
        difference = STEER * (min(right, KEEP_OFF) - min(left, KEEP_OFF))
    spins = ((speed + half) / WHEEL_RADIUS for half in (difference / 2, -difference / 2))
    left_spin, right_spin = (max(-MAX_SPIN, min(MAX_SPIN, spin)) for spin in spins)
    return left_spin, right_spin, turning


def room_ahead(points: list[Point], margin: float) -> float:
    """Return the free distance straight ahead with a margin on both sides [m]."""
    lane = HALF_WIDTH + margin
    return min([x for x, y in points if abs(y) < lane and x > 0], default=FAR) - HALF_LENGTH


def room_beside(points: list[Point], side: int) -> float:
    """Return the room beside the hull and a little before it [m]; side -1 is left, 1 right."""
    beside = [side * y for x, y in points if side * y > 0 and -0.3 < x < 0.6]
    return max(0.0, min(beside, default=FAR) - HALF_WIDTH)


def freer_side(points: list[Point]) -> int:
    """Return -1 when there is more room in front on the left, else 1."""
    balance = sum(max(-4.0, min(4.0, y)) for x, y in points if x > 0)
    return -1 if balance < 0 else 1


@dataclass
class WanderLog:
    """Log of a run, in the server's axes and units.

    Attributes:
        track: Per report time [s], truth, odometry and INS as (x [m], y [m], yaw [rad]).
        scan: Ranges [m] of the last laser scan, its fov [rad], the scanner's pose on the robot,
            and the robot's true pose then (None when the run ended before it came).
        min_clearance: Least distance from hull to echo [m].
        messages: Number of messages of each kind.
    """

    track: list[list[Any]] = field(default_factory=list[list[Any]])
    scan: dict[str, Any] = field(default_factory=dict[str, Any])
    min_clearance: float = math.inf
    messages: dict[str, int] = field(default_factory=dict[str, int])


class Wanderer:
    """Processes messages and drives.

    Args:
        robot: The connection; its robot exists.
    """

    def __init__(self, robot: UsarsimClient) -> None:
        self.robot = robot
        self.log = WanderLog()
        self.memory = Memory()
        self.turning = 0
        self.poses: dict[str, Pose2D] = {}  # the latest of each pose sensor, by its type
        self.sonars = mounts(robot.geo("Sonar"))
        self.scanner = mounts(robot.geo("RangeScanner"))
        self.began = self.now = -1.0

    def run(self, seconds: float) -> WanderLog:
        """Wander for that many simulated seconds, then stop the wheels."""
        shown = 0
        ranges: dict[str, float] = {}
        while self.began < 0 or self.now - self.began < seconds:
            # Decide on the newest data: process all received messages, and wait only without any.
            message = self.robot.receive(0.0 if ranges else self.robot.timeout)
            if message is not None:
                ranges = self.take(message) or ranges
                continue
            if not ranges:
                raise TimeoutError(f"no data for {self.robot.timeout:g} s")
            self.decide(ranges)
            ranges = {}
            if self.now - self.began >= shown:
                print(f"{self.now - self.began:6.1f} s  {self.account()}", flush=True)
                shown += 1
        self.robot.drive(0.0, 0.0)
        return self.log

    def take(self, message: ServerMessage) -> dict[str, float]:
        """Record a message; return the ranges of a sonar message."""
        kind = message.value("Type") if message.kind == "SEN" else message.kind
        self.log.messages[kind] = self.log.messages.get(kind, 0) + 1
        self.now = message.time() or self.now
        if self.began < 0:
            self.began = self.now
        if kind in ("Odometry", "INS", "GroundTruth"):
            self.poses[kind] = message.pose()
        if kind == "RangeScanner":
            at, fov = self.scanner[message.value("Name")], float(message.value("FOV"))
            self.log.scan = {"ranges": message.scan(), "fov": fov, "at": at, "pose": None}
        if kind == "GroundTruth" and len(self.poses) == 3:
            poses = (self.poses[name] for name in ("GroundTruth", "Odometry", "INS"))
            self.log.track.append([self.now, *poses])
            # Ground truth ends a report, so a scan before it is of the same moment.
            if self.log.scan and not self.log.scan["pose"]:
                self.log.scan["pose"] = self.poses["GroundTruth"]
        return message.ranges() if kind == "Sonar" else {}

    def decide(self, ranges: dict[str, float]) -> None:
        """Command the wheels."""
        points = echoes(ranges, self.sonars)
        self.log.min_clearance = min(self.log.min_clearance, clearance(points))
        pose = self.poses.get("INS")
        # INS, not odometry: with skid steering odometry estimates larger turns than the true ones.
        remembered = self.memory.around(pose) if pose else []
        left, right, self.turning = steer(points, remembered, self.turning)
        self.robot.drive(left, right)
        if pose:
            self.memory.add(self.now, pose, points)

    def account(self) -> str:
        """Return the present state as one line for the terminal."""
        x, y, _ = self.poses.get("INS", (math.nan,) * 3)
        doing = {-1: "turning left", 0: "driving", 1: "turning right"}[self.turning]
        return f"INS {x:6.2f} {y:6.2f}  clear by {self.log.min_clearance:.2f} m  {doing}"


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="Wander by sonar without touching a wall.")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=3000)
    parser.add_argument("--seconds", type=float, default=20.0, help="simulated time to wander")
    parser.add_argument("--json", type=Path, help="write the log of the drive to this file")
    options = parser.parse_args()
    try:
        with UsarsimClient(options.host, options.port, timeout=60.0) as robot:
            robot.init("USARBot.P2AT", "Wanderer", START)
            wall = time.monotonic()
            log = Wanderer(robot).run(options.seconds)
            wall = time.monotonic() - wall
            level = robot.greeting.value("Level")
    except OSError as error:
        print(f"wander: {options.host}:{options.port}: {error}", file=sys.stderr)
        return 1
    if options.json:
        record = {"level": level, "real_seconds": wall, **asdict(log)}
        options.json.write_text(json.dumps(record), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
