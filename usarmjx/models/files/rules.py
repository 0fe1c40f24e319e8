"""Rules of the dataclasses of arenas: conditions between their fields, beside the limits of each one."""

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.registry import is_name
from usarmjx.models.compile.inertia import arena_inertia
from usarmjx.models.compile.victims import build_victim_table, check_victim
from usarmjx.models.files.content import MAX_COORDINATE
from usarmjx.models.types.arena import ArenaSpec, Door, FalseAlarm, LooseObject, Victim, Water
from usarmjx.models.types.shapes import FENDER, BodyInertia, Shape
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


def _shape(shape: Shape) -> str:
    if shape.material == FENDER and shape.kind != "box":
        return f"a fender is a box, not a {shape.kind}"
    for kind, key, data in (("mesh", "mesh", shape.mesh), ("hfield", "heights", shape.heights)):
        if (shape.kind == kind) != (data is not None):
            return f"kind {kind} and the key {key!r} go together; this is a {shape.kind}"
    if shape.kind in SIZES:
        count, meaning = SIZES[shape.kind]
        if len(shape.size) != count or min(shape.size) <= 0:
            return f"size {list(shape.size)} of a {shape.kind}: wants {count} above zero, {meaning} [m]"
    return texture_problem(shape.texture)


def _loose(loose: LooseObject) -> str:
    if loose.inertia is not None and (loose.inertia.mass <= 0 or not _is_inertia(loose.inertia)):
        return f"loose object {loose.name!r}: inertia is that of no body: {loose.inertia}"
    if loose.inertia is None and sum(shape.mass for shape in loose.shapes) <= 0:
        return f"loose object {loose.name!r} has no mass: give one of its shapes a mass [kg]"
    if any(shape.kind == "hfield" for shape in loose.shapes):
        return f"loose object {loose.name!r} is a terrain; those stay where they are"
    return ""


def _is_inertia(stated: BodyInertia) -> bool:
    """Return whether a body can have these moments: all above 0, none above the sum of the others."""
    tensor = arena_inertia(stated).tensor
    if not np.isfinite(tensor).all():
        return False
    values = np.linalg.eigvalsh(tensor)
    return bool(values[0] > 0 and values[2] <= (values[0] + values[1]) * (1 + 1e-6))


def _door(door: Door) -> str:
    if door.limits[0] >= door.limits[1]:
        return f"door {door.name!r}: limits {list(door.limits)}: wants lowest and highest angle"
    return ""


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


def arena_problem(arena: ArenaSpec) -> str:
    """Return the error of an arena; empty: it is valid."""
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
    return ""


ARENA_RULES: dict[type, Callable[[Any], str]] = {
    ArenaSpec: arena_problem,
    Door: _door,
    FalseAlarm: _alarm,
    LooseObject: _loose,
    Shape: _shape,
    Victim: _victim,
    Water: _water,
}
"""Check of each dataclass, which returns its error; empty: it is valid."""
