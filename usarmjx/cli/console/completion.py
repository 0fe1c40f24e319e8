"""Completion of a command that is being typed: heads, keys, values."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from usarmjx.cli.console.knowledge import (
    ASKED_TYPES,
    CLASS_PREFIX,
    KEYS,
    REPEATED_KEYS,
    SENSOR_OPCODES,
    VALUES,
    VIEWPORTS,
    Knowledge,
    heads,
)

BARE_HEADS = ("GETSTARTPOSES",)
"""Commands without keys."""
_SEGMENT = re.compile(r"\{\s*([^\s{}]+)\s*([^{}]*)\}")


@dataclass
class Completer:
    """Completes lines.

    Attributes:
        knowledge: Knowledge of the robot.
        classes: Robot classes, once they are known.
        client: What an image server calls the client of its pictures, for `{Client ...}`.
    """

    knowledge: Knowledge
    classes: Sequence[str] = ()
    client: str = ""
    _heads: list[str] = field(default_factory=heads)

    def complete(self, text: str) -> list[str]:
        """Return the lines that a line may become by its next word, the likeliest first."""
        head, space, rest = text.partition(" ")
        if not space:
            return [found if found in BARE_HEADS else f"{found} " for found in _fitting(self._heads, head)]
        head = head.upper()
        _, brace, inside = rest.rpartition("{")
        if not brace or "}" in inside:
            return [f"{text.rstrip()} {{{key} " for key in self._keys(head, text)]
        start = text[: len(text) - len(inside)]
        key, gap, value = inside.partition(" ")
        if not gap:
            return [f"{start}{found} " for found in _fitting(self._keys(head, text[: len(start) - 1]), key)]
        values = self._values(head, key, text[: len(start) - 1])
        return [f"{start}{key} {found}}}" for found in _fitting(values, value.strip())]

    def _keys(self, head: str, before: str) -> list[str]:
        """Return the keys that may come next, without those that the line has."""
        known = list(self.knowledge.names("Joint")) if head == "MULTIDRIVE" else list(KEYS.get(head, ()))
        had = {key.lower() for key, _ in _SEGMENT.findall(before)} - REPEATED_KEYS.get(head, frozenset())
        if head == "SET":
            known = self._set_keys(before)
        return [key for key in known if key.lower() not in had]

    def _set_keys(self, before: str) -> list[str]:
        kind = _told(before, "Type").lower()
        if kind == "camera":
            return ["Name", "FOV", "Opcode", "Params", "Robot", "Client"]
        if kind == "viewports":
            return ["Config", *VIEWPORTS]
        return ["Name", "Opcode", "Params"] if kind else list(KEYS["SET"])

    def _values(self, head: str, key: str, before: str) -> list[str]:
        known, name = self.knowledge, key.lower()
        if name in VALUES:
            return list(VALUES[name])
        if name in (port.lower() for port in VIEWPORTS):
            return [*known.names("Camera"), "Disable"]
        found: dict[str, Iterable[str]] = {
            "classname": [CLASS_PREFIX + one for one in self.classes],
            "start": known.starts,
            "location": [at for at, _ in known.starts.values()],
            "rotation": [turn for _, turn in known.starts.values()],
            "robot": [known.robot] if known.robot else [],
            "client": [self.client] if self.client else [],
            "type": self._types(head),
            "name": self._names(head, before),
            "opcode": self._opcodes(before),
            "link": [str(number) for number in known.packages.get(_told(before, "Name"), {})],
        }
        return list(found.get(name, ()))

    def _types(self, head: str) -> list[str]:
        learned = [kind for kind in self.knowledge.items if kind not in ASKED_TYPES]
        if head == "SET":
            return [*learned, "Camera", "Effecter", "Joint", "Viewports"]
        return [*ASKED_TYPES, *learned]

    def _names(self, head: str, before: str) -> list[str]:
        if head == "INIT":
            return []
        types = {"DRIVE": "Joint", "MISPKG": "MisPkg"}
        return self.knowledge.names(types.get(head) or _told(before, "Type"))

    def _opcodes(self, before: str) -> list[str]:
        kind, name = _told(before, "Type").lower(), _told(before, "Name").lower()
        if name in self.knowledge.opcodes:
            return self.knowledge.opcodes[name]
        return list(SENSOR_OPCODES.get(kind, ()))


def common_beginning(lines: Sequence[str]) -> str:
    """Return the common beginning of all lines, case ignored and as in the first."""
    count = 0
    for letters in zip(*(line.lower() for line in lines), strict=False):
        if len(set(letters)) > 1:
            break
        count += 1
    return lines[0][:count] if lines else ""


def _fitting(words: Iterable[str], begun: str) -> list[str]:
    """Return the words that begin so, case ignored; a class may be begun without its prefix."""
    begun = begun.lower()
    found = [word for word in words if word.lower().startswith(begun)]
    return found or [
        word for word in words if word.lower().removeprefix(CLASS_PREFIX.lower()).startswith(begun)
    ]


def _told(before: str, key: str) -> str:
    """Return the last value of a key in a line so far."""
    values = [value.strip() for name, value in _SEGMENT.findall(before) if name.lower() == key.lower()]
    return values[-1] if values else ""
