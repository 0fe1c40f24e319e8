"""Settings of mounted items: fields named after the manual's ini keys, and how a mount overrides them."""

import dataclasses
import re
from typing import TypeVar

from usarmjx.errors import UnknownNameError, UsageError
from usarmjx.models.spec import Options

T = TypeVar("T")


def field_name(key: str) -> str:
    """Return the field for an ini key: `MaxRange` -> `max_range`, `bWithTimeStamp` -> `with_time_stamp`."""
    bare = re.sub(r"^b(?=[A-Z])", "", key)
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", bare).lower()


def resolve(kind: type[T], overrides: Options, owner: str) -> T:
    """Return the settings of `kind` (a dataclass) with a mount's overrides applied.

    Raises:
        UnknownNameError: A key that this item does not have; lists those it has.
        UsageError: A value of another kind than the setting's: text for a number, a number for true or false.
    """
    fields = {f.name: f for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    values: dict[str, object] = {}
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
        values[name] = value
    return kind(**values)
