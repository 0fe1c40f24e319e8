"""DM-Soccer: a small soccer field, for teams of two against two.

Start poses BlueGoal, MiddleField and YellowGoal are those of the manual's answer to GETSTARTPOSES (5.3.3),
which puts the floor at height 0. They are in front of goals whose lines are 5.4 m apart, as on the field of
the Four-Legged League (RoboCup rules of 2005: 5.4 x 3.6 m between the lines, carpet 6 x 4 m, goals 0.8 m wide
and 0.3 m deep). The rest is chosen.

The ball is a sphere with contacts to ground, walls, hulls and loose objects, but not to wheels, tracks and
casters, as wheels do not touch each other either: engine `jax` has no reliable contact of cylinder and
sphere, and the robots' hulls cover their wheels. It rolls without resistance until something stops it.
"""

import math

from usarmjx.models.arenas.pieces import block
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, Light, LooseObject, StartPose
from usarmjx.models.types.shapes import Rgba, Shape

LENGTH, WIDTH = 5.4, 3.6
"""Between the goal lines and between the side lines [m]."""
CARPET = (6.0, 4.0)
GOAL_WIDTH, GOAL_DEPTH, GOAL_HEIGHT, POST = 0.8, 0.3, 0.5, 0.05
"""Size of the goals; the height and the thickness of their sides are chosen [m]."""
BOARD = (0.05, 0.3)
"""Thickness and height of the boards around the carpet (chosen) [m]."""
LINE_WIDTH, PAINT_THICKNESS = 0.05, 0.002
"""Width and thickness of the lines [m]."""
PENALTY_AREA = (0.6, 2.0)
"""Depth and width of the penalty areas (chosen) [m]."""
CIRCLE_RADIUS, CIRCLE_SIDES = 0.5, 12
"""Radius of the centre circle (chosen) [m] and the number of its lines."""
BALL_RADIUS, BALL_MASS = 0.11, 0.43  # FIFA's size 5: circumference 68 to 70 cm, 410 to 450 g
BALL_START = (1.2, 0.0)
"""Position of the ball: the centre spot is the start pose MiddleField."""

WHITE: Rgba = (0.95, 0.95, 0.95, 1.0)
GREEN: Rgba = (0.25, 0.55, 0.3, 1.0)
BLUE: Rgba = (0.2, 0.35, 0.85, 1.0)
YELLOW: Rgba = (0.95, 0.85, 0.2, 1.0)
PINK: Rgba = (0.95, 0.5, 0.7, 1.0)
ORANGE: Rgba = (0.95, 0.45, 0.1, 1.0)


def _line(at: tuple[float, float], length: float, yaw: float = 0.0) -> Shape:
    return block(at, (length, LINE_WIDTH, PAINT_THICKNESS), yaw=yaw, surface="fixture", rgba=WHITE)


def _goal(side: int, rgba: Rgba) -> tuple[Shape, ...]:
    """Return the sides of the goal at `side` of x and the board behind it."""
    x, y = side * (LENGTH + GOAL_DEPTH) / 2, (GOAL_WIDTH + POST) / 2
    cheeks = (
        block((x, far * y), (GOAL_DEPTH, POST, GOAL_HEIGHT), surface="wall", rgba=rgba) for far in (-1, 1)
    )
    back = side * (LENGTH / 2 + GOAL_DEPTH + BOARD[0] / 2)
    return (
        *cheeks,
        block((back, 0.0), (BOARD[0], GOAL_WIDTH + 2 * POST, GOAL_HEIGHT), surface="wall", rgba=rgba),
    )


def _boards() -> tuple[Shape, ...]:
    """Return the boards around the carpet, with gaps for the goals' backs."""
    thick, high = BOARD
    x, y = (CARPET[0] + thick) / 2, (CARPET[1] + thick) / 2
    inner = GOAL_WIDTH / 2 + POST
    length = CARPET[1] / 2 - inner
    along = (block((0.0, far * y), (CARPET[0] + 2 * thick, thick, high), surface="wall") for far in (-1, 1))
    across = (
        block((side * x, far * (inner + length / 2)), (thick, length, high), surface="wall")
        for side in (-1, 1)
        for far in (-1, 1)
    )
    return (*along, *across)


def _beacons() -> tuple[Shape, ...]:
    """Return the coloured beacons outside of the corners, pink above or below by the league's rules."""
    x, y = CARPET[0] / 2 + 0.2, CARPET[1] / 2 + 0.2
    return tuple(
        block((side * x, far * y), (0.1, 0.1, 0.2), z=z, surface="wall", rgba=rgba)
        for side, own in ((-1, BLUE), (1, YELLOW))
        for far in (-1, 1)
        for z, rgba in zip((0.0, 0.2), (own, PINK)[::far], strict=True)
    )


def _markings() -> tuple[Shape, ...]:
    """Return carpet and lines, without contacts."""
    depth, width = PENALTY_AREA
    lines = [block((0.0, 0.0), (*CARPET, PAINT_THICKNESS / 2), surface="fixture", rgba=GREEN)]
    lines += [_line((0.0, far * WIDTH / 2), LENGTH + LINE_WIDTH) for far in (-1, 1)]
    lines += [_line((x, 0.0), WIDTH, math.pi / 2) for x in (-LENGTH / 2, 0.0, LENGTH / 2)]
    for side in (-1, 1):
        lines.append(_line((side * (LENGTH / 2 - depth), 0.0), width, math.pi / 2))
        lines += [_line((side * (LENGTH - depth) / 2, far * width / 2), depth) for far in (-1, 1)]
    # Tangents of the circle, whose ends meet.
    chord = 2 * CIRCLE_RADIUS * math.tan(math.pi / CIRCLE_SIDES)
    for i in range(CIRCLE_SIDES):
        turn = 2 * math.pi * i / CIRCLE_SIDES
        lines.append(
            _line((CIRCLE_RADIUS * math.cos(turn), CIRCLE_RADIUS * math.sin(turn)), chord, turn + math.pi / 2)
        )
    return tuple(lines)


BALL = LooseObject(
    name="Ball",
    at=(*BALL_START, BALL_RADIUS),
    shapes=(Shape(kind="sphere", size=(BALL_RADIUS,), mass=BALL_MASS, surface="wheel", rgba=ORANGE),),
)

SOCCER = ArenaSpec(
    name="DM-Soccer",
    aliases=("soccer",),
    about=(
        "A soccer field of 5.4 x 3.6 m with boards, two goals and a ball that robots push; the ball touches "
        "hulls, not wheels. 1 loose object."
    ),
    shapes=(*_goal(-1, BLUE), *_goal(1, YELLOW), *_boards(), *_beacons(), *_markings()),
    starts=(
        StartPose(tag="BlueGoal", at=(-2.55, 0.0, START_ELEVATION), yaw=0.01),
        StartPose(tag="MiddleField", at=(0.01, 0.0, START_ELEVATION)),
        StartPose(tag="YellowGoal", at=(2.57, 0.01, START_ELEVATION), yaw=-3.13),
        StartPose(tag="Blue1", at=(-1.3, -0.9, START_ELEVATION)),
        StartPose(tag="Blue2", at=(-1.3, 0.9, START_ELEVATION)),
        StartPose(tag="Yellow1", at=(1.3, 0.9, START_ELEVATION), yaw=math.pi),
        StartPose(tag="Yellow2", at=(1.3, -0.9, START_ELEVATION), yaw=math.pi),
        StartPose(tag="PlayerStart", at=(-0.6, 1.2, START_ELEVATION)),
    ),
    extent=((-CARPET[0] / 2 - 0.3, CARPET[0] / 2 + 0.3), (-CARPET[1] / 2 - 0.3, CARPET[1] / 2 + 0.3)),
    loose=(BALL,),
    lights=tuple(Light(at=(x, y, 4.0), brightness=6.0) for x in (-1.5, 1.5) for y in (-1.0, 1.0)),
    robots=("P2DX", "P2AT", "Zerg", "ERS", "QRIO"),
)
