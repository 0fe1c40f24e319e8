"""Turning and zooming a robot's camera: which link of its package pans, which tilts, and which way."""

import math
from dataclasses import dataclass

from usarmjx.console.knowledge import Knowledge, PackageLink

ANGLE_STEP_DEGREES = 10.0
"""So far a key turns the camera (manual 5.2.5.1) [degrees]."""
ZOOM_FACTOR = 0.8
"""Zooming in makes the field of view so many times as wide."""
STEEP = 0.7
"""An axis counts as upright, or as lying across, if so much of it is."""

LinkAxis = tuple[float, float, float]


@dataclass
class CameraAim:
    """Aims the first camera of a robot, or its first package that can be aimed.

    Attributes:
        knowledge: What is known of the robot.
        targets: Where links were sent last [rad], by package and number.
    """

    knowledge: Knowledge

    def __post_init__(self) -> None:
        """Nothing has been sent anywhere yet."""
        self.targets: dict[tuple[str, int], float] = {}

    def pan(self, left: float) -> list[str]:
        """Turn the camera so many steps to the left."""
        # About an axis that points down (z of the wire) a positive angle turns to the right.
        return self._turn(axis=2, steps=-left)

    def tilt(self, up: float) -> list[str]:
        """Turn it so many steps up."""
        # About the wire's y, to the right, a positive angle lifts.
        return self._turn(axis=1, steps=up)

    def zoom(self, steps: int) -> list[str]:
        """Zoom in, or out."""
        known = self.knowledge
        name = next(iter(known.fovs), "")
        if not name:
            return []
        low, high = known.fov_limits.get(name, (0.0, math.pi))
        fov = min(max(known.fovs[name] * ZOOM_FACTOR**steps, low), high)
        known.fovs[name] = fov
        return [f"SET {{Type Camera}} {{Name {name}}} {{FOV {fov:.4f}}}"]

    def _turn(self, axis: int, steps: float) -> list[str]:
        package = self._package()
        for number, link in self.knowledge.packages.get(package, {}).items():
            along = link_axis(self.knowledge.packages[package], number)[axis]
            if abs(along) < STEEP:
                continue
            step = math.copysign(math.radians(ANGLE_STEP_DEGREES), along) * steps
            low, high = link.limits or (-math.inf, math.inf)
            target = min(max(self.targets.get((package, number), link.value) + step, low), high)
            self.targets[package, number] = target
            return [f"MISPKG {{Name {package}}} {{Link {number}}} {{Value {target:.4f}}} {{Order 0}}"]
        return []

    def _package(self) -> str:
        """Return the package that carries the first camera; else one that is called after it."""
        known = self.knowledge
        for name in known.names("Camera"):
            package, link, _ = known.mounts.get(("camera", name.lower()), "").rpartition("_Link")
            if link and package in known.packages:
                return package
        return next((name for name in known.packages if "pantilt" in name.lower()), "")


def link_axis(links: dict[int, PackageLink], number: int) -> LinkAxis:
    """Return the axis of a link in the robot's frame on the wire, its package at rest."""
    axis: LinkAxis = (0.0, 0.0, 1.0)
    seen: set[int] = set()
    while number in links and number not in seen:
        seen.add(number)
        axis = _rotate(links[number].orientation, axis)
        number = links[number].parent
    return axis


def _rotate(angles: tuple[float, ...], vector: LinkAxis) -> LinkAxis:
    """Return a vector turned by roll, pitch and yaw [rad], in this order about the fixed axes."""
    roll, pitch, yaw = (*angles, 0.0, 0.0, 0.0)[:3]
    x, y, z = vector
    y, z = y * math.cos(roll) - z * math.sin(roll), y * math.sin(roll) + z * math.cos(roll)
    x, z = x * math.cos(pitch) + z * math.sin(pitch), -x * math.sin(pitch) + z * math.cos(pitch)
    x, y = x * math.cos(yaw) - y * math.sin(yaw), x * math.sin(yaw) + y * math.cos(yaw)
    return x, y, z
