"""Maps of arenas: which squares of the floor fixed solids fill."""

import math

import numpy as np

from usarmjx.models.compile.raster import Grid, rasterize
from usarmjx.models.types.arena import ArenaSpec

CELL = 0.05
"""Side of a map's square [m]; doubled until there are no more than `MOST_SQUARES`."""
MOST_SQUARES = 1_000_000
LOWEST, HIGHEST = 0.1, 0.6
"""Heights above the floor between which a solid is an obstacle [m]."""
MARGIN = 0.5
"""Margin of the map around the arena's extent [m]."""


def floor_map(arena: ArenaSpec) -> tuple[Grid, np.ndarray]:
    """Return the squares of an arena's map, and which of them a fixed solid fills (i, j).

    Solids are widened by half a square on each side. Loose objects and doors are left out.
    """
    cell, spans = CELL, [(low - MARGIN, high + MARGIN) for low, high in arena.extent]
    while math.prod((high - low) / cell for low, high in spans) > MOST_SQUARES:
        cell *= 2
    columns, rows = (max(1, math.ceil((high - low) / cell)) for low, high in spans)
    grid = Grid(low=(spans[0][0], spans[1][0]), cell=cell, shape=(columns, rows))
    table = rasterize(arena.shapes, grid)
    blocks = (table.high > LOWEST) & (table.low < HIGHEST)  # above the floor
    filled = np.zeros(grid.shape, bool)
    filled.reshape(-1)[table.square[blocks]] = True
    return grid, filled
