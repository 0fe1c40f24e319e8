"""The Soryu: three cars on two tracks each, with a pan and a tilt joint between them (manual 12.15)."""

from dataclasses import replace

from usarmjx.base.transforms import Vec3
from usarmjx.models.robots.kit import (
    BLACK,
    DARK,
    POSE_SENSORS,
    STEEL,
    Belt,
    ball,
    block,
    camera,
    drive_tracks,
    drum,
    lens,
    mass_of,
    rod,
    track,
    track_names,
)
from usarmjx.models.types.robot import CHASSIS, LEFT, UP, Motor, Part, RobotSpec
from usarmjx.models.types.shapes import Shape

RIGHT: Vec3 = (0.0, 1.0, 0.0)
DOWN: Vec3 = (0.0, 0.0, 1.0)
YELLOW = (0.85, 0.75, 0.15, 1.0)

LENGTH, WIDTH, HEIGHT = 1.21, 0.122, 0.145  # manual 12.15.1
MASS = 10.0  # manual 12.15.1
BELT = Belt(
    radius=HEIGHT / 2,  # chosen, as all without a source: tracks above and below, as it drives on either
    max_spin=0.37 / (HEIGHT / 2),  # manual 12.15.1: 0.37 m/s
    width=0.055,
    max_pull=60.0,
    inertia=1.0,
    wheel_mass=0.06,
    cleat=0.007,
    trim=YELLOW,
)
CROWN = 0.006
"""Reduction of the end cars' axle radius [m]: on flat ground it stands on its middle car, and so can turn."""
END_BELT = replace(
    BELT, radius=BELT.radius - CROWN, max_spin=BELT.max_spin * BELT.radius / (BELT.radius - CROWN)
)
SEPARATION = WIDTH - BELT.width
CAR_LENGTH = 0.38  # length of a car
CAR_SPACING = (LENGTH - CAR_LENGTH) / 2  # from car to car
AXLE = CAR_LENGTH / 2 - BELT.radius  # x of a car's first axle from its middle
CAR_MASS = 2.6
JOINT_MASS = 0.2
TILT_MOTOR = Motor(max_speed=1.0, torque=50.0, stiffness=1000.0, damping=35.0, armature=0.5)
PAN_MOTOR = Motor(max_speed=1.0, torque=30.0, stiffness=600.0, damping=21.0, armature=0.3)


def _body(mass: float, at: Vec3 = (0.0, 0.0, 0.0)) -> tuple[Shape, ...]:
    """Return a car's hull between and inside its tracks; the wheels' rims stand out of it on all sides."""
    half = (CAR_LENGTH / 2 - 0.04, WIDTH / 2 - 0.003, 0.02)
    return (Shape(kind="box", size=half, at=at, mass=mass, rgba=YELLOW),)


def _car_visuals(x: float, belt: Belt = END_BELT) -> tuple[Shape, ...]:
    """Return a car with its middle at x: two belts and a hull between, with a lid above and below."""
    belts = (belt.looks((x + AXLE, y, 0.0), (x - AXLE, y, 0.0)) for y in (-SEPARATION / 2, SEPARATION / 2))
    return (
        *(solid for track_looks in belts for solid in track_looks),
        block((CAR_LENGTH / 2 - 0.015, 0.0115, 0.05), (x, 0.0, 0.0), YELLOW),
        block((CAR_LENGTH / 2 - 0.05, WIDTH / 2 - 0.002, 0.012), (x, 0.0, 0.0), YELLOW),
        *(block((0.05, 0.0118, 0.003), (x, 0.0, z), BLACK) for z in (-0.05, 0.05)),
    )


def _face(x: float) -> tuple[Shape, ...]:
    """Return the two cameras and the lamps at the front of the first car."""
    front = x + CAR_LENGTH / 2
    return (
        *lens((front - 0.012, 0.0, -0.03), 0.01),
        *lens((front - 0.012, 0.0, 0.0), 0.01),
        drum(0.008, 0.006, (front - 0.012, 0.0, 0.03), (0.98, 0.97, 0.86, 1.0), (0.0, 1.5708, 0.0)),
    )


def _joint_pair(end: str, sign: int) -> tuple[Part, Part]:
    """Return the joints before (sign 1) or behind the middle car: pan first, then tilt with the car on it.

    Positive pans the end to the left and tilts it up, in front as behind.
    """
    x = sign * CAR_SPACING / 2
    pan = Part(
        name=f"{end}Pan",
        at=(sign * CAR_SPACING / 2, 0.0, 0.0),
        axis=UP if sign > 0 else DOWN,
        motor=PAN_MOTOR,
        limits=(-0.8, 0.8),
        shapes=(Shape(kind="sphere", size=(0.02,), mass=JOINT_MASS, surface="fixture", rgba=BLACK),),
        looks=(
            drum(0.024, 0.03, rgba=DARK),
            rod((-sign * 0.04, 0.0, 0.0), (sign * 0.04, 0.0, 0.0), 0.014, STEEL, blunt=True),
            *(ball((0.011, 0.034, 0.034), (sign * at, 0.0, 0.0), BLACK) for at in (-0.03, 0.03)),
        ),
    )
    tilt = Part(
        name=f"{end}Tilt",
        parent=pan.name,
        axis=RIGHT if sign > 0 else LEFT,
        motor=TILT_MOTOR,
        limits=(-1.5, 1.5),
        shapes=_body(CAR_MASS, (x, 0.0, 0.0)),
        looks=(*_car_visuals(x), *(_face(x) if sign > 0 else ())),
    )
    return pan, tilt


def soryu(wheels: int = 4) -> RobotSpec:
    """Return the Soryu with a number of wheels in each of its six tracks (manual 12.10.2)."""
    joints = (*_joint_pair("Front", 1), *_joint_pair("Rear", -1))
    cars = (("FrontTilt", CAR_SPACING / 2), (CHASSIS, 0.0), ("RearTilt", -CAR_SPACING / 2))
    tracks: list[Part] = []
    for side, y in (("Left", -SEPARATION / 2), ("Right", SEPARATION / 2)):
        names = track_names(side, wheels * len(cars))
        # The same iterator several times: as many names at a time as a car has wheels.
        for (parent, x), some in zip(cars, zip(*[iter(names)] * wheels, strict=True), strict=True):
            belt = BELT if parent == CHASSIS else END_BELT
            out = CAR_LENGTH / 2 - belt.radius
            tracks += track(belt, some, (x + out, y, 0.0), (x - out, y, 0.0), parent)
    parts = (*joints, *tracks)
    return RobotSpec(
        name="Soryu",
        dimensions=(LENGTH, WIDTH, HEIGHT),
        mass=MASS,
        origin_height=BELT.radius,
        chassis=_body(MASS - mass_of(parts)),
        looks=_car_visuals(0.0, BELT),
        parts=parts,
        drive=drive_tracks(parts, BELT),
        sensors=POSE_SENSORS,
        cameras=(
            camera(at=(CAR_SPACING / 2 + CAR_LENGTH / 2, 0.0, -0.03), parent="FrontTilt"),
            camera("Camera2", at=(CAR_SPACING / 2 + CAR_LENGTH / 2, 0.0, 0.0), parent="FrontTilt"),
        ),
        wheel_radius=BELT.radius,
        wheel_separation=SEPARATION,
        wheel_base=2 * (CAR_SPACING + AXLE),
        reported_joints=tuple(joint.name for joint in joints),
        sources=(
            ("dimensions", "manual 12.15"),
            ("mass", "manual 12.15"),
            ("top speed", "manual 12.15"),
            ("cameras", "manual 12.15"),
            ("wheel_radius", "chosen"),
            ("layout", "chosen"),
            ("joints", "chosen"),
        ),
    )


SORYU = soryu()
