"""Baseline of stairs: straight on, front flippers up to the first edge, then all flat."""

import math

import jax
import jax.numpy as jnp

from usarmjx.base.errors import UsageError
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import ActionArrays, ObservationArrays, Policy
from usarmjx.train.tasks.stairs import MAX_FLIPPER_ANGLE, Stairs

UP = 0.6
"""Angle of the front flippers before the first step [rad]."""
ON_STAIRS = 0.2
"""With its nose farther up than this it is on the stairs [rad]."""
STEER = 1.5
"""Share by which one track is slower than the other, per radian off the goal [1/rad]."""


def climb_action(seen: jax.Array, pace: float) -> jax.Array:
    """Return the action (2,) or (4,) for one robot's observation of `Stairs` (n,); `pace` is a share."""
    off = jnp.arctan2(seen[1], seen[0])
    turn = jnp.clip(STEER * off, -1.0, 1.0)
    # One track is slowed down, instead of the other one being faster than the pace.
    left, right = pace * jnp.minimum(1.0 - turn, 1.0), pace * jnp.minimum(1.0 + turn, 1.0)
    return jnp.stack([left, right])


def flipper_targets(seen: jax.Array, taper: float) -> jax.Array:
    """Return where front and rear flippers shall go (2,); `taper` is their lower edge's angle [rad]."""
    on_stairs = seen[6] > ON_STAIRS
    front = jnp.where(on_stairs, -taper, UP)
    return jnp.stack([front, jnp.where(on_stairs, -taper, 0.0)]) / MAX_FLIPPER_ANGLE


def climb_policy(env: Env) -> Policy:
    """Return the baseline of `stairs`; its carry is empty.

    Raises:
        UsageError: Another task.
    """
    task = env.task
    if not isinstance(task, Stairs):
        raise UsageError(f"this policy climbs stairs, not {env.name}")
    robot, size = env.scene.groups[0].robot, env.groups[0].action_size
    # No faster than 0.6 m/s.
    pace, taper = min(1.0, 0.6 / robot.drive.top_speed), 0.0
    tip = [part for part in robot.parts if part.parent == "FRFlipper"]
    if tip:
        # With flippers straight down to the line of the tracks the robot has a long flat underside.
        taper = math.asin((robot.wheel_radius - tip[-1].shapes[0].size[0]) / tip[-1].at[0])

    def one(seen: jax.Array) -> jax.Array:
        tracks = climb_action(seen, pace)
        return tracks if size == 2 else jnp.concatenate([tracks, flipper_targets(seen, taper)])

    def act(carry: tuple[()], obs: ObservationArrays, key: jax.Array) -> tuple[tuple[()], ActionArrays]:
        del key
        return carry, (jax.vmap(jax.vmap(one))(obs[0]),)

    return Policy(initial_carry=lambda worlds: (), act=act)
