"""Rigid-body motion of flying and diving robots, under the forces of their drives."""

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco

from usarmjx.base.backend import Array
from usarmjx.base.compilation import unroll_on_gpu
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
from usarmjx.engines.planar.overlap import Outlines, rectangle_overlap

SMALL_ANGLE = 1e-2
"""Angle below which two terms of the sine's series suffice [rad]."""
SIDE_GAP = 0.05
"""Horizontal gap up to which a flying robot can still rest on another [m]."""
HELD_GAP = 1e-4
"""Vertical gap between a resting robot and the top of the other [m]."""
FLIGHT_STEP = 0.01
"""Longest integration step of flying robots [s]: they rotate too fast for longer ones."""
GPU_STEPS = 8
"""Steps of flight in a row on a GPU, where each turn of a loop adds launches of its own."""
MAX_STACK = 3
"""Largest number of robots resting on each other in a stack."""


def fly(robots: PlanarRobots, motion: Motion, wrench: Array, model: mujoco.MjModel, dt: float) -> Motion:
    """Return the robots' motion after a control step as free bodies.

    Semi-implicit Euler, as MuJoCo's, with at least as many steps as MuJoCo, and none longer than
    `FLIGHT_STEP`.

    Args:
        robots: Robots of the model.
        motion: Their motion.
        wrench: Forces [N] and torques [N m] on the model's bodies, world axes (nbody, 6).
        model: The model.
        dt: Length of a control step [s].
    """
    if not robots.flies.any():
        return motion
    push = parts(wrench[robots.chassis])
    pull = plus([number / robots.mass for number in push[:3]], model.opt.gravity.tolist())
    fixed = _BodyConstants(parts(robots.centre), *map(matrix_rows, (robots.inertia, robots.inverse_inertia)))
    # The small number: a quotient just above a whole number by rounding must not add a step.
    steps = max(round(dt / model.opt.timestep), math.ceil(dt / FLIGHT_STEP - 1e-6))
    step = partial(_step, fixed, pull, push[3:], dt / steps)
    now = _BodyMotion(*map(parts, (motion.pos, motion.quat, motion.linear, motion.angular)))
    unroll = unroll_on_gpu(min(steps, GPU_STEPS))
    flown = jax.lax.fori_loop(0, steps, lambda _, now: step(now), now, unroll=unroll)
    pos, quat, linear, angular = (jnp.stack(numbers, -1) for numbers in flown)
    return motion.replace(pos=pos, quat=quat, linear=linear, angular=angular)


class _BodyMotion(NamedTuple):
    """Motion of bodies: a `Motion` with each component an array of its own (robots,)."""

    pos: Components
    quat: Components
    linear: Components
    angular: Components


class _BodyConstants(NamedTuple):
    """Constants of bodies: centres of mass, inertia about these, and its inverse."""

    centre: Components
    inertia: MatrixRows
    inverse: MatrixRows


def _step(
    body: _BodyConstants, pull: Components, torque: Components, h: float, now: _BodyMotion
) -> _BodyMotion:
    """Return the motion one physics step [s] later, under accelerations [m/s^2] and torques [N m].

    Both are in world axes.
    """
    mat = rotation(now.quat)
    arm = apply(mat, body.centre)
    # As of MuJoCo's free joints: linear rates are in world axes, angular ones in the body's.
    spin = apply(mat, now.angular)
    centre, speed = plus(now.pos, arm), plus(now.linear, cross(spin, arm))
    # The centre of mass is moved, not the origin: only there forces and turning are independent.
    speed = plus(speed, times(pull, h))
    own = apply(transposed(mat), torque)
    # Euler's equations: angular rates and inertia are in the body frame.
    gyration = cross(now.angular, apply(body.inertia, now.angular))
    angular = plus(now.angular, times(apply(body.inverse, minus(own, gyration)), h))
    quat = rotate(now.quat, times(angular, h))
    mat = rotation(quat)
    arm = apply(mat, body.centre)
    pos = minus(plus(centre, times(speed, h)), arm)
    return _BodyMotion(pos, quat, minus(speed, cross(apply(mat, angular), arm)), angular)


def resolve_stacking(robots: PlanarRobots, old: Footprints, after: Motion) -> tuple[Motion, Array | None]:
    """Correct motions so that no flying robot sinks into a robot below it.

    A robot counts as above another if that is the shorter way out: if its depth below the other's top is less
    than the horizontal overlap of their rectangles. It then stays above that top, and does not descend faster
    than it.

    Args:
        robots: Robots of a world.
        old: Their footprints.
        after: Their proposed motion.

    Returns:
        The corrected motion; and which robots are stacked, whose side contacts are ignored (robots, robots).
        None: no robot flies.
    """
    if not robots.flies.any():
        return after, None
    new = robots.footprints(after)
    aside, later = _horizontal_overlap(old), _horizontal_overlap(new)
    # Rows are the upper robots, columns the lower ones.
    sunk = old.high - old.low[:, None]
    higher = (old.low + old.high)[:, None] > old.low + old.high
    over = robots.flies[:, None] & higher & (sunk < aside)
    resting = over & (jnp.maximum(aside, later) > -SIDE_GAP)
    low, upward = new.low, after.linear[:, 2]
    # One more robot of a stack finds its height in each pass.
    for _ in range(min(MAX_STACK, robots.count - 1)):
        # Robots on the ground have not been placed on it yet in this step.
        tops = jnp.where(resting, jnp.maximum(low, old.low) + robots.height + HELD_GAP, -jnp.inf)
        speed = jnp.take(upward, tops.argmax(-1))
        lifted = tops.max(-1) > low
        upward = jnp.where(lifted, jnp.maximum(upward, speed), upward)
        low = jnp.maximum(low, tops.max(-1))
    pos = jnp.concatenate([after.pos[:, :2], (low + robots.clearance)[:, None]], -1)
    # Others keep their exact bits: heights computed back and forth are rounded.
    pos = jnp.where((low > new.low)[:, None], pos, after.pos)
    linear = jnp.concatenate([after.linear[:, :2], upward[:, None]], -1)
    # Both ways round: neither pushes the other aside.
    return after.replace(pos=pos, linear=linear), over | over.T


def _horizontal_overlap(footprints: Footprints) -> Array:
    """Return the horizontal overlap of the robots' rectangles [m] (robots, robots)."""
    mine = footprints.outlines
    return rectangle_overlap(Outlines(*(part[:, None] for part in mine)), mine)[0]


def sinc(angle: Array) -> Array:
    """Return sin(x) / x (...), differentiable at 0."""
    small = jnp.abs(angle) < SMALL_ANGLE
    # The unused branch must be finite: its derivative is multiplied by 0, and 0 times NaN is NaN.
    safe = jnp.where(small, 1.0, angle)
    return jnp.where(small, 1.0 - angle * angle / 6, jnp.sin(safe) / safe)


def rotate(quat: Sequence[Array], angle: Sequence[Array]) -> Components:
    """Rotate orientations by rotation vectors in the body frame."""
    half = times(angle, 0.5)
    square = dot(half, half)
    turns = square > SMALL_ANGLE**2
    size = jnp.where(
        turns, jnp.sqrt(jnp.where(turns, square, 1.0)), 0.0
    )  # the root's derivative is infinite at 0
    cosine = jnp.where(turns, jnp.cos(size), 1.0 - square / 2)
    sine = jnp.where(turns, sinc(size), 1.0 - square / 6)
    new = quat_times(quat, (cosine, *times(half, sine)))
    # Products of many steps drift away from length 1 in single precision.
    norm = jnp.sqrt(dot(new, new))
    return tuple(number / norm for number in new)
