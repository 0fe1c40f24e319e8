"""Parts that many robots share: wheels, pan-tilt heads, the usual sensors."""

import math
from dataclasses import replace

from usarmjx.base.transforms import Vec3
from usarmjx.models.robots.looks_kit import ACROSS, DARK, STEEL, ball, block, drum, lens, wheel_looks
from usarmjx.models.spec.robot import (
    CHASSIS,
    STEER_SUFFIX,
    SUSPENSION_SUFFIX,
    UP,
    Link,
    MissionPackage,
    Motor,
    Mount,
    Part,
    Spring,
    options,
)
from usarmjx.models.spec.shapes import ZERO, Rgba, Shape

RUBBER: Rgba = (0.15, 0.15, 0.15, 1.0)
BLACK: Rgba = (0.1, 0.1, 0.1, 1.0)
ON_THE_FLOOR = options(MaxIncidence=1.309)
"""Of sonars that look level over the ground: it is silent, as in captured sessions of a P2AT, which read up
to 5 m where their cones meet the floor at 1.5 m."""
AXLE_ROTATION = (-math.pi / 2, 0.0, 0.0)
"""Turns a cylinder's axis (z) to the side (y)."""


def wheel(
    name: str,
    *,
    at: Vec3,
    size: tuple[float, float],
    mass: float,
    motor: Motor | None,
    parent: str = CHASSIS,
    surface: str = "wheel",
) -> Part:
    """Return a wheel of (radius, width) [m]; without a motor it rolls freely. It is drawn with spokes."""
    radius, width = size
    tyre = Shape(
        kind="cylinder",
        size=(radius, width / 2),
        rotation=AXLE_ROTATION,
        mass=mass,
        surface=surface,
        rgba=RUBBER,
    )
    looks = wheel_looks(radius, width)
    return Part(name=name, parent=parent, at=at, motor=motor, shapes=(tyre,), looks=looks, is_wheel=True)


def firm_motor(max_speed: float, torque: float, inertia: float, armature: float) -> Motor:
    """Return a firm servo: gains a tenth and a third of those at which steps of 5 ms break down.

    Args:
        max_speed: [rad/s].
        torque: [N m].
        inertia: Of what it turns [kg m2].
        armature: Its own, seen at the joint [kg m2].
    """
    whole = inertia + armature
    return Motor(
        max_speed=max_speed, torque=torque, stiffness=4000.0 * whole, damping=60.0 * whole, armature=armature
    )


def car_wheel(
    tyre: Part,
    *,
    hub: float,
    spring: Spring | None = None,
    travel: float = 0.0,
    steer: Motor | None = None,
    lock: float = 0.0,
) -> tuple[Part, ...]:
    """Return the manual's car-wheel joint (14.4.2.4): `<wheel>_Suspension`, `<wheel>_Steer`, then the wheel.

    Args:
        tyre: The wheel as it would be without them (`kit.wheel`).
        hub: Mass of what does not spin with it: brake, a share of axle and springs [kg].
        spring: Its suspension, positive when compressed; None: it has none.
        travel: How far it springs, up and down [m].
        steer: What turns it about the vertical, positive to the left; None: it does not steer.
        lock: How far it steers to each side [rad].
    """
    name, joints = tyre.name, (spring is not None) + (steer is not None)
    # Out of sight and of contacts, within the tyre.
    size = (tyre.shapes[0].size[1],)
    knuckle = Shape(kind="sphere", size=size, mass=hub / max(1, joints), surface="fixture", rgba=BLACK)
    parts: list[Part] = []
    parent, at = tyre.parent, tyre.at
    if spring is not None:
        slide = Part(
            name=name + SUSPENSION_SUFFIX,
            parent=parent,
            at=at,
            axis=UP,
            joint="slide",
            limits=(-travel, travel),
            spring=spring,
            shapes=(knuckle,),
        )
        parts.append(slide)
        parent, at = slide.name, ZERO
    if steer is not None:
        turn = Part(
            name=name + STEER_SUFFIX,
            parent=parent,
            at=at,
            axis=UP,
            motor=steer,
            limits=(-lock, lock),
            shapes=(knuckle,),
        )
        parts.append(turn)
        parent, at = turn.name, ZERO
    return (*parts, replace(tyre, parent=parent, at=at))


def pan_tilt(
    location: Vec3, *, tilt: tuple[float, float] = (-0.16, 0.40), name: str = "CameraPanTilt"
) -> MissionPackage:
    """Return the usual camera head with the captured frames: pan about the vertical, tilt up positive.

    Args:
        location: Of the pan joint on the chassis.
        tilt: Range of the tilt joint (manual 9.3's example by default).
        name: Name of the package.
    """
    pan_shape = Shape(kind="sphere", size=(0.03,), mass=0.2, surface="fixture", rgba=BLACK)
    head = Shape(
        kind="box", size=(0.05, 0.04, 0.03), at=(0.02, 0.0, 0.0), mass=0.3, surface="fixture", rgba=BLACK
    )
    # Drawn as a pedestal, and between two cheeks the head, with its lens where the cameras are.
    pedestal = (drum(0.034, 0.012, (0.0, 0.0, -0.012)), drum(0.024, 0.02, (0.0, 0.0, -0.03), STEEL))
    face = (
        block((0.036, 0.036, 0.026), (0.026, 0.0, 0.026), DARK),
        ball((0.036, 0.036, 0.016), (0.026, 0.0, 0.0), DARK),
        drum(0.03, 0.042, (0.0, 0.0, 0.02), STEEL, ACROSS),
        *lens((0.066, 0.0, 0.03), 0.02),
    )
    speed, torque = 0.17, 20.0  # captured
    return MissionPackage(
        name=name,
        links=(
            Link(
                number=1,
                parent=-1,
                location=location,
                orientation=(math.pi, 0.0, 0.0),
                min_range=1.0,
                max_range=0.0,
                shapes=(pan_shape,),
                looks=pedestal,
                max_speed=speed,
                max_torque=torque,
            ),
            Link(
                number=2,
                parent=1,
                location=(0.0, 0.0, 0.0599),
                orientation=(math.pi / 2, 0.0, 0.0),
                min_range=tilt[0],
                max_range=tilt[1],
                shapes=(head,),
                looks=face,
                max_speed=speed,
                max_torque=torque,
            ),
        ),
    )


def camera(name: str = "Camera", at: Vec3 = (0.0820, 0.0002, 0.0613), **where: object) -> Mount:
    """Return a colour camera, by default where captures have it: on the tilting part of `CameraPanTilt`.

    Args:
        name: Item name.
        at: Position on its parent.
        where: `parent` and `direction` of the mount.
    """
    fov = options(CameraDefFov=0.8727, CameraMinFov=0.3491, CameraMaxFov=2.0944)  # manual 9.3's CONF
    place = {"parent": "CameraPanTilt_Link2", **where}
    return Mount(kind="Camera", name=name, at=at, defaults=fov, **place)  # type: ignore[arg-type]


def sick_lms200(at: Vec3, name: str = "Scanner1", parent: str = CHASSIS) -> Mount:
    """Return a SICK LMS200: 181 beams over half a turn, 20 m (captured CONF)."""
    fan = options(MaxRange=20.0, MinRange=0.1, Resolution=math.pi / 180, ScanFov=math.pi)
    return Mount(kind="RangeScanner", name=name, at=at, parent=parent, defaults=fan)


def sick_housing(at: Vec3) -> Shape:
    """Return a box of the LMS200's size (data sheet: 155 x 156 x 210 mm; optics in its upper half)."""
    centre = (at[0], at[1], at[2] - 0.03)
    return Shape(kind="box", size=(0.0775, 0.078, 0.08), at=centre, rgba=(0.2, 0.3, 0.7, 1))


POSE_SENSORS = (
    Mount(kind="Odometry", name="Odometry"),
    Mount(kind="INS", name="INS"),
    Mount(kind="GroundTruth", name="GroundTruth"),
)
"""What the manual gives most robots, and the GroundTruth that captured ones carry too."""

ENCODER_AXIS = (0.0, 0.0, math.pi / 2)
"""Direction of an encoder that looks along the axle to the right (captured for ECRight)."""
