"""To a goal: straight on, and along walls that bar the way (after Lumelsky and Stepanov's bug algorithm)."""

import jax
import jax.numpy as jnp
from flax import struct

from usarmjx.base.errors import UsageError
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.train.baselines.steering import choose_way, head_for, obstacles, way_lengths, wrapped
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.policy import Actions, Observations, Policy
from usarmjx.train.tasks.drive_to_goal import FAR, DriveToGoal

GAIN = 0.4
"""So much nearer to the goal than where the wall began it leaves the wall [m]."""
BARRED = 0.9
"""A way that leads off the goal's direction by more than this is one along a wall [rad]."""
HUG = 1.9
"""How far to the wall's side of its heading it looks for a way along the wall [rad]."""


class BugMemory(struct.PyTreeNode, kw_only=True):
    """What it remembers.

    Attributes:
        side: 0 on the way to the goal; 1 along a wall on its right, -1 along one on its left ().
        best: Distance from the goal where the wall began [m] ().
    """

    side: jax.Array
    best: jax.Array


def unwalled(*shape: int) -> BugMemory:
    """Return what robots remember at first (shape)."""
    return BugMemory(side=jnp.zeros(shape), best=jnp.zeros(shape))


def toward(
    robot: RobotSpec, kinds: tuple[str, ...], memory: BugMemory, obs: jax.Array
) -> tuple[BugMemory, jax.Array]:
    """Return the memory and the action (keys,) for one robot's observation of `DriveToGoal` (n,).

    Distances are those that the observation tells: at most 10 m.
    """
    bearing, distance = jnp.arctan2(obs[1], obs[0]), FAR * obs[2]
    lengths = way_lengths(obstacles(obs[4:], robot, kinds), robot)
    # What lies behind the goal bars no way to it.
    lengths = jnp.where(lengths > distance, jnp.inf, lengths)
    straight, free = choose_way(lengths, bearing, jnp.zeros(()))
    off = wrapped(straight - bearing)
    barred = jnp.abs(off) > BARRED
    leave = (distance < memory.best - GAIN) & ~barred
    along = (memory.side != 0) & ~leave
    begins = ~along & barred
    side = jnp.where(along, memory.side, jnp.where(begins, jnp.sign(off), 0.0))
    hugging, hug_free = choose_way(lengths, -side * HUG, side)
    best = jnp.where(begins, distance, memory.best)
    walled = side != 0
    action = head_for(jnp.where(walled, hugging, straight), jnp.where(walled, hug_free, free), robot)
    return BugMemory(side=side, best=best), action


def go_to_goal(env: Env) -> Policy:
    """Return the baseline of `drive-to-goal`.

    Raises:
        UsageError: Another task; a robot that hand-written policies cannot drive.
    """
    task = env.task
    if not isinstance(task, DriveToGoal):
        raise UsageError(f"this policy goes to the goals of drive-to-goal, not of {env.name}")
    robot, kinds = env.scene.teams[0].robot, task.ranges

    def one(memory: BugMemory, obs: jax.Array) -> tuple[BugMemory, jax.Array]:
        return toward(robot, kinds, memory, obs)

    def act(memory: BugMemory, obs: Observations, key: jax.Array) -> tuple[BugMemory, Actions]:
        del key
        memory, actions = jax.vmap(jax.vmap(one))(memory, obs[0])
        return memory, (actions,)

    return Policy(start=lambda worlds: unwalled(worlds, 1), act=act)
