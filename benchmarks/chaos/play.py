"""Attacks one after another, and what a well-behaved neighbour noticed of each."""

import contextlib
import math
import socket
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from benchmarks.chaos.attacks import QUIET, Attack
from benchmarks.chaos.neighbour import Gaps, Watch
from benchmarks.chaos.target import ThreadClock
from usarmjx.base.errors import UsageError
from usarmjx.base.tables import table_lines

CONNECT_LIMIT = 0.5
"""How long a connection may take [s]: a server that is held up does not keep the attackers waiting."""
READ_SIZE = 1 << 16
"""Most bytes taken or sent at once by one of them."""
TURN = 0.002
"""They act so often [s]."""
RECONNECT_PAUSE = 0.05
"""Who could not connect or was hung up on comes again after so long [s]."""
BREAK_OFF = struct.pack("ii", 1, 0)
"""For SO_LINGER: closing resets the connection."""


@dataclass
class Damage:
    """Deeds of attackers and the server's answers.

    Attributes:
        sent: Amount sent [bytes].
        connections: Number of connections made.
        refused: Number of refused connections.
        hung_up: Number of connections that the server closed.
    """

    sent: int = 0
    connections: int = 0
    refused: int = 0
    hung_up: int = 0


class Attacker:
    """One of them.

    Args:
        attack: Its behaviour.
        address: Host and port.
        volume: Most that it sends [bytes].
        damage: Record of its deeds.
    """

    def __init__(self, attack: Attack, address: tuple[str, int], volume: int, damage: Damage) -> None:
        self._attack, self._address, self._damage = attack, address, damage
        self._left = volume
        self._socket: socket.socket | None = None
        self._came = self._back = 0.0
        self._unsent = memoryview(b"")

    def act(self, now: float) -> None:
        """Do what it is time for [s]."""
        if self._socket is None:
            if now >= self._back:
                self._connect(now)
            return
        try:
            self._send()
            if self._attack.reads and not self._read():
                raise ConnectionResetError
        except ConnectionError:
            self._damage.hung_up += 1
            self.leave(now + RECONNECT_PAUSE)
        else:
            if now >= self._came + self._attack.stay:
                self.leave(now)

    def leave(self, back: float = 0.0) -> None:
        """Close the connection, to come again at a time [s]."""
        if self._socket is not None:
            if self._attack.rude:
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, BREAK_OFF)
            self._socket.close()
        self._socket, self._back = None, back

    def _connect(self, now: float) -> None:
        try:
            made = socket.create_connection(self._address, CONNECT_LIMIT)
        except OSError:
            self._damage.refused += 1
            self._back = now + RECONNECT_PAUSE
            return
        made.setblocking(False)
        self._socket, self._came = made, now
        self._unsent = memoryview(self._attack.first)
        self._damage.connections += 1

    def _send(self) -> None:
        assert self._socket is not None
        if not self._unsent and self._left > 0:
            self._unsent = memoryview(self._attack.load)
        if self._unsent:
            with contextlib.suppress(BlockingIOError):
                sent = self._socket.send(self._unsent[:READ_SIZE])
                self._unsent = self._unsent[sent:]
                self._left -= sent
                self._damage.sent += sent

    def _read(self) -> bool:
        """Read what is there; return whether the server still is."""
        assert self._socket is not None
        with contextlib.suppress(BlockingIOError):
            return bool(self._socket.recv(READ_SIZE))
        return True


def carry_out(
    attack: Attack, address: tuple[str, int], attackers: int, seconds: float, volume: int
) -> Damage:
    """Attack.

    Args:
        attack: Its settings.
        address: Host and port.
        attackers: Number at once.
        seconds: For how long [s].
        volume: Most that each of them sends [bytes].

    Returns:
        Their deeds; they have left.
    """
    damage = Damage()
    them = [Attacker(attack, address, volume, damage) for _ in range(attackers)]
    end = time.perf_counter() + seconds
    try:
        while (now := time.perf_counter()) < end:
            for attacker in them:
                attacker.act(now)
            time.sleep(TURN)
    finally:
        for attacker in them:
            attacker.leave()
    return damage


GREETING = b"NFO"
SEATS = 15
"""Most seats that are asked for afterwards: a server has 16, of which the neighbour has one."""
PAUSE = 0.05
"""Who found no seat asks again after so long [s]."""
HEADINGS = ("attack", "gap s", "CPU s", "irregular", "bad lines", "MB", "came", "hung up", "seats")
MEGABYTE = 1e6


@dataclass(frozen=True, kw_only=True)
class ChaosCase:
    """Target and kind of the attack.

    Attributes:
        host: Whose server.
        port: Its Gamebots port.
        page_port: Port of its page; None: that is not attacked.
        rosbridge_port: Port of its rosbridge; None likewise.
        metrics_port: Port of its metrics; None likewise.
        image_port: Port of its pictures; None likewise.
        attacks: Attacks to play.
        attackers: Number at once.
        seconds: For how long each [s].
        volume: Most that one of them sends [bytes].
        settling: Time for which the neighbour is watched after that [s].
        limit: A report or a seat that takes longer than this does not come any more [s].
    """

    host: str
    port: int
    page_port: int | None = None
    rosbridge_port: int | None = None
    metrics_port: int | None = None
    image_port: int | None = None
    attacks: tuple[Attack, ...]
    attackers: int = 15
    seconds: float = 8.0
    volume: int = 4_000_000
    settling: float = 1.0
    limit: float = 120.0

    def port_of(self, attack: Attack) -> int | None:
        """Return the port that an attack goes to; None if there is none."""
        ports = {
            "robots": self.port,
            "page": self.page_port,
            "rosbridge": self.rosbridge_port,
            "metrics": self.metrics_port,
            "pictures": self.image_port,
        }
        return ports[attack.door]


@dataclass(frozen=True)
class Outcome:
    """Outcome of an attack.

    Attributes:
        attack: Its name.
        gaps: Observations of the neighbour; None: it got no reports any more.
        damage: Deeds of the attackers.
        seats: Whether as many as attacked could connect afterwards.
        trouble: Why the neighbour got no reports, or nothing.
    """

    attack: str
    gaps: Gaps | None
    damage: Damage
    seats: bool
    trouble: str = ""

    def as_record(self) -> dict[str, Any]:
        """Return it as a flat mapping for a file; None is what nobody knows."""
        flat = {"attack": self.attack, **asdict(self.damage), "seats": self.seats, "trouble": self.trouble}
        if self.gaps is not None:
            flat |= asdict(self.gaps)
        return {key: None if value != value else value for key, value in flat.items()}  # NaN is no JSON

    def as_row(self) -> list[str]:
        """Return what a table shows of it."""
        noticed = ["-"] * 4
        if self.gaps is not None:
            used = "-" if math.isnan(self.gaps.processor) else f"{self.gaps.processor:.3f}"
            noticed = [f"{self.gaps.gap:.2f}", used, str(self.gaps.irregular), str(self.gaps.bad_lines)]
        done = [f"{self.damage.sent / MEGABYTE:.1f}", str(self.damage.connections), str(self.damage.hung_up)]
        return [self.attack, *noticed, *done, "back" if self.seats else "LOST"]


def play_attacks(
    case: ChaosCase, clock: ThreadClock | None, say: Callable[[str], None] = lambda text: None
) -> list[Outcome]:
    """Play attacks, after a while in which nobody does anything.

    Args:
        case: Which.
        clock: Processor time of the server's thread; None: nobody knows it.
        say: Is told what is being done.

    Raises:
        UsageError: The neighbour gets no report at all.
    """
    attacks = [attack for attack in case.attacks if case.port_of(attack) is not None]
    outcomes: list[Outcome] = []
    with contextlib.ExitStack() as stack:
        watch: Watch | None = None
        for attack in (QUIET, *attacks):
            say(f"{attack.name}: {attack.about} ...")
            if watch is None:  # the first, or after one who was dropped
                watch = stack.enter_context(Watch(case.port, case.host, clock, case.limit))
            outcomes.append(play_attack(case, attack, watch))
            if outcomes[-1].gaps is None:
                stack.close()
                watch = None
    return outcomes


def play_attack(case: ChaosCase, attack: Attack, watch: Watch) -> Outcome:
    """Play one attack beside a neighbour."""
    address = (case.host, case.port_of(attack) or case.port)
    attackers = 0 if attack is QUIET else case.attackers
    damage, trouble, gaps = Damage(), "", None

    def act() -> None:
        nonlocal damage
        damage = carry_out(attack, address, attackers, case.seconds, case.volume)
        time.sleep(case.settling)

    try:
        gaps = watch.during(act)
    except UsageError as error:
        trouble = str(error)
    return Outcome(attack.name, gaps, damage, has_seats(case, min(case.attackers, SEATS)), trouble)


def has_seats(case: ChaosCase, seats: int) -> bool:
    """Return whether so many can connect at once and are greeted, before the limit."""
    end = time.perf_counter() + case.limit
    with contextlib.ExitStack() as stack:
        while seats and time.perf_counter() < end:
            try:
                made = socket.create_connection((case.host, case.port), case.limit)
                made.settimeout(case.limit)
                greeted = made.recv(len(GREETING)) == GREETING
            except OSError:
                greeted = False
            else:
                stack.enter_context(made)
            seats -= greeted
            if not greeted:
                time.sleep(PAUSE)
    return not seats


def table(outcomes: Sequence[Outcome]) -> str:
    """Return the outcomes as a table of Markdown, and below it what went wrong."""
    lines = table_lines(HEADINGS, (outcome.as_row() for outcome in outcomes))
    return "\n".join([*lines, *(f"{one.attack}: {one.trouble}" for one in outcomes if one.trouble)])
