"""The robots on tracks with four flippers: Tarantula and Kenaf (manual 12.10, 12.23).

Flipper angles are the manual's and UsarCommander's: negative in front and positive behind is up, and {FR,FL}
1.5 with {RR,RL} -1.5 lifts the chassis (12.23).
"""

import math
from dataclasses import replace

from usarmjx.models.robots.kit import (
    ACROSS,
    ALONG,
    BLACK,
    DARK,
    ENCODER_AXIS,
    FLIPPERS,
    JET_BLACK,
    LAMP,
    POSE_SENSORS,
    STEEL,
    Belt,
    Flippers,
    block,
    camera,
    drive_tracks,
    drum,
    lens,
    mass_of,
    mirrored,
    prism,
    rod,
    track_pair,
    track_pair_visuals,
)
from usarmjx.models.types.robot import CHASSIS, Link, MissionPackage, Motor, Mount, RobotSpec, options
from usarmjx.models.types.shapes import Shape

RIGHT = (0.0, 1.0, 0.0)
ORANGE = (0.9, 0.45, 0.1, 1.0)
GREEN = (0.2, 0.45, 0.25, 1.0)

# The Tarantula is a toy that stands on its four tracked arms alone. Here a row of wheels of the chassis
# closes the gap between the inner ends of front and rear track, so that no edge gets between them.
TARANTULA_HEIGHT = 0.1406  # manual 12.10.1; that of the tracks, whose wheels fill it
TARANTULA_WIDTH, TARANTULA_LENGTH = 0.444, 0.6778  # manual 12.10.1; with the flippers out
TARANTULA_BELT = Belt(
    radius=TARANTULA_HEIGHT / 2,
    max_spin=3.1416,  # manual 12.10.1
    width=0.06,  # chosen, as all below
    max_pull=50.0,
    inertia=1.0,
    wheel_mass=0.12,
    cleat=0.007,
    trim=ORANGE,
)
TARANTULA_PIVOT, TARANTULA_TIP = 0.12, 0.035
TARANTULA_SEPARATION = TARANTULA_WIDTH - TARANTULA_BELT.width
TARANTULA_FLIPPERS = Flippers(
    pivot=(TARANTULA_PIVOT, TARANTULA_SEPARATION / 2),
    height=0.0,
    length=TARANTULA_LENGTH / 2 - TARANTULA_PIVOT - TARANTULA_TIP,
    tip=TARANTULA_TIP,
    count=3,
    mass=0.25,
    motor=Motor(max_speed=1.5, torque=25.0, stiffness=400.0, damping=14.0, armature=0.2),
)
TARANTULA_MASS = 8.0  # chosen: the toy with batteries and a computer


_TARANTULA_BODY = (
    prism(
        mirrored([(0.15, 0.0), (0.17, -0.03), (0.12, -0.066)]),
        0.15,
        ORANGE,
    ),
    block((0.09, 0.1, 0.004), (-0.01, 0.0, -0.067), JET_BLACK),
    block((0.02, 0.12, 0.012), (0.155, 0.0, -0.03), DARK),
    *(drum(0.015, 0.006, (0.176, y, -0.03), LAMP, ALONG) for y in (-0.08, 0.08)),
    rod((-0.12, 0.1, -0.06), (-0.15, 0.1, -0.2), 0.003, JET_BLACK),
)


def tarantula(wheels: int = 4) -> RobotSpec:
    """Return the Tarantula with a number of wheels in each row of the chassis (manual 12.10.2)."""
    row = {
        "separation": TARANTULA_SEPARATION,
        "front": TARANTULA_PIVOT,
        "rear": -TARANTULA_PIVOT,
        "height": 0.0,
    }
    rows = track_pair(TARANTULA_BELT, wheels, **row)
    parts = (*rows, *TARANTULA_FLIPPERS.parts(TARANTULA_BELT))
    return RobotSpec(
        name="Tarantula",
        dimensions=(TARANTULA_LENGTH, TARANTULA_WIDTH, TARANTULA_HEIGHT),
        mass=TARANTULA_MASS,
        origin_height=TARANTULA_BELT.radius,
        chassis=(
            Shape(
                kind="box",
                size=(0.16, 0.155, 0.03),
                at=(0.0, 0.0, -0.035),
                mass=TARANTULA_MASS - mass_of(parts),
                rgba=ORANGE,
            ),
        ),
        looks=(*track_pair_visuals(TARANTULA_BELT, **row), *_TARANTULA_BODY),
        parts=parts,
        drive=drive_tracks(parts, TARANTULA_BELT),
        sensors=POSE_SENSORS,
        wheel_radius=TARANTULA_BELT.radius,
        wheel_separation=TARANTULA_SEPARATION,
        wheel_base=2 * TARANTULA_PIVOT,
        reported_joints=FLIPPERS,
        sources=(
            ("dimensions", "manual 12.10"),
            ("top speed", "manual 12.10"),
            ("flippers", "manual 12.10"),
            ("wheel_radius", "chosen"),
            ("mass", "chosen"),
            ("layout", "chosen"),
            ("sensors", "chosen"),
        ),
    )


TARANTULA = tarantula()

# Hokuyo URG-04LX as the UDK version's ini has it: 228 beams over 240 degrees. MinRange from its data sheet.
HOKUYO = options(MaxRange=4.0, MinRange=0.02, Resolution=0.0184087, ScanFov=4.189, ScanInterval=0.3)
# Six motors (manual 12.23.1): one for each track, one for each flipper.
KENAF_ENCODERS = (
    ("ECLeft", "LeftFWheel"),
    ("ECRight", "RightFWheel"),
    ("ECFR", "FRFlipper"),
    ("ECFL", "FLFlipper"),
    ("ECRR", "RRFlipper"),
    ("ECRL", "RLFlipper"),
)

KENAF_SHORT, KENAF_LONG = 0.575, 0.937  # manual 12.23.1: without and with flippers
KENAF_WIDTH, KENAF_HEIGHT = 0.429, 0.259  # manual 12.23.1
KENAF_MASS = 20.0  # manual 12.23.1
KENAF_BELT = Belt(
    radius=0.0875,  # chosen, as all without a source
    max_spin=6.2832,  # the wheel joint's default in the Kenaf of the UDK version: 0.55 m/s
    width=0.14,
    max_pull=120.0,
    inertia=2.0,
    wheel_mass=0.3,
    cleat=0.009,
    trim=GREEN,
)
KENAF_NARROW = replace(KENAF_BELT, width=0.05, wheel_mass=0.15)
KENAF_PIVOT, KENAF_TIP = KENAF_SHORT / 2 - KENAF_BELT.radius, 0.04
KENAF_SEPARATION = KENAF_WIDTH - 2 * KENAF_NARROW.width - KENAF_BELT.width
KENAF_FLIPPERS = Flippers(
    pivot=(KENAF_PIVOT, (KENAF_WIDTH - KENAF_NARROW.width) / 2),
    height=0.0,
    length=KENAF_LONG / 2 - KENAF_PIVOT - KENAF_TIP,
    tip=KENAF_TIP,
    count=4,
    mass=0.5,
    motor=Motor(max_speed=1.5, torque=60.0, stiffness=1200.0, damping=42.0, armature=0.6),
)
KENAF_DECK = KENAF_BELT.radius - KENAF_HEIGHT  # z of the body's top
KENAF_HEAD = (0.10, 0.0, KENAF_DECK - 0.03)  # pan joint
KENAF_SCANNER = (0.20, 0.0, KENAF_DECK - 0.04)
KENAF_MAST = (-0.20, 0.0, KENAF_DECK - 0.40)  # top of the pole that carries the bird's-eye camera
KENAF_HEAD_MOTOR = Motor(max_speed=1.0, torque=3.0, stiffness=40.0, damping=1.4, armature=0.02)

KENAF_HEAD_FORCE = 20.0  # as captured of other camera heads, in the original's own units
KENAF_CAMERA = MissionPackage(
    # Its joints have names of their own, by which MULTIDRIVE moves them (manual 12.23.1). Pan to the left and
    # tilt up are positive, as on every camera here; the manual's example leaves the side open.
    name="CameraPanTilt",
    links=(
        Link(
            number=1,
            part="kenafCameraPan",
            parent=-1,
            location=KENAF_HEAD,
            orientation=(math.pi, 0.0, 0.0),  # its axis points up
            min_range=1.0,
            max_range=0.0,
            max_speed=KENAF_HEAD_MOTOR.max_speed,
            max_torque=KENAF_HEAD_FORCE,
            motor=KENAF_HEAD_MOTOR,
            shapes=(Shape(kind="sphere", size=(0.03,), mass=0.2, surface="fixture", rgba=BLACK),),
            looks=(drum(0.03, 0.02, (0.0, 0.0, 0.005)), drum(0.02, 0.025, (0.0, 0.0, -0.03), STEEL)),
        ),
        Link(
            number=2,
            part="kenafCameraTilt",
            parent=1,
            location=(0.0, 0.0, 0.06),
            orientation=(math.pi / 2, 0.0, 0.0),  # its axis points to the right
            min_range=-1.0,
            max_range=1.5,
            max_speed=KENAF_HEAD_MOTOR.max_speed,
            max_torque=KENAF_HEAD_FORCE,
            motor=KENAF_HEAD_MOTOR,
            shapes=(Shape(kind="box", size=(0.05, 0.04, 0.03), mass=0.3, surface="fixture", rgba=BLACK),),
            looks=(
                block((0.042, 0.036, 0.026), rgba=DARK),
                drum(0.018, 0.042, rgba=STEEL, rotation=ACROSS),
                *lens((0.045, 0.0, 0.0), 0.018),
                *(drum(0.006, 0.004, (0.043, y, -0.015), LAMP, ALONG) for y in (-0.025, 0.025)),
            ),
        ),
    ),
)
KENAF_HEAD_MASS = sum(shape.mass for link in KENAF_CAMERA.links for shape in link.shapes)


_KENAF_BODY = (
    prism(
        mirrored([(0.25, -0.05), (0.235, -0.14), (0.19, KENAF_DECK)]),
        0.15,
        GREEN,
        top=0.135,
    ),
    block((0.2, 0.13, 0.05), (0.0, 0.0, -0.02), DARK),
    block((0.13, 0.1, 0.003), (-0.04, 0.0, KENAF_DECK - 0.002), JET_BLACK),
    block((0.01, 0.1, 0.012), (0.244, 0.0, -0.085), STEEL),
    # A Hokuyo: a square foot, a drum with a window, an orange cap.
    block((0.025, 0.025, 0.015), (KENAF_SCANNER[0], 0.0, KENAF_DECK - 0.015), JET_BLACK),
    drum(0.022, 0.012, (KENAF_SCANNER[0], 0.0, KENAF_SCANNER[2]), DARK),
    drum(0.02, 0.01, (KENAF_SCANNER[0], 0.0, KENAF_SCANNER[2] - 0.02), ORANGE),
    drum(0.035, 0.012, (KENAF_HEAD[0], 0.0, KENAF_DECK - 0.01), STEEL),
    rod((KENAF_MAST[0], 0.0, KENAF_DECK), KENAF_MAST, 0.01, STEEL, blunt=True),
    block((0.025, 0.022, 0.018), (KENAF_MAST[0], 0.0, KENAF_MAST[2]), DARK, (0.0, -0.9, 0.0)),
    drum(
        0.012,
        0.008,
        (KENAF_MAST[0] + 0.018, 0.0, KENAF_MAST[2] + 0.022),
        JET_BLACK,
        (0.0, math.pi / 2 - 0.9, 0.0),
    ),
    rod((-0.2, 0.1, KENAF_DECK), (-0.2, 0.1, KENAF_DECK - 0.25), 0.004, JET_BLACK),
)


KENAF_SENSORS = (
    Mount(kind="RangeScanner", name="Scanner1", at=KENAF_SCANNER, defaults=HOKUYO),
    *POSE_SENSORS,
    *(Mount(kind="Encoder", name=name, parent=part, direction=ENCODER_AXIS) for name, part in KENAF_ENCODERS),
)


def kenaf(wheels: int = 8) -> RobotSpec:
    """Return the Kenaf with a number of wheels in each of its two body tracks (manual 12.10.2)."""
    row = {"separation": KENAF_SEPARATION, "front": KENAF_PIVOT, "rear": -KENAF_PIVOT, "height": 0.0}
    rows = track_pair(KENAF_BELT, wheels, **row)
    parts = (*rows, *KENAF_FLIPPERS.parts(KENAF_NARROW))
    body = -KENAF_DECK / 2
    return RobotSpec(
        name="kenaf",  # manual 12.23.1 spells it so
        dimensions=(KENAF_LONG, KENAF_WIDTH, KENAF_HEIGHT),
        mass=KENAF_MASS,
        origin_height=KENAF_BELT.radius,
        chassis=(
            # Over the tracks and no lower than their axles; its mass lies in a pan between them.
            Shape(kind="box", size=(0.235, 0.15, body - 0.01), at=(0.0, 0.0, -body - 0.01), rgba=GREEN),
            Shape(
                kind="box",
                size=(0.20, 0.15, 0.05),
                at=(0.0, 0.0, -0.03),
                mass=KENAF_MASS - mass_of(parts) - KENAF_HEAD_MASS,
                surface="fixture",
                rgba=GREEN,
            ),
            Shape(kind="box", size=(0.03, 0.03, 0.035), at=KENAF_SCANNER, surface="fixture", rgba=BLACK),
            Shape(
                kind="box",
                size=(0.01, 0.01, 0.20),
                at=(KENAF_MAST[0], 0.0, KENAF_MAST[2] + 0.20),
                surface="fixture",
                rgba=BLACK,
            ),
        ),
        looks=(*track_pair_visuals(KENAF_BELT, **row), *_KENAF_BODY),
        parts=parts,
        drive=drive_tracks(parts, KENAF_BELT),
        packages=(KENAF_CAMERA,),
        sensors=KENAF_SENSORS,
        cameras=(
            camera(at=(0.05, 0.0, 0.0), parent="kenafCameraTilt"),
            camera("BirdsEye", at=KENAF_MAST, direction=(0.0, -0.9, 0.0), parent=CHASSIS),
        ),
        wheel_radius=KENAF_BELT.radius,
        wheel_separation=KENAF_SEPARATION,
        wheel_base=2 * KENAF_PIVOT,
        reported_joints=FLIPPERS,
        sources=(
            ("dimensions", "manual 12.23"),
            ("mass", "manual 12.23"),
            ("sensors", "manual 12.23"),
            ("flippers", "manual 12.23"),
            ("top speed", "chosen"),
            ("wheel_radius", "chosen"),
            ("layout", "chosen"),
        ),
    )


KENAF = kenaf()
