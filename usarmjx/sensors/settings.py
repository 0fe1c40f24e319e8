"""Settings of cameras, and payload checks; re-exports `field_name` and `resolve_settings`."""

import math
from dataclasses import dataclass, replace
from typing import Annotated

from usarmjx.base.errors import SpecError
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, Setting
from usarmjx.models.effecters import effecters_of
from usarmjx.models.types.robot import Mount, RobotSpec, field_name, resolve_settings
from usarmjx.sensors.base import SENSORS, SensorSettings

__all__ = ["CameraSettings", "field_name", "resolve_camera", "resolve_settings"]

DISTORTION_LIMITS = Setting(ge=-0.3, le=1.0)
"""Limits of a distortion coefficient."""
MAX_SUPERSAMPLING = 4
"""Largest number of rays along each side of a pixel."""


@dataclass(frozen=True)
class CameraSettings:
    """Settings of a camera (manual 10.14.2, its CONF example, and 3.2.6.2).

    Attributes:
        weight: Share of the payload [kg].
        camera_def_fov: Initial horizontal field of view [rad].
        camera_min_fov: Smallest field of view [rad].
        camera_max_fov: Largest field of view [rad].
        is_stereo: Whether it has two lenses.
        stereo_spacing: Half the offset from the left to the right lens, in USARSim's axes [m].
        omni: Whether it faces a parabolic mirror; the packages of manual 10.15 always do.
        exposure: Factor on the brightness of its pictures. Own key, like the following.
        distortion_k1: Brown's radial distortion: coefficient of the squared distance from the centre, in
            focal lengths; negative is barrel distortion.
        distortion_k2: Coefficient of the fourth power.
        image_noise: Standard deviation of the noise of each colour of each pixel, of 255.
        supersampling: Rays along each side of a pixel, for smooth edges.
    """

    weight: Annotated[float, NOT_NEGATIVE] = 0.4
    camera_def_fov: float = 0.8727
    camera_min_fov: float = 0.3491
    camera_max_fov: float = 2.0944
    is_stereo: bool = False
    stereo_spacing: tuple[tuple[str, float], ...] = (("Y", 0.05),)
    omni: bool = False
    exposure: Annotated[float, POSITIVE] = 1.0
    distortion_k1: Annotated[float, DISTORTION_LIMITS] = 0.0
    distortion_k2: Annotated[float, DISTORTION_LIMITS] = 0.0
    image_noise: Annotated[float, NOT_NEGATIVE] = 0.0
    supersampling: Annotated[int, Setting(ge=1, le=MAX_SUPERSAMPLING)] = 1


def resolve_camera(mount: Mount, owner: str) -> CameraSettings:
    """Return the settings of a camera; a default field of view is clamped to the limits.

    So equal CameraMinFov and CameraMaxFov make a camera of that field of view (manual 10.14.2).

    Raises:
        UnknownNameError: See `models.types.robot.checked`.
        SpecError: Likewise; or fields of view in the wrong order or not between 0 and pi.
    """
    settings = resolve_settings(CameraSettings, mount.all_options, owner)
    low, high = settings.camera_min_fov, settings.camera_max_fov
    if "camera_def_fov" not in {field_name(key) for key, _ in mount.options}:
        settings = replace(settings, camera_def_fov=max(low, min(high, settings.camera_def_fov)))
    if not 0 < low <= settings.camera_def_fov <= high < math.pi:
        raise SpecError(
            f"{owner}: fields of view are {low:g} to {high:g}, at first {settings.camera_def_fov:g} rad; "
            "expected 0 < CameraMinFov <= CameraDefFov <= CameraMaxFov < pi"
        )
    return settings


def carried_weight(robot: RobotSpec) -> float:
    """Return the weight of all sensors, cameras and effecters of a robot class [kg].

    It is not added to any body: the mass of an item is in the solids of its part (manual 10, footnote 3).

    Raises:
        UnknownNameError: An item has an unknown type or setting.
    """
    weights = [_weight(mount, SENSORS.get(mount.kind).settings_class) for mount in robot.sensors]
    weights += [_weight(mount, CameraSettings) for mount in robot.cameras]
    weights += [effecter.settings.weight for effecter in effecters_of(robot)]
    return float(sum(weights))


def _weight(mount: Mount, kind: type[object]) -> float:
    settings = resolve_settings(kind, mount.all_options, f"{mount.kind} {mount.name}")
    return getattr(settings, "weight", SensorSettings.weight)


def overload(robot: RobotSpec) -> str:
    """Return the fault if a robot carries more than its payload, otherwise "".

    A payload of 0 is unknown.
    """
    load = carried_weight(robot)
    if not robot.payload or load <= robot.payload + 1e-9:
        return ""
    items = len(robot.sensors) + len(robot.cameras) + len(robot.effecters)
    return f"{robot.name} carries {load:.2f} kg of {items} items, its payload is {robot.payload:.2f} kg"
