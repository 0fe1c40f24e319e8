"""Baselines of one robot among obstacles: it finds a free direction and drives there.

`bug_policy` goes to a goal, along walls that bar the way (after Lumelsky and Stepanov's bug algorithm).
`roam_policy` goes straight on, away from walls beside, and where the way ends turns to the more open side.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import wrap_angle
from usarmjx.models.drives import Ackermann, RotaryWing, SkidSteer, Tracks
from usarmjx.models.types.robot import RobotSpec
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import ActionArrays, ObservationArrays, Policy
from usarmjx.train.tasks.clearance import bounding_box_of
from usarmjx.train.tasks.drive_to_goal import MAX_GOAL_DISTANCE, DriveToGoal
from usarmjx.train.tasks.team import MAX_RANGE, range_lines
from usarmjx.train.tasks.wander import Wander

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
        # Rear wheels turn the other way, for a tighter curve.
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
    # Both sides alike, or the curve would change where one is beyond its limit.
    return action / jnp.maximum(jnp.abs(action).max(), 1.0)


def obstacles(seen: jax.Array, robot: RobotSpec, kinds: tuple[str, ...]) -> jax.Array:
    """Return the points that range readings (n,) mean, in the robot's axes [m] (n, 2); none: far away."""
    origin, angle = range_lines(robot, kinds)
    along = np.stack([np.cos(angle), np.sin(angle)], -1)
    # A reading of 1 means nothing was met.
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
    # A little is added, as rounding would make the wanted direction itself the last one round.
    around = jnp.mod(side * off + 1e-3, 2 * jnp.pi)
    cost = jnp.where(side == 0, jnp.abs(off), around)
    # Blocked ones only where all are blocked, and then the longest of them.
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


LEAVE_MARGIN = 0.4
"""Gain on the distance at which the wall began from which on it leaves the wall [m]."""
BLOCKED_ANGLE = 0.9
"""A way that leads off the goal's direction by more than this is one along a wall [rad]."""
WALL_FOLLOW_ANGLE = 1.9
"""Angle to the wall's side of the heading up to which it looks for a way along the wall [rad]."""


class BugCarry(struct.PyTreeNode, kw_only=True):
    """Memory that a robot following walls carries from step to step.

    Attributes:
        side: 0 on the way to the goal; 1 along a wall on its right, -1 along one on its left ().
        best: Distance from the goal where the wall began [m] ().
    """

    side: jax.Array
    best: jax.Array


def initial_bug_carry(*shape: int) -> BugCarry:
    """Return the carry of robots at first (*shape)."""
    return BugCarry(side=jnp.zeros(shape), best=jnp.zeros(shape))


def bug_action(
    robot: RobotSpec, kinds: tuple[str, ...], carry: BugCarry, obs: jax.Array
) -> tuple[BugCarry, jax.Array]:
    """Return the carry and the action (keys,) for one robot's observation of `DriveToGoal` (n,).

    Distances are those of the observation: at most 10 m.
    """
    bearing, distance = jnp.arctan2(obs[1], obs[0]), MAX_GOAL_DISTANCE * obs[2]
    lengths = free_distances(obstacles(obs[4:], robot, kinds), robot)
    # Obstacles behind the goal do not block the way to it.
    lengths = jnp.where(lengths > distance, jnp.inf, lengths)
    straight, free = choose_direction(lengths, bearing, jnp.zeros(()))
    off = wrap_angle(straight - bearing)
    barred = jnp.abs(off) > BLOCKED_ANGLE
    # Nearer than where the wall began: else it could follow the same wall for ever.
    leave = (distance < carry.best - LEAVE_MARGIN) & ~barred
    along = (carry.side != 0) & ~leave
    begins = ~along & barred
    side = jnp.where(along, carry.side, jnp.where(begins, jnp.sign(off), 0.0))
    hugging, hug_free = choose_direction(lengths, -side * WALL_FOLLOW_ANGLE, side)
    best = jnp.where(begins, distance, carry.best)
    walled = side != 0
    action = steer_toward(jnp.where(walled, hugging, straight), jnp.where(walled, hug_free, free), robot)
    return BugCarry(side=side, best=best), action


def bug_policy(env: Env) -> Policy:
    """Return the baseline of `drive-to-goal`.

    Raises:
        UsageError: Another task; a robot that hand-written policies cannot drive.
    """
    task = env.task
    if not isinstance(task, DriveToGoal):
        raise UsageError(f"this policy goes to the goals of drive-to-goal, not of {env.name}")
    robot, kinds = env.scene.groups[0].robot, task.ranges

    def one(carry: BugCarry, obs: jax.Array) -> tuple[BugCarry, jax.Array]:
        return bug_action(robot, kinds, carry, obs)

    def act(carry: BugCarry, obs: ObservationArrays, key: jax.Array) -> tuple[BugCarry, ActionArrays]:
        del key
        carry, actions = jax.vmap(jax.vmap(one))(carry, obs[0])
        return carry, (actions,)

    return Policy(initial_carry=lambda worlds: initial_bug_carry(worlds, 1), act=act)


STOP, GO, SLOW_AHEAD = 0.2, 0.45, 0.7
"""Free ahead of the robot's front [m]: below the first it turns, until the second is free; below the third
it is slow."""
KEEP_OFF = 0.35
"""Nearer than this beside the robot pushes it to the other side [m]."""
STEER = 2.5
"""Turn, as a share, per metre of that."""
BESIDE_SHARE = 1.2
"""Distance ahead and behind up to which solids are beside the robot [half lengths of the robot]."""


def roam_action(
    robot: RobotSpec, kinds: tuple[str, ...], turning: jax.Array, obs: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the carry `turning` () and the action (keys,) for one robot's observation of `Wander` (n,).

    Args:
        robot: The robot.
        kinds: Types of its range sensors.
        turning: Which way it turns on the spot, 1 for left, -1 for right; 0: it drives ().
        obs: Its observation.
    """
    points = obstacles(obs, robot, kinds)
    lengths = free_distances(points, robot)
    # Straight ahead; a constant index, which needs no gather.
    front = lengths[int(np.argmin(np.abs(ANGLES)))]
    left, right = (_beside(points, robot, side) for side in (1.0, -1.0))
    reach = jnp.minimum(lengths, 3.0)
    open_left, open_right = ((reach * ((np.sin(ANGLES) * side) > 0.3)).sum() for side in (1.0, -1.0))
    better = jnp.where(open_left > open_right, 1.0, -1.0)
    ends = front < jnp.where(turning == 0, STOP, GO)
    # It keeps its side while it turns, or it would swing between two walls.
    turning = jnp.where(ends, jnp.where(turning == 0, better, turning), 0.0)
    push = jnp.maximum(KEEP_OFF - right, 0.0) - jnp.maximum(KEEP_OFF - left, 0.0)
    ahead = jnp.clip(front / SLOW_AHEAD, 0.25, 1.0)
    drive = driver(robot)
    going = drive(ahead, jnp.clip(STEER * push, -1.0, 1.0))
    # A car, which cannot turn on the spot, backs up the other way.
    spot = (
        drive(jnp.float32(-0.4), -turning)
        if isinstance(robot.drive, Ackermann)
        else drive(0.0 * ahead, turning)
    )
    return turning, jnp.where(turning == 0, going, spot)


def _beside(points: jax.Array, robot: RobotSpec, side: float) -> jax.Array:
    """Return how far the robot's side is from what is beside it: 1 for the left, -1 for the right [m] ()."""
    low, high = bounding_box_of(robot)
    away = side * points[:, 1] - float(max(high[1], -low[1]))
    here = (jnp.abs(points[:, 0]) < BESIDE_SHARE * float(high[0])) & (side * points[:, 1] > 0)
    return jnp.where(here, away, NO_OBSTACLE_DISTANCE).min(initial=NO_OBSTACLE_DISTANCE)


def roam_policy(env: Env) -> Policy:
    """Return the baseline of `wander`.

    Raises:
        UsageError: Another task; a robot that hand-written policies cannot drive.
    """
    task = env.task
    if not isinstance(task, Wander):
        raise UsageError(f"this policy wanders as wander asks for, not as {env.name} does")
    robot, kinds = env.scene.groups[0].robot, task.ranges

    def act(turning: jax.Array, obs: ObservationArrays, key: jax.Array) -> tuple[jax.Array, ActionArrays]:
        del key
        turning, actions = jax.vmap(jax.vmap(partial(roam_action, robot, kinds)))(turning, obs[0])
        return turning, (actions,)

    return Policy(initial_carry=lambda worlds: jnp.zeros((worlds, 1)), act=act)
