"""The text grammar of settings, one for the command line, `--set` and ini files.

| type | texts |
|---|---|
| number | `1`, `-2.5`, `.5`, `1e-3`, `1_000`; with a unit where the setting has one: `90deg`, `50 cm` |
| whole number | the same, if it is whole: `64`, `1e6` |
| true or false | `true yes on 1`, `false no off 0` |
| none | `none`, `null` |
| word | as it stands, case ignored |
| list | `64,64`, `[64, 64]`, `(64, 64)`; `[]` is empty; lists in lists have brackets |
| mapping | `P2AT:4,Kenaf:2`, `{P2AT: 4}` |

Settings in settings have dots: `physics.timestep=0.01`. YAML, JSON and TOML have types of their own; there
only numbers with a unit are texts.
"""

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any, cast

from usarmjx.base.errors import UsageError

TRUE, FALSE, NONE = ("true", "yes", "on", "1"), ("false", "no", "off", "0"), ("none", "null")
UNITS: dict[str, dict[str, float]] = {
    "rad": {"deg": math.pi / 180},
    "rad/s": {"deg/s": math.pi / 180},
    "m": {"mm": 1e-3, "cm": 1e-2, "km": 1e3},
    "m/s": {"cm/s": 1e-2, "km/h": 1 / 3.6},
    "s": {"ms": 1e-3, "min": 60.0, "h": 3600.0},
    "kg": {"g": 1e-3},
    "Hz": {"kHz": 1e3, "MHz": 1e6},
}
"""Multiples of a setting's unit that a text may name beside the unit itself."""
LONGEST_NUMBER = 100
"""Characters of a number; Python takes the square of their count to read them."""
LARGEST_WHOLE = 2**53
"""Largest float that stands for a whole number: beyond, not all of them are floats."""
_NUMBER = re.compile(
    r"([+-]?(?:(?:\d[\d_]*\.?[\d_]*|\.\d[\d_]*)(?:[eE][+-]?\d+)?|\.?inf|\.?nan))\s*(\S*)",
    # Without ASCII, \d takes the digits of all scripts.
    re.ASCII | re.IGNORECASE,
)
_OPENING, _CLOSING = "[({", "])}"


class Text(str):
    """A value as it was typed, which the grammar reads; other texts are data, which it does not.

    Attributes:
        place: Position, as `file:line`; empty: see the source of all.
    """

    __slots__ = ("place",)

    def __new__(cls, text: str, place: str = "") -> "Text":
        """Return a text."""
        one = super().__new__(cls, text)
        one.place = place
        return one


def parse_number(text: str, unit: str = "", *, unit_needed: bool = False) -> float | int | None:
    """Return the number that a text is, in the setting's unit; None: it is no number.

    Args:
        text: The text.
        unit: The setting's unit.
        unit_needed: Refuse a number without a unit, but for `inf`.
    """
    found = _NUMBER.fullmatch(text.strip()) if len(text) <= LONGEST_NUMBER else None
    if found is None:
        return None
    # YAML writes infinity and NaN with a dot before, Python without.
    digits, named = found[1].lower().replace("_", "").replace(".inf", "inf").replace(".nan", "nan"), found[2]
    factors = {"": 1.0, unit: 1.0, **UNITS.get(unit, {})}
    if named not in factors or (unit_needed and not named and "inf" not in digits):
        return None
    # Whole numbers stay exact at any length.
    plain = int(digits) if digits.lstrip("+-").isdigit() else float(digits)
    # Unchanged without a factor: a product with 1.0 would make a float of a whole number.
    return plain if factors[named] == 1.0 else plain * factors[named]


def parse_truth(text: str) -> bool | None:
    """Return the truth value that a text is; None: it is none."""
    word = text.strip().lower()
    return True if word in TRUE else False if word in FALSE else None


def is_none(text: str) -> bool:
    """Return whether a text says that there is nothing."""
    return text.strip().lower() in NONE


def parse_list(text: str) -> list[str] | None:
    """Return the items of a list; None: its brackets do not match."""
    inner = _without_brackets(text.strip(), "[(", "])")
    items, depth, item = list[str](), list[str](), ""
    for letter in inner:
        if letter in _OPENING:
            depth.append(_CLOSING[_OPENING.index(letter)])
        elif letter in _CLOSING and (not depth or depth.pop() != letter):
            return None
        if letter == "," and not depth:
            items.append(item.strip())
            item = ""
        else:
            item += letter
    if depth:
        return None
    # Nothing behind the last comma is no item, as in (64,).
    return [*items, item.strip()] if item.strip() else items


def parse_mapping(text: str) -> dict[str, str] | None:
    """Return the keys and values of a mapping; None: it is none, or a key is there twice."""
    found: dict[str, str] = {}
    items = parse_list(_without_brackets(text.strip(), "{", "}"))
    for item in items or ():
        # At the first colon: the value may be a mapping in turn.
        key, colon, value = item.partition(":")
        if not (colon and key.strip()) or key.strip() in found:
            return None
        found[key.strip()] = value.strip()
    return None if items is None else found


def _without_brackets(text: str, opening: str, closing: str) -> str:
    """Return a text without the pair of brackets around all of it."""
    if not text or text[0] not in opening or text[-1] != closing[opening.index(text[0])]:
        return text
    depth = 0
    for place, letter in enumerate(text):
        depth += (letter in _OPENING) - (letter in _CLOSING)
        if depth == 0 and place < len(text) - 1:
            return text  # the first bracket closes before the end, as in (0,1),(2,3)
    return text[1:-1]


def parse_assignments(pairs: Iterable[str], where: str = "") -> dict[str, Text]:
    """Return texts by name from `name=text` each, for `from_text`.

    Args:
        pairs: As typed.
        where: The option, for messages.

    Raises:
        UsageError: One is of another form, or a name is there twice.
    """
    start = f"{where}: " if where else ""
    found: dict[str, Text] = {}
    for pair in pairs:
        # At the first sign: the text may have more of them.
        name, equals, text = pair.partition("=")
        name = name.strip()
        if not (equals and name):
            raise UsageError(f"{start}{pair!r} is not of the form name=value")
        if name in found:
            raise UsageError(f"{start}{name} is given twice: {found[name]!r} and {text!r}")
        found[name] = Text(text.strip(), where)
    return found


def nested_texts(texts: Mapping[str, str], where: str = "") -> dict[str, Any]:
    """Return texts by names with dots as mappings in mappings.

    Raises:
        UsageError: A name stands for a value and for settings in it at once, or is empty.
    """
    found: dict[str, Any] = {}
    start = f"{where}: " if where else ""
    for name, text in texts.items():
        *outer, last = name.split(".")
        inner = found
        for part in outer:
            below: object = inner.setdefault(part, {})
            if not isinstance(below, dict):
                raise UsageError(f"{start}{name}: {part} is given as a whole, too")
            inner = cast(dict[str, Any], below)
        if not all((*outer, last)):
            raise UsageError(f"{start}{name!r} is not the name of a setting")
        if last in inner:
            raise UsageError(f"{start}{name}: settings in it are given, too")
        inner[last] = text if isinstance(text, Text) else Text(text)
    return found
