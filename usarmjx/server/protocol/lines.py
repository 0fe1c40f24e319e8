"""Bytes in any chunking -> lines of text."""

import re

from usarmjx.base.errors import PeerError

# The longest line that a known client can send is a few hundred bytes, and the largest line buffer
# seen in one (Player's drivers) is 4096 bytes. Twice that leaves room and stays a small allocation.
DEFAULT_LIMIT = 8192

# Controllers end lines with CR LF, LF CR, LF or CR. Any run of them is one end, which also drops
# blank lines.
_END = re.compile(rb"[\r\n]+")
# The first line of any HTTP request, whatever its method, and what follows first in those of browsers.
_HTTP = re.compile(r"[a-z-]+ +[^ {}]+ +HTTP/[0-9]|Host:", re.IGNORECASE)


class HttpRequestError(PeerError):
    """A peer speaks HTTP: it may be a browser in which somebody else's page sends our commands."""


def refuse_http(line: str) -> None:
    """Do nothing unless a line is of an HTTP request.

    Raises:
        HttpRequestError: It is; hang up before anything that follows is carried out.
    """
    if _HTTP.match(line):
        raise HttpRequestError("it speaks HTTP, and this port is not for browsers")


class LineBuffer:
    """Collects bytes until a line is complete; holds at most `limit` of them.

    A line over the limit is counted and skipped up to its end instead of ending the connection:
    the original servers ignore what they cannot use and stay connected, and a skipped line costs
    no memory however long it is. Bytes are read as latin-1, in which every byte is a character.

    Args:
        limit: Longest line accepted, its end not counted [bytes].
    """

    def __init__(self, limit: int = DEFAULT_LIMIT) -> None:
        self.limit = limit
        self._pending = bytearray()
        self._skipping = False
        self._too_long = 0

    def feed(self, data: bytes) -> list[str]:
        """Return the lines that `data` completes, without their ends; blank ones are left out.

        Raises:
            HttpRequestError: One of them is of an HTTP request; none of them counts.
        """
        *complete, rest = _END.split(data)
        lines: list[str] = []
        for piece in complete:
            self._append(piece)
            lines.extend(self.end())
        for line in lines:
            refuse_http(line)
        self._append(rest)
        return lines

    def end(self) -> list[str]:
        """End the line at hand, for a peer that sends no line end before it closes.

        Returns:
            The line, or nothing if it is blank or was skipped.
        """
        text = "" if self._skipping else self._pending.decode("latin-1")
        self._pending.clear()
        self._skipping = False
        return [text] if text.strip() else []

    def take_too_long(self) -> int:
        """Return how many over-long lines began to be skipped since the last call."""
        count, self._too_long = self._too_long, 0
        return count

    def _append(self, piece: bytes) -> None:
        if self._skipping:
            return
        if len(self._pending) + len(piece) > self.limit:
            self._pending.clear()
            self._skipping = True
            self._too_long += 1
        else:
            self._pending += piece
