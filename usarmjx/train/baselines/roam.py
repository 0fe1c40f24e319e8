"""About: straight on, away from walls beside, and where the way ends a turn to the more open side."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.models.drives import Ackermann
from usarmjx.models.types.robot import RobotSpec
from usarmjx.train.baselines.steering import ANGLES, NO_OBSTACLE_DISTANCE, driver, free_distances, obstacles
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import ActionArrays, ObservationArrays, Policy
from usarmjx.train.tasks.clearance import bounding_box_of
from usarmjx.train.tasks.wander import Wander

STOP, GO, SLOW_DISTANCE = 0.2, 0.45, 0.7
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
    front = lengths[int(np.argmin(np.abs(ANGLES)))]
    left, right = (_beside(points, robot, side) for side in (1.0, -1.0))
    reach = jnp.minimum(lengths, 3.0)
    open_left, open_right = ((reach * ((np.sin(ANGLES) * side) > 0.3)).sum() for side in (1.0, -1.0))
    better = jnp.where(open_left > open_right, 1.0, -1.0)
    ends = front < jnp.where(turning == 0, STOP, GO)
    turning = jnp.where(ends, jnp.where(turning == 0, better, turning), 0.0)
    push = jnp.maximum(KEEP_OFF - right, 0.0) - jnp.maximum(KEEP_OFF - left, 0.0)
    ahead = jnp.clip(front / SLOW_DISTANCE, 0.25, 1.0)
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
