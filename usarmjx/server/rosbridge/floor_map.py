"""The arena's map for robots that drive on its floor, as an OccupancyGrid."""

import math

import numpy as np

from usarmjx.models.build.raster import Grid, rasterize
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.motion import MAP, pose

CELL = 0.05
"""Side of a square [m]; doubled until there are no more than `MOST_SQUARES`."""
MOST_SQUARES = 1_000_000
LOWEST, HIGHEST = 0.1, 0.6
"""What fills a part of this above the floor is in the way [m]."""
MARGIN = 0.5
"""Around the arena's extent [m]."""
OCCUPIED = 100


def floor_map(arena: ArenaSpec) -> tuple[Grid, np.ndarray]:
    """Return the squares of an arena's map, and which of them a fixed solid fills (i, j).

    Solids are half a square wider than they are on each side. Loose objects and doors are left out.
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


def occupancy_grid(version: RosVersion, floor: float, grid: Grid, filled: np.ndarray) -> RosMessage:
    """Return a map as an OccupancyGrid on a floor of that height [m]: rows along x, from the lowest y on."""
    origin = pose((*grid.low, floor), np.eye(4)[0])
    return {
        "header": version.header(0.0, MAP),
        "info": {
            "map_load_time": version.stamp(0.0),
            "resolution": grid.cell,
            "width": grid.shape[0],
            "height": grid.shape[1],
            "origin": origin,
        },
        "data": (filled.T.reshape(-1).astype(int) * OCCUPIED).tolist(),
    }
