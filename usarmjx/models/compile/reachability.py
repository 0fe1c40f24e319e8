"""Reachability: the part of an arena that a robot of some size can reach from a start pose.

Vertical lines through the cells of a grid cut the arena's solids, which gives each cell the surfaces with
enough room above them, one above the other. Surfaces of neighbouring cells are joined where they differ by no
more than a step, or by the rise of a slope. The robot's middle keeps its radius from the edges of surfaces,
measured along them; so it may drive up a ramp to a second floor, and below it.

Moving things are left out (doors, robots). Loose objects and victims are obstacles where they are higher than
a step, but are no ground. Dynamics, as turning over on rubble, are not considered: this is a plan, not a
drive.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import angles_from_mat, mat_from_angles
from usarmjx.models.compile.raster import Grid, SpanTable, rasterize
from usarmjx.models.compile.victims import segment_poses, victim_table
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, LooseObject, StartPose, Victim
from usarmjx.models.types.robot import RobotSpec
from usarmjx.models.types.shapes import ZERO, Shape

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
DEFAULT_CELL_SIZE = 0.05
"""Side of a cell [m]; more in arenas that would need more than MAX_CELLS of them."""
MAX_CELLS = 1_000_000
"""Largest number of cells of a grid."""
DEFAULT_HEIGHT = 0.4
"""Default of the room that a robot needs above the ground [m]."""
DEFAULT_SLOPE = math.radians(30)
"""Default of the steepest passable slope [rad] (chosen; friction 0.8 holds to 38 degrees)."""
STEP_SHARE = 0.5
"""Highest step relative to a wheel's radius: on `c` a P2AT climbs boards of 6 cm."""
SURFACE_TOLERANCE = 0.1
"""Difference of heights up to which they belong to one surface [m]."""
CELL_TOLERANCE = 1e-6
"""Tolerance of rounding to whole cells."""


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
        # A block whose top is only a steep face has no ground, unless the face is no higher than a step.
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
    # Rows are sorted by cell: the first of each cell gives every row its rank there.
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
    # Half of the directions: each entry serves both ways.
    for di, dj in (*SIDES, *CORNERS):
        (here_i, there_i), (here_j, there_j) = _slices(di), _slices(dj)
        here, there = (here_i, here_j), (there_i, there_j)
        length = math.hypot(di, dj) * cell
        joined: dict[tuple[int, int], np.ndarray] = {}
        for a, b in product(range(len(ground)), repeat=2):
            rise = step + RISE_TOLERANCE + length * np.maximum(steep[a][here], steep[b][there])
            joined[a, b] = np.abs(ground[a][here] - ground[b][there]) <= rise  # False beside NaN
        # The pair of lowest layers stays, so that each direction has an entry.
        some = {pair: which for pair, which in joined.items() if pair == (0, 0) or which.any()}
        yield SurfaceAdjacency(corner=bool(di and dj), here=here, there=there, joined=some)


def octagon(steps: int) -> Iterator[bool]:
    """Yield for each step of one cell whether corners count, so that all steps together make an octagon.

    A square or a diamond of neighbours alone would err by 41 % of the distance in some directions.
    """
    # With this share of steps over corners all eight sides come out equally long.
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
    # Renumbered in place: from a node of the graph to its component.
    number[which] = connected_components(graph, directed=False)[1]
    return number


@dataclass(frozen=True)
class RobotFootprint:
    """Room that a robot needs to pass [m]: radius of its turning circle, highest step, height."""

    radius: float
    step: float
    height: float


def footprint_of(robot: RobotSpec) -> RobotFootprint:
    """Return the room that a robot needs to pass, from its `dimensions`.

    The step is half a wheel's radius; for robots without wheels a sixth of their height (chosen).
    """
    length, width, height = robot.dimensions
    step = STEP_SHARE * robot.wheel_radius if robot.wheel_radius else height / 6
    return RobotFootprint(radius=math.hypot(length, width) / 2, step=step, height=height)


@dataclass(frozen=True, eq=False)
class ReachMap:
    """Surfaces of an arena and their connected areas for a robot.

    Attributes:
        grid: The cells.
        ground: Height of each surface, from the lowest up; NaN above the last (layers, i, j).
        area: Connected area of positions of a robot's middle, -1 where it does not fit (layers, i, j).
        start_area: Area of the start pose (the highest surface under it); -1: the robot does not fit there.
        links: Joined surfaces.
    """

    grid: Grid
    ground: np.ndarray
    area: np.ndarray
    start_area: int
    links: tuple[SurfaceAdjacency, ...]

    def fits(self, x: float, y: float, z: float | None = None) -> bool:
        """Return whether the robot's middle fits there, on the surface at height `z` or on any."""
        return bool((self.areas(x, y, z) >= 0).any())

    def reachable(self, x: float, y: float, z: float | None = None) -> bool:
        """Return whether the robot's middle can get there, on the surface at height `z` or on any."""
        return self.start_area >= 0 and bool((self.areas(x, y, z) == self.start_area).any())

    def reachable_points(self, points: np.ndarray) -> np.ndarray:
        """Return `reachable` of points x, y [m], on any surface: (..., 2) to (...)."""
        i, j = np.moveaxis((np.asarray(points, float) - self.grid.low) // self.grid.cell, -1, 0).astype(int)
        rows, columns = self.grid.shape
        held = (i >= 0) & (i < rows) & (j >= 0) & (j < columns)
        there = (np.isfinite(self.ground) & (self.area == self.start_area)).any(0) & (self.start_area >= 0)
        return held & there[np.clip(i, 0, rows - 1), np.clip(j, 0, columns - 1)]

    def reaches_within(self, x: float, y: float, z: float | None = None, distance: float = 1.0) -> bool:
        """Return whether the robot's middle gets within a distance [m] of a point.

        The distance is measured around walls and along the ground, to the surface under height `z`, or to
        any, with the resolution of a cell.
        """
        i, j = self.grid.index(x, y)
        if not self.grid.holds(i, j):
            return False
        under = np.isfinite(self.ground[:, i, j])
        if z is not None:
            # Of the surfaces below the point the highest: the one that it is above.
            under = np.flatnonzero(self.ground[:, i, j] <= z + SURFACE_TOLERANCE)[-1:]
        return bool(self._spread(distance)[under, i, j].any())

    def areas(self, x: float, y: float, z: float | None = None) -> np.ndarray:
        """Return the areas at a point; `z`: only on surfaces within `SURFACE_TOLERANCE` of that height."""
        i, j = self.grid.index(x, y)
        if not self.grid.holds(i, j):
            return np.zeros(0, int)
        there = (
            np.isfinite(self.ground[:, i, j])
            if z is None
            else np.abs(self.ground[:, i, j] - z) < SURFACE_TOLERANCE
        )
        return self.area[there, i, j]

    @cached_property
    def _spreads(self) -> dict[int, np.ndarray]:
        return {}

    def _spread(self, distance: float) -> np.ndarray:
        """Return the surfaces within a distance of reachable ones, along surfaces (layers, i, j)."""
        steps = int(distance / self.grid.cell)
        if steps not in self._spreads:
            reached = (self.area == self.start_area) & (self.start_area >= 0)
            for corners in octagon(steps):
                reached = dilate(reached, self.links, corners)
            self._spreads[steps] = reached
        return self._spreads[steps]


def reach_map(
    arena: ArenaSpec,
    radius: float,
    step: float,
    *,
    height: float = DEFAULT_HEIGHT,
    slope: float = DEFAULT_SLOPE,
    cell: float = DEFAULT_CELL_SIZE,
    start: StartPose | None = None,
) -> ReachMap:
    """Return the surfaces that a robot can reach.

    Args:
        arena: The arena; the grid covers its extent and its start poses.
        radius: Radius of the robot's turning circle [m].
        step: Highest step that it climbs [m].
        height: Room that it needs above the ground [m].
        slope: Steepest slope that it climbs [rad].
        cell: Side of the grid's cells [m]: gaps wider than the robot by less than three of them may count as
            closed, none as open that is narrower.
        start: Start pose; None: the arena's first one.
    """
    grid = _grid(arena, cell)
    solids = rasterize(arena.shapes, grid)
    # Below all solids: cells without any then have no finite ground.
    floor = 0.0 if arena.has_floor else -math.inf
    ground, steep = walkable_surfaces(solids, grid, floor, step=step, height=height, steepest=math.tan(slope))
    # Once: eroding, labelling and spreading all walk along the same neighbours.
    links = tuple(surface_adjacencies(ground, steep, step, grid.cell))
    things = rasterize(
        [shape for thing in (*arena.loose, *arena.victims) for shape in shapes_in_arena(thing)], grid
    )
    free = np.isfinite(ground) & ~blocked(things, ground, step=step, height=height)
    # Solids are half a cell too wide already.
    steps = max(0, math.ceil(radius / grid.cell - 0.5 - CELL_TOLERANCE))
    # Areas of the robot's middle: labelled after the edges are cut off, so that gaps too narrow part them.
    area = label_areas(erode(free, links, steps), links)
    x, y, z = (start or arena.starts[0]).at
    i, j = grid.index(x, y)
    # A start pose exactly on the upper edge has an index one past the end.
    i, j = min(i, grid.shape[0] - 1), min(j, grid.shape[1] - 1)
    # Start poses are above the ground by the manual's elevation (5.3.5).
    under = np.flatnonzero(ground[:, i, j] <= z - START_ELEVATION + SURFACE_TOLERANCE)
    home = int(area[under[-1], i, j]) if len(under) else -1
    return ReachMap(grid=grid, ground=ground, area=area, start_area=home, links=links)


def shapes_in_arena(thing: LooseObject | Victim) -> list[Shape]:
    """Return the solids of a loose object or a victim in its initial pose, in the arena's axes."""
    shapes = thing.shapes if isinstance(thing, LooseObject) else _body(thing)
    mat = mat_from_angles(*np.array(thing.rotation))
    at = np.array([shape.at for shape in shapes]) @ mat.T + thing.at
    angles = np.array([shape.rotation for shape in shapes])
    turned = angles_from_mat(mat @ mat_from_angles(angles[:, 0], angles[:, 1], angles[:, 2]))
    return [
        Shape(kind=s.kind, size=s.size, at=tuple(a), rotation=tuple(t), surface=s.surface, mesh=s.mesh)
        for s, a, t in zip(shapes, at.tolist(), turned.tolist(), strict=True)
    ]


def _body(victim: Victim) -> tuple[Shape, ...]:
    return _boxes(replace(victim, name="", at=ZERO, rotation=ZERO))


@lru_cache(maxsize=256)
def _boxes(victim: Victim) -> tuple[Shape, ...]:
    """Return the boxes of a victim at the origin, cached as many victims share a posture."""
    table = victim_table((victim,))
    pos, quat = segment_poses(table, np.zeros(()))
    mat = np.zeros((table.num_boxes, 9))
    for row, turn in zip(mat, quat.astype(float), strict=True):
        mujoco.mju_quat2Mat(row, turn)
    angles = angles_from_mat(mat.reshape(-1, 3, 3))
    return tuple(
        Shape(kind="box", size=tuple(size), at=tuple(at), rotation=tuple(turned), surface="ground")
        for size, at, turned in zip(table.size.tolist(), pos.tolist(), angles.tolist(), strict=True)
    )


def victims_reached(arena: ArenaSpec, there: ReachMap, distance: float = 1.0) -> list[bool]:
    """Return for each victim whether the robot gets that close to the middle of a part of its body [m]."""
    return [
        any(there.reaches_within(*part.at, distance=distance) for part in shapes_in_arena(victim))
        for victim in arena.victims
    ]


def _grid(arena: ArenaSpec, cell: float) -> Grid:
    (x0, x1), (y0, y1) = arena.extent
    xs, ys = [start.at[0] for start in arena.starts], [start.at[1] for start in arena.starts]
    x0, x1, y0, y1 = min(x0, *xs), max(x1, *xs), min(y0, *ys), max(y1, *ys)
    cell = max(cell, math.sqrt((x1 - x0) * (y1 - y0) / MAX_CELLS))
    counts = (math.ceil((x1 - x0) / cell - CELL_TOLERANCE), math.ceil((y1 - y0) / cell - CELL_TOLERANCE))
    return Grid(low=(x0, y0), cell=cell, shape=(max(1, counts[0]), max(1, counts[1])))
