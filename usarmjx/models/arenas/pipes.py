"""Pipes, which lie about or are the edges of steps.

A pipe is two square bars across each other: their eight edges lie on its circle. Not a cylinder, as engine
`jax` has no contacts of cylinders with wheels; and with sides to lie on it does not roll away.
"""

import math

from usarmjx.base.transforms import Vec3
from usarmjx.models.arenas.elements import CELL, WOOD, block
from usarmjx.models.arenas.pieces import STEEL
from usarmjx.models.spec.arena import LooseObject
from usarmjx.models.spec.shapes import ZERO, Shape

PIPE = 0.06
"""Outer diameter of a 2 inch pipe [m]."""
PIPE_MASS = 5.4
"""Of a metre of it, in steel [kg]."""
EDGE = 0.11
"""Outer diameter of a 4 inch pipe [m]."""
FLAT = math.cos(math.pi / 8)
"""How high the axis of a pipe is that lies on a side, over its radius."""


def _bars(
    at: Vec3, length: float, diameter: float, yaw: float = 0.0, mass: float = 0.0, surface: str = "ground"
) -> tuple[Shape, ...]:
    half = diameter / math.sqrt(8)
    return tuple(
        Shape(
            kind="box",
            size=(length / 2, half, half),
            at=at,
            rotation=(roll, 0.0, yaw),
            mass=mass / 2,
            surface=surface,
            rgba=STEEL,
        )
        for roll in (math.pi / 8, 3 * math.pi / 8)
    )


def pipe(
    at: tuple[float, float], length: float, *, diameter: float = PIPE, z: float = 0.0, yaw: float = 0.0
) -> tuple[Shape, ...]:
    """Return a fixed pipe along `yaw` whose underside is at height `z` [m]; `at` is its middle."""
    return _bars((*at, z + diameter / 2 * FLAT), length, diameter, yaw)


def loose_pipe(
    name: str, at: tuple[float, float], length: float, *, z: float = 0.0, yaw: float = 0.0
) -> LooseObject:
    """Return a loose pipe of steel along `yaw` whose underside is at height `z` [m]."""
    shapes = _bars(ZERO, length, PIPE, mass=PIPE_MASS * length, surface="loose")
    return LooseObject(name=name, at=(*at, z + PIPE / 2 * FLAT), rotation=(0.0, 0.0, yaw), shapes=shapes)


def pipe_steps(
    foot: tuple[float, float], uphill: float, count: int, *, rise: float = 0.2, width: float = CELL
) -> tuple[Shape, ...]:
    """Return steps half a cell deep whose edges are pipes, as those of ASTM E2802's hurdles (sizes chosen).

    The upper side of each pipe is level with its step.

    Args:
        foot: Middle of the first step's face [m].
        uphill: Direction of climb [rad].
        count: Number of steps.
        rise: Height of each [m].
        width: Of the steps [m].
    """
    along = (math.cos(uphill), math.sin(uphill))
    shapes: list[Shape] = []
    for i in range(count):
        top, near, far = (i + 1) * rise, i * CELL / 2, count * CELL / 2
        middle = (near + far) / 2
        at = (foot[0] + middle * along[0], foot[1] + middle * along[1])
        edge = (foot[0] + near * along[0], foot[1] + near * along[1])
        low = top - EDGE * FLAT
        shapes.append(block(at, (far - near, width, top), yaw=uphill, rgba=WOOD))
        shapes.extend(pipe(edge, width, diameter=EDGE, z=low, yaw=uphill + math.pi / 2))
    return tuple(shapes)
