"""What the values of an arena must be beside their types: one rule per dataclass, in words."""

from collections import Counter
from collections.abc import Callable
from typing import Any

from usarmjx.base.errors import SpecError
from usarmjx.base.names import is_name
from usarmjx.models.build.victim_table import build_table, check
from usarmjx.models.files.values import FARTHEST
from usarmjx.models.spec.arena import ArenaSpec, Door, FalseAlarm, Light, LooseObject, Victim, Water
from usarmjx.models.spec.shapes import FENDER, MATERIALS, SURFACES, Shape
from usarmjx.models.spec.textures import texture_problem

SIZES = {
    "box": (3, "half lengths along x, y and z"),
    "sphere": (1, "the radius"),
    "capsule": (2, "radius and half length without the balls"),
    "cylinder": (2, "radius and half length"),
    "ellipsoid": (3, "radii along x, y and z"),
    "hfield": (3, "half lengths along x and y, and the ground's thickness below the lowest point"),
}
"""How many numbers the size of a kind of solid has, and what they are; a mesh has none."""


def problem(record: object) -> str:
    """Return what is wrong with a dataclass of an arena, and what is allowed; empty: nothing."""
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
    return _said(lambda: check(victim))


def _alarm(alarm: FalseAlarm) -> str:
    return _said(lambda: build_table((), (alarm,)))


def _said(action: Callable[[], object]) -> str:
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
    if not farthest <= FARTHEST:
        return f"something lies or reaches {farthest:g} m from the origin; at most {FARTHEST:g}"
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
