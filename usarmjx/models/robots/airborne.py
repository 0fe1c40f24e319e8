"""The flying robots AirRobot and Passarola (manual 12.20, 12.21).

The manual gives sizes, masses and speeds. The rest is chosen, as no drawing or ini file of them is known;
the AirRobot's limits of tilt are those of its successor in the UDK version.
"""

import math

from usarmjx.base.transforms import Vec3
from usarmjx.models.drives import Blimp, RotaryWing
from usarmjx.models.drives.fluid import AIR_DENSITY, Hull
from usarmjx.models.robots.kit import BLACK, POSE_SENSORS, camera
from usarmjx.models.spec.robot import Link, MissionPackage, Motor, RobotSpec
from usarmjx.models.spec.shapes import Rgba, Shape

WHITE: Rgba = (0.9, 0.9, 0.9, 1.0)
ORANGE: Rgba = (0.95, 0.55, 0.1, 1.0)
ROTOR: Rgba = (0.3, 0.3, 0.3, 0.6)
ALONG = (0.0, math.pi / 2, 0.0)
"""Turns a capsule's axis (z) to the front (x)."""
POSES = tuple(sensor for sensor in POSE_SENSORS if sensor.kind != "Odometry")  # there are no wheels to count
TILT_MOTOR = Motor(max_speed=0.17, torque=1.0, stiffness=4.0, damping=0.2, armature=0.002)
"""Light enough not to shake a robot of 1 kg; the speed is that of captured camera heads."""


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


AIRROBOT = RobotSpec(
    name="AirRobot",
    dimensions=(AIRROBOT_SPAN, AIRROBOT_SPAN, 0.194),
    mass=1.0,
    payload=0.2,
    origin_height=0.097,
    chassis=(
        Shape(kind="box", size=(0.10, 0.10, 0.045), at=(0.0, 0.0, -0.03), mass=0.54, rgba=BLACK),
        # What meets walls and other robots: the frame around the rotors.
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

# 3 kg hang below 10.3 kg of gas and air, which weigh as much as the air outside: the righting moment is
# that of the 3 kg below the envelope's middle.
PASSAROLA_ARM = (
    3.0 * (PASSAROLA_COG - PASSAROLA_TOP) / (AIR_DENSITY * 4 / 3 * math.pi * math.prod(PASSAROLA_RADII))
)


def _thruster(y: float) -> Shape:
    return Shape(
        kind="cylinder", size=(0.15, 0.04), at=(0.0, y, 0.8), rotation=ALONG, surface="fixture", rgba=ROTOR
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
        # What the envelope touches with: its nose and tail, its sides, its top.
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
