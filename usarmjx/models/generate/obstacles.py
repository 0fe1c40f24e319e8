"""Obstacles that robots have to cross, and their heights by measured success.

Each covers a cell from wall to wall. Their height depends on the robot's step and the roughness; `usarmjx
arena check --drive` proves them passable. `contents.place_obstacles` puts them where no way leads around.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.resources import files

from usarmjx.base.errors import SpecError
from usarmjx.base.registry import Registry
from usarmjx.models.compile.reachability import RobotFootprint
from usarmjx.models.generate.plan import CELL, DIRECTIONS
from usarmjx.models.generate.random_stream import RandomStream
from usarmjx.models.generate.structures import CONCRETE, WOOD, block, lerp, slope
from usarmjx.models.types.shapes import Position2D, Shape

MIN_HEIGHT_RATIO, MAX_HEIGHT_RATIO = 0.3, 0.95
"""Heights of steps at roughness 0 and 1, over the robot's step."""
RIDGE_SLOPE_RATE, MAX_RIDGE_SLOPE = math.radians(350), math.radians(40)
"""Slope of a ridge over the height of a step [rad/m], and the steepest [rad]."""
POSTS = 3
"""Number of posts along each side of a step field."""
BARS = 3
"""Number of bars across a way."""
MAX_OBSTACLE_SOLIDS = POSTS**2
"""Largest number of solids of one obstacle."""

Obstacle = Callable[[RandomStream, Position2D, float, int], list[Shape]]
"""Maker of an obstacle from draws, cell's middle [m], height [m] and direction in quarter turns."""

CROSSINGS_FILE = "crossings.json"
"""Table of measured crossings, packaged beside this module."""

SuccessCurve = Sequence[tuple[float, float]]
"""Heights over the robot's step, ascending, with the share of drives that crossed such obstacles."""


def bars(draw: RandomStream, at: Position2D, height: float, toward: int) -> list[Shape]:
    """Return beams from wall to wall, the highest of that height."""
    ahead, yaw = DIRECTIONS[toward], toward * math.pi / 2
    shares = draw.shuffled((1.0, 0.8, 0.6))
    return [
        block(
            (at[0] + offset * ahead[0], at[1] + offset * ahead[1]),
            (0.09, CELL, share * height),
            yaw=yaw,
            rgba=WOOD,
        )
        for offset, share in zip((-0.4, 0.0, 0.4), shares, strict=True)
    ]


def slabs(draw: RandomStream, at: Position2D, height: float, toward: int) -> list[Shape]:
    """Return four slabs of broken floor, each tilted about a random axis so that an edge is that high."""
    side, thick = CELL / 2, 0.3
    shapes: list[Shape] = []
    for sx, sy in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        rise = height * draw.randint_between(70, 100) / 100
        tilt = math.asin(rise / side)
        yaw = draw.randint(4) * math.pi / 2
        # The middle of the upper face lies at half the rise.
        lift = rise / 2 - thick / 2 * math.cos(tilt)
        back = thick / 2 * math.sin(tilt)
        spot = (at[0] + sx * side / 2 + back * math.cos(yaw), at[1] + sy * side / 2 + back * math.sin(yaw))
        shapes.append(
            Shape(
                kind="box",
                size=(side / 2, side / 2, thick / 2),
                at=(*spot, lift),
                rotation=(0.0, -tilt, yaw),
                surface="ground",
                rgba=CONCRETE,
            )
        )
    return shapes


def posts(draw: RandomStream, at: Position2D, height: float, toward: int) -> list[Shape]:
    """Return a step field whose neighbouring posts differ by no more than that height."""
    pitch = CELL / POSTS
    shapes: list[Shape] = []
    for i in range(POSTS):
        for j in range(POSTS):
            middle_post = i == j == POSTS // 2
            top = height * (draw.randint_between(55, 100) / 100 + 0.45 * middle_post)
            spot = (at[0] + (i - (POSTS - 1) / 2) * pitch, at[1] + (j - (POSTS - 1) / 2) * pitch)
            shapes.append(block(spot, (pitch, pitch, top), rgba=WOOD))
    return shapes


def ridge(draw: RandomStream, at: Position2D, height: float, toward: int) -> list[Shape]:
    """Return a hill from wall to wall: a ramp up, a level top and a ramp down, steeper with the height."""
    angle, run = min(MAX_RIDGE_SLOPE, RIDGE_SLOPE_RATE * height), CELL / 3
    top = block(at, (run, CELL, run * math.tan(angle)), yaw=toward * math.pi / 2, rgba=WOOD)
    return [
        top,
        *(
            slope((at[0] - run * dx, at[1] - run * dy), run, CELL, angle, way)
            for way in (toward, (toward + 2) % 4)
            for dx, dy in (DIRECTIONS[way],)
        ),
    ]


def obstacle_height(robot: RobotFootprint, roughness: float, highest: float = MAX_HEIGHT_RATIO) -> float:
    """Return the height of obstacles for a robot [m]; `highest` at roughness 1, over its step."""
    return lerp(min(MIN_HEIGHT_RATIO, highest), highest, roughness) * robot.step


OBSTACLES: Registry[Obstacle] = Registry("kind of obstacle")
"""Kinds of obstacles by name."""
OBSTACLES.add("bars", bars)
OBSTACLES.add("slabs", slabs)
OBSTACLES.add("posts", posts)
OBSTACLES.add("ridge", ridge)


@cache
def measured_crossings() -> Mapping[str, Mapping[str, SuccessCurve]]:
    """Return the measured success curves, by class and kind of obstacle."""
    return json.loads(files("usarmjx.models.generate").joinpath(CROSSINGS_FILE).read_text(encoding="utf-8"))[
        "classes"
    ]


def highest_at(curve: SuccessCurve, success: float) -> float:
    """Return the largest height over the step at which at least that share of the drives succeeds.

    The curve is made monotonic and interpolated linearly.
    """
    held, share = curve[0]
    for height, found in curve[1:]:
        found = min(found, share)
        if found < success:
            return held + (height - held) * (share - success) / (share - found) if share > success else held
        held, share = height, found
    return held


def highest_obstacle(robot: str, kind: str, risk: float) -> float:
    """Return the height of the highest obstacles for a class, over its step.

    Args:
        robot: The class; "" if only a footprint is known.
        kind: A name of `obstacles.OBSTACLES`.
        risk: Share of the drives that may fail. At 0, obstacles are no higher than the step, and than the
            height that every drive crossed; unmeasured classes are assumed to climb their step.

    Raises:
        SpecError: A risk for a class that was not measured.
    """
    known = measured_crossings()
    curve = known.get(robot, {}).get(kind)
    if curve is None:
        if risk:
            there = ", ".join(known)
            raise SpecError(f"a risk of {risk:g} for {robot or 'a footprint'}: measured are {there}")
        return MAX_HEIGHT_RATIO
    return (
        max(MIN_HEIGHT_RATIO, highest_at(curve, 1.0 - risk))
        if risk
        else min(MAX_HEIGHT_RATIO, highest_at(curve, 1.0))
    )
