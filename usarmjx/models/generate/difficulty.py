"""Difficulty of a generated arena."""

from dataclasses import dataclass, fields
from typing import Annotated

from usarmjx.base.settings import SHARE, validate


@dataclass(frozen=True, kw_only=True)
class Difficulty:
    """Difficulty of a generated arena; every number is from 0, easy, to 1, hard.

    Arenas of one seed are nested: contents at 0.3 are also there at 0.6.

    Attributes:
        wall_density: Length of the inner walls; 1 gives a maze all its walls.
        roughness: Height of obstacles: boards, blocks, posts, slabs, ramps.
        clutter: Number of loose objects and fixed blocks beside the ways.
        dead_ends: Share of the dead ends that are kept; the others become loops. In buildings: share of the
            walls between rooms with only one doorway.
        radio_shadow: Share of the inner walls that are two sheets, which the radio counts as two walls.
        obstacles: Share of the rings of cells around the base that can only be crossed over obstacles; see
            `contents.place_obstacles`. Explicit only: `of` leaves it at 0.
        risk: Share of drives that fail at the highest of those obstacles, as measured (`crossings.json`); at
            0 every drive crosses them. Explicit only, too.
    """

    wall_density: Annotated[float, SHARE] = 0.5
    roughness: Annotated[float, SHARE] = 0.5
    clutter: Annotated[float, SHARE] = 0.5
    dead_ends: Annotated[float, SHARE] = 0.5
    radio_shadow: Annotated[float, SHARE] = 0.5
    obstacles: Annotated[float, SHARE] = 0.0
    risk: Annotated[float, SHARE] = 0.0

    def __post_init__(self) -> None:
        """Check the settings."""
        validate(self)

    @classmethod
    def of(cls, level: float) -> "Difficulty":
        """Return the difficulty with all numbers except obstacles and risk at one level, for curricula."""
        explicit = ("obstacles", "risk")
        return cls(**{field.name: level for field in fields(cls) if field.name not in explicit})
