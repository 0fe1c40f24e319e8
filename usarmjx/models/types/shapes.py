"""Solids of robots, arenas and effecters: their geometry, contact surface, material and texture.

A shape lies in the axes of the description that holds it: USARSim's for robots and effecters (see
`types.robot`); x forward, y left, z up for arenas. Lengths are metres, angles radians, masses kilograms.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np

from usarmjx.base.settings import NOT_NEGATIVE, SHARE, Setting
from usarmjx.base.transforms import Vec3

Position2D: TypeAlias = tuple[float, float]
"""x and y on the ground [m]."""
Rgba: TypeAlias = Annotated[tuple[float, float, float, float], SHARE]
"""Red, green, blue and opacity, each from 0 to 1."""
ZERO: Vec3 = (0.0, 0.0, 0.0)
ACROSS: Vec3 = (-math.pi / 2, 0.0, 0.0)
"""Rotation of a cylinder's axis (z) to the side (y)."""
ALONG: Vec3 = (0.0, math.pi / 2, 0.0)
"""Rotation of a cylinder's axis (z) ahead (x)."""
TEXTURES = ("brick", "tiles", "wood", "concrete", "chart", "hazmat", "tag", "qr")
"""All textures: patterns of walls and floors, and signs."""
SIGNS = {"chart": 999, "hazmat": 5, "tag": 9, "qr": 9}
"""Textures that are signs in the middle of each face of a box, with their largest numbers (`tag:7`)."""
CODE_STRIDE = 16
"""Number of texture codes per sign number: a code is one plus the index of the texture, plus this times its
number."""


@dataclass(frozen=True)
class Surface:
    """Contact parameters of a kind of surface.

    Attributes:
        friction: Sliding friction coefficient.
        priority: MuJoCo's: of two touching surfaces the one with the higher priority sets the friction.
        contype: MuJoCo's collision type bits.
        conaffinity: MuJoCo's collision affinity bits.
        solref: MuJoCo's: time constant of a contact [s], and its damping ratio.
        solimp: MuJoCo's: impedance at zero depth and at a depth, and that depth [m].
    """

    friction: float
    priority: int
    contype: int
    conaffinity: int
    solref: tuple[float, float] = (0.02, 1.0)
    solimp: tuple[float, float, float] = (0.9, 0.95, 0.001)


HULL_BIT, WHEEL_BIT, FIXED_BIT = 1, 2, 4
"""Collision bits. Fixed solids do not touch each other; nor do wheels: a robot's hull covers its wheels, and
cylinder against cylinder is the least reliable pair of MJX-JAX."""

# Friction 0.8 holds a robot on slopes up to 38 degrees. Walls are slick and have the highest priority, so
# that a robot that pushes one spins its wheels instead of climbing it.
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
"""Contact parameters by the names that `Shape.surface` takes."""
MAX_SLIP_FACTOR, MAX_SOFTNESS, MIN_RESTITUTION, MAX_RESTITUTION = 10.0, 9.0, 1e-3, 0.95
"""Limits of a tyre's contact: factor on or divisor of the slip, softness (settling time times one more than
that), and the smallest and largest restitution. The solver is stable within them."""


@dataclass(frozen=True, kw_only=True)
class Tyre:
    """Parameters of a tyre in Karma's terms (manual 14.4.2.3); the defaults keep the surface unchanged.

    A MuJoCo contact has one friction coefficient in all directions, and one slip, the speed at which it
    creeps under a force: both use the geometric mean of Karma's two directions. Slip and softness affect each
    other slightly: a contact that gives sideways also gives downwards.

    Attributes:
        roll_friction: Friction in the tyre's direction.
        lateral_friction: Friction across the tyre.
        roll_slip: Largest slip in the tyre's direction.
        lateral_slip: Largest slip across the tyre.
        min_slip: Smallest slip in both directions.
        slip_rate: Slip per Unreal unit a second of its robot's top speed.
        softness: Softness; 1 doubles the time in which a contact settles.
        restitution: Ratio of rebound to impact speed.
        speed: Top speed of its robot [Unreal units/s].
    """

    roll_friction: float = 15.0
    lateral_friction: float = 15.0
    roll_slip: float = 0.06
    lateral_slip: float = 0.06
    min_slip: float = 0.001
    slip_rate: float = 0.0005
    softness: float = 0.0
    restitution: float = 0.0
    speed: float = 0.0

    @property
    def slip(self) -> float:
        """Karma's slip at the top speed: the mean of both directions."""
        grown = self.min_slip + self.slip_rate * self.speed
        return math.sqrt(min(self.roll_slip, grown) * min(self.lateral_slip, grown))

    def on(self, surface: Surface) -> Surface:
        """Return a stock tyre's surface changed by these parameters; it takes priority over the ground."""
        stock = Tyre(speed=self.speed)
        # Karma's friction has no unit in common with a coefficient: the stock tyre is our surface as it is.
        grip = math.sqrt(self.roll_friction * self.lateral_friction) / stock.roll_friction
        slip = min(max(self.slip / stock.slip, 1 / MAX_SLIP_FACTOR), MAX_SLIP_FACTOR)
        begins, deep, depth = surface.solimp
        # Damping ratio of a mass on a spring with that coefficient of restitution, at an unchanged frequency:
        # e = exp(-pi z / sqrt(1 - z^2)), solved for z.
        loss = math.log(min(max(self.restitution, MIN_RESTITUTION), MAX_RESTITUTION))
        ratio = 1.0 if self.restitution <= MIN_RESTITUTION else -loss / math.hypot(math.pi, loss)
        return replace(
            surface,
            friction=surface.friction * grip,
            priority=max(surface.priority, 1),
            solref=(surface.solref[0] * (1 + min(self.softness, MAX_SOFTNESS)) / ratio, ratio),
            # MuJoCo's contact creeps in proportion to (1 - d) / d for impedance d: scaling that ratio scales
            # the slip.
            solimp=(*(1 / (1 + (1 / share - 1) * slip) for share in (begins, deep)), depth),
        )


MAX_BELT_SPEED = 10.0
"""Greatest speed of a conveyor along an axis [m/s]."""

OPAQUE = "opaque"
"""Material that stops rays, the default."""
GLASS = "glass"
"""Material that passes infrared and light, not sound."""
MIRROR = "mirror"
"""Material that reflects light, and stops other rays."""
FENDER = "fender"
"""Material of a grid fender: passes every ray that meets one of its holes."""
SKY = "sky"
"""Material that passes everything but light, is never touched and does not attenuate radio."""
MATERIALS = (OPAQUE, GLASS, MIRROR, FENDER, SKY)
"""Values of `Shape.material`: effects of a solid on rays (manual 14.1.2)."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A solid given by its vertices [m] (vertices, 3); contacts and the radio use their convex hull.

    Rays and pictures use its faces (faces, 3), three vertex indices each, counter-clockwise from outside;
    those of the hull if it has none. Meshes with equal vertices and faces are equal.
    """

    vertices: np.ndarray
    faces: np.ndarray | None = None

    def __eq__(self, other: object) -> bool:
        """Return whether the other has the same vertices and faces."""
        if not isinstance(other, Mesh) or (self.faces is None) != (other.faces is None):
            return False
        same = np.array_equal(self.vertices, other.vertices)
        return same and (self.faces is None or np.array_equal(self.faces, other.faces))  # type: ignore[arg-type]

    def __hash__(self) -> int:
        """Return the hash of the vertices."""
        # Faces are left out: equal meshes have equal vertices, and that is all that a hash has to keep.
        return hash(self.vertices.tobytes())


@dataclass(frozen=True, eq=False)
class HeightField:
    """Terrain: heights above the shape's position on a regular grid, none below zero [m] (rows, columns).

    Rows run along y, columns along x, from the corner with the lowest of both; the shape's size is half the
    lengths along x and y, and the thickness of the ground below the lowest point.
    """

    heights: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Conveyor:
    """A moving surface, which carries what stands on it; engine `c` alone moves it.

    Attributes:
        name: Name under which a world controller sets its speed; several belts may share it.
        velocity: Velocity of the surface in the axes of its solid [m/s].
    """

    name: str
    velocity: Vec3


@dataclass(frozen=True, kw_only=True)
class Shape:
    """One solid, for contacts and for rays.

    Attributes:
        kind: MuJoCo geom type.
        size: MuJoCo's size numbers: half lengths of a box; radius; radius and half length.
        at: Centre, in the axes of the description that holds it.
        rotation: Roll, pitch, yaw [rad].
        mass: Mass [kg]; 0 leaves the body's mass to its other shapes.
        surface: A key of `SURFACES`.
        tyre: Tyre parameters that modify its surface.
        material: Effect on rays; one of `MATERIALS`. Fenders are boxes.
        mesh: The solid of kind mesh.
        heights: The terrain of kind hfield.
        rgba: Colour, for pictures.
        texture: Texture in pictures, for the arena's fixed solids; see `TEXTURES`.
        conveyor: Motion of its surface, for an arena's fixed boxes.
    """

    kind: Literal["box", "sphere", "capsule", "cylinder", "ellipsoid", "mesh", "hfield"]
    size: tuple[float, ...] = ()
    at: Vec3 = ZERO
    rotation: Vec3 = ZERO
    mass: Annotated[float, NOT_NEGATIVE] = 0.0
    surface: Annotated[str, Setting(choices=tuple(SURFACES))] = "hull"
    tyre: Tyre | None = None
    material: Annotated[str, Setting(choices=MATERIALS)] = OPAQUE
    mesh: Mesh | None = None
    heights: HeightField | None = None
    rgba: Rgba = (0.7, 0.7, 0.7, 1.0)
    texture: str = ""
    conveyor: Conveyor | None = None


@dataclass(frozen=True, kw_only=True)
class BodyInertia:
    """Mass and inertia that a file states of a body, in place of those of its solids.

    Attributes:
        mass: Mass [kg].
        at: Centre of mass, in the axes of that body [m].
        moments: Inertia about that centre, in the same axes: xx, yy, zz, xy, xz, yz [kg m2].
    """

    mass: float
    at: Vec3
    moments: tuple[float, float, float, float, float, float]


def texture_problem(texture: str) -> str:
    """Return the error of a texture's name, "" if it is valid; "" itself is no texture."""
    name, colon, number = texture.partition(":")
    if not texture or (name in TEXTURES and not colon):
        return ""
    if name in SIGNS and number.isdecimal() and int(number) <= SIGNS[name]:
        return ""
    signs = ", ".join(f"{name}:0 to {name}:{last}" for name, last in SIGNS.items())
    plain = ", ".join(name for name in TEXTURES if name not in SIGNS)
    return f"no texture {texture!r}; known: {plain}, {signs}"


def texture_code(texture: str) -> int:
    """Return the code of a texture; 0 is no texture."""
    name, _, number = texture.partition(":")
    return TEXTURES.index(name) + 1 + CODE_STRIDE * int(number or 0) if name else 0


def decode_texture(code: Any) -> tuple[Any, Any]:  # noqa: ANN401 - a whole number, or an array of them
    """Return the texture, counted from 1, and the sign number of codes."""
    return code % CODE_STRIDE, code // CODE_STRIDE


def texture_names(codes: Any) -> frozenset[str]:  # noqa: ANN401 - whole numbers
    """Return the names of the textures of some codes."""
    return frozenset(TEXTURES[int(code) % CODE_STRIDE - 1] for code in codes if code)
