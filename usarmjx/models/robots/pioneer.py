"""The Pioneer robots P2AT and P2DX, also with omnidirectional cameras (manual 12.1, 12.3).

Sources, best first: messages captured from a UT2004 server (NIST MOAST's `usarsiminf.c`), the manual,
UsarCommander's copy of USARBot.ini (sonar rings), and choices, marked so.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from usarmjx.base.transforms import Vec3
from usarmjx.models.drives import SkidSteer, YieldingSkidSteer
from usarmjx.models.robots.kit import (
    BLACK,
    DARK,
    ENCODER_AXIS,
    JET_BLACK,
    LEVEL_SONAR,
    POSE_SENSORS,
    STEEL,
    ball,
    block,
    camera,
    drum,
    pan_tilt,
    rod,
    sick,
    sick_housing,
    sick_lms200,
    sonar_discs,
    wheel,
    wheel_visuals,
)
from usarmjx.models.robots.packages import PACKAGES, mount_package
from usarmjx.models.types.robot import MissionPackage, Motor, Mount, RobotSpec
from usarmjx.models.types.shapes import Rgba, Shape

RED: Rgba = (0.78, 0.1, 0.1, 1.0)


def _discs(sonars: Sequence[Mount], push: float) -> tuple[Shape, ...]:
    return sonar_discs([(mount.at, mount.direction[2]) for mount in sonars], push)


def p2at_visuals(
    sonars: Sequence[Mount], scanner: tuple[float, float, float], rgba: Rgba
) -> tuple[Shape, ...]:
    """Return a P2AT without its wheels and its camera."""
    rings = (drum(0.148, 0.021, (x, 0.0, 0.0), JET_BLACK) for x in (0.10, -0.10))
    return (
        block((0.262, 0.18, 0.04), (0.0, 0.0, 0.07), rgba),
        block((0.23, 0.165, 0.03), (0.0, 0.0, 0.125), rgba),
        block((0.275, 0.15, 0.02), (0.0, 0.0, 0.095), JET_BLACK),  # bumpers
        *rings,
        *_discs(sonars, 0.012),
        block((0.258, 0.2, 0.003), (0.0, 0.0, -0.0223), rgba),
        block((0.245, 0.187, 0.003), (0.0, 0.0, -0.0283), JET_BLACK),
        block((0.06, 0.06, 0.006), (scanner[0], 0.0, -0.0365), DARK),
        *sick(scanner),
        block((0.05, 0.07, 0.012), (-0.12, 0.0, -0.043), DARK),  # its radio, and the antenna
        rod((-0.16, 0.05, -0.04), (-0.16, 0.05, -0.24), 0.004, JET_BLACK),
    )


def p2at_wheel_visuals(y: float, radius: float, width: float) -> tuple[Shape, ...]:
    """Return a tyre as wide inward as the real one, on the side of `y`."""
    wide = 0.055
    return wheel_visuals(radius, wide, rim=0.5, shift=-math.copysign((wide - width) / 2, y), bars=2)


def p2dx_visuals(
    sonars: Sequence[Mount], scanner: tuple[float, float, float], rgba: Rgba
) -> tuple[Shape, ...]:
    """Return a P2DX without its wheels and its camera."""
    return (
        block((0.06, 0.145, 0.06), (-0.02, 0.0, 0.08), rgba),
        drum(0.145, 0.06, (0.045, 0.0, 0.08), rgba),
        drum(0.145, 0.06, (-0.075, 0.0, 0.08), rgba),
        drum(0.15, 0.02, (0.066, 0.0, 0.0), JET_BLACK),
        *_discs(sonars, 0.012),
        *(drum(0.165, 0.005, (x, 0.0, -0.015), rgba) for x in (0.055, -0.055)),
        block((0.055, 0.165, 0.005), (0.0, 0.0, -0.015), rgba),
        block((0.1, 0.12, 0.003), (-0.03, 0.0, -0.021), JET_BLACK),
        ball((0.0375, 0.0375, 0.0375), (-0.16, 0.0, 0.1625), JET_BLACK),
        drum(0.02, 0.03, (-0.16, 0.0, 0.135), STEEL),
        block((0.06, 0.06, 0.018), (scanner[0], 0.0, scanner[2] + 0.068), DARK),
        *sick(scanner),
    )


# Side sonars of a front ring: y and yaw, from right to left seen from above (manual 12.1.1, degrees
# there; F1 looks left). x differs between the robots.
RING_Y = (-0.13, -0.115, -0.08, -0.025, 0.025, 0.08, 0.115, 0.13)
RING_YAW = tuple(math.radians(a) for a in (-90, -50, -30, -10, 10, 30, 50, 90))
P2AT_RING_X = (0.145, 0.185, 0.22, 0.24, 0.24, 0.22, 0.185, 0.145)
P2DX_RING_X = (0.115, 0.155, 0.19, 0.21, 0.21, 0.19, 0.155, 0.115)


def _front_ring(xs: tuple[float, ...]) -> tuple[Mount, ...]:
    return tuple(
        Mount(kind="Sonar", name=f"F{i}", at=(x, y, 0.0), direction=(0.0, 0.0, yaw), defaults=LEVEL_SONAR)
        for i, (x, y, yaw) in enumerate(zip(xs, RING_Y, RING_YAW, strict=True), start=1)
    )


def _rear_ring(xs: tuple[float, ...]) -> tuple[Mount, ...]:
    """Return the front ring turned by half a turn about the vertical: R1 is opposite F1."""
    return tuple(
        Mount(
            kind="Sonar",
            name=f"R{i}",
            at=(-x, -y, 0.0),
            direction=(0.0, 0.0, yaw + math.pi if yaw <= 0 else yaw - math.pi),
            defaults=LEVEL_SONAR,
        )
        for i, (x, y, yaw) in enumerate(zip(xs, RING_Y, RING_YAW, strict=True), start=1)
    )


P2AT_WHEEL = 0.1300  # captured GEO; the real tyre has 0.11
P2AT_TRACK, P2AT_BASE = 0.4712, 0.2884  # captured GEO
P2AT_WIDTH = 0.4968  # captured GEO; the tyres' outer faces, which gives their width
P2AT_SCANNER = (0.1439, 0.0, -0.0920)  # captured
# Captured CONF MaxSpeed: 0.7 m/s. The torque is about what a tyre can put on the ground (chosen).
P2AT_MOTOR = Motor(max_speed=5.385, torque=4.0, armature=0.15)
# Manual 12.1.1: wheels that make 0.7 m/s turn it at 140 deg/s, as wheels 0.573 m apart would without slip. In
# the real robot's software they are 0.588 m apart (2 / DiffConvFactor of ARIA's p2at.p).
P2AT_LEVER = 2 * 0.7 / math.radians(140)
P2AT_EASE = 5.5  # fitted here to the turning rate

P2AT = RobotSpec(
    name="P2AT",
    dimensions=(0.5238, P2AT_WIDTH, 0.2913),  # captured GEO
    mass=14.0,  # manual 12.1.1 and captured CONF
    payload=40.0,
    origin_height=0.26,  # manual 5.3.6
    chassis=(
        # Body between the wheels; carries all mass that is not wheels and camera (chosen: low, as the
        # batteries lie at the bottom, though the captured COG is the origin). It reaches just past the
        # tyres, so that it makes contact with walls near axle height: the tyres would climb a wall, and
        # pushing with the deck the robot would turn over backwards.
        Shape(kind="box", size=(0.276, 0.20, 0.05), at=(0.0, 0.0, 0.11), mass=9.5, rgba=RED),
        # Deck over body and wheels, up to the captured height: it makes contact with robots beside it, and
        # their sonars, 0.26 m above the ground, see it.
        Shape(kind="box", size=(0.2619, P2AT_WIDTH / 2, 0.0207), at=(0.0, 0.0, -0.0106), rgba=BLACK),
        sick_housing(P2AT_SCANNER),
    ),
    looks=p2at_visuals((*_front_ring(P2AT_RING_X), *_rear_ring(P2AT_RING_X)), P2AT_SCANNER, RED),
    parts=tuple(
        replace(
            wheel(
                name,
                at=(x, y, 0.26 - P2AT_WHEEL),
                size=(P2AT_WHEEL, P2AT_WIDTH - P2AT_TRACK),
                mass=1.0,  # chosen
                motor=P2AT_MOTOR,
            ),
            looks=p2at_wheel_visuals(y, P2AT_WHEEL, P2AT_WIDTH - P2AT_TRACK),
        )
        for name, x, y in (
            ("LeftFWheel", P2AT_BASE / 2, -P2AT_TRACK / 2),
            ("RightFWheel", P2AT_BASE / 2, P2AT_TRACK / 2),
            ("LeftRWheel", -P2AT_BASE / 2, -P2AT_TRACK / 2),
            ("RightRWheel", -P2AT_BASE / 2, P2AT_TRACK / 2),
        )
    ),
    drive=YieldingSkidSteer(
        left=("LeftFWheel", "LeftRWheel"),
        right=("RightFWheel", "RightRWheel"),
        max_spin=P2AT_MOTOR.max_speed,
        radius=P2AT_WHEEL,
        max_turn=math.radians(140),  # manual 12.1.1
        lever=P2AT_LEVER,
        ease=P2AT_EASE,
    ),
    packages=(pan_tilt((0.1239, 0.0, -0.2036)),),  # captured
    sensors=(
        *_front_ring(P2AT_RING_X),
        *_rear_ring(P2AT_RING_X),
        sick_lms200(P2AT_SCANNER),
        *POSE_SENSORS,
        Mount(kind="RFID", name="RFID"),
    ),
    cameras=(camera(),),
    wheel_radius=P2AT_WHEEL,
    wheel_separation=P2AT_TRACK,
    wheel_base=P2AT_BASE,
    battery_life=3600.0,  # manual 12.1.2
    sources=(
        ("dimensions, wheels, spin, torque, mounts", "captured"),
        ("mass, payload, battery, sonars", "manual 12.1"),
        ("origin height", "manual 5.3.6"),
        ("mass distribution, motors", "chosen"),
    ),
)

P2DX_WHEEL = 0.0825  # manual 12.3.1: diameter 16.5 cm
P2DX_TRACK = 0.38 - 0.037  # chosen: manual's width less a wheel's width
P2DX_SCANNER = (0.05, 0.0, -0.11)  # chosen: on the deck
P2DX_CASTER = 0.0375  # chosen radius
# Chosen: a torque at which neither a start nor a stop lifts the caster; at standstill more than the 1.9 N m
# with which a wheel begins to climb an edge of 2 cm.
P2DX_MOTOR = Motor(max_speed=1.8 / P2DX_WHEEL, torque=1.5, armature=0.03, stall_torque=3.0)

P2DX = RobotSpec(
    name="P2DX",
    dimensions=(0.44, 0.38, 0.22),
    mass=9.0,
    payload=20.0,
    origin_height=0.20,  # manual 5.3.6
    chassis=(
        # Its mass lies behind the axle (chosen), so that braking does not lift the caster far.
        Shape(kind="box", size=(0.17, 0.145, 0.065), at=(-0.05, 0.0, 0.085), mass=7.0, rgba=RED),
        Shape(kind="box", size=(0.22, 0.19, 0.012), at=(0.0, 0.0, -0.008), rgba=BLACK),
        Shape(
            kind="sphere",
            size=(P2DX_CASTER,),
            at=(-0.16, 0.0, 0.20 - P2DX_CASTER),
            surface="caster",
            rgba=BLACK,
        ),
        sick_housing(P2DX_SCANNER),
        # A bumper behind, low and just past the deck: it makes contact when the robot backs into a wall
        # askew. With the corner of the deck the robot pitched until its wheels left the ground.
        Shape(kind="box", size=(0.031, 0.192, 0.015), at=(-0.191, 0.0, 0.125), rgba=BLACK),
        # A rounded, smooth nose: with an edge on the floor and its tail against a wall it stayed there, as a
        # ladder does.
        Shape(
            kind="capsule",
            size=(0.015, 0.13),
            at=(0.112, 0.0, 0.14),
            rotation=(math.pi / 2, 0.0, 0.0),
            surface="caster",
            rgba=RED,
        ),
    ),
    looks=p2dx_visuals(_front_ring(P2DX_RING_X), P2DX_SCANNER, RED),
    parts=tuple(
        wheel(name, at=(0.0, y, 0.20 - P2DX_WHEEL), size=(P2DX_WHEEL, 0.037), mass=0.75, motor=P2DX_MOTOR)
        for name, y in (("LeftFWheel", -P2DX_TRACK / 2), ("RightFWheel", P2DX_TRACK / 2))
    ),
    drive=SkidSteer(
        left=("LeftFWheel",),
        right=("RightFWheel",),
        max_spin=P2DX_MOTOR.max_speed,
        radius=P2DX_WHEEL,
        max_turn=math.radians(300),  # manual 12.3.1
        lever=P2DX_TRACK,
    ),
    packages=(pan_tilt((0.05, 0.0, -0.23)),),  # chosen: on the scanner, as on the P2AT
    sensors=(
        *_front_ring(P2DX_RING_X),
        sick_lms200(P2DX_SCANNER),
        *POSE_SENSORS,
        Mount(kind="Encoder", name="ECLeft", parent="LeftFWheel", direction=ENCODER_AXIS),
        Mount(kind="Encoder", name="ECRight", parent="RightFWheel", direction=ENCODER_AXIS),
    ),
    cameras=(camera(),),
    wheel_radius=P2DX_WHEEL,
    wheel_separation=P2DX_TRACK,
    wheel_base=0.0,
    battery_life=3600.0,
    sources=(
        ("dimensions, mass, payload, wheels, top speed", "manual 12.3"),
        ("sonars", "UsarCommander"),
        ("origin height", "manual 5.3.6"),
        ("encoder directions, wheel names", "captured"),
        ("track, caster, scanner and camera mounts, motors", "chosen"),
    ),
)


MIRROR_DIRECTION: Vec3 = (-3.1415927, 1.5707964, 0.0)
"""Direction of a camera towards the mirror above it (manual 10.15.2: Y=1.5707964, Z=-3.1415927)."""
ORANGE: Rgba = (0.88, 0.36, 0.08, 1.0)
OMNI_BASE_Z = -0.11
"""Height of the base on the scanner's housing [m] (chosen)."""


def _omni(
    base: RobotSpec, package: MissionPackage, link: int, at: Vec3, looks: tuple[Shape, ...]
) -> RobotSpec:
    pillar = mount_package(package, (at[0], at[1], at[2] + OMNI_BASE_Z))
    eye = camera(at=(0.0, 0.0, -0.09), parent=f"{package.name}_Link{link}", direction=MIRROR_DIRECTION)
    return replace(
        base,
        name=f"Omni{base.name}",
        looks=looks,
        packages=(pillar,),
        cameras=(eye,),
        sources=(*base.sources, ("camera", "chosen")),
    )


def _sonars(robot: RobotSpec) -> list[Mount]:
    return [mount for mount in robot.sensors if mount.kind == "Sonar"]


OMNI_P2AT = _omni(
    P2AT, PACKAGES.get("OmniCamPillar"), 4, P2AT_SCANNER, p2at_visuals(_sonars(P2AT), P2AT_SCANNER, ORANGE)
)
OMNI_P2DX = _omni(
    P2DX, PACKAGES.get("OmniCamera"), 1, P2DX_SCANNER, p2dx_visuals(_sonars(P2DX), P2DX_SCANNER, ORANGE)
)
