"""All parts of a robot in one list: its own, the links of its mission packages, its effecters' parts.

To the solids of each come those of mounted effecters, and the housings of shown sensors.
"""

from dataclasses import replace
from functools import cache

import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import Vec3, mat_from_angles
from usarmjx.models.effecters import effecters_of
from usarmjx.models.types.robot import (
    CHASSIS,
    Link,
    MissionPackage,
    Motor,
    Mount,
    Part,
    RobotSpec,
    field_name,
)
from usarmjx.models.types.shapes import Shape

LINK_STIFFNESS, LINK_DAMPING, LINK_ARMATURE = 40.0, 4.0, 0.02
"""Servo of a mission package joint [N m/rad], [N m s/rad], [kg m2]: stiff for parts of some 0.5 kg."""

HOUSING_SIZE = (0.02, 0.012, 0.008)
"""Half lengths of a housing, longest along the sensor's axis [m] (chosen)."""

HOUSING_RGBA = (0.95, 0.75, 0.1, 1.0)
"""Colour of a housing."""


def part_name(package: MissionPackage, link: Link) -> str:
    """Return the name of a mission package's part: its own, or as captured: `CameraPanTilt_Link2`."""
    return link.part or f"{package.name}_Link{link.number}"


def link_frames(package: MissionPackage) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return each link's position (3,) and matrix (3, 3) in the chassis frame, USARSim's axes."""
    frames = {-1: (np.zeros(3), np.eye(3))}
    for link in package.links:
        if link.parent not in frames:
            raise SpecError(f"mission package {package.name}: link {link.number} has no parent {link.parent}")
        at, mat = frames[link.parent]
        frames[link.number] = (at + mat @ link.location, mat @ mat_from_angles(*np.array(link.orientation)))
    return frames


def link_motor(link: Link) -> Motor:
    """Return a link's motor: its own, or a small servo with the reported limits."""
    return link.motor or Motor(
        max_speed=link.max_speed,
        torque=link.max_torque,
        stiffness=LINK_STIFFNESS,
        damping=LINK_DAMPING,
        armature=LINK_ARMATURE,
    )


def _vector(array: np.ndarray) -> Vec3:
    x, y, z = array.tolist()
    return (x, y, z)


def _link_parts(package: MissionPackage) -> list[Part]:
    """Return the parts of a package's links.

    Parts are parallel to the chassis at rest (captured mounts show it); joints turn about link z.
    """
    frames, names = link_frames(package), {-1: CHASSIS}
    parts: list[Part] = []
    for link in package.links:
        names[link.number] = part_name(package, link)
        parts.append(
            Part(
                name=names[link.number],
                parent=names[link.parent],
                at=_vector(frames[link.number][0] - frames[link.parent][0]),
                axis=_vector(frames[link.number][1][:, 2]),
                joint="hinge" if link.joint == "Revolute" else "slide",
                motor=link_motor(link),
                # A lower limit above the upper one stands for none, as in CONF on the wire.
                limits=None if link.min_range > link.max_range else (link.min_range, link.max_range),
                shapes=link.shapes,
                looks=link.looks,
            )
        )
    return parts


@cache
def parts_of(robot: RobotSpec) -> tuple[Part, ...]:
    """Return all parts of a robot: its own in their order, the links of its packages, its effecters' parts.

    Parents come first. This is the order of a robot's joints everywhere. Each part has `looks`, by default
    its solids.

    Raises:
        SpecError: Two parts of one name, a part or an effecter whose parent does not exist, or a drive or an
            effecter that names a joint which is missing or has no motor.
        UnknownNameError: An effecter of an unknown type or with an unknown setting.
    """
    waiting = [*robot.parts, *(part for package in robot.packages for part in _link_parts(package))]
    own = {part.name for part in waiting}
    brought = (part for effecter in effecters_of(robot) for part in effecter.parts())
    waiting += [part for part in brought if part.name not in own]
    names = [CHASSIS, *(part.name for part in waiting)]
    doubles = {name for name in names if names.count(name) > 1}
    if doubles:
        raise SpecError(f"robot {robot.name}: several parts are called {', '.join(sorted(doubles))}")
    parts: list[Part] = []
    placed = {CHASSIS}
    while waiting:
        # Descriptions may have a part before its parent; apart from that their order stays.
        ready = next((part for part in waiting if part.parent in placed), None)
        if ready is None:
            lost = ", ".join(f"{part.name} (on {part.parent})" for part in waiting)
            raise SpecError(f"robot {robot.name}: parts without a parent: {lost}; parts: {', '.join(names)}")
        waiting.remove(ready)
        items = _item_shapes(robot, ready.name)
        # Without looks a part shows its solids; items on it are seen in both cases.
        looks = (*(ready.looks or ready.shapes), *items)
        parts.append(replace(ready, shapes=(*ready.shapes, *items), looks=looks))
        placed.add(ready.name)
    _check_joints(robot, parts)
    return tuple(parts)


def _check_joints(robot: RobotSpec, parts: list[Part]) -> None:
    motors = {part.name for part in parts if part.motor is not None}
    users = [("drive", control.joint) for control in robot.drive.joint_controls]
    for effecter in effecters_of(robot):
        mount = effecter.mount
        if mount.parent not in (CHASSIS, *(part.name for part in parts)):
            raise SpecError(f"robot {robot.name}: no part {mount.parent!r} for {mount.kind} {mount.name}")
        users += [(f"{mount.kind} {mount.name}", joint) for joint in effecter.joints]
    missing = [f"{joint} ({user})" for user, joint in users if joint not in motors]
    if missing:
        raise SpecError(f"robot {robot.name}: no motor at {', '.join(missing)}")


def _item_shapes(robot: RobotSpec, parent: str) -> tuple[Shape, ...]:
    effecters = (effecter for effecter in effecters_of(robot) if effecter.mount.parent == parent)
    return (*(shape for effecter in effecters for shape in effecter.shapes()), *housings(robot, parent))


def chassis_shapes(robot: RobotSpec) -> tuple[Shape, ...]:
    """Return the solids of the chassis, including those of effecters and shown sensors."""
    return (*robot.chassis, *_item_shapes(robot, CHASSIS))


def chassis_visuals(robot: RobotSpec) -> tuple[Shape, ...]:
    """Return the visuals of the chassis, including those of effecters and shown sensors."""
    return (*(robot.looks or robot.chassis), *_item_shapes(robot, CHASSIS))


def joint_names(robot: RobotSpec) -> tuple[str, ...]:
    """Return the joint names of a robot class, in the order of `parts_of`."""
    return tuple(part.name for part in parts_of(robot))


def is_shown(mount: Mount) -> bool:
    """Return whether a mount's settings show it; by default sensors are hidden (manual 10)."""
    values = [value for key, value in mount.all_options if field_name(key) == "hidden_sensor"]
    # Of several values of a key the last one counts, as in `resolve_settings`.
    return bool(values) and values[-1] is False


def housings(robot: RobotSpec, parent: str) -> tuple[Shape, ...]:
    """Return the housings of the sensors that are shown on a part; their front is at the mount."""
    shown = [mount for mount in robot.sensors if mount.parent == parent and is_shown(mount)]
    return tuple(_housing(mount) for mount in shown)


def _housing(mount: Mount) -> Shape:
    ahead = mat_from_angles(*mount.direction)[:, 0]
    x, y, z = (float(a - HOUSING_SIZE[0] * way) for a, way in zip(mount.at, ahead, strict=True))
    return Shape(
        kind="box",
        size=HOUSING_SIZE,
        at=(x, y, z),
        rotation=mount.direction,
        surface="fixture",
        rgba=HOUSING_RGBA,
    )
