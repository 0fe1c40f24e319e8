"""Messages about victims and RFID tags: SEN of the sensors that find them, RES of reading tags.

Lines are as captured (VictSensor, RFID, CO2Sensor) or as the manual's examples (HumanMotion, Sound; 9.3).
"""

import re
from collections.abc import Callable, Mapping, MutableMapping

import numpy as np

from usarmjx.models.compile.tags import tag_ids
from usarmjx.models.compile.victims import PART_NAMES
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.sensors.base import Sensor
from usarmjx.server.protocol.commands import Set
from usarmjx.server.protocol.frames import flip_wire_vector
from usarmjx.server.protocol.grammar import Message, Segment, four_decimals, two_decimals, two_decimals_list
from usarmjx.server.protocol.reports import STATUS_FAILED, STATUS_OK

EMPTY_MEMORY = "0"
"""Reported text of a tag without memory (manual 10.9.4); writing it erases the tag (10.9.7)."""
MAX_TAG_TEXT = 256
"""Longest text of a tag [characters] (chosen): sixteen tags with their texts fit into one line."""
_PARAMS = re.compile(r"\s*(\d{1,9})\s*(.*)", re.DOTALL)

TagTexts = Mapping[int, str]
"""Memory of tags, by ID; tags that are absent are empty."""


def _line(sensor: Sensor, time: float | None, *segments: Segment, named: bool = True) -> Message:
    head: tuple[Segment, ...] = () if time is None else (("Time", four_decimals(time)),)
    name: tuple[Segment, ...] = (("Name", sensor.mounts[0].name),) if named else ()
    return Message("SEN", (*head, ("Type", sensor.kind), *name, *segments))


def victims(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    """Return the parts that a VictSensor sees; without any the line has a status and no name (captured).

    Args:
        sensor: The sensor.
        value: Its reading; see `sensors.victim.VictSensor` (boxes, 5).
        time: Simulated time [s]; None leaves it out.
    """
    parts: list[Segment] = []
    for seen, part, *pos in value.tolist():
        if seen:
            # Captured lines have a Location behind each PartName; clients pair them by that order.
            parts += [
                ("PartName", PART_NAMES[int(part)]),
                ("Location", two_decimals_list(flip_wire_vector(pos))),
            ]
    if not parts:
        return _line(sensor, time, ("Status", "NoVictims"), named=False)
    return _line(sensor, time, *parts)


def tags(
    sensor: Sensor, value: np.ndarray, time: float | None, texts: TagTexts | None = None
) -> Message | None:
    """Return the tags that an RFID sensor reads; None, and no line, without any (manual 10.9.4).

    Args:
        sensor: The sensor.
        value: Its reading; see `sensors.rfid.Rfid` (tags, 5).
        time: Simulated time [s]; None leaves it out.
        texts: Memory of tags.
    """
    items: list[Segment] = []
    for read, number, *pos in value.tolist():
        if read:
            items += [("ID", str(int(number))), ("Location", two_decimals_list(flip_wire_vector(pos)))]
            if sensor.settings[0].always_read_rfid_mem:
                items.append(("Mem", (texts or {}).get(int(number), "") or EMPTY_MEMORY))
    return _line(sensor, time, *items) if items else None


def sound(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    """Return the loudest sound: loudness and duration [s] (2,)."""
    loudness, duration = value.tolist()
    return _line(sensor, time, ("Loudness", two_decimals(loudness)), ("Duration", two_decimals(duration)))


def human_motion(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    """Return the probability of human motion ()."""
    return _line(sensor, time, ("Prob", two_decimals(float(value))))


def co2(sensor: Sensor, value: np.ndarray, time: float | None) -> Message:
    """Return the density of CO2 ()."""
    return _line(sensor, time, ("Gas", "CO2"), ("Density", two_decimals(float(value))))


REPORTS: dict[str, Callable[[Sensor, np.ndarray, float | None], Message | None]] = {
    "VictSensor": victims,
    "RFID": tags,
    "Sound": sound,
    "HumanMotion": human_motion,
    "CO2Sensor": co2,
}

CONFIGURATION: dict[str, tuple[tuple[str, str], ...]] = {
    "VictSensor": (
        ("MaxRange", "distance"),
        ("HorizontalFOV", "horizontal_fov"),
        ("VerticalFOV", "vertical_fov"),
    ),
    "RFID": (("MaxRange", "max_range"),),
    "Sound": (("Noise", "noise"),),
    "HumanMotion": (("MaxRange", "max_range"), ("FOV", "fov_radians")),
    "CO2Sensor": (("Noise", "noise"),),
}
"""CONF of these sensors, as `sensors.CONFIGURATION`; that of VictSensor is the original's."""


def initial_tag_texts(arena: ArenaSpec) -> dict[int, str]:
    """Return the memory of an arena's tags, by ID."""
    return {number: tag.memory for number, tag in zip(tag_ids(arena.tags), arena.tags, strict=True)}


def access_tag(
    command: Set, time: float, texts: MutableMapping[int, str], reaches: Callable[[int], bool]
) -> Message:
    """Read, write or erase the memory of an RFID tag (manual 10.9.5 to 10.9.7); return the RES.

    It fails for tags out of range, unknown IDs, other opcodes, a Read with more than an ID, and texts that
    are too long or that no line can carry.

    Args:
        command: SET of an RFID sensor; its parameters are an ID and, of Write, a text. A missing space
            between the two is accepted, unless the text starts with a digit.
        time: Simulated time [s].
        texts: Memory of tags; Write changes it.
        reaches: Whether the last reading of the sensor has a tag of that ID.
    """
    echo = (("Time", two_decimals(time)), ("Type", command.type), ("Name", command.name))
    failed = Message("RES", (*echo, ("Status", STATUS_FAILED)))
    found, opcode = _PARAMS.fullmatch(command.params), command.opcode.lower()
    if found is None or opcode not in ("read", "write"):
        return failed
    number, text = int(found.group(1)), found.group(2).strip()
    if not reaches(number) or (opcode == "read" and text):
        return failed
    if opcode == "read":
        memory = texts.get(number, "") or EMPTY_MEMORY
        return Message("RES", (*echo, ("Status", STATUS_OK), ("ID", str(number)), ("Mem", memory)))
    # Braces and line ends would end the segment early in every later line that quotes this tag.
    if len(text) > MAX_TAG_TEXT or set(text) & set("{}\r\n"):
        return failed
    # The manual erases with the text that an empty tag reports (10.9.7).
    texts[number] = "" if text == EMPTY_MEMORY else text
    return Message("RES", (*echo, ("Status", STATUS_OK)))
