"""What lies about in the orange and red arenas (manual 3.2.1.1): cement blocks, paper, slabs, rubble.

Fixed pieces are shapes; loose ones, which robots push about, are `LooseObject` and as heavy as real ones.
"""

import math
import random

from usarmjx.base.transforms import Vec3
from usarmjx.models.arenas.elements import STONE, WOOD, block
from usarmjx.models.arenas.pieces import CONCRETE, loose_box
from usarmjx.models.spec.arena import LooseObject
from usarmjx.models.spec.shapes import Position2D, Rgba, Shape

CINDER: Vec3 = (0.39, 0.19, 0.19)
"""A cement block [m]: 16 x 8 x 8 inches less the mortar."""
CINDER_MASS = 13.0
PLYWOOD_DENSITY = 600.0
"""Density [kg/m3]."""
PAPER: Rgba = (0.92, 0.92, 0.88, 1.0)


def cinder_block(at: Position2D, *, z: float = 0.0, yaw: float = 0.0) -> Shape:
    """Return a fixed cement block."""
    return block(at, CINDER, z=z, yaw=yaw, rgba=STONE)


def loose_cinder_block(name: str, at: Position2D, *, z: float = 0.0, yaw: float = 0.0) -> LooseObject:
    """Return a loose cement block."""
    return loose_box(name, at, CINDER, CINDER_MASS, z=z, yaw=yaw, rgba=STONE)


def loose_board(name: str, at: Position2D, size: Vec3, *, z: float = 0.0, yaw: float = 0.0) -> LooseObject:
    """Return a loose board of plywood of full lengths `size` [m]."""
    return loose_box(name, at, size, PLYWOOD_DENSITY * math.prod(size), z=z, yaw=yaw, rgba=WOOD)


def plank(at: Position2D, length: float, *, z: float = 0.0, yaw: float = 0.0) -> Shape:
    """Return a fixed plank of 38 x 89 mm, a 2 by 4."""
    return block(at, (length, 0.089, 0.038), z=z, yaw=yaw, rgba=WOOD)


def paper(at: Position2D, *, yaw: float = 0.0) -> Shape:
    """Return a stack of paper, 60 x 42 cm and 5 mm thick (chosen)."""
    return block(at, (0.6, 0.42, 0.005), yaw=yaw, rgba=PAPER)


def pallet(at: Position2D, *, z: float = 0.0, yaw: float = 0.0) -> tuple[Shape, ...]:
    """Return a pallet of 1200 x 800 x 144 mm (EN 13698-1) with a closed deck on three runners."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    runners = (
        block(
            (at[0] - side * 0.35 * sin, at[1] + side * 0.35 * cos), (1.2, 0.1, 0.1), z=z, yaw=yaw, rgba=WOOD
        )
        for side in (-1, 0, 1)
    )
    return (block(at, (1.2, 0.8, 0.044), z=z + 0.1, yaw=yaw, rgba=WOOD), *runners)


def slab(at: Vec3, size: Vec3, rotation: Vec3 = (0.0, 0.0, 0.0)) -> Shape:
    """Return a plate of concrete of full lengths `size` [m], tilted by roll, pitch and yaw [rad]."""
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    return Shape(kind="box", size=half, at=at, rotation=rotation, surface="ground", rgba=CONCRETE)


GOLDEN = math.pi * (3 - math.sqrt(5))


def rubble(at: Position2D, radius: float, height: float, count: int, *, seed: int) -> tuple[Shape, ...]:
    """Return a pile of tilted chunks, cone-shaped and without voids; the same for the same seed.

    Args:
        at: Its middle [m].
        radius: Of the ring of the outermost chunks' middles [m].
        height: About how high it is [m].
        count: Number of chunks.
        seed: Of their sizes and tilts.
    """
    draw = random.Random(seed)
    chunks: list[Shape] = []
    for i in range(count):
        out = math.sqrt(i / count)
        x, y = (radius * out * turn(i * GOLDEN) for turn in (math.cos, math.sin))
        top, below = height * (1 - 0.85 * out), 0.15
        half = (draw.uniform(0.15, 0.3), draw.uniform(0.1, 0.2), (top + below) / 2)
        tilt = (draw.uniform(-0.3, 0.3), draw.uniform(-0.3, 0.3), draw.uniform(-math.pi, math.pi))
        place = (at[0] + x, at[1] + y, (top - below) / 2)
        grey = draw.uniform(0.45, 0.7)
        chunks.append(
            Shape(
                kind="box",
                size=half,
                at=place,
                rotation=tilt,
                surface="ground",
                rgba=(grey, grey, 0.95 * grey, 1.0),
                texture="concrete",
            )
        )
    return tuple(chunks)
