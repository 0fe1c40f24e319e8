"""Where obstacles go: into rings of cells round the base, which whoever wants further must cross.

Cells that are equally many cells away from the base are a ring. In a ring with obstacles every cell that is
free has one.
"""

import math

from usarmjx.models.generate.contents import ArenaBuilder
from usarmjx.models.generate.crossings import highest_obstacle
from usarmjx.models.generate.obstacles import OBSTACLES, SLOPE, obstacle_height
from usarmjx.models.generate.plan import DIRECTIONS, START_CELL, Cell, CellGrid, edge, middle

STEEP = math.radians(25)
"""The steepest ridge where no drive may fail: steeper ones are hard on slick ground."""


def place_obstacles(builder: ArenaBuilder) -> None:
    """Put obstacles into rings of cells; more rings with more obstacles, the same ones first."""
    share, obstacle = builder.difficulty.obstacles, builder.kind.obstacle
    if not share:
        return
    draw, away = builder.random_stream("obstacles"), distances(builder.plan)
    rings = draw.shuffled(_rings(builder, away))
    left = min(builder.max_count("obstacles"), len(builder.plan.tree) // 2)
    heights = {name: ring_height(builder, name) for name in OBSTACLES.names()}
    for ring in rings[: math.ceil(share * len(rings))]:
        if len(ring) > left:
            continue
        left -= len(ring)
        for cell in ring:
            ways = _ways(builder.plan, cell)
            straight = len({way % 2 for way in ways}) == 1
            name = obstacle if straight else "posts"
            builder.shapes += OBSTACLES.get(name)(draw, middle(cell), heights[name], ways[0])
        builder.obstructed.update(ring)


def ring_height(builder: ArenaBuilder, kind: str) -> float:
    """Return how high obstacles of a kind are [m]."""
    highest = highest_obstacle(builder.robot, kind, builder.difficulty.risk)
    height = obstacle_height(builder.footprint, builder.difficulty.roughness, highest)
    return height if builder.difficulty.risk or kind != "ridge" else min(height, STEEP / SLOPE)


def _rings(builder: ArenaBuilder, away: dict[Cell, int]) -> list[list[Cell]]:
    """Return the rings that can have obstacles, no two of them side by side; what bars the way needs none."""
    farthest = max(away.values())
    rings: list[list[Cell]] = []
    for count in range(2, farthest, 2):
        cells = [cell for cell, found in away.items() if found == count and cell in builder.plan.tree]
        beyond = any(found > count for cell, found in away.items() if cell in builder.plan.tree)
        if cells and beyond and not builder.clear & set(cells):
            rings.append(cells)
    return rings


def distances(plan: CellGrid) -> dict[Cell, int]:
    """Return how many cells each cell is from the base, where no wall is in between."""
    found: dict[Cell, int] = {START_CELL: 0}
    front: list[Cell] = [START_CELL]
    for cell in front:
        for other in plan.around(cell):
            if other not in found and edge(cell, other) not in plan.walls:
                found[other] = found[cell] + 1
                front.append(other)
    return found


def _ways(plan: CellGrid, cell: Cell) -> list[int]:
    """Return in which directions a cell is left, in quarter turns."""
    ends = [(cell[0] + dx, cell[1] + dy) for dx, dy in DIRECTIONS]
    beside = plan.around(cell)
    return [i for i, end in enumerate(ends) if end in beside and edge(cell, end) not in plan.walls]
