"""Arguments of a client's commands: one table and one validator.

A word where a number belongs, too few numbers, too many, or a number out of range makes a line or a SET
invalid as a whole: nothing changes. Numbers keep the forms that real controllers send: `.4`, vectors with
commas or spaces. A decimal comma is refused: cut as the original cut it, `2,5` would be another number. In a
vector without spaces a comma always separates.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from usarmjx.base.errors import PeerError
from usarmjx.base.settings import Parameters, Setting
from usarmjx.server.protocol.commands import DRIVE_KEYS
from usarmjx.server.protocol.grammar import Message, clip, is_number, split_vector, to_float

ANY_KEY = "*"
"""Key of the table that stands for each key of a message without an entry of its own."""
_NO_LIMITS = Setting()
_TRUTHS = ("true", "false")


class ArgumentKind(Enum):
    """Form of an argument, in words."""

    NUMBER = "a number"
    TRUTH = "True, False or a number"
    VECTOR = "three numbers"
    NUMBERS = "numbers"
    POINTS = "points of three numbers, separated by semicolons"


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument of a command.

    Attributes:
        kind: Its form.
        note: Its unit; limits belong to the robot, which holds its orders within them.
    """

    kind: ArgumentKind = ArgumentKind.NUMBER
    note: Setting = _NO_LIMITS

    @property
    def expects(self) -> str:
        """The form in words, with limits and unit."""
        return f"{self.kind.value}{self.note.limits_and_unit}"


_NUMBER, _TRUTH = Argument(), Argument(ArgumentKind.TRUTH)
_ANGLE, _SPIN = Argument(note=Setting(unit="rad")), Argument(note=Setting(unit="rad/s"))
_SPEED, _SECONDS = Argument(note=Setting(unit="m/s")), Argument(note=Setting(unit="s"))
_DRIVE_UNITS = {
    **dict.fromkeys(("FrontSteer", "RearSteer", "Rudder", "SternPlane", "XZAngle"), _ANGLE),
    **dict.fromkeys(("AltitudeVelocity", "LinearVelocity", "LateralVelocity", "ThrustPropeller"), _SPEED),
}
ARGUMENTS: dict[str, dict[str, Argument]] = {
    "INIT": {
        # Those that are missing are 0, and a fourth is dropped: the manual itself prints one (5.3.3).
        "Location": Argument(ArgumentKind.NUMBERS, Setting(unit="m")),
        "Rotation": Argument(ArgumentKind.NUMBERS, Setting(unit="rad")),
    },
    "DRIVE": {
        **{key: _DRIVE_UNITS.get(key, _SPIN) for key in DRIVE_KEYS},
        **{"Normalized": _TRUTH, "Light": _TRUTH, "Flip": _TRUTH},
        **{"WheelNumber": _NUMBER, "WheelSpeed": _SPIN, "WheelSteer": _ANGLE},
        **{"Order": _NUMBER, "Value": _NUMBER, "Steer": _ANGLE},
    },
    "MULTIDRIVE": {ANY_KEY: _ANGLE},
    "MISPKG": {
        **{"Link": _NUMBER, "Value": _NUMBER, "Order": _NUMBER, "Gripper": _NUMBER},
        "Rotation": Argument(ArgumentKind.VECTOR, Setting(unit="rad")),
    },
    "CONTROL": {
        **dict.fromkeys(("Location", "MinPos", "MaxPos"), Argument(ArgumentKind.VECTOR, Setting(unit="m"))),
        "Rotation": Argument(ArgumentKind.VECTOR, Setting(unit="rad")),
        "Scale": Argument(ArgumentKind.VECTOR, Setting()),
        **dict.fromkeys(("Permanent", "Move", "Loop", "Autoalign", "Show", "ResetOnClear"), _TRUTH),
        "Speed": Argument(ArgumentKind.NUMBERS),  # one number of SetWP and Conveyor, three of Rotate
        "Time": _SECONDS,
        "WP": Argument(ArgumentKind.POINTS, Setting(unit="m")),
    },
    "SET": {},  # those of its opcodes: see `read_parameters`
    "TRACE": {"On": _TRUTH, "Interval": _SECONDS},
    "CAMERA": {
        "Rotation": Argument(ArgumentKind.VECTOR, Setting(unit="rad")),
        **{"Order": _NUMBER, "Zoom": _ANGLE},
    },
}
"""Arguments that are no words, by head and key. A head without an entry has none."""
# Keys count in any case: the original compared them so, and controllers spell them as they like.
_BY_LOWER_CASE = {
    head: {key.lower(): argument for key, argument in arguments.items()}
    for head, arguments in ARGUMENTS.items()
}
_REPEATED = {
    "DRIVE": frozenset({"wheelnumber", "wheelspeed", "wheelsteer"}),
    "MISPKG": frozenset({"link", "value", "order"}),
}
"""Keys that stand for one item each time; of others the first counts."""


def check_arguments(message: Message) -> None:
    """Do nothing if every argument of a message has its form; a key without a value has.

    Raises:
        PeerError: Names the argument, and what it may be.
    """
    known = _BY_LOWER_CASE.get(message.kind)
    if not known:
        return
    repeated, seen = _REPEATED.get(message.kind, frozenset[str]()), set[str]()
    for key, value in message.segments:
        field = key.lower()
        # The keys of a MULTIDRIVE are names of joints, which no table can list.
        argument = known.get(field) or known.get(ANY_KEY)
        # Only the first of a repeated key counts, so a later one may be anything.
        if value and argument is not None and field not in seen and not _MATCHES[argument.kind](value):
            raise PeerError(f"{clip(key)} is {clip(value)}; expected {argument.expects}")
        if field not in repeated:
            seen.add(field)


def _is_truth(text: str) -> bool:
    return text.strip().lower() in _TRUTHS or is_number(text)


def _is_vector(text: str) -> bool:
    return len(split_vector(text)) == 3 and _are_numbers(text)


def _are_numbers(text: str) -> bool:
    # With spaces a comma inside a part is its decimal comma, which is refused: its tail would be lost.
    return all(map(is_number, split_vector(text)))


def _is_points(text: str) -> bool:
    points = [split_vector(point) for point in text.split(";") if point.strip()]
    return bool(points) and all(len(point) == 3 and all(map(is_number, point)) for point in points)


_MATCHES: dict[ArgumentKind, Callable[[str], bool]] = {
    ArgumentKind.NUMBER: is_number,
    ArgumentKind.TRUTH: _is_truth,
    ArgumentKind.VECTOR: _is_vector,
    ArgumentKind.NUMBERS: _are_numbers,
    ArgumentKind.POINTS: _is_points,
}


def read_parameters(text: str, form: Parameters) -> tuple[float, ...]:
    """Return the numbers of the `Params` of a SET.

    Raises:
        PeerError: A word stands among them, there are too few or too many, or one is out of range; names
            the text, and what it may be.
    """
    parts = split_vector(text)
    # Each part is checked before any is read: `to_float` reads a word as 0, which may be a legal value.
    fits = form.fewest <= len(parts) <= form.most and all(map(is_number, parts))
    values = tuple(map(to_float, parts)) if fits else ()
    if not fits or not all(map(form.note.admits, values)):
        raise PeerError(f"Params is {clip(text)}; expected {form.expects}")
    return values
