"""Markings of a route network: lane boundaries, stop lines, kerbs and parking spots.

Sizes of markings are those of the United States' Manual on Uniform Traffic Control Devices (MUTCD). A lane's
markings end at a waypoint with an exit, and begin again at the next waypoint with an entry: there it crosses
another road. Paint is visible, but has no contacts.
"""

import math
from collections.abc import Iterator
from itertools import islice, pairwise

import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.models.roads.network import METRES_PER_FOOT, Lane, LatLon, RouteNetwork, Spot, to_local_xy
from usarmjx.models.types.shapes import Rgba, Shape

MAX_MARKINGS = 50_000
"""Largest number of markings of a network: the limit of an arena's solids."""
LANE_WIDTH = 12.0
"""Width of lanes without a given width [feet] (chosen: that of highways)."""
LINE_WIDTH, STOP_LINE_WIDTH = 0.10, 0.45
"""Widths of lines and of stop lines [m] (MUTCD 3A.06: 4 to 6 inches; 3B.16: 12 to 24 inches)."""
DASH_LENGTH, DASH_GAP = 10 * METRES_PER_FOOT, 30 * METRES_PER_FOOT
"""Lengths of the dashes of a broken line and of the gaps between them [m] (MUTCD 3A.06)."""
PAINT_THICKNESS = 0.004
"""Thickness of paint [m], twice that of the asphalt below it."""
KERB_WIDTH, KERB_HEIGHT = 0.15, 0.15
"""Width and height of a kerb [m]: six inches (chosen: the usual barrier kerb)."""
MAX_STRAIGHT_BEND = 2e-3
"""Bend below which a path counts as straight [rad]."""

WHITE, YELLOW = (0.95, 0.95, 0.95, 1.0), (0.95, 0.75, 0.1, 1.0)
CONCRETE = (0.65, 0.65, 0.62, 1.0)


def road_shapes(network: RouteNetwork, origin: LatLon) -> tuple[Shape, ...]:
    """Return the markings and kerbs of a network in the axes of an arena, whose floor they lie on.

    Lanes without a right boundary have a kerb there. Both lanes beside a double line paint one of its lines,
    both beside a broken line half of its width.

    Args:
        network: The route network.
        origin: Latitude and longitude of the arena's origin [degrees].

    Raises:
        SpecError: There are more than `MAX_MARKINGS` of them.
    """
    # A stop line at a waypoint that repeats the one before has no length.
    seen = (shape for shape in _markings(network, origin) if min(shape.size) > 0)
    shapes = tuple(islice(seen, MAX_MARKINGS + 1))
    if len(shapes) > MAX_MARKINGS:
        raise SpecError(f"roads {network.name!r} have more than {MAX_MARKINGS} markings")
    return shapes


def _markings(network: RouteNetwork, origin: LatLon) -> Iterator[Shape]:
    for owner, part in network.parts():
        if isinstance(part, Lane):
            half = lane_width(part) / 2
            for run in lane_runs(network, owner, origin):
                yield from _boundary(run, half, part.left)
                yield from _boundary(run, -half, part.right) if part.right else _kerb(run, -half)
            yield from _stop_lines(part, origin)
    for zone in network.zones:
        yield from _spot_lines(zone.spots, origin)


def lane_width(lane: Lane) -> float:
    """Return a lane's width [m]."""
    return (LANE_WIDTH if lane.width is None else lane.width) * METRES_PER_FOOT


def lane_path(lane: Lane, origin: LatLon) -> np.ndarray:
    """Return a lane's waypoints x, y in the arena's axes [m] (waypoints, 2)."""
    return np.array([to_local_xy(origin, at) for at in lane.waypoints])


def lane_runs(network: RouteNetwork, owner: tuple[int, int], origin: LatLon) -> list[np.ndarray]:
    """Return the paths of a lane between crossings, x, y [m] (points, 2), each of at least two points."""
    lane = network.lane(*owner)
    left = {point for point, _ in lane.exits}
    entries = network.entries
    path = lane_path(lane, origin)
    first = lane.first
    # `exits` name points from `first` on, arrays count from 0.
    ends = [i for i in range(1, len(path)) if i - 1 + first in left and (*owner, i + first) in entries]
    runs = [_distinct(run) for run in np.split(path, ends)]
    return [run for run in runs if len(run) > 1]


def _distinct(path: np.ndarray) -> np.ndarray:
    """Return a path without repeated points (points, 2)."""
    return path[np.r_[True, (np.diff(path, axis=0) != 0).any(axis=1)]] if len(path) else path


def offset_path(path: np.ndarray, left: float) -> np.ndarray:
    """Return the line at a distance to the left of a path, negative: to its right [m] (points, 2)."""
    along = np.diff(path, axis=0)
    lengths = np.linalg.norm(along, axis=1, keepdims=True)
    # A repeated waypoint has no direction.
    along /= np.where(lengths > 0, lengths, 1.0)
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    before, after = np.vstack([normal[:1], normal]), np.vstack([normal, normal[-1:]])
    # Mitre joint: the bisector of two normals, lengthened by 1 / cos of half the bend.
    return path + left * (before + after) / (1 + (before * after).sum(1, keepdims=True))


def stripe(a: np.ndarray, b: np.ndarray, width: float, rgba: Rgba) -> Shape:
    """Return a line of paint from one point to another [m]."""
    return _bar(a, b, width, PAINT_THICKNESS, "fixture", rgba)


def _bar(a: np.ndarray, b: np.ndarray, width: float, height: float, surface: str, rgba: Rgba) -> Shape:
    (x, y), (dx, dy) = (a + b) / 2, b - a
    return Shape(
        kind="box",
        size=(math.hypot(dx, dy) / 2, width / 2, height / 2),
        at=(float(x), float(y), height / 2),
        rotation=(0.0, 0.0, math.atan2(dy, dx)),
        surface=surface,
        rgba=rgba,
    )


def _pieces(path: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Iterate over the straight pieces of a path: two ends [m] (2,) each."""
    # Unwrapped: a path to the west passes from pi to -pi without a bend.
    heading = np.unwrap(np.arctan2(*np.diff(path, axis=0).T[::-1]))
    bends = [0, *(1 + np.flatnonzero(np.abs(np.diff(heading)) > MAX_STRAIGHT_BEND)), len(path) - 1]
    for start, end in pairwise(bends):
        yield path[start], path[end]


def _boundary(run: np.ndarray, edge: float, kind: str) -> Iterator[Shape]:
    """Iterate over the lines of a lane's boundary, which lies `edge` [m] to the left of its path."""
    inwards, rgba = -math.copysign(1.0, edge), YELLOW if "yellow" in kind else WHITE
    if kind == "broken_white":
        path = offset_path(run, edge + inwards * LINE_WIDTH / 4)
        yield from (stripe(a, b, LINE_WIDTH / 2, rgba) for a, b in _dashes(path))
    elif kind:
        # The two lines of a double one, painted by both lanes, then lie a line's width apart.
        path = offset_path(run, edge + inwards * LINE_WIDTH * (1.0 if kind.startswith("double") else 0.5))
        yield from (stripe(a, b, LINE_WIDTH, rgba) for a, b in _pieces(path))


def _dashes(path: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    done = 0.0
    for a, b in _pieces(path):
        length = float(np.linalg.norm(b - a))
        # Dashes continue across bends: the phase goes on with the length so far.
        first = math.floor(done / (DASH_LENGTH + DASH_GAP)) * (DASH_LENGTH + DASH_GAP) - done
        for start in np.arange(first, length, DASH_LENGTH + DASH_GAP):
            low, high = max(0.0, start), min(length, start + DASH_LENGTH)
            if high > low:
                yield a + (b - a) * low / length, a + (b - a) * high / length
        done += length


def _kerb(run: np.ndarray, edge: float) -> Iterator[Shape]:
    # A kerb is on the right alone: beyond the edge, the outside is to the right.
    path = offset_path(run, edge - KERB_WIDTH / 2)
    yield from (_bar(a, b, KERB_WIDTH, KERB_HEIGHT, "ground", CONCRETE) for a, b in _pieces(path))


def _stop_lines(lane: Lane, origin: LatLon) -> Iterator[Shape]:
    # From line to line, not over them.
    path, half = lane_path(lane, origin), lane_width(lane) / 2 - LINE_WIDTH
    if len(path) > 1:
        across = offset_path(path, half) - path
        yield from (
            stripe(path[i] - across[i], path[i] + across[i], STOP_LINE_WIDTH, WHITE)
            for i in (stop - lane.first for stop in lane.stops)
        )


def _spot_lines(spots: tuple[Spot, ...], origin: LatLon) -> Iterator[Shape]:
    """Iterate over the lines beside spots, twice as long as from the mouth to the parking position.

    Neighbours share one.
    """
    drawn: list[np.ndarray] = []
    for spot in spots:
        mouth, middle = np.array([to_local_xy(origin, at) for at in spot.waypoints])
        path = np.array([mouth, 2 * middle - mouth])
        half = (LANE_WIDTH if spot.width is None else spot.width) * METRES_PER_FOOT / 2
        for a, b in (offset_path(path, half), offset_path(path, -half)):
            if not any(np.linalg.norm((a + b) / 2 - other) < LINE_WIDTH for other in drawn):
                drawn.append((a + b) / 2)
                yield stripe(a, b, LINE_WIDTH, WHITE)
