"""Solids: what robots, arenas and effecters are built of, how they touch others and what they do to rays.

A shape lies in the axes of the description that holds it: USARSim's for robots and effecters (see
`spec.robot`); x forward, y left, z up for arenas. Lengths are metres, angles radians, masses kilograms.
"""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from usarmjx.base.transforms import Vec3

Position2D: TypeAlias = tuple[float, float]
"""x and y on the ground [m]."""
Rgba: TypeAlias = tuple[float, float, float, float]
"""Red, green, blue and how opaque, each from 0 to 1."""

ZERO: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Surface:
    """How a kind of surface touches others.

    Attributes:
        friction: Sliding friction coefficient.
        priority: MuJoCo's: of two touching surfaces the one with the higher priority sets the friction.
        contype: MuJoCo's collision type bits.
        conaffinity: MuJoCo's collision affinity bits.
        solref: MuJoCo's: time in which a contact settles [s], and its damping ratio.
        solimp: MuJoCo's: share of the force that a contact takes up where it begins and at a depth [m].
    """

    friction: float
    priority: int
    contype: int
    conaffinity: int
    solref: tuple[float, float] = (0.02, 1.0)
    solimp: tuple[float, float, float] = (0.9, 0.95, 0.001)


HULL_BIT, WHEEL_BIT, FIXED_BIT = 1, 2, 4
"""Collision bits. Fixed things do not touch each other; nor do wheels: a robot's hull covers its wheels, and
cylinder against cylinder is the least reliable pair of MJX-JAX."""

# Friction 0.8 holds a robot on slopes up to 38 degrees. Walls are slick and have the last word, so that
# a robot that pushes one spins its wheels instead of climbing it.
SURFACES = {
    "ground": Surface(friction=0.8, priority=0, contype=FIXED_BIT, conaffinity=HULL_BIT | WHEEL_BIT),
    "wall": Surface(friction=0.3, priority=2, contype=FIXED_BIT, conaffinity=HULL_BIT | WHEEL_BIT),
    "hull": Surface(friction=0.3, priority=0, contype=HULL_BIT, conaffinity=HULL_BIT | WHEEL_BIT | FIXED_BIT),
    "wheel": Surface(friction=0.8, priority=0, contype=WHEEL_BIT, conaffinity=HULL_BIT | FIXED_BIT),
    # With 0.8 a Talon hangs between its wheels on stairs of 35 degrees; rubber cleats have more (chosen).
    "track": Surface(friction=1.2, priority=0, contype=WHEEL_BIT, conaffinity=HULL_BIT | FIXED_BIT),
    "caster": Surface(friction=0.01, priority=1, contype=WHEEL_BIT, conaffinity=HULL_BIT | FIXED_BIT),
    # Under a steady load a soft contact creeps, by 0.5 mm/s with MuJoCo's own figures: a brick would be lost
    # after a minute. These make it 0.2 mm/s; still harder ones need more iterations than the solver has.
    "finger": Surface(
        friction=1.5,
        priority=3,
        contype=HULL_BIT,
        conaffinity=HULL_BIT | WHEEL_BIT | FIXED_BIT,
        solref=(0.01, 1.0),
        solimp=(0.95, 0.98, 0.001),
    ),
    "loose": Surface(
        friction=0.6, priority=0, contype=HULL_BIT, conaffinity=HULL_BIT | WHEEL_BIT | FIXED_BIT
    ),
    "fixture": Surface(friction=0.3, priority=0, contype=0, conaffinity=0),  # seen, but never touched
}


OPAQUE, GLASS, MIRROR, FENDER, SKY = "opaque", "glass", "mirror", "fender", "sky"
MATERIALS = (OPAQUE, GLASS, MIRROR, FENDER, SKY)
"""What a solid does to rays (manual 14.1.2), beside stopping them: glass lets infrared and light through,
not sound; a mirror reflects light; a grid fender lets every ray through that meets one of its holes; the sky
lets everything but light through, is never touched, and is no wall to the radio."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A convex solid: its corners [m] (vertices, 3), of which MuJoCo takes the convex hull.

    Two are the same if they have the same corners.
    """

    vertices: np.ndarray

    def __eq__(self, other: object) -> bool:
        """Whether the other has the same corners."""
        return isinstance(other, Mesh) and np.array_equal(self.vertices, other.vertices)

    def __hash__(self) -> int:
        """Return the hash of the corners."""
        return hash(self.vertices.tobytes())


@dataclass(frozen=True, eq=False)
class HeightField:
    """Terrain: heights above the shape's place on a regular grid, none below zero [m] (rows, columns).

    Rows run along y, columns along x, from the corner with the lowest of both; the shape's size is half the
    lengths along x and y, and the thickness of the ground below the lowest point.
    """

    heights: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Shape:
    """One solid, seen by contacts and by rays.

    Attributes:
        kind: MuJoCo geom type.
        size: MuJoCo's size numbers: half lengths of a box; radius; radius and half length.
        at: Centre, in the axes of the description that holds it.
        rotation: Roll, pitch, yaw.
        mass: Mass; 0 leaves the body's mass to its other shapes.
        surface: A key of `SURFACES`.
        material: What it does to rays; one of `MATERIALS`. Fenders are boxes.
        mesh: The solid of kind mesh.
        heights: The terrain of kind hfield.
        rgba: Colour, for pictures.
    """

    kind: Literal["box", "sphere", "capsule", "cylinder", "ellipsoid", "mesh", "hfield"]
    size: tuple[float, ...] = ()
    at: Vec3 = ZERO
    rotation: Vec3 = ZERO
    mass: float = 0.0
    surface: str = "hull"
    material: str = OPAQUE
    mesh: Mesh | None = None
    heights: HeightField | None = None
    rgba: Rgba = (0.7, 0.7, 0.7, 1.0)
