"""Rigid bodies under the forces of their drives: what flies and dives."""

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco

from usarmjx.base.arrays import Array
from usarmjx.base.rotations import (
    Components,
    MatrixRows,
    apply,
    cross,
    dot,
    matrix_rows,
    minus,
    parts,
    plus,
    quat_times,
    rotation,
    times,
    transposed,
)
from usarmjx.engines.planar.bodies import Motion, PlanarRobots
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.overlap import Outlines, side_depth

SMALL = 1e-2
"""Of smaller angles a sine is known by two terms [rad]."""
BESIDE = 0.05
"""What flies is held up by others that it is over, or that it is beside by no more than this [m]."""
HELD_GAP = 1e-4
"""Gap between one that is held up and the other's top [m]."""
FLIGHT_STEP = 0.01
"""Bodies in flight turn too fast for longer steps [s]."""
STACKED = 3
"""So many are held up by each other, one over the other."""


def fly(robots: PlanarRobots, motion: Motion, wrench: Array, model: mujoco.MjModel, dt: float) -> Motion:
    """Return where robots are after a control step, were they free bodies.

    Semi-implicit Euler, as MuJoCo's, in as many steps as it would make, or more: none beyond `FLIGHT_STEP`.

    Args:
        robots: The robots of the model.
        motion: Where they are.
        wrench: Forces [N] and torques [N m] on the model's bodies, world axes (nbody, 6).
        model: The model.
        dt: Length of a control step [s].
    """
    if not robots.flies.any():
        return motion
    push = parts(wrench[robots.chassis])
    pull = plus([number / robots.mass for number in push[:3]], model.opt.gravity.tolist())
    fixed = _Fixed(parts(robots.centre), *map(matrix_rows, (robots.inertia, robots.inverse_inertia)))
    steps = max(round(dt / model.opt.timestep), math.ceil(dt / FLIGHT_STEP - 1e-6))
    step = partial(_step, fixed, pull, push[3:], dt / steps)
    now = _Moving(*map(parts, (motion.pos, motion.quat, motion.linear, motion.angular)))
    flown = jax.lax.fori_loop(0, steps, lambda _, now: step(now), now)
    pos, quat, linear, angular = (jnp.stack(numbers, -1) for numbers in flown)
    return motion.replace(pos=pos, quat=quat, linear=linear, angular=angular)


class _Moving(NamedTuple):
    """Where bodies are and how they move: as a `Motion`, each number an array of its own (robots,)."""

    pos: Components
    quat: Components
    linear: Components
    angular: Components


class _Fixed(NamedTuple):
    """What of bodies does not change: their centres of mass, their inertia about these, and its inverse."""

    centre: Components
    inertia: MatrixRows
    inverse: MatrixRows


def _step(body: _Fixed, pull: Components, torque: Components, h: float, now: _Moving) -> _Moving:
    """Return where bodies are a physics step [s] later, pulled [m/s^2] and turned [N m] in world axes."""
    mat = rotation(now.quat)
    arm = apply(mat, body.centre)
    spin = apply(mat, now.angular)
    centre, speed = plus(now.pos, arm), plus(now.linear, cross(spin, arm))
    speed = plus(speed, times(pull, h))
    own = apply(transposed(mat), torque)
    gyration = cross(now.angular, apply(body.inertia, now.angular))
    angular = plus(now.angular, times(apply(body.inverse, minus(own, gyration)), h))
    quat = turned(now.quat, times(angular, h))
    mat = rotation(quat)
    arm = apply(mat, body.centre)
    pos = minus(plus(centre, times(speed, h)), arm)
    return _Moving(pos, quat, minus(speed, cross(apply(mat, angular), arm)), angular)


def held_up(robots: PlanarRobots, old: Footprints, after: Motion) -> tuple[Motion, Array | None]:
    """Return motions in which nothing that flies sinks into a robot below it.

    The one is over the other if that is the shorter way out of it: if it is less far below its top than their
    rectangles overlap on the plan. It comes no lower than that top then, and no slower than it.

    Args:
        robots: The robots of a world.
        old: Where they are.
        after: Where they would go.

    Returns:
        Where they go; and which are over or under each other, who cannot meet from aside (robots, robots).
        None: nobody flies.
    """
    if not robots.flies.any():
        return after, None
    new = robots.footprints(after)
    aside, later = _overlap_aside(old), _overlap_aside(new)
    sunk = old.high - old.low[:, None]
    higher = (old.low + old.high)[:, None] > old.low + old.high
    over = robots.flies[:, None] & higher & (sunk < aside)
    held = over & (jnp.maximum(aside, later) > -BESIDE)
    low, upward = new.low, after.linear[:, 2]
    for _ in range(min(STACKED, robots.count - 1)):
        # What stands on the ground has not been put back on it yet.
        tops = jnp.where(held, jnp.maximum(low, old.low) + robots.height + HELD_GAP, -jnp.inf)
        speed = jnp.take(upward, tops.argmax(-1))
        lifted = tops.max(-1) > low
        upward = jnp.where(lifted, jnp.maximum(upward, speed), upward)
        low = jnp.maximum(low, tops.max(-1))
    pos = jnp.concatenate([after.pos[:, :2], (low + robots.clearance)[:, None]], -1)
    pos = jnp.where((low > new.low)[:, None], pos, after.pos)
    linear = jnp.concatenate([after.linear[:, :2], upward[:, None]], -1)
    return after.replace(pos=pos, linear=linear), over | over.T


def _overlap_aside(prints: Footprints) -> Array:
    """Return by how much the rectangles of robots overlap on the plan [m] (robots, robots)."""
    mine = prints.outlines
    return side_depth(Outlines(*(part[:, None] for part in mine)), mine)[0]


def sine_over(angle: Array) -> Array:
    """Return sines of angles over these (...), with a slope however small they are."""
    small = jnp.abs(angle) < SMALL
    safe = jnp.where(small, 1.0, angle)
    return jnp.where(small, 1.0 - angle * angle / 6, jnp.sin(safe) / safe)


def turned(quat: Sequence[Array], angle: Sequence[Array]) -> Components:
    """Return orientations turned about axes of their own by rotation vectors."""
    half = times(angle, 0.5)
    square = dot(half, half)
    turns = square > SMALL**2
    size = jnp.where(turns, jnp.sqrt(jnp.where(turns, square, 1.0)), 0.0)  # a root has no slope at 0
    cosine = jnp.where(turns, jnp.cos(size), 1.0 - square / 2)
    sine = jnp.where(turns, sine_over(size), 1.0 - square / 6)
    new = quat_times(quat, (cosine, *times(half, sine)))
    norm = jnp.sqrt(dot(new, new))
    return tuple(number / norm for number in new)
