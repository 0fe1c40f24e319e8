"""Baseline of inspections: square up to the window, fly through it, turn to the point and hover before it."""

import jax
import jax.numpy as jnp

from usarmjx.base.errors import UsageError
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import ActionArrays, ObservationArrays, Policy
from usarmjx.train.tasks.hover_inspect import POSITION_SCALE, SPEED_SCALE, TURN_RATE_SCALE, HoverInspect

GAIN, TURN_GAIN = 1.0, 1.2
"""Speed over distance and turning rate over angle [1/s]."""
STANDOFF = 1.3
"""Least distance from the point at which it hovers, and from the window at which it squares up [m]."""
SQUARE = 0.12
"""Off the window's middle or its axis by less than this it flies through [m, rad]."""
TURN_FIRST = 0.6
"""With the point farther off its nose than this it turns on the spot [rad]."""
COMMIT_DISTANCE = 0.6
"""Nearer to the wall than this there is no way but on [m]: its front is in the window."""
WINDOW_SPEED = 0.8
"""Speed through a window [m/s]."""


def inspection_action(seen: jax.Array) -> jax.Array:
    """Return the action (4,) for one robot's observation of `HoverInspect` (n,)."""
    point, window = POSITION_SCALE * seen[:3], POSITION_SCALE * seen[3:6]
    yaw, there = jnp.arctan2(seen[7], seen[8]), seen[6] > 0.5
    return jnp.where(there, _through(point, window, yaw), _before(point))


def _through(point: jax.Array, window: jax.Array, yaw: jax.Array) -> jax.Array:
    """Fly through a window in a wall across x, with the nose along x."""
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)
    # Along the world's axes: to the window's middle, and which side of the wall the point is on.
    x, y = window[0] * cos - window[1] * sin, window[0] * sin + window[1] * cos
    side = jnp.sign(point[0] * cos - point[1] * sin - x)
    square = (jnp.abs(y) < SQUARE) & (jnp.abs(window[2]) < SQUARE) & (jnp.abs(yaw) < SQUARE)
    inside = side * x < COMMIT_DISTANCE
    along = jnp.where(square | inside, side * WINDOW_SPEED, GAIN * (x - side * STANDOFF))
    return _action(along * cos + GAIN * y * sin, GAIN * y * cos - along * sin, GAIN * window[2], -yaw)


def _before(point: jax.Array) -> jax.Array:
    """Hover before a point, the nose to it."""
    far, off = jnp.hypot(point[0], point[1]), jnp.arctan2(point[1], point[0])
    # Speeds turn with the body until the next action: it turns first, then goes.
    ahead = GAIN * (far - STANDOFF) * jnp.clip((TURN_FIRST - jnp.abs(off)) / 0.3, 0.0, 1.0)
    return _action(ahead * jnp.cos(off), ahead * jnp.sin(off), GAIN * point[2], off)


def _action(forward: jax.Array, left: jax.Array, up: jax.Array, turn: jax.Array) -> jax.Array:
    """Return the action for speeds [m/s], slower if they are too fast, and a turn to the left [rad]."""
    speed = jnp.stack([forward, -left])
    # Both by one factor: each cut by itself would turn the direction of flight.
    speed = speed / jnp.maximum(jnp.linalg.norm(speed), 1.0)
    clockwise = jnp.clip(-TURN_GAIN * turn / TURN_RATE_SCALE, -1.0, 1.0)
    return jnp.concatenate(
        [jnp.clip(up / SPEED_SCALE, -0.5, 0.5)[None], speed / SPEED_SCALE, clockwise[None]]
    )


def inspection_policy(env: Env) -> Policy:
    """Return the baseline of `hover-inspect`; its carry is empty.

    Raises:
        UsageError: Another task.
    """
    if not isinstance(env.task, HoverInspect):
        raise UsageError(f"this policy inspects points from the air, not {env.name}")

    def act(carry: tuple[()], obs: ObservationArrays, key: jax.Array) -> tuple[tuple[()], ActionArrays]:
        del key
        return carry, (jax.vmap(jax.vmap(inspection_action))(obs[0]),)

    return Policy(initial_carry=lambda worlds: (), act=act)
