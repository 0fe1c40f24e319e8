"""All parts of a robot in one list: its own parts and the links of its mission packages."""

from functools import cache

import numpy as np

from usarmjx.errors import SpecError
from usarmjx.models.spec import CHASSIS, Link, MissionPackage, Motor, Part, RobotSpec
from usarmjx.transforms import Vec3, mat_from_angles

LINK_STIFFNESS, LINK_DAMPING, LINK_ARMATURE = 40.0, 4.0, 0.02
"""Servo of a mission package joint [N m/rad], [N m s/rad], [kg m2]: stiff for parts of some 0.5 kg."""


STEER, SUSPENSION = "_Steer", "_Suspension"
"""What follows a wheel's name in the names of the joints that steer and spring it: the manual's car-wheel
joint (14.4.2.4) is one joint for all three."""


def part_name(package: MissionPackage, link: Link) -> str:
    """Return the wire's name of a mission package part (captured: `CameraPanTilt_Link2`)."""
    return f"{package.name}_Link{link.number}"


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
    """Return a link's motor: its own, or the usual small servo with the reported limits."""
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
    """Parts are parallel to the chassis at rest (captured mounts show it); joints turn about link z."""
    frames, names = link_frames(package), {-1: CHASSIS}
    parts = []
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
                limits=None if link.min_range > link.max_range else (link.min_range, link.max_range),
                shapes=link.shapes,
            )
        )
    return parts


@cache
def parts_of(robot: RobotSpec) -> tuple[Part, ...]:
    """Return all parts of a robot: its own in their order, then the links of its packages, parents first.

    This is the order of a robot's joints everywhere.

    Raises:
        SpecError: Two parts of one name, a part whose parent does not exist, or a drive that names a joint
            which is missing or has no motor.
    """
    waiting = [*robot.parts, *(part for package in robot.packages for part in _link_parts(package))]
    names = [CHASSIS, *(part.name for part in waiting)]
    doubles = {name for name in names if names.count(name) > 1}
    if doubles:
        raise SpecError(f"robot {robot.name}: several parts are called {', '.join(sorted(doubles))}")
    parts: list[Part] = []
    there = {CHASSIS}
    while waiting:
        ready = next((part for part in waiting if part.parent in there), None)
        if ready is None:
            lost = ", ".join(f"{part.name} (on {part.parent})" for part in waiting)
            raise SpecError(f"robot {robot.name}: parts without a parent: {lost}; parts: {', '.join(names)}")
        waiting.remove(ready)
        parts.append(ready)
        there.add(ready.name)
    motors = {part.name for part in parts if part.motor is not None}
    missing = [aim.joint for aim in robot.drive.aims if aim.joint not in motors]
    if missing:
        raise SpecError(f"robot {robot.name}: its drive has no motor at {', '.join(missing)}")
    return tuple(parts)


def joint_names(robot: RobotSpec) -> tuple[str, ...]:
    """Return the joint names of a robot class, in the order of `parts_of`."""
    return tuple(part.name for part in parts_of(robot))
