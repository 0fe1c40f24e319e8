"""The cars: Hummer, SnowStorm, Sedan and Cooper (manual 12.5 to 12.8), and how to build others.

The manual gives sizes and speeds of most; data sheets of the real cars, and choices, complete them. Sedan and
Cooper have the manual's 100 rad/s; its 134 km/h for them are those of the Hummer's bigger wheels. `build_car`
makes a car from measurements: four sprung wheels, the front ones steered, body and cabin.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from usarmjx.base.transforms import GRAVITY, Vec3
from usarmjx.models.drives.ground import Ackermann, Wheel
from usarmjx.models.robots.kit import (
    ALONG,
    AMBER,
    BLACK,
    DARK,
    GLASS_BLACK,
    JET_BLACK,
    LAMP,
    POSE_SENSORS,
    SICK_YELLOW,
    SILVER,
    TAIL_LAMP,
    TYRE_BLACK,
    block,
    camera,
    car_wheel,
    drum,
    firm_motor,
    hull,
    lens,
    pan_tilt,
    prism,
    rod,
    sick,
    sick_housing,
    sick_lms200,
    wheel,
)
from usarmjx.models.types.robot import (
    CHASSIS,
    STEER_SUFFIX,
    MissionPackage,
    Mount,
    Part,
    RobotSpec,
    Spring,
    options,
)
from usarmjx.models.types.shapes import Rgba, Shape

MAX_SPIN = 100.0
"""Highest wheel speed [rad/s] (manual 12.5, 12.7, 12.8; chosen for the SnowStorm, whose section lacks it)."""

MAX_STEER, LOCK = 0.56, 0.7
"""Largest FrontSteer, and the limit of a wheel, whose inner one turns further [rad] (chosen: past the 30
degrees of manual 9.4's example; turning circles come out near the data sheets' 10.7 m of the Mini, 10.9 m
of the Cherokee)."""

STEER_RATE = 1.438
"""Steering rate [rad/s] (manual 14.4.2.3: SteerSpeed 15000, as a rotation in Unreal units)."""

SUSPENSION_FREQUENCY, DAMPING, SUSPENSION_TRAVEL = 11.0, 0.5, 0.12
"""Suspension (chosen): natural frequency [rad/s] and damping ratio of the car on it, and its travel [m]; the
travel of manual 14.4.2.3, SuspHighLimit 1.0 or 0.2 m, would put low cars on their floor."""

ARMATURE, STEER_ARMATURE = 0.05, 0.02
"""Inertia of motors per mass and wheel radius squared, and per mass [m2] (chosen). With less of the first the
solver's iterations do not always suffice to hold a car still; with less of the second the road turns the
wheels."""

STEER_TORQUE = 1.3
"""Torque of steering per mass [N m/kg] (chosen: a few times the torque that turns a standing wheel)."""

ODOMETRY = Mount(
    kind="Odometry", name="Odometry", options=options(LeftTire="LeftRWheel", RightTire="RightRWheel")
)
"""Odometry by the rear wheels, which do not steer: the difference of their paths gives the heading."""


@dataclass(frozen=True, kw_only=True)
class CarStyle:
    """Style of a car; x as shares of half the length, from its middle, forward.

    Attributes:
        cowl: x of the windscreen's foot.
        roof: x of the roof's front and rear edge.
        deck: x of the rear window's foot.
        nose: Drop of the bonnet from the cowl to its front [m].
        tuck: Inset of the roof from the beltline, on each side [m].
        pillars: x of the pillars between the doors, at the beltline.
        lamps: Whether headlights are round.
        grille: Number of slots of the grille.
        trim: Colour of bumpers.
    """

    cowl: float
    roof: tuple[float, float]
    deck: float
    nose: float = 0.1
    tuck: float = 0.12
    pillars: tuple[float, ...] = (0.0,)
    lamps: bool = False
    grille: int = 1
    trim: Rgba = DARK


@dataclass(frozen=True, kw_only=True)
class CarFrame:
    """Measurements of a car that its visuals need, see `Car`; the origin is `origin` above the ground."""

    size: Vec3
    wheel_base: float
    track: float
    tyre: tuple[float, float]
    floor: float
    beltline: float
    origin: float
    rgba: Rgba


def car_visuals(car: CarFrame, look: CarStyle) -> tuple[Shape, ...]:
    """Return the body of a car without its wheels."""
    return (*_lower_body(car, look), *_cabin(car, look), *_ends(car, look))


def _lower_body(car: CarFrame, look: CarStyle) -> tuple[Shape, ...]:
    """Return a tub between the wheels, sills between the arches, and the body above the arches."""
    (length, width, _), (radius, tyre) = car.size, car.tyre
    half, up = length / 2, car.origin
    arch, room = 2 * radius + 0.06, radius + 0.07  # height above the ground and half length of an arch
    front, rear = car.wheel_base / 2, -car.wheel_base / 2
    inner = car.track / 2 - tyre / 2 - 0.03
    nose, door = car.beltline - look.nose, (car.beltline - arch) / 2
    upper = [
        (half, up - arch),
        (half - 0.02, up - nose + 0.08),
        (half - 0.12, up - nose),
        (look.cowl * half, up - car.beltline),
        (look.deck * half, up - car.beltline),
        (-half + 0.03, up - car.beltline + 0.04),
        (-half, up - arch),
    ]

    def across(x0: float, x1: float, low: float, wide: float, rgba: Rgba) -> Shape:
        size = ((x0 - x1) / 2, wide, (arch - low) / 2)
        return block(size, ((x0 + x1) / 2, 0.0, up - (arch + low) / 2), rgba)

    return (
        prism(upper, width / 2, car.rgba),
        across(half - 0.05, -half + 0.05, car.floor, inner, JET_BLACK),
        across(front - room, rear + room, car.floor + 0.02, width / 2 - 0.01, car.rgba),
        across(half - 0.02, front + room, car.floor + 0.05, width / 2 - 0.01, car.rgba),
        across(rear - room, -half + 0.02, car.floor + 0.05, width / 2 - 0.01, car.rgba),
        *(
            block((0.07, width / 2 + 0.004, 0.012), (x * half, 0.0, up - car.beltline + 0.1), DARK)
            for x in look.pillars
        ),  # door handles
        *(
            block((0.006, width / 2 + 0.002, door), (x * half - 0.1, 0.0, up - arch - door), DARK)
            for x in look.pillars
        ),  # and the gaps between doors
    )


def _cabin(car: CarFrame, look: CarStyle) -> tuple[Shape, ...]:
    """Return the windows, and above them the roof on its pillars."""
    (length, width, height), up = car.size, car.origin
    half, foot, top = length / 2, width / 2 - 0.04, width / 2 - 0.04 - look.tuck
    low, high = up - car.beltline, up - height + 0.05
    front, rear = (look.cowl, look.roof[0]), (look.deck, look.roof[1])
    glass = [
        (x * half, side * y, z)
        for edge in (front, rear)
        for x, y, z in zip(edge, (foot, top), (low, high), strict=True)
        for side in (-1.0, 1.0)
    ]
    lid = [
        (x + 0.02 * way, side * (top + 0.01 * (1 - rise)), high - 0.05 * rise)
        for x, way in zip((look.roof[0] * half, look.roof[1] * half), (1.0, -1.0), strict=True)
        for side in (-1.0, 1.0)
        for rise in (0.0, 1.0)
    ]
    pillars = (
        rod((foot_x * half, side * foot, low), (top_x * half, side * top, high), 0.028, car.rgba)
        for side in (-1.0, 1.0)
        for foot_x, top_x in (front, rear, *((x, x) for x in look.pillars))
    )
    mirrors = (
        block((0.04, 0.07, 0.05), (look.cowl * half - 0.12, side * (width / 2 + 0.02), low - 0.05), car.rgba)
        for side in (-1.0, 1.0)
    )
    return (hull(glass, GLASS_BLACK), hull(lid, car.rgba), *pillars, *mirrors)


def _ends(car: CarFrame, look: CarStyle) -> tuple[Shape, ...]:
    """Return bumpers, lamps, grille and number plates."""
    (length, width, _), up = car.size, car.origin
    half, side = length / 2, width / 2
    lamp = up - (car.beltline - look.nose - 0.16)
    bumper = up - (car.floor + 0.16)
    slots = _spread(look.grille, 0.5 * side)
    slot, tall = 0.4 * side / look.grille, 0.08 if look.grille > 1 else 0.05
    return (
        *(block((0.05, side - 0.03, 0.08), (x, 0.0, bumper), look.trim) for x in (half - 0.04, -half + 0.04)),
        *_lamps(look, half, side, lamp),
        *(block((0.02, slot, tall), (half - 0.015, y, lamp), JET_BLACK) for y in slots),
        *(
            block((0.02, 0.09, 0.06), (-half + 0.015, y, lamp), TAIL_LAMP)
            for y in (-side + 0.14, side - 0.14)
        ),
        *(block((0.004, 0.2, 0.05), (x, 0.0, bumper - 0.02), SILVER) for x in (half + 0.008, -half - 0.008)),
    )


def _lamps(look: CarStyle, front: float, side: float, z: float) -> tuple[Shape, ...]:
    sides = (-side + 0.2, side - 0.2)
    blinkers = (block((0.02, 0.04, 0.04), (front - 0.015, y * (side - 0.07), z), AMBER) for y in (-1.0, 1.0))
    if look.lamps:
        return (*(drum(0.09, 0.03, (front - 0.02, y, z), LAMP, ALONG) for y in sides), *blinkers)
    return (*(block((0.025, 0.12, 0.055), (front - 0.015, y, z), LAMP) for y in sides), *blinkers)


def _spread(count: int, half: float) -> Sequence[float]:
    """Return positions spread evenly from -half to half."""
    return [half * (2 * (k + 0.5) / count - 1) for k in range(count)]


@dataclass(frozen=True, kw_only=True)
class Car:
    """Measurements of a car; heights are above the ground.

    Attributes:
        name: Class name.
        dimensions: Length, width, height.
        mass: Total mass.
        wheel_base: Distance of the axles.
        track: Lateral distance of the wheels.
        tyre: Radius and width of a wheel.
        unsprung: Masses of a wheel and of its hub.
        floor: Lowest point of the body.
        beltline: Border between body and cabin.
        cog_height: Height of the centre of gravity.
        front_weight_share: Share of the weight on the front wheels.
        all_wheel: Whether all wheels are powered; else only the front ones are.
        max_acceleration: Largest acceleration and deceleration by its motors [m/s2].
        rgba: Colour of the body.
        look: Style of its visuals.
    """

    name: str
    dimensions: Vec3
    mass: float
    wheel_base: float
    track: float
    tyre: tuple[float, float]
    unsprung: tuple[float, float]
    floor: float
    beltline: float
    cog_height: float
    front_weight_share: float
    all_wheel: bool
    max_acceleration: float
    rgba: Rgba
    look: CarStyle

    @property
    def origin(self) -> float:
        """Height of the chassis origin: half of the car's, midway between the axles (chosen)."""
        return self.dimensions[2] / 2


def _axle(car: Car, front: bool) -> tuple[list[Part], list[Wheel]]:
    """Return the parts of an axle, and its wheels for the drive."""
    (radius, _), (mass, hub) = car.tyre, car.unsprung
    share, x = (
        (car.front_weight_share, car.wheel_base / 2)
        if front
        else (1 - car.front_weight_share, -car.wheel_base / 2)
    )
    # The spring carries what is above it: neither the wheel nor its hub.
    carried = car.mass * share / 2 - mass - hub
    spring = Spring(
        stiffness=SUSPENSION_FREQUENCY**2 * carried,
        damping=2 * DAMPING * SUSPENSION_FREQUENCY * carried,
        load=carried * GRAVITY,
    )
    powered = front or car.all_wheel
    torque = car.max_acceleration * car.mass * radius / (4 if car.all_wheel else 2)
    motor = firm_motor(
        MAX_SPIN,
        torque if powered else torque / 2,  # that of the brake (chosen): the rear wheels carry less
        mass * radius**2 / 2,
        ARMATURE * car.mass * radius**2,
    )
    steer = firm_motor(STEER_RATE, STEER_TORQUE * car.mass, mass * radius**2 / 4, STEER_ARMATURE * car.mass)
    parts: list[Part] = []
    wheels: list[Wheel] = []
    for side, y in (("Left", -car.track / 2), ("Right", car.track / 2)):
        name = f"{side}{'F' if front else 'R'}Wheel"
        tyre = wheel(name, at=(x, y, car.origin - radius), size=car.tyre, mass=mass, motor=motor)
        parts += car_wheel(
            tyre, hub=hub, spring=spring, travel=SUSPENSION_TRAVEL, steer=steer if front else None, lock=LOCK
        )
        steers = name + STEER_SUFFIX if front else ""
        wheels.append(Wheel(joint=name, steer=steers, x=x, y=y, powered=powered, brakes=True))
    return parts, wheels


def _body(car: Car, head: float) -> tuple[Shape, ...]:
    """Return body and cabin, and within them the mass except wheels, hubs and camera head [kg]."""
    length, width, height = car.dimensions
    unsprung = 4 * sum(car.unsprung)
    sprung = car.mass - unsprung
    body, cabin = (car.beltline - car.floor) / 2, (height - car.beltline) / 2
    # Position of the ballast that gives the whole car its axle loads and the height of its centre of gravity.
    ahead = car.wheel_base * (car.front_weight_share - 0.5) * car.mass / sprung
    balance = (car.cog_height * car.mass - car.tyre[0] * unsprung) / sprung
    return (
        Shape(
            kind="box",
            size=(length / 2, width / 2, body),
            at=(0.0, 0.0, car.origin - car.floor - body),
            rgba=car.rgba,
        ),
        Shape(
            kind="box",
            size=(0.27 * length, 0.45 * width, cabin),
            at=(-0.05 * length, 0.0, cabin - car.origin),
            rgba=car.rgba,
        ),
        Shape(
            kind="box",
            size=(min(0.45 * length, length / 2 - abs(ahead)), 0.4 * width, 0.15),  # within the body
            at=(ahead, 0.0, car.origin - balance),
            mass=sprung - head,
            surface="fixture",
            rgba=BLACK,
        ),
    )


def _frame(car: Car) -> CarFrame:
    return CarFrame(
        size=car.dimensions,
        wheel_base=car.wheel_base,
        track=car.track,
        tyre=car.tyre,
        floor=car.floor,
        beltline=car.beltline,
        origin=car.origin,
        rgba=car.rgba,
    )


def build_car(
    car: Car,
    *,
    solids: tuple[Shape, ...] = (),
    looks: tuple[Shape, ...] = (),
    packages: tuple[MissionPackage, ...] = (),
    sensors: tuple[Mount, ...] = (),
    cameras: tuple[Mount, ...] = (),
    sources: tuple[tuple[str, str], ...],
) -> RobotSpec:
    """Return a car with its equipment, odometry and pose sensors included.

    Args:
        car: Its measurements.
        solids: Further solids of the chassis, without mass.
        looks: Visuals of these solids, and further visuals.
        packages: Mission packages, whose mass is part of the car's.
        sensors: Sensors of its own.
        cameras: Cameras.
        sources: Sources of its numbers; steering, suspension and pose sensors are chosen for all.
    """
    head = sum(shape.mass for package in packages for link in package.links for shape in link.shapes)
    (front, steered), (rear, straight) = _axle(car, front=True), _axle(car, front=False)
    return RobotSpec(
        name=car.name,
        dimensions=car.dimensions,
        mass=car.mass,
        origin_height=car.origin,
        chassis=(*_body(car, head), *solids),
        looks=(*car_visuals(_frame(car), car.look), *looks),
        parts=(*front, *rear),
        drive=Ackermann(
            wheels=(*steered, *straight), max_spin=MAX_SPIN, radius=car.tyre[0], max_front_steer=MAX_STEER
        ),
        packages=packages,
        sensors=(*sensors, ODOMETRY, *POSE_SENSORS[1:]),
        cameras=cameras,
        wheel_radius=car.tyre[0],
        wheel_separation=car.track,
        wheel_base=car.wheel_base,
        sources=(
            *sources,
            ("steering", "chosen"),
            ("suspension", "chosen"),
            ("Odometry, INS, GroundTruth", "chosen"),
        ),
    )


HUMMER_LENGTH, HUMMER_WIDTH = 3.686, 1.799  # manual 12.5.1; the real one has 4.57 and 2.16
_HUMMER = Car(
    name="Hummer",
    dimensions=(HUMMER_LENGTH, HUMMER_WIDTH, 2.059),  # manual 12.5.1
    mass=2359.0,  # data sheet: M998, 5200 lb
    wheel_base=3.30 * HUMMER_LENGTH / 4.57,  # data sheet: 130 in; scaled
    track=1.82 * HUMMER_WIDTH / 2.16,  # data sheet: 71.6 in; scaled
    tyre=(0.3727, 0.26),  # manual 12.5.1; width data sheet (12.5 in), scaled
    unsprung=(55.0, 45.0),  # chosen: tyres with run-flat inserts, geared hubs
    floor=0.33,  # data sheet: 16 in, scaled
    beltline=1.10,  # chosen, as all below
    cog_height=0.62,
    front_weight_share=0.5,
    all_wheel=True,  # manual 12.5.1
    max_acceleration=5.0,
    rgba=(0.45, 0.45, 0.3, 1.0),
    look=CarStyle(
        cowl=0.4,
        roof=(0.3, -0.55),
        deck=-0.95,
        nose=0.08,
        tuck=0.1,
        pillars=(0.0, -0.45),
        lamps=True,
        grille=7,
        trim=(0.36, 0.36, 0.24, 1.0),
    ),
)
HUMMER_SCANNER = (1.3, 0.0, _HUMMER.origin - _HUMMER.beltline - 0.05)  # chosen: on the bonnet
HUMMER = build_car(
    _HUMMER,
    solids=(sick_housing(HUMMER_SCANNER),),
    looks=(
        *sick(HUMMER_SCANNER),
        *(
            block((0.3, 0.04, 0.02), (1.1, y, _HUMMER.origin - _HUMMER.beltline), JET_BLACK)
            for y in (-0.5, 0.5)
        ),
        rod((0.75, 0.92, -0.2), (0.75, 0.92, -1.2), 0.05, JET_BLACK),  # the snorkel
        rod((0.75, 0.0, -0.07), (0.58, 0.0, -0.98), 0.03, _HUMMER.rgba),  # two windscreens
        *(rod((1.86, y, 0.35), (1.86, y, -0.1), 0.03, JET_BLACK) for y in (-0.35, 0.35)),
        rod((1.86, -0.6, -0.1), (1.86, 0.6, -0.1), 0.03, JET_BLACK),
        drum(0.36, 0.12, (-1.9, 0.35, 0.1), TYRE_BLACK, ALONG),  # the spare wheel
        drum(0.2, 0.13, (-1.9, 0.35, 0.1), _HUMMER.rgba, ALONG),
        rod((-1.6, -0.8, -0.2), (-1.65, -0.8, -1.4), 0.012, JET_BLACK),
    ),
    packages=(pan_tilt((0.0, 0.0, -_HUMMER.origin)),),  # chosen: on the roof; pans all around
    sensors=(sick_lms200(HUMMER_SCANNER),),
    cameras=(camera(),),
    sources=(
        ("dimensions, wheel radius, top speed, wheels", "manual 12.5"),
        ("scanner, camera", "manual 12.5"),
        ("mass, wheel base, track", "data sheet"),
        ("layout", "chosen"),
    ),
)

_SNOWSTORM = Car(
    name="SnowStorm",
    dimensions=(4.239, 1.720, 1.621),  # manual 12.6.1
    mass=1523.0,  # data sheet of the Jeep Cherokee XJ
    wheel_base=2.576,  # data sheet
    track=1.473,  # data sheet
    tyre=(0.352, 0.215),  # data sheet: 215/75 R15
    unsprung=(25.0, 40.0),  # chosen, as all below
    floor=0.21,
    beltline=0.98,
    cog_height=0.58,
    front_weight_share=0.53,
    all_wheel=True,  # chosen; manual 12.6.1: two or four wheel drive
    max_acceleration=5.0,
    rgba=(0.85, 0.85, 0.9, 1.0),
    look=CarStyle(
        cowl=0.38,
        roof=(0.2, -0.88),
        deck=-0.97,
        nose=0.06,
        tuck=0.1,
        pillars=(0.0, -0.35, -0.62),
        grille=7,
        trim=(0.2, 0.2, 0.22, 1.0),
    ),
)
SNOWSTORM_ROOF = -_SNOWSTORM.origin
SNOWSTORM_SCANNER = (0.75, 0.0, SNOWSTORM_ROOF - 0.05)  # chosen: on the front edge of the roof
HALF_STEREO_BASELINE = 0.06  # half the distance of a Bumblebee's lenses (data sheet: 12 cm)
SNOWSTORM = build_car(
    _SNOWSTORM,
    solids=(sick_housing(SNOWSTORM_SCANNER),),
    looks=(
        *sick(SNOWSTORM_SCANNER),
        *(rod((0.3, y, SNOWSTORM_ROOF), (-1.7, y, SNOWSTORM_ROOF), 0.03, JET_BLACK) for y in (-0.55, 0.55)),
        rod((0.8, -0.62, SNOWSTORM_ROOF), (0.8, 0.62, SNOWSTORM_ROOF), 0.025, JET_BLACK),
        *lens((0.9, -HALF_STEREO_BASELINE, SNOWSTORM_ROOF + 0.1), 0.02),
        *lens((0.9, HALF_STEREO_BASELINE, SNOWSTORM_ROOF + 0.1), 0.02),
        drum(0.08, 0.03, (-0.8, 0.0, SNOWSTORM_ROOF - 0.02), SICK_YELLOW),  # the GPS
        block((0.5, _SNOWSTORM.dimensions[1] / 2 + 0.003, 0.08), (-0.1, 0.0, 0.12), (0.15, 0.3, 0.6, 1.0)),
    ),
    sensors=(
        # The range of an outdoor LMS (data sheet); the fan is the sensor's own.
        Mount(kind="RangeScanner3D", name="Scanner1", at=SNOWSTORM_SCANNER, defaults=options(MaxRange=80.0)),
        Mount(kind="GPS", name="GPS", at=(-0.8, 0.0, SNOWSTORM_ROOF)),
    ),
    cameras=tuple(
        camera(name, at=(0.9, y, SNOWSTORM_ROOF + 0.1), parent=CHASSIS)
        for name, y in (("Camera", -HALF_STEREO_BASELINE), ("Camera2", HALF_STEREO_BASELINE))
    ),
    sources=(
        ("dimensions, wheels", "manual 12.6"),
        ("GPS, stereo camera, 3D scanner", "manual 12.6"),
        ("mass, wheel base, track, wheel radius", "data sheet"),
        ("top speed, layout", "chosen"),
    ),
)

SEDAN = build_car(
    Car(
        name="Sedan",
        dimensions=(4.2779, 1.7883, 1.3238),  # manual 12.7.1
        mass=1250.0,  # data sheet of the Nissan Primera P10, about
        wheel_base=2.55,  # data sheet
        track=1.47,  # data sheet
        tyre=(0.2820, 0.195),  # manual 12.7.1; width data sheet
        unsprung=(18.0, 33.0),  # chosen, as all below
        floor=0.15,
        beltline=0.85,
        cog_height=0.50,
        front_weight_share=0.6,
        all_wheel=False,  # manual 12.7.1
        max_acceleration=3.5,
        rgba=(0.3, 0.4, 0.6, 1.0),
        look=CarStyle(cowl=0.45, roof=(0.12, -0.4), deck=-0.68, nose=0.16, tuck=0.14, pillars=(-0.12,)),
    ),
    sources=(
        ("dimensions, wheel radius, top speed, wheels", "manual 12.7"),
        ("mass, wheel base, track", "data sheet"),
        ("layout", "chosen"),
    ),
)

COOPER = build_car(
    Car(
        name="Cooper",
        dimensions=(3.626, 1.688, 1.416),  # data sheet of the Mini Cooper R50, as the next four
        mass=1146.0,
        wheel_base=2.467,
        track=1.46,
        tyre=(0.304, 0.175),  # 175/65 R15
        unsprung=(18.0, 33.0),  # chosen, as all below
        floor=0.15,
        beltline=0.90,
        cog_height=0.52,
        front_weight_share=0.6,
        all_wheel=False,  # manual 12.8.1
        max_acceleration=3.5,
        rgba=(0.7, 0.15, 0.15, 1.0),
        look=CarStyle(
            cowl=0.42,
            roof=(0.2, -0.78),
            deck=-0.96,
            nose=0.12,
            tuck=0.12,
            pillars=(-0.25,),
            lamps=True,
            trim=SILVER,
        ),
    ),
    looks=tuple(
        block((0.42, 0.1, 0.006), (1.05, y, -0.155), (0.95, 0.95, 0.93, 1.0), (0.0, -0.11, 0.0))
        for y in (-0.3, 0.3)
    ),  # stripes on its bonnet
    sources=(
        ("top speed, wheels", "manual 12.8"),
        ("dimensions, mass, wheel base, track, wheel radius", "data sheet"),
        ("layout", "chosen"),
    ),
)
