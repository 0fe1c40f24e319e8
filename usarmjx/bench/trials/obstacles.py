"""How difficult the obstacles of generated arenas are: how often a robot crosses them, and how fast."""

from dataclasses import dataclass

from usarmjx.bench.trials.driver import Trial
from usarmjx.models.arenas.elements import CELL
from usarmjx.models.arenas.lanes import lane_of
from usarmjx.models.build.reach import footprint_of
from usarmjx.models.generate.draw import RandomStream
from usarmjx.models.generate.obstacles import OBSTACLES, obstacle_height
from usarmjx.models.spec.robot import RobotSpec

ROW = 3
"""Obstacles one behind the other, a bare cell between two, as in rings."""
TIME = 60.0
"""For one crossing of them [s]."""


@dataclass(frozen=True)
class Crossings:
    """What a robot did at obstacles of one kind and roughness.

    Attributes:
        kind: A name of `generate.obstacles.OBSTACLES`.
        roughness: From 0 to 1.
        tries: Lanes with other draws that it was sent through once each.
        crossed: How many it got through.
        seconds: Mean simulated time of those [s].
    """

    kind: str
    roughness: float
    tries: int
    crossed: int
    seconds: float


def measure_crossings(
    kind: str, robot: RobotSpec, roughness: float, tries: int = 4, scale: float = 1.0
) -> Crossings:
    """Send a robot through lanes of three obstacles, each once.

    Args:
        kind: A name of `OBSTACLES`.
        robot: The robot's class, to which they are sized.
        roughness: How high they are, from 0 to 1.
        tries: How many lanes, each of other draws.
        scale: On the step that the robot is said to climb.

    Raises:
        UnknownNameError: No such kind.
        UsageError: The class does not drive on the ground.
    """
    make, times = OBSTACLES.get(kind), []
    height = scale * obstacle_height(footprint_of(robot), roughness)
    for number in range(tries):
        draw = RandomStream(number, f"{kind} to cross")
        shapes = [shape for i in range(ROW) for shape in make(draw, ((2 * i + 0.5) * CELL, 0.0), height, 0)]
        lane = lane_of(kind, "not a test method", f"Obstacles: {kind}", (2 * ROW - 1) * CELL, *shapes)
        ride = Trial(lane.arena, robot).follow([*lane.way(back=False)], TIME)
        if not ride.fault:
            times.append(ride.seconds)
    mean = sum(times) / len(times) if times else 0.0
    return Crossings(kind, roughness, tries, len(times), mean)
