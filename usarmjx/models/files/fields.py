"""Values of a file to the frozen dataclasses of `models.spec`, by their type hints."""

import math
import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from usarmjx.models.files.rules import problem
from usarmjx.models.files.values import YamlValue

T = TypeVar("T")
Special = Mapping[type, Callable[[YamlValue], Any]]
"""How types are read that a YAML file gives in another way, as meshes by the name of a file."""
DEGREES = "deg"
"""What may follow an angle; without it, it is in radians."""


def read_record(kind: type[T], value: YamlValue, special: Special, **defaults: object) -> T:
    """Return a dataclass from a mapping with its field names as keys.

    Args:
        kind: The dataclass.
        value: The mapping.
        special: How to read some types.
        defaults: Fields that the mapping need not have.

    Raises:
        ArenaFileError: An unknown or missing key, a value of another type, or one that is not allowed.
    """
    given = value.mapping()
    hints = hints_of(kind)
    check_keys(value, list(hints))
    taken = {name: read(hints[name], item, special) for name, item in given.items()}
    for field in fields(kind):  # type: ignore[arg-type] - a dataclass
        bare = field.default is MISSING and field.default_factory is MISSING
        if bare and field.name not in taken and field.name not in defaults:
            raise value.error(f"has no {field.name!r}, {_said(hints[field.name])}")
    record = kind(**{**defaults, **taken})
    if wrong := problem(record):
        raise value.error(wrong)
    return record


def read(hint: Any, value: YamlValue, special: Special) -> Any:  # noqa: ANN401 - as the hint says
    """Return a value as what a type hint says: scalars, tuples, unions with None, dataclasses.

    Raises:
        ArenaFileError: It is something else; names the place and what is allowed.
    """
    if hint in special:
        return special[hint](value)
    if hint in SCALARS:
        return SCALARS[hint](value)
    if is_dataclass(hint):
        return read_record(hint, value, special)  # type: ignore[arg-type] - a class
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Literal:
        if value.data not in inner:
            raise value.error(f"{value.shown} is not one of {', '.join(map(str, inner))}")
        return value.data
    if origin in (Union, types.UnionType):
        if value.data is None:
            return None
        (some,) = (one for one in inner if one is not type(None))
        return read(some, value, special)
    if inner[-1:] == (Ellipsis,):
        return tuple(read(inner[0], item, special) for item in value.items())
    items = value.data
    if not isinstance(items, list) or len(items) != len(inner):
        raise value.error(f"{value.shown} is not {_said(hint)}")
    return tuple(read(one, item, special) for one, item in zip(inner, items, strict=True))


@cache
def hints_of(kind: type) -> dict[str, Any]:
    """Return the type hints of a dataclass' fields, in order."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


def check_keys(value: YamlValue, allowed: list[str]) -> None:
    """Refuse keys of a mapping that nobody reads.

    Raises:
        ArenaFileError: Names the key, the likely one, and those that are allowed.
    """
    for key, item in value.mapping().items():
        if key not in allowed:
            near = get_close_matches(key, allowed, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise item.error(f"unknown key {key!r}{hint} (allowed: {', '.join(allowed)})")


def _number(value: YamlValue) -> float:
    data = value.data
    if isinstance(data, str):  # YAML takes 1e-3 for a word
        word = data.removesuffix(DEGREES)
        try:
            data = math.radians(float(word)) if word != data else float(word)
        except ValueError:
            raise value.error(f"{value.shown} is not a number") from None
    if isinstance(data, bool) or not isinstance(data, (int, float)):
        raise value.error(f"{value.shown} is not a number")
    try:
        number = float(data)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise value.error(f"{value.shown} is not a finite number")
    return number


def _exactly(kind: type[T]) -> Callable[[YamlValue], T]:
    def read_one(value: YamlValue) -> T:
        if type(value.data) is not kind:
            raise value.error(f"{value.shown} is not {_said(kind)}")
        return value.data

    return read_one


SCALARS: dict[Any, Callable[[YamlValue], Any]] = {
    float: _number,
    int: _exactly(int),
    bool: _exactly(bool),
    str: _exactly(str),
}
NAMES = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}


def _said(hint: Any) -> str:  # noqa: ANN401 - a type hint
    """Return a type hint in words."""
    if hint in NAMES:
        return NAMES[hint]
    inner = get_args(hint)
    if get_origin(hint) is tuple:
        if inner[-1] is Ellipsis:
            return "a list"
        each = "numbers" if set(inner) == {float} else f"items, each {_said(inner[0])}"
        return f"a list of {len(inner)} {each}"
    if get_origin(hint) is Literal:
        return f"one of {', '.join(map(str, inner))}"
    return "a mapping" if is_dataclass(hint) else "a value"


def required(value: YamlValue, key: str) -> YamlValue:
    """Return what a mapping has under a key.

    Raises:
        ArenaFileError: It has nothing there.
    """
    given = value.mapping()
    if key not in given:
        raise value.error(f"has no {key!r}")
    return given[key]


def option(hint: Any, value: YamlValue, key: str, default: Any) -> Any:  # noqa: ANN401 - as the hint says
    """Return what a mapping has under a key, as the hint says, else the default."""
    given = value.mapping()
    return read(hint, given[key], {}) if key in given else default
