"""Sensor settings: dataclass fields named after the manual's ini keys, and how a mount overrides them."""

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
        UnknownNameError: A key that this sensor does not have; lists those it has.
        UsageError: A number where the setting is true or false, or the like.
    """
    fields = {f.name: f for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    values: dict[str, object] = {}
    for key, value in overrides:
        name = field_name(key)
        if name not in fields:
            raise UnknownNameError(f"{owner} has no setting {key!r}; known: {', '.join(sorted(fields))}")
        default = fields[name].default
        if isinstance(default, bool) != isinstance(value, bool):
            raise UsageError(f"{owner}: setting {key} is {value!r}, expected {type(default).__name__}")
        values[name] = value
    return kind(**values)
