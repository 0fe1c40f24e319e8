"""Settings of mounted items: fields named after the manual's ini keys, and the overrides of a mount.

A field declares its limits by notes, as `Annotated[float, POSITIVE]`, and the manual's key where it does not
follow from the field's name: `Annotated[float, Setting(manual_key="dBmTXPower")]`. Conditions between two
settings are in the method `problem` of the settings.
"""

import math
import re
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

from usarmjx.base.settings import Setting, describe
from usarmjx.models.types.robot import Options

if TYPE_CHECKING:
    from usarmjx.base.settings.reader import Reader

T = TypeVar("T")

ANGLE_STEP = Setting(ge=1e-5)
"""Limits of an angle between neighbouring rays, or of two ticks [rad]."""
HALF_TURN = Setting(ge=0, le=math.pi + 1e-5)
"""Limits of an angle up to half a turn [rad]; a little more, for 3.1416 in place of 3.1415927."""
TURN = Setting(gt=0, le=2 * math.pi + 1e-5)
"""Limits of an angle up to a full turn [rad]."""


def field_name(key: str) -> str:
    """Return the field for an ini key: `MaxRange` -> `max_range`, `bWithTimeStamp` -> `with_time_stamp`."""
    bare = re.sub(r"^b(?=[A-Z])", "", key)
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", bare).lower()


def camel_case(field: str) -> str:
    """Return the key of a field, without the b of a flag: `max_range` -> `MaxRange`."""
    return "".join(part[:1].upper() + part[1:] for part in field.split("_"))


@cache
def manual_keys(kind: type[Any]) -> dict[str, str]:
    """Return the manual's keys of settings by field: the declared ones, or `camel_case` of the fields' names.

    Derived keys of flags begin with a b: `with_time_stamp` -> `bWithTimeStamp`.
    """
    flags = {one.name: "b" if isinstance(one.default, bool) else "" for one in describe(kind)}
    return {one.name: one.note.manual_key or flags[one.name] + camel_case(one.name) for one in describe(kind)}


@cache
def field_names(kind: type[Any]) -> dict[str, str]:
    """Return the fields of settings by the `field_name` of their keys."""
    return {field_name(one.note.manual_key) or one.name: one.name for one in describe(kind)}


@cache
def _reader() -> "Reader":
    from usarmjx.base.settings.reader import Reader  # pydantic-core takes 40 ms to import

    return Reader(spelling=field_name)


def _last_of_each(kind: type, overrides: Options) -> dict[str, object]:
    """Return overrides by key; of two spellings of a field the last one counts."""
    names = _reader().names(kind)
    last = {names.get(field_name(key), key): (key, value) for key, value in overrides}
    return dict(last.values())


def checked(kind: type, overrides: Options, owner: str) -> dict[str, Any]:
    """Return a mount's overrides by field, each checked alone.

    Raises:
        UnknownNameError: The item has no such key; the message lists its keys.
        SpecError: A value of another type than the setting's, or beyond its limits.
    """
    return _reader().values(kind, _last_of_each(kind, overrides), where=owner)


def resolve_settings(kind: type[T], overrides: Options, owner: str) -> T:
    """Return the settings of `kind` (a dataclass) with a mount's overrides applied.

    Raises:
        UnknownNameError: See `checked`.
        SpecError: See `checked`; or settings that contradict each other (`problem`).
    """
    return _reader().from_data(kind, _last_of_each(kind, overrides), where=owner)
