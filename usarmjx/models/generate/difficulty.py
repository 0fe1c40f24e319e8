"""How difficult a generated arena is."""

from dataclasses import dataclass, fields

from usarmjx.base.errors import SpecError


@dataclass(frozen=True, kw_only=True)
class Difficulty:
    """How difficult a generated arena is; every number is from 0, easy, to 1, hard.

    One seed gives the same arena with more or less of something: what it has at 0.3, it has at 0.6 too.

    Attributes:
        wall_density: Length of the inner walls; at 1 a maze has all that a maze can have.
        roughness: Height of obstacles: boards, blocks, posts, slabs, ramps.
        clutter: Number of loose objects and fixed blocks beside the ways.
        dead_ends: Share of the dead ends that are kept: without, ways lead around in circles. In buildings:
            share of the walls between rooms with only one doorway.
        radio_shadow: Share of the inner walls that are two sheets, which the radio counts as two walls.
        obstacles: Share of the rings of cells round the base that can only be crossed over obstacles; see
            `generate.rings`. Asked for by itself: `of` leaves it at 0.
        risk: Share of drives that fail at the highest of those obstacles, as measured (`generate.crossings`);
            at 0 every drive gets over them. Asked for by itself, too.
    """

    wall_density: float = 0.5
    roughness: float = 0.5
    clutter: float = 0.5
    dead_ends: float = 0.5
    radio_shadow: float = 0.5
    obstacles: float = 0.0
    risk: float = 0.0

    def __post_init__(self) -> None:
        """Refuse numbers out of range."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value <= 1.0:  # nor not a number
                raise SpecError(f"difficulty {field.name} is {value}, expected from 0 to 1")

    @classmethod
    def of(cls, level: float) -> "Difficulty":
        """Return the difficulty with all numbers but obstacles and risk at one level, for curricula."""
        asked_for = ("obstacles", "risk")
        return cls(**{field.name: level for field in fields(cls) if field.name not in asked_for})
