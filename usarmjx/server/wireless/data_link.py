"""Dialect A of the wireless server, a data link: `SEND 5 hello;` in, the bare bytes out (manual 3.2.4.3).

Exactly one byte behind the payload is eaten, whatever it is, and completes the message; a message counts
only when it is complete. SEND and CLOSE are matched with case. Any other five bytes are a word that is
skipped up to the next `;`, as the in-engine server does; line ends between messages are dropped.
"""

from collections.abc import Callable
from enum import Enum

from usarmjx.base.errors import PeerError

MAX_PAYLOAD = 1 << 20
"""Longest payload accepted [bytes]: a camera picture has a tenth of that."""
MAX_LENGTH_DIGITS = 16
WORD_SIZE = 5


class DataLinkPhase(Enum):
    """What the next byte is."""

    WORD = "word"
    LENGTH = "length"
    PAYLOAD = "payload"
    TRAILER = "trailer"
    SKIPPING = "skipping"
    CLOSING = "closing"
    CLOSED = "closed"


WORDS = {b"SEND ": DataLinkPhase.LENGTH, b"CLOSE": DataLinkPhase.CLOSING}
"""What follows a word; SKIPPING follows any other."""
TRANSITIONS: dict[DataLinkPhase, frozenset[DataLinkPhase]] = {
    DataLinkPhase.WORD: frozenset({*WORDS.values(), DataLinkPhase.SKIPPING}),
    DataLinkPhase.LENGTH: frozenset({DataLinkPhase.PAYLOAD, DataLinkPhase.TRAILER, DataLinkPhase.SKIPPING}),
    DataLinkPhase.PAYLOAD: frozenset({DataLinkPhase.TRAILER}),
    DataLinkPhase.TRAILER: frozenset({DataLinkPhase.WORD}),
    DataLinkPhase.SKIPPING: frozenset({DataLinkPhase.WORD}),
    DataLinkPhase.CLOSING: frozenset({DataLinkPhase.CLOSED}),
    DataLinkPhase.CLOSED: frozenset(),
}


class DataLinkParser:
    """One direction of a data link: bytes in any chunking -> messages.

    Args:
        most: Longest payload accepted [bytes].

    Attributes:
        phase: What the next byte is; CLOSED after a CLOSE.
    """

    def __init__(self, most: int = MAX_PAYLOAD) -> None:
        self.phase = DataLinkPhase.WORD
        self._most = most
        self._kept = bytearray()  # of the word, the length or the payload
        self._left = 0
        self._messages: list[bytes] = []
        self._take: dict[DataLinkPhase, Callable[[bytes, int], int]] = {
            DataLinkPhase.WORD: self._word,
            DataLinkPhase.LENGTH: self._length,
            DataLinkPhase.PAYLOAD: self._payload,
            DataLinkPhase.TRAILER: self._trailer,
            DataLinkPhase.SKIPPING: self._skip,
            DataLinkPhase.CLOSING: self._skip,
        }

    def receive_data(self, data: bytes) -> list[bytes]:
        """Return the messages that `data` completes, in order; nothing behind a CLOSE.

        Raises:
            PeerError: A message is announced that is longer than allowed.
        """
        at = 0
        while at < len(data) and self.phase is not DataLinkPhase.CLOSED:
            at = self._take[self.phase](data, at)
        messages, self._messages = self._messages, []
        return messages

    # Each of these takes bytes from `at` on and returns where it stopped.

    def _go(self, phase: DataLinkPhase) -> None:
        assert phase in TRANSITIONS[self.phase]
        self.phase = phase

    def _word(self, data: bytes, at: int) -> int:
        while not self._kept and at < len(data) and data[at] in b"\r\n":
            at += 1
        end = at + WORD_SIZE - len(self._kept)
        self._kept += data[at:end]
        if len(self._kept) == WORD_SIZE:
            self._go(WORDS.get(bytes(self._kept), DataLinkPhase.SKIPPING))
            self._kept.clear()
        return min(end, len(data))

    def _length(self, data: bytes, at: int) -> int:
        byte = data[at : at + 1]
        if byte.isdigit():
            self._kept += byte
            if len(self._kept) > MAX_LENGTH_DIGITS or int(self._kept) > self._most:
                raise PeerError(f"a message of more than {self._most} bytes is announced")
        elif byte == b" " and self._kept:
            self._left = int(self._kept)
            self._kept.clear()
            self._go(DataLinkPhase.PAYLOAD if self._left else DataLinkPhase.TRAILER)
        else:  # no number: not worth guessing where its payload would end
            self._kept.clear()
            self._go(DataLinkPhase.SKIPPING)
            return at
        return at + 1

    def _payload(self, data: bytes, at: int) -> int:
        piece = data[at : at + self._left]
        self._kept += piece
        self._left -= len(piece)
        if not self._left:
            self._go(DataLinkPhase.TRAILER)
        return at + len(piece)

    def _trailer(self, data: bytes, at: int) -> int:
        del data
        self._messages.append(bytes(self._kept))
        self._kept.clear()
        self._go(DataLinkPhase.WORD)
        return at + 1

    def _skip(self, data: bytes, at: int) -> int:
        end = data.find(b";", at)
        if end < 0:
            return len(data)
        self._go(DataLinkPhase.WORD if self.phase is DataLinkPhase.SKIPPING else DataLinkPhase.CLOSED)
        return end + 1
