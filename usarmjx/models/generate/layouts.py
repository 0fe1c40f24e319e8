"""Layouts of walls and ways on the grid of a generated arena: mazes, open fields, buildings."""

from usarmjx.models.generate.difficulty import Difficulty
from usarmjx.models.generate.plan import Cell, CellGrid, Edge, edge
from usarmjx.models.generate.random_stream import RandomStream

MIN_WALL_PERCENT = {"maze": 40, "field": 10}
"""Share of a perfect maze's walls at wall density 0 [%]."""


MAX_WALL_PERCENT = {"maze": 100, "field": 45}
"""Share of a perfect maze's walls at wall density 1 [%]."""


MIN_CORRIDOR_CELLS = 5
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
    if min(columns, rows) >= MIN_CORRIDOR_CELLS:
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
