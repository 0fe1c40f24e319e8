"""Drives to every start pose and victim that a plan of an arena declares reachable."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

import numpy as np

from usarmjx.models.check.arena import VICTIM_REACH, in_water
from usarmjx.models.compile.reachability import (
    DEFAULT_CELL_SIZE,
    ReachMap,
    footprint_of,
    reach_map,
    shapes_in_arena,
)
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose, Victim
from usarmjx.models.types.robot import RobotSpec
from usarmjx.models.types.shapes import Position2D
from usarmjx.sim.trials.driver import Trial

FINE_CELL_SIZE = 0.02
"""Side of the squares of a plan where a robot fits narrowly [m]."""
WAYPOINT_SPACING = 0.3
"""Distance of the points that a robot is driven along [m]."""
MIN_SPEED_SHARE = 0.1
"""Share of its top speed at which a robot gets on at least, else it is out of time."""
EXTRA_TIME = 15.0
"""Time besides the drive itself, for turning and backing off [s]."""
BORDER_DISTANCE, BORDER_COST = 0.1, 3.0
"""Ways keep away from where a robot does not fit: so far [m], and what they give for it."""


class RouteSegment(NamedTuple):
    """A path between two points of an arena.

    Attributes:
        goal: Name of its end: "start 'B'".
        path: Points [m].
        length: Length [m].
        home: Start pose to continue from if the robot does not arrive.
    """

    goal: str
    path: tuple[Position2D, ...]
    length: float
    home: StartPose


@dataclass(frozen=True)
class ArenaRoute:
    """Result of a drive round an arena.

    Attributes:
        segments: Ways that it was sent.
        metres: Length of those that it made [m].
        seconds: Simulated time of those [s].
        faults: A sentence for each way that it did not make.
    """

    segments: int
    metres: float
    seconds: float
    faults: tuple[str, ...]

    @property
    def success(self) -> float:
        """Share of the ways that it made."""
        return 1.0 - len(self.faults) / self.segments if self.segments else 1.0


def drive_arena(arena: ArenaSpec, robot: RobotSpec, share: float = 1.0) -> ArenaRoute:
    """Drive a robot from the first start pose on ground to all others and to victims, where a plan leads.

    Ways are planned with its size and the step that it should climb; whether it climbs, tips over or gets
    stuck is what is found out. After a fault it goes on from the next start pose.

    Args:
        arena: The arena.
        robot: Its class.
        share: Share of its top speed.

    Raises:
        UsageError: The class does not drive on the ground, or there is no start pose for it.
    """
    dry_starts = tuple(start for start in arena.starts if not in_water(arena, start))
    arena = replace(arena, starts=dry_starts or arena.starts)
    trial, segments = Trial(arena, robot, share), plan_segments(arena, robot)
    metres = seconds = 0.0
    faults: list[str] = []
    for segment in segments:
        limit = EXTRA_TIME + segment.length / (MIN_SPEED_SHARE * max(robot.drive.top_speed, 1e-3) * share)
        run = trial.follow(segment.path, limit)
        if run.fault:
            faults.append(f"{segment.goal}: a driven {robot.name} {_verb(run.fault)}")
            trial.reset_to(segment.home)
            continue
        metres, seconds = metres + segment.length, seconds + run.seconds
    return ArenaRoute(len(segments), metres, seconds, tuple(faults))


def _verb(fault: str) -> str:
    return f"is {fault}" if fault.startswith(("stuck", "out of")) else fault


def plan_segments(arena: ArenaSpec, robot: RobotSpec) -> list[RouteSegment]:
    """Return ways to all start poses and victims that a robot should reach, the nearest next."""
    finder = _PathFinder(arena, robot)
    goals = {f"start {start.tag!r}": (finder.node(start), start) for start in arena.starts[1:]}
    goals |= {f"victim {victim.name!r}": (finder.beside(victim), None) for victim in arena.victims}
    remaining = {name: (target, start) for name, (target, start) in goals.items() if target >= 0}
    segments: list[RouteSegment] = []
    node, home = finder.node(arena.starts[0]), arena.starts[0]
    while remaining and node >= 0:
        lengths, predecessors = finder.shortest_paths(node)
        name = min(remaining, key=lambda one: lengths[remaining[one][0]])
        target, start = remaining.pop(name)
        if not math.isfinite(lengths[target]):
            continue
        home = start or home
        path = finder.path(predecessors, node, target)
        segments.append(RouteSegment(name, path, _length(path), home))
        node = target
    return segments


def _length(path: Sequence[Position2D]) -> float:
    return sum(math.dist(a, b) for a, b in itertools.pairwise(path))


class _PathFinder:
    """Shortest ways over the surfaces of an arena on which a robot has room to turn."""

    def __init__(self, arena: ArenaSpec, robot: RobotSpec) -> None:
        size = footprint_of(robot)
        for cell in (DEFAULT_CELL_SIZE, FINE_CELL_SIZE):
            self.map: ReachMap = reach_map(arena, size.radius, size.step, height=size.height, cell=cell)
            if self.map.start_area >= 0:
                break
        self._free = (self.map.area == self.map.start_area) & (self.map.start_area >= 0)
        self._numbers = np.full(self._free.shape, -1)
        self._numbers[self._free] = np.arange(int(self._free.sum()))
        _, i, j = np.nonzero(self._free)
        low, cell = self.map.grid.low, self.map.grid.cell
        self._points = np.stack([low[0] + (i + 0.5) * cell, low[1] + (j + 0.5) * cell], -1)
        self._graph = self._edges()

    def _edges(self) -> Any:  # noqa: ANN401 - a sparse matrix of scipy
        from scipy import ndimage, sparse  # pyright: ignore[reportMissingTypeStubs]

        csr_array, distance_transform_edt = (
            cast(Any, sparse).csr_array,
            cast(Any, ndimage).distance_transform_edt,
        )

        cell = self.map.grid.cell
        clearances = [
            np.asarray(distance_transform_edt(np.pad(layer, 1)))[1:-1, 1:-1] for layer in self._free
        ]
        cost = 1.0 + BORDER_COST * np.exp(-np.stack(clearances) * cell / BORDER_DISTANCE)
        ends: list[np.ndarray] = []
        weights: list[np.ndarray] = []
        for link in self.map.links:
            for (lower, upper), joined in link.joined.items():
                here = self._numbers[lower][link.here][joined]
                there = self._numbers[upper][link.there][joined]
                edge_cost = (cost[lower][link.here][joined] + cost[upper][link.there][joined]) / 2
                usable = (here >= 0) & (there >= 0)
                ends.append(np.stack([here[usable], there[usable]]))
                weights.append(edge_cost[usable] * cell * (math.sqrt(2.0) if link.corner else 1.0))
        count = len(self._points)
        if not ends:
            return csr_array((count, count))
        pairs = np.concatenate(ends, axis=1)
        return csr_array((np.concatenate(weights), (pairs[0], pairs[1])), shape=(count, count))

    def node(self, start: StartPose) -> int:
        """Return the square under a start pose; -1: the robot does not get there."""
        return self._near(start.at[0], start.at[1], start.at[2] - START_ELEVATION, 4 * self.map.grid.cell)

    def beside(self, victim: Victim) -> int:
        """Return the square nearest to a victim that the robot may stand on; -1: none is near."""
        found = [self._near(*part.at, VICTIM_REACH) for part in shapes_in_arena(victim)]
        found = [node for node in found if node >= 0]
        if not found:
            return -1
        at = np.array(victim.at[:2])
        return min(found, key=lambda node: float(np.linalg.norm(self._points[node] - at)))

    def _near(self, x: float, y: float, z: float, max_distance: float) -> int:
        if not len(self._points):
            return -1
        ground = self.map.ground[self._free]
        distances = np.hypot(*(self._points - (x, y)).T) + np.where(
            np.abs(ground - z) < VICTIM_REACH, 0.0, 10.0 * VICTIM_REACH
        )
        best = int(distances.argmin())
        return best if distances[best] <= max_distance else -1

    def shortest_paths(self, node: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the cost of ways from a square to all others, and the squares before them."""
        from scipy.sparse import csgraph  # pyright: ignore[reportMissingTypeStubs]

        lengths, predecessors = cast(Any, csgraph).dijkstra(
            self._graph, directed=False, indices=node, return_predecessors=True
        )
        return np.asarray(lengths), np.asarray(predecessors)

    def path(self, predecessors: np.ndarray, here: int, there: int) -> tuple[Position2D, ...]:
        """Return points along a way."""
        squares = [there]
        while squares[-1] != here:
            squares.append(int(predecessors[squares[-1]]))
        every = max(1, round(WAYPOINT_SPACING / self.map.grid.cell))
        chosen = [*squares[::-1][every::every], there]
        return tuple((float(x), float(y)) for x, y in self._points[chosen])
