"""Baseline of soccer: who is nearer gets behind the ball and pushes it to the goal, the other keeps goal.

It is here and not with the other baselines because the task itself needs it for `opponent`.
"""

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.models.arenas.soccer import BALL_RADIUS
from usarmjx.train.tasks.soccer_field import (
    CORNER,
    GOAL_LINE,
    LENGTH_WIDTH,
    SCANNER_RANGE,
    SIDE_BOARD,
    beams,
    depth_inside,
)

POSITION_SCALE = 3.0
"""Unit of positions in a robot's axes [m], see `soccer.Soccer`."""
LEAD = (0.2, 1.2)
"""The ball is met where it will be so much later, at least and at most [s]."""
PUSH_START_DISTANCE = BALL_RADIUS + LENGTH_WIDTH[0] / 2 + 0.15
"""Distance behind the ball at which a push begins, between the middles [m]."""
PASS_DISTANCE = 0.55
"""Distance at which a robot passes the ball's middle [m]."""
TOUCH, CLOSE_DISTANCE, NEAR_BALL = BALL_RADIUS + LENGTH_WIDTH[0] / 2, 0.42, 0.8
"""The ball is touched, close, and in reach for a push, between the middles [m]."""
LINE_TOLERANCES, LINE_UP, AIM = (0.06, 0.17), 1.0, (0.15, 0.7)
"""Off the line of the push by less than the first it pushes, close to the ball by less than the second [m];
it turns so much to that line [rad/m]; so far off the way of the ball it stands still to turn, close to it by
the second [rad]."""
BOARDS = 0.27
"""Robots' middles stay so far from the boards [m]."""
KEEPER_DISTANCE = 0.45
"""Distance of the keeper from the middle of its goal [m]."""
ACROSS = 0.8
"""Pushes are slow whose way has a larger share than this across the field."""
ARRIVED_DISTANCE, SLOW_DISTANCE = 0.12, 0.36
"""So near is there, and from here on it drives slower [m]."""
TURN_FIRST = 0.9
"""With the way farther off its nose than this it turns on the spot [rad]."""
PASS_MARGIN, PASS_LOOKAHEAD = 0.33, 0.9
"""Ways pass others' sides at so much from the robot's middle, as far as they are so near [m]."""
PUSH_ROOM = 0.24
"""Room for a robot behind the ball, from its middle [m]."""
BALL_PATH_MARGIN, BALL_PATH_LENGTH = 0.3, 1.2
"""The same for the way of the ball."""
DIRECTIONS = np.array(
    [0.0, 0.25, -0.25, 0.5, -0.5, 0.75, -0.75, 1.0, -1.0, 1.3, -1.3, 1.6, -1.6, 1.9, -1.9, 2.2, -2.2],
    np.float32,
)
"""Ways that are tried if the straight one is not free, off that one [rad]."""
BLOCKED_DISTANCE, BACK_UP_SHARE, TURNS = 0.33, 0.25, 16.0
"""With another robot as near as that [m] it backs up for this share of every sixteenth of the time."""
FORGOTTEN = 0.99
"""From this age on, as a share, nothing is known."""
IN_GOAL = np.array([GOAL_LINE + 0.1, 0.0], np.float32)
OWN_GOAL = np.array([-GOAL_LINE, 0.0], np.float32)
KEEPER_POSITION = OWN_GOAL + np.array([KEEPER_DISTANCE, 0.0], np.float32)
FAR_OFF = 99.0
"""Coordinate of robots and balls that are not seen [m]."""
SECTOR_ANGLES = beams().reshape(19, -1).mean(-1)
"""Middles of the sectors in which others are seen [rad]."""
SECTOR_LINES = np.stack([np.cos(SECTOR_ANGLES), np.sin(SECTOR_ANGLES)], -1)


def soccer_action(seen: jax.Array) -> jax.Array:
    """Return the action (2,) for one robot's observation of `Soccer` (n,)."""
    position, number = seen[:2] * np.array([GOAL_LINE, SIDE_BOARD], np.float32), seen[16]
    sin, cos = seen[2], seen[3]
    turn = jnp.stack([jnp.stack([cos, -sin]), jnp.stack([sin, cos])])
    near = SCANNER_RANGE * seen[18:, None] * SECTOR_LINES
    others = jnp.where(seen[18:, None] < FORGOTTEN, position + near @ turn.T, FAR_OFF)
    away = POSITION_SCALE * seen[8:10]
    # The ball rolls on while the robot drives: it aims at where they meet.
    soon = jnp.clip(jnp.linalg.norm(away) - TOUCH, LEAD[0], LEAD[1])
    # Extrapolated without bounces, the ball might lie beyond the boards.
    ball = _inside(position + turn @ (away + soon * seen[10:12]), BALL_RADIUS)
    mate = position + turn @ (POSITION_SCALE * seen[13:15])
    known, heard = seen[12] < FORGOTTEN, seen[15] < FORGOTTEN

    push = _push(ball, others)
    behind = ball - PUSH_START_DISTANCE * push
    mine, its = jnp.linalg.norm(behind - position), jnp.linalg.norm(behind - mate)
    # Equal distances go to the robot of number 0, so that one of both always attacks.
    first = known & (~heard | (mine < its) | ((mine == its) & (number < 0.5)))
    attack, pushes = _shot(turn.T @ push, position - ball, push)
    # A robot that does not know where the ball is goes to the middle or its own goal, and looks around.
    post = jnp.where(known, _between(ball), jnp.where(number < 0.5, 0.0 * KEEPER_POSITION, KEEPER_POSITION))
    way = jnp.where(first, _round_ball(position, ball, push), post) - position
    there = ~first & (jnp.linalg.norm(way) < ARRIVED_DISTANCE)
    looks = jnp.where(known, _turn_to(turn.T @ (ball - position)), jnp.array([-0.4, 0.4]))
    action = jnp.where(there, looks, _go(turn.T @ _round_others(way, others - position)))
    jammed = (SCANNER_RANGE * seen[18:].min() < BLOCKED_DISTANCE) & (
        jnp.mod(TURNS * seen[17], 1.0) < BACK_UP_SHARE
    )
    action = jnp.where(jammed & ~there, jnp.array([-0.5, -0.3]), action)
    return jnp.where(first & pushes & ~jammed, attack, action)


def _ways(way: jax.Array) -> jax.Array:
    """Return directions about that of a way (2,), the nearest first (ways, 2)."""
    angle = jnp.arctan2(way[1], way[0]) + DIRECTIONS
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)


def _is_free(ways: jax.Array, others: jax.Array, room: float, far: jax.Array | float) -> jax.Array:
    """Return which ways (ways, 2) are so far free of others (n, 2) (ways,)."""
    # Dot and cross product: the distance along each way, and the distance off it.
    on, off = ways @ others.T, ways[:, :1] * others[:, 1] - ways[:, 1:] * others[:, 0]
    return ~((on > 0) & (on < far) & (jnp.abs(off) < room)).any(-1)


def _round_others(way: jax.Array, others: jax.Array) -> jax.Array:
    """Return a way (2,) turned so far that others (n, 2) are not in it, if there is such a one (2,)."""
    ways, length = _ways(way), jnp.linalg.norm(way)
    free = _is_free(ways, others, PASS_MARGIN, jnp.minimum(PASS_LOOKAHEAD, length))
    return jnp.where(free.any(), length * ways[jnp.argmax(free)], way)


def _push(ball: jax.Array, others: jax.Array) -> jax.Array:
    """Return where to push the ball (2,) (2,): to the goal, past others (n, 2), from where there is room."""
    ways = _ways(jnp.asarray(IN_GOAL) - ball)
    behind = depth_inside(ball - PUSH_START_DISTANCE * ways) > PUSH_ROOM
    free = _is_free(ways, others - ball, BALL_PATH_MARGIN, BALL_PATH_LENGTH)
    # Room behind the ball counts more than a free way: without it the robot cannot push at all.
    return ways[jnp.argmax(2 * behind + free)]


def _inside(position: jax.Array, room: float = BOARDS) -> jax.Array:
    """Return the position nearest to another one (2,) at which there is room between the boards (2,)."""
    limit = np.array([GOAL_LINE - room, SIDE_BOARD - room], np.float32)
    position = jnp.clip(position, -limit, limit)
    # Corners are cut off at 45 degrees: there the sum of both coordinates is bounded.
    over = jnp.maximum(jnp.abs(position).sum() - (CORNER - np.sqrt(2.0) * room), 0.0)
    return position - jnp.sign(position) * over / 2


def _shot(ahead: jax.Array, off: jax.Array, way: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the action (2,) that pushes the ball, and whether the robot is where it can ().

    A slippery ball is pushed to where the robot's nose points: before it touches the ball, it lines up.

    Args:
        ahead: The way of the ball in the robot's axes (2,).
        off: Position of the robot, seen from the ball [m] (2,).
        way: The way of the ball, of length 1 (2,).
    """
    along, aside = off @ way, off[1] * way[0] - off[0] * way[1]
    turn = jnp.arctan2(ahead[1], ahead[0]) - LINE_UP * jnp.clip(aside, -0.2, 0.2)
    touches = (along > -CLOSE_DISTANCE) & (jnp.abs(turn) < AIM[1])
    room = jnp.where(touches, LINE_TOLERANCES[1], LINE_TOLERANCES[0] + 0.3 * jnp.maximum(-along - TOUCH, 0.0))
    ready = (along < -0.2) & (along > -NEAR_BALL) & (jnp.abs(aside) < room)
    # Along the boards beside the goal it goes slowly, or the ball would roll past the goal.
    most = jnp.where(jnp.abs(way[1]) > ACROSS, 0.5, 1.0)
    aim = jnp.where(touches, AIM[1], AIM[0])
    return _wheels(most * jnp.clip(1.5 - 1.5 * jnp.abs(turn) / aim, 0.0, 1.0), turn), ready


def _round_ball(position: jax.Array, ball: jax.Array, way: jax.Array) -> jax.Array:
    """Return where to drive now to get behind the ball (2,), without touching it (2,)."""
    left = jnp.stack([-way[1], way[0]])
    along, aside = (position - ball) @ way, (position - ball) @ left
    # It goes round the ball on its own side, unless there is a board.
    side = jnp.where(aside >= 0, 1.0, -1.0)
    side = jnp.where(depth_inside(ball + side * PASS_DISTANCE * left) > BOARDS - 0.05, side, -side)
    beside = ball + side * PASS_DISTANCE * left
    crossing = (jnp.abs(aside) < PASS_DISTANCE - 0.1) | (side * aside < 0)
    around = jnp.where(crossing, beside + jnp.maximum(along, 0.0) * way, beside - PUSH_START_DISTANCE * way)
    return jnp.where(along < -0.25, ball - PUSH_START_DISTANCE * way, _inside(around))


def _between(ball: jax.Array) -> jax.Array:
    """Return where to keep goal (2,): between it and the ball."""
    way = ball - OWN_GOAL
    return _inside(jnp.asarray(OWN_GOAL) + KEEPER_DISTANCE * way / jnp.maximum(jnp.linalg.norm(way), 1e-6))


def _turn_to(ahead: jax.Array) -> jax.Array:
    """Return the action (2,) that turns a robot to something in its axes (2,)."""
    return _wheels(0.0, 0.7 * jnp.arctan2(ahead[1], ahead[0]))


def _go(ahead: jax.Array) -> jax.Array:
    """Return the action (2,) that drives a robot to a position in its axes (2,)."""
    off = jnp.arctan2(ahead[1], ahead[0])
    speed = jnp.clip(jnp.linalg.norm(ahead) / SLOW_DISTANCE, 0.2, 1.0)
    return _wheels(speed * jnp.clip(1.0 - jnp.abs(off) / TURN_FIRST, 0.0, 1.0), off)


def _wheels(speed: jax.Array | float, turn: jax.Array) -> jax.Array:
    """Return the action (2,) for a speed, as a share, and an angle to turn by [rad]."""
    rate = jnp.clip(0.6 * turn, -0.5, 0.5)
    action = jnp.stack([speed - rate, speed + rate])
    # Both wheels are scaled alike, so that the curve stays the same.
    return action / jnp.maximum(jnp.abs(action).max(), 1.0)
