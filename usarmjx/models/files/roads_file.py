"""Route networks (RNDF) as arenas: paint and kerbs on a floor, and start poses on the lanes."""

import math
from pathlib import Path

import numpy as np

from usarmjx.base.errors import ArenaFileError, SpecError
from usarmjx.models.files.content import Content
from usarmjx.models.roads.network import METRES_PER_FOOT, LatLon, RouteNetwork, to_local_xy
from usarmjx.models.roads.rndf import read_rndf
from usarmjx.models.roads.shapes import lane_path, road_shapes
from usarmjx.models.types.arena import START_ELEVATION, StartPose

MARGIN = 20.0
"""Width of the ground around the points of a network [m]."""
MAX_ROAD_STARTS = 64
"""Largest number of start poses."""
NEAREST_STARTS = 8.0
"""Least distance between two start poses [m]: cars do not touch there."""
FIRST_WORD = "rndf_name"
"""First word of a route network's file."""


def is_route_network(data: bytes) -> bool:
    """Return whether a file's content is a route network."""
    # The beginning is enough: other kinds of files may be long, and without a blank.
    words = data[:4096].split(None, 1)
    return bool(words) and words[0].lower() == FIRST_WORD.encode()


def roads_content(path: Path, origin: LatLon | None = None) -> Content:
    """Return a route network as markings and kerbs on the floor, with a start pose at the head of each lane.

    Start poses have the names of their waypoints with `_` for the points, as 1_1_1, and look along the lane.
    Parking spots have one each, which looks out of the spot.

    Args:
        path: The file.
        origin: Latitude and longitude of the arena's origin [degrees]; None: the middle of the network.

    Raises:
        ArenaFileError: An unreadable file; names it and the line.
    """
    try:
        network = read_rndf(path)
        points = np.array(list(network.points().values()), float).reshape(-1, 2)
        if not len(points):
            raise ArenaFileError(f"{path}: the network has no points")
        low, high = points.min(0), points.max(0)
        if origin is None:
            middle = ((low + high) / 2).tolist()
            origin = (middle[0], middle[1])
        shapes = road_shapes(network, origin)
    except ArenaFileError:
        raise
    except SpecError as error:
        raise ArenaFileError(str(error)) from error
    local = np.array([to_local_xy(origin, (float(a), float(b))) for a, b in points])
    (x0, y0), (x1, y1) = (local.min(0) - MARGIN).tolist(), (local.max(0) + MARGIN).tolist()
    starts = _starts(network, origin)
    notes = () if starts else (f"{path}: no lane and no spot has two points: there is no start pose on it",)
    return Content(
        shapes=shapes,
        floor=True,
        extent=((x0, x1), (y0, y1)),
        starts=starts,
        gps=origin,
        warnings=notes,
    )


def _starts(network: RouteNetwork, origin: LatLon) -> tuple[StartPose, ...]:
    """Return the start poses of lanes and spots, none too near to another one."""
    found: list[StartPose] = []
    for m, segment in enumerate(network.segments, 1):
        for n, lane in enumerate(segment.lanes, 1):
            path = lane_path(lane, origin)
            if len(path) > 1:
                found.append(_start(f"{m}_{n}_1", path[0], path[1]))
    for m, zone in enumerate(network.zones, 1 + len(network.segments)):
        for n, spot in enumerate(zone.spots, 1):
            mouth, middle = (np.array(to_local_xy(origin, at)) for at in spot.waypoints)
            # The parking position is the second point of a spot (`M.N.2`).
            found.append(_start(f"{m}_{n}_2", middle, mouth))
    kept: list[StartPose] = []
    for start in found:
        if all(math.dist(start.at[:2], other.at[:2]) >= _least(start) for other in kept):
            kept.append(start)
    return tuple(kept[:MAX_ROAD_STARTS])


def _least(start: StartPose) -> float:
    """Return the least distance of a start pose to others [m]: spots are narrower than cars are long."""
    return NEAREST_STARTS if start.tag.endswith("_1") else 8 * METRES_PER_FOOT


def _start(tag: str, at: np.ndarray, ahead: np.ndarray) -> StartPose:
    x, y = at.tolist()
    dx, dy = (ahead - at).tolist()
    return StartPose(tag=tag, at=(x, y, START_ELEVATION), yaw=math.atan2(dy, dx))
