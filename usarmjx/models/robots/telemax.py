"""The TeleMax: four flippers that carry it, and an arm with seven joints (manual 12.19)."""

import math
from typing import Literal

from usarmjx.base.transforms import Vec3
from usarmjx.models.robots.kit import (
    ACROSS,
    ALONG,
    BLACK,
    FLIPPERS,
    GRIPPER_FINGERS_MASS,
    JET_BLACK,
    LAMP,
    POSE_SENSORS,
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
from usarmjx.models.types.robot import CHASSIS, Link, MissionPackage, Motor, Mount, RobotSpec
from usarmjx.models.types.shapes import Shape

BLUE = (0.2, 0.3, 0.5, 1.0)
SILVER = (0.75, 0.75, 0.78, 1.0)

TELEMAX_LENGTH, TELEMAX_WIDTH, TELEMAX_HEIGHT = 0.80, 0.40, 0.75  # manual 12.19.1, stowed
TELEMAX_BELT = Belt(
    radius=0.381 / 2,  # manual 12.19.1
    max_spin=1.3 / (0.381 / 2),  # manual 12.19.1: 1.3 m/s
    width=0.095,  # manual 12.19.1
    max_pull=300.0,  # chosen, as all without a source
    inertia=10.0,
    wheel_mass=2.0,
    cleat=0.015,
    trim=BLUE,
)
TELEMAX_MASS = 80.0
# Stowed, the flippers point up, and the wheels around their hinges are the ends of it. In the middle of each
# side a third wheel closes the gap between the tracks' inner ends.
TELEMAX_PIVOT = TELEMAX_LENGTH / 2 - TELEMAX_BELT.radius
TELEMAX_SEPARATION = TELEMAX_WIDTH - TELEMAX_BELT.width
TELEMAX_FLIPPERS = Flippers(
    pivot=(TELEMAX_PIVOT, TELEMAX_SEPARATION / 2),
    height=0.0,
    length=0.34,
    tip=0.06,
    count=4,
    mass=1.5,
    motor=Motor(max_speed=1.0, torque=250.0, stiffness=8000.0, damping=280.0, armature=4.0),
)

# Lengths in the inverse kinematics of the Matlab toolbox for USARSim [m]. Its L1 and L2, turret and shoulder,
# are the captured mounts of links 1 and 2 here; L3 and L4 are the upper arm up to and beyond the telescope's
# joint, L5 is the lower arm, L6 and L7 the wrist.
L3, L4, L5, L6, L7 = 0.4436, 0.18996, 0.3999, 0.125, 0.125
FOREARM_OFFSET = 0.10  # chosen: from elbow to the joint that turns the lower arm
RAISED: Vec3 = (math.pi, 0.0, 0.0)  # captured: z of the turret's frame points up
TILT: Vec3 = (math.pi / 2, 0.0, 0.0)  # captured: z of the shoulder's to the right, so that positive lifts
TO_ROLL_AXIS: Vec3 = (0.0, math.pi / 2, 0.0)  # from a tilting joint's frame to one with z ahead along the arm
TO_TILT_AXIS: Vec3 = (0.0, -math.pi / 2, 0.0)  # and back


def _motor(torque: float, armature: float) -> Motor:
    """Return a servo with the captured speed, so stiff that the arm's weight bends it by less than 1 mrad."""
    return Motor(
        max_speed=0.17,
        torque=torque,
        stiffness=4000.0 * armature,
        damping=60.0 * armature,
        armature=armature,
    )


def _link(
    number: int,
    pose: tuple[Vec3, Vec3],
    limits: tuple[float, float],
    motor: Motor,
    bar: Shape,
    joint: Literal["Revolute", "Prismatic"] = "Revolute",
) -> Link:
    """Return a link at (location, orientation) on the previous one."""
    return Link(
        number=number,
        parent=number - 1 if number > 1 else -1,
        location=pose[0],
        orientation=pose[1],
        max_speed=0.17,
        max_torque=300.0,
        min_range=limits[0],
        max_range=limits[1],
        joint=joint,
        motor=motor,
        shapes=(bar,),
        looks=_tube(bar),
    )


def _bar(start: float, end: float, thick: float, mass: float) -> Shape:
    """Return a bar along the arm, from `start` to `end` ahead of its joint."""
    half = ((end - start) / 2, thick / 2, thick / 2)
    return Shape(kind="box", size=half, at=((start + end) / 2, 0.0, 0.0), mass=mass, rgba=BLACK)


def _tube(bar: Shape) -> tuple[Shape, ...]:
    """Return the visuals of a bar of the arm: a tube, the drum of its joint, a collar at its end."""
    half, thick, _ = bar.size
    start, end = bar.at[0] - half, bar.at[0] + half
    return (
        rod((start, 0.0, 0.0), (end, 0.0, 0.0), 0.8 * thick, SILVER, blunt=True),
        drum(1.15 * thick, 1.3 * thick, (max(start, 0.0), 0.0, 0.0), JET_BLACK, ACROSS),
        drum(0.95 * thick, 0.012, (end - 0.012, 0.0, 0.0), BLUE, ALONG),
    )


UNLIMITED = (1.0, 0.0)  # captured for link 1: unlimited
SHOULDER, ELBOW, WRIST = _motor(300.0, 12.0), _motor(120.0, 4.0), _motor(40.0, 1.0)
TELESCOPE = _motor(600.0, 20.0)

TELEMAX_ARM = MissionPackage(
    # Straight ahead at zero: then the manual's initial pose (12.19.1: link 2 at 2, link 4 at -2) raises the
    # upper arm and leaves the lower arm level. Ranges of links 1 and 3 are captured and the toolbox's, the
    # others are chosen.
    name="TeleMaxArm",
    links=(
        _link(1, ((0.1789, -0.0014, -0.0905), RAISED), UNLIMITED, SHOULDER, _bar(-0.05, 0.05, 0.1, 2.0)),
        _link(2, ((0.0258, -0.0720, 0.1566), TILT), (-0.5, 2.6), SHOULDER, _bar(0.0, L3, 0.06, 2.5)),
        _link(
            3, ((L3, 0.0, 0.0), TO_ROLL_AXIS), (0.0, 0.3), TELESCOPE, _bar(-0.2, L4, 0.05, 1.2), "Prismatic"
        ),
        _link(4, ((0.0, 0.0, L4), TO_TILT_AXIS), (-2.6, 2.6), ELBOW, _bar(0.0, FOREARM_OFFSET, 0.05, 0.6)),
        _link(
            5,
            ((FOREARM_OFFSET, 0.0, 0.0), TO_ROLL_AXIS),
            (-3.14, 3.14),
            WRIST,
            _bar(0.0, L5 - FOREARM_OFFSET, 0.05, 0.8),
        ),
        _link(
            6, ((0.0, 0.0, L5 - FOREARM_OFFSET), TO_TILT_AXIS), (-2.0, 2.0), WRIST, _bar(0.0, L6, 0.04, 0.4)
        ),
        _link(7, ((L6, 0.0, 0.0), TO_ROLL_AXIS), UNLIMITED, WRIST, _bar(-0.02, 0.005, 0.05, 0.2)),
    ),
)


_TELEMAX_BODY = (
    prism(
        mirrored([(0.3, 0.08), (0.34, 0.0), (0.34, -0.1), (0.28, -0.15)]),
        0.1,
        SILVER,
    ),
    block((0.24, 0.15, 0.012), (0.0, 0.0, -0.185), SILVER),
    block((0.16, 0.08, 0.02), (-0.1, 0.0, -0.165), BLUE),
    block((0.004, 0.07, 0.03), (0.341, 0.0, -0.05), BLUE),
    *(drum(0.018, 0.01, (0.342, y, -0.09), LAMP, ALONG) for y in (-0.07, 0.07)),
    *lens((0.342, 0.0, -0.1), 0.018),
    drum(0.07, 0.05, (0.1789, -0.0014, -0.14), JET_BLACK),
    rod((-0.22, 0.1, -0.19), (-0.22, 0.1, -0.45), 0.006, JET_BLACK),
)


def telemax(wheels: int = 4) -> RobotSpec:
    """Return the TeleMax with a number of wheels in each row of the chassis (manual 12.10.2)."""
    row = {"separation": TELEMAX_SEPARATION, "front": TELEMAX_PIVOT, "rear": -TELEMAX_PIVOT, "height": 0.0}
    rows = track_pair(TELEMAX_BELT, wheels, **row)
    parts = (*rows, *TELEMAX_FLIPPERS.parts(TELEMAX_BELT))
    packages = (TELEMAX_ARM,)
    return RobotSpec(
        name="TeleMax",
        dimensions=(TELEMAX_LENGTH, TELEMAX_WIDTH, TELEMAX_HEIGHT),
        mass=TELEMAX_MASS,
        origin_height=TELEMAX_BELT.radius,
        chassis=(
            # Over the axles, so that edges meet the tracks; its mass, batteries, lies between them.
            Shape(kind="box", size=(0.34, 0.20, 0.06), at=(0.0, 0.0, -0.08), rgba=SILVER),
            Shape(
                kind="box",
                size=(0.30, 0.10, 0.08),
                at=(0.0, 0.0, 0.02),
                mass=TELEMAX_MASS - mass_of(parts, packages) - GRIPPER_FINGERS_MASS,
                surface="fixture",
                rgba=SILVER,
            ),
        ),
        looks=(*track_pair_visuals(TELEMAX_BELT, **row), *_TELEMAX_BODY),
        parts=parts,
        drive=drive_tracks(parts, TELEMAX_BELT),
        packages=packages,
        sensors=POSE_SENSORS,
        cameras=(
            camera(at=(0.35, 0.0, -0.10), parent=CHASSIS),
            camera("GCam", at=(0.0, 0.0, -0.05), parent="TeleMaxArm_Link7"),
        ),
        # Its closed fingers, 12 cm with the palm, end L7 beyond the joint that turns it.
        effecters=(
            Mount(kind="Gripper", name="Gripper", parent="TeleMaxArm_Link7", at=(L7 - 0.12, 0.0, 0.0)),
        ),
        wheel_radius=TELEMAX_BELT.radius,
        wheel_separation=TELEMAX_SEPARATION,
        wheel_base=2 * TELEMAX_PIVOT,
        battery_life=7200.0,
        reported_joints=FLIPPERS,
        sources=(
            ("dimensions", "manual 12.19"),
            ("wheel_radius", "manual 12.19"),
            ("top speed", "manual 12.19"),
            ("battery_life", "manual 12.19"),
            ("arm mounts", "captured"),
            ("mass", "chosen"),
            ("layout", "chosen"),
            ("sensors", "manual 12.19"),
        ),
    )


TELEMAX = telemax()
