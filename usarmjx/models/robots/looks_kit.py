"""Solids for what robots are drawn as (`Part.looks`): never touched, never met by sensors, without mass.

Axes, sizes and rotations are those of `spec.shapes` in a robot's description: x forward, y right, z down, and
half lengths.
"""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np

from usarmjx.base.transforms import Vec3, flip_vector
from usarmjx.models.spec.shapes import ZERO, Mesh, Rgba, Shape

ACROSS: Vec3 = (-math.pi / 2, 0.0, 0.0)
ALONG: Vec3 = (0.0, math.pi / 2, 0.0)
"""Turn a cylinder's axis (z) to the side (y), and ahead (x)."""

RUBBER: Rgba = (0.13, 0.13, 0.14, 1.0)
TREAD: Rgba = (0.2, 0.2, 0.21, 1.0)
BLACK: Rgba = (0.08, 0.08, 0.09, 1.0)
DARK: Rgba = (0.22, 0.23, 0.25, 1.0)
STEEL: Rgba = (0.62, 0.64, 0.67, 1.0)
SILVER: Rgba = (0.8, 0.81, 0.83, 1.0)
WHITE: Rgba = (0.93, 0.93, 0.91, 1.0)
GOLD: Rgba = (0.85, 0.65, 0.2, 1.0)
GLASS_BLACK: Rgba = (0.1, 0.14, 0.19, 1.0)
SICK_BLUE: Rgba = (0.16, 0.32, 0.66, 1.0)
SICK_YELLOW: Rgba = (0.96, 0.8, 0.12, 1.0)
LAMP: Rgba = (0.98, 0.97, 0.86, 1.0)
AMBER: Rgba = (0.98, 0.6, 0.1, 1.0)
TAIL_LAMP: Rgba = (0.8, 0.07, 0.07, 1.0)


def block(size: Vec3, at: Vec3 = ZERO, rgba: Rgba = DARK, rotation: Vec3 = ZERO) -> Shape:
    """Return a box of some half lengths."""
    return Shape(kind="box", size=size, at=at, rotation=rotation, rgba=rgba, surface="fixture")


def drum(radius: float, half: float, at: Vec3 = ZERO, rgba: Rgba = DARK, rotation: Vec3 = ZERO) -> Shape:
    """Return a cylinder, upright unless turned."""
    return Shape(kind="cylinder", size=(radius, half), at=at, rotation=rotation, rgba=rgba, surface="fixture")


def ball(radii: Vec3, at: Vec3 = ZERO, rgba: Rgba = DARK, rotation: Vec3 = ZERO) -> Shape:
    """Return an ellipsoid."""
    return Shape(kind="ellipsoid", size=radii, at=at, rotation=rotation, rgba=rgba, surface="fixture")


def rod(start: Vec3, end: Vec3, radius: float, rgba: Rgba = DARK, *, blunt: bool = False) -> Shape:
    """Return a rod between two points, with round ends unless it is blunt."""
    way = np.subtract(end, start)
    length = float(np.linalg.norm(way))
    turn = (0.0, math.acos(way[2] / length), math.atan2(way[1], way[0]))
    x, y, z = (np.add(start, end) / 2).tolist()
    kind = "cylinder" if blunt else "capsule"
    return Shape(
        kind=kind, size=(radius, length / 2), at=(x, y, z), rotation=turn, rgba=rgba, surface="fixture"
    )


def mirrored(half_profile: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return a profile (x, z) and its image behind x = 0."""
    return [*half_profile, *((-x, z) for x, z in reversed(half_profile))]


@cache
def _mesh(corners: tuple[Vec3, ...]) -> Mesh:
    """Return a mesh: unlike its place, its corners are not turned when a robot is built."""
    return Mesh(np.array([flip_vector(corner) for corner in corners], float))


def hull(corners: Sequence[Vec3], rgba: Rgba = DARK) -> Shape:
    """Return the convex solid about some corners."""
    return Shape(kind="mesh", mesh=_mesh(tuple(corners)), rgba=rgba, surface="fixture")


def prism(profile: Sequence[tuple[float, float]], half: float, rgba: Rgba, top: float | None = None) -> Shape:
    """Return a convex solid of one profile (x, z) from side to side.

    Args:
        profile: Its corners.
        half: Half its width.
        rgba: Its colour.
        top: Half the width of its highest corners; None: as of all.
    """
    height = min(z for _, z in profile)
    wide = [half if z > height or top is None else top for _, z in profile]
    return hull(
        [(x, side * y, z) for side in (-1.0, 1.0) for (x, z), y in zip(profile, wide, strict=True)], rgba
    )


def wheel_looks(
    radius: float,
    width: float,
    *,
    rim: float = 0.62,
    bars: int = 3,
    rgba: Rgba = SILVER,
    shift: float = 0.0,
) -> tuple[Shape, ...]:
    """Return a wheel whose turning shows: tyre, dish, spokes from rim to rim, hub cap.

    Args:
        radius: Of the tyre [m].
        width: Of the tyre [m].
        rim: Radius of the dish over the tyre's.
        bars: How many bars of two spokes each.
        rgba: Colour of spokes and hub cap.
        shift: How far to the right of its axle's middle it is drawn [m].
    """
    inner, half, at = rim * radius, width / 2, (0.0, shift, 0.0)
    spoke = (0.96 * inner, half + 0.03 * radius, 0.09 * radius)
    return (
        drum(radius, half, at, RUBBER, ACROSS),
        drum(inner, half + 0.015 * radius, at, DARK, ACROSS),
        *(block(spoke, at, rgba, (0.0, k * math.pi / bars, 0.0)) for k in range(bars)),
        drum(0.2 * radius, half + 0.05 * radius, at, rgba, ACROSS),
    )


def cleats(radius: float, width: float, count: int, thick: float) -> tuple[Shape, ...]:
    """Return the cleats of a track's wheel: bars across it, of which the tips stand out of the belt.

    Args:
        radius: How far out they reach [m].
        width: Of the track [m].
        count: Bars of two cleats each.
        thick: Of a bar [m].
    """
    return tuple(
        block((radius, width / 2, thick / 2), rgba=TREAD, rotation=(0.0, k * math.pi / count, 0.0))
        for k in range(count)
    )


def sprocket(radius: float, width: float, rgba: Rgba) -> tuple[Shape, ...]:
    """Return the sides of a sprocket in a track of some width [m]: a dish with spokes and a cap."""
    half = width / 2
    return (
        drum(radius, half + 0.004, rgba=DARK, rotation=ACROSS),
        block((0.9 * radius, half + 0.007, 0.13 * radius), rgba=rgba),
        block((0.13 * radius, half + 0.007, 0.9 * radius), rgba=rgba),
        drum(0.3 * radius, half + 0.01, rgba=rgba, rotation=ACROSS),
    )


def belt(front: Vec3, rear: Vec3, radii: tuple[float, float], width: float) -> tuple[Shape, ...]:
    """Return a track's belt about two axles that lie ahead of each other.

    Args:
        front: Middle of the front axle.
        rear: Middle of the rear axle.
        radii: Outer radii of the belt about them [m].
        width: Of the belt [m].
    """
    (x0, y, z0), (x1, _, z1), half = front, rear, width / 2
    ends = (drum(radii[0], half, front, RUBBER, ACROSS), drum(radii[1], half, rear, RUBBER, ACROSS))
    if radii[0] == radii[1] and z0 == z1:
        return (*ends, block(((x0 - x1) / 2, half, radii[0]), ((x0 + x1) / 2, y, z0), RUBBER))
    lean = (radii[1] - radii[0]) / math.hypot(x0 - x1, z0 - z1)  # where straight runs touch both ends
    ahead, rise, corners = math.copysign(1.0, x0 - x1), math.sqrt(1 - lean * lean), list[Vec3]()
    for (x, z), radius in zip(((x0, z0), (x1, z1)), radii, strict=True):
        for side in (-1.0, 1.0):
            corners += [
                (x + ahead * lean * radius, y + across, z + side * rise * radius) for across in (-half, half)
            ]
    return (*ends, hull(corners, RUBBER))


def sick(at: Vec3) -> tuple[Shape, ...]:
    """Return a SICK LMS200, whose beams leave at `at`: a blue box with a dark window all around its front."""
    x, y, z = at
    return (
        block((0.0775, 0.078, 0.03), (x, y, z + 0.02), SICK_BLUE),
        block((0.04, 0.078, 0.025), (x - 0.0375, y, z - 0.035), SICK_BLUE),
        drum(0.068, 0.03, (x, y, z - 0.035), BLACK),
        block((0.0775, 0.078, 0.025), (x, y, z - 0.085), SICK_BLUE),
        block((0.002, 0.04, 0.009), (x + 0.0775, y, z - 0.085), SICK_YELLOW),
    )


def sonar_discs(
    sonars: Sequence[tuple[Vec3, float]], push: float, radius: float = 0.017
) -> tuple[Shape, ...]:
    """Return the golden fronts of sonars at (place, yaw), pushed ahead of their places [m]."""
    return tuple(
        drum(
            radius,
            0.004,
            (x + push * math.cos(yaw), y + push * math.sin(yaw), z),
            GOLD,
            (0.0, math.pi / 2, yaw),
        )
        for (x, y, z), yaw in sonars
    )


def lens(at: Vec3, radius: float, rgba: Rgba = BLACK, depth: float = 0.012) -> tuple[Shape, ...]:
    """Return a camera's lens that looks ahead: a barrel and its glass."""
    x, y, z = at
    return (
        drum(radius, depth, at, rgba, ALONG),
        drum(0.7 * radius, 0.002, (x + depth, y, z), (0.25, 0.35, 0.5, 1.0), ALONG),
    )
