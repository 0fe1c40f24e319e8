"""To a goal: straight on, and along walls that bar the way (after Lumelsky and Stepanov's bug algorithm)."""

import jax
import jax.numpy as jnp
from flax import struct

from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import wrap_angle
from usarmjx.models.types.robot import RobotSpec
from usarmjx.train.baselines.steering import choose_direction, free_distances, obstacles, steer_toward
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import ActionArrays, ObservationArrays, Policy
from usarmjx.train.tasks.drive_to_goal import MAX_GOAL_DISTANCE, DriveToGoal

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
    # What lies behind the goal bars no way to it.
    lengths = jnp.where(lengths > distance, jnp.inf, lengths)
    straight, free = choose_direction(lengths, bearing, jnp.zeros(()))
    off = wrap_angle(straight - bearing)
    barred = jnp.abs(off) > BLOCKED_ANGLE
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
