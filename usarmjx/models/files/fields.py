"""Conversion of values of a file to the frozen dataclasses of `models.types`, by their type hints."""

import math
import types
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from usarmjx.base.errors import SpecError
from usarmjx.base.registry import is_name
from usarmjx.models.compile.victims import build_victim_table, check_victim
from usarmjx.models.files.values import MAX_COORDINATE, YamlValue
from usarmjx.models.types.arena import ArenaSpec, Door, FalseAlarm, Light, LooseObject, Victim, Water
from usarmjx.models.types.shapes import FENDER, MATERIALS, SURFACES, Shape
from usarmjx.models.types.textures import texture_problem

SIZES = {
    "box": (3, "half lengths along x, y and z"),
    "sphere": (1, "the radius"),
    "capsule": (2, "radius and half length without the balls"),
    "cylinder": (2, "radius and half length"),
    "ellipsoid": (3, "radii along x, y and z"),
    "hfield": (3, "half lengths along x and y, and the ground's thickness below the lowest point"),
}
"""Number and meaning of the size numbers of a kind of solid; a mesh has none."""


def problem(record: object) -> str:
    """Return the error of a dataclass of an arena, with the allowed values; empty: it is valid."""
    return ARENA_RULES.get(type(record), _fine)(record)


def _fine(_: object) -> str:
    return ""


def _shape(shape: Shape) -> str:
    if shape.surface not in SURFACES:
        return f"no surface {shape.surface!r}; there is: {', '.join(SURFACES)}"
    if shape.material not in MATERIALS:
        return f"no material {shape.material!r}; there is: {', '.join(MATERIALS)}"
    if shape.material == FENDER and shape.kind != "box":
        return f"a fender is a box, not a {shape.kind}"
    if shape.mass < 0:
        return f"mass {shape.mass} is negative"
    for kind, key, data in (("mesh", "mesh", shape.mesh), ("hfield", "heights", shape.heights)):
        if (shape.kind == kind) != (data is not None):
            return f"kind {kind} and the key {key!r} go together; this is a {shape.kind}"
    if shape.kind in SIZES:
        count, meaning = SIZES[shape.kind]
        if len(shape.size) != count or min(shape.size) <= 0:
            return f"size {list(shape.size)} of a {shape.kind}: wants {count} above zero, {meaning} [m]"
    return texture_problem(shape.texture) or _colour(shape.rgba)


def _colour(rgba: tuple[float, ...]) -> str:
    outside = any(not 0 <= part <= 1 for part in rgba)
    return f"rgba {list(rgba)}: wants red, green, blue and opacity between 0 and 1" if outside else ""


def _loose(loose: LooseObject) -> str:
    if sum(shape.mass for shape in loose.shapes) <= 0:
        return f"loose object {loose.name!r} has no mass: give one of its shapes a mass [kg]"
    if any(shape.kind == "hfield" for shape in loose.shapes):
        return f"loose object {loose.name!r} is a terrain; those stay where they are"
    return ""


def _door(door: Door) -> str:
    if min(door.size) <= 0 or door.mass <= 0 or door.friction < 0:
        return f"door {door.name!r}: size and mass are above zero, friction is not below"
    if door.limits[0] >= door.limits[1]:
        return f"door {door.name!r}: limits {list(door.limits)}: wants lowest and highest angle"
    return _colour(door.rgba)


def _water(water: Water) -> str:
    if all(low < high for low, high in zip(water.low, water.high, strict=True)):
        return ""
    return f"low {list(water.low)} is not below high {list(water.high)} in x, y and z"


def _victim(victim: Victim) -> str:
    return _refusal(lambda: check_victim(victim))


def _alarm(alarm: FalseAlarm) -> str:
    return _refusal(lambda: build_victim_table((), (alarm,)))


def _refusal(action: Callable[[], object]) -> str:
    try:
        action()
    except SpecError as error:
        return str(error)
    return ""


def _light(light: Light) -> str:
    return f"brightness {light.brightness} is negative" if light.brightness < 0 else ""


def _arena(arena: ArenaSpec) -> str:
    solids = [*arena.shapes, *(shape for one in arena.loose for shape in one.shapes)]
    places = [one.at for one in (*solids, *arena.starts, *arena.loose, *arena.doors, *arena.victims)]
    lengths = [*places, *(shape.size for shape in solids), *arena.extent]
    farthest = max((abs(number) for numbers in lengths for number in numbers), default=0.0)
    if not farthest <= MAX_COORDINATE:
        return f"something lies or reaches {farthest:g} m from the origin; at most {MAX_COORDINATE:g}"
    for start in arena.starts:
        if not is_name(start.tag):
            return f"start {start.tag!r}: a tag is one word of ASCII without braces"
    for kind, records in (("loose object", arena.loose), ("door", arena.doors), ("victim", arena.victims)):
        twice = [name for name, count in Counter(record.name for record in records).items() if count > 1]
        if twice:
            return f"two {kind}s are called {twice[0]!r}; names are unique"
    if any(low >= high for low, high in arena.extent):
        return f"extent {[list(pair) for pair in arena.extent]}: wants [[x0, x1], [y0, y1]], lowest first"
    if arena.gps is not None and (abs(arena.gps[0]) > 90 or abs(arena.gps[1]) > 180):
        return f"gps {list(arena.gps)}: wants latitude and longitude [degrees]"
    return ""


ARENA_RULES: dict[type, Callable[[Any], str]] = {
    ArenaSpec: _arena,
    Door: _door,
    FalseAlarm: _alarm,
    Light: _light,
    LooseObject: _loose,
    Shape: _shape,
    Victim: _victim,
    Water: _water,
}
"""Check of each dataclass, which returns its error."""


T = TypeVar("T")
Special = Mapping[type, Callable[[YamlValue], Any]]
"""Readers of types with a YAML form of their own, as meshes by the name of a file."""
DEGREES = "deg"
"""Suffix of an angle in degrees; without it, it is in radians."""


def read_record(kind: type[T], value: YamlValue, special: Special, **defaults: object) -> T:
    """Return a dataclass from a mapping with its field names as keys.

    Args:
        kind: The dataclass.
        value: The mapping.
        special: Readers of some types.
        defaults: Fields that the mapping may omit.

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
    """Convert a value by a type hint: scalars, tuples, unions with None, dataclasses.

    Raises:
        ArenaFileError: The value is of another type; names its position and the allowed values.
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
    """Refuse unknown keys of a mapping.

    Raises:
        ArenaFileError: Names the key, the most similar one, and the allowed ones.
    """
    for key, item in value.mapping().items():
        if key not in allowed:
            near = get_close_matches(key, allowed, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise item.error(f"unknown key {key!r}{hint} (allowed: {', '.join(allowed)})")


def _number(value: YamlValue) -> float:
    """Return a finite number, or an angle in degrees as radians."""
    data = value.data
    if isinstance(data, str):  # PyYAML reads 1e-3 as a string: its floats need a dot
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
"""Reader of each scalar type."""
NAMES = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}
"""Scalar types in words."""


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
    """Return the value under a key of a mapping.

    Raises:
        ArenaFileError: The key is missing.
    """
    given = value.mapping()
    if key not in given:
        raise value.error(f"has no {key!r}")
    return given[key]


def option(hint: Any, value: YamlValue, key: str, default: Any) -> Any:  # noqa: ANN401 - as the hint says
    """Return the value under a key of a mapping, converted by the hint, else the default."""
    given = value.mapping()
    return read(hint, given[key], {}) if key in given else default
