"""What clients send in fragments, put together: those of one message share an id, and come in any order."""

from dataclasses import dataclass, field

from usarmjx.base.errors import UsageError
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.rosbridge.definitions import RosMessage

MAX_UNFINISHED = 16
"""Most messages of one client of which fragments are missing; the oldest goes for a new one."""
MAX_LENGTH = 256 * 1024
"""Longest message that is put together [characters]."""
MAX_FRAGMENTS = 4096
"""Most fragments that a message may have."""


@dataclass
class UnfinishedMessage:
    """A message of which fragments are missing.

    Attributes:
        total: How many fragments it has.
        parts: Those that have come, by number.
        length: Of all of them [characters].
    """

    total: int
    parts: dict[int, str] = field(default_factory=dict[int, str])
    length: int = 0


class Defragmenter:
    """Puts the messages of one client together."""

    def __init__(self) -> None:
        self._unfinished: dict[str, UnfinishedMessage] = {}

    def add(self, said: RosMessage) -> str | None:
        """Take a fragment; return the whole message if it was the last one that was missing.

        Raises:
            UsageError: It is none, or the message becomes too long; its other fragments are forgotten.
        """
        name, data, number, total = _checked(said)
        one = self._of(name, total)
        one.length += len(data) - len(one.parts.get(number, ""))
        one.parts[number] = data
        if one.length > MAX_LENGTH:
            del self._unfinished[name]
            raise UsageError(f"{clip(name)} is longer than {MAX_LENGTH} characters")
        if len(one.parts) < total:
            return None
        del self._unfinished[name]
        return "".join(one.parts[number] for number in range(total))

    def _of(self, name: str, total: int) -> UnfinishedMessage:
        one = self._unfinished.get(name)
        if one is None or one.total != total:
            self._unfinished.pop(name, None)
            while len(self._unfinished) >= MAX_UNFINISHED:
                self._unfinished.pop(next(iter(self._unfinished)))
            one = self._unfinished[name] = UnfinishedMessage(total)
        return one


def _checked(said: RosMessage) -> tuple[str, str, int, int]:
    """Return id, data, number and count of a fragment.

    Raises:
        UsageError: They are not what they should be.
    """
    name, data, number, total = (said.get(key) for key in ("id", "data", "num", "total"))
    if not (isinstance(name, str) and isinstance(data, str)):
        raise UsageError("a fragment has id and data, texts")
    if type(number) is not int or type(total) is not int or not 0 <= number < total <= MAX_FRAGMENTS:
        raise UsageError(f"a fragment has total, from 1 to {MAX_FRAGMENTS}, and num, from 0 to total - 1")
    return name, data, number, total
