"""Obstacles that robots have to cross, their heights by measured success, and structures that fill cells.

Each covers a cell from wall to wall. Their height depends on the robot's step and the roughness; `usarmjx
arena check --drive` proves them passable. `arena.place_obstacles` puts them where no way leads around.

Each maker gets draws, the cell's middle and a roughness from 0 to 1. Its solids stay within `STRUCTURE_SIZE`
around the middle, clear of all walls. Roughness changes their heights, never their number or arrangement.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.resources import files

from usarmjx.base.errors import SpecError
from usarmjx.base.random import RandomStream
from usarmjx.base.registry import Registry
from usarmjx.models.compile.reachability import RobotFootprint
from usarmjx.models.generate.plan import CELL, DIRECTIONS, THICKNESS, Cell, middle
from usarmjx.models.types.shapes import Position2D, Rgba, Shape

STRUCTURE_SIZE = 1.1
"""Side of the square that contains a structure [m]."""
RAMP = math.radians(15)
"""Slope of ramps, as in the NIST arenas."""
STOREY_CELLS = 2
"""Length of the ramp to the second floor, in cells."""
STOREY = STOREY_CELLS * CELL * math.tan(RAMP)
"""Height of the second floor [m]: 64 cm."""
DECK = 0.1
"""Thickness of decks and slabs [m]."""
STEP_FIELD_POSTS = 4
"""Number of posts of a step field along each side."""
WOOD = (0.7, 0.55, 0.35, 1.0)
STONE = (0.6, 0.6, 0.6, 1.0)
CONCRETE = (0.55, 0.53, 0.5, 1.0)
Maker = Callable[[RandomStream, Position2D, float], list[Shape]]
"""Maker of a structure from draws, the cell's middle [m] and a roughness."""
MIN_HEIGHT_RATIO, MAX_HEIGHT_RATIO = 0.3, 0.95
"""Heights of steps at roughness 0 and 1, over the robot's step."""
RIDGE_SLOPE_RATE, MAX_RIDGE_SLOPE = math.radians(350), math.radians(40)
"""Slope of a ridge over the height of a step [rad/m], and the steepest [rad]."""
POSTS = 3
"""Number of posts along each side of a step field."""
MAX_OBSTACLE_SOLIDS = POSTS**2
"""Largest number of solids of one obstacle."""
Obstacle = Callable[[RandomStream, Position2D, float, int], list[Shape]]
"""Maker of an obstacle from draws, cell's middle [m], height [m] and direction in quarter turns."""
CROSSINGS_FILE = "crossings.json"
"""Table of measured crossings, packaged beside this module."""
SuccessCurve = Sequence[tuple[float, float]]
"""Heights over the robot's step, ascending, with the share of drives that crossed such obstacles."""


def lerp(low: float, high: float, roughness: float) -> float:
    """Return the value between `low` at roughness 0 and `high` at 1."""
    return low + (high - low) * roughness


def block(
    at: Position2D, size: tuple[float, float, float], *, z: float = 0.0, yaw: float = 0.0, rgba: Rgba = STONE
) -> Shape:
    """Return a box of full lengths `size` that stands at height `z` [m]."""
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    return Shape(
        kind="box", size=half, at=(*at, z + half[2]), rotation=(0.0, 0.0, yaw), surface="ground", rgba=rgba
    )


def slope(at: Position2D, run: float, width: float, angle: float, uphill: int, rgba: Rgba = WOOD) -> Shape:
    """Return a slab whose upper face rises out of the floor.

    Args:
        at: Middle of its footprint [m].
        run: Length of the footprint [m].
        width: Width [m].
        angle: Slope of its upper face [rad].
        uphill: Direction of climb, in quarter turns from x.
        rgba: Colour.
    """
    ahead = ((1, 0), (0, 1), (-1, 0), (0, -1))[uphill]
    # The middle of the upper face is over `at`; the box's own is half its thickness away along the normal.
    back = DECK / 2 * math.sin(angle)
    z = run / 2 * math.tan(angle) - DECK / 2 * math.cos(angle)
    return Shape(
        kind="box",
        size=(run / math.cos(angle) / 2, width / 2, DECK / 2),
        at=(at[0] + back * ahead[0], at[1] + back * ahead[1], z),
        rotation=(0.0, -angle, uphill * math.pi / 2),
        surface="ground",
        rgba=rgba,
    )


def rubble(draw: RandomStream, at: Position2D, roughness: float) -> list[Shape]:
    """Return a slab that leans, and three blocks around it, all turned at random."""
    shapes: list[Shape] = []
    for i, (sx, sy) in enumerate(draw.shuffled(((1, 1), (1, -1), (-1, 1), (-1, -1)))):
        spot = (at[0] + 0.27 * sx, at[1] + 0.27 * sy)
        yaw = math.radians(draw.randint(180))
        # Within a circle of 0.28 m about the middle of a quarter.
        length, width = draw.randint_between(25, 45) / 100, draw.randint_between(15, 30) / 100
        height = lerp(0.06, 0.4, roughness) * draw.randint_between(50, 100) / 100
        if i == 0:
            tilt = lerp(0.1, 0.6, roughness) * draw.randint_between(60, 100) / 100
            shapes.append(_slab(spot, (0.44, 0.3, 0.06), tilt, yaw))
        else:
            shapes.append(block(spot, (length, width, height), yaw=yaw))
    return shapes


def _slab(at: Position2D, size: tuple[float, float, float], tilt: float, yaw: float) -> Shape:
    """Return a slab that rests on one of its lower edges."""
    lift = size[0] / 2 * math.sin(tilt) + size[2] / 2 * math.cos(tilt)
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    return Shape(
        kind="box", size=half, at=(*at, lift), rotation=(0.0, -tilt, yaw), surface="ground", rgba=CONCRETE
    )


def steps(draw: RandomStream, at: Position2D, roughness: float) -> list[Shape]:
    """Return a field of square posts of four heights, higher towards one side, one corner or the middle."""
    pitch, unit = STRUCTURE_SIZE / STEP_FIELD_POSTS, lerp(0.03, 0.08, roughness)
    sx, sy = draw.choice(((1, 0), (0, 1), (1, 1), (1, -1), (0, 0)))
    shapes: list[Shape] = []
    for i in range(STEP_FIELD_POSTS):
        for j in range(STEP_FIELD_POSTS):
            x, y = i - (STEP_FIELD_POSTS - 1) / 2, j - (STEP_FIELD_POSTS - 1) / 2
            trend = 1.5 + (sx * x + sy * y) / 2 if sx or sy else 2.5 - max(abs(x), abs(y))
            level = 1 + max(0, min(3, round(trend) + draw.randint(2)))
            spot = (at[0] + x * pitch, at[1] + y * pitch)
            shapes.append(block(spot, (pitch - 0.005, pitch - 0.005, level * unit), rgba=WOOD))
    return shapes


def ramps(draw: RandomStream, at: Position2D, roughness: float) -> list[Shape]:
    """Return a ramp of 15 degrees that ends in a drop, longer with the roughness."""
    run = lerp(0.45, 1.0, roughness)
    return [slope(at, run, STRUCTURE_SIZE, RAMP, draw.randint(4))]


def collapsed(draw: RandomStream, at: Position2D, roughness: float) -> list[Shape]:
    """Return a floor slab fallen down on one side, propped up by a block, and another block on the floor."""
    uphill = draw.randint(4)
    angle = lerp(math.radians(8), math.radians(30), roughness)
    slab = slope(at, 0.8, 1.0, angle, uphill, CONCRETE)
    # The block fits just below the slab's lower face.
    ahead = ((1, 0), (0, 1), (-1, 0), (0, -1))[uphill]
    # The near side of the block is 0.7 m from the slab's lower edge.
    prop = max(0.02, 0.7 * math.tan(angle) - DECK / math.cos(angle))
    spots = [(at[0] + d * ahead[0], at[1] + d * ahead[1]) for d in (0.35, -0.47)]
    flat = [(0.1, 0.6, prop), (0.1, 0.4, lerp(0.05, 0.25, roughness) * draw.randint_between(50, 100) / 100)]
    return [slab, *(block(s, size, yaw=uphill * math.pi / 2) for s, size in zip(spots, flat, strict=True))]


def void(at: Position2D, facing: int, length: float, roof: float) -> list[Shape]:
    """Return a slab over a victim, on two walls beside it.

    Args:
        at: Middle of the slab [m].
        facing: Direction of its length, in quarter turns from x: the walls are at the end that lies behind.
        length: Length of the slab [m].
        roof: Height of its lower face [m].
    """
    ahead = ((1, 0), (0, 1), (-1, 0), (0, -1))[facing]
    yaw = facing * math.pi / 2
    shapes = [block(at, (length, STRUCTURE_SIZE, DECK), z=roof, yaw=yaw, rgba=CONCRETE)]
    # Half of a wall: both walls end with the slab.
    back = length / 2 - 0.4
    for side in (-1, 1):
        x = at[0] - back * ahead[0] - side * 0.52 * ahead[1]
        y = at[1] - back * ahead[1] + side * 0.52 * ahead[0]
        shapes.append(block((x, y), (0.8, 0.06, roof), yaw=yaw))
    return shapes


def second_floor(landing: Cell, step: int, columns: int) -> list[Shape]:
    """Return a ramp up from beside a landing, a deck behind it, and a ramp down where there is room.

    Args:
        landing: Cell at the foot of the ramp.
        step: 1 if it leads towards larger columns, -1 if towards smaller ones.
        columns: Columns of the arena.
    """
    width = CELL - THICKNESS
    uphill = 0 if step > 0 else 2
    run = STOREY_CELLS * CELL
    y = middle(landing)[1]
    edge = middle(landing)[0] + step * CELL / 2
    end = CELL * (columns if step > 0 else 0) - step * THICKNESS / 2
    shapes = [slope((edge + step * run / 2, y), run, width, RAMP, uphill)]
    if columns >= MIN_TWO_RAMP_COLUMNS:
        # A cell at the foot of the second ramp stays free, as a landing.
        end -= step * (run + CELL - THICKNESS / 2)
        shapes.append(slope((end + step * run / 2, y), run, width, RAMP, (uphill + 2) % 4))
    start = edge + step * run
    at = ((start + end) / 2, y)
    shapes.append(block(at, (abs(end - start), width, DECK), z=STOREY - DECK, rgba=WOOD))
    return shapes


MIN_TWO_RAMP_COLUMNS = 2 * (STOREY_CELLS + 1) + 1
"""Columns of the smallest arena whose second floor has a ramp at both ends."""


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
            # The middle has 1 to 1.45 of the height, its neighbours 0.55 to 1: they differ by 0.9 of it at
            # most.
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
    # A measured limit may lie below the usual lowest height.
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
        # Measured shares scatter: a higher obstacle must not count as easier.
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
