"""The robots on two tracks: Talon and Rugbot (manual 12.12, 12.22)."""

import math

from usarmjx.base.transforms import Vec3
from usarmjx.models.robots.kit import (
    ACROSS,
    ALONG,
    BLACK,
    DARK,
    GRIPPER_FINGERS_MASS,
    JET_BLACK,
    LAMP,
    POSE_SENSORS,
    STEEL,
    Belt,
    block,
    camera,
    drive_tracks,
    drum,
    lens,
    mass_of,
    mirrored,
    pan_tilt,
    prism,
    rod,
    sick,
    sick_housing,
    sick_lms200,
    track_pair,
    track_pair_visuals,
)
from usarmjx.models.types.robot import CHASSIS, Link, MissionPackage, Motor, Mount, RobotSpec
from usarmjx.models.types.shapes import Shape

OLIVE = (0.35, 0.38, 0.22, 1.0)
RED = (0.75, 0.1, 0.1, 1.0)

TALON_LENGTH, TALON_WIDTH, TALON_HEIGHT = 0.9117, 0.5903, 0.3654  # manual 12.12.1
TALON_MASS, TALON_PAYLOAD = 34.0, 45.0  # manual 12.12.1
TALON_ORIGIN = 0.13  # manual 5.3.6
TALON_BELT = Belt(
    radius=0.14,  # manual 12.12.1: 0.28 (its unit is wrong), taken for a diameter: 0.90 m/s
    max_spin=6.43,  # manual 12.12.1
    width=0.15,  # chosen, as all without a source
    max_pull=300.0,
    inertia=4.0,
    wheel_mass=1.0,
    cleat=0.013,
    trim=OLIVE,
)
TALON_SEPARATION = TALON_WIDTH - TALON_BELT.width
TALON_BUMPER = 0.004
"""Overhang of its bumpers before and behind its tracks, above the steps that it climbs [m]: they make contact
with walls, which the tracks would climb until the robot turned over."""
TALON_AXLE = TALON_LENGTH / 2 - TALON_BELT.radius
TALON_AXLE_HEIGHT = TALON_ORIGIN - TALON_BELT.radius  # z down: the axles are 1 cm above the origin


def _arm_motor(torque: float, armature: float) -> Motor:
    """Return a servo so stiff that the arm's weight bends no joint by a hundredth of a radian."""
    return Motor(
        max_speed=0.5, torque=torque, stiffness=4000.0 * armature, damping=60.0 * armature, armature=armature
    )


def _arm_visuals(length: float) -> tuple[Shape, ...]:
    """Return a link of the arm: a joint, a tube, and the collar at its end."""
    return (
        drum(0.036, 0.04, rgba=DARK, rotation=ACROSS),
        rod((0.0, 0.0, 0.0), (length, 0.0, 0.0), 0.021, OLIVE, blunt=True),
        drum(0.028, 0.015, (0.8 * length, 0.0, 0.0), JET_BLACK, ALONG),
    )


def _arm_link(
    number: int, location: Vec3, orientation: Vec3, limits: tuple[float, float], motor: Motor, length: float
) -> Link:
    bar = Shape(
        kind="box", size=(length / 2, 0.025, 0.025), at=(length / 2, 0.0, 0.0), mass=2.4 * length, rgba=BLACK
    )
    return Link(
        number=number,
        parent=number - 1 if number > 1 else -1,
        location=location,
        orientation=orientation,
        max_speed=motor.max_speed,
        max_torque=motor.torque,
        min_range=limits[0],
        max_range=limits[1],
        shapes=(bar,),
        looks=_arm_visuals(length),
        motor=motor,
    )


UPPER, LOWER, HAND = 0.45, 0.33, 0.06  # chosen lengths: at zero the arm lies ahead along the deck
TILT: Vec3 = (-math.pi / 2, 0.0, 0.0)  # turns z to the right: positive lifts the arm
TALON_ARM = MissionPackage(
    # The manual's text has two joints, its example of MISPKG moves links 1 and 3: shoulder, elbow and wrist.
    name="TalonArm",
    links=(
        _arm_link(1, (-0.33, 0.0, -0.19), TILT, (-0.1, 2.6), _arm_motor(120.0, 2.0), UPPER),
        _arm_link(2, (UPPER, 0.0, 0.0), (0.0, 0.0, 0.0), (-2.6, 2.6), _arm_motor(60.0, 1.0), LOWER),
        _arm_link(3, (LOWER, 0.0, 0.0), (0.0, math.pi / 2, 0.0), (1.0, 0.0), _arm_motor(20.0, 0.3), HAND),
    ),
)


def _talon_body(top: float) -> tuple[Shape, ...]:
    """Return hull, boxes and mast of a Talon; `top` is z of its deck."""
    return (
        prism(
            mirrored([(0.36, 0.03), (0.4, -0.03), (0.36, top)]),
            0.135,
            OLIVE,
        ),
        *(block((0.33, 0.07, 0.006), (0.0, y, top - 0.004), OLIVE) for y in (-0.2, 0.2)),  # fenders
        block((0.12, 0.1, 0.03), (0.08, 0.0, top - 0.02), JET_BLACK),
        block((0.1, 0.05, 0.03), (-0.2, 0.2, top - 0.035), OLIVE),
        block((0.1, 0.05, 0.03), (-0.2, -0.2, top - 0.035), OLIVE),
        block((0.05, 0.06, 0.03), (-0.33, 0.0, top - 0.02), DARK),
        *(drum(0.022, 0.012, (0.385, y, -0.06), LAMP, ALONG) for y in (-0.08, 0.08)),
        *lens((0.372, 0.0, top - 0.002), 0.018),
        rod((-0.3, 0.12, top), (-0.3, 0.12, top - 0.3), 0.006, JET_BLACK),
        rod((-0.3, -0.12, top), (-0.3, -0.12, top - 0.3), 0.006, JET_BLACK),
    )


def talon(wheels: int = 10) -> RobotSpec:
    """Return the Talon with a number of wheels in each track (manual 12.10.2)."""
    row = {
        "separation": TALON_SEPARATION,
        "front": TALON_AXLE,
        "rear": -TALON_AXLE,
        "height": TALON_AXLE_HEIGHT,
    }
    parts = track_pair(TALON_BELT, wheels, **row)
    packages = (TALON_ARM,)
    top = TALON_ORIGIN - TALON_BELT.radius - 0.13  # z of the deck
    return RobotSpec(
        name="Talon",
        dimensions=(TALON_LENGTH, TALON_WIDTH, TALON_HEIGHT),
        mass=TALON_MASS,
        payload=TALON_PAYLOAD,
        origin_height=TALON_ORIGIN,
        chassis=(
            Shape(kind="box", size=(0.38, TALON_WIDTH / 2, 0.05), at=(0.0, 0.0, top + 0.05), rgba=OLIVE),
            Shape(
                kind="box",
                size=(TALON_LENGTH / 2 + TALON_BUMPER, TALON_WIDTH / 2, 0.015),
                at=(0.0, 0.0, -0.1),
                rgba=OLIVE,
            ),
            Shape(
                kind="box",
                size=(0.35, 0.14, 0.05),
                mass=TALON_MASS - mass_of(parts, packages) - GRIPPER_FINGERS_MASS,
                surface="fixture",
                rgba=OLIVE,
            ),
        ),
        looks=(*track_pair_visuals(TALON_BELT, **row), *_talon_body(top)),
        parts=parts,
        drive=drive_tracks(parts, TALON_BELT),
        packages=packages,
        sensors=POSE_SENSORS,
        cameras=(
            camera(at=(0.38, 0.0, top), parent=CHASSIS),
            camera("Camera2", at=(-0.38, 0.0, top), direction=(0.0, 0.0, math.pi), parent=CHASSIS),
            camera("Camera3", at=(0.0, 0.0, -0.06), parent="TalonArm_Link2"),
            camera("Camera4", at=(0.0, 0.0, -0.06), parent="TalonArm_Link3"),
        ),
        effecters=(Mount(kind="Gripper", name="Gripper", parent="TalonArm_Link3", at=(HAND, 0.0, 0.0)),),
        wheel_radius=TALON_BELT.radius,
        wheel_separation=TALON_SEPARATION,
        wheel_base=2 * TALON_AXLE,
        sources=(
            ("dimensions", "manual 12.12"),
            ("mass", "manual 12.12"),
            ("payload", "manual 12.12"),
            ("wheel_radius", "manual 12.12"),
            ("top speed", "manual 12.12"),
            ("origin_height", "manual 5.3.6"),
            ("sensors", "manual 12.12"),
            ("layout", "chosen"),
            ("arm", "chosen"),
        ),
    )


TALON = talon()

RUGBOT_LENGTH, RUGBOT_WIDTH, RUGBOT_HEIGHT = 0.385, 0.255, 0.270  # manual 12.22
RUGBOT_MASS, RUGBOT_PAYLOAD = 34.0, 45.0  # manual 12.22
RUGBOT_BELT = Belt(
    radius=0.125,  # manual 12.22, its unit read as m
    max_spin=6.0,  # manual 12.22
    width=0.06,  # chosen, as all without a source
    max_pull=60.0,
    inertia=8.0,
    wheel_mass=0.8,
    cleat=0.011,
    trim=RED,
)
RUGBOT_SEPARATION = RUGBOT_WIDTH - RUGBOT_BELT.width
RUGBOT_AXLE = RUGBOT_LENGTH / 2 - RUGBOT_BELT.radius
RUGBOT_DECK = RUGBOT_BELT.radius - RUGBOT_HEIGHT  # z
RUGBOT_SCANNER = (0.08, 0.0, RUGBOT_DECK - 0.055)


def rugbot(wheels: int = 3) -> RobotSpec:
    """Return the Rugbot with a number of wheels in each track (manual 12.10.2)."""
    row = {"separation": RUGBOT_SEPARATION, "front": RUGBOT_AXLE, "rear": -RUGBOT_AXLE, "height": 0.0}
    parts = track_pair(RUGBOT_BELT, wheels, **row)
    packages = (pan_tilt((-0.05, 0.0, RUGBOT_DECK - 0.05)),)
    return RobotSpec(
        name="Rugbot",
        dimensions=(RUGBOT_LENGTH, RUGBOT_WIDTH, RUGBOT_HEIGHT),
        mass=RUGBOT_MASS,
        payload=RUGBOT_PAYLOAD,
        origin_height=RUGBOT_BELT.radius,
        chassis=(
            Shape(
                kind="box",
                size=(0.10, RUGBOT_WIDTH / 2, 0.0425),
                at=(0.0, 0.0, RUGBOT_DECK + 0.0425),
                rgba=RED,
            ),
            # Its mass lies low, between the tracks.
            Shape(
                kind="box",
                size=(0.15, 0.06, 0.04),
                at=(0.0, 0.0, 0.07),
                mass=RUGBOT_MASS - mass_of(parts, packages),
                surface="fixture",
                rgba=RED,
            ),
            sick_housing(RUGBOT_SCANNER),
        ),
        looks=(
            *track_pair_visuals(RUGBOT_BELT, **row),
            block((0.15, 0.062, 0.09), (0.0, 0.0, 0.0), DARK),
            block((0.13, RUGBOT_WIDTH / 2, 0.012), (0.0, 0.0, RUGBOT_DECK + 0.012), RED),
            prism([(0.12, -0.09), (0.1, RUGBOT_DECK), (-0.14, RUGBOT_DECK), (-0.16, -0.09)], 0.1, RED),
            block((0.025, 0.05, 0.03), (-0.14, 0.0, RUGBOT_DECK - 0.03), JET_BLACK),
            *(drum(0.015, 0.006, (0.15, y, 0.03), LAMP, ALONG) for y in (-0.035, 0.035)),
            block((0.06, 0.06, 0.008), (RUGBOT_SCANNER[0], 0.0, RUGBOT_DECK), DARK),
            rod((-0.05, 0.0, RUGBOT_DECK), (-0.05, 0.0, RUGBOT_DECK - 0.04), 0.02, STEEL, blunt=True),
            *sick(RUGBOT_SCANNER),
        ),
        parts=parts,
        drive=drive_tracks(parts, RUGBOT_BELT),
        packages=packages,
        sensors=(sick_lms200(RUGBOT_SCANNER), *POSE_SENSORS),
        cameras=(camera(),),
        wheel_radius=RUGBOT_BELT.radius,
        wheel_separation=RUGBOT_SEPARATION,
        wheel_base=2 * RUGBOT_AXLE,
        sources=(
            ("dimensions", "manual 12.22"),
            ("mass", "manual 12.22"),
            ("payload", "manual 12.22"),
            ("wheel_radius", "manual 12.22"),
            ("top speed", "manual 12.22"),
            ("sensors", "manual 12.22"),
            ("layout", "chosen"),
        ),
    )


RUGBOT = rugbot()
