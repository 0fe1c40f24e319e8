"""Make an ERS, Sony's AIBO, walk a metre: a trot, sent joint by joint with MULTIDRIVE.

    python -m usarmjx serve --arena yellow &
    python examples/ers_walk.py --port 3000 --distance 1.0

The legs follow a clock, whatever the ground does; only the heading is corrected. The clock is the
server's, guessed between its reports. At real time a command goes out every 0.02 s and the robot walks
0.14 m/s; the faster the simulation runs, the fewer commands get through, and beyond some ten times real
time it may stumble. Axes are the server's too: x forward, y right, yaw clockwise.
"""

import argparse
import math
import sys
import time
from dataclasses import dataclass, field

try:
    from usarmjx.client import ServerMessage, UsarsimClient
except ImportError:  # without usarmjx: its usarsim_client.py lies beside this file
    from usarsim_client import ServerMessage, UsarsimClient

PERIOD = 0.45  # s for a step of each leg
STANCE = 0.6  # share of it that a paw is on the ground: diagonal pairs take turns, with some overlap
SWING = 0.18  # rad that a leg swings to either side of where it stands
LIFT = 0.3  # rad that the knee bends to lift the paw, some 1 cm
SPREAD = 0.2  # rad that the legs stand outward
STEER = 4.0  # by how much longer the steps of one side are, per radian off the course
LEGS = {"LeftF": 0.0, "RightR": 0.0, "RightF": 0.5, "LeftR": 0.5}  # when in the period each touches down

TICK = 0.02  # s between two commands: the server's control step
REPORT = 0.2  # s between two reports (msg_timer)
PATIENCE = 0.002  # s of real time to wait for a message before it is time to look at the clock
FALLEN = 0.8  # rad of roll or pitch from which no trot recovers


def posture(phase: float, strength: float = 1.0, steer: float = 0.0) -> dict[str, float]:
    """Return the positions of all leg joints [rad].

    Args:
        phase: Periods since the start.
        strength: Scales the steps; 0 stands.
        steer: Positive makes the steps of the left legs longer, which turns to the right; up to 0.8.
    """
    joints = {}
    for leg, shift in LEGS.items():
        at = (phase + shift) % 1
        reach = SWING * strength * (1 + steer * (1 if leg.startswith("Left") else -1))
        if at < STANCE:
            swing, bend = reach * (1 - 2 * at / STANCE), 0.0
        else:
            way = math.pi * (at - STANCE) / (1 - STANCE)
            swing, bend = -reach * math.cos(way), LIFT * strength * math.sin(way)
        # A bent knee takes the front paws forward and the rear paws backward: the shoulder takes that back.
        away = 1 if leg.endswith("F") else -1
        joints[f"{leg}Rotator"] = swing - away * bend / 2
        joints[f"{leg}Elevator"] = SPREAD * min(1.0, strength)
        joints[f"{leg}Knee"] = bend
    return joints


@dataclass
class Clock:
    """The server's time, also between its reports: as fast as it went between the last two.

    Attributes:
        now: The best guess; it never goes back, and waits when a report is late [s].
        rate: Simulated seconds per second; 0 until two reports have come.
    """

    now: float = -1.0
    rate: float = 0.0
    report: tuple[float, float] | None = None  # server's time and real time of the last one

    def hear(self, stamp: float, real: float) -> None:
        """Take in the time of a report that came at the time `real`."""
        if self.report is not None and real > self.report[1]:
            self.rate = (stamp - self.report[0]) / (real - self.report[1])
        self.report = (stamp, real)
        self.now = max(self.now, stamp)

    def look(self, real: float) -> float:
        """Return the server's time at the time `real`."""
        if self.report is not None:
            stamp, then = self.report
            self.now = max(self.now, stamp + min(self.rate * (real - then), REPORT))
        return self.now


@dataclass
class Walk:
    """How it went.

    Attributes:
        path: Time [s] and true x, y [m], yaw [rad] of each report.
        lean: Largest roll or pitch so far [rad].
    """

    path: list[tuple[float, float, float, float]] = field(default_factory=list)
    lean: float = 0.0

    @property
    def distance(self) -> float:
        """How far it has come, ahead as it looked at the start [m]."""
        (_, x0, y0, yaw), (_, x1, y1, _) = self.path[0], self.path[-1]
        return (x1 - x0) * math.cos(yaw) + (y1 - y0) * math.sin(yaw)

    @property
    def seconds(self) -> float:
        """For how long it has walked [s]."""
        return self.path[-1][0] - self.path[0][0]

    @property
    def steer(self) -> float:
        """What turns it back to the heading of the start."""
        error = math.remainder(self.path[0][3] - self.path[-1][3], 2 * math.pi)
        return max(-0.8, min(0.8, STEER * error))

    def take(self, now: float, truth: ServerMessage) -> None:
        """Note a GroundTruth message."""
        roll, pitch, _ = (math.remainder(angle, 2 * math.pi) for angle in truth.vector("Orientation"))
        self.lean = max(self.lean, abs(roll), abs(pitch))
        self.path.append((now, *truth.pose()))

    def done(self, distance: float, seconds: float) -> bool:
        """Whether it has arrived, the time is up, or it has fallen."""
        return bool(self.path) and (
            self.distance >= distance or self.seconds >= seconds or self.lean > FALLEN
        )


def walk(robot: UsarsimClient, distance: float, seconds: float) -> Walk:
    """Walk so far [m], or for so long [simulated s], and stand again."""
    clock, trip, began = Clock(), Walk(), -1.0
    heard, told = time.monotonic(), -1.0
    while not trip.done(distance, seconds):
        message = robot.receive(PATIENCE)
        real = time.monotonic()
        if message is not None:
            heard = real
            if message.kind == "STA":
                clock.hear(message.time() or 0.0, real)
            elif message.value("Type") == "GroundTruth":
                trip.take(clock.now, message)
        elif trip.path and clock.rate and clock.look(real) >= told + TICK:
            told = clock.now
            began = told if began < 0.0 else began
            phase = (told - began) / PERIOD
            robot.multidrive(posture(phase, min(1.0, phase), trip.steer))
        if real - heard > robot.timeout:
            raise TimeoutError(f"no data for {robot.timeout:g} s")
    robot.multidrive(posture(0.0, 0.0))
    return trip


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="Make an ERS walk.")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=3000)
    parser.add_argument("--distance", type=float, default=1.0, help="how far to walk [m]")
    parser.add_argument("--seconds", type=float, default=60.0, help="simulated time after which it gives up")
    options = parser.parse_args()
    try:
        with UsarsimClient(options.host, options.port, timeout=60.0) as robot:
            _, place, turn = robot.start_poses()[0]
            robot.init("USARBot.ERS", "Walker", place, turn)
            trip = walk(robot, options.distance, options.seconds)
    except OSError as error:
        print(f"ers_walk: {options.host}:{options.port}: {error}", file=sys.stderr)
        return 1
    print(
        f"walked {trip.distance:.2f} m in {trip.seconds:.1f} s ({trip.distance / trip.seconds:.3f} m/s), "
        f"leaning by {math.degrees(trip.lean):.0f} degrees at most"
    )
    return 0 if trip.distance >= options.distance else 1


if __name__ == "__main__":
    sys.exit(main())
