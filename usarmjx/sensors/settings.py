"""Settings of cameras; `field_name` and `resolve` are those of `models.settings`, here for sensors."""

from dataclasses import dataclass

from usarmjx.models.settings import field_name, resolve

__all__ = ["CameraSettings", "field_name", "resolve"]


@dataclass(frozen=True)
class CameraSettings:
    """Weight of a camera [kg] and its fields of view [rad] (manual 10.14.2, and its CONF example)."""

    weight: float = 0.4
    camera_def_fov: float = 0.8727
    camera_min_fov: float = 0.3491
    camera_max_fov: float = 2.0944
