"""UnitLoader: a platform on four wheels with a roller table, which receives packages and passes them on.

A release of 2011 could spawn a class of that name; its appearance and measurements are unknown. All are
chosen.
"""

from usarmjx.models.drives import SkidSteer
from usarmjx.models.robots.kit import (
    ALONG,
    AMBER,
    DARK,
    JET_BLACK,
    LAMP,
    POSE_SENSORS,
    block,
    drum,
    rod,
    sick,
    sick_housing,
    sick_lms200,
    wheel,
)
from usarmjx.models.types.robot import Motor, Mount, RobotSpec
from usarmjx.models.types.shapes import Rgba, Shape

RADIUS, TRACK, BASE = 0.12, 0.50, 0.34
LENGTH, WIDTH, DECK = 0.60, 0.56, 0.34  # the deck's height, on which the rollers stand
ORIGIN = 0.20
MOTOR = Motor(max_speed=6.0, torque=8.0, armature=0.3)
SCANNER = (0.22, 0.0, 0.03)  # in a recess below the deck
YELLOW = (0.9, 0.7, 0.1, 1.0)


def loader_visuals(
    length: float, width: float, scanner: tuple[float, float, float], rgba: Rgba
) -> tuple[Shape, ...]:
    """Return a UnitLoader without wheels and rollers: a platform with warning stripes on its sides."""
    stripes = tuple(
        block((0.022, width / 2 + 0.002, 0.0199), (x, 0.0, -0.05), JET_BLACK)
        for x in (-0.24, -0.12, 0.0, 0.12, 0.24)
    )
    return (
        block((0.28, 0.2, 0.05), (0.0, 0.0, 0.075), DARK),
        block((0.2, 0.16, 0.03), (-0.04, 0.0, 0.0), DARK),
        block((length / 2, width / 2, 0.02), (0.0, 0.0, -0.05), rgba),
        *stripes,
        *sick(scanner),
        *(drum(0.02, 0.01, (0.295, y, 0.0), LAMP, ALONG) for y in (0.14, -0.14)),
        rod((-0.27, 0.2, -0.07), (-0.27, 0.2, -0.09), 0.025, AMBER),
    )


UNIT_LOADER = RobotSpec(
    name="UnitLoader",
    dimensions=(LENGTH, WIDTH, DECK),
    mass=40.0,
    payload=40.0,
    origin_height=ORIGIN,
    chassis=(
        Shape(kind="box", size=(0.28, 0.20, 0.06), at=(0.0, 0.0, 0.08), mass=34.2, rgba=YELLOW),
        Shape(kind="box", size=(LENGTH / 2, WIDTH / 2, 0.02), at=(0.0, 0.0, -0.05), rgba=YELLOW),
        sick_housing(SCANNER),
    ),
    looks=loader_visuals(LENGTH, WIDTH, SCANNER, YELLOW),
    parts=tuple(
        wheel(name, at=(x, y, ORIGIN - RADIUS), size=(RADIUS, WIDTH - TRACK), mass=1.0, motor=MOTOR)
        for name, x, y in (
            ("LeftFWheel", BASE / 2, -TRACK / 2),
            ("RightFWheel", BASE / 2, TRACK / 2),
            ("LeftRWheel", -BASE / 2, -TRACK / 2),
            ("RightRWheel", -BASE / 2, TRACK / 2),
        )
    ),
    drive=SkidSteer(
        left=("LeftFWheel", "LeftRWheel"),
        right=("RightFWheel", "RightRWheel"),
        max_spin=MOTOR.max_speed,
        radius=RADIUS,
    ),
    sensors=(sick_lms200(SCANNER), *POSE_SENSORS),
    effecters=(
        Mount(kind="RollerTable", name="Roller", at=(0.0, 0.0, ORIGIN - DECK)),
        Mount(kind="Headlight", name="Headlight", at=(0.30, 0.0, 0.0)),
    ),
    wheel_radius=RADIUS,
    wheel_separation=TRACK,
    wheel_base=BASE,
    sources=(("dimensions", "chosen"), ("mass", "chosen"), ("top speed", "chosen"), ("layout", "chosen")),
)
