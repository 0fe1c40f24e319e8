"""The kinds of generated arenas, and the limits of their contents."""

from collections.abc import Callable
from dataclasses import dataclass

from usarmjx.base.registry import Registry
from usarmjx.models.generate import structures
from usarmjx.models.generate.layouts import building, maze, open_field
from usarmjx.models.generate.obstacles import MAX_OBSTACLE_SOLIDS
from usarmjx.models.generate.plan import MAX_WALL_CELLS
from usarmjx.models.generate.structures import Maker

MAX_LOOSE, MAX_VICTIMS, DEFAULT_STARTS, MAX_TAGS = 12, 16, 24, 16
"""Limits of contents in arenas of any size."""


@dataclass(frozen=True, kw_only=True)
class ArenaKind:
    """A kind of generated arena.

    Attributes:
        about: Description, in one sentence.
        layout: Function that lays out walls and ways, from a plan, draws and a difficulty.
        structure: Maker of impassable structures; None: none.
        structure_percent: Share of cells with a structure [%].
        max_solids: Largest number of solids of a structure.
        voids: Whether victims lie under slabs.
        second_floor: Whether a second floor lies along the last row.
        obstacle: Kind of obstacle at difficulties with obstacles; a name of `obstacles.OBSTACLES`.
    """

    about: str
    layout: Callable[..., None]
    structure: Maker | None = None
    structure_percent: int = 0
    max_solids: int = 0
    voids: bool = False
    second_floor: bool = False
    obstacle: str = "bars"

    def structures(self, size: tuple[int, int]) -> int:
        """Return the number of cells with structures."""
        return size[0] * size[1] * self.structure_percent // 100


KINDS: Registry[ArenaKind] = Registry("kind of arena")
"""Kinds of arenas by name."""
KINDS.add("maze", ArenaKind(about="Corridors one cell wide.", layout=maze))
KINDS.add("building", ArenaKind(about="Rooms with doorways, and a corridor.", layout=building))
KINDS.add(
    "rubble",
    ArenaKind(
        about="An open field with heaps of slabs and blocks.",
        layout=open_field,
        structure=structures.rubble,
        obstacle="slabs",
        structure_percent=25,
        max_solids=4,
    ),
)
KINDS.add(
    "steps",
    ArenaKind(
        about="Step fields of posts between some walls.",
        layout=open_field,
        structure=structures.steps,
        obstacle="posts",
        structure_percent=12,
        max_solids=structures.POSTS**2,
    ),
)
KINDS.add(
    "ramps",
    ArenaKind(
        about="Ramps of 15 degrees, and a second floor along one side.",
        layout=open_field,
        structure=structures.ramps,
        obstacle="ridge",
        structure_percent=20,
        max_solids=1,
        second_floor=True,
    ),
)
KINDS.add(
    "collapsed",
    ArenaKind(
        about="A building whose ceiling has come down in places; victims in voids.",
        layout=building,
        structure=structures.collapsed,
        obstacle="slabs",
        structure_percent=20,
        max_solids=3,
        voids=True,
    ),
)


@dataclass(frozen=True)
class Budget:
    """Limits of all contents of a kind for a size."""

    shapes: int
    loose: int
    victims: int
    starts: int
    tags: int


def counts(size: tuple[int, int]) -> dict[str, int]:
    """Return the limits of loose objects, fixed blocks, boards, obstacles, victims and tags for a size."""
    cells = size[0] * size[1]
    return {
        "loose": min(MAX_LOOSE, cells // 4),
        "blocks": cells // 8,
        "boards": cells // 10,
        "obstacles": cells // 5,
        "victims": min(MAX_VICTIMS, max(1, cells // 8)),
        "tags": min(MAX_TAGS, cells // 8),
    }


def budget(kind: str, size: tuple[int, int]) -> Budget:
    """Return the limits of all contents of a kind for a size in cells, at any difficulty.

    Raises:
        UnknownNameError: No such kind.
    """
    made, most, (columns, rows) = KINDS.get(kind), counts(size), size
    outer = 2 * (-(-columns // MAX_WALL_CELLS) - (-rows // MAX_WALL_CELLS))
    inner = 2 * ((columns - 1) * -(-rows // 2) + (rows - 1) * -(-columns // 2))  # every wall of two sheets
    shapes = outer + inner + most["blocks"] + most["boards"] + made.structures(size) * made.max_solids
    shapes += most["obstacles"] * MAX_OBSTACLE_SOLIDS
    shapes += 3 * most["victims"] * made.voids + 3 * made.second_floor
    return Budget(
        shapes=shapes,
        loose=most["loose"],
        victims=most["victims"],
        starts=min(DEFAULT_STARTS, columns * rows),
        tags=most["tags"],
    )
