"""Walkable surfaces over the cells of a grid, one above the other, and their connections."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.models.compile.raster import Grid, SpanTable

RISE_TOLERANCE = 1e-6
"""Tolerance of a rise [m]."""
MAX_SURFACE_PAIRS = 5e8
"""Largest product of the number of cells and the squared number of layers, which bounds the work."""
SIDES = ((1, 0), (0, 1))
"""Offsets of half of the neighbours that share a side; the other half follows by symmetry."""
CORNERS = ((1, 1), (1, -1))
"""Offsets of half of the neighbours that share a corner."""


Squares = tuple[slice, slice]
"""Index of cells: slices along x and y."""


@dataclass(frozen=True, eq=False)
class SurfaceAdjacency:
    """Joined surfaces of neighbouring cells, for all cells and one direction.

    Attributes:
        corner: Whether the cells touch at a corner only.
        here: Index of the cells on this side.
        there: Index of the cells on the other side.
        joined: Whether surfaces are joined (i, j), by layer here and layer there.
    """

    corner: bool
    here: Squares
    there: Squares
    joined: dict[tuple[int, int], np.ndarray]


def walkable_surfaces(
    solids: SpanTable, grid: Grid, floor: float, step: float, height: float, steepest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return height and steepness of the surfaces with room above them (layers, i, j).

    Each cell's solids are visited from the lowest to the highest; solids with less room between them than the
    robot's height form one block. Steep faces are no surface, unless they rise by no more than a step.

    Raises:
        SpecError: There are too many surfaces one above the other (`MAX_SURFACE_PAIRS`).
    """
    squares = grid.shape[0] * grid.shape[1]
    top, steep, count = np.full(squares, floor), np.zeros(squares), np.zeros(squares, int)
    firm = top.copy()  # the highest face of this block that is not too steep
    grounds, steeps = [np.full(squares, np.nan)], [np.zeros(squares)]

    def close(which: np.ndarray) -> None:
        which = which[np.isfinite(firm[which]) & (top[which] <= firm[which] + step)]
        for layer in range(int(count[which].max(initial=-1)) + 1):
            if layer == len(grounds):
                if squares * (layer + 1) ** 2 > MAX_SURFACE_PAIRS:
                    raise SpecError(f"more than {layer} surfaces one above the other on {squares} squares")
                grounds.append(np.full(squares, np.nan))
                steeps.append(np.zeros(squares))
            these = which[count[which] == layer]
            grounds[layer][these], steeps[layer][these] = top[these], steep[these]
        count[which] += 1

    order = np.lexsort((solids.low, solids.square))
    square, low, high, slant = (v[order] for v in (solids.square, solids.low, solids.high, solids.slope))
    first = np.searchsorted(square, square)
    rank = np.arange(len(square)) - first
    # All cells at once: the k-th pass handles the k-th lowest solid of every cell that has one.
    for now in np.split(np.argsort(rank, kind="stable"), np.cumsum(np.bincount(rank))[:-1]):
        at = square[now]
        # Enough room above the block so far: it is complete, and the next one begins.
        free = at[low[now] - top[at] >= height]
        close(free)
        firm[free] = -np.inf
        firm[at] = np.where(slant[now] <= steepest, np.maximum(firm[at], high[now]), firm[at])
        above = high[now] > top[at]
        top[at[above]], steep[at[above]] = high[now][above], slant[now][above]
    close(np.arange(squares))
    shape = (len(grounds), *grid.shape)
    return np.stack(grounds).reshape(shape), np.stack(steeps).reshape(shape)


def blocked(things: SpanTable, ground: np.ndarray, step: float, height: float) -> np.ndarray:
    """Return the surfaces on which things obstruct a robot (layers, i, j)."""
    flat = ground.reshape(len(ground), -1)
    under = flat[:, things.square]
    hit = (things.low < under + height) & (things.high > under + step)  # False beside NaN
    taken = np.zeros(flat.shape, bool)
    layer, row = np.nonzero(hit)
    taken[layer, things.square[row]] = True
    return taken.reshape(ground.shape)


def _slices(offset: int) -> tuple[slice, slice]:
    """Return the cells with a neighbour at that offset, and those neighbours."""
    if offset == 0:
        return slice(None), slice(None)
    return (slice(None, -1), slice(1, None)) if offset > 0 else (slice(1, None), slice(None, -1))


def surface_adjacencies(
    ground: np.ndarray, steep: np.ndarray, step: float, cell: float
) -> Iterator[SurfaceAdjacency]:
    """Yield the joined surfaces of neighbouring cells, for half of the directions."""
    for di, dj in (*SIDES, *CORNERS):
        (here_i, there_i), (here_j, there_j) = _slices(di), _slices(dj)
        here, there = (here_i, here_j), (there_i, there_j)
        length = math.hypot(di, dj) * cell
        joined: dict[tuple[int, int], np.ndarray] = {}
        for a, b in product(range(len(ground)), repeat=2):
            rise = step + RISE_TOLERANCE + length * np.maximum(steep[a][here], steep[b][there])
            joined[a, b] = np.abs(ground[a][here] - ground[b][there]) <= rise  # False beside NaN
        some = {pair: which for pair, which in joined.items() if pair == (0, 0) or which.any()}
        yield SurfaceAdjacency(corner=bool(di and dj), here=here, there=there, joined=some)


def octagon(steps: int) -> Iterator[bool]:
    """Yield for each step of one cell whether corners count, so that all steps together make an octagon.

    A square or a diamond of neighbours alone would err by 41 % of the distance in some directions.
    """
    share = 1 / (1 + math.sqrt(2))
    for step in range(steps):
        yield round((step + 1) * share) > round(step * share)


def dilate(which: np.ndarray, links: tuple[SurfaceAdjacency, ...], corners: bool) -> np.ndarray:
    """Return the given surfaces and those joined to them (layers, i, j)."""
    grown = which.copy()
    for link in links:
        if corners or not link.corner:
            for (a, b), joined in link.joined.items():
                grown[b][link.there] |= which[a][link.here] & joined
                grown[a][link.here] |= which[b][link.there] & joined
    return grown


def erode(which: np.ndarray, links: tuple[SurfaceAdjacency, ...], steps: int) -> np.ndarray:
    """Return the surfaces farther than some steps from their edge (layers, i, j).

    A surface ends where a neighbouring cell has none joined to it; not at the edge of the grid.
    """
    for corners in octagon(steps):
        kept = which.copy()
        for link in links:
            if corners or not link.corner:
                here, there = which[:, *link.here], which[:, *link.there]
                ahead, behind = np.zeros_like(here), np.zeros_like(there)
                for (a, b), joined in link.joined.items():
                    ahead[a] |= there[b] & joined
                    behind[b] |= here[a] & joined
                kept[:, *link.here] &= ahead
                kept[:, *link.there] &= behind
        which = kept
    return which


def label_areas(which: np.ndarray, links: tuple[SurfaceAdjacency, ...]) -> np.ndarray:
    """Number the areas connected by the cells' sides; -1 elsewhere (layers, i, j)."""
    # Imports in a fifth of a second; serving a world does not need it.
    from scipy.sparse import coo_array  # pyright: ignore[reportMissingTypeStubs]
    from scipy.sparse.csgraph import (  # pyright: ignore[reportMissingTypeStubs]
        connected_components,  # pyright: ignore[reportUnknownVariableType]
    )

    count = np.count_nonzero(which)
    number = np.full(which.shape, -1, np.int32)
    number[which] = np.arange(count, dtype=np.int32)
    starts: list[np.ndarray] = []
    ends: list[np.ndarray] = []
    for link in links:
        if not link.corner:
            for (a, b), joined in link.joined.items():
                both = joined & which[a][link.here] & which[b][link.there]
                starts.append(number[a][link.here][both])
                ends.append(number[b][link.there][both])
    pairs = np.concatenate(starts), np.concatenate(ends)
    graph = coo_array((np.ones(len(pairs[0]), np.int8), pairs), shape=(count, count))
    number[which] = connected_components(graph, directed=False)[1]
    return number
