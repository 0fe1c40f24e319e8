"""The six-wheeled indoor robots Kurt2D and Kurt3D (manual 12.16, 12.17)."""

import math

from usarmjx.models.drives import SkidSteer
from usarmjx.models.robots.kit import (
    ACROSS,
    ALONG,
    BLACK,
    DARK,
    ENCODER_AXIS,
    GOLD,
    JET_BLACK,
    LEVEL_SONAR,
    POSE_SENSORS,
    SICK_YELLOW,
    STEEL,
    TAIL_LAMP,
    block,
    camera,
    drum,
    firm_motor,
    lens,
    mirrored,
    prism,
    rod,
    sick,
    sick_housing,
    sick_lms200,
    wheel,
)
from usarmjx.models.types.robot import CHASSIS, Mount, Part, RobotSpec
from usarmjx.models.types.shapes import Shape

LENGTH, WIDTH, HEIGHT = 0.45, 0.29, 0.35  # manual 12.16.1; the scanner is the highest
MASS = 35.0  # manual 12.16.1
TOP_SPEED = 4.0  # manual 12.16.1
ORIGIN = 0.175  # chosen: half its height
RADIUS, TYRE = 0.075, 0.04  # chosen: three wheels fill its length
BASE, TRACK = LENGTH - 2 * RADIUS, WIDTH - TYRE
WHEEL_MASS = 0.5  # chosen
MOTOR = firm_motor(
    max_speed=TOP_SPEED / RADIUS,
    torque=3.5,  # chosen: about what a tyre can put on the ground
    inertia=WHEEL_MASS * RADIUS**2 / 2,
    armature=0.06,  # chosen
)
LEFT_WHEELS, RIGHT_WHEELS = (tuple(f"{side}{row}Wheel" for row in "FMR") for side in ("Left", "Right"))
WHEELS = tuple(
    wheel(name, at=(x, y, ORIGIN - RADIUS), size=(RADIUS, TYRE), mass=WHEEL_MASS, motor=MOTOR)
    for names, y in ((LEFT_WHEELS, -TRACK / 2), (RIGHT_WHEELS, TRACK / 2))
    for name, x in zip(names, (BASE / 2, 0.0, -BASE / 2), strict=True)
)
DECK = 0.18  # height of the deck (chosen)
ORANGE = (0.85, 0.45, 0.1, 1.0)
SCANNER = (0.10, 0.0, ORIGIN - DECK - 0.06)  # chosen: on the deck
SCANNER_MASS = 4.5  # data sheet of the LMS200

SENSORS = (
    # Directions of the manual's sonar and seven IR sensors are chosen: ahead, and a fan over the front half.
    Mount(kind="Sonar", name="F1", at=(LENGTH / 2, 0.0, 0.04), defaults=LEVEL_SONAR),
    *(
        Mount(
            kind="IR",
            name=f"IR{i}",
            at=(0.13 + 0.09 * math.cos(yaw), 0.12 * math.sin(yaw), 0.02),
            direction=(0.0, 0.0, yaw),
        )
        for i, yaw in enumerate((math.radians(30 * k) for k in range(-3, 4)), start=1)
    ),
    Mount(kind="Encoder", name="ECLeft", parent="LeftMWheel", direction=ENCODER_AXIS),
    Mount(kind="Encoder", name="ECRight", parent="RightMWheel", direction=ENCODER_AXIS),
    *POSE_SENSORS,
)


_BODY = (
    prism(mirrored([(0.17, ORIGIN - 0.05), (0.225, ORIGIN - 0.09), (0.225, ORIGIN - 0.155)]), 0.1, ORANGE),
    block((LENGTH / 2, WIDTH / 2, 0.008), (0.0, 0.0, ORIGIN - DECK + 0.008), JET_BLACK),
    block((0.2, WIDTH / 2 + 0.001, 0.004), (0.0, 0.0, ORIGIN - DECK + 0.016), ORANGE),
    drum(0.016, 0.005, (0.226, 0.0, 0.04), GOLD, ALONG),
    *(
        block(
            (0.006, 0.012, 0.006),
            (0.14 + 0.09 * math.cos(yaw), 0.1 * math.sin(yaw), 0.02),
            TAIL_LAMP,
        )
        for yaw in (-0.5, 0.0, 0.5)
    ),
    block((0.05, 0.07, 0.02), (-0.15, 0.0, ORIGIN - DECK - 0.02), DARK),
    rod((-0.2, 0.1, ORIGIN - DECK), (-0.2, 0.1, ORIGIN - DECK - 0.16), 0.004, JET_BLACK),
)


def _kurt(
    name: str,
    *,
    solids: tuple[Shape, ...] = (),
    looks: tuple[Shape, ...],
    head: tuple[Part, ...] = (),
    scanner: Mount,
    cameras: tuple[Mount, ...],
) -> RobotSpec:
    carried = sum(shape.mass for part in (*WHEELS, *head) for shape in part.shapes)
    return RobotSpec(
        name=name,
        dimensions=(LENGTH, WIDTH, HEIGHT),
        mass=MASS,
        origin_height=ORIGIN,
        chassis=(
            # Between the wheels and just past them, with all mass but wheels and scanner.
            Shape(
                kind="box",
                size=(LENGTH / 2 + 0.001, 0.10, 0.055),
                at=(0.0, 0.0, ORIGIN - 0.095),
                mass=MASS - carried,
                rgba=ORANGE,
            ),
            Shape(
                kind="box",
                size=(LENGTH / 2, WIDTH / 2, (DECK - 0.155) / 2),
                at=(0.0, 0.0, ORIGIN - (DECK + 0.155) / 2),
                rgba=BLACK,
            ),
            *solids,
        ),
        looks=(*_BODY, *looks),
        parts=(*WHEELS, *head),
        drive=SkidSteer(left=LEFT_WHEELS, right=RIGHT_WHEELS, max_spin=MOTOR.max_speed, radius=RADIUS),
        sensors=(scanner, *SENSORS),
        cameras=cameras,
        wheel_radius=RADIUS,
        wheel_separation=TRACK,
        wheel_base=BASE,
        sources=(
            ("dimensions, mass, top speed, equipment", "manual 12.16"),
            ("wheels, layout, Odometry, INS, GroundTruth", "chosen"),
        ),
    )


KURT2D = _kurt(
    "Kurt2D",
    solids=(sick_housing(SCANNER),),
    looks=(
        *sick(SCANNER),
        rod((-0.05, 0.0, ORIGIN - DECK), (-0.05, 0.0, -0.03), 0.012, STEEL, blunt=True),
        block((0.03, 0.035, 0.025), (-0.06, 0.0, -0.05), DARK),
        *lens((-0.025, 0.0, -0.05), 0.015),
    ),
    scanner=sick_lms200(SCANNER),
    cameras=(camera(at=(-0.05, 0.0, -0.05), parent=CHASSIS),),
)

# The scanner between two cheeks that turn it up and down about its middle; positive looks up, as the pitch of
# what it carries. Range and speed are chosen: the real one's scans take some seconds for 120 degrees.
SCANNER_SIDES = Part(
    name="ScannerSides",
    at=(SCANNER[0], 0.0, ORIGIN - HEIGHT + 0.08),
    axis=(0.0, 1.0, 0.0),
    motor=firm_motor(max_speed=1.0, torque=20.0, inertia=0.02, armature=0.05),
    limits=(-math.pi / 3, math.pi / 3),
    shapes=(Shape(kind="box", size=(0.0775, 0.078, 0.08), mass=SCANNER_MASS, rgba=(0.2, 0.3, 0.7, 1)),),
    looks=(
        *sick((0.0, 0.0, 0.03)),
        *(drum(0.05, 0.004, (0.0, y, 0.0), SICK_YELLOW, ACROSS) for y in (-0.084, 0.084)),
        *(block((0.025, 0.02, 0.02), (0.025, y, -0.05), DARK) for y in (-0.1, 0.1)),
        *(solid for y in (-0.1, 0.1) for solid in lens((0.052, y, -0.05), 0.013)),
    ),
)
KURT3D = _kurt(
    "Kurt3D",
    looks=(
        *(block((0.03, 0.006, 0.06), (SCANNER[0], y, ORIGIN - DECK - 0.05), STEEL) for y in (-0.098, 0.098)),
        *(drum(0.03, 0.008, (SCANNER[0], y, SCANNER_SIDES.at[2]), JET_BLACK, ACROSS) for y in (-0.1, 0.1)),
        block((0.03, 0.02, 0.03), (SCANNER[0] - 0.02, 0.12, ORIGIN - DECK - 0.03), DARK),  # its servo
    ),
    head=(SCANNER_SIDES,),
    scanner=sick_lms200((0.0, 0.0, 0.0), parent=SCANNER_SIDES.name),
    cameras=tuple(
        camera(
            name, at=(0.05, y, -0.05), parent=SCANNER_SIDES.name
        )  # chosen: beside the scanner, and turned with it
        for name, y in (("Camera", -0.09), ("Camera2", 0.09))
    ),
)
