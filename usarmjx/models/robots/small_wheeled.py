"""Skid-steered robots on four wheels: StereoP2AT, ATRVJr and Zerg (manual 12.2, 12.4, 12.11)."""

import math
from collections.abc import Sequence
from dataclasses import replace

from usarmjx.models.drives import SkidSteer
from usarmjx.models.robots.kit import (
    ACROSS,
    BLACK,
    DARK,
    JET_BLACK,
    LEVEL_SONAR,
    POSE_SENSORS,
    STEEL,
    block,
    camera,
    drum,
    firm_motor,
    mirrored,
    pan_tilt,
    prism,
    rod,
    sick,
    sick_housing,
    sick_lms200,
    sonar_discs,
    wheel,
)
from usarmjx.models.robots.pioneer import P2AT, P2AT_SCANNER, p2at_visuals
from usarmjx.models.types.robot import Motor, Mount, Part, RobotSpec
from usarmjx.models.types.shapes import Rgba, Shape

WINE = (0.5, 0.08, 0.3, 1.0)
GREEN = (0.2, 0.4, 0.25, 1.0)
YELLOW = (0.85, 0.7, 0.15, 1.0)
LEFT_WHEELS, RIGHT_WHEELS = ("LeftFWheel", "LeftRWheel"), ("RightFWheel", "RightRWheel")

HALF_STEREO_BASELINE = 0.05  # half the distance of the eyes: manual 3.2.6.2's example, (eye to eye)/2
STEREO_P2AT = replace(
    P2AT,
    name="StereoP2AT",
    looks=p2at_visuals([mount for mount in P2AT.sensors if mount.kind == "Sonar"], P2AT_SCANNER, WINE),
    cameras=tuple(
        camera(name, at=(0.0820, 0.0002 + y, 0.0613))  # the P2AT's camera between them
        for name, y in (("Camera", -HALF_STEREO_BASELINE), ("Camera2", HALF_STEREO_BASELINE))
    ),
    sources=(*P2AT.sources, ("stereo camera", "manual 3.2.6")),
)


def atrv_visuals(
    sonars: Sequence[Mount], scanner: tuple[float, float, float], top: float, rgba: Rgba
) -> tuple[Shape, ...]:
    """Return an ATRVJr without its wheels and its camera; `top` is z of its deck."""
    lower = [(0.30, 0.27), (0.385, 0.17), (0.385, 0.0), (-0.385, 0.0), (-0.385, 0.17), (-0.30, 0.27)]
    return (
        prism(lower, 0.19, DARK),
        prism([(0.385, 0.005), (0.30, top), (-0.30, top), (-0.385, 0.005)], 0.312, rgba, top=0.23),
        block((0.27, 0.2, 0.004), (0.0, 0.0, top - 0.002), JET_BLACK),
        *(block((0.012, 0.17, 0.03), (x, 0.0, 0.12), rgba) for x in (0.39, -0.39)),
        *sonar_discs([((m.at[0], m.at[1], 0.06), m.direction[2]) for m in sonars], 0.042, 0.02),
        drum(0.03, 0.19, (0.0, 0.0, 0.1978), STEEL, ACROSS),
        block((0.06, 0.06, 0.006), (scanner[0], 0.0, top - 0.006), DARK),
        *sick(scanner),
        *(drum(0.012, 0.012, (-0.28, y, top - 0.015), (0.85, 0.1, 0.1, 1.0)) for y in (0.16, -0.16)),
        rod((-0.26, 0.0, top), (-0.26, 0.0, top - 0.25), 0.006, JET_BLACK),
    )


def zerg_visuals(length: float, rgba: Rgba) -> tuple[Shape, ...]:
    """Return a Zerg without its wheels and its camera: a flat body with sloping ends and a roll bar."""
    x = length / 2
    profile = mirrored([(x - 0.03, 0.035), (x, 0.02), (x - 0.04, -0.032)])
    return (
        prism(profile, 0.15, rgba),
        block((0.085, 0.11, 0.003), (0.0, 0.0, -0.034), JET_BLACK),
        block((0.006, 0.1, 0.012), (x - 0.004, 0.0, 0.018), JET_BLACK),
        rod((-0.06, -0.13, -0.03), (-0.06, -0.13, -0.055), 0.006, JET_BLACK),
        rod((-0.06, 0.13, -0.03), (-0.06, 0.13, -0.055), 0.006, JET_BLACK),
        rod((-0.06, -0.13, -0.055), (-0.06, 0.13, -0.055), 0.006, JET_BLACK),
    )


def _four_wheels(
    *, base: float, track: float, size: tuple[float, float], down: float, mass: float, motor: Motor
) -> tuple[Part, ...]:
    """Return wheels with their axles `down` below the origin."""
    return tuple(
        wheel(name, at=(x, y, down), size=size, mass=mass, motor=motor)
        for names, y in ((LEFT_WHEELS, -track / 2), (RIGHT_WHEELS, track / 2))
        for name, x in zip(names, (base / 2, -base / 2), strict=True)
    )


# ATRVJr

ATRV_LENGTH, ATRV_WIDTH, ATRV_HEIGHT = 0.7744, 0.6318, 0.5754  # manual 9.3's GEO
ATRV_WHEEL, ATRV_TRACK, ATRV_BASE = 0.1922, 0.5120, 0.3880  # manual 9.3's GEO
ATRV_TYRE = ATRV_WIDTH - ATRV_TRACK  # the tyres' outer faces are the width
ATRV_ORIGIN = 0.39  # manual 5.3.6
ATRV_WHEEL_MASS = 2.0  # chosen
ATRV_TOP = ATRV_ORIGIN - ATRV_HEIGHT  # z of the deck
ATRV_SCANNER = (0.25, 0.0, ATRV_TOP - 0.06)  # chosen: at the front of the deck
ATRV_MOTOR = firm_motor(
    max_speed=1.0 / ATRV_WHEEL,  # manual 12.4.1: 1.0 m/s; the 2.0943 in 9.3's CONF are its 120 degrees/s
    torque=20.0,  # chosen, as the P2AT's: about what a tyre can put on the ground
    inertia=ATRV_WHEEL_MASS * ATRV_WHEEL**2 / 2,
    armature=1.2,  # chosen, in proportion the P2AT's: with less, wheels skid sideways and turn it slowly
)
# x [mm], y [mm], yaw [degrees] of the sonars S1..S17 (manual 12.4.1).
ATRV_SONARS = (
    (334.95, -104.39, -30),
    (340.41, -49.91, -15),
    (347.06, 0, 0),
    (340.41, 49.91, 15),
    (334.95, 104.39, 30),
    (230.23, 175, 45),
    (172.49, 178.6, 60),
    (117.2, 181.1, 75),
    (72.26, 181.1, 90),
    (-295.17, 181.1, 90),
    (-347.06, 150.36, 180),
    (-347.06, -150.36, -180),
    (-295.17, -181.1, -90),
    (72.26, -181.1, -90),
    (117.2, -181.1, -75),
    (172.49, -178.6, -60),
    (230.23, -175, -45),
)

ATRV_RING = tuple(
    Mount(
        kind="Sonar",
        name=f"S{i}",
        at=(x / 1000, y / 1000, 0.0),
        direction=(0.0, 0.0, math.radians(yaw)),
        defaults=LEVEL_SONAR,
    )
    for i, (x, y, yaw) in enumerate(ATRV_SONARS, start=1)
)

ATRVJR = RobotSpec(
    name="ATRVJr",
    dimensions=(ATRV_LENGTH, ATRV_WIDTH, ATRV_HEIGHT),
    mass=50.0,  # manual 12.4.1
    payload=25.0,
    origin_height=ATRV_ORIGIN,
    chassis=(
        # Between the wheels, reaching just past them, with all mass that is not wheels and camera (chosen:
        # batteries lie low, though 9.3's COG is 0.1 m above the origin).
        Shape(
            kind="box",
            size=(ATRV_LENGTH / 2, 0.19, 0.11),
            at=(0.0, 0.0, ATRV_ORIGIN - 0.20),
            mass=50.0 - 4 * ATRV_WHEEL_MASS - 0.5,
            rgba=GREEN,
        ),
        # Over the wheels, up to the deck.
        Shape(
            kind="box",
            size=(ATRV_LENGTH / 2, ATRV_WIDTH / 2, (ATRV_HEIGHT - 0.40) / 2),
            at=(0.0, 0.0, ATRV_TOP + (ATRV_HEIGHT - 0.40) / 2),
            rgba=GREEN,
        ),
        sick_housing(ATRV_SCANNER),
    ),
    looks=atrv_visuals(ATRV_RING, ATRV_SCANNER, ATRV_TOP, GREEN),
    parts=_four_wheels(
        base=ATRV_BASE,
        track=ATRV_TRACK,
        size=(ATRV_WHEEL, ATRV_TYRE),
        down=ATRV_ORIGIN - ATRV_WHEEL,
        mass=ATRV_WHEEL_MASS,
        motor=ATRV_MOTOR,
    ),
    drive=SkidSteer(
        left=LEFT_WHEELS,
        right=RIGHT_WHEELS,
        max_spin=ATRV_MOTOR.max_speed,
        radius=ATRV_WHEEL,
        max_turn=math.radians(120),  # manual 12.4
        lever=0.98,  # measured here: it turns at 117 deg/s at full speed
    ),
    packages=(pan_tilt((0.23, 0.0, ATRV_SCANNER[2] - 0.11)),),  # chosen: on the scanner, as on the P2AT
    sensors=(
        *ATRV_RING,
        sick_lms200(ATRV_SCANNER),
        *POSE_SENSORS,
    ),
    cameras=(camera(),),
    wheel_radius=ATRV_WHEEL,
    wheel_separation=ATRV_TRACK,
    wheel_base=ATRV_BASE,
    sources=(
        ("dimensions, wheels", "manual 9.3"),
        ("mass, payload, top speed, sonars", "manual 12.4"),
        ("origin height", "manual 5.3.6"),
        ("layout, mass distribution, Odometry, INS, GroundTruth", "chosen"),
    ),
)

# Zerg

ZERG_LENGTH, ZERG_WIDTH, ZERG_HEIGHT = 0.3112, 0.4154, 0.1211  # manual 12.11.1
ZERG_WHEEL = 0.0606  # manual 12.11.1; its height is that of the wheels
ZERG_TYRE = 0.05  # chosen
ZERG_TRACK, ZERG_BASE = ZERG_WIDTH - ZERG_TYRE, ZERG_LENGTH - 2 * ZERG_WHEEL
ZERG_ORIGIN = 0.06  # manual 5.3.6
ZERG_MASS, ZERG_WHEEL_MASS = 6.0, 0.3  # chosen
ZERG_MOTOR = firm_motor(
    max_speed=6.2832,  # manual 12.11.1
    torque=0.8,  # chosen, as the ATRVJr's
    inertia=ZERG_WHEEL_MASS * ZERG_WHEEL**2 / 2,
    armature=0.014,  # chosen, as the ATRVJr's
)

ZERG = RobotSpec(
    name="Zerg",
    dimensions=(ZERG_LENGTH, ZERG_WIDTH, ZERG_HEIGHT),
    mass=ZERG_MASS,
    origin_height=ZERG_ORIGIN,
    chassis=(
        Shape(
            kind="box",
            size=(ZERG_LENGTH / 2, 0.15, 0.03),
            mass=ZERG_MASS - 4 * ZERG_WHEEL_MASS - 0.5,
            rgba=YELLOW,
        ),
        # A roll bar between the wheels, as high as they are, which gives the manual's height.
        Shape(
            kind="box", size=(0.02, 0.15, 0.03), at=(-0.05, 0.0, ZERG_ORIGIN - ZERG_HEIGHT + 0.03), rgba=BLACK
        ),
    ),
    looks=zerg_visuals(ZERG_LENGTH, YELLOW),
    parts=_four_wheels(
        base=ZERG_BASE,
        track=ZERG_TRACK,
        size=(ZERG_WHEEL, ZERG_TYRE),
        down=ZERG_ORIGIN - ZERG_WHEEL,
        mass=ZERG_WHEEL_MASS,
        motor=ZERG_MOTOR,
    ),
    drive=SkidSteer(left=LEFT_WHEELS, right=RIGHT_WHEELS, max_spin=ZERG_MOTOR.max_speed, radius=ZERG_WHEEL),
    packages=(pan_tilt((0.05, 0.0, -0.03)),),  # chosen
    sensors=POSE_SENSORS,
    cameras=(camera(),),
    wheel_radius=ZERG_WHEEL,
    wheel_separation=ZERG_TRACK,
    wheel_base=ZERG_BASE,
    sources=(
        ("dimensions, wheel radius, top speed, camera", "manual 12.11"),
        ("origin height", "manual 5.3.6"),
        ("mass, tyre width, layout, Odometry, INS, GroundTruth", "chosen"),
    ),
)
