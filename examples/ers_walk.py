"""Make an ERS, Sony's AIBO, walk a metre: a trot, sent joint by joint with MULTIDRIVE.

    python -m usarmjx serve --arena yellow &
    python examples/ers_walk.py --port 3000 --distance 1.0

The legs follow a clock, whatever the ground does; only the course is corrected, back to the line on which
it began. The clock is the server's, guessed between its reports. At real time a command goes out every
0.02 s and the robot walks 0.14 m/s. When fewer commands get through, on a busy machine or because the
simulation runs many times faster, it walks more slowly: legs that skipped a part of their way would throw
it off its course, or over. Axes are the server's too: x forward, y right, yaw clockwise.
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
SWING = 0.2  # rad that a leg swings to either side of where it stands
LIFT = 0.3  # rad that the knee bends to lift the paw, some 1 cm
SPREAD = 0.2  # rad that the legs stand outward
STEER = 4.0  # what share of their steps the legs of one side lose, per radian off the heading
RETURN = 2.0  # rad towards the line per metre off it
SLANT = 0.4  # rad: the most of that
LEGS = {"LeftF": 0.0, "RightR": 0.0, "RightF": 0.5, "LeftR": 0.5}  # when in the period each touches down

TICK = 0.02  # s between two commands: the server's control step
LEAP = 3 * TICK  # the farthest that the legs go on in one command, however late it is
REPORT = 0.2  # s between two reports (msg_timer)
REPORTS = 6  # so many tell how fast the server's time goes: on a busy machine one comes late, the next soon
PATIENCE = 0.002  # s of real time to wait for a message before it is time to look at the clock
ROCKING = 0.2  # rad of roll or pitch from which it takes shorter steps, until it has calmed down
FALLEN = 0.8  # rad of roll or pitch from which no trot recovers


def posture(phase: float, strength: float = 1.0, steer: float = 0.0) -> dict[str, float]:
    """Return the positions of all leg joints [rad].

    Args:
        phase: Periods since the start.
        strength: Scales the steps; 0 stands.
        steer: Positive makes the steps of the right legs shorter, which turns to the right; at 1 they
            make none. None gets longer: long steps rock the robot until it falls.
    """
    joints = {}
    for leg, shift in LEGS.items():
        at = (phase + shift) % 1
        less = max(0.0, steer if leg.startswith("Right") else -steer)
        reach = SWING * strength * (1 - less)
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
    """The server's time, also between its reports: as fast as it went in the last few.

    Attributes:
        now: The best guess; it never goes back, and waits when a report is late [s].
        rate: Simulated seconds per second; 0 until two reports have come.
    """

    now: float = -1.0
    rate: float = 0.0
    reports: list[tuple[float, float]] = field(default_factory=list)  # server's and real time of the last

    def hear(self, stamp: float, real: float) -> None:
        """Take in the time of a report that came at the time `real`."""
        self.reports = [*self.reports, (stamp, real)][-REPORTS:]
        began, then = self.reports[0]
        if real > then:
            self.rate = (stamp - began) / (real - then)
        self.now = max(self.now, stamp)

    def look(self, real: float) -> float:
        """Return the server's time at the time `real`."""
        if self.reports:
            stamp, then = self.reports[-1]
            self.now = max(self.now, stamp + min(self.rate * (real - then), REPORT))
        return self.now


@dataclass
class Walk:
    """How it went.

    Attributes:
        path: Time [s] and true x, y [m], yaw [rad] of each report.
        tilt: Roll or pitch in the last report, the larger one [rad].
        lean: Largest of these so far [rad].
    """

    path: list[tuple[float, float, float, float]] = field(default_factory=list)
    tilt: float = 0.0
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
        """What turns it back to the line of the start, from -1 to 1."""
        (_, x0, y0, course), (_, x1, y1, yaw) = self.path[0], self.path[-1]
        right = (y1 - y0) * math.cos(course) - (x1 - x0) * math.sin(course)
        heading = course - max(-SLANT, min(SLANT, RETURN * right))
        return max(-1.0, min(1.0, STEER * math.remainder(heading - yaw, 2 * math.pi)))

    def take(self, now: float, truth: ServerMessage) -> None:
        """Note a GroundTruth message."""
        roll, pitch, _ = (math.remainder(angle, 2 * math.pi) for angle in truth.vector("Orientation"))
        self.tilt = max(abs(roll), abs(pitch))
        self.lean = max(self.lean, self.tilt)
        self.path.append((now, *truth.pose()))

    def done(self, distance: float, seconds: float) -> bool:
        """Whether it has arrived, the time is up, or it has fallen."""
        return bool(self.path) and (
            self.distance >= distance or self.seconds >= seconds or self.lean > FALLEN
        )


def walk(robot: UsarsimClient, distance: float, seconds: float) -> Walk:
    """Walk so far [m], or for so long [simulated s], and stand again."""
    clock, trip, phase, strength = Clock(), Walk(), 0.0, 0.0
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
            step = min(clock.now - told, LEAP) / PERIOD
            told = clock.now
            phase += step
            strength = max(0.0, min(1.0, strength + (step if trip.tilt < ROCKING else -step)))
            robot.multidrive(posture(phase, strength, trip.steer))
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
