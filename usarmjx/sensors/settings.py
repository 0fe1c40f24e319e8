"""Settings of cameras; `field_name` and `resolve_settings` are those of `models.spec.settings`."""

from dataclasses import dataclass

from usarmjx.models.spec.settings import field_name, resolve_settings

__all__ = ["CameraSettings", "field_name", "resolve_settings"]


@dataclass(frozen=True)
class CameraSettings:
    """Settings of a camera (manual 10.14.2, its CONF example, and 3.2.6.2).

    Attributes:
        weight: Adds to the payload [kg].
        camera_def_fov: Horizontal field of view that it starts with [rad].
        camera_min_fov: Smallest one [rad].
        camera_max_fov: Largest one [rad].
        is_stereo: Whether it has two eyes.
        stereo_spacing: Half the way from the left eye to the right one, in USARSim's axes [m].
        omni: Whether it looks into a parabolic mirror; those on the packages of manual 10.15 do anyway.
    """

    weight: float = 0.4
    camera_def_fov: float = 0.8727
    camera_min_fov: float = 0.3491
    camera_max_fov: float = 2.0944
    is_stereo: bool = False
    stereo_spacing: tuple[tuple[str, float], ...] = (("Y", 0.05),)
    omni: bool = False
