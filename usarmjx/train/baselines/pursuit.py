"""Baseline of convoys: pure pursuit of a point of the lane ahead, at a constant time behind the next car."""

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.models.drives import Ackermann
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import ActionArrays, ObservationArrays, Policy
from usarmjx.train.tasks.convoy import AHEAD, BEAMS, RANGE_SCALE, SPEED_SCALE, Convoy

LOOKAHEAD = 3.0, 0.6
"""Along the lane from the rear axle to the point that is steered for: at rest [m], and more per speed [s]."""
LANE = 1.5
"""Distance from the lane's middle within which solids are in the way [m]."""
CATCH_UP = 1.25
"""Highest speed, as a multiple of the target speed, to close a gap."""


def pursuit_action(seen: jax.Array, task: Convoy) -> jax.Array:
    """Return the action (2,) for one car's observation of `Convoy` (n,)."""
    car = task.robots[0]
    assert isinstance(car.drive, Ackermann)  # as `robots` says
    speed, target = SPEED_SCALE * seen[3], SPEED_SCALE * seen[4]
    points = RANGE_SCALE * seen[5 : 5 + 2 * len(AHEAD)].reshape(-1, 2)
    goal = _between(points, LOOKAHEAD[0] + LOOKAHEAD[1] * speed)
    # The circle through the rear axle, along the car's heading there, and the point.
    # A point at the axle has no circle.
    bend = 2.0 * goal[1] / jnp.maximum((goal**2).sum(), 1e-3)
    # The bicycle model: front wheels at this angle lead the rear axle along the circle.
    steer = jnp.arctan(car.wheel_base * bend) / car.drive.max_front_steer
    gap = _gap(RANGE_SCALE * seen[5 + 2 * len(AHEAD) :], points, car.dimensions[0] / 2 + car.wheel_base / 2)
    wanted = jnp.where(gap >= RANGE_SCALE, target, (gap - task.standstill) / task.headway)
    catching = jnp.where(gap >= RANGE_SCALE, 1.0, CATCH_UP) * target
    return jnp.clip(jnp.stack([jnp.clip(wanted, 0.0, catching) / SPEED_SCALE, steer]), -1.0, 1.0)


def _between(points: jax.Array, along: jax.Array) -> jax.Array:
    """Return the lane's point so far along from the rear axle [m] (2,)."""
    return jnp.stack([jnp.interp(along, np.array(AHEAD), points[:, i]) for i in range(2)])


def _gap(scan: jax.Array, points: jax.Array, front: float) -> jax.Array:
    """Return how far away something in the lane is, by the scanner at `front` of the rear axle [m] ()."""
    angle = np.linspace(-0.6, 0.6, BEAMS)
    hit = jnp.stack([front + scan * np.cos(angle), scan * np.sin(angle)], -1)
    # Every half metre: against the width of the lane the nearest point is as good as the nearest part.
    x = jnp.arange(0.0, AHEAD[-1], 0.5)
    lane = jnp.stack([jnp.interp(x, np.array(AHEAD), points[:, i]) for i in range(2)], -1)
    aside = jnp.linalg.norm(hit[:, None] - lane, axis=-1).min(-1)
    # A beam without an echo has the longest range, but for rounding.
    return jnp.where((aside < LANE) & (scan < 0.999 * RANGE_SCALE), scan, RANGE_SCALE).min()


def pursuit_policy(env: Env) -> Policy:
    """Return the baseline of `convoy`; its carry is empty.

    Raises:
        UsageError: Another task.
    """
    task = env.task
    if not isinstance(task, Convoy):
        raise UsageError(f"this policy drives in convoys, not in {env.name}")

    def one(seen: jax.Array) -> jax.Array:
        return pursuit_action(seen, task)

    def act(carry: tuple[()], obs: ObservationArrays, key: jax.Array) -> tuple[tuple[()], ActionArrays]:
        del key
        return carry, (jax.vmap(jax.vmap(one))(obs[0]),)

    return Policy(initial_carry=lambda worlds: (), act=act)
