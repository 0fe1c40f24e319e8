"""Content of files for arenas, and defaults for missing surfaces, extents and start poses."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from usarmjx.base.transforms import Vec3, mat_from_angles
from usarmjx.models.compile.raster import half_lengths
from usarmjx.models.compile.reachability import reach_map, shapes_in_arena
from usarmjx.models.types.arena import (
    START_ELEVATION,
    ArenaSpec,
    Door,
    GpsOrigin,
    Light,
    LooseObject,
    StartPose,
)
from usarmjx.models.types.shapes import Shape

Rectangle = tuple[tuple[float, float], tuple[float, float]]
"""Limits of x and of y [m]."""
MIN_WALL_HEIGHT = 0.3
"""Height from which a solid that is thinner than high is a wall by default [m]."""
UPRIGHT_TOLERANCE = 1e-3
"""Lean of the z axis up to which a solid is upright [rad]."""
EXTENT_MARGIN = 1.0
"""Margin of an extent around the solids [m]."""
EMPTY_EXTENT: Rectangle = ((-5.0, 5.0), (-5.0, 5.0))
"""Extent of an arena without solids."""
MAX_COORDINATE = 1e7
"""Largest distance from an arena's origin, and largest length [m]."""
START_CLEARANCE = (0.45, 0.05)
"""Radius of the free circle that a start pose needs, and the highest step in it [m]."""
PREFERRED_START_SLOPE, MAX_START_SLOPE = math.radians(2), math.radians(20)
"""Largest slope of a start pose, first choice and fallback [rad]."""
DEFAULT_START_TAG = "PlayerStart"
"""Tag of an automatic start pose, the Unreal editor's (manual 5.3.2)."""


@dataclass(frozen=True, kw_only=True)
class Content:
    """Content of a file for an arena, in the arena's axes.

    Attributes:
        shapes: Fixed solids.
        loose: Loose objects.
        doors: Doors.
        floor: Whether it has an unbounded floor at height zero; None: unspecified.
        extent: Its floor plan; None: that of its solids.
        free_position: x and y of a free position; None: to be found.
        starts: Start poses.
        lights: Lamps.
        gps: Latitude and longitude of the origin [degrees]; None: unknown.
        warnings: Content that was left out, in words.
    """

    shapes: tuple[Shape, ...] = ()
    loose: tuple[LooseObject, ...] = ()
    doors: tuple[Door, ...] = ()
    floor: bool | None = None
    extent: Rectangle | None = None
    free_position: tuple[float, float] | None = None
    starts: tuple[StartPose, ...] = ()
    lights: tuple[Light, ...] = ()
    gps: GpsOrigin | None = None
    warnings: tuple[str, ...] = ()


def merge_contents(parts: Sequence[Content]) -> Content:
    """Return the content of several files as one."""
    floors = [part.floor for part in parts if part.floor is not None]
    extents = [part.extent for part in parts if part.extent is not None]
    return Content(
        shapes=tuple(shape for part in parts for shape in part.shapes),
        loose=tuple(loose for part in parts for loose in part.loose),
        doors=tuple(door for part in parts for door in part.doors),
        floor=any(floors) if floors else None,
        extent=_around(np.array(extents).swapaxes(1, 2).reshape(-1, 2)) if extents else None,
        free_position=next((part.free_position for part in parts if part.free_position is not None), None),
        starts=tuple(start for part in parts for start in part.starts),
        lights=tuple(light for part in parts for light in part.lights),
        gps=next((part.gps for part in parts if part.gps is not None), None),
        warnings=tuple(warning for part in parts for warning in part.warnings),
    )


def corners_of(shape: Shape) -> np.ndarray:
    """Return lowest and highest corner of the box around a solid, in the axes that hold it (2, 3) [m]."""
    if shape.mesh is not None:
        points = np.asarray(shape.mesh.vertices, float)
    elif shape.heights is not None:
        x, y, base = shape.size
        # The box goes from the bottom of the base, which lies below z = 0, to the highest point.
        high = float(np.max(shape.heights.heights))
        points = np.array([[a * x, b * y, c] for a in (-1, 1) for b in (-1, 1) for c in (-base, high)])
    else:
        signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), -1).reshape(-1, 3)
        points = signs * half_lengths(shape)
    turned = points @ mat_from_angles(*np.array(shape.rotation)).T + shape.at
    return np.stack([turned.min(0), turned.max(0)])


def surface_of(shape: Shape) -> str:
    """Return the default surface of a solid: "wall" if it stands upright, else "ground"."""
    low, high = corners_of(shape)
    length, width, height = high - low
    # The last element of the matrix is the cosine between the solid's z axis and the vertical.
    upright = mat_from_angles(*np.array(shape.rotation))[2, 2] > np.cos(UPRIGHT_TOLERANCE)
    return "wall" if upright and height >= MIN_WALL_HEIGHT and min(length, width) < height else "ground"


def transform_content(content: Content, at: Vec3, yaw: float) -> Content:
    """Return content rotated about the vertical through the origin, and then moved."""
    if at == (0.0, 0.0, 0.0) and yaw == 0.0:
        return content
    mat = mat_from_angles(0.0, 0.0, np.float64(yaw))

    def there(point: Vec3) -> Vec3:
        x, y, z = (mat @ point + at).tolist()
        return (x, y, z)

    def turned(angles: Vec3) -> Vec3:  # the yaw of ZYX angles comes last
        return (angles[0], angles[1], angles[2] + yaw)

    return replace(
        content,
        shapes=tuple(replace(s, at=there(s.at), rotation=turned(s.rotation)) for s in content.shapes),
        loose=tuple(replace(o, at=there(o.at), rotation=turned(o.rotation)) for o in content.loose),
        doors=tuple(replace(door, at=there(door.at), yaw=door.yaw + yaw) for door in content.doors),
        starts=tuple(replace(start, at=there(start.at), yaw=start.yaw + yaw) for start in content.starts),
        lights=tuple(replace(light, at=there(light.at)) for light in content.lights),
        # A turned extent is no rectangle along the axes, and north is no longer x.
        gps=None,
        extent=None,
        free_position=None if content.free_position is None else there((*content.free_position, 0.0))[:2],
    )


def extent_of(shapes: Sequence[Shape], loose: Sequence[LooseObject] = ()) -> Rectangle:
    """Return x and y limits of solids with a margin around them."""
    solids = [*shapes, *(shape for one in loose for shape in shapes_in_arena(one))]
    if not solids:
        return EMPTY_EXTENT
    points = np.concatenate([corners_of(shape) for shape in solids])[:, :2]
    return _around(np.concatenate([points - EXTENT_MARGIN, points + EXTENT_MARGIN]))


def _around(points: np.ndarray) -> Rectangle:
    # Rounded to a micrometre: rotations leave digits that no file needs to show.
    (x0, y0), (x1, y1) = points.min(0).round(6).tolist(), points.max(0).round(6).tolist()
    return ((x0, x1), (y0, y1))


def free_start_pose(arena: ArenaSpec, wish: tuple[float, float] | None = None) -> StartPose | None:
    """Return a start pose on level ground with clearance: in the largest free area, near its middle.

    Args:
        arena: The arena; it needs no start poses yet.
        wish: Preferred x and y; used if there is room.
    """
    # `reach_map` wants a start pose; the areas do not depend on it.
    nowhere = StartPose(tag=DEFAULT_START_TAG, at=(*np.mean(arena.extent, axis=1).tolist(), START_ELEVATION))
    found = reach_map(replace(arena, starts=(nowhere,)), *START_CLEARANCE, slope=PREFERRED_START_SLOPE)
    if found.area.max() < 0:
        found = reach_map(replace(arena, starts=(nowhere,)), *START_CLEARANCE, slope=MAX_START_SLOPE)
    layers, i, j = np.nonzero(found.area >= 0)
    if not len(layers):
        return None
    # Areas have numbers from 0; cells that no robot can stand on have -1, which NumPy's counts refuse.
    areas = found.area[layers, i, j]
    x = found.grid.low[0] + (i + 0.5) * found.grid.cell
    y = found.grid.low[1] + (j + 0.5) * found.grid.cell
    ground = found.ground[layers, i, j]
    largest = np.bincount(areas)[areas] == np.bincount(areas).max()
    aim = wish if wish is not None else (x[largest].mean(), y[largest].mean())
    away = np.hypot(x - aim[0], y - aim[1])
    # If no robot fits at the wish itself, only the largest area counts.
    if wish is None or away.min() > found.grid.cell:
        away = np.where(largest, away, np.inf)
    # The last key of NumPy's lexsort is the first one: of equal distances the lowest ground wins.
    best = int(np.lexsort((ground, away))[0])
    at = (round(float(x[best]), 3), round(float(y[best]), 3), round(float(ground[best]) + START_ELEVATION, 6))
    return StartPose(tag=DEFAULT_START_TAG, at=at)
