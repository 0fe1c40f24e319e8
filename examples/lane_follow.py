"""Follow a lane of a route network (RNDF) by GPS, as the cars of the DARPA Urban Challenge did.

    python -m usarmjx serve --arena arda &
    python examples/lane_follow.py --lane 1.1 --speed 6

The car starts where the arena says and knows that; then it counts its wheels' turns (Odometry) and lets the
GPS set that right, `--by truth` steers by GroundTruth instead. GroundTruth is only written down otherwise.
Axes and times are the server's: x north, y east, yaw clockwise; simulated seconds.
"""

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path

import usarmjx
from usarmjx.client import ServerMessage, UsarsimClient
from usarmjx.models.roads import METRES_PER_FOOT, RouteNetwork, read_rndf, to_local_xy

RNDF = Path(usarmjx.__file__).parent / "models" / "arenas" / "ARDA_RNDF.txt"
ORIGIN = (34.587, -117.367)  # of DM-ARDA [degrees]

LOOKAHEAD = 0.5, 3.5  # s and m: how far ahead on the lane is steered for
SIDEWAYS = 1.5  # m/s2 in curves, at most
FORESIGHT = 12.0  # m ahead that curves are slowed down for
ALPHA = 0.08  # share of a GPS position's news that is believed: the best of 0.05 to 0.3 in DM-ARDA
BETA = ALPHA**2 / (2 - ALPHA)  # likewise of its rate: the alpha-beta filter's usual choice

Point = tuple[float, float]
Pose = tuple[float, float, float]  # x, y [m], yaw [rad]


class Way:
    """A way through points [m], which ends where it began if it is closed."""

    def __init__(self, points: list[Point], closed: bool):
        self.points = [*points, points[0]] if closed else points
        self.closed = closed
        self.ends = [0.0]  # how far along each point is [m]
        for a, b in zip(self.points, self.points[1:]):  # noqa: B905
            self.ends.append(self.ends[-1] + math.dist(a, b))

    @property
    def length(self) -> float:
        return self.ends[-1]

    def at(self, along: float) -> Point:
        """Return the place so far along."""
        along = along % self.length if self.closed else min(max(along, 0.0), self.length)
        i = max(1, next((i for i, end in enumerate(self.ends) if end >= along), len(self.ends) - 1))
        share = (along - self.ends[i - 1]) / (self.ends[i] - self.ends[i - 1])
        (x0, y0), (x1, y1) = self.points[i - 1], self.points[i]
        return x0 + share * (x1 - x0), y0 + share * (y1 - y0)

    def nearest(self, place: Point) -> tuple[float, float]:
        """Return how far along the nearest place is, and how far to the right of it the given one [m]."""
        best = (math.inf, 0.0, 0.0)
        for (x0, y0), (x1, y1), start in zip(self.points, self.points[1:], self.ends):  # noqa: B905
            length = math.dist((x0, y0), (x1, y1))
            dx, dy = (x1 - x0) / length, (y1 - y0) / length
            px, py = place[0] - x0, place[1] - y0
            along = min(max(px * dx + py * dy, 0.0), length)
            far = math.dist((px, py), (along * dx, along * dy))
            best = min(best, (far, start + along, math.copysign(far, dx * py - dy * px)))
        return best[1], best[2]

    def bend(self, along: float, ahead: float) -> float:
        """Return how much the way turns on the next metres, per metre [rad/m]."""
        a, b, c, d = (self.at(along + step) for step in (0.0, 1.0, ahead, ahead + 1.0))
        turn = math.atan2(d[1] - c[1], d[0] - c[0]) - math.atan2(b[1] - a[1], b[0] - a[0])
        return abs(math.remainder(turn, math.tau)) / ahead


def lane_path(network: RouteNetwork, segment: int, lane: int, origin: Point = ORIGIN) -> Way:
    """Return the way along a lane; it is closed if its last waypoint leads to its first."""
    found = network.lane(segment, lane)
    metres = [to_local_xy(origin, at) for at in found.waypoints]
    closed = (found.last, (segment, lane, found.first)) in found.exits
    return Way([(x, -y) for x, y in metres], closed)


def pursue(path: Way, pose: Pose, speed: float, top: float, wheel_base: float) -> tuple[float, float]:
    """Decide how to drive: pure pursuit of a point on the way ahead.

    Args:
        path: The way.
        pose: Of the car's middle.
        speed: Of the car [m/s].
        top: Speed where the way is straight [m/s].
        wheel_base: Distance of the axles [m].

    Returns:
        Speed [m/s], and FrontSteer [rad], positive to the left.
    """
    x, y, yaw = pose
    rear = x - wheel_base / 2 * math.cos(yaw), y - wheel_base / 2 * math.sin(yaw)
    along, _ = path.nearest((x, y))
    goal = path.at(along + LOOKAHEAD[0] * speed + LOOKAHEAD[1] - wheel_base / 2)
    off = math.remainder(math.atan2(goal[1] - rear[1], goal[0] - rear[0]) - yaw, math.tau)
    steer = -math.atan(2 * wheel_base * math.sin(off) / math.dist(goal, rear))
    return min(top, math.sqrt(SIDEWAYS / max(path.bend(along, FORESIGHT), 1e-3))), steer


class Reckoner:
    """Where the car is, by its odometry, set right by GPS.

    Args:
        start: Where it starts.
        mount: Where the GPS antenna is on the car, forward and to the right [m].
    """

    def __init__(self, start: Pose, mount: Point):
        self.pose, self.mount = start, mount
        self.last: Pose | None = None
        self.moved = 0.0  # since the last GPS position [m]

    def odometry(self, now: Pose) -> None:
        """Go on by what the wheels have turned since the last time."""
        if self.last is not None:
            dx, dy, before = now[0] - self.last[0], now[1] - self.last[1], self.last[2]
            step = dx * math.cos(before) + dy * math.sin(before)
            x, y, yaw = self.pose
            turn = math.remainder(now[2] - self.last[2], math.tau)
            middle = yaw + turn / 2
            self.pose = x + step * math.cos(middle), y + step * math.sin(middle), yaw + turn
            self.moved += step
        self.last = now

    def gps(self, place: Point) -> None:
        """Believe some of what a GPS position says: of the place, and of the heading while driving."""
        x, y, yaw = self.pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        forward, right = self.mount
        news = (place[0] - x - forward * cos + right * sin, place[1] - y - forward * sin - right * cos)
        sideways = news[1] * cos - news[0] * sin
        if self.moved > 0.2:
            yaw += BETA * sideways / self.moved
        self.pose = x + ALPHA * news[0], y + ALPHA * news[1], yaw
        self.moved = 0.0


def degrees(text: str) -> float:
    """Return the degrees of a GPS message's `34,35.2200,N`."""
    whole, minutes, side = text.split(",")
    return (float(whole) + float(minutes) / 60) * (-1 if side in "SW" else 1)


@dataclass
class MetricsLog:
    """What happened.

    Attributes:
        lane: Length of the lane [m], and its width.
        track: Per report time [s], true x, y [m] and yaw [rad], and the pose that it believed in.
        sideways: Per report how far the car's middle was to the right of the lane's [m].
        satellites: Fewest that the GPS has seen.
    """

    lane: tuple[float, float] = (0.0, 0.0)
    track: list = field(default_factory=list)
    sideways: list = field(default_factory=list)
    satellites: int = 12


class LaneFollower:
    """Takes in messages and drives.

    Args:
        robot: The connection; its robot exists.
        path: The lane.
        start: Where the robot is.
        by: `gps` or `truth`.
    """

    def __init__(self, robot: UsarsimClient, path: Way, start: Pose, by: str):
        self.robot, self.path, self.by = robot, path, by
        self.log = MetricsLog()
        geo, mount = robot.geo("Robot"), robot.geo("GPS").items()
        self.wheel_radius, self.wheel_base = geo.vector("WheelRadius")[0], geo.vector("WheelBase")[0]
        x, y, _ = (float(n) for n in next(iter(mount.values()))["Location"].split(","))
        self.reckoner = Reckoner(start, (x, y))
        self.truth: Pose = start
        self.fix: Point | None = None  # where the GPS of this report is
        self.now = self.began = -1.0
        self.speed = 0.0

    def run(self, seconds: float, top: float) -> MetricsLog:
        """Follow the lane for that many simulated seconds, or once round or to its end, then stop."""
        done, along = 0.0, self.path.nearest(self.truth[:2])[0]
        for message in self.robot:
            if not self.take(message):
                continue
            pose = self.truth if self.by == "truth" else self.reckoner.pose
            self.speed, steer = pursue(self.path, pose, self.speed, top, self.wheel_base)
            self.robot.send("DRIVE", Speed=self.speed / self.wheel_radius, FrontSteer=steer)
            here, off = self.path.nearest(self.truth[:2])
            step = here - along
            if self.path.closed:
                step = math.remainder(step, self.path.length)
            done, along = done + step, here
            self.log.track.append([self.now, self.truth, self.reckoner.pose])
            self.log.sideways.append(off)
            left = self.path.length - done if self.path.closed else self.path.length - along - 2 * self.speed
            if self.now - self.began >= seconds or left <= 0:
                break
        self.robot.send("DRIVE", Speed=0.0, FrontSteer=0.0)
        return self.log

    def take(self, message: ServerMessage) -> bool:
        """Note what a message says; return whether it ends a report."""
        kind = message.value("Type")
        if message.kind == "STA":
            self.now = message.time() or self.now
            self.began = self.now if self.began < 0 else self.began
        elif kind == "Odometry":
            self.reckoner.odometry(message.pose())
        elif kind == "GPS":
            self.log.satellites = min(self.log.satellites, int(message.value("Satellites")))
            if message.value("Fix") == "1":
                at = degrees(message.value("Latitude")), degrees(message.value("Longitude"))
                x, y = to_local_xy(ORIGIN, at)
                self.fix = (x, -y)
        elif kind == "GroundTruth":
            self.truth = message.pose()
            if self.fix:  # only now: the report's odometry came after it
                self.reckoner.gps(self.fix)
                self.fix = None
        return kind == "GroundTruth"


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="Follow a lane of a route network by GPS.")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=3000)
    parser.add_argument("--rndf", type=Path, default=RNDF, help="the route network")
    parser.add_argument("--lane", default="1.1", help="segment and lane")
    parser.add_argument("--start", default="Loop1", help="tag of the start pose; it is on the lane")
    parser.add_argument("--by", choices=("gps", "truth"), default="gps", help="what to steer by")
    parser.add_argument("--speed", type=float, default=6.0, help="on straight road [m/s]")
    parser.add_argument("--seconds", type=float, default=300.0, help="simulated time at most")
    parser.add_argument("--json", type=Path, help="write the log of the drive to this file")
    options = parser.parse_args()
    segment, lane = map(int, options.lane.split("."))
    network = read_rndf(options.rndf)
    path = lane_path(network, segment, lane)
    try:
        with UsarsimClient(options.host, options.port, timeout=60.0) as robot:
            starts = {tag: (place, turn) for tag, place, turn in robot.start_poses()}
            place, turn = starts[options.start]
            robot.init("USARBot.SnowStorm", "Follower", place, turn)
            start = (place[0], place[1], turn[2])
            log = LaneFollower(robot, path, start, options.by).run(options.seconds, options.speed)
    except OSError as error:
        print(f"lane_follow: {options.host}:{options.port}: {error}", file=sys.stderr)
        return 1
    except KeyError:
        known = ", ".join(starts)
        print(f"lane_follow: no start {options.start}; known: {known}", file=sys.stderr)
        return 1
    log.lane = (path.length, (network.lane(segment, lane).width or 12.0) * METRES_PER_FOOT)
    worst = max(map(abs, log.sideways))
    print(
        f"{log.track[-1][0] - log.track[0][0]:.1f} s on lane {options.lane}, {path.length:.0f} m long, by "
        f"{options.by}: at most {worst:.2f} m off its middle, {log.satellites} satellites or more"
    )
    if options.json:
        options.json.write_text(json.dumps(asdict(log)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
