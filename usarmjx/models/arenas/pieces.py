"""Pieces of buildings and things that lie about, which several arenas need."""

import math

from usarmjx.base.transforms import Vec3
from usarmjx.models.arenas.elements import WOOD, block
from usarmjx.models.spec.arena import LooseObject, SegmentMotion
from usarmjx.models.spec.shapes import OPAQUE, Rgba, Shape

CONCRETE: Rgba = (0.65, 0.65, 0.62, 1.0)
STEEL: Rgba = (0.45, 0.48, 0.52, 1.0)
BRICK: Rgba = (0.6, 0.28, 0.2, 1.0)
CARDBOARD: Rgba = (0.72, 0.55, 0.36, 1.0)
PANE: Rgba = (0.6, 0.8, 0.9, 0.35)
SILVER: Rgba = (0.8, 0.85, 0.9, 1.0)
MESHWORK: Rgba = (0.75, 0.75, 0.2, 0.6)


def span(
    low: Vec3, high: Vec3, rgba: Rgba = CONCRETE, *, surface: str = "wall", material: str = OPAQUE
) -> Shape:
    """Return the box between its lowest and its highest corner [m]."""
    x, y, z = ((a + b) / 2 for a, b in zip(low, high, strict=True))
    half_x, half_y, half_z = ((b - a) / 2 for a, b in zip(low, high, strict=True))
    return Shape(
        kind="box",
        size=(half_x, half_y, half_z),
        at=(x, y, z),
        surface=surface,
        material=material,
        rgba=rgba,
    )


def waving(arm: str = "RightArm", rate: float = 2.0) -> tuple[SegmentMotion, ...]:
    """Return the motion of a victim that waves with a raised arm; `rate` is how fast it turns [rad/s]."""
    out = 0.5 if arm == "LeftArm" else -0.5
    move = SegmentMotion(
        name=arm, initial=(-2.7, 0.0, out), final=(-2.7, 0.0, -0.8 * out), rates=(0.0, 0.0, rate)
    )
    return (move,)


def table(at: tuple[float, float], size: Vec3, rgba: Rgba = WOOD) -> tuple[Shape, ...]:
    """Return a table of full lengths `size`: a top of 5 cm on two ends of 5 cm, open along x."""
    x, y = at
    length, width, height = size
    ends = (
        block((x + side * (length - 0.05) / 2, y), (0.05, width, height - 0.05), surface="wall", rgba=rgba)
        for side in (-1, 1)
    )
    return (block(at, (length, width, 0.05), z=height - 0.05, surface="wall", rgba=rgba), *ends)


def loose_box(
    name: str,
    at: tuple[float, float],
    size: Vec3,
    mass: float,
    *,
    z: float = 0.0,
    yaw: float = 0.0,
    rgba: Rgba = CARDBOARD,
) -> LooseObject:
    """Return a loose box of full lengths `size` [m] whose underside is at height `z`."""
    half_x, half_y, half_z = (length / 2 for length in size)
    shape = Shape(kind="box", size=(half_x, half_y, half_z), mass=mass, surface="loose", rgba=rgba)
    return LooseObject(name=name, at=(*at, z + half_z), rotation=(0.0, 0.0, yaw), shapes=(shape,))


def brick(name: str, at: tuple[float, float], *, z: float = 0.0, yaw: float = 0.0) -> LooseObject:
    """Return a loose clay brick of 215 x 102 x 65 mm (a common format) and 2.5 kg."""
    return loose_box(name, at, (0.215, 0.102, 0.065), 2.5, z=z, yaw=yaw, rgba=BRICK)


def drum(
    name: str, at: tuple[float, float], mass: float, radius: float = 0.2, height: float = 0.6
) -> LooseObject:
    """Return a loose drum that stands: two boxes across each other make its eight sides.

    Eight corners instead of a round wall, as engine `jax` cannot have cylinders touch each other.
    """
    half = radius * math.cos(math.pi / 8)
    shapes = tuple(
        Shape(
            kind="box",
            size=(half, half, height / 2),
            rotation=(0.0, 0.0, yaw),
            mass=mass / 2,
            surface="loose",
            rgba=STEEL,
        )
        for yaw in (0.0, math.pi / 4)
    )
    return LooseObject(name=name, at=(*at, height / 2), shapes=shapes)
