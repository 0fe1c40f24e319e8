"""How cars are built from their figures: four sprung wheels, the front ones steered, a body with a cabin."""

from dataclasses import dataclass

from usarmjx.base.transforms import GRAVITY, Vec3
from usarmjx.models.drives.ackermann import Ackermann, Wheel
from usarmjx.models.robots.car_looks import CarFrame, CarLook, car_looks
from usarmjx.models.robots.kit import BLACK, POSE_SENSORS, car_wheel, firm_motor, wheel
from usarmjx.models.spec.robot import STEER_SUFFIX, MissionPackage, Mount, Part, RobotSpec, Spring, options
from usarmjx.models.spec.shapes import Rgba, Shape

MAX_SPIN = 100.0
"""Highest wheel speed [rad/s] (manual 12.5, 12.7, 12.8; chosen for the SnowStorm, which has none there)."""
MAX_STEER, LOCK = 0.56, 0.7
"""Largest FrontSteer, and room for the inner wheel's angle then [rad] (chosen: past the 30 degrees of manual
9.4's example; turning circles come out near the data sheets' 10.7 m of the Mini, 10.9 m of the Cherokee)."""
STEER_RATE = 1.438
"""How fast wheels steer [rad/s] (manual 14.4.2.3: SteerSpeed 15000, as a rotation in Unreal units)."""
SUSPENSION_FREQUENCY, DAMPING, SUSPENSION_TRAVEL = 11.0, 0.5, 0.12
"""Suspension (chosen): frequency [rad/s] and damping ratio of the car on it, and how far it springs [m]; the
travel of manual 14.4.2.3, SuspHighLimit 1.0 or 0.2 m, would put low cars on their floor."""
ARMATURE, STEER_ARMATURE = 0.05, 0.02
"""Inertia of motors per mass and wheel radius squared, and per mass [m2] (chosen). Less of the first and the
solver's iterations do not always suffice to hold a car still; less of the second gives in to the road."""
STEER_TORQUE = 1.3
"""Per mass [N m/kg] (chosen: a few times what turning a standing wheel takes)."""


@dataclass(frozen=True, kw_only=True)
class Car:
    """Figures of a car; heights are above the ground.

    Attributes:
        name: Class name.
        dimensions: Length, width, height.
        mass: All of it.
        wheel_base: Distance of the axles.
        track: Lateral distance of the wheels.
        tyre: Radius and width of a wheel.
        unsprung: Masses of a wheel and of its hub.
        floor: Lowest point of the body.
        beltline: Where the body ends and the cabin begins.
        cog_height: Height of the centre of gravity.
        front_weight_share: Share of the weight on the front wheels.
        all_wheel: Whether all wheels are powered; else only the front ones are.
        max_acceleration: Acceleration and deceleration that its motors are good for [m/s2].
        rgba: Of the body.
        look: What else it is drawn with.
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
    look: CarLook

    @property
    def origin(self) -> float:
        """Height of the chassis origin: half of the car's, midway between the axles (chosen)."""
        return self.dimensions[2] / 2


def _axle(car: Car, front: bool) -> tuple[list[Part], list[Wheel]]:
    """Return the parts of an axle, and its wheels as the drive sees them."""
    (radius, _), (mass, hub) = car.tyre, car.unsprung
    share, x = (
        (car.front_weight_share, car.wheel_base / 2)
        if front
        else (1 - car.front_weight_share, -car.wheel_base / 2)
    )
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
    """Return body and cabin, and within them all mass but wheels, hubs and camera head [kg]."""
    length, width, height = car.dimensions
    unsprung = 4 * sum(car.unsprung)
    sprung = car.mass - unsprung
    body, cabin = (car.beltline - car.floor) / 2, (height - car.beltline) / 2
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


ODOMETRY = Mount(
    kind="Odometry", name="Odometry", options=options(LeftTire="LeftRWheel", RightTire="RightRWheel")
)
"""By the rear wheels, which do not steer: what they roll gives the heading."""


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
    """Return a car with what is mounted on it, odometry and pose sensors besides.

    Args:
        car: Its figures.
        solids: More solids of the chassis, without mass.
        looks: What these are drawn as, and whatever else is drawn of it alone.
        packages: Mission packages, whose mass is part of the car's.
        sensors: Sensors of its own.
        cameras: Cameras.
        sources: Where its figures are from; steering, suspension and pose sensors are chosen for all.
    """
    head = sum(shape.mass for package in packages for link in package.links for shape in link.shapes)
    (front, steered), (rear, straight) = _axle(car, front=True), _axle(car, front=False)
    return RobotSpec(
        name=car.name,
        dimensions=car.dimensions,
        mass=car.mass,
        origin_height=car.origin,
        chassis=(*_body(car, head), *solids),
        looks=(*car_looks(_frame(car), car.look), *looks),
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
