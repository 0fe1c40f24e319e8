"""What soccer robots believe of the game: from their scanners, and from what their mates send."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax.struct import PyTreeNode

from usarmjx.base.arrays import Array
from usarmjx.base.transforms import mat_from_angles
from usarmjx.comms.mail import BYTES_PER_NUMBER, Inboxes, OutgoingMessages
from usarmjx.models.arenas.soccer import BALL_RADIUS
from usarmjx.train.tasks.soccer_field import (
    BEAMS,
    COVER,
    LOWER_SCANNER_HEIGHT,
    SCANNER_RANGE,
    UPPER_SCANNER_HEIGHT,
    beams,
    depth_inside,
)

UPPER, LOWER = "IRScanner", "RangeScanner"
"""Types of the two scanners."""
MIN_RANGE_GAP = 0.15
"""So much farther must the upper scanner see than the lower one where a ball is [m]."""
FLOOR_MARGIN = 0.04
"""Hits that are no higher than this may be of the floor [m]."""
BOARD_MARGIN = 0.1
"""What is nearer to a board or a goal than this may be one [m]."""
VELOCITY_SMOOTHING = 0.4
"""Share of a new velocity of the ball in what is known of it."""
MAX_VELOCITY_GAP = 0.35
"""Velocities are estimated from two scans that are no farther apart [s]."""
MAX_BALL_SPEED = 2.0
"""Balls are no faster than this in each direction [m/s]."""
NEVER = -1e3
"""When what never happened did [s]."""
NUMBERS = 8
"""Of a message: the sender's x, y, yaw; the ball's x, y and its velocity; when it was seen."""


class SoccerBelief(PyTreeNode, kw_only=True):
    """What each robot believes, in the world's axes.

    Attributes:
        pose: Where it is: x, y [m] and yaw [rad] (robots, 3).
        others: How far away another robot is along each upper beam, `SCANNER_RANGE` for none [m] (robots,
            beams).
        ball: Where the ball was seen last, by the robot or its mate [m] (robots, 2).
        velocity: How fast it was then [m/s] (robots, 2).
        ball_time: When that was [s] (robots,).
        mate_pose: What its mate said of its own pose (robots, 3).
        mate_time: When it said so [s] (robots,).
    """

    pose: jax.Array
    others: jax.Array
    ball: jax.Array
    velocity: jax.Array
    ball_time: jax.Array
    mate_pose: jax.Array
    mate_time: jax.Array


def initial_belief(robots: int) -> SoccerBelief:
    """Return the belief of robots that have sensed nothing yet."""
    none, never = jnp.zeros((robots, 2)), jnp.full(robots, NEVER)
    pose = jnp.zeros((robots, 3))
    return SoccerBelief(
        pose=pose,
        others=jnp.full((robots, BEAMS), SCANNER_RANGE),
        ball=none,
        velocity=none,
        ball_time=never,
        mate_pose=pose,
        mate_time=never,
    )


def find_ball(pose: jax.Array, low: jax.Array, high: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return where a robot sees the ball [m] (2,), and whether it does ().

    The ball is what the lower scanner meets and the upper one does not, within the boards. As the robot
    tilts when it brakes, only beams count that are then above the floor, and above the ball and below the
    top of robots.

    Args:
        pose: Where the robot is: x, y, z [m], roll, pitch, yaw [rad] (6,).
        low: Ranges of the lower scanner [m] (beams,).
        high: Those of the upper one (beams,).
    """
    along = _directions(pose)
    rise, flat = low * along[:, 2], jnp.linalg.norm(along[:, :2], axis=-1)
    upper = UPPER_SCANNER_HEIGHT + rise
    level = (LOWER_SCANNER_HEIGHT + rise > FLOOR_MARGIN) & (upper > 2 * BALL_RADIUS) & (upper < COVER[1])
    middle = pose[:2] + (low * flat + BALL_RADIUS)[:, None] * along[:, :2] / flat[:, None]
    met = (high > low + MIN_RANGE_GAP) & level & (depth_inside(middle) > BALL_RADIUS / 2)
    nearest = jnp.where(met, low, jnp.inf).min()
    # Beams that pass the ball's middle meet it first; those beside are on both sides.
    mine = met & (low < nearest + BALL_RADIUS)
    way = jnp.where(mine[:, None], along[:, :2], 0.0).sum(0)
    way = way / jnp.maximum(jnp.linalg.norm(way), 1e-6)
    return pose[:2] + (jnp.where(met.any(), nearest, 0.0) + BALL_RADIUS) * way, met.any()


def find_others(pose: jax.Array, high: jax.Array) -> jax.Array:
    """Return how far away robots are along the upper beams, `SCANNER_RANGE` for none [m] (beams,).

    They are what is neither board nor goal.
    """
    along = _directions(pose)
    hit = pose[:2] + high[:, None] * along[:, :2]
    return jnp.where((high < SCANNER_RANGE) & (depth_inside(hit) > BOARD_MARGIN), high, SCANNER_RANGE)


def _directions(pose: jax.Array) -> jax.Array:
    """Return the directions of a scanner's beams in the world (beams, 3)."""
    angle = beams()
    lines = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    return jnp.asarray(lines) @ mat_from_angles(pose[3], pose[4], pose[5], jnp).T


class SoccerReadings(NamedTuple):
    """What the robots' sensors say.

    Attributes:
        pose: Where they are: x, y, z [m], roll, pitch, yaw [rad] (robots, 6).
        low: Ranges of the lower scanners [m] (robots, beams).
        high: Those of the upper ones (robots, beams).
        fresh: Whether these are of now (robots,).
    """

    pose: jax.Array
    low: jax.Array
    high: jax.Array
    fresh: jax.Array


def update_from_sensors(belief: SoccerBelief, readings: SoccerReadings, time: Array) -> SoccerBelief:
    """Return the belief after the sensors' readings at a time [s] ()."""
    ball, there = jax.vmap(find_ball)(readings.pose, readings.low, readings.high)
    others = jax.vmap(find_others)(readings.pose, readings.high)
    there = there & readings.fresh
    gap = time - belief.ball_time
    moved = jnp.clip((ball - belief.ball) / jnp.maximum(gap, 1e-3)[:, None], -MAX_BALL_SPEED, MAX_BALL_SPEED)
    moved = (1 - VELOCITY_SMOOTHING) * belief.velocity + VELOCITY_SMOOTHING * moved
    moved = jnp.where((gap < MAX_VELOCITY_GAP)[:, None], moved, 0.0)
    return belief.replace(
        pose=readings.pose[:, (0, 1, 5)],
        others=jnp.where(readings.fresh[:, None], others, belief.others),
        ball=jnp.where(there[:, None], ball, belief.ball),
        velocity=jnp.where(there[:, None], moved, belief.velocity),
        ball_time=jnp.where(there, time, belief.ball_time),
    )


def update_from_mail(belief: SoccerBelief, mail: Inboxes) -> SoccerBelief:
    """Return the belief after robots read their mail: whoever saw the ball later is believed."""
    last, rows = jnp.maximum(mail.count - 1, 0), jnp.arange(len(belief.ball_time))
    payload, got = mail.payload[rows, last], mail.count > 0
    newer = got & (payload[:, 7] > belief.ball_time)
    return belief.replace(
        ball=jnp.where(newer[:, None], payload[:, 3:5], belief.ball),
        velocity=jnp.where(newer[:, None], payload[:, 5:7], belief.velocity),
        ball_time=jnp.where(newer, payload[:, 7], belief.ball_time),
        mate_pose=jnp.where(got[:, None], payload[:, :3], belief.mate_pose),
        mate_time=jnp.where(got, mail.time[rows, last], belief.mate_time),
    )


def compose_messages(belief: SoccerBelief, to: Array) -> OutgoingMessages:
    """Return the messages of robots to others (robots, robots)."""
    payload = jnp.concatenate([belief.pose, belief.ball, belief.velocity, belief.ball_time[:, None]], -1)
    length = jnp.full(len(payload), BYTES_PER_NUMBER * NUMBERS, jnp.int32)
    return OutgoingMessages(receivers=to, payload=payload, size_bytes=length)
