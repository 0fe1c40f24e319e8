"""Small arenas for tests: quick to compile, with known answers."""

import math

from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape

RAMP = Shape(
    kind="box",
    size=(0.6, 0.6, 0.1),
    at=(1.05, 0.0, 0.055),
    rotation=(0.0, -math.radians(15), 0.0),
    surface="ground",
)
STEP = Shape(kind="box", size=(0.1, 0.5, 0.02), at=(-0.6, 2.0, 0.02), surface="ground")
WALL = Shape(kind="box", size=(0.05, 2.0, 0.5), at=(-2.0, 0.0, 0.5), surface="wall")

STARTS = tuple(
    StartPose(tag=f"S{i}", at=(0.0, 2.0 * i, 0.188), yaw=yaw)
    for i, yaw in enumerate((0.0, math.pi, 0.5, -0.5, 1.0, 2.0))
)
FLAT = ArenaSpec(name="flat", starts=STARTS, extent=((-3, 3), (-3, 3)))
COURSE = ArenaSpec(name="course", starts=STARTS, extent=((-3, 3), (-3, 3)), shapes=(RAMP, STEP, WALL))
