"""Two robots drive apart through the yellow arena, talking by radio until the link drops, and back.

    python -m usarmjx serve --arena yellow --radio-ini examples/radio.ini &
    python examples/radio_drive.py --csv radio.csv --png radio.png

Each sends the other a numbered message every 0.2 s, through the wireless server as the manual has it (manual
3.2.4.3). Once the signal is below the cutoff, the next message is lost and the link closes without a word;
then they ask for a new one every second until there is a signal again. Axes and times are the server's: x
forward, y right, yaw clockwise; simulated seconds.
"""

import argparse
import csv
import importlib
import importlib.util
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path

if importlib.util.find_spec("usarmjx") is None:
    importlib.import_module("usarsim_client")  # which finds usarmjx in this clone

try:
    from usarmjx.client import RadioError, RadioLink, UsarsimClient, WirelessA
except ImportError:  # without usarmjx: its two client files lie beside this file
    from usarsim_client import UsarsimClient
    from usarsim_radio import RadioError, RadioLink, WirelessA

# Centres of the arena's cells, 1.2 m apart. There are three walls between the two ends.
PATHS = {
    "R1": ((3.0, 3.0), (4.2, 3.0), (5.4, 3.0)),
    "R2": ((1.8, 3.0), (0.6, 3.0), (0.6, 1.8), (-0.6, 1.8)),
}
HEIGHT = 1.8  # of the start places; the floor is at 2.08, z down

WHEEL_RADIUS = 0.13  # m, of the P2AT
CRUISE = 0.4  # m/s
TURN = 3.0  # rad/s of the wheels when turning in place, at most
AIM = 0.25  # rad: further off than this, turn in place
NEAR = 0.12  # m: close enough to a place
ASK_AGAIN = 1.0  # s


class Driver:
    """Drives one robot along its path: forward on the way out, backward on the way back.

    Args:
        robot: The connection; its robot exists.
        path: The places.
    """

    def __init__(self, robot: UsarsimClient, path):
        self.robot, self.ahead = robot, list(path)
        self.behind: list = []
        self.time, self.pose = -1.0, (math.nan,) * 3
        self.backward = False

    def look(self) -> None:
        """Take the next report and steer by it."""
        for message in self.robot:
            if message.value("Type") == "GroundTruth":
                self.time, self.pose = message.time() or self.time, message.pose()
                break
        else:
            raise TimeoutError("the robot does not report")
        self.robot.drive(*self.steer())

    def steer(self) -> tuple[float, float]:
        """Return the speed of the left and right wheels [rad/s]; places that are reached are ticked off."""
        x, y, yaw = self.pose
        while self.ahead and math.dist(self.ahead[0], (x, y)) < NEAR:
            self.behind.insert(0, self.ahead.pop(0))
        if not self.ahead:
            return 0.0, 0.0
        dx, dy = self.ahead[0][0] - x, self.ahead[0][1] - y
        off = math.remainder(math.atan2(dy, dx) - yaw + math.pi * self.backward, math.tau)
        if abs(off) > AIM:  # in place; positive is clockwise, the left wheels forward
            spin = max(-TURN, min(TURN, 4.0 * off))
            return spin, -spin
        speed = min(CRUISE, 0.15 + math.hypot(dx, dy)) / WHEEL_RADIUS * (-1 if self.backward else 1)
        return speed + 2.0 * off, speed - 2.0 * off

    def turn_back(self) -> None:
        """Go back the way that it has come."""
        self.ahead, self.behind, self.backward = self.behind[1:], [], True


@dataclass
class Chat:
    """A link between two robots, remade when it has dropped.

    Attributes:
        sent: How many messages each has sent.
        received: How many have arrived, both ways together.
    """

    radio: WirelessA
    names: tuple[str, str]
    links: list[RadioLink] = field(default_factory=list)
    sent: int = 0
    received: int = 0
    next_try: float = -math.inf

    def open(self, now: float) -> bool:
        """Return whether there is a link, after trying to make one if it is time [s]."""
        if self.links or now < self.next_try:
            return bool(self.links)
        self.next_try = now + ASK_AGAIN
        one, other = self.names
        try:
            # Any free port; the server may remember it from an attempt that came to nothing, and says so.
            with self.radio.listen(other) as door:
                self.links = [self.radio.connect(one, other, door.port), door.accept(10.0)]
        except RadioError:
            return False
        return True

    def talk(self) -> None:
        """Count what has come, then send a message each way; forget a link that is closed."""
        for link in self.links:
            while data := link.receive(0.0):
                self.received += data.count(b"\n")
            if data == b"":
                return self.hang_up()
        self.sent += 1
        try:
            for link in self.links:
                link.send(b"message %d\n" % self.sent)
        except ConnectionError:
            self.hang_up()

    def hang_up(self) -> None:
        """Close what is left of the link."""
        for link in self.links:
            link.close()
        self.links = []


def drive(drivers: dict[str, Driver], chat: Chat) -> list[dict[str, float]]:
    """Drive apart and back; return what was measured every 0.2 s."""
    rows = []
    for way in ("out", "back"):
        if way == "back":
            for driver in drivers.values():
                driver.turn_back()
        while any(driver.ahead for driver in drivers.values()):
            for driver in drivers.values():
                driver.look()
            one, other = drivers.values()
            linked = chat.open(one.time)
            if linked:
                chat.talk()
            rows.append(
                {
                    "time": one.time,
                    **{f"{n}_{axis}": d.pose[i] for n, d in drivers.items() for i, axis in enumerate("xy")},
                    "distance": math.dist(one.pose[:2], other.pose[:2]),
                    "strength": chat.radio.strength(*chat.names),
                    "linked": int(linked),
                    "received": chat.received,
                }
            )
            if len(rows) > 1 and rows[-2]["linked"] != linked:
                print(account(rows[-1]), flush=True)
        print(f"{way}: {account(rows[-1])}", flush=True)
    return rows


def account(row: dict[str, float]) -> str:
    """Return one line for the terminal."""
    state = "linked" if row["linked"] else "no link"
    place = f"{row['time']:.1f} s, {row['distance']:.2f} m apart, {row['strength']:.1f} dBm"
    return f"{place}: {state}, {row['received']} messages received"


def plot(rows: list[dict[str, float]], cutoff: float, path: Path) -> bool:
    """Draw the signal over time; return whether that was possible."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return False
    figure = Figure(figsize=(8, 4), layout="constrained")
    axes = figure.add_subplot(xlabel="time [s]", ylabel="power received [dBm]")
    times = [row["time"] - rows[0]["time"] for row in rows]
    powers = [row["strength"] for row in rows]
    axes.plot(times, powers, color="tab:blue", label="signal")
    axes.axhline(cutoff, color="tab:red", linestyle="--", label="cutoff")
    dropped = [not row["linked"] for row in rows]
    span = axes.get_ylim()
    axes.fill_between(times, *span, where=dropped, color="tab:red", alpha=0.15, label="no link")
    axes.set_ylim(span)
    beside = axes.twinx()
    beside.plot(times, [row["distance"] for row in rows], color="tab:gray", linewidth=1)
    beside.set_ylabel("distance [m]", color="tab:gray")
    axes.legend(loc="lower left")
    figure.savefig(path, dpi=120)
    return True


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(
        description="Drive two robots apart until their radio link drops, and back."
    )
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=3000)
    parser.add_argument("--wss-port", type=int, default=5874)
    parser.add_argument("--cutoff", type=float, default=-70.0, help="of the server's ini, for the plot [dBm]")
    parser.add_argument("--csv", type=Path, help="write what was measured to this file")
    parser.add_argument("--png", type=Path, help="draw it, if matplotlib is installed")
    options = parser.parse_args()
    robots: list[UsarsimClient] = []
    try:
        with WirelessA(options.host, options.wss_port, timeout=60.0) as radio:
            drivers = {}
            for name, path in PATHS.items():
                robots.append(UsarsimClient(options.host, options.port, timeout=60.0))
                yaw = math.atan2(path[1][1] - path[0][1], path[1][0] - path[0][0])
                robots[-1].init("USARBot.P2AT", name, (*path[0], HEIGHT), (0.0, 0.0, yaw))
                radio.register(name)
                drivers[name] = Driver(robots[-1], path)
            chat = Chat(radio, ("R1", "R2"))
            rows = drive(drivers, chat)
            chat.hang_up()
    except OSError as error:
        print(f"radio_drive: {options.host}: {error}", file=sys.stderr)
        return 1
    finally:
        for robot in robots:
            robot.close()
    if options.csv:
        with options.csv.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            writer.writerows(rows)
    if options.png and not plot(rows, options.cutoff, options.png):
        print("radio_drive: no picture: matplotlib is not installed", file=sys.stderr)
    links = [row["linked"] for row in rows]
    if not (links[0] and links[-1] and 0 in links):
        print("radio_drive: the link should have dropped and come back", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
