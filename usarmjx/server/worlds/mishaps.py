"""What goes wrong with a served world's physics."""

from dataclasses import dataclass


@dataclass
class Mishaps:
    """What has happened to a world's physics so far.

    Attributes:
        put_back: Robots and objects that went bad and were put back.
        resets: How often the whole world was reset for that.
        names: What was put back last.
    """

    put_back: int = 0
    resets: int = 0
    names: tuple[str, ...] = ()
