"""The wireless protocols' view of the world: its robots, and the power received between two of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from usarmjx.base.transforms import Vec3


@dataclass(frozen=True, slots=True)
class RadioRobot:
    """A robot in the world; a base station is one too.

    Attributes:
        name: Its name on the wire.
        position: Its chassis origin, in our axes [m].
        battery_empty: Whether it has used up its battery.
    """

    name: str
    position: Vec3
    battery_empty: bool = False


class RadioAccess(Protocol):
    """The radio of one world at this moment. Names are those of INIT, in any case; the first match counts.

    Attributes:
        cutoff: Below this power there is no link [dBm].
    """

    cutoff: float

    def present(self) -> Sequence[RadioRobot]:
        """Return all robots in the world."""
        ...

    def has_robot(self, name: str) -> bool:
        """Return whether a robot of that name is in the world."""
        ...

    def signal_strength(self, one: str, other: str) -> float | None:
        """Return the power received between two robots [dBm]; None if either is not in the world."""
        ...

    def obstacles(self, one: str, other: str) -> int | None:
        """Return how many solids lie between two robots; None if either is not in the world."""
        ...

    def obstacles_between(self, start: Vec3, end: Vec3) -> int:
        """Return how many solids lie between two positions, in our axes [m]."""
        ...


def reaches(radio: RadioAccess, one: str, other: str) -> bool:
    """Return whether two robots hear each other: both are there, and the power is not below the cutoff."""
    power = radio.signal_strength(one, other)
    return power is not None and power >= radio.cutoff
