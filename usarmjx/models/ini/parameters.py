"""Parameters of a robot's ini section: single numbers and their effects on the robot (manual 14.4.2.3)."""

import re
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import partial

import numpy as np

from usarmjx.base.transforms import Vec3
from usarmjx.models.drives import Tracks
from usarmjx.models.ini.items import WarningLog
from usarmjx.models.ini.parse import (
    UU_PER_METRE,
    UU_PER_RADIAN,
    Line,
    Units,
    as_bool,
    as_number,
    as_vector,
    as_whole,
    fail,
)
from usarmjx.models.types.robot import (
    STEER_SUFFIX,
    SUSPENSION_SUFFIX,
    UP,
    Options,
    Part,
    RobotSpec,
    field_name,
)
from usarmjx.models.types.shapes import Shape, Tyre

STEREO_KEYS = ("isStereo", "stereoSpacing", "uuStereoSpacing")
"""Keys of stereo vision."""

TRACKS = {"front": ("FRFlipper", "FLFlipper"), "rear": ("RRFlipper", "RLFlipper")}
"""Flippers at each end of a robot."""

MAX_TIRES = 12
"""Largest number of tires of one flipper; more only cost time."""

MOTOR_TORQUE, STEER_TORQUE, SUSP_STIFFNESS, SUSP_DAMPING = 20.0, 1000.0, 150.0, 15.0
"""The original's defaults (manual 14.4.2.3), equivalent to our robots' own values."""

KARMA_SCALE = 50.0
"""Length of Karma's unit in Unreal units (manual 14.4.2.3)."""

DEFAULT_SUSPENSION_TRAVEL = (-KARMA_SCALE / UU_PER_METRE, KARMA_SCALE / UU_PER_METRE)
"""The original's default of a suspension's travel [m]."""

TYRES = ("wheel", "track")
"""Surfaces of tyres."""

ParameterLines = Mapping[str, Line]
"""Last line of each key, by the key in lower case."""


def with_stereo(robot: RobotSpec, figures: Mapping[str, Line], units: Units, notes: WarningLog) -> RobotSpec:
    """Return a robot whose first camera has its section's stereo settings.

    As in the original, isStereo switches it on and the spacing is half the distance of the eyes; the spacing
    in metres has priority over that in Unreal units.

    Raises:
        SpecError: A value of the wrong kind, or a spacing of 0; names file and line.
    """
    switch, metres, unreal = (figures.get(key.lower()) for key in STEREO_KEYS)
    given: dict[str, object] = {}
    if switch is not None:
        given["IsStereo"] = as_bool(switch, switch.value, "isStereo")
    if (line := metres or unreal) is not None:
        spacing = as_vector(line, line.value, line.key)
        if not any(spacing):
            fail(line, f"{line.key} is 0 along all axes", "half the distance of the eyes, as (Y=0.05)")
        if metres is None:
            # This key is in Unreal units, whatever the section's other lengths are in.
            spacing = replace(units, by_uu=True).position(spacing)
        given["StereoSpacing"] = tuple(zip("XYZ", spacing, strict=True))
    first = next((line for line in (switch, metres, unreal) if line is not None), None)
    if first is None:
        return robot
    if not robot.cameras:
        notes.add(first, f"{first.key} changes nothing: {robot.name} has no camera")
        return robot
    main, *others = robot.cameras
    kept: Options = tuple(
        (key, value) for key, value in main.options if field_name(key) not in map(field_name, given)
    )
    return replace(robot, cameras=(replace(main, options=(*kept, *given.items())), *others))


def read_tracks(robot: RobotSpec, lines: Mapping[str, Line]) -> RobotSpec:
    """Return a robot with given numbers of tires on the flippers of its ends.

    Args:
        robot: A robot whose flippers carry wheels named `FRFlipperWheel1` and so on, driven as tracks.
        lines: `NumTires` lines by end.

    Raises:
        SpecError: A robot without such flippers, or no whole number from 1 to 12; names file and line.
    """
    for end, line in lines.items():
        count = as_whole(line, 1, MAX_TIRES)
        for flipper in TRACKS[end]:
            wheels = [part for part in robot.parts if _belongs(part, flipper)]
            if not wheels or not isinstance(robot.drive, Tracks):
                fail(line, f"{robot.name} has no tires on {flipper}", "a robot with tracked flippers")
            robot = _retracked(robot, flipper, wheels, count)
    return robot


def _belongs(part: Part, flipper: str) -> bool:
    return (
        part.is_wheel
        and part.parent == flipper
        and re.fullmatch(rf"{flipper}Wheel\d+", part.name) is not None
    )


def _retracked(robot: RobotSpec, flipper: str, wheels: list[Part], count: int) -> RobotSpec:
    """Return a robot with a new, evenly spaced row of wheels on one flipper, shrinking to the tip.

    Their total mass stays.
    """
    last = wheels[-1]
    tip, first = last.shapes[0].size[0], robot.wheel_radius
    fresh: list[Part] = []
    for i in range(1, count + 1):
        share = i / count
        fresh.append(_scaled(last, f"{flipper}Wheel{i}", share, (first + (tip - first) * share) / tip))
    before, after = (sum(part.shapes[0].mass for part in row) for row in (wheels, fresh))
    fresh = [
        replace(p, shapes=(replace(p.shapes[0], mass=p.shapes[0].mass * before / after),)) for p in fresh
    ]
    # In the old place: bodies, joints and messages follow the order of parts.
    at = robot.parts.index(wheels[0])
    kept = [part for part in robot.parts if part not in wheels]
    robot = replace(robot, parts=(*kept[:at], *fresh, *kept[at:]))
    return replace(robot, drive=_redriven(robot, {part.name for part in wheels}, [p.name for p in fresh]))


def _scaled(wheel: Part, name: str, share: float, size: float) -> Part:
    """Return a wheel nearer to the hinge, scaled by `size`: same belt speed, same pull."""
    tyre, motor = wheel.shapes[0], wheel.motor
    radius, width = tyre.size[0] * size, tyre.size[1]
    if motor is not None:
        motor = replace(
            motor,
            max_speed=motor.max_speed / size,
            torque=motor.torque * size,
            # The same speed and pull at the belt: speed falls with the radius, torque grows with it, and
            # gains and inertia, which are torque over angle, with its square.
            stiffness=motor.stiffness * size**2,
            damping=motor.damping * size**2,
            armature=motor.armature * size**2,
        )
    x, y, z = (share * coordinate for coordinate in wheel.at)
    tyre = replace(tyre, size=(radius, width), mass=tyre.mass * size**2)
    return replace(wheel, name=name, at=(x, y, z), motor=motor, shapes=(tyre,))


def _redriven(robot: RobotSpec, gone: set[str], fresh: list[str]) -> Tracks:
    """Return the drive with wheels replaced on their side."""
    drive = robot.drive
    assert isinstance(drive, Tracks)
    radii = {part.name: part.shapes[0].size[0] for part in robot.wheels}

    def side(names: tuple[str, ...]) -> tuple[str, ...]:
        if not gone & set(names):
            return names
        return (*(name for name in names if name not in gone), *fresh)

    left, right = side(drive.left), side(drive.right)
    # One belt speed for all wheels of a track: smaller ones spin faster.
    ratios = tuple(drive.radius / radii[name] for name in (*left, *right))
    return replace(drive, left=left, right=right, ratios=ratios)


def set_weight(robot: RobotSpec, value: float) -> RobotSpec:
    """Set Weight: mass in CONF, without effect on motion (manual 12.1.2)."""
    return replace(robot, mass=value)


def set_chassis_mass(robot: RobotSpec, value: float) -> RobotSpec:
    """Set ChassisMass: Karma's unit has no kilograms; its default 1 is the chassis as described."""
    solids = tuple(replace(shape, mass=shape.mass * value) for shape in robot.chassis)
    inertia = robot.inertia and replace(
        robot.inertia,
        mass=robot.inertia.mass * value,
        moments=tuple(moment * value for moment in robot.inertia.moments),
    )
    return replace(robot, chassis=solids, inertia=inertia)


def set_max_torque(robot: RobotSpec, value: float) -> RobotSpec:
    """Set MaxTorque: torque in CONF; wheels scale in proportion, and it limits MotorTorque."""
    # MaxTorque is in the original's units, which no motor of ours has: only its ratio to the usual one
    # counts.
    share = value / robot.max_torque
    # A hinge's torque is the smaller of MotorTorque and MaxTorque, here with MotorTorque at its default.
    cut = min(value, MOTOR_TORQUE) / min(robot.max_torque, MOTOR_TORQUE)
    robot = _motors(_motors(robot, _is_wheel, torque=share), _is_hinge, torque=cut)
    return replace(robot, max_torque=value)


def set_spin_speed(robot: RobotSpec, value: float) -> RobotSpec:
    """Set maxSpinSpeed (KRobot.uc): highest speed of the wheels [rad/s]."""
    drive = robot.drive
    if "max_spin" not in {field.name for field in fields(drive)}:  # type: ignore[arg-type]
        return robot
    share = value / drive.max_spin  # type: ignore[attr-defined]
    return replace(_motors(robot, _is_wheel, speed=share), drive=replace(drive, max_spin=value))  # type: ignore[type-var]


def set_motor_torque(robot: RobotSpec, value: float) -> RobotSpec:
    """Set MotorTorque: scales the robot's own joints except wheels; MaxTorque limits it."""
    limit = robot.max_torque
    return _motors(robot, _is_hinge, torque=min(value, limit) / min(MOTOR_TORQUE, limit))


def set_motor_speed(robot: RobotSpec, value: float) -> RobotSpec:
    """Set MotorSpeed: highest speed of those joints [rad/s]."""
    return _each_part(
        robot,
        lambda part: _is_hinge(part) and part.joint == "hinge",
        lambda part: replace(part, motor=part.motor and replace(part.motor, max_speed=value)),
    )


def set_steer_torque(robot: RobotSpec, value: float) -> RobotSpec:
    """Set SteerTorque: scales the steering joints."""
    return _motors(robot, _is_steering, torque=value / STEER_TORQUE)


def set_steer_speed(robot: RobotSpec, value: float) -> RobotSpec:
    """Set SteerSpeed: highest speed of those joints, in Unreal's angles a second."""
    return _each_part(
        robot,
        _is_steering,
        lambda part: replace(part, motor=part.motor and replace(part.motor, max_speed=value / UU_PER_RADIAN)),
    )


def set_stiffness(robot: RobotSpec, value: float) -> RobotSpec:
    """Set SuspStiffness: scales the springs of suspensions; their load at rest stays."""
    return _springs(robot, stiffness=value / SUSP_STIFFNESS)


def set_susp_damping(robot: RobotSpec, value: float) -> RobotSpec:
    """Set SuspDamping: scales the dampers of suspensions."""
    return _springs(robot, damping=value / SUSP_DAMPING)


def set_tyre(robot: RobotSpec, **figures: float) -> RobotSpec:
    """Set Tire...: parameters of all tyres with ground contact, including tracks' wheels."""

    def changed(shape: Shape) -> Shape:
        if shape.surface not in TYRES:
            return shape
        # Its speed too: whether a tyre is the stock one depends on the robot's drive.
        stock = Tyre(speed=robot.drive.top_speed * UU_PER_METRE)
        tyre = replace(shape.tyre or stock, **figures)
        return replace(shape, tyre=None if tyre == stock else tyre)

    return _each_part(
        robot,
        lambda part: part.is_wheel,
        lambda part: replace(part, shapes=tuple(changed(shape) for shape in part.shapes)),
    )


def set_high(robot: RobotSpec, value: float, uu_per_metre: float) -> RobotSpec:
    """Set SuspHighLimit: upward travel of a suspension."""
    return _travel(robot, value * KARMA_SCALE / uu_per_metre, upper=True)


def set_low(robot: RobotSpec, value: float, uu_per_metre: float) -> RobotSpec:
    """Set SuspLowLimit: downward travel of a suspension, negative."""
    return _travel(robot, value * KARMA_SCALE / uu_per_metre, upper=False)


def set_centre(robot: RobotSpec, at: Vec3) -> RobotSpec:
    """Set CenterOfMass (ours): gather the chassis' mass in a box of half the robot's size around a point."""
    mass = sum(shape.mass for shape in robot.chassis) if robot.inertia is None else robot.inertia.mass
    x, y, z = (edge / 4 for edge in robot.dimensions)
    # A box, not a point: MuJoCo needs moments of inertia about all axes.
    ballast = Shape(kind="box", size=(x, y, z), at=at, mass=mass, surface="fixture", rgba=(0, 0, 0, 0))
    light = tuple(replace(shape, mass=0.0) for shape in robot.chassis)
    return replace(robot, chassis=(*light, ballast), inertia=None)


SETTERS: dict[str, tuple[float, Callable[[RobotSpec, float], RobotSpec]]] = {
    "msgTimer": (0.0, lambda robot, value: replace(robot, msg_timer=value)),
    "batteryLife": (0.0, lambda robot, value: replace(robot, battery_life=value)),
    "Payload": (-1e-9, lambda robot, value: replace(robot, payload=value)),
    "Weight": (0.0, set_weight),
    "ChassisMass": (0.0, set_chassis_mass),
    "MaxTorque": (0.0, set_max_torque),
    "MotorTorque": (0.0, set_motor_torque),
    "MotorSpeed": (0.0, set_motor_speed),
    "maxSpinSpeed": (0.0, set_spin_speed),
    "SteerTorque": (0.0, set_steer_torque),
    "SteerSpeed": (0.0, set_steer_speed),
    "SuspStiffness": (0.0, set_stiffness),
    "SuspDamping": (0.0, set_susp_damping),
    "TireRollFriction": (0.0, lambda robot, value: set_tyre(robot, roll_friction=value)),
    "TireLateralFriction": (0.0, lambda robot, value: set_tyre(robot, lateral_friction=value)),
    "TireRollSlip": (0.0, lambda robot, value: set_tyre(robot, roll_slip=value)),
    "TireLateralSlip": (0.0, lambda robot, value: set_tyre(robot, lateral_slip=value)),
    "TireMinSlip": (0.0, lambda robot, value: set_tyre(robot, min_slip=value)),
    "TireSlipRate": (-1e-9, lambda robot, value: set_tyre(robot, slip_rate=value)),
    "TireSoftness": (-1e-9, lambda robot, value: set_tyre(robot, softness=value)),
    "TireRestitution": (-1e-9, lambda robot, value: set_tyre(robot, restitution=value)),
}
"""Keys of one number: exclusive lower limit, and setter; in the order of application."""
LENGTHS: dict[str, Callable[[RobotSpec, float, float], RobotSpec]] = {
    "SuspHighLimit": set_high,
    "SuspLowLimit": set_low,
}
"""Keys of one number in Karma's scale, with their setters."""


def apply_parameters(
    robot: RobotSpec, figures: ParameterLines, units: Units, notes: WarningLog, skip: set[str]
) -> RobotSpec:
    """Return a robot with the parameters of its section; one without effect becomes a warning.

    Args:
        robot: The robot.
        figures: Its section's keys.
        units: Units of its positions.
        notes: Log of warnings.
        skip: Keys, in lower case, that have been used already.

    Raises:
        SpecError: A value that is no number, or too small; names file and line.
    """
    # In the table's order, not the file's: MaxTorque limits MotorTorque whichever is written first.
    steps = [(key, low, set_to) for key, (low, set_to) in SETTERS.items()]
    scale = units.uu_per_metre
    steps += [(key, -np.inf, partial(_set_length, set_to, scale)) for key, set_to in LENGTHS.items()]
    for key, low, set_to in steps:
        line = figures.get(key.lower())
        if line is None or key.lower() in skip:
            continue
        value = as_number(line, line.value, key, above=low)
        before, robot = robot, set_to(robot, value)
        if robot == before and not _is_set(before, key, value):
            notes.add(line, f"{key} changes nothing: {robot.name} has no joint that it is about")
    if (line := figures.get("centerofmass")) is not None:
        robot = set_centre(robot, units.position(as_vector(line, line.value, "CenterOfMass")))
    if (line := figures.get("babsolutecamera")) is not None:
        robot = replace(robot, absolute_camera=as_bool(line, line.value, "bAbsoluteCamera"))
    return robot


def _set_length(
    set_to: Callable[[RobotSpec, float, float], RobotSpec], scale: float, robot: RobotSpec, value: float
) -> RobotSpec:
    return set_to(robot, value, scale)


def _is_set(robot: RobotSpec, key: str, value: float) -> bool:
    """Return whether a key has its value already, rather than no effect at any value."""
    if key in SETTERS:
        # Tried with another value than the present one.
        return SETTERS[key][1](robot, value * 1.5 + 0.1) != robot
    return LENGTHS[key](robot, value + 1.0, 1.0) != robot


def _is_wheel(part: Part) -> bool:
    return part.is_wheel and part.motor is not None


def _is_steering(part: Part) -> bool:
    return part.name.endswith(STEER_SUFFIX)


def _is_hinge(part: Part) -> bool:
    return part.motor is not None and not part.is_wheel and not _is_steering(part)


def _each_part(robot: RobotSpec, pick: Callable[[Part], bool], change: Callable[[Part], Part]) -> RobotSpec:
    return replace(robot, parts=tuple(change(part) if pick(part) else part for part in robot.parts))


def _motors(
    robot: RobotSpec, pick: Callable[[Part], bool], torque: float = 1.0, speed: float = 1.0
) -> RobotSpec:
    """Return a robot with some motors' torques and speeds multiplied."""

    def changed(part: Part) -> Part:
        motor = part.motor
        if motor is None:
            return part
        # None stays None: such a motor has no curve to scale.
        stall = motor.stall_torque and motor.stall_torque * torque
        motor = replace(
            motor, torque=motor.torque * torque, max_speed=motor.max_speed * speed, stall_torque=stall
        )
        return replace(part, motor=motor)

    return _each_part(robot, pick, changed)


def _springs(robot: RobotSpec, stiffness: float = 1.0, damping: float = 1.0) -> RobotSpec:
    def changed(part: Part) -> Part:
        spring = part.spring
        if spring is None:
            return part
        spring = replace(spring, stiffness=spring.stiffness * stiffness, damping=spring.damping * damping)
        return replace(part, spring=spring)

    return _each_part(robot, _is_suspension, changed)


def _is_suspension(part: Part) -> bool:
    return part.name.endswith(SUSPENSION_SUFFIX)


def _travel(robot: RobotSpec, limit: float, *, upper: bool) -> RobotSpec:
    """Return a robot whose suspensions have one limit of their travel changed [m], up positive."""

    def changed(part: Part) -> Part:
        low, high = part.limits or DEFAULT_SUSPENSION_TRAVEL
        # A joint that runs downwards has its upward travel at the low end.
        if np.dot(part.axis, UP) > 0:
            return replace(part, limits=(low, limit) if upper else (limit, high))
        return replace(part, limits=(-limit, high) if upper else (low, -limit))

    return _each_part(robot, _is_suspension, changed)
