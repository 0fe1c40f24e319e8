"""Pioneers that look all around: OmniP2AT and OmniP2DX, classes of a 2011 release (camera: manual 10.15)."""

from dataclasses import replace

from usarmjx.base.transforms import Vec3
from usarmjx.models.robots.kit import camera
from usarmjx.models.robots.packages import PACKAGES, mount_package
from usarmjx.models.robots.pioneer import P2AT, P2AT_SCANNER, P2DX, P2DX_SCANNER
from usarmjx.models.robots.pioneer_looks import at_looks, dx_looks
from usarmjx.models.spec.robot import MissionPackage, Mount, RobotSpec
from usarmjx.models.spec.shapes import Rgba, Shape

LOOKS_UP: Vec3 = (-3.1415927, 1.5707964, 0.0)
"""Direction of the camera towards the mirror above it (manual 10.15.2: Y=1.5707964, Z=-3.1415927)."""
ORANGE: Rgba = (0.88, 0.36, 0.08, 1.0)
ON_SCANNER = -0.11
"""The base stands on the scanner's housing [m] (chosen)."""


def _omni(
    base: RobotSpec, package: MissionPackage, link: int, at: Vec3, looks: tuple[Shape, ...]
) -> RobotSpec:
    pillar = mount_package(package, (at[0], at[1], at[2] + ON_SCANNER))
    eye = camera(at=(0.0, 0.0, -0.09), parent=f"{package.name}_Link{link}", direction=LOOKS_UP)
    return replace(
        base,
        name=f"Omni{base.name}",
        looks=looks,
        packages=(pillar,),
        cameras=(eye,),
        sources=(*base.sources, ("camera", "chosen")),
    )


def _sonars(robot: RobotSpec) -> list[Mount]:
    return [mount for mount in robot.sensors if mount.kind == "Sonar"]


OMNI_P2AT = _omni(
    P2AT, PACKAGES.get("OmniCamPillar"), 4, P2AT_SCANNER, at_looks(_sonars(P2AT), P2AT_SCANNER, ORANGE)
)
OMNI_P2DX = _omni(
    P2DX, PACKAGES.get("OmniCamera"), 1, P2DX_SCANNER, dx_looks(_sonars(P2DX), P2DX_SCANNER, ORANGE)
)
