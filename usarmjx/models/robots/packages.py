"""Mission packages by class name (`USARMisPkg.<name>`), for robots and for ini files that mount them."""

from dataclasses import replace

from usarmjx.base.registry import Registry
from usarmjx.base.transforms import Vec3
from usarmjx.models.robots.kit import BLACK, DARK, STEEL, ball, drum, pan_tilt, rod
from usarmjx.models.types.robot import Link, MissionPackage
from usarmjx.models.types.shapes import ZERO, Shape

GLASSY = (0.75, 0.8, 0.85, 1.0)
PILLAR_STEP = 0.1
"""Height of one centre link of the pillar [m] (chosen)."""


def _fixed(number: int, parent: int, location: Vec3, *shapes: Shape, looks: tuple[Shape, ...] = ()) -> Link:
    """Return a link that does not move: both of its limits are 0."""
    return Link(
        number=number,
        parent=parent,
        location=location,
        orientation=ZERO,
        max_speed=0.0,
        max_torque=20.0,
        min_range=0.0,
        max_range=0.0,
        shapes=shapes,
        looks=looks,
    )


def _omni_visuals() -> tuple[Shape, ...]:
    """Return the camera on its base, and above it the mirror, rounded below, on the staves of its tube."""
    corners = [(0.042 * x, 0.042 * y) for x, y in ((1, 0), (-0.5, 0.866), (-0.5, -0.866))]
    return (
        drum(0.05, 0.015, (0.0, 0.0, -0.015), BLACK),
        drum(0.022, 0.02, (0.0, 0.0, -0.05), DARK),
        drum(0.012, 0.006, (0.0, 0.0, -0.075), BLACK),
        *(rod((x, y, -0.03), (x, y, -0.2), 0.0025, STEEL) for x, y in corners),
        ball((0.042, 0.042, 0.034), (0.0, 0.0, -0.198), GLASSY),
        drum(0.046, 0.012, (0.0, 0.0, -0.21), GLASSY),
        drum(0.046, 0.003, (0.0, 0.0, -0.225), BLACK),
    )


def _omni_head() -> tuple[Shape, ...]:
    """Return the base, and above it the mirror that faces the camera (manual 10.15; sizes chosen)."""
    base = Shape(
        kind="cylinder", size=(0.05, 0.015), at=(0, 0, -0.015), mass=0.3, surface="fixture", rgba=BLACK
    )
    mirror = Shape(
        kind="cylinder", size=(0.035, 0.02), at=(0, 0, -0.2), mass=0.1, surface="fixture", rgba=GLASSY
    )
    return base, mirror


def omni_pillar(centre_links: int = 2) -> MissionPackage:
    """Return the pillar with the omnidirectional camera: bottom, centre and top links (manual 10.15.2)."""
    rod = Shape(
        kind="cylinder",
        size=(0.02, PILLAR_STEP / 2),
        at=(0, 0, -PILLAR_STEP / 2),
        mass=0.2,
        surface="fixture",
        rgba=BLACK,
    )
    step = (0.0, 0.0, -PILLAR_STEP)
    links = [_fixed(1, -1, ZERO, rod)]
    links += [_fixed(2 + i, 1 + i, step, rod) for i in range(centre_links)]
    links.append(_fixed(2 + centre_links, 1 + centre_links, step, *_omni_head(), looks=_omni_visuals()))
    return MissionPackage(name="OmniCamPillar", links=tuple(links))


def mount_package(package: MissionPackage, location: Vec3, name: str = "") -> MissionPackage:
    """Return a package at a position on the chassis, under another name if given."""
    # Other links are placed on their parents, and follow.
    links = tuple(
        replace(link, location=tuple(a + b for a, b in zip(link.location, location, strict=True)))
        if link.parent == -1
        else link
        for link in package.links
    )
    return replace(package, name=name or package.name, links=links)


PACKAGES: Registry[MissionPackage] = Registry("mission package")
"""Mission packages by name."""
for _package in (
    pan_tilt(ZERO),
    MissionPackage(name="OmniCamera", links=(_fixed(1, -1, ZERO, *_omni_head(), looks=_omni_visuals()),)),
    omni_pillar(),
):
    PACKAGES.add(_package.name, _package)
