"""The flying robots AirRobot and Passarola (manual 12.20, 12.21).

The manual gives sizes, masses and speeds. The rest is chosen, as no drawing or ini file of them is known; the
AirRobot's limits of tilt are those of its successor in the UDK version.
"""

import math
from itertools import pairwise

from usarmjx.base.transforms import Vec3
from usarmjx.models.drives import Blimp, RotaryWing
from usarmjx.models.drives.fluid import AIR_DENSITY, Hull
from usarmjx.models.robots.kit import (
    BLACK,
    DARK,
    GLASS_BLACK,
    LAMP,
    POSE_SENSORS,
    SILVER,
    STEEL,
    ball,
    block,
    camera,
    drum,
    hull,
    lens,
    mirrored,
    prism,
    rod,
)
from usarmjx.models.types.robot import Link, MissionPackage, Motor, RobotSpec
from usarmjx.models.types.shapes import Rgba, Shape

WHITE: Rgba = (0.9, 0.9, 0.9, 1.0)
ORANGE: Rgba = (0.95, 0.55, 0.1, 1.0)
ROTOR_BLADE: Rgba = (0.2, 0.21, 0.23, 1.0)
ROTOR: Rgba = (0.3, 0.3, 0.3, 0.6)
ALONG = (0.0, math.pi / 2, 0.0)
"""Rotation of a capsule's axis (z) to the front (x)."""
POSES = tuple(sensor for sensor in POSE_SENSORS if sensor.kind != "Odometry")  # there are no wheels to count
TILT_MOTOR = Motor(max_speed=0.17, torque=1.0, stiffness=4.0, damping=0.2, armature=0.002)
"""Servo light enough not to shake a robot of 1 kg; the speed is that of captured camera heads."""


def tilt_camera(at: Vec3, mass: float = 0.06) -> MissionPackage:
    """Return a camera head that only tilts; positive looks down (UsarCommander's sign)."""
    head = Shape(kind="box", size=(0.03, 0.02, 0.02), mass=mass, surface="fixture", rgba=BLACK)
    tilt = Link(
        number=1,
        parent=-1,
        location=at,
        orientation=(math.pi / 2, 0.0, 0.0),  # its axis points left
        max_speed=TILT_MOTOR.max_speed,
        max_torque=20.0,  # captured, of ground robots
        min_range=-math.pi / 6,  # chosen: from 30 degrees up ...
        max_range=math.pi / 2,  # ... to straight down
        shapes=(head,),
        looks=(ball((0.028, 0.026, 0.026), rgba=BLACK), *lens((0.022, 0.0, 0.0), 0.014, DARK)),
        motor=TILT_MOTOR,
    )
    return MissionPackage(name="CameraPanTilt", links=(tilt,))


TILTING = camera(at=(0.03, 0.0, 0.0), parent="CameraPanTilt_Link1")

# AirRobot: a flat cross of rotors in a frame, with body, skids and camera below its middle, so that the
# centre of gravity lies on the axis of the thrust. Masses chosen to add up to the manual's 1 kg.
AIRROBOT_SPAN = 0.999  # manual
FRAME = 0.012  # half thickness of the frame's bars
AIRROBOT_ROTORS = tuple((x, y) for x in (0.28, -0.28) for y in (-0.28, 0.28))


def _rotor(x: float, y: float) -> Shape:
    return Shape(
        kind="cylinder", size=(0.19, 0.012), at=(x, y, -0.085), mass=0.09, surface="fixture", rgba=ROTOR
    )


def _bar(x: int, y: int) -> Shape:
    """Return the frame's bar in front (1, 0), behind, at the right or at the left (0, -1)."""
    reach = AIRROBOT_SPAN / 2 - FRAME
    size = (FRAME, reach + FRAME, FRAME) if x else (reach + FRAME, FRAME, FRAME)
    return Shape(kind="box", size=size, at=(x * reach, y * reach, FRAME - 0.097), rgba=WHITE)


def _airrobot_visuals() -> tuple[Shape, ...]:
    """Return a hoop of carbon about four rotors on crossed arms, a rounded body below, and its legs."""
    reach, edges = AIRROBOT_SPAN / 2 - FRAME, 20
    hoop = [
        (reach * math.cos(2 * math.pi * k / edges), reach * math.sin(2 * math.pi * k / edges), FRAME - 0.097)
        for k in range(edges + 1)
    ]
    return (
        *(rod(start, end, FRAME, BLACK) for start, end in pairwise(hoop)),
        *(rod((-x, -y, -0.075), (x, y, -0.075), 0.012, BLACK) for x, y in ((0.35, 0.35), (0.35, -0.35))),
        *(solid for x, y in AIRROBOT_ROTORS for solid in _blades((x, y, -0.085), 0.19)),
        ball((0.12, 0.12, 0.05), (0.0, 0.0, -0.035), SILVER),
        drum(0.1, 0.012, (0.0, 0.0, -0.035), ORANGE),
        drum(0.05, 0.015, (0.0, 0.0, 0.012), BLACK),
        *(block((0.02, 0.004, 0.003), (0.112, y, -0.03), LAMP) for y in (-0.03, 0.03)),
        *(
            rod((0.09 * x, 0.09 * y, 0.0), (0.12 * x, 0.12 * y, 0.09), 0.006, BLACK)
            for x in (-1, 1)
            for y in (-1, 1)
        ),
        *(rod((-0.12, y, 0.091), (0.12, y, 0.091), 0.006, BLACK) for y in (-0.12, 0.12)),
    )


def _blades(at: Vec3, radius: float) -> tuple[Shape, ...]:
    """Return a rotor of two blades and its motor."""
    x, y, z = at
    turn = -0.7 if x * y > 0 else 0.7
    return (
        drum(0.022, 0.022, (x, y, z + 0.008), STEEL),
        block((radius, 0.014, 0.002), (x, y, z - 0.012), ROTOR_BLADE, (0.05, 0.0, turn)),
        drum(0.016, 0.006, (x, y, z - 0.014), ORANGE),
    )


AIRROBOT = RobotSpec(
    name="AirRobot",
    dimensions=(AIRROBOT_SPAN, AIRROBOT_SPAN, 0.194),
    mass=1.0,
    payload=0.2,
    origin_height=0.097,
    chassis=(
        Shape(kind="box", size=(0.10, 0.10, 0.045), at=(0.0, 0.0, -0.03), mass=0.54, rgba=BLACK),
        # The frame around the rotors makes contact with walls and other robots.
        *(_bar(x, y) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))),
        *(
            Shape(
                kind="box",
                size=(0.4, 0.01, 0.01),
                at=(0.0, 0.0, -0.08),
                rotation=(0.0, 0.0, yaw),
                surface="fixture",
                rgba=BLACK,
            )
            for yaw in (math.pi / 4, -math.pi / 4)
        ),
        *(
            Shape(kind="box", size=(0.12, 0.01, 0.05), at=(0.0, y, 0.047), mass=0.02, rgba=BLACK)
            for y in (-0.12, 0.12)
        ),
        *(_rotor(x, y) for x, y in AIRROBOT_ROTORS),
    ),
    looks=_airrobot_visuals(),
    drive=RotaryWing(
        max_speeds=(5.0, 5.0, 5.0),
        max_turn=1.5708,
        mass=1.0,
        inertia=(0.0358, 0.0355, 0.0673),
        # Frame and body seen from the side; rotors and frame from above (chosen): it falls at 9 m/s.
        drag_areas=(0.06, 0.06, 0.2),
        max_thrust=24.0,  # a bit more than twice its weight with payload
        max_torque=(6.0, 6.0, 1.0),  # enough to get up from its back, with rotors that can reverse
        acceleration_tilt=math.radians(25),  # the UDK AirRobot's limit of roll and pitch
    ),
    packages=(tilt_camera((0.0, 0.0, 0.05)),),
    sensors=POSES,
    cameras=(TILTING,),
    sources=(
        ("dimensions, mass, payload, speeds", "manual 12.20"),
        ("camera's sign", "captured"),
        ("layout, drag, thrust, sensors", "chosen"),
    ),
)

# Passarola: an envelope with a gondola of thrusters and camera below its middle, with the manual's length,
# width over the thrusters, and height over all. Masses chosen to add up to the manual's 3 kg.
PASSAROLA_ENVELOPE = (0.9, 1.1)  # radius, half length of the tube
PASSAROLA_TOP = -0.1  # of the envelope's middle
PASSAROLA_RADII = (2.0, 1.0, 1.0)
PASSAROLA_COG = 0.230  # of the 3 kg, below the origin

# 3 kg are suspended below 10.3 kg of gas and air, which weigh as much as the displaced air: the righting
# moment is that of the 3 kg below the envelope's middle.
PASSAROLA_ARM = (
    3.0 * (PASSAROLA_COG - PASSAROLA_TOP) / (AIR_DENSITY * 4 / 3 * math.pi * math.prod(PASSAROLA_RADII))
)


def _thruster(y: float) -> Shape:
    return Shape(
        kind="cylinder", size=(0.15, 0.04), at=(0.0, y, 0.8), rotation=ALONG, surface="fixture", rgba=ROTOR
    )


def _passarola_visuals() -> tuple[Shape, ...]:
    """Return an envelope with bands and fins, and below it a gondola with thrusters in rings."""
    top, red = PASSAROLA_TOP, (0.75, 0.15, 0.1, 1.0)
    fin = ((-1.35, 0.45), (-1.8, 0.9), (-1.98, 0.9), (-1.95, 0.1))
    return (
        ball((2.0, 0.9, 0.9), (0.0, 0.0, top), ORANGE),
        *(ball((0.03, 0.853, 0.853), (x, 0.0, top), WHITE) for x in (0.7, -0.7)),
        ball((0.05, 0.907, 0.907), (0.0, 0.0, top), red),
        ball((0.15, 0.36, 0.36), (1.88, 0.0, top), WHITE),
        *(
            hull([(x, y * side, top + thick) for x, y in fin for thick in (-0.012, 0.012)], red)
            for side in (-1.0, 1.0)
        ),
        *(
            hull([(x, thick, top + y * side) for x, y in fin for thick in (-0.012, 0.012)], red)
            for side in (-1.0, 1.0)
        ),
        prism(mirrored([(0.34, 0.94), (0.42, 0.88), (0.36, 0.79)]), 0.2, DARK),
        block((0.05, 0.16, 0.035), (0.37, 0.0, 0.85), GLASS_BLACK),
        block((0.22, 0.204, 0.03), (-0.06, 0.0, 0.85), GLASS_BLACK),
        *(rod((-0.38, y, 0.98), (0.38, y, 0.98), 0.02, BLACK) for y in (-0.18, 0.18)),
        *(rod((x, y, 0.94), (x, y, 0.98), 0.012, BLACK) for x in (-0.25, 0.25) for y in (-0.18, 0.18)),
        *(rod((x, 0.0, 0.8), (x, 0.0, 0.7), 0.03, BLACK) for x in (-0.25, 0.25)),
        rod((0.0, -0.85, 0.8), (0.0, 0.85, 0.8), 0.018, STEEL, blunt=True),
        *(solid for y in (-0.85, 0.85) for solid in _thruster_visuals((0.0, y, 0.8))),
        *_thruster_visuals((-2.0, 0.0, top)),
    )


def _thruster_visuals(at: Vec3) -> tuple[Shape, ...]:
    """Return a ring with a propeller that pushes ahead."""
    x, y, z = at
    ring = [(0.15 * math.cos(k * math.pi / 6), 0.15 * math.sin(k * math.pi / 6)) for k in range(13)]
    return (
        *(rod((x, y + a[0], z + a[1]), (x, y + b[0], z + b[1]), 0.012, BLACK) for a, b in pairwise(ring)),
        drum(0.03, 0.05, at, STEEL, ALONG),
        *(
            block((0.004, 0.018, 0.14), at, ROTOR_BLADE, (turn, 0.0, 0.0))
            for turn in (0.4, 0.4 + math.pi / 2)
        ),
    )


PASSAROLA = RobotSpec(
    name="Passarola",
    dimensions=(4.0, 2.0, 2.0),
    mass=3.0,
    payload=2.0,
    origin_height=1.0,
    chassis=(
        Shape(
            kind="capsule",
            size=PASSAROLA_ENVELOPE,
            at=(0.0, 0.0, PASSAROLA_TOP),
            rotation=ALONG,
            mass=2.0,
            surface="fixture",
            rgba=ORANGE,
        ),
        # Contact boxes of the envelope: its nose and tail, its sides, its top.
        Shape(kind="box", size=(2.0, 0.2, 0.2), at=(0.0, 0.0, PASSAROLA_TOP), rgba=ORANGE),
        Shape(kind="box", size=(1.1, 0.9, 0.3), at=(0.0, 0.0, PASSAROLA_TOP), rgba=ORANGE),
        Shape(kind="box", size=(1.1, 0.3, 0.9), at=(0.0, 0.0, PASSAROLA_TOP), rgba=ORANGE),
        # Gondola, its skids, the bar with the thrusters, the tail's fins.
        Shape(kind="box", size=(0.4, 0.2, 0.075), at=(0.0, 0.0, 0.875), mass=0.84, rgba=BLACK),
        *(
            Shape(kind="box", size=(0.4, 0.02, 0.025), at=(0.0, y, 0.975), mass=0.05, rgba=BLACK)
            for y in (-0.18, 0.18)
        ),
        Shape(kind="box", size=(0.015, 0.85, 0.015), at=(0.0, 0.0, 0.8), surface="fixture", rgba=BLACK),
        *(_thruster(y) for y in (-0.85, 0.85)),
        Shape(kind="box", size=(0.2, 0.01, 0.8), at=(-1.75, 0.0, PASSAROLA_TOP), surface="fixture"),
        Shape(kind="box", size=(0.2, 0.8, 0.01), at=(-1.75, 0.0, PASSAROLA_TOP), surface="fixture"),
    ),
    looks=_passarola_visuals(),
    drive=Blimp(
        hull=Hull(
            radii=PASSAROLA_RADII,
            density=AIR_DENSITY,
            mass=3.0,
            inertia=(1.42, 3.10, 2.46),
            drag=(0.3, 0.8, 0.8),  # along, with gondola and fins; across
            cog_depth=PASSAROLA_ARM,
        ),
        max_angle=math.pi / 2,
        max_thrust_speed=2.0,
        max_turn=1.0,
        max_thrust=15.0,  # 12.3 N of drag going up at 2 m/s, and some to speed up
        max_torque=8.0,  # likewise: 4.3 N m at 1 rad/s
    ),
    packages=(tilt_camera((0.0, 0.0, 0.975)),),
    sensors=POSES,
    cameras=(TILTING,),
    sources=(
        ("dimensions, mass, payload, speeds", "manual 12.21"),
        ("layout, drag, thrust, sensors", "chosen"),
    ),
)
