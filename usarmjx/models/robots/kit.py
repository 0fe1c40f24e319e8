"""Building blocks that many robots share: visuals, wheels, tracks, camera heads and sensors.

Tracks are the original's (manual 12.10.2): rows of driven wheels, on the chassis or on flippers. Wheels of
one robot never touch each other, so those of a row may overlap: more wheels approximate a belt better, and
cost more. Every wheel has a motor, and all of a side run at one belt speed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from usarmjx.base.transforms import Vec3, flip_vector
from usarmjx.models.drives import Tracks
from usarmjx.models.types.robot import (
    CHASSIS,
    STEER_SUFFIX,
    SUSPENSION_SUFFIX,
    UP,
    Link,
    MissionPackage,
    Motor,
    Mount,
    Part,
    Spring,
    options,
)
from usarmjx.models.types.shapes import ACROSS, ALONG, ZERO, Mesh, Rgba, Shape

TYRE_BLACK: Rgba = (0.13, 0.13, 0.14, 1.0)
TREAD: Rgba = (0.2, 0.2, 0.21, 1.0)
JET_BLACK: Rgba = (0.08, 0.08, 0.09, 1.0)
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

RUBBER: Rgba = (0.15, 0.15, 0.15, 1.0)

BLACK: Rgba = (0.1, 0.1, 0.1, 1.0)

LEVEL_SONAR = options(MaxIncidence=1.309)
"""Options of level sonars above the ground: the floor returns no echo, as in captured sessions of a P2AT,
which read up to 5 m though their cones meet the floor at 1.5 m."""

POSE_SENSORS = (
    Mount(kind="Odometry", name="Odometry"),
    Mount(kind="INS", name="INS"),
    Mount(kind="GroundTruth", name="GroundTruth"),
)
"""Pose sensors of most robots by the manual, and the GroundTruth of captured ones."""

ENCODER_AXIS = (0.0, 0.0, math.pi / 2)
"""Direction of an encoder along the axle to the right (captured for ECRight)."""


def block(size: Vec3, at: Vec3 = ZERO, rgba: Rgba = DARK, rotation: Vec3 = ZERO) -> Shape:
    """Return a box of given half lengths."""
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
    # The pitch and yaw that take the z axis to the rod's direction.
    turn = (0.0, math.acos(way[2] / length), math.atan2(way[1], way[0]))
    x, y, z = (np.add(start, end) / 2).tolist()
    kind = "cylinder" if blunt else "capsule"
    return Shape(
        kind=kind, size=(radius, length / 2), at=(x, y, z), rotation=turn, rgba=rgba, surface="fixture"
    )


def mirrored(half_profile: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return a profile (x, z) followed by its mirror image at x = 0."""
    return [*half_profile, *((-x, z) for x, z in reversed(half_profile))]


@cache
def _mesh(corners: tuple[Vec3, ...]) -> Mesh:
    """Return a mesh in MuJoCo's axes.

    Composition converts the pose of a shape, not the vertices of its mesh.
    """
    return Mesh(np.array([flip_vector(corner) for corner in corners], float))


def hull(corners: Sequence[Vec3], rgba: Rgba = DARK) -> Shape:
    """Return the convex hull of some points."""
    return Shape(kind="mesh", mesh=_mesh(tuple(corners)), rgba=rgba, surface="fixture")


def prism(profile: Sequence[tuple[float, float]], half: float, rgba: Rgba, top: float | None = None) -> Shape:
    """Return a convex solid with one profile (x, z) from side to side.

    Args:
        profile: Corners of the profile.
        half: Half its width.
        rgba: Colour.
        top: Half the width at its highest corners; None: `half`.
    """
    height = min(z for _, z in profile)
    # z points down: the highest corners have the smallest z.
    wide = [half if z > height or top is None else top for _, z in profile]
    return hull(
        [(x, side * y, z) for side in (-1.0, 1.0) for (x, z), y in zip(profile, wide, strict=True)], rgba
    )


def wheel_visuals(
    radius: float,
    width: float,
    *,
    rim: float = 0.62,
    bars: int = 3,
    rgba: Rgba = SILVER,
    shift: float = 0.0,
) -> tuple[Shape, ...]:
    """Return a wheel with visible rotation: tyre, dish, spokes from rim to rim, hub cap.

    Args:
        radius: Radius of the tyre [m].
        width: Width of the tyre [m].
        rim: Radius of the dish over the tyre's.
        bars: Number of bars of two spokes each.
        rgba: Colour of spokes and hub cap.
        shift: Offset to the right of its axle's middle [m].
    """
    inner, half, at = rim * radius, width / 2, (0.0, shift, 0.0)
    spoke = (0.96 * inner, half + 0.03 * radius, 0.09 * radius)
    return (
        drum(radius, half, at, TYRE_BLACK, ACROSS),
        drum(inner, half + 0.015 * radius, at, DARK, ACROSS),
        *(block(spoke, at, rgba, (0.0, k * math.pi / bars, 0.0)) for k in range(bars)),
        drum(0.2 * radius, half + 0.05 * radius, at, rgba, ACROSS),
    )


def cleats(radius: float, width: float, count: int, thick: float) -> tuple[Shape, ...]:
    """Return the cleats of a track's wheel: bars across it, whose tips stand out of the belt.

    Args:
        radius: Radius of the tips [m].
        width: Width of the track [m].
        count: Bars of two cleats each.
        thick: Thickness of a bar [m].
    """
    return tuple(
        block((radius, width / 2, thick / 2), rgba=TREAD, rotation=(0.0, k * math.pi / count, 0.0))
        for k in range(count)
    )


def sprocket_looks(radius: float, width: float, rgba: Rgba) -> tuple[Shape, ...]:
    """Return the sides of a sprocket in a track of some width [m]: a dish with spokes and a cap."""
    half = width / 2
    return (
        drum(radius, half + 0.004, rgba=DARK, rotation=ACROSS),
        block((0.9 * radius, half + 0.007, 0.13 * radius), rgba=rgba),
        block((0.13 * radius, half + 0.007, 0.9 * radius), rgba=rgba),
        drum(0.3 * radius, half + 0.01, rgba=rgba, rotation=ACROSS),
    )


def belt_looks(front: Vec3, rear: Vec3, radii: tuple[float, float], width: float) -> tuple[Shape, ...]:
    """Return a track's belt around two axles, one ahead of the other.

    Args:
        front: Middle of the front axle.
        rear: Middle of the rear axle.
        radii: Outer radii of the belt about them [m].
        width: Width of the belt [m].
    """
    (x0, y, z0), (x1, _, z1), half = front, rear, width / 2
    ends = (drum(radii[0], half, front, TYRE_BLACK, ACROSS), drum(radii[1], half, rear, TYRE_BLACK, ACROSS))
    # A box for the usual case: rays meet it faster than the triangles of a mesh.
    if radii[0] == radii[1] and z0 == z1:
        return (*ends, block(((x0 - x1) / 2, half, radii[0]), ((x0 + x1) / 2, y, z0), TYRE_BLACK))
    lean = (radii[1] - radii[0]) / math.hypot(x0 - x1, z0 - z1)  # sine of the common tangents' slope
    ahead, rise, corners = math.copysign(1.0, x0 - x1), math.sqrt(1 - lean * lean), list[Vec3]()
    # The common tangents touch both ends here; the hull of these points fills the space between the ends.
    for (x, z), radius in zip(((x0, z0), (x1, z1)), radii, strict=True):
        for side in (-1.0, 1.0):
            corners += [
                (x + ahead * lean * radius, y + across, z + side * rise * radius) for across in (-half, half)
            ]
    return (*ends, hull(corners, TYRE_BLACK))


def sick(at: Vec3) -> tuple[Shape, ...]:
    """Return a SICK LMS200 whose beams leave at `at`: a blue box with a dark window around its front."""
    x, y, z = at
    return (
        block((0.0775, 0.078, 0.03), (x, y, z + 0.02), SICK_BLUE),
        block((0.04, 0.078, 0.025), (x - 0.0375, y, z - 0.035), SICK_BLUE),
        drum(0.068, 0.03, (x, y, z - 0.035), JET_BLACK),
        block((0.0775, 0.078, 0.025), (x, y, z - 0.085), SICK_BLUE),
        block((0.002, 0.04, 0.009), (x + 0.0775, y, z - 0.085), SICK_YELLOW),
    )


def sonar_discs(
    sonars: Sequence[tuple[Vec3, float]], push: float, radius: float = 0.017
) -> tuple[Shape, ...]:
    """Return the golden fronts of sonars at (position, yaw), shifted ahead [m]."""
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


def lens(at: Vec3, radius: float, rgba: Rgba = JET_BLACK, depth: float = 0.012) -> tuple[Shape, ...]:
    """Return a camera's lens that points ahead: a barrel and its glass."""
    x, y, z = at
    return (
        drum(radius, depth, at, rgba, ALONG),
        drum(0.7 * radius, 0.002, (x + depth, y, z), (0.25, 0.35, 0.5, 1.0), ALONG),
    )


def wheel(
    name: str,
    *,
    at: Vec3,
    size: tuple[float, float],
    mass: float,
    motor: Motor | None,
    parent: str = CHASSIS,
    surface: str = "wheel",
) -> Part:
    """Return a wheel of (radius, width) [m] with spokes; without a motor it rolls freely."""
    radius, width = size
    tyre = Shape(
        kind="cylinder",
        size=(radius, width / 2),
        rotation=ACROSS,
        mass=mass,
        surface=surface,
        rgba=RUBBER,
    )
    looks = wheel_visuals(radius, width)
    return Part(name=name, parent=parent, at=at, motor=motor, shapes=(tyre,), looks=looks, is_wheel=True)


def firm_motor(max_speed: float, torque: float, inertia: float, armature: float) -> Motor:
    """Return a stiff servo: gains are a tenth and a third of the stability limit at steps of 5 ms.

    Args:
        max_speed: Highest speed [rad/s].
        torque: Torque [N m].
        inertia: Inertia of the load [kg m2].
        armature: Inertia of the motor, seen at the joint [kg m2].
    """
    # Gains in proportion to the inertia: frequency and damping, hence stability, are the same for all joints.
    whole = inertia + armature
    return Motor(
        max_speed=max_speed, torque=torque, stiffness=4000.0 * whole, damping=60.0 * whole, armature=armature
    )


def car_wheel(
    tyre: Part,
    *,
    hub: float,
    spring: Spring | None = None,
    travel: float = 0.0,
    steer: Motor | None = None,
    lock: float = 0.0,
) -> tuple[Part, ...]:
    """Return the manual's car-wheel joint (14.4.2.4): `<wheel>_Suspension`, `<wheel>_Steer`, then the wheel.

    Args:
        tyre: The wheel without suspension and steering (`kit.wheel`).
        hub: Mass that does not spin with it: brake, a share of axle and springs [kg].
        spring: Suspension, positive when compressed; None: none.
        travel: Travel of the suspension, up and down [m].
        steer: Steering servo about the vertical, positive to the left; None: none.
        lock: Steering limit to each side [rad].
    """
    name, joints = tyre.name, (spring is not None) + (steer is not None)
    # Every body of a joint needs a mass; these are hidden within the tyre and have no contacts.
    size = (tyre.shapes[0].size[1],)
    # The bodies of both joints share the hub's mass.
    knuckle = Shape(kind="sphere", size=size, mass=hub / max(1, joints), surface="fixture", rgba=BLACK)
    parts: list[Part] = []
    parent, at = tyre.parent, tyre.at
    if spring is not None:
        slide = Part(
            name=name + SUSPENSION_SUFFIX,
            parent=parent,
            at=at,
            axis=UP,
            joint="slide",
            limits=(-travel, travel),
            spring=spring,
            shapes=(knuckle,),
        )
        parts.append(slide)
        parent, at = slide.name, ZERO
    if steer is not None:
        turn = Part(
            name=name + STEER_SUFFIX,
            parent=parent,
            at=at,
            axis=UP,
            motor=steer,
            limits=(-lock, lock),
            shapes=(knuckle,),
        )
        parts.append(turn)
        parent, at = turn.name, ZERO
    return (*parts, replace(tyre, parent=parent, at=at))


def pan_tilt(
    location: Vec3, *, tilt: tuple[float, float] = (-0.16, 0.40), name: str = "CameraPanTilt"
) -> MissionPackage:
    """Return the common camera head with the captured frames: pan about the vertical, tilt up positive.

    Args:
        location: Position of the pan joint on the chassis.
        tilt: Range of the tilt joint (manual 9.3's example by default).
        name: Name of the package.
    """
    pan_shape = Shape(kind="sphere", size=(0.03,), mass=0.2, surface="fixture", rgba=BLACK)
    head = Shape(
        kind="box", size=(0.05, 0.04, 0.03), at=(0.02, 0.0, 0.0), mass=0.3, surface="fixture", rgba=BLACK
    )
    # Visuals: a pedestal, and the head between two cheeks, with its lens at the position of the camera.
    pedestal = (drum(0.034, 0.012, (0.0, 0.0, -0.012)), drum(0.024, 0.02, (0.0, 0.0, -0.03), STEEL))
    face = (
        block((0.036, 0.036, 0.026), (0.026, 0.0, 0.026), DARK),
        ball((0.036, 0.036, 0.016), (0.026, 0.0, 0.0), DARK),
        drum(0.03, 0.042, (0.0, 0.0, 0.02), STEEL, ACROSS),
        *lens((0.066, 0.0, 0.03), 0.02),
    )
    speed, torque = 0.17, 20.0  # captured
    return MissionPackage(
        name=name,
        links=(
            Link(
                number=1,
                parent=-1,
                location=location,
                orientation=(math.pi, 0.0, 0.0),
                # Limits in the wrong order are none: the head turns all the way round.
                min_range=1.0,
                max_range=0.0,
                shapes=(pan_shape,),
                looks=pedestal,
                max_speed=speed,
                max_torque=torque,
            ),
            Link(
                number=2,
                parent=1,
                location=(0.0, 0.0, 0.0599),
                orientation=(math.pi / 2, 0.0, 0.0),
                min_range=tilt[0],
                max_range=tilt[1],
                shapes=(head,),
                looks=face,
                max_speed=speed,
                max_torque=torque,
            ),
        ),
    )


def camera(name: str = "Camera", at: Vec3 = (0.0820, 0.0002, 0.0613), **where: object) -> Mount:
    """Return a colour camera, by default on the tilting part of `CameraPanTilt`, as captured.

    Args:
        name: Item name.
        at: Position on its parent.
        where: `parent` and `direction` of the mount.
    """
    fov = options(CameraDefFov=0.8727, CameraMinFov=0.3491, CameraMaxFov=2.0944)  # manual 9.3's CONF
    mounting = {"parent": "CameraPanTilt_Link2", **where}
    return Mount(kind="Camera", name=name, at=at, defaults=fov, **mounting)  # type: ignore[arg-type]


def sick_lms200(at: Vec3, name: str = "Scanner1", parent: str = CHASSIS) -> Mount:
    """Return a SICK LMS200: 181 beams over half a turn, 20 m (captured CONF)."""
    fan = options(MaxRange=20.0, MinRange=0.1, Resolution=math.pi / 180, ScanFov=math.pi)
    return Mount(kind="RangeScanner", name=name, at=at, parent=parent, defaults=fan)


def sick_housing(at: Vec3) -> Shape:
    """Return a box of the LMS200's size (data sheet: 155 x 156 x 210 mm; optics in its upper half)."""
    centre = (at[0], at[1], at[2] - 0.03)
    return Shape(kind="box", size=(0.0775, 0.078, 0.08), at=centre, rgba=(0.2, 0.3, 0.7, 1))


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
        # Torque and inertia grow with the radius so that belts accelerate alike on wheels of all sizes.
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
        # Of equal width: the mass grows with the square of the radius.
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
        # A bar is two cleats, so half the circumference counts.
        bars = max(3, round(math.pi * radius / (CLEAT_PITCH * self.cleat)))
        side = sprocket_looks(0.66 * radius, self.width, self.trim) if sprocket else self._bearing(radius)
        return replace(part, looks=(*cleats(radius, self.width, bars, 0.9 * self.cleat), *side))

    def looks(self, front: Vec3, rear: Vec3, radii: tuple[float, float] | None = None) -> tuple[Shape, ...]:
        """Return the belt around a row's foremost and rearmost wheel, as visuals of their parent."""
        outer = (self.radius, self.radius) if radii is None else radii
        # The belt itself lies within the cleats, whose tips reach the radius that touches the ground.
        first, last = (radius - self.cleat for radius in outer)
        # Narrower than the cleats, so that their sides do not lie in one plane.
        return belt_looks(front, rear, (first, last), 0.96 * self.width)


def _with_cleats(belt: Belt, row: Sequence[Part]) -> tuple[Part, ...]:
    """Return a row of wheels, some with cleats, spaced so that the belt's cleats show no gap."""
    apart = abs(row[0].at[0] - row[-1].at[0]) / (len(row) - 1)
    # Chord of the wheel at a cleat's depth; the cleat's square under the root is left out as small.
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
        # y points to the right, as in the original.
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
        # Straight edges: the radius falls evenly with the distance from the hinge.
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

    # Wheels of a flipper have positions on it, not on the chassis.
    def side(part: Part) -> float:
        return part.at[1] + (side(by_name[part.parent]) if part.parent in by_name else 0.0)

    wheels = [part for part in parts if part.is_wheel]
    left = [part for part in wheels if side(part) < 0]
    right = [part for part in wheels if side(part) > 0]
    # At one belt speed a small wheel turns faster.
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
