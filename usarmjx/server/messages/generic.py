"""What the server says of sensors without a message of the manual's: what they say of themselves."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from usarmjx.models.spec.settings import camel_case, field_names
from usarmjx.sensors.base import NoisySensorSettings, Sensor
from usarmjx.sensors.quantities import Quantity
from usarmjx.server.protocol.descriptions import ConfField
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.protocol.grammar import Message, Segment, check_word, four_decimals, four_decimals_list

T = TypeVar("T")

_COMMON = frozenset(field.name for field in dataclasses.fields(NoisySensorSettings))

_WORDS: dict[str, Callable[[Sequence[float]], str]] = {
    "number": lambda numbers: four_decimals(numbers[0]),
    "count": lambda numbers: str(round(numbers[0])),
    "flag": lambda numbers: str(bool(numbers[0])),
    "yaw": lambda numbers: four_decimals(flip_wire_angles((0.0, 0.0, numbers[0]))[2]),
    "vector": lambda numbers: four_decimals_list(flip_wire_vector(numbers)),
    "angles": lambda numbers: four_decimals_list(flip_wire_angles(numbers)),
}
"""How each of `sensors.quantities.FORMS` is written, in the wire's axes."""


def lookup_by_type(sensor: Sensor, table: Mapping[str, T]) -> T | None:
    """Return what a table has of a sensor's type, or of the nearest type that it is derived from.

    None: there is nothing, or a type before says itself what its value is.
    """
    for base in type(sensor).__mro__:
        own = vars(base)
        if own.get("quantities"):
            return None
        if own.get("kind") in table:
            return table[own["kind"]]
    return None


def of_type(kind: str, message: Message) -> Message:
    """Return a SEN as one of that type."""
    if ("Type", kind) in message.segments:
        return message
    segments = tuple((key, kind if key == "Type" else text) for key, text in message.segments)
    return Message(message.kind, segments)


def report(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    """Return the SEN of a reading: its quantities, as `Sensor.quantities` lists them, in that order.

    Without such a list all numbers are one `{Value ...}`. Sensors that report together have a segment each,
    `{Name F1 Range 1.0000}`, others a segment for each quantity.

    Args:
        sensor: The sensor.
        value: Its reading, in our axes (...,); of a group (mounts, ...).
        time: Simulated time [s]; None leaves it out.
    """
    head: tuple[Segment, ...] = () if time is None else (("Time", four_decimals(time)),)
    rows = np.asarray(value, float).reshape(len(sensor.mounts) if sensor.grouped else 1, -1).tolist()
    segments: list[Segment] = []
    for mount, row in zip(sensor.mounts, rows, strict=False):
        pairs = _pairs(sensor.quantities, row)
        if sensor.grouped:
            words = " ".join(f"{key} {text}" for key, text in pairs)
            segments.append(("Name", f"{check_word(mount.name)} {words}"))
        else:
            segments += [("Name", mount.name), *pairs]
    return Message("SEN", (*head, ("Type", sensor.kind), *segments))


def _pairs(quantities: Sequence[Quantity], numbers: Sequence[float]) -> list[Segment]:
    """Return key and text of each quantity."""
    if not quantities:
        return [("Value", four_decimals_list(numbers))]
    pairs, start = [], 0
    for quantity in quantities:
        end = start + quantity.size
        pairs.append((quantity.key, _WORDS[quantity.form](numbers[start:end])))
        start = end
    return pairs


def fields(settings: object) -> list[ConfField]:
    """Return what CONF says of a sensor: those of its settings that are its own, and one number or word."""
    names = field_names(type(settings)).items()
    pairs = [(camel_case(name), getattr(settings, field)) for name, field in names if field not in _COMMON]
    return [(key, value) for key, value in pairs if isinstance(value, bool | int | float | str)]
