"""Parts of a robot from the part-joint pairs of an ini file (manual 14.4.2.4).

A car-wheel joint is up to three of our joints: `<wheel>_Suspension` slides, `<wheel>_Steer` on it turns,
and the wheel on that one spins; a locked one is left out.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from usarmjx.base.registry import Registry
from usarmjx.base.transforms import GRAVITY, Vec3
from usarmjx.models.ini.figures import DEFAULT_SUSPENSION_TRAVEL
from usarmjx.models.ini.pairs import (
    JointPair,
    check_own_axes,
    leaning,
    part_rotation,
    spin_axis,
    steering_axis,
    unit_of,
)
from usarmjx.models.ini.read import as_class, fail, key_text, number_of, vector_of
from usarmjx.models.robots.car_kit import STEER_ARMATURE, STEER_TORQUE
from usarmjx.models.robots.kit import BLACK, car_wheel, firm_motor, wheel
from usarmjx.models.spec.robot import UP, Motor, Part, RobotSpec, Spring
from usarmjx.models.spec.shapes import Shape

# All below is chosen. A wheel's motor has the inertia of the load that it moves, at least a P2DX's, gains of
# a P2AT's (667 and 33 times the inertia), and torque for a friction coefficient of 1.
MIN_ARMATURE = 0.03
STIFFNESS, DAMPING = 667.0, 33.0
WHEEL_SPEED = 6.2832  # rad/s: the wheel joint's default in the UDK version
HINGE_SPEED, HINGE_TORQUE = 0.1745, 20.0  # MotorSpeed, MotorTorque (manual 14.4.2.3), taken as N m
STEER_SPEED = 15000 * np.pi / 32768  # SteerSpeed (manual 14.4.2.3)
SUSPENSION_RATE, SUSPENSION_SHARE = 2 * np.pi * 2.0, 0.4  # rad/s, of critical damping
WHEEL_SHARE, PART_MASS, HUB_SHARE = 0.07, 0.5, 0.3


def build_parts(pairs: Sequence[JointPair], weight: float, robots: Registry[RobotSpec]) -> tuple[Part, ...]:
    """Return the parts of a robot that weighs so much; every wheel has a motor."""
    wheels = sum(pair.joint == "wheel" for pair in pairs)
    parts: list[Part] = []
    for pair in pairs:
        if pair.joint == "wheel":
            parts += _wheel_parts(pair, weight, wheels, robots)
        else:
            parts.append(_hinge_part(pair))
    return tuple(parts)


def _wheel_parts(pair: JointPair, weight: float, wheels: int, robots: Registry[RobotSpec]) -> list[Part]:
    """Return suspension, steering and wheel, as far as they are free."""
    line, struct = pair.line, pair.struct
    check_own_axes(pair)
    model = _model_of(pair, robots)
    known = model.shapes[0] if model else None
    radius = number_of(line, struct, "Radius", known and known.size[0], above=0.0)
    width = number_of(line, struct, "Width", known and 2 * known.size[1], above=0.0)
    usual = known.mass if known else weight * min(WHEEL_SHARE, 0.5 / wheels)
    mass = number_of(line, struct, "Mass", usual, above=0.0)
    load = weight / wheels
    motor = (model.motor if model else None) or _wheel_motor(load, radius)
    motor = replace(
        motor,
        max_speed=number_of(line, struct, "MaxSpeed", motor.max_speed, above=0.0),
        torque=number_of(line, struct, "Torque", motor.torque, above=0.0),
        brake=pair.brake,
        stall_torque=motor.stall_torque if struct.get("Torque") is None else None,
    )
    upright = steering_axis(pair)
    spring = Spring(
        stiffness=load * SUSPENSION_RATE**2,
        damping=2 * SUSPENSION_SHARE * load * SUSPENSION_RATE,
        load=load * GRAVITY * float(np.dot(upright, UP)),
    )
    tyre = wheel(pair.name, at=pair.at, size=(radius, width), mass=mass, motor=motor, parent=pair.parent)
    if model and tyre.shapes[0].size == model.shapes[0].size:
        tyre = replace(tyre, looks=model.looks)
    tyre = replace(tyre, rotation=leaning(spin_axis(pair)))
    tyre = replace(tyre, shapes=_moved(tyre.shapes, pair.middle), looks=_moved(tyre.looks, pair.middle))
    parts = car_wheel(
        tyre,
        hub=mass * HUB_SHARE,
        spring=spring if pair.sprung else None,
        travel=DEFAULT_SUSPENSION_TRAVEL[1],
        steer=_steering_servo(weight, mass * radius**2 / 4) if pair.steers else None,
        lock=np.pi,
    )
    return [part if part.is_wheel else replace(part, axis=upright) for part in parts]


def _steering_servo(weight: float, inertia: float) -> Motor:
    """Return what turns a wheel of that inertia about its upright, as firm as those of our cars."""
    return firm_motor(STEER_SPEED, STEER_TORQUE * weight, inertia, STEER_ARMATURE * weight)


def _moved(shapes: Sequence[Shape], by: Vec3) -> tuple[Shape, ...]:
    x, y, z = by
    return tuple(replace(shape, at=(shape.at[0] + x, shape.at[1] + y, shape.at[2] + z)) for shape in shapes)


def _model_of(pair: JointPair, robots: Registry[RobotSpec]) -> Part | None:
    """Return the wheel that a PartClass stands for, the first on its side: P2ATTire is a P2AT's."""
    written = pair.struct.get("PartClass")
    name = as_class(pair.line, written, "PartClass") if written is not None else ""
    owner = name.lower().removesuffix("tire")
    if owner != name.lower() and owner in robots:
        wheels = [part for part in robots.get(owner).wheels if part.shapes[0].kind == "cylinder"]
        if wheels:
            side = pair.chassis_position[1]
            return next((wheel for wheel in wheels if wheel.at[1] * side > 0), wheels[0])
    given = [pair.struct.get(field) is not None for field in ("Radius", "Width")]
    if not all(given):
        tires = [f"{known}Tire" for known, robot in robots if robot.wheels]
        fail(
            pair.line,
            f"the size of wheel {pair.name} (PartClass {name or 'not given'}) is not known",
            f"Radius= and Width=, or a PartClass of {', '.join(tires)}",
        )
    return None


def _wheel_motor(load: float, radius: float) -> Motor:
    return _servo(max(MIN_ARMATURE, load * radius**2), WHEEL_SPEED, load * GRAVITY * radius)


def _servo(armature: float, speed: float, torque: float) -> Motor:
    """Return a motor whose gains suit its inertia."""
    return Motor(
        max_speed=speed,
        torque=torque,
        stiffness=STIFFNESS * armature,
        damping=DAMPING * armature,
        armature=armature,
    )


def _hinge_part(pair: JointPair) -> Part:
    """Return a part on a hinge or a slider: a box of the given Size around its own middle."""
    line, struct = pair.line, pair.struct
    if struct.get("Size") is None:
        fail(line, f"{key_text(line)} has no Size", "Size=(X=length,Y=width,Z=height) of the part's box")
    x, y, z = (abs(edge) / 2 for edge in pair.units.position(vector_of(line, struct, "Size")))
    mass = number_of(line, struct, "Mass", PART_MASS, above=0.0)
    if min(x, y, z) == 0:
        fail(line, "Size has an edge of no length", "three lengths")
    # The inertia of its box about its joint, as the gains are of a servo that moves nothing else.
    arm = float(np.linalg.norm(pair.middle)) + max(x, y, z)
    motor = _servo(max(0.1, mass * arm**2), HINGE_SPEED, HINGE_TORQUE)
    motor = replace(
        motor,
        max_speed=number_of(line, struct, "MaxSpeed", motor.max_speed, above=0.0),
        torque=number_of(line, struct, "Torque", motor.torque, above=0.0),
    )
    limits = None
    if struct.get("MinRange") is not None or struct.get("MaxRange") is not None:
        low, high = (number_of(line, struct, name) for name in ("MinRange", "MaxRange"))
        limits = None if low > high else (low, high)
    turn = part_rotation(pair)
    axis = unit_of(pair, "SelfAxis" if struct.get("SelfAxis") is not None else "ParentAxis")
    a, b, c = (axis + 0.0).tolist()
    return Part(
        name=pair.name,
        parent=pair.parent,
        at=pair.at,
        rotation=turn,
        axis=(a, b, c),
        joint="hinge" if pair.joint == "hinge" else "slide",
        motor=motor,
        limits=limits,
        shapes=(Shape(kind="box", size=(x, y, z), at=pair.middle, mass=mass, rgba=BLACK),),
    )
