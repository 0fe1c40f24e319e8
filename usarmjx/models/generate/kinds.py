"""The kinds of generated arenas, and the limits of their contents."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from usarmjx.base.errors import SpecError
from usarmjx.base.registry import Registry
from usarmjx.models.generate import structures
from usarmjx.models.generate.difficulty import Difficulty
from usarmjx.models.generate.draw import RandomStream
from usarmjx.models.generate.obstacles import HIGHEST, LOWEST, MOST_SOLIDS
from usarmjx.models.generate.plan import LONGEST, Cell, CellGrid, Edge, edge
from usarmjx.models.generate.structures import Maker

CROSSINGS_FILE = "crossings.json"

SuccessCurve = Sequence[tuple[float, float]]
"""Heights over the robot's step, ascending, with the share of drives that crossed such obstacles."""


@cache
def measured_crossings() -> Mapping[str, Mapping[str, SuccessCurve]]:
    """Return the measured success curves, by class and kind of obstacle."""
    return json.loads(files("usarmjx.models.generate").joinpath(CROSSINGS_FILE).read_text(encoding="utf-8"))[
        "classes"
    ]


def highest_at(curve: SuccessCurve, success: float) -> float:
    """Return the largest height over the step at which at least that share of the drives succeeds.

    The curve is made monotonic and interpolated linearly.
    """
    held, share = curve[0]
    for height, found in curve[1:]:
        found = min(found, share)
        if found < success:
            return held + (height - held) * (share - success) / (share - found) if share > success else held
        held, share = height, found
    return held


def highest_obstacle(robot: str, kind: str, risk: float) -> float:
    """Return the height of the highest obstacles for a class, over its step.

    Args:
        robot: The class; "" if only a footprint is known.
        kind: A name of `obstacles.OBSTACLES`.
        risk: Share of the drives that may fail. At 0, obstacles are no higher than the step, and than the
            height that every drive crossed; unmeasured classes are assumed to climb their step.

    Raises:
        SpecError: A risk for a class that was not measured.
    """
    known = measured_crossings()
    curve = known.get(robot, {}).get(kind)
    if curve is None:
        if risk:
            there = ", ".join(known)
            raise SpecError(f"a risk of {risk:g} for {robot or 'a footprint'}: measured are {there}")
        return HIGHEST
    return max(LOWEST, highest_at(curve, 1.0 - risk)) if risk else min(HIGHEST, highest_at(curve, 1.0))


SPARSEST = {"maze": 40, "field": 10}
"""Share of a perfect maze's walls at wall density 0 [%]."""
DENSEST = {"maze": 100, "field": 45}
"""Share of a perfect maze's walls at wall density 1 [%]."""
CORRIDOR_WIDTH = 5
"""Number of cells across from which on buildings have a corridor."""


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
    fixed = [(a, b) for a, b in closed if (a in barred) != (b in barred)]
    closed = [(a, b) for a, b in closed if a not in barred and b not in barred]
    ends = draw.shuffled([cell for cell in ways if len(ways[cell]) == 1])
    opened: set[Edge] = set()
    for rank, cell in enumerate(ends):
        sides = [n for n in plan.around(cell) if n not in ways[cell] and n in ways]
        if sides:
            side = draw.choice(sides)
            if rank >= round(difficulty.dead_ends * len(ends)):
                opened.add(edge(cell, side))
    keep = wall_count(SPARSEST[kind], DENSEST[kind], difficulty.wall_density, len(closed))
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
    for wall, rank in zip(walls[:keep], ranks, strict=False):
        plan.walls.update(wall)
        doors = draw.shuffled(wall)
        both = len(doors) > 2 and rank >= round(difficulty.dead_ends * len(walls))
        plan.walls.difference_update(doors[: 1 + both])
    plan.grow_tree(draw, bushy=True)


def _partitions(plan: CellGrid, draw: RandomStream) -> list[list[Edge]]:
    """Return the walls that divide a building, each as its edges, the first ones first."""
    columns, rows = plan.size
    rooms: list[Room] = [(0, columns, 0, rows)]
    walls: list[list[Edge]] = []
    if min(columns, rows) >= CORRIDOR_WIDTH:
        tall = rows > columns
        length = columns if tall else rows
        at = draw.randint_between(2, length - 3)
        for line in (at, at + 1):
            walls.append(_line(rooms[0], line, tall))
        rooms = [_part(rooms[0], 0, at, tall), _part(rooms[0], at + 1, length, tall)]
    while rooms:
        room = max(rooms, key=_area)
        rooms.remove(room)
        wide, deep = room[1] - room[0], room[3] - room[2]
        upright = wide >= deep
        length = max(wide, deep)
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


MOST_LOOSE, MOST_VICTIMS, USUAL_STARTS, MOST_TAGS = 12, 16, 24, 16
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
        "loose": min(MOST_LOOSE, cells // 4),
        "blocks": cells // 8,
        "boards": cells // 10,
        "obstacles": cells // 5,
        "victims": min(MOST_VICTIMS, max(1, cells // 8)),
        "tags": min(MOST_TAGS, cells // 8),
    }


def budget(kind: str, size: tuple[int, int]) -> Budget:
    """Return the limits of all contents of a kind for a size in cells, at any difficulty.

    Raises:
        UnknownNameError: No such kind.
    """
    made, most, (columns, rows) = KINDS.get(kind), counts(size), size
    outer = 2 * (-(-columns // LONGEST) - (-rows // LONGEST))
    inner = 2 * ((columns - 1) * -(-rows // 2) + (rows - 1) * -(-columns // 2))  # every wall of two sheets
    shapes = outer + inner + most["blocks"] + most["boards"] + made.structures(size) * made.max_solids
    shapes += most["obstacles"] * MOST_SOLIDS
    shapes += 3 * most["victims"] * made.voids + 3 * made.second_floor
    return Budget(
        shapes=shapes,
        loose=most["loose"],
        victims=most["victims"],
        starts=min(USUAL_STARTS, columns * rows),
        tags=most["tags"],
    )
