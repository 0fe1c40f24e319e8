"""A safety layer for robots that skid: of the commands near their own, one that keeps them clear.

A dynamic window (after Fox, Burgard and Thrun 1997): each command is followed for a short time, and those
that bring the robot's box too near to what its scanner sees, or to where other robots said to be, drop out.
"""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.backend import Array
from usarmjx.models.drives import SkidSteer
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.ranging import ScannerSettings
from usarmjx.train.mapping.maps import to_robot_frame
from usarmjx.train.tasks.clearance import bounding_box_of

MARGIN = 0.06
"""Distance that a command must keep from what is known [m]: 1 cm of the INS, and how far beams are apart."""
HORIZONS = (0.2, 0.4)
"""Times for which commands are followed [s]: another robot at full speed comes 0.14 m nearer in an action."""
SPEED_SHARES = (1.0, 0.6, 0.3, 0.0)
"""Shares of the wanted speed that are tried."""
RETREAT = 0.3
"""Speed away from what is too near, as a share of the highest."""
MATE_MARGIN = 0.2
"""Distance in addition to that from other robots [m]: they said where they are an action ago, and go on."""
TURNS = (0.0, -0.15, 0.15, -0.3, 0.3)
"""Changes of the wanted turn that are tried, as shares of the highest speed."""
TURN_WEIGHT = 0.5
"""Cost of a changed turn beside that of a changed speed."""
FAR, CLOSE = 1e3, 0.01
"""Distance of what was not seen or heard of, and from the longest range of a beam that met nothing [m]."""
RECENT = 2.0
"""Age from which on it does not count where a robot said to be [s]."""


class Footprint(struct.PyTreeNode, kw_only=True):
    """A robot that skids, in the plane of its axes.

    Attributes:
        low: Its rear right corner [m] (2,).
        high: Its front left corner [m] (2,).
        top_speed: Speed of its wheels at full [m/s].
        lever: Difference of both sides' speeds over the turning rate [m].
        max_turn: Highest turning rate [rad/s].
    """

    low: Array
    high: Array
    top_speed: float = struct.field(pytree_node=False)
    lever: float = struct.field(pytree_node=False)
    max_turn: float = struct.field(pytree_node=False)


def footprint_of(robot: RobotSpec) -> Footprint | None:
    """Return the footprint of a robot; None: it does not skid on wheels or tracks whose lever is known."""
    drive = robot.drive
    if not isinstance(drive, SkidSteer) or not drive.lever:
        return None
    low, high = box_of(robot)
    return Footprint(
        low=low,
        high=high,
        top_speed=drive.top_speed,
        lever=drive.lever,
        max_turn=drive.max_turn,
    )


def box_of(robot: RobotSpec) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest corner of a robot in the plane of its axes [m] (2,), (2,)."""
    low, high = bounding_box_of(robot)
    return low[:2].astype(np.float32), high[:2].astype(np.float32)


def outline(low: Array, high: Array) -> np.ndarray:
    """Return the corners of a box and the middles of its sides [m] (8, 2)."""
    middle = (np.asarray(low) + np.asarray(high)) / 2
    xs, ys = (np.array([low[axis], middle[axis], high[axis]]) for axis in range(2))
    grid = np.stack(np.meshgrid(xs, ys, indexing="ij"), -1).reshape(-1, 2)
    # 4 is the middle of the three by three points.
    return np.delete(grid, 4, axis=0).astype(np.float32)


def moved(body: Footprint, command: jax.Array, time: float) -> tuple[jax.Array, jax.Array]:
    """Return where a command (..., 2) takes a robot: its position [m] (..., 2), and its yaw [rad] (...,)."""
    # Clipped per side, as `drive_values` does: a turn at full speed slows the robot.
    left, right = (jnp.clip(command[..., 0] + side * command[..., 1], -1.0, 1.0) for side in (-1, 1))
    speed = body.top_speed * (left + right) / 2
    rate = jnp.clip(body.top_speed * (right - left) / body.lever, -body.max_turn, body.max_turn)
    yaw = rate * time
    # The chord of an arc; sinc keeps straight ways exact.
    chord = speed * time * jnp.sinc(yaw / (2 * jnp.pi))
    return chord[..., None] * jnp.stack([jnp.cos(yaw / 2), jnp.sin(yaw / 2)], -1), yaw


def distance_from(body: Footprint, points: jax.Array, position: jax.Array, yaw: jax.Array) -> jax.Array:
    """Return the least distance of points (n, 2) from the box of a robot at a pose [m] ()."""
    away = points - position
    # The points turn back into the box's axes, in which its sides are straight.
    x = jnp.cos(yaw) * away[:, 0] + jnp.sin(yaw) * away[:, 1]
    y = jnp.cos(yaw) * away[:, 1] - jnp.sin(yaw) * away[:, 0]
    gap_x = jnp.maximum(jnp.maximum(body.low[0] - x, x - body.high[0]), 0.0)
    gap_y = jnp.maximum(jnp.maximum(body.low[1] - y, y - body.high[1]), 0.0)
    return jnp.sqrt((gap_x * gap_x + gap_y * gap_y).min())


def safe_command(body: Footprint, seen: jax.Array, mates: jax.Array, command: jax.Array) -> jax.Array:
    """Return the nearest safe command of one robot: speed and turn, as shares of the highest (2,).

    A command is safe if the robot keeps `MARGIN`, and `MATE_MARGIN` more from other robots, or where it is
    nearer already comes no nearer. If none is, the one that keeps farthest away is taken.

    Args:
        body: The robot.
        seen: Points that its scanner sees, in its axes [m] (n, 2).
        mates: Outlines of other robots, in its axes [m] (n, 2).
        command: Command that it wants (2,).
    """
    # A retreat both ways: the obstacle may be ahead or behind.
    speeds = jnp.concatenate([np.array(SPEED_SHARES) * command[0], np.array([-RETREAT, RETREAT])])
    turns = jnp.concatenate([command[1] + np.array(TURNS), jnp.zeros(1)])
    tried = jnp.stack(jnp.meshgrid(speeds, turns, indexing="ij"), -1).reshape(-1, 2)

    def clear_at(position: jax.Array, yaw: jax.Array) -> jax.Array:
        from_mates = distance_from(body, mates, position, yaw) - MATE_MARGIN
        return jnp.minimum(distance_from(body, seen, position, yaw), from_mates)

    def clear(one: jax.Array) -> jax.Array:
        return jnp.stack([clear_at(*moved(body, one, time)) for time in HORIZONS]).min()

    now = clear_at(jnp.zeros(2), jnp.zeros(()))
    clearances = jax.vmap(clear)(tried)
    # The slack keeps rounding from forbidding a robot inside the margin to stand still.
    safe = clearances >= jnp.minimum(MARGIN, now) - 1e-4
    cost = jnp.abs(tried - command) @ jnp.array([1.0, TURN_WEIGHT])
    best = jnp.where(safe.any(), jnp.where(safe, cost, jnp.inf).argmin(), clearances.argmax())
    return tried[best]


def mate_points(pose: jax.Array, mates: jax.Array, age: jax.Array, outlines: Array) -> jax.Array:
    """Return the outlines of other robots in a robot's axes [m] (n, 2); those not heard of lately: far away.

    Args:
        pose: The robot's: x, y [m], yaw [rad] (3,).
        mates: Poses that others reported (robots, 3).
        age: Of that [s] (robots,).
        outlines: Of each robot, in its axes [m] (robots, 8, 2).
    """
    cos, sin = jnp.cos(mates[:, 2:]), jnp.sin(mates[:, 2:])
    x, y = outlines[..., 0], outlines[..., 1]
    turned = jnp.stack([cos * x - sin * y, sin * x + cos * y], -1)
    where = jnp.where((age < RECENT)[:, None, None], mates[:, None, :2] + turned, FAR)
    return to_robot_frame(pose, where.reshape(-1, 2))


def beam_points(scanner: ScannerSettings, pose: Array, ranges: jax.Array) -> jax.Array:
    """Return where beams end, in the axes of their scanner's pose (3,) [m] (beams, 2); none: far away."""
    angle = pose[2] + scanner.resolution * np.arange(scanner.beams) - scanner.scan_fov / 2
    # Noise may bring a beam that met nothing a little below the longest range.
    reach = jnp.where(ranges < scanner.max_range - CLOSE, ranges, FAR)
    return jnp.asarray(pose)[:2] + reach[:, None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
