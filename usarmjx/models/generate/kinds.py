"""The kinds of generated arenas: layouts of walls and ways, difficulty, and the limits of their contents."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Annotated

from usarmjx.base.random import RandomStream
from usarmjx.base.registry import Registry
from usarmjx.base.settings import SHARE, validate
from usarmjx.models.generate import obstacles
from usarmjx.models.generate.obstacles import MAX_OBSTACLE_SOLIDS, Maker
from usarmjx.models.generate.plan import MAX_WALL_CELLS, Cell, CellGrid, Edge, edge

MIN_WALL_PERCENT = {"maze": 40, "field": 10}
"""Share of a perfect maze's walls at wall density 0 [%]."""
MAX_WALL_PERCENT = {"maze": 100, "field": 45}
"""Share of a perfect maze's walls at wall density 1 [%]."""
MIN_CORRIDOR_CELLS = 5
"""Number of cells across from which on buildings have a corridor."""
MAX_LOOSE, MAX_VICTIMS, DEFAULT_STARTS, MAX_TAGS = 12, 16, 24, 16
"""Limits of contents in arenas of any size."""


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
            `arena.place_obstacles`. Explicit only: `of` leaves it at 0.
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


def wall_count(low: int, high: int, level: float, count: int) -> int:
    """Return the part of `count` for a level between 0 and 1, from `low` to `high` percent."""
    return round((low + (high - low) * level) * count / 100)


def maze(
    plan: CellGrid, draw: RandomStream, difficulty: Difficulty, *, barred: tuple[Cell, ...] = ()
) -> None:
    """Lay out a maze: perfect at wall density and dead ends 1."""
    plan.grow_tree(draw, bushy=False, barred=barred)
    _thin(plan, draw, difficulty, "maze", barred)


def open_field(
    plan: CellGrid, draw: RandomStream, difficulty: Difficulty, *, barred: tuple[Cell, ...] = ()
) -> None:
    """Lay out an open field with some pieces of wall."""
    plan.grow_tree(draw, bushy=True, barred=barred)
    _thin(plan, draw, difficulty, "field", barred)


def _thin(
    plan: CellGrid, draw: RandomStream, difficulty: Difficulty, kind: str, barred: tuple[Cell, ...]
) -> None:
    """Put walls wherever no way leads, then open dead ends and remove walls.

    The order does not depend on their number, so that arenas of one seed are nested.
    """
    ways = plan.tree
    closed = [(a, b) for a, b in plan.edges() if b not in ways.get(a, ())]
    # Barred cells are closed off at any density of walls.
    fixed = [(a, b) for a, b in closed if (a in barred) != (b in barred)]
    closed = [(a, b) for a, b in closed if a not in barred and b not in barred]
    ends = draw.shuffled([cell for cell in ways if len(ways[cell]) == 1])
    opened: set[Edge] = set()
    for rank, cell in enumerate(ends):
        sides = [n for n in plan.around(cell) if n not in ways[cell] and n in ways]
        if sides:
            # Drawn for each end, whether it opens or not: the draws of all others stay the same.
            side = draw.choice(sides)
            if rank >= round(difficulty.dead_ends * len(ends)):
                opened.add(edge(cell, side))
    keep = wall_count(MIN_WALL_PERCENT[kind], MAX_WALL_PERCENT[kind], difficulty.wall_density, len(closed))
    plan.walls = {*fixed, *draw.shuffled(closed)[:keep]} - opened


Room = tuple[int, int, int, int]
"""Columns from, to (excluded), rows from, to."""


def building(plan: CellGrid, draw: RandomStream, difficulty: Difficulty) -> None:
    """Lay out rooms and, where there is space, a corridor; every wall between rooms has a doorway.

    The largest room is divided repeatedly, as often as the wall density demands.
    """
    walls = _partitions(plan, draw)
    keep = wall_count(25, 100, difficulty.wall_density, len(walls))
    ranks = draw.shuffled(range(len(walls)))
    # There is a rank for every wall, also for those that are not kept.
    for wall, rank in zip(walls[:keep], ranks, strict=False):
        plan.walls.update(wall)
        doors = draw.shuffled(wall)
        # A second doorway makes a loop: the more dead ends are wanted, the fewer walls have one.
        both = len(doors) > 2 and rank >= round(difficulty.dead_ends * len(walls))
        plan.walls.difference_update(doors[: 1 + both])
    plan.grow_tree(draw, bushy=True)


def _partitions(plan: CellGrid, draw: RandomStream) -> list[list[Edge]]:
    """Return the walls that divide a building, each as its edges, the first ones first."""
    columns, rows = plan.size
    rooms: list[Room] = [(0, columns, 0, rows)]
    walls: list[list[Edge]] = []
    if min(columns, rows) >= MIN_CORRIDOR_CELLS:
        tall = rows > columns
        length = columns if tall else rows
        # At least two cells remain on either side of the corridor.
        at = draw.randint_between(2, length - 3)
        # Both walls of the corridor, which is one cell wide.
        for line in (at, at + 1):
            walls.append(_line(rooms[0], line, tall))
        rooms = [_part(rooms[0], 0, at, tall), _part(rooms[0], at + 1, length, tall)]
    while rooms:
        room = max(rooms, key=_area)
        rooms.remove(room)
        wide, deep = room[1] - room[0], room[3] - room[2]
        upright = wide >= deep
        length = max(wide, deep)
        # Each part of a divided room is at least two cells long.
        if length < 4:
            continue
        start = room[0] if upright else room[2]
        at = start + draw.randint_between(2, length - 2)
        walls.append(_line(room, at, upright))
        rooms += [_part(room, start, at, upright), _part(room, at, start + length, upright)]
    return walls


def _area(room: Room) -> int:
    return (room[1] - room[0]) * (room[3] - room[2])


def _part(room: Room, start: int, stop: int, upright: bool) -> Room:
    """Return the part of a room between two lines."""
    return (start, stop, room[2], room[3]) if upright else (room[0], room[1], start, stop)


def _line(room: Room, at: int, upright: bool) -> list[Edge]:
    """Return the edges along a line across a room."""
    if upright:
        return [((at - 1, row), (at, row)) for row in range(room[2], room[3])]
    return [((column, at - 1), (column, at)) for column in range(room[0], room[1])]


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
        structure=obstacles.rubble,
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
        structure=obstacles.steps,
        obstacle="posts",
        structure_percent=12,
        max_solids=obstacles.STEP_FIELD_POSTS**2,
    ),
)


KINDS.add(
    "ramps",
    ArenaKind(
        about="Ramps of 15 degrees, and a second floor along one side.",
        layout=open_field,
        structure=obstacles.ramps,
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
        structure=obstacles.collapsed,
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
    # Rounded up: straight walls are cut at their largest length.
    outer = 2 * (-(-columns // MAX_WALL_CELLS) - (-rows // MAX_WALL_CELLS))
    # Along a line at most every other cell begins a run of wall, and every wall may have two sheets.
    inner = 2 * ((columns - 1) * -(-rows // 2) + (rows - 1) * -(-columns // 2))
    shapes = outer + inner + most["blocks"] + most["boards"] + made.structures(size) * made.max_solids
    shapes += most["obstacles"] * MAX_OBSTACLE_SOLIDS
    # A slab on two walls over each victim; two ramps and a deck upstairs.
    shapes += 3 * most["victims"] * made.voids + 3 * made.second_floor
    return Budget(
        shapes=shapes,
        loose=most["loose"],
        victims=most["victims"],
        starts=min(DEFAULT_STARTS, columns * rows),
        tags=most["tags"],
    )
