"""Attackers: connections that never block, in one loop, with bounds on what they send."""

import contextlib
import socket
import struct
import time
from dataclasses import dataclass

from usarmjx.bench.chaos.attacks import Attack

CONNECT_LIMIT = 0.5
"""How long a connection may take [s]: a server that is held up does not keep the attackers waiting."""
READ_SIZE = 1 << 16
"""Most bytes taken or sent at once by one of them."""
TURN = 0.002
"""They act so often [s]."""
PAUSE = 0.05
"""Who could not connect or was hung up on comes again after so long [s]."""
BREAK_OFF = struct.pack("ii", 1, 0)
"""For SO_LINGER: closing resets the connection."""


@dataclass
class Damage:
    """What attackers did and had done to them.

    Attributes:
        sent: What they sent [bytes].
        connections: How often they connected.
        refused: How often they could not.
        hung_up: How often the server closed their connection.
    """

    sent: int = 0
    connections: int = 0
    refused: int = 0
    hung_up: int = 0


class Attacker:
    """One of them.

    Args:
        attack: What it does.
        address: Host and port.
        volume: Most that it sends [bytes].
        damage: Where it adds what it did.
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
            self.leave(now + PAUSE)
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
            self._back = now + PAUSE
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
        attack: How.
        address: Host and port.
        attackers: How many at once.
        seconds: For how long [s].
        volume: Most that each of them sends [bytes].

    Returns:
        What they did; they have left.
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
