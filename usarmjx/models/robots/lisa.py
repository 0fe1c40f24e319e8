"""Lisa, whose two big wheels in opposite corners steer and drive independently (manual 12.18).

The manual gives its wheels but no measurements, as the real one was not built yet: all but the steering is
chosen.
"""

import math

from usarmjx.models.drives.ground import OmniDrive, Wheel
from usarmjx.models.robots.kit import (
    BLACK,
    DARK,
    ENCODER_AXIS,
    JET_BLACK,
    POSE_SENSORS,
    STEEL,
    ball,
    block,
    car_wheel,
    drum,
    firm_motor,
    rod,
    wheel,
)
from usarmjx.models.types.robot import STEER_SUFFIX, Mount, RobotSpec
from usarmjx.models.types.shapes import Shape

ORIGIN = 0.40
RADIUS, TYRE = 0.125, 0.05
BALL = 0.06
MASS, WHEEL_MASS, HUB = 80.0, 3.0, 4.0
SPIN = 8.0  # 1 m/s
MAX_STEER = 3.14  # manual 12.18.2
# Wheel 0 is the front right one and wheel 1 opposite, where manual 9.4's example has them: with both at 0.75
# rad to the left and opposite speeds "the robot rotates on place", so their axes meet in its middle.
HALF_TRACK = 0.30
HALF_BASE = HALF_TRACK * math.tan(0.75)
CORNERS = ((HALF_BASE, HALF_TRACK), (-HALF_BASE, -HALF_TRACK))

LIGHT, BLUE = (0.88, 0.9, 0.92, 1.0), (0.25, 0.5, 0.75, 1.0)

MOTOR = firm_motor(SPIN, torque=15.0, inertia=WHEEL_MASS * RADIUS**2 / 2, armature=0.2)
STEERING = firm_motor(3.0, torque=30.0, inertia=WHEEL_MASS * RADIUS**2 / 4, armature=0.5)
WHEELS = tuple(
    Wheel(joint=f"Wheel{i}", steer=f"Wheel{i}{STEER_SUFFIX}", x=x, y=y, powered=True)
    for i, (x, y) in enumerate(CORNERS)
)

LISA = RobotSpec(
    name="Lisa",
    dimensions=(0.85, 0.75, 0.80),
    mass=MASS,
    origin_height=ORIGIN,
    chassis=(
        # A platform with all mass but the wheels', and a cabinet on it.
        Shape(
            kind="box",
            size=(0.425, 0.375, 0.09),
            at=(0.0, 0.0, ORIGIN - 0.15),
            mass=MASS - 2 * (WHEEL_MASS + HUB),
            rgba=(0.85, 0.85, 0.85, 1),
        ),
        Shape(kind="box", size=(0.25, 0.25, 0.28), at=(0.0, 0.0, -0.12), rgba=(0.6, 0.7, 0.8, 1)),
        # Wheels 2 and 3, which neither drive nor steer: balls that slide in all directions.
        *(
            Shape(kind="sphere", size=(BALL,), at=(x, -y, ORIGIN - BALL), surface="caster", rgba=BLACK)
            for x, y in CORNERS
        ),
    ),
    looks=(
        block((0.425, 0.375, 0.02), (0.0, 0.0, ORIGIN - 0.31), LIGHT),
        *(drum(0.04, 0.02, (x, y, ORIGIN - 0.31), LIGHT) for x in (0.39, -0.39) for y in (0.34, -0.34)),
        block((0.16, 0.36, 0.06), (0.0, 0.0, ORIGIN - 0.23), DARK),
        block((0.40, 0.18, 0.06), (0.0, 0.0, ORIGIN - 0.23), DARK),
        block((0.428, 0.2, 0.006), (0.0, 0.0, ORIGIN - 0.305), BLUE),
        *(
            solid
            for x, y in CORNERS
            for solid in (
                drum(0.05, 0.05, (x, -y, ORIGIN - 0.2), STEEL),
                ball((BALL, BALL, BALL), (x, -y, ORIGIN - BALL), JET_BLACK),
            )
        ),
        # The cabinet: doors with handles, a bar to push it by, a display that leans back.
        block((0.25, 0.25, 0.27), (0.0, 0.0, -0.1), LIGHT),
        *(block((0.002, 0.115, 0.12), (0.25, y, -0.03), BLUE) for y in (-0.12, 0.12)),
        *(block((0.006, 0.008, 0.03), (0.254, y, -0.03), STEEL) for y in (-0.02, 0.02)),
        block((0.26, 0.26, 0.01), (0.0, 0.0, -0.378), DARK),
        block((0.008, 0.1, 0.06), (0.2, 0.0, -0.26), JET_BLACK, (0.0, 0.0, 0.0)),
        block((0.002, 0.09, 0.05), (0.2518, 0.0, -0.25), (0.35, 0.65, 0.85, 1.0)),
        rod((-0.3, -0.2, -0.32), (-0.3, 0.2, -0.32), 0.014, STEEL),
        *(rod((-0.25, y, -0.32), (-0.3, y, -0.32), 0.01, STEEL) for y in (-0.18, 0.18)),
    ),
    parts=tuple(
        part
        for drive in WHEELS
        for part in car_wheel(
            wheel(
                drive.joint,
                at=(drive.x, drive.y, ORIGIN - RADIUS),
                size=(RADIUS, TYRE),
                mass=WHEEL_MASS,
                motor=MOTOR,
            ),
            hub=HUB,
            steer=STEERING,
            lock=MAX_STEER,
        )
    ),
    drive=OmniDrive(wheels=WHEELS, max_spin=SPIN, radius=RADIUS, max_steer=MAX_STEER),
    sensors=(
        *(
            Mount(kind="Encoder", name=f"EC{i}", parent=drive.joint, direction=ENCODER_AXIS)
            for i, drive in enumerate(WHEELS)
        ),
        *POSE_SENSORS[1:],
    ),
    wheel_radius=RADIUS,
    wheel_separation=2 * HALF_TRACK,
    wheel_base=2 * HALF_BASE,
    sources=(
        ("wheels, MaxSteerAngle, encoders", "manual 12.18"),
        ("ratio of wheel base and track", "manual 9.4"),
        ("dimensions, mass, wheel radius, top speed, layout, INS, GroundTruth", "chosen"),
    ),
)
