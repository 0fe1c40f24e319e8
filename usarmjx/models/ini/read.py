"""Typed reading of values of an ini file: numbers, vectors and names, with the position of every error."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NoReturn

from usarmjx.base.errors import SpecError
from usarmjx.base.registry import is_name
from usarmjx.base.transforms import Vec3
from usarmjx.models.ini.parse import UU_PER_METRE, IniValue, Line, Reference, Struct
from usarmjx.models.ini.values import quote_short

MAX_NUMBER = 1e12
"""Largest number, whose cube is still usable."""
UU_PER_RADIAN = 32768 / math.pi
"""Unreal's angles per radian (manual 6.2)."""


@dataclass(frozen=True)
class Units:
    """Units of positions and angles in a robot's section.

    Attributes:
        by_uu: bMountByUU: in Unreal units and Unreal's axes, z up; else in metres, radians and z down.
        uu_per_metre: Length of a metre in Unreal units.
    """

    by_uu: bool = False
    uu_per_metre: float = UU_PER_METRE

    def position(self, vector: Vec3) -> Vec3:
        """Convert a position to metres, z down."""
        if not self.by_uu:
            return vector
        x, y, z = (value / self.uu_per_metre for value in vector)
        return (x, y, 0.0 - z)

    def angles(self, vector: Vec3) -> Vec3:
        """Convert rotations about x, y, z to radians: roll, pitch, yaw, whose signs are Unreal's too."""
        if not self.by_uu:
            return vector
        x, y, z = (value / UU_PER_RADIAN for value in vector)
        return (x, y, z)


def fail(line: Line, problem: str, expected: str) -> NoReturn:
    """Raise SpecError with file and line, the error and the allowed values."""
    raise SpecError(f"{line.file}:{line.line}: {problem}; expected {expected}")


def key_text(line: Line) -> str:
    """Return a key in the notation of the file: `Wheels(2)`."""
    return line.key if line.index is None else f"{line.key}({line.index})"


def as_number(line: Line, value: IniValue | None, name: str, *, above: float = -math.inf) -> float:
    """Return a finite number, which must be greater than `above`."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        fail(line, f"{name} is {_quoted(value)}", "a number")
    if not (abs(value) <= MAX_NUMBER and value > above):
        fail(
            line,
            f"{name} is {value:g}",
            f"a number above {max(above, -MAX_NUMBER):g}, at most {MAX_NUMBER:g}",
        )
    return float(value)


def as_whole(line: Line, least: int, most: int) -> int:
    """Return the integer of a line, within limits."""
    value = as_number(line, line.value, line.key)
    if value != int(value) or not least <= value <= most:
        fail(line, f"{line.key} is {line.value}", f"a whole number from {least} to {most}")
    return int(value)


def as_bool(line: Line, value: IniValue | None, name: str) -> bool:
    """Return a truth value; 1 and 0 are accepted."""
    if isinstance(value, bool) or (isinstance(value, int) and value in (0, 1)):
        return bool(value)
    return fail(line, f"{name} is {_quoted(value)}", "True or False")


def as_name(line: Line, value: IniValue | None, name: str) -> str:
    """Return a word: an item's or a part's name."""
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    if not isinstance(value, str) or not is_name(value.strip()):
        fail(line, f"{name} is {_quoted(value)}", "a name: one word of printable ASCII without braces")
    return value.strip()


def as_class(line: Line, value: IniValue | None, name: str) -> str:
    """Return the name of a class without its package: SonarSensor of class'USARBot.SonarSensor'."""
    text = value.name if isinstance(value, Reference) else value
    if not isinstance(text, str) or not text.strip() or not text.strip().isprintable():
        fail(line, f"{name} is {_quoted(value)}", "a class, as in class'USARBot.SonarSensor'")
    return text.strip().rpartition(".")[2]


def as_struct(line: Line) -> Struct:
    """Return the value of a line that must be a struct."""
    if not isinstance(line.value, Struct) or not line.value.fields:
        fail(line, f"{key_text(line)} is {_quoted(line.value)}", "(Name=value,Name=value,...)")
    return line.value


def as_vector(line: Line, value: IniValue | None, name: str) -> Vec3:
    """Return (X, Y, Z); a missing axis is 0."""
    if not isinstance(value, Struct):
        fail(line, f"{name} is {_quoted(value)}", "(X=number,Y=number,Z=number)")
    axes = {key.lower(): as_number(line, part, f"{key} of {name}") for key, part in value.fields}
    if not axes.keys() <= {"x", "y", "z"}:
        fail(line, f"{name} has {', '.join(key for key, _ in value.fields)}", "X, Y and Z")
    return (axes.get("x", 0.0), axes.get("y", 0.0), axes.get("z", 0.0))


def vector_of(line: Line, struct: Struct, name: str, default: Vec3 = (0.0, 0.0, 0.0)) -> Vec3:
    """Return a vector of a struct, or the default if it is missing."""
    value = struct.get(name)
    return default if value is None else as_vector(line, value, name)


def number_of(
    line: Line, struct: Struct, name: str, default: float | None = None, *, above: float = -math.inf
) -> float:
    """Return a number of a struct, or the default unchecked; without a default it is required."""
    value = struct.get(name)
    if value is None and default is not None:
        return default
    if value is None:
        fail(line, f"{key_text(line)} has no {name}", f"{name}=number")
    return as_number(line, value, name, above=above)


def reject_unknown(line: Line, struct: Struct, allowed: Iterable[str]) -> None:
    """Raise SpecError for an unknown name within brackets."""
    known = list(allowed)
    lowered = {name.lower() for name in known}
    unknown = [key for key, _ in struct.fields if key.lower() not in lowered]
    if unknown:
        fail(line, f"{key_text(line)} has no {', '.join(unknown)}", f"some of {', '.join(known)}")


def _quoted(value: IniValue | None) -> str:
    """Return a value for a message."""
    return "not given" if value is None else quote_short(str(value))
