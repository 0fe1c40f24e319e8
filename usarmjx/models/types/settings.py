"""Settings of mounted items: fields named after the manual's ini keys, and the overrides of a mount.

The annotation of a setting holds its limits, as `Annotated[float, POSITIVE]`, and the manual's key where it
does not follow from the field's name: `Annotated[float, ManualKey("dBmTXPower")]`. Conditions between two
settings are in the method `problem` of the settings.
"""

import dataclasses
import math
import re
from collections.abc import Iterator
from functools import cache
from typing import Annotated, Any, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from usarmjx.base.errors import SpecError, UnknownNameError, UsageError
from usarmjx.models.types.robot import Options

T = TypeVar("T")


class NumberLimits(NamedTuple):
    """Numbers that a setting accepts: from `low` to `high`.

    Attributes:
        low: The smallest.
        high: The largest.
        low_exclusive: Whether `low` itself is too small.
    """

    low: float = -math.inf
    high: float = math.inf
    low_exclusive: bool = False

    def __contains__(self, value: object) -> bool:
        """Return whether a value is within the limits."""
        return isinstance(value, int | float) and (
            self.low < value <= self.high if self.low_exclusive else self.low <= value <= self.high
        )

    def __str__(self) -> str:
        """Return the limits in words, for messages."""
        low = f"above {self.low:g}" if self.low_exclusive else f"from {self.low:g}"
        return f"a number {low}" + ("" if math.isinf(self.high) else f" to {self.high:g}")


class OneOf(tuple[str, ...]):
    """Words that a setting accepts, case ignored."""

    __slots__ = ()

    def __contains__(self, value: object) -> bool:
        """Return whether a value is one of the words."""
        return isinstance(value, str) and value.lower() in map(str.lower, self)

    def __str__(self) -> str:
        """Return the words, for messages."""
        return f"one of {', '.join(self)}"


SMALLEST_NUMBER = float(np.finfo(np.float32).tiny)
"""Smallest normal number in single precision; some devices flush smaller ones to zero, some do not."""


class ManualKey(str):
    """The manual's key of a setting whose field name does not follow from it by `field_name`."""

    __slots__ = ()


NOT_NEGATIVE = NumberLimits(low=0.0)
"""Limits of a setting that may be 0."""
POSITIVE = NumberLimits(low=0.0, low_exclusive=True)
"""Limits of a setting above 0."""
ANGLE_STEP = NumberLimits(low=1e-5)
"""Limits of an angle between neighbouring rays, or of two ticks [rad]."""
HALF_TURN = NumberLimits(low=0.0, high=math.pi + 1e-5)
"""Limits of an angle up to half a turn [rad]; a little more, for 3.1416 in place of 3.1415927."""
TURN = NumberLimits(low=0.0, high=2 * math.pi + 1e-5, low_exclusive=True)
"""Limits of an angle up to a full turn [rad]."""


def field_name(key: str) -> str:
    """Return the field for an ini key: `MaxRange` -> `max_range`, `bWithTimeStamp` -> `with_time_stamp`."""
    bare = re.sub(r"^b(?=[A-Z])", "", key)
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", bare).lower()


def camel_case(field: str) -> str:
    """Return the key of a field, without the b of a flag: `max_range` -> `MaxRange`."""
    return "".join(part[:1].upper() + part[1:] for part in field.split("_"))


def _notes(kind: type) -> Iterator[tuple[str, object]]:
    """Yield the fields of settings with the metadata of their annotations.

    A class that gives a field another default keeps the metadata of its base class.
    """
    for base in reversed(kind.__mro__):
        for name, hint in get_type_hints(base, include_extras=True).items():
            for note in get_args(hint)[1:] if get_origin(hint) is Annotated else ():
                yield name, note


@cache
def limits_of(kind: type) -> dict[str, NumberLimits | OneOf]:
    """Return the limits of settings by field, for fields that have any."""
    return {name: note for name, note in _notes(kind) if isinstance(note, NumberLimits | OneOf)}


@cache
def manual_keys(kind: type[Any]) -> dict[str, str]:
    """Return the manual's keys of settings by field: the fields' `ManualKey`, or `camel_case` of their names.

    Without a `ManualKey` those of flags begin with a b: `with_time_stamp` -> `bWithTimeStamp`.
    """
    told = {name: str(note) for name, note in _notes(kind) if isinstance(note, ManualKey)}
    flags = {field.name: "b" if isinstance(field.default, bool) else "" for field in dataclasses.fields(kind)}
    return {name: told.get(name, flag + camel_case(name)) for name, flag in flags.items()}


@cache
def field_names(kind: type[Any]) -> dict[str, str]:
    """Return the fields of settings by the `field_name` of their keys."""
    told = {name: field_name(note) for name, note in _notes(kind) if isinstance(note, ManualKey)}
    return {told.get(field.name, field.name): field.name for field in dataclasses.fields(kind)}


def checked(kind: type, overrides: Options, owner: str) -> dict[str, Any]:
    """Return a mount's overrides by field, each checked alone.

    Raises:
        UnknownNameError: The item has no such key; the message lists its keys.
        UsageError: A value of another type than the setting's: text for a number, a number for true or false.
        SpecError: A number that is not finite or is subnormal, or a value beyond the setting's limits.
    """
    fields, names = {f.name: f for f in dataclasses.fields(kind)}, field_names(kind)
    values: dict[str, Any] = {}
    for key, value in overrides:
        name = field_name(key)
        name = names.get(name, name)
        if name not in fields:
            raise UnknownNameError(f"{owner} has no setting {key!r}; known: {', '.join(sorted(fields))}")
        wanted: object = fields[name].default
        number = isinstance(wanted, int | float) and not isinstance(wanted, bool)
        allowed = (int, float) if number else type(wanted)
        if not isinstance(value, allowed) or isinstance(value, bool) != isinstance(wanted, bool):
            expected = "a number" if number else type(wanted).__name__
            raise UsageError(f"{owner}: setting {key} is {value!r}, expected {expected}")
        limits = limits_of(kind).get(name)
        if number and not math.isfinite(value):  # type: ignore[arg-type]
            raise SpecError(f"{owner}: setting {key} is {value!r}, expected {limits or 'a finite number'}")
        if isinstance(value, float) and 0 < abs(value) < SMALLEST_NUMBER:
            raise SpecError(
                f"{owner}: setting {key} is {value!r}, expected 0 or at least {SMALLEST_NUMBER:.2g}"
            )
        if limits is not None and value not in limits:
            raise SpecError(f"{owner}: setting {key} is {value!r}, expected {limits}")
        # An integer in a file is a length or an angle like any other: messages show its decimals.
        values[name] = float(value) if isinstance(wanted, float) and number else value  # type: ignore[arg-type]
    return values


def resolve_settings(kind: type[T], overrides: Options, owner: str) -> T:
    """Return the settings of `kind` (a dataclass) with a mount's overrides applied.

    Raises:
        UnknownNameError: See `checked`.
        UsageError: See `checked`.
        SpecError: See `checked`; or settings that contradict each other (`problem`).
    """
    settings = kind(**checked(kind, overrides, owner))
    problem = getattr(settings, "problem", None)  # settings of effecters have none
    if problem is not None and (found := problem()):
        raise SpecError(f"{owner}: {found}")
    return settings
