"""Common parts of baselines: driving any robot by speed and turn, and finding a free direction."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import wrap_angle
from usarmjx.models.drives import Ackermann, RotaryWing, SkidSteer, Tracks
from usarmjx.models.types.robot import RobotSpec
from usarmjx.train.tasks.clearance import bounding_box_of
from usarmjx.train.tasks.team import MAX_RANGE, range_lines

MAX_SPEED = 1.0
"""Hand-written policies drive no faster than this [m/s]."""
TURN_SPEED = 0.35
"""Speed of the wheels of one side against the other when turning at full, of a robot that skids [m/s]."""
MARGIN = 0.06
"""Left free beside the robot [m]."""
ANGLES = np.linspace(-np.pi, np.pi, 48, endpoint=False).astype(np.float32)
"""Directions in which a way is looked for, positive to the left [rad]."""
BLOCKED_DISTANCE, SLOW_DISTANCE = 0.3, 0.6
"""A way that is free for less is barred; on one that is free for less than the second it is slow [m]."""
NO_OBSTACLE_DISTANCE = 100.0
"""Distance of directions in which nothing was seen [m]."""

Driver = Callable[[jax.Array, jax.Array], jax.Array]
"""From speed ahead and turn to the left, shares from -1 to 1 (), to an action (keys,)."""


def driver(robot: RobotSpec) -> Driver:
    """Return how to drive a robot.

    Raises:
        UsageError: One whose drive these policies cannot handle; names those that they can.
    """
    drive = robot.drive
    pace = min(1.0, MAX_SPEED / drive.top_speed)
    if isinstance(drive, SkidSteer | Tracks):
        turning = min(1.0, TURN_SPEED / drive.top_speed)
        return lambda ahead, turn: _fitted(
            jnp.stack([pace * ahead - turning * turn, pace * ahead + turning * turn])
        )
    if isinstance(drive, Ackermann):
        steers = np.array([1.0] + [-1.0] * (drive.max_rear_steer > 0), np.float32)
        return lambda ahead, turn: jnp.concatenate([pace * ahead[None], turn * steers])
    if isinstance(drive, RotaryWing):
        # A little upward, off the ground; turns are clockwise.
        return lambda ahead, turn: jnp.stack([0.02 + 0.0 * ahead, pace * ahead, 0.0 * ahead, -turn])
    raise UsageError(
        f"no hand-written policy drives a {robot.name}: expected wheels or tracks that skid, a car or a "
        "robot with rotors"
    )


def _fitted(action: jax.Array) -> jax.Array:
    return action / jnp.maximum(jnp.abs(action).max(), 1.0)


def obstacles(seen: jax.Array, robot: RobotSpec, kinds: tuple[str, ...]) -> jax.Array:
    """Return the points that range readings (n,) mean, in the robot's axes [m] (n, 2); none: far away."""
    origin, angle = range_lines(robot, kinds)
    along = np.stack([np.cos(angle), np.sin(angle)], -1)
    return jnp.where(seen[:, None] < 1.0, origin + MAX_RANGE * seen[:, None] * along, NO_OBSTACLE_DISTANCE)


def free_distances(points: jax.Array, robot: RobotSpec) -> jax.Array:
    """Return how far a robot can go straight on in each of `ANGLES` past points (n, 2) [m] (directions,).

    The length is that of its middle's way until its front is at the point.
    """
    low, high = bounding_box_of(robot)
    half, front = float(max(high[1], -low[1])) + MARGIN, float(high[0])
    ahead = points[:, 0] * np.cos(ANGLES)[:, None] + points[:, 1] * np.sin(ANGLES)[:, None]
    aside = points[:, 1] * np.cos(ANGLES)[:, None] - points[:, 0] * np.sin(ANGLES)[:, None]
    met = (ahead > 0) & (jnp.abs(aside) < half)
    return jnp.where(met, ahead, NO_OBSTACLE_DISTANCE).min(-1, initial=NO_OBSTACLE_DISTANCE) - front


def choose_direction(lengths: jax.Array, wanted: jax.Array, side: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the best of the free directions [rad] (), and how far it is free [m] ().

    Args:
        lengths: Of the ways (directions,).
        wanted: Direction to go in [rad] ().
        side: 0 takes the direction nearest to the wanted one; 1 the first one to the left of it, -1 the
            first one to the right ().
    """
    off = wrap_angle(ANGLES - wanted)
    around = jnp.mod(side * off + 1e-3, 2 * jnp.pi)
    cost = jnp.where(side == 0, jnp.abs(off), around)
    best = jnp.argmin(
        cost + 100.0 * (lengths < BLOCKED_DISTANCE) - 1e-3 * jnp.minimum(lengths, BLOCKED_DISTANCE)
    )
    return jnp.asarray(ANGLES)[best], lengths[best]


def steer_toward(direction: jax.Array, free: jax.Array, robot: RobotSpec) -> jax.Array:
    """Return the action (keys,) that takes a robot in a direction [rad] () that is free so far [m] ()."""
    turn = jnp.clip(2.0 * direction, -1.0, 1.0)
    slow = jnp.clip(free / SLOW_DISTANCE, 0.15, 1.0)
    if isinstance(robot.drive, Ackermann):
        # A car cannot turn in place: what is behind it, it approaches backwards, in a curve.
        behind = jnp.abs(direction) > 2.0
        return driver(robot)(jnp.where(behind, -0.5, slow), jnp.where(behind, -turn, turn))
    ahead = slow * jnp.clip(1.0 - jnp.abs(direction) / 0.8, 0.0, 1.0)
    return driver(robot)(ahead, turn)
