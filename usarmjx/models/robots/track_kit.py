"""Tracks in the original's way (manual 12.10.2): rows of driven wheels, on the chassis or on flippers.

Wheels of one robot never touch each other, so those of a row may overlap: more wheels approximate a belt
better, and cost more. Every wheel has a motor, and all of a side run at one belt speed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from usarmjx.base.transforms import Vec3
from usarmjx.models.drives import Tracks
from usarmjx.models.robots.kit import ACROSS, BLACK, STEEL, block, cleats, drum, wheel
from usarmjx.models.robots.kit import belt as belt_looks
from usarmjx.models.robots.kit import sprocket as sprocket_looks
from usarmjx.models.types.robot import CHASSIS, MissionPackage, Motor, Part
from usarmjx.models.types.shapes import ZERO, Rgba, Shape

BELT_STIFFNESS, BELT_DAMPING = 2000.0, 70.0
"""Gains of a wheel's servo over its inertia [1/s2], [1/s]: stable at steps of 5 ms (a twentieth and a third
of the limits), damped to 0.8 of critical."""
CLEAT_PITCH = 5.5
"""Spacing of drawn cleats over their height."""

FLIPPERS = ("FRFlipper", "FLFlipper", "RRFlipper", "RLFlipper")
"""Names of the flippers' parts."""

GRIPPER_FINGERS_MASS = 0.2
"""Mass of the two fingers of a gripper [kg]: part of the robot's mass, but not of its own parts."""


@dataclass(frozen=True, kw_only=True)
class Belt:
    """Common properties of the wheels of a robot's tracks.

    Attributes:
        radius: Radius of the wheels whose speed DRIVE sets [m].
        max_spin: Highest speed of those wheels [rad/s].
        width: Width of the tracks [m].
        max_pull: Largest pull of one wheel [N].
        inertia: Inertia of a wheel's motor at the belt [kg].
        wheel_mass: Mass of a wheel of that radius [kg]; those of smaller ones scale with their area.
        cleat: Height of the drawn cleats [m]; the wheels' radii include it.
        trim: Colour of its sprockets.
    """

    radius: float
    max_spin: float
    width: float
    max_pull: float
    inertia: float
    wheel_mass: float
    cleat: float = 0.01
    trim: Rgba = STEEL

    def motor(self, radius: float) -> Motor:
        """Return the motor of a wheel of some radius: same pull, same belt speed."""
        armature = self.inertia * radius**2
        return Motor(
            max_speed=self.max_spin * self.radius / radius,
            torque=self.max_pull * radius,
            stiffness=BELT_STIFFNESS * armature,
            damping=BELT_DAMPING * armature,
            armature=armature,
        )

    def wheel(self, name: str, at: Vec3, radius: float, parent: str = CHASSIS) -> Part:
        """Return one wheel of a track."""
        mass = self.wheel_mass * (radius / self.radius) ** 2
        size = (radius, self.width)
        part = wheel(
            name, at=at, size=size, mass=mass, motor=self.motor(radius), parent=parent, surface="track"
        )
        return replace(part, looks=self._bearing(radius))

    def _bearing(self, radius: float) -> tuple[Shape, ...]:
        return (drum(0.28 * radius, self.width / 2 + 0.003, rgba=self.trim, rotation=ACROSS),)

    def driven(self, part: Part, *, sprocket: bool = False) -> Part:
        """Return a wheel with the cleats that pass it as visuals, which thus run at the belt's speed."""
        radius = part.shapes[0].size[0]
        bars = max(3, round(math.pi * radius / (CLEAT_PITCH * self.cleat)))
        side = sprocket_looks(0.66 * radius, self.width, self.trim) if sprocket else self._bearing(radius)
        return replace(part, looks=(*cleats(radius, self.width, bars, 0.9 * self.cleat), *side))

    def looks(self, front: Vec3, rear: Vec3, radii: tuple[float, float] | None = None) -> tuple[Shape, ...]:
        """Return the belt around a row's foremost and rearmost wheel, as visuals of their parent."""
        outer = (self.radius, self.radius) if radii is None else radii
        first, last = (radius - self.cleat for radius in outer)
        return belt_looks(front, rear, (first, last), 0.96 * self.width)


def _with_cleats(belt: Belt, row: Sequence[Part]) -> tuple[Part, ...]:
    """Return a row of wheels, some with cleats, spaced so that the belt's cleats show no gap."""
    apart = abs(row[0].at[0] - row[-1].at[0]) / (len(row) - 1)
    shown = 2 * math.sqrt(2 * belt.radius * belt.cleat)  # along the belt, of a wheel's cleats
    step = max(1, round(shown / apart))
    ends = (0, len(row) - 1)
    return tuple(
        belt.driven(part, sprocket=i in ends) if i % step == 0 or i in ends else part
        for i, part in enumerate(row)
    )


def _along(first: float, last: float, count: int) -> list[float]:
    return [first + (last - first) * i / (count - 1) for i in range(count)]


def track_names(side: str, count: int) -> tuple[str, ...]:
    """Return names of a side's wheels from front to rear: LeftFWheel, LeftWheel2, ..., LeftRWheel."""
    return (f"{side}FWheel", *(f"{side}Wheel{i}" for i in range(2, count)), f"{side}RWheel")


def track(
    belt: Belt, names: Sequence[str], front: Vec3, rear: Vec3, parent: str = CHASSIS
) -> tuple[Part, ...]:
    """Return a straight row of equal wheels, evenly spaced.

    Args:
        belt: Properties of its wheels.
        names: Names of the wheels, from front to rear; at least two.
        front: Axle of the foremost wheel.
        rear: Axle of the rearmost wheel.
        parent: Part that carries them.
    """
    axles = zip(*(_along(a, b, len(names)) for a, b in zip(front, rear, strict=True)), strict=True)
    row = [belt.wheel(name, at, belt.radius, parent) for name, at in zip(names, axles, strict=True)]
    return _with_cleats(belt, row)


def track_pair_visuals(
    belt: Belt, *, separation: float, front: float, rear: float, height: float
) -> tuple[Shape, ...]:
    """Return the belts of a `track_pair` with the same arguments, visuals of the chassis."""
    sides = (-separation / 2, separation / 2)
    return tuple(solid for y in sides for solid in belt.looks((front, y, height), (rear, y, height)))


def track_pair(
    belt: Belt, count: int, *, separation: float, front: float, rear: float, height: float
) -> tuple[Part, ...]:
    """Return a left and a right track on the chassis.

    Args:
        belt: Properties of their wheels.
        count: Wheels of each track (manual 12.10.2 lets users set it).
        separation: Lateral distance of the tracks.
        front: x of the foremost axles.
        rear: x of the rearmost axles.
        height: z of the axles, down.
    """
    sides = (("Left", -separation / 2), ("Right", separation / 2))
    rows = [track(belt, track_names(side, count), (front, y, height), (rear, y, height)) for side, y in sides]
    return tuple(part for row in rows for part in row)


@dataclass(frozen=True, kw_only=True)
class Flippers:
    """Four tracked arms at a robot's corners, each on a hinge whose axis is an axle of the tracks.

    Attributes:
        pivot: x and y of the hinges, both positive [m].
        height: z of the hinges, down [m].
        length: Distance from the hinge to the axle of the tip's wheel [m].
        tip: Radius of the tip's wheel, smaller than the belt's radius at the hinge [m].
        count: Wheels on each flipper; the one around the hinge belongs to the chassis' tracks.
        mass: Mass of a flipper without its wheels [kg].
        motor: Servo of the hinge.
    """

    pivot: tuple[float, float]
    height: float
    length: float
    tip: float
    count: int
    mass: float
    motor: Motor

    def parts(self, belt: Belt) -> tuple[Part, ...]:
        """Return FRFlipper, FLFlipper, RRFlipper, RLFlipper (manual 12.10.1), each with its wheels.

        They point outward at zero. The wheels of FRFlipper are FRFlipperWheel1 to the tip's.
        """
        x, y = self.pivot
        corners = {"FR": (x, y), "FL": (x, -y), "RR": (-x, y), "RL": (-x, -y)}
        flippers: list[Part] = []
        wheels: list[Part] = []
        for corner, at in corners.items():
            out = 1 if at[0] > 0 else -1
            name = f"{corner}Flipper"
            tip = (out * self.length, 0.0, 0.0)
            side = (out * self.length * 0.45, 0.0, 0.0)
            looks = (
                *belt.looks(ZERO, tip, (belt.radius, self.tip)),
                block((0.3 * self.length, belt.width / 2 + 0.003, 0.3 * self.tip), side, belt.trim),
            )
            arm = (self._arm(out, belt),)
            flippers.append(Part(name=name, at=(*at, self.height), motor=self.motor, shapes=arm, looks=looks))
            for i, (distance, radius) in enumerate(self._row(belt.radius), start=1):
                part = belt.wheel(f"{name}Wheel{i}", (out * distance, 0.0, 0.0), radius, name)
                wheels.append(belt.driven(part, sprocket=i == self.count))
        return (*flippers, *wheels)

    def _row(self, root: float) -> list[tuple[float, float]]:
        """Return distance from the hinge and radius of each wheel.

        Both edges of the track are straight, and the radii form a geometric series, so that all gaps between
        wheels are similar.
        """
        radii = [root * (self.tip / root) ** (i / self.count) for i in range(1, self.count + 1)]
        return [(self.length * (root - radius) / (root - self.tip), radius) for radius in radii]

    def _arm(self, out: int, belt: Belt) -> Shape:
        """Return the arm inside its track, without contacts: the wheels surround it."""
        half = (self.length / 2, 0.4 * belt.width, self.tip / 2)
        return Shape(
            kind="box",
            size=half,
            at=(out * self.length / 2, 0.0, 0.0),
            mass=self.mass,
            surface="fixture",
            rgba=BLACK,
        )


def drive_tracks(parts: Sequence[Part], belt: Belt) -> Tracks:
    """Return the drive of all wheels among the parts, by their side of the robot."""
    by_name = {part.name: part for part in parts}

    def side(part: Part) -> float:
        return part.at[1] + (side(by_name[part.parent]) if part.parent in by_name else 0.0)

    wheels = [part for part in parts if part.is_wheel]
    left = [part for part in wheels if side(part) < 0]
    right = [part for part in wheels if side(part) > 0]
    return Tracks(
        left=tuple(part.name for part in left),
        right=tuple(part.name for part in right),
        max_spin=belt.max_spin,
        radius=belt.radius,
        ratios=tuple(belt.radius / part.shapes[0].size[0] for part in (*left, *right)),
    )


def mass_of(parts: Sequence[Part], packages: Sequence[MissionPackage] = ()) -> float:
    """Return the mass of parts and mission packages, to subtract from the chassis' [kg]."""
    shapes = [shape for part in parts for shape in part.shapes]
    shapes += [shape for package in packages for link in package.links for shape in link.shapes]
    return sum(shape.mass for shape in shapes)
