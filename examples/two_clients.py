"""Two clients share a world: each has a robot, and hears the other's come and go by its sonars.

    python examples/two_clients.py --record meeting.mcap
    usarmjx view meeting.mcap

Ann stands, Bob drives up to her until his sonars hear her close before him; then she comes after him while he
backs off. Nobody tells either where the other is. The world is a server of its own, as fast as it can be, or
the one at `--port`. Axes are the server's: x forward, y right.
"""

import argparse
import math
import sys
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path

from own_server import served

try:
    from usarmjx.client import UsarsimClient
except ImportError:  # in a clone that is not installed
    from usarsim_client import UsarsimClient

APART = 3.0  # m between the two at first
CLOSE, FAR = 0.8, 1.6  # m: here Bob stops, there Ann does
SPEED = 30.0  # percent of the top speed
AHEAD = ("F3", "F4", "F5", "F6")  # the sonars of a P2AT that look ahead


@dataclass
class Visitor:
    """A client and what its robot has reported last.

    Attributes:
        robot: The connection.
        ahead: What its sonars hear ahead [m].
        place: Where it really is: x, y [m]; only the log of the meeting has it.
        time: When [s].
        reports: Times of its status reports [s].
    """

    robot: UsarsimClient
    ahead: float = math.inf
    place: tuple[float, float] = (math.nan, math.nan)
    time: float = 0.0
    reports: list[float] = field(default_factory=list)

    def look(self) -> None:
        """Take messages up to the end of the next report."""
        for message in self.robot:
            kind = message.value("Type") if message.kind == "SEN" else message.kind
            if kind == "STA":
                self.time = message.time() or self.time
                self.reports.append(self.time)
            elif kind == "Sonar":
                self.ahead = min(message.ranges()[name] for name in AHEAD)
            elif kind == "GroundTruth":
                self.place = message.pose()[:2]
            elif kind == "MISSTA":  # ends a report
                return
        raise ConnectionError("the robot does not report any more")

    def drive(self, percent: float) -> None:
        """Drive straight on, or back [percent]."""
        self.robot.drive(percent, percent, normalized=True)


def meet(port: int, host: str = "127.0.0.1") -> list[tuple[float, ...]]:
    """Let the two meet; return per report of Bob's: time [s], distance [m], what Ann and Bob hear [m]."""
    with UsarsimClient(host, port, timeout=60.0) as first, UsarsimClient(host, port, timeout=60.0) as second:
        _, (x, y, z), _ = first.start_poses()[0]
        first.init("USARBot.P2AT", "Ann", (x, y, z), (0.0, 0.0, math.pi))
        second.init("USARBot.P2AT", "Bob", (x - APART, y, z))
        ann, bob = Visitor(first), Visitor(second)
        log: list[tuple[float, ...]] = []

        def until(enough: float, *, nearer: bool) -> None:
            while (bob.ahead > enough) if nearer else (bob.ahead < enough):
                for visitor in (ann, bob):
                    visitor.look()
                log.append((bob.time, math.dist(ann.place, bob.place), ann.ahead, bob.ahead))

        bob.look()
        bob.drive(SPEED)
        until(CLOSE, nearer=True)
        print(f"{bob.time:6.2f} s  Bob hears her {bob.ahead:.2f} m before him; Ann hears {ann.ahead:.2f} m")
        bob.drive(-SPEED)
        ann.drive(SPEED / 2)
        until(FAR, nearer=False)
        print(f"{bob.time:6.2f} s  he is off, and hears her {bob.ahead:.2f} m away")
        for visitor in (ann, bob):
            visitor.drive(0.0)
        return log


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="Two clients share a world.")
    parser.add_argument("--port", type=int, help="of a server that runs; else one of its own")
    parser.add_argument("--record", type=Path, help="keep it in this file, .mcap")
    options = parser.parse_args()
    record = ("--record", str(options.record)) if options.record else ()
    own = served("--arena", "field", "--seats", "2", "--realtime-factor", "0", *record)
    try:
        with nullcontext(options.port) if options.port else own as port:
            meet(port)
    except (OSError, RuntimeError) as error:
        print(f"two_clients: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
