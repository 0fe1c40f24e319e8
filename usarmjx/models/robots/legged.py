"""The legged robots QRIO and ERS, Sony's humanoid and its AIBO (manual 12.13, 12.14).

The manual counts their joints and gives the size of the ERS, and no more; joint names are chosen. All
joints are at 0 when the robot stands. Signs, the same on both sides of a robot: pitch joints, rotators and
tilts lift forward or up; rolls and elevators go outward; hip yaws turn the toes outward; knees and elbows
bend; pans turn to the left.
"""

import math
from dataclasses import replace

from usarmjx.base.transforms import Vec3
from usarmjx.models.drives import NoDrive
from usarmjx.models.robots.kit import (
    ACROSS,
    ALONG,
    BLACK,
    DARK,
    GLASS_BLACK,
    JET_BLACK,
    POSE_SENSORS,
    RUBBER,
    SILVER,
    STEEL,
    ball,
    block,
    camera,
    drum,
    rod,
)
from usarmjx.models.types.robot import CHASSIS, UP, Motor, Mount, Part, RobotSpec, options
from usarmjx.models.types.shapes import Rgba, Shape

PEARL: Rgba = (0.92, 0.92, 0.9, 1.0)
BLUE: Rgba = (0.25, 0.5, 0.95, 1.0)
PINK: Rgba = (0.85, 0.35, 0.5, 1.0)
NAVY: Rgba = (0.16, 0.22, 0.42, 1.0)

ERS_BODY_VISUALS = (
    ball((0.115, 0.052, 0.045), (-0.005, 0.0, -0.008), PEARL),
    ball((0.05, 0.055, 0.05), (0.06, 0.0, -0.012), PEARL),  # its chest
    ball((0.045, 0.052, 0.042), (-0.075, 0.0, -0.006), PEARL),
    block((0.05, 0.018, 0.004), (-0.005, 0.0, -0.052), BLUE),  # the switches on its back
    ball((0.03, 0.04, 0.025), (0.085, 0.0, 0.008), DARK),
    rod((-0.105, 0.0, -0.03), (-0.165, 0.0, -0.085), 0.006, PEARL),
    ball((0.009, 0.009, 0.009), (-0.167, 0.0, -0.087), JET_BLACK),
)
ERS_NECK = (rod((0.0, 0.0, -0.01), (0.0, 0.0, -0.07), 0.017, DARK),)
ERS_COLLAR = (drum(0.024, 0.008, (0.0, 0.0, 0.012), DARK), ball((0.02, 0.02, 0.02), rgba=STEEL))
ERS_HEAD = (
    ball((0.055, 0.046, 0.042), (0.0, 0.0, -0.012), PEARL),
    ball((0.042, 0.036, 0.026), (0.045, 0.0, 0.004), PEARL),  # muzzle
    ball((0.03, 0.041, 0.018), (0.036, 0.0, -0.022), GLASS_BLACK),  # the visor of its face
    *(ball((0.004, 0.006, 0.006), (0.064, y, -0.022), BLUE) for y in (-0.016, 0.016)),
    ball((0.008, 0.012, 0.007), (0.085, 0.0, -0.006), JET_BLACK),  # nose
    drum(0.007, 0.003, (0.083, 0.0, 0.0146), JET_BLACK, ALONG),  # and camera
    ball((0.02, 0.022, 0.005), (0.05, 0.0, 0.026), PINK),
    *(
        ball((0.02, 0.009, 0.038), (-0.012, y, 0.006), DARK, (0.25 * y / 0.05, 0.15, 0.0))
        for y in (-0.05, 0.05)
    ),
    ball((0.02, 0.014, 0.006), (-0.01, 0.0, -0.053), BLUE),
)


def ers_thigh(length: float) -> tuple[Shape, ...]:
    """Return the upper half of a leg, down from the shoulder."""
    return (
        ball((0.025, 0.02, 0.58 * length), (0.0, 0.0, 0.42 * length), PEARL),
        drum(0.022, 0.022, rgba=DARK, rotation=ACROSS),
        drum(0.014, 0.024, rgba=SILVER, rotation=ACROSS),
    )


def ers_shin(length: float, paw: float) -> tuple[Shape, ...]:
    """Return the lower half of a leg with its paw."""
    return (
        drum(0.014, 0.019, rgba=DARK, rotation=ACROSS),
        ball((0.015, 0.016, 0.55 * length), (0.0, 0.0, 0.45 * length), PEARL),
        ball((0.017, 0.018, paw), (0.003, 0.0, length), DARK),
        *(ball((0.008, 0.006, 0.007), (0.016, y, length + 0.003), PEARL) for y in (-0.009, 0.0, 0.009)),
    )


QRIO_PELVIS = (
    ball((0.05, 0.068, 0.04), (0.0, 0.0, -0.005), SILVER),
    block((0.046, 0.05, 0.01), (0.0, 0.0, -0.03), DARK),
)
QRIO_WAIST = (drum(0.034, 0.02, rgba=DARK),)
QRIO_TORSO_VISUALS = (
    ball((0.075, 0.082, 0.085), (-0.018, 0.0, -0.075), SILVER),
    block((0.02, 0.045, 0.035), (0.035, 0.0, -0.085), NAVY),
    drum(0.012, 0.004, (0.057, 0.0, -0.085), BLUE, ALONG),
    block((0.03, 0.055, 0.05), (-0.075, 0.0, -0.08), DARK),  # its backpack
    drum(0.024, 0.1, (0.0, 0.0, -0.12), DARK, ACROSS),  # shoulders
)
QRIO_NECK = (drum(0.02, 0.016, rgba=DARK),)
QRIO_HEAD_VISUALS = (
    ball((0.062, 0.07, 0.058), (0.0, 0.0, -0.06), SILVER),
    ball((0.03, 0.055, 0.032), (0.038, 0.0, -0.06), GLASS_BLACK),
    *(ball((0.006, 0.012, 0.012), (0.064, y, -0.064), BLUE) for y in (-0.024, 0.024)),
    *(drum(0.022, 0.008, (0.0, y, -0.06), NAVY, ACROSS) for y in (-0.068, 0.068)),
    ball((0.035, 0.03, 0.01), (-0.005, 0.0, -0.113), NAVY),
)


def qrio_limb(length: float, radius: float, rgba: Rgba = SILVER) -> tuple[Shape, ...]:
    """Return a limb that extends down from its joint."""
    return (
        ball((radius, 0.95 * radius, 0.6 * length), (0.0, 0.0, 0.5 * length), rgba),
        drum(0.7 * radius, 0.98 * radius, rgba=DARK, rotation=ACROSS),
    )


def qrio_forearm(length: float) -> tuple[Shape, ...]:
    """Return a forearm with a hand of three fingers."""
    return (
        *qrio_limb(0.7 * length, 0.022),
        ball((0.014, 0.01, 0.018), (0.0, 0.0, 0.8 * length), DARK),
        *(
            rod((x, 0.0, 0.85 * length), (1.2 * x, 0.0, 1.02 * length), 0.005, STEEL)
            for x in (-0.01, 0.0, 0.01)
        ),
    )


def qrio_foot(sole: float) -> tuple[Shape, ...]:
    """Return a foot; `sole` is the depth of its end below the ankle."""
    return (
        block((0.08, 0.035, 0.005), (0.02, 0.0, sole - 0.005), DARK),
        ball((0.076, 0.034, 0.026), (0.02, 0.0, sole - 0.01), SILVER),
        ball((0.026, 0.026, 0.026), rgba=DARK),
        ball((0.02, 0.03, 0.015), (0.07, 0.0, sole - 0.012), NAVY, (0.0, math.pi / 12, 0.0)),
    )


SILVER_SHELL: Rgba = (0.7, 0.72, 0.75, 1.0)
LIFT: Vec3 = (0.0, 1.0, 0.0)
"""Axis to the right, about which a limb swings forward."""
BEND: Vec3 = (0.0, -1.0, 0.0)
"""Axis to the left, about which a limb swings backward."""
POSES = tuple(sensor for sensor in POSE_SENSORS if sensor.kind != "Odometry")  # there are no wheels to count


def _out(y: float) -> Vec3:
    """Return the axis about which a limb on the side of `y` turns outward."""
    return (-math.copysign(1.0, y), 0.0, 0.0)


def _toes_out(y: float) -> Vec3:
    return (0.0, 0.0, math.copysign(1.0, y))


def _range(low: float, high: float, rest: float = 0.0) -> tuple[float, float]:
    """Return a range [rad] from one in degrees, relative to the joint's rest angle [rad]."""
    return (math.radians(low) - rest, math.radians(high) - rest)


def _box(size: Vec3, mass: float, at: Vec3 = (0.0, 0.0, 0.0), surface: str = "hull") -> Shape:
    x, y, z = size
    rgba = BLACK if surface == "fixture" else SILVER_SHELL
    return Shape(kind="box", size=(x / 2, y / 2, z / 2), at=at, mass=mass, surface=surface, rgba=rgba)


def _gear(radius: float, mass: float) -> Shape:
    """Return the servo of a joint at the same point as the next one: visible, without contacts."""
    return Shape(kind="sphere", size=(radius,), mass=mass, surface="fixture", rgba=BLACK)


# ERS: the manual's size and mass are those of the ERS-7.

ERS_HIP = (0.065, 0.0625)  # half the distances of the shoulders; the width (0.125) from the data sheet
ERS_UPPER, ERS_PAW = 0.0695, 0.012  # data sheet; chosen radius
ERS_LOWER = {"F": 0.0715, "R": 0.0765}  # knee to the end of the paw (front: data sheet; rear: chosen)
ERS_STAND = 0.117  # shoulder above the paw's centre (chosen: knees bent by some 50 degrees)
ERS_BODY = 1.6 - 4 * 0.14 - 0.28  # the manual's mass less legs and head

# Speeds and ranges: Sony's recommended values for the ERS-7. Torques, gains and inertia are chosen: to stand
# takes a tenth of the torque, and the knees give by 0.2 degrees.
ERS_SERVO = {"torque": 1.5, "stiffness": 30.0, "damping": 0.5, "armature": 0.004}
ERS_ROTATOR = Motor(max_speed=4.865, **ERS_SERVO)
ERS_KNEE = Motor(max_speed=5.280, **ERS_SERVO)  # elevators are as fast
ERS_ROTATOR_RANGE = {"F": (-115.0, 130.0), "R": (-130.0, 115.0)}


def _ers_rest(end: str) -> tuple[float, float]:
    """Return the angles of shoulder and knee that put the paw below the shoulder, by the law of cosines."""
    upper, lower, reach = ERS_UPPER, ERS_LOWER[end] - ERS_PAW, ERS_STAND
    shoulder = math.acos((reach**2 + upper**2 - lower**2) / (2 * reach * upper))
    knee = math.pi - math.acos((upper**2 + lower**2 - reach**2) / (2 * upper * lower))
    return shoulder, knee


def _ers_leg(side: str, end: str) -> tuple[Part, Part, Part]:
    """Return a leg; front knees point backward, rear knees forward, as a dog's."""
    x, y = ERS_HIP[0] * (1 if end == "F" else -1), ERS_HIP[1] * (1 if side == "Right" else -1)
    forward = 1 if end == "F" else -1  # where the paw goes when the knee bends
    shoulder, knee = _ers_rest(end)
    shin = ERS_LOWER[end] - ERS_PAW
    name = f"{side}{end}"
    paw = Shape(kind="sphere", size=(ERS_PAW,), at=(0.0, 0.0, shin), mass=0.015, surface="wheel", rgba=RUBBER)
    # Pitch is positive up, so a hanging limb with a positive pitch points forward.
    rotator = Part(
        name=f"{name}Rotator",
        at=(x, y, 0.0),
        # The joint is at 0 while the robot stands: limits count from there.
        rotation=(0.0, -forward * shoulder, 0.0),
        axis=LIFT,
        motor=ERS_ROTATOR,
        limits=_range(*ERS_ROTATOR_RANGE[end], rest=-forward * shoulder),
        shapes=(_gear(0.022, 0.05),),
    )
    elevator = Part(
        name=f"{name}Elevator",
        parent=rotator.name,
        axis=_out(y),
        motor=ERS_KNEE,
        limits=_range(-10.0, 88.0),
        shapes=(_box((0.04, 0.055, ERS_UPPER), 0.05, (0.0, 0.0, ERS_UPPER / 2), "fixture"),),
        looks=ers_thigh(ERS_UPPER),
    )
    lower = Part(
        name=f"{name}Knee",
        parent=elevator.name,
        at=(0.0, 0.0, ERS_UPPER),
        rotation=(0.0, forward * knee, 0.0),
        axis=LIFT if end == "F" else BEND,
        motor=ERS_KNEE,
        limits=_range(-25.0, 122.0, rest=knee),
        shapes=(_box((0.022, 0.03, shin), 0.025, (0.0, 0.0, shin / 2)), paw),
        looks=ers_shin(shin, ERS_PAW),
    )
    return rotator, elevator, lower


def _ers_paw_button(side: str, end: str) -> Mount:
    """Return the paw sensor, which points straight down while the robot stands."""
    shoulder, knee = _ers_rest(end)
    # The shin's angle against the vertical, by which the sensor turns back.
    lean = (knee - shoulder) * (1 if end == "F" else -1)
    shin = ERS_LOWER[end] - ERS_PAW
    at = (-ERS_PAW * math.sin(lean), 0.0, shin + ERS_PAW * math.cos(lean))
    return Mount(
        kind="Touch",
        name=f"Paw{side}{end}",
        parent=f"{side}{end}Knee",
        at=at,
        direction=(0.0, -math.pi / 2 - lean, 0.0),
    )


ERS_LEGS = tuple((side, end) for end in "FR" for side in ("Left", "Right"))
ERS_MUZZLE = (0.081, 0.0, 0.0146)  # camera on the nodding part: the height from the data sheet


def _ers_infrared(name: str, reach: tuple[float, float]) -> Mount:
    near, far = options(MinRange=reach[0]), options(MaxRange=reach[1])
    return Mount(kind="IR", name=name, parent="HeadNod", at=ERS_MUZZLE, defaults=(*near, *far))


ERS = RobotSpec(
    name="ERS",
    dimensions=(0.3190, 0.1800, 0.2780),  # manual 12.14 and its GEO example
    mass=1.6,
    origin_height=ERS_STAND + ERS_PAW,
    chassis=(
        _box((0.21, 0.10, 0.085), ERS_BODY, (-0.005, 0.0, -0.005)),
        _box((0.054, 0.012, 0.012), 0.0, (-0.137, 0.0, -0.035), "fixture"),  # tail
    ),
    looks=ERS_BODY_VISUALS,
    parts=(
        *(part for side, end in ERS_LEGS for part in _ers_leg(side, end)),
        Part(
            name="HeadTilt",
            at=(0.0675, 0.0, -0.0195),  # chosen, as the length of the neck, to give the manual's height
            axis=LIFT,
            motor=Motor(max_speed=3.185, **ERS_SERVO),
            limits=_range(-75.0, 0.0),
            shapes=(_box((0.03, 0.03, 0.06), 0.04, (0.0, 0.0, -0.04), "fixture"),),
            looks=ERS_NECK,
        ),
        Part(
            name="HeadPan",
            parent="HeadTilt",
            at=(0.0, 0.0, -0.08),
            axis=UP,
            motor=Motor(max_speed=10.057, **ERS_SERVO),
            limits=_range(-88.0, 88.0),
            shapes=(_gear(0.02, 0.04),),
            looks=ERS_COLLAR,
        ),
        Part(
            name="HeadNod",
            parent="HeadPan",
            axis=LIFT,
            motor=Motor(max_speed=5.781, **ERS_SERVO),
            limits=_range(-15.0, 45.0),
            shapes=(_box((0.125, 0.085, 0.08), 0.20, (0.025, 0.0, -0.009)),),
            looks=ERS_HEAD,
        ),
    ),
    drive=NoDrive(kind="LeggedRobot", steering_type="FourLegs"),
    sensors=(
        *(_ers_paw_button(side, end) for side, end in ERS_LEGS),
        _ers_infrared("IRNear", (0.05, 0.50)),
        _ers_infrared("IRFar", (0.20, 1.50)),
        *POSES,
    ),
    cameras=(camera(at=ERS_MUZZLE, parent="HeadNod"),),
    battery_life=3600.0,
    sources=(
        ("dimensions", "manual 12.14"),
        ("mass", "manual 12.14"),
        ("layout", "manual 12.14"),
        ("lengths of upper legs and front paws", "data sheet"),
        ("joint ranges and speeds", "data sheet"),
        ("infrared ranges", "data sheet"),
        ("battery_life", "manual 12.1"),
        ("origin_height", "chosen"),
        ("joint names", "chosen"),
        ("torques", "chosen"),
        ("masses and other lengths of parts", "chosen"),
    ),
)

# QRIO: Sony gives height, width, depth and mass of the whole; its proportions here are chosen, as are all
# figures of its servos. One foot's length resists tipping with 4 N m, which two ankles exert easily.

QRIO_HIP, QRIO_ANKLE, QRIO_SHIN, QRIO_THIGH = 0.04, 0.045, 0.10, 0.105
QRIO_LEG = Motor(max_speed=6.0, torque=12.0, stiffness=300.0, damping=8.0, armature=0.05)
QRIO_ARM = Motor(max_speed=6.0, torque=3.0, stiffness=40.0, damping=1.2, armature=0.008)


def _qrio_part(
    name: str,
    parent: str,
    axis: Vec3,
    limits: tuple[float, float],
    shape: Shape,
    at: Vec3 = (0.0, 0.0, 0.0),
    motor: Motor = QRIO_LEG,
) -> Part:
    return Part(
        name=name, parent=parent, at=at, axis=axis, motor=motor, limits=_range(*limits), shapes=(shape,)
    )


def _qrio_leg(side: str, y: float) -> tuple[Part, ...]:
    yaw, roll, pitch = (f"{side}Hip{joint}" for joint in ("Yaw", "Roll", "Pitch"))
    knee, ankle = f"{side}Knee", f"{side}AnklePitch"
    gear = _gear(0.02, 0.10)
    thigh = _box((0.06, 0.06, 0.09), 0.45, (0.0, 0.0, QRIO_THIGH / 2), "fixture")
    shin = _box((0.055, 0.055, 0.09), 0.40, (0.0, 0.0, QRIO_SHIN / 2))
    foot = _box((0.16, 0.07, 0.02), 0.25, (0.02, 0.0, QRIO_ANKLE - 0.01))
    return (
        _qrio_part(yaw, CHASSIS, _toes_out(y), (-30, 45), gear, (0.0, y, 0.0)),
        _qrio_part(roll, yaw, _out(y), (-20, 40), gear),
        _qrio_part(pitch, roll, LIFT, (-30, 90), thigh),
        _qrio_part(knee, pitch, BEND, (0, 120), shin, (0.0, 0.0, QRIO_THIGH)),
        _qrio_part(ankle, knee, LIFT, (-45, 60), _gear(0.02, 0.05), (0.0, 0.0, QRIO_SHIN)),
        _qrio_part(f"{side}AnkleRoll", ankle, _out(y), (-25, 25), foot),
    )


def _qrio_arm(side: str, y: float) -> tuple[Part, ...]:
    upper = _box((0.05, 0.05, 0.09), 0.20, (0.0, 0.0, 0.045), "fixture")
    lower = _box((0.045, 0.045, 0.11), 0.20, (0.0, 0.0, 0.055))
    pitch, roll, elbow = (f"{side}{joint}" for joint in ("ShoulderPitch", "ShoulderRoll", "Elbow"))
    gear = _gear(0.025, 0.10)
    return (
        _qrio_part(pitch, "BodyTilt", LIFT, (-90, 180), gear, (0.0, y, -0.12), QRIO_ARM),
        _qrio_part(roll, pitch, _out(y), (-10, 150), upper, motor=QRIO_ARM),
        _qrio_part(elbow, roll, LIFT, (0, 130), lower, (0.0, 0.0, 0.09), QRIO_ARM),
    )


QRIO_VISUALS = {
    "HipPitch": qrio_limb(QRIO_THIGH, 0.034),
    "Knee": qrio_limb(QRIO_SHIN, 0.03, NAVY),
    "AnkleRoll": qrio_foot(QRIO_ANKLE),
    "BodyPan": QRIO_WAIST,
    "BodyTilt": QRIO_TORSO_VISUALS,
    "ShoulderRoll": qrio_limb(0.09, 0.025),
    "Elbow": qrio_forearm(0.12),
    "HeadPan": QRIO_NECK,
    "HeadTilt": QRIO_HEAD_VISUALS,
}
"""Visuals by the name of the joint, without its side."""


def _qrio_visuals(name: str) -> tuple[Shape, ...]:
    return QRIO_VISUALS.get(name.removeprefix("Left").removeprefix("Right"), ())


QRIO_TORSO = _box((0.14, 0.15, 0.14), 1.95, (-0.02, 0.0, -0.07))
QRIO_HEAD = _box((0.12, 0.14, 0.115), 0.60, (0.0, 0.0, -0.0575))

QRIO = RobotSpec(
    name="QRIO",
    dimensions=(0.19, 0.26, 0.58),  # data sheet
    mass=7.0,  # data sheet; the 50 of the manual's CONF example is also the ATRVJr's
    origin_height=QRIO_ANKLE + QRIO_SHIN + QRIO_THIGH,
    chassis=(_box((0.09, 0.13, 0.07), 0.60, (0.0, 0.0, -0.005)),),
    looks=QRIO_PELVIS,
    parts=tuple(
        replace(part, looks=_qrio_visuals(part.name))
        for part in (
            *_qrio_leg("Left", -QRIO_HIP),
            *_qrio_leg("Right", QRIO_HIP),
            _qrio_part("BodyPan", CHASSIS, UP, (-60, 60), _gear(0.03, 0.10), (0.0, 0.0, -0.05)),
            _qrio_part("BodyTilt", "BodyPan", LIFT, (-45, 20), QRIO_TORSO),
            *_qrio_arm("Left", -0.105),
            *_qrio_arm("Right", 0.105),
            _qrio_part("HeadPan", "BodyTilt", UP, (-90, 90), _gear(0.02, 0.05), (0.0, 0.0, -0.15), QRIO_ARM),
            _qrio_part("HeadTilt", "HeadPan", LIFT, (-40, 40), QRIO_HEAD, (0.0, 0.0, -0.015), QRIO_ARM),
        )
    ),
    drive=NoDrive(kind="LeggedRobot", steering_type="TwoLegs"),
    sensors=POSES,
    cameras=(camera(at=(0.06, 0.0, -0.06), parent="HeadTilt"),),
    battery_life=3600.0,
    sources=(
        ("dimensions", "data sheet"),
        ("mass", "data sheet"),
        ("layout", "manual 12.13"),
        ("battery_life", "manual 12.1"),
        ("proportions", "chosen"),
        ("origin_height", "chosen"),
        ("joint names, ranges, speeds and torques", "chosen"),
        ("masses of parts", "chosen"),
    ),
)
