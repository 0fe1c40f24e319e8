"""Settings of mounted items: fields named after the manual's ini keys, and how a mount overrides them.

Which values a setting takes stands in its annotation, as `Annotated[float, POSITIVE]`; what two settings must
be to each other, in the method `wrong` of the settings.
"""

import dataclasses
import math
import re
from functools import cache
from typing import Annotated, Any, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

from usarmjx.base.errors import SpecError, UnknownNameError, UsageError
from usarmjx.models.spec.robot import Options

T = TypeVar("T")


class NumberLimits(NamedTuple):
    """Which numbers a setting takes: from `low` to `high`.

    Attributes:
        low: The smallest.
        high: The largest.
        low_exclusive: Whether `low` itself is too small.
    """

    low: float = -math.inf
    high: float = math.inf
    low_exclusive: bool = False

    def __contains__(self, value: object) -> bool:
        """Whether it takes a value."""
        return isinstance(value, int | float) and (
            self.low < value <= self.high if self.low_exclusive else self.low <= value <= self.high
        )

    def __str__(self) -> str:
        """Return what it takes, for messages."""
        low = f"above {self.low:g}" if self.low_exclusive else f"from {self.low:g}"
        return f"a number {low}" + ("" if math.isinf(self.high) else f" to {self.high:g}")


class OneOf(tuple[str, ...]):
    """Which words a setting takes, case ignored."""

    __slots__ = ()

    def __contains__(self, value: object) -> bool:
        """Whether it takes a value."""
        return isinstance(value, str) and value.lower() in map(str.lower, self)

    def __str__(self) -> str:
        """Return what it takes, for messages."""
        return f"one of {', '.join(self)}"


NOT_NEGATIVE = NumberLimits(low=0.0)
POSITIVE = NumberLimits(low=0.0, low_exclusive=True)
ANGLE_STEP = NumberLimits(low=1e-5)
"""An angle between two of many rays, or of two ticks [rad]."""
HALF_TURN = NumberLimits(low=0.0, high=math.pi + 1e-5)
"""An angle up to half a turn [rad]; a little more, for those who write 3.1416 (of 3.1415927)."""
TURN = NumberLimits(low=0.0, high=2 * math.pi + 1e-5, low_exclusive=True)
"""An angle up to a full turn [rad]."""


def field_name(key: str) -> str:
    """Return the field for an ini key: `MaxRange` -> `max_range`, `bWithTimeStamp` -> `with_time_stamp`."""
    bare = re.sub(r"^b(?=[A-Z])", "", key)
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", bare).lower()


@cache
def limits_of(kind: type) -> dict[str, NumberLimits | OneOf]:
    """Return what the fields of settings take, by name, where there is anything to say.

    A class that gives a field another default keeps the limits of the one that it is derived from.
    """
    found: dict[str, NumberLimits | OneOf] = {}
    for base in reversed(kind.__mro__):
        for name, hint in get_type_hints(base, include_extras=True).items():
            notes = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
            for note in notes:
                if isinstance(note, NumberLimits | OneOf):
                    found[name] = note
    return found


def checked(kind: type, overrides: Options, owner: str) -> dict[str, Any]:
    """Return a mount's overrides by field, each for itself allowed.

    Raises:
        UnknownNameError: A key that this item does not have; lists those it has.
        UsageError: A value of another kind than the setting's: text for a number, a number for true or false.
        SpecError: A number that is not finite, or a value beyond the setting's limits.
    """
    fields = {f.name: f for f in dataclasses.fields(kind)}
    values: dict[str, Any] = {}
    for key, value in overrides:
        name = field_name(key)
        if name not in fields:
            raise UnknownNameError(f"{owner} has no setting {key!r}; known: {', '.join(sorted(fields))}")
        wanted = fields[name].default
        number = isinstance(wanted, int | float) and not isinstance(wanted, bool)
        allowed = (int, float) if number else type(wanted)
        if not isinstance(value, allowed) or isinstance(value, bool) != isinstance(wanted, bool):
            expected = "a number" if number else type(wanted).__name__
            raise UsageError(f"{owner}: setting {key} is {value!r}, expected {expected}")
        limits = limits_of(kind).get(name)
        if number and not math.isfinite(value):  # type: ignore[arg-type]
            raise SpecError(f"{owner}: setting {key} is {value!r}, expected {limits or 'a finite number'}")
        if limits is not None and value not in limits:
            raise SpecError(f"{owner}: setting {key} is {value!r}, expected {limits}")
        values[name] = value
    return values


def resolve_settings(kind: type[T], overrides: Options, owner: str) -> T:
    """Return the settings of `kind` (a dataclass) with a mount's overrides applied.

    Raises:
        UnknownNameError: See `checked`.
        UsageError: See `checked`.
        SpecError: See `checked`; or settings that do not go together, as `wrong` says.
    """
    settings = kind(**checked(kind, overrides, owner))
    wrong = getattr(settings, "wrong", None)
    if wrong is not None and (problem := wrong()):
        raise SpecError(f"{owner}: {problem}")
    return settings
