"""Place and robots of soccer: a field without dead corners, and robots that can push a ball.

The field is that of DM-Soccer. Its boards stand 0.3 m behind the goal lines, where a ball beside a goal is
lost to robots that can only push; here they stand on the goal lines, and boards cut the corners off. The ball
is as slippery as casters are, so that robots do not clamp it against boards.

The robot is a P2DX, the fastest class that turns on the spot, under a cover with upright sides like those of
the Small Size League. As it is, the ball rolls under its deck, which then presses it onto the floor.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.base.transforms import Vec3
from usarmjx.models.arenas.pieces import block
from usarmjx.models.arenas.soccer import (
    BALL,
    BALL_RADIUS,
    BOARD,
    CARPET,
    GOAL_DEPTH,
    GOAL_WIDTH,
    LENGTH,
    POST,
    SOCCER,
)
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose, start_tag
from usarmjx.models.types.robot import Mount, RobotSpec, options
from usarmjx.models.types.shapes import Shape
from usarmjx.train.tasks.equip import GROUND_TRUTH

GOAL_LINE, SIDE_BOARD = LENGTH / 2, CARPET[1] / 2
"""Distances of the boards from the middle of the field [m]."""
CUT = 0.5
"""Length that corner boards take of each side [m]."""
CORNER = GOAL_LINE + SIDE_BOARD - CUT
"""On the corner boards |x| + |y| is this [m]."""
START_COUNT, MIN_START_DISTANCE, FREE_KICK = 12, 0.65, 0.8
"""Start poses, the least distance between two of them, and from the ball [m]."""

LENGTH_WIDTH = (0.44, 0.38)
"""Of the cover: those of the P2DX (manual 12.3.1) [m]."""
COVER = (0.03, 0.3)
"""Its lower and upper edge above the ground: as high as the boards [m] (chosen)."""
LOWER_SCANNER_HEIGHT, UPPER_SCANNER_HEIGHT = 0.11, 0.26
"""Heights of the two scanners [m]: that of the ball's middle, and above the ball but not above boards and
robots. An echo of the lower one alone is the ball."""
SCANNER_RANGE, FOV, RESOLUTION, BEAMS = 4.0, 4.189, 3 * 0.0184087, 76
"""Every third beam of a Hokuyo URG-04LX, as `equip.HOKUYO`, but ten times a second [m], [rad]. A ball 4 m
away is as wide as the angle between two beams."""
SCAN = options(
    MaxRange=SCANNER_RANGE, MinRange=0.02, Resolution=RESOLUTION, ScanFov=FOV, ScanInterval=0.1, Noise=0.01
)
FRONT_CASTER = 0.003
"""Height of the front caster above the ground [m]: braking tilts the robot by one degree, not more."""
MASSES = (3.0, 2.4, 1.6)
"""Of the cover and the parts at the rear and the front caster: together the P2DX's chassis [kg] (chosen)."""

Colour = tuple[float, float, float, float]
BLUE: Colour = (0.2, 0.35, 0.85, 1.0)
YELLOW: Colour = (0.95, 0.85, 0.2, 1.0)


def _boards() -> list[Shape]:
    """Return boards on the goal lines, solid up to those of the carpet's edge, and across the corners."""
    inner, height = GOAL_WIDTH / 2 + POST, BOARD[1]
    width = SIDE_BOARD - inner
    depth, diagonal = CARPET[0] / 2 - GOAL_LINE, np.sqrt(2.0) * CUT
    shapes: list[Shape] = []
    for i in (-1, 1):
        for j in (-1, 1):
            middle = (i * (GOAL_LINE + depth / 2), j * (inner + width / 2))
            shapes.append(block(middle, (depth, width, height), surface="wall"))
            out = BOARD[0] / 2 / np.sqrt(2.0)  # its inner face is on the line
            corner = (i * (GOAL_LINE - CUT / 2 + out), j * (SIDE_BOARD - CUT / 2 + out))
            size = (float(diagonal), BOARD[0], height)
            shapes.append(block(corner, size, yaw=-i * j * np.pi / 4, surface="wall"))
    return shapes


def _starts() -> tuple[StartPose, ...]:
    """Return start poses on both halves; half a turn about the middle makes the second half of them."""
    draw = np.random.default_rng(3)
    poses: list[tuple[float, float, float]] = []
    while len(poses) < START_COUNT // 2:
        x, y, yaw = draw.uniform((-2.2, -1.5, -np.pi), (2.2, 1.5, np.pi)).round(2)
        here = np.array([x, y])
        others = [sign * np.array(pose[:2]) for pose in poses for sign in (-1, 1)]
        # Each pose stands for two, so its own counterpart counts, too.
        crowded = any(np.linalg.norm(here - other) < MIN_START_DISTANCE for other in [*others, -here])
        if not crowded and np.linalg.norm(here) > FREE_KICK and abs(x) + abs(y) < CORNER - 0.5:
            poses.append((float(x), float(y), float(yaw)))
    # Both teams meet the same poses: none has an advantage.
    poses += [(-x, -y, yaw + np.pi) for x, y, yaw in poses]
    return tuple(
        StartPose(tag=start_tag(i), at=(x, y, START_ELEVATION), yaw=yaw)
        for i, (x, y, yaw) in enumerate(poses)
    )


def _stays(shape: Shape) -> bool:
    """Return whether a solid of DM-Soccer is here: no lines, beacons, and boards behind the new ones."""
    x, y, _ = shape.at
    return shape.surface == "wall" and (abs(x) < CARPET[0] / 2 or abs(y) < GOAL_WIDTH / 2)


_SLIPPERY = tuple(replace(shape, surface="caster") for shape in BALL.shapes)

SOCCER_FIELD = ArenaSpec(
    name="DM-Pitch",
    about="The field of DM-Soccer with boards on the goal lines and across the corners. 1 loose object.",
    shapes=(*(shape for shape in SOCCER.shapes if _stays(shape)), *_boards()),
    starts=_starts(),
    extent=SOCCER.extent,
    loose=(replace(BALL, at=(0.0, 0.0, BALL_RADIUS), shapes=_SLIPPERY),),
    lights=SOCCER.lights,
)


def depth_inside(position: Array) -> Array:
    """Return how far positions (..., 2) are from the boards and goals, negative outside [m] (...,)."""
    x, y = jnp.abs(position[..., 0]), jnp.abs(position[..., 1])
    field = jnp.minimum(jnp.minimum(GOAL_LINE - x, SIDE_BOARD - y), (CORNER - x - y) / np.sqrt(2.0))
    goal = jnp.minimum(GOAL_LINE + GOAL_DEPTH - x, GOAL_WIDTH / 2 - y)
    return jnp.maximum(field, goal)


def goal_scored(ball: Array) -> Array:
    """Return 1 if the whole ball (2,) is in the goal at +x, -1 in the one at -x, else 0 ()."""
    inside = jnp.abs(ball[1]) < GOAL_WIDTH / 2
    return jnp.where(inside & (jnp.abs(ball[0]) > GOAL_LINE + BALL_RADIUS), jnp.sign(ball[0]), 0.0)


def soccer_robot(rgba: Colour) -> RobotSpec:
    """Return a P2DX with a cover of that colour, two scanners and what knows where it is.

    The pan-tilt head, the camera and the other sensors are left off. A second caster is at the front; most of
    the chassis' weight lies at the casters, low and a little behind the axle.
    """
    base = ROBOTS.get("P2DX")
    length, width = LENGTH_WIDTH
    cover = Shape(
        kind="box",
        size=(length / 2, width / 2, (COVER[1] - COVER[0]) / 2),
        at=_above(base, (COVER[0] + COVER[1]) / 2),
        mass=MASSES[0],
        rgba=rgba,
    )
    rear = replace(next(shape for shape in base.chassis if shape.surface == "caster"), mass=MASSES[1])
    x, y, z = rear.at
    # With z down, less is higher.
    front = replace(rear, at=(-x, y, z - FRONT_CASTER), mass=MASSES[2])
    lower = Mount(kind="RangeScanner", name="Low", at=_above(base, LOWER_SCANNER_HEIGHT), options=SCAN)
    # Of another type, as a task finds a sensor by its type.
    upper = Mount(kind="IRScanner", name="High", at=_above(base, UPPER_SCANNER_HEIGHT), options=SCAN)
    return replace(
        base,
        dimensions=(length, width, COVER[1]),
        mass=sum(MASSES) + sum(shape.mass for part in base.parts for shape in part.shapes),
        chassis=(cover, rear, front),
        packages=(),
        cameras=(),
        sensors=(GROUND_TRUTH, lower, upper),
    )


def _above(robot: RobotSpec, height: float) -> Vec3:
    """Return the position over a robot's origin at a height above the ground, in USARSim's axes [m]."""
    return (0.0, 0.0, robot.origin_height - height)


def beams() -> np.ndarray:
    """Return the directions of a scanner's beams, from right to left [rad] (beams,)."""
    return (np.arange(BEAMS) * RESOLUTION - FOV / 2).astype(np.float32)
