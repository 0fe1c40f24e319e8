"""A running attack: its clock, its sockets, and the loop that most attacks share."""

import contextlib
import random
import select
import socket
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

HOST = "127.0.0.1"
PATIENCE = 0.2  # s, for one wait of a socket
HANDSHAKES = 12.0  # s, for the handshakes of all attackers before the time begins
RESET = struct.pack("ii", 1, 0)  # SO_LINGER: close sends RST
STEP = 1 << 16

Sends = Callable[["Stage", int], bytes]


@dataclass
class Stage:
    """Clock, ports and counters that the attackers of one attack share."""

    ports: dict[str, int]
    until: float
    """End, by `time.monotonic` [s]."""
    sent: int = 0
    connections: int = 0
    answered: int = 0
    """Attackers whose first hello was answered."""
    lock: Any = field(default_factory=threading.Lock)

    @property
    def runs(self) -> bool:
        """Whether the attack goes on."""
        return time.monotonic() < self.until

    def connect(self, kind: str) -> socket.socket:
        """Return a new connection to a port, which closes with the stage at the latest.

        Raises:
            OSError: It did not come about.
        """
        some = {"any": list(self.ports), "hoarded": [one for one in self.ports if one != "robots"]}
        port = self.ports[random.choice(some.get(kind, [kind]))]
        made = socket.create_connection((HOST, port), timeout=2.0)
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        made.setblocking(False)
        with self.lock:
            self.connections += 1
        return made

    def push(self, link: socket.socket, data: bytes, piece: int = STEP) -> None:
        """Send all, as fast as the other side takes it, until the end of the stage.

        Raises:
            OSError: The other side has gone.
        """
        view, at = memoryview(data), 0
        while at < len(view) and self.runs:
            if not select.select([], [link], [], PATIENCE)[1]:
                continue
            count = link.send(view[at : at + piece])
            at += count
            with self.lock:
                self.sent += count

    def drain(self, link: socket.socket, wait: float = 0.0) -> bytes:
        """Return what can be read by now, or within a wait [s].

        Raises:
            OSError: The other side has gone.
        """
        if not select.select([link], [], [], wait)[0]:
            return b""
        data = link.recv(1 << 20)
        if not data:
            raise ConnectionError("closed")
        return data

    def rest(self, seconds: float) -> None:
        """Wait, but not past the end."""
        time.sleep(max(0.0, min(seconds, self.until - time.monotonic())))


@dataclass(frozen=True)
class PortAttack:
    """An attack on one port: connect, say hello, then send again and again.

    An attack of another form has `act`.
    """

    name: str
    port: str
    what: str
    sends: Sends | None = None
    """Data that is sent again and again; None: nothing, the connection is held."""
    hello: Sends | None = None
    """Data that is sent first; the attacker waits for `answer` if that is set."""
    answer: bytes = b""
    reads: bool = True
    pause: float = 0.0
    """Between two sends [s]."""
    piece: int = STEP
    """Most bytes for one call of send."""
    times: int = 0
    """Sends on one connection; 0: until the end."""
    reset: bool = False
    """Whether closing a connection resets it."""
    act: Callable[["Stage", int], None] | None = None
    attackers: int = 0
    """Number of attackers at once; 0: that of the command line."""


def visit(attack: PortAttack, stage: Stage, number: int, link: socket.socket) -> None:
    """Carry out an attack on one connection.

    Raises:
        OSError: The other side has gone.
    """
    if attack.hello is not None:
        stage.push(link, attack.hello(stage, number))
        got = b""
        while attack.answer and stage.runs and attack.answer not in got:
            got += stage.drain(link, PATIENCE)
        with stage.lock:
            stage.answered += 1
    turns = 0
    while stage.runs and not (attack.times and turns >= attack.times):
        turns += 1
        if attack.sends is None:
            stage.rest(PATIENCE)
        else:
            stage.push(link, attack.sends(stage, number), attack.piece)
        if attack.reads:
            stage.drain(link)
        stage.rest(attack.pause)


def attacker(attack: PortAttack, stage: Stage, number: int) -> None:
    """Attack until the end of the stage; open a new connection after each one that ends."""
    while stage.runs:
        if attack.act is not None:
            with contextlib.suppress(OSError):
                attack.act(stage, number)
            stage.rest(0.002)
            continue
        with contextlib.suppress(OSError):
            link = stage.connect(attack.port)
            try:
                visit(attack, stage, number, link)
            finally:
                if attack.reset:
                    link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                link.close()
        stage.rest(0.002)


def play(attack: PortAttack, ports: dict[str, int], seconds: float, attackers: int) -> Stage:
    """Play an attack with several attackers at once, and return its stage.

    If a hello has an answer, the time begins when all have theirs, or when they have waited too long.
    """
    count = attack.attackers or attackers
    stage = Stage(ports, time.monotonic() + (HANDSHAKES if attack.answer else 0.0) + seconds)
    crowd = [
        threading.Thread(target=attacker, args=(attack, stage, number), daemon=True)
        for number in range(count)
    ]
    for one in crowd:
        one.start()
    if attack.answer:
        while stage.answered < count and time.monotonic() < stage.until - seconds:
            time.sleep(0.05)
        stage.until = min(stage.until, time.monotonic() + seconds)
    for one in crowd:
        one.join(seconds + 10.0)
    return stage
