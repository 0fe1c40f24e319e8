"""Wander through an arena by sonar, without touching a wall.

    python -m usarmjx serve --arena yellow &
    python examples/wander.py --port 3000 --seconds 20 --json log.json

Everything here works through `usarsim_client.py`, as any controller does. Times are the server's, so
that it does the same at any speed of the simulation. Axes are the server's too: x forward, y right,
yaw clockwise.
"""

import argparse
import json
import math
import sys
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

from usarsim_client import Message, UsarsimClient

START = (4.5, 1.9, 1.8)  # the manual's place for DM-USAR_yellow (Table 2)

# The P2AT (its GETGEO and GETCONF say the same).
WHEEL_RADIUS = 0.13  # m
MAX_SPIN = 5.385  # rad/s
HALF_LENGTH, HALF_WIDTH = 0.262, 0.249  # m

CRUISE = 0.40  # m/s
TURN = 1.2  # m/s between left and right wheels when turning in place
MARGIN = 0.13  # m beside the hull that must be free ahead
MARGIN_OF_MEMORY = 0.03  # m, likewise, but of echoes heard before
STOP_AT = 0.35  # m free ahead: below this, turn in place ...
GO_AT = 0.70  # m ... until this much is free
SLOW_AT = 1.2  # m free ahead: below this, slow down
KEEP_OFF = 0.45  # m beside the hull: closer than this pushes the robot to the other side
STEER = 1.4  # m/s between the wheels per metre of that

FAR = 9.0  # m: nothing there
NEAR, REMEMBER = 1.0, 8.0  # m and s: which echoes are remembered, and how long

Point = tuple[float, float]  # on the robot [m]
Place = tuple[float, float, float]  # x [m], y [m], yaw [rad] of a sonar on the robot


def mounts(geo: Message) -> dict[str, Place]:
    """Return where each sonar of a GEO message is."""
    places = {}
    for name, item in geo.items().items():
        x, y, _ = (float(n) for n in item["Location"].split(","))
        places[name] = (x, y, float(item["Orientation"].split(",")[2]))
    return places


def echoes(ranges: dict[str, float], sonars: dict[str, Place]) -> list[Point]:
    """Return the points that the sonars' axes hit, on the robot [m]."""
    points = []
    for name, distance in ranges.items():
        x, y, yaw = sonars[name]
        points.append((x + distance * math.cos(yaw), y + distance * math.sin(yaw)))
    return points


def clearance(points: list[Point]) -> float:
    """Return the distance from the hull to the nearest point [m]."""
    gaps = [(max(abs(x) - HALF_LENGTH, 0.0), max(abs(y) - HALF_WIDTH, 0.0)) for x, y in points]
    return min(math.hypot(*gap) for gap in gaps)


class Memory:
    """Near echoes of the last seconds, where odometry says they are.

    A sonar no longer hears a low block once it is close; what was heard on the way there must do.
    """

    def __init__(self):
        self.points: deque = deque()  # (time, x, y) in the frame of the odometry

    def add(self, now: float, pose: Place, points: list[Point]) -> None:
        """Remember those of the points on the robot that lie near and in front; forget old ones."""
        x, y, yaw = pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        for px, py in points:
            if HALF_LENGTH < px and math.hypot(px, py) < NEAR:
                self.points.append((now, x + px * cos - py * sin, y + px * sin + py * cos))
        while self.points and self.points[0][0] < now - REMEMBER:
            self.points.popleft()

    def around(self, pose: Place) -> list[Point]:
        """Return the remembered points on the robot at its present pose."""
        x, y, yaw = pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        offsets = [(px - x, py - y) for _, px, py in self.points]
        return [(dx * cos + dy * sin, dy * cos - dx * sin) for dx, dy in offsets]


def steer(points: list[Point], remembered: list[Point] = (), turning: int = 0) -> tuple[float, float, int]:
    """Decide how to drive from the points that the sonars have hit.

    Args:
        points: x and y of each on the robot [m].
        turning: What the last decision returned: -1 turning left in place, 1 right, 0 driving.

    Returns:
        Left and right wheel speed [rad/s], and whether it turns in place now.
    """
    ahead = min(room_ahead(points, MARGIN), room_ahead(remembered, MARGIN_OF_MEMORY))
    if ahead < (GO_AT if turning else STOP_AT):
        turning = turning or freer_side(points)
        speed, difference = 0.0, TURN * turning
    else:
        turning = 0
        speed = CRUISE * min(1.0, max(0.25, (ahead - STOP_AT) / (SLOW_AT - STOP_AT)))
        left, right = room_beside(points, -1), room_beside(points, 1)
        difference = STEER * (min(right, KEEP_OFF) - min(left, KEEP_OFF))
    spins = ((speed + half) / WHEEL_RADIUS for half in (difference / 2, -difference / 2))
    left_spin, right_spin = (max(-MAX_SPIN, min(MAX_SPIN, spin)) for spin in spins)
    return left_spin, right_spin, turning


def room_ahead(points: list[Point], margin: float) -> float:
    """Return how far the robot can drive straight on with a margin on both sides [m]."""
    lane = HALF_WIDTH + margin
    return min([x for x, y in points if abs(y) < lane and x > 0], default=FAR) - HALF_LENGTH


def room_beside(points: list[Point], side: int) -> float:
    """Return the room beside the hull and a little before it [m]; side -1 is left, 1 right."""
    beside = [side * y for x, y in points if side * y > 0 and -0.3 < x < 0.6]
    return max(0.0, min(beside, default=FAR) - HALF_WIDTH)


def freer_side(points: list[Point]) -> int:
    """Return -1 when there is more room in front on the left, else 1."""
    balance = sum(max(-2.0, min(2.0, y)) for x, y in points if x > 0)
    return -1 if balance < 0 else 1
