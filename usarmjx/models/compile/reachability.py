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
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import mujoco
import numpy as np

from usarmjx.base.transforms import angles_from_mat, mat_from_angles
from usarmjx.models.compile.raster import Grid, rasterize
from usarmjx.models.compile.surfaces import (
    SurfaceAdjacency,
    blocked,
    dilate,
    erode,
    label_areas,
    octagon,
    surface_adjacencies,
    walkable_surfaces,
)
from usarmjx.models.compile.victims import segment_poses, victim_table
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, LooseObject, StartPose, Victim
from usarmjx.models.types.robot import RobotSpec
from usarmjx.models.types.shapes import ZERO, Shape

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
    floor = 0.0 if arena.has_floor else -math.inf
    ground, steep = walkable_surfaces(solids, grid, floor, step=step, height=height, steepest=math.tan(slope))
    links = tuple(surface_adjacencies(ground, steep, step, grid.cell))
    things = rasterize(
        [shape for thing in (*arena.loose, *arena.victims) for shape in shapes_in_arena(thing)], grid
    )
    free = np.isfinite(ground) & ~blocked(things, ground, step=step, height=height)
    # Solids are half a cell too wide already.
    steps = max(0, math.ceil(radius / grid.cell - 0.5 - CELL_TOLERANCE))
    area = label_areas(erode(free, links, steps), links)
    x, y, z = (start or arena.starts[0]).at
    i, j = grid.index(x, y)
    i, j = min(i, grid.shape[0] - 1), min(j, grid.shape[1] - 1)
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
