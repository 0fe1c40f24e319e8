"""Robots that roll: from what their wheels are told to where they come to, on the ground."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import set_rows
from usarmjx.base.compilation import materialize
from usarmjx.base.rotations import parts
from usarmjx.engines.base import Inputs
from usarmjx.engines.planar.bodies import Motion, PlanarRobots, on_plan
from usarmjx.engines.planar.drives import follow
from usarmjx.engines.planar.flight import sine_over
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.overlap import SIGNS

GRAVITY = 9.81
STANCE = 0.8
"""Robots stand at this share of their footprints' sides from the middle."""
STEEPEST_TILT = 0.6
"""Robots tilt by no more, as rise over run: one that hangs over an edge does not stand on its nose."""
IN_THE_AIR = 0.02
"""What is so far above the ground keeps its tilt [m]."""


def roll(robots: PlanarRobots, before: Any, state: Any, inputs: Inputs, dt: float) -> tuple[Any, Array]:  # noqa: ANN401
    """Return the state with the wheels turned, and the twists of the chassis.

    Args:
        robots: The robots.
        before: A state with qpos and qvel, of one world, at the beginning of the step.
        state: The same with the other joints moved, and act.
        inputs: What the engine is told.
        dt: Length of a control step [s].

    Returns:
        The state; forward speed, sideways speed and rate of turn of each robot (robots, 3).
    """
    twist = jnp.zeros((robots.count, 3))
    ctrl = jnp.append(inputs.ctrl, 0.0)
    for group in robots.rolling:
        wheels, answer = group.wheels, group.response
        joints = state.qpos[group.qpos]
        places = group.qpos[:, wheels.spin]
        spin = before.qvel[group.qvel[:, wheels.spin]]
        grip, size = _variation(inputs, group.members)
        now = follow(answer, wheels.twist(joints, spin), wheels.twist(joints, ctrl[group.ctrl]), dt, grip)
        turned = wheels.spins(joints, now)
        angle, turned = materialize((before.qpos[places] + (spin + turned) * dt / 2, turned))
        # What a servo aims at is where its wheel is: it does not wind up.
        act = set_rows(jnp.append(state.act, 0.0), (group.act, angle))[:-1]
        state = state.replace(
            qpos=set_rows(state.qpos, (places, angle)),
            qvel=set_rows(state.qvel, (group.qvel[:, wheels.spin], turned)),
            act=act,
        )
        ahead, turn = answer.gain * now[:, 0], answer.turn_gain * now[:, 2]
        aside = answer.gain * now[:, 1] + answer.drift * ahead * turn
        twist = set_rows(twist, (group.members, jnp.stack([ahead, aside, turn], -1) * size))
    return state, twist


def _variation(inputs: Inputs, members: np.ndarray) -> tuple[Array | float, Array | float]:
    """Return factors on the most acceleration (n, 1) and on the speed (n, 1) of robots that vary.

    Less friction, weaker motors and more mass all leave less acceleration; of friction and motors the scarcer
    one counts. Larger wheels go farther.
    """
    varied = inputs.varied
    if varied is None:
        return 1.0, 1.0
    one = jnp.ones((len(members), 1))
    grip = one if varied.friction is None else one * varied.friction
    if varied.torque is not None:
        motors = varied.torque[members][:, None]
        grip = motors if varied.friction is None else jnp.minimum(grip, motors)
    grip = grip if varied.mass is None else grip / varied.mass[members][:, None]
    return grip, one if varied.wheel is None else varied.wheel[members][:, None]


def rolled(motion: Motion, twist: Array, dt: float) -> Motion:
    """Return robots after they went with their twists for a time: in an arc, by its chord."""
    w, x, y, z = motion.unit
    ahead, aside, turn = parts(twist)
    way = jnp.stack(
        [
            (1 - 2 * (y * y + z * z)) * ahead + 2 * (x * y - w * z) * aside,
            2 * (x * y + w * z) * ahead + (1 - 2 * (x * x + z * z)) * aside,
        ],
        -1,
    )
    angle = turn * dt
    share = sine_over(angle / 2) * dt
    (x, y, height), (dx, dy) = parts(motion.pos), parts(on_plan(way, angle / 2))
    return motion.replace(
        pos=jnp.stack([x + dx * share, y + dy * share, height], -1),
        quat=_about_z(motion.quat, angle),
        linear=jnp.stack([*parts(on_plan(way, angle)), motion.linear[:, 2]], -1),
        angular=_with_third(motion.angular, turn),
    )


def _with_third(vectors: Array, third: Array) -> Array:
    """Return vectors (n, 3) with another third number (n,)."""
    return jnp.stack([vectors[:, 0], vectors[:, 1], third], -1)


def _where(mask: Array, new: Sequence[Array], old: Array) -> Array:
    """Return vectors of which some are others, number by number."""
    return jnp.stack([jnp.where(mask, *pair) for pair in zip(new, parts(old), strict=True)], -1)


def _about_z(quat: Array, angle: Array) -> Array:
    """Return orientations (n, 4) turned about the vertical (n,)."""
    c, s = jnp.cos(angle / 2), jnp.sin(angle / 2)
    w, x, y, z = parts(quat)
    return jnp.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], -1)


def stopped(
    robots: PlanarRobots, before: Motion, after: Motion, kept: Footprints, touched: Array, dt: float
) -> Motion:
    """Return motions as they were kept apart: what touched something has the speed with which it got on."""
    turn = kept.yaw - after.yaw
    turn = jnp.arctan2(jnp.sin(turn), jnp.cos(turn))
    x, y = parts(kept.pos - on_plan(robots.offset, kept.yaw))
    angle = kept.yaw - before.yaw
    rate = jnp.arctan2(jnp.sin(angle), jnp.cos(angle)) / dt
    went = [(now - then) / dt for now, then in zip((x, y), parts(before.pos), strict=False)]
    return after.replace(
        pos=_where(touched, (x, y, after.pos[:, 2]), after.pos),
        quat=_where(touched, parts(_about_z(after.quat, turn)), after.quat),
        linear=_where(touched, (*went, after.linear[:, 2]), after.linear),
        angular=_with_third(after.angular, jnp.where(touched, rate, after.angular[:, 2])),
    )


def reach_of(robots: PlanarRobots, before: Motion) -> Array:
    """Return up to what height the ground may be under where robots stand [m] (4, robots)."""
    w, x, y, z = before.unit
    limits: list[Array] = []
    for stance in _stances(robots):
        down = 2 * (x * z - w * y) * stance[:, 0] + 2 * (y * z + w * x) * stance[:, 1]
        bottom = before.pos[:, 2] + down - (1 - 2 * (x * x + y * y)) * robots.clearance
        limits.append(bottom + robots.step)
    return jnp.stack(limits)


def feet_of(prints: Footprints) -> Array:
    """Return where robots (robots,) stand on the plan (4, robots, 2)."""
    stances = [STANCE * jnp.asarray(corner) * prints.half for corner in SIGNS]
    return jnp.stack([prints.pos + on_plan(stance, prints.yaw) for stance in stances])


def _stances(robots: PlanarRobots) -> list[Array]:
    half, offset = (jnp.asarray(part, jnp.float32) for part in (robots.half, robots.offset))
    return [STANCE * jnp.asarray(corner) * half + offset for corner in SIGNS]


def place_on_ground(robots: PlanarRobots, before: Motion, after: Motion, ground: Array, dt: float) -> Motion:
    """Return robots that roll on the ground below them, tilted as it is, or falling; others not below it.

    Args:
        robots: The robots.
        before: Where they were.
        after: Where they came to on the plan.
        ground: How high it is under what they stand on [m] (4, robots).
        dt: Length of a control step [s].
    """
    half, limit = STANCE * jnp.asarray(robots.half, jnp.float32), STEEPEST_TILT
    height = ground.mean(0) + robots.clearance
    rise = jnp.clip((ground[0] + ground[1] - ground[2] - ground[3]) / (4 * half[:, 0]), -limit, limit)
    lean = jnp.clip((ground[0] + ground[3] - ground[1] - ground[2]) / (4 * half[:, 1]), -limit, limit)
    old, upward = before.pos[:, 2], after.linear[:, 2]
    falling = old + upward * dt - GRAVITY * dt * dt / 2
    z = jnp.where(robots.flies, jnp.maximum(after.pos[:, 2], height), jnp.maximum(height, falling))
    rolls = ~robots.flies & (z <= height + IN_THE_AIR)
    tilted = _tilted(after.yaw, rise, lean)
    # How the tilt changed, in the robot's own axes.
    rate = _turn_between(before.unit, tilted)
    stands = robots.flies & (after.pos[:, 2] < height)
    held = jnp.where(stands, jnp.maximum(upward, 0.0), upward)
    return after.replace(
        pos=_with_third(after.pos, z),
        quat=_where(rolls, tilted, after.quat),
        linear=_with_third(after.linear, jnp.where(robots.flies, held, (z - old) / dt)),
        angular=_where(rolls, (rate[0] / dt, rate[1] / dt, after.angular[:, 2]), after.angular),
    )


Quaternion = tuple[Array, ...]
"""Four arrays (n,), w first."""


def _turn_between(one: Quaternion, other: Quaternion) -> tuple[Array, Array]:
    """Return sines of the turns from orientations to others, about their own first and second axes."""
    (w, x, y, z), (w2, x2, y2, z2) = one, other
    turn = w * w2 + x * x2 + y * y2 + z * z2
    first = w * x2 - x * w2 - y * z2 + z * y2
    second = w * y2 - y * w2 - z * x2 + x * z2
    return 2 * turn * first, 2 * turn * second


def _tilted(yaw: Array, rise: Array, lean: Array) -> Quaternion:
    """Return orientations of robots on planes that rise ahead and to the left of them (n,).

    The columns of the matrix are the robot's axes: ahead along the rise, up across that and the lean.
    """
    long = jnp.sqrt(1 + rise * rise)
    high = jnp.sqrt(1 + rise * rise + lean * lean)
    up = -rise / high, -lean / high, 1 / high
    ahead = 1 / long, rise / long
    # The axis to the left is up x ahead: what of it and of the others the quaternion needs.
    left_x, left_y, left_z = up[1] * ahead[1], up[2] * ahead[0] - up[0] * ahead[1], -up[1] * ahead[0]
    w = jnp.sqrt(1 + ahead[0] + left_y + up[2]) / 2
    x, y, z = (left_z - up[1]) / (4 * w), (up[0] - ahead[1]) / (4 * w), -left_x / (4 * w)
    c, s = jnp.cos(yaw / 2), jnp.sin(yaw / 2)
    quat = c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w
    # The larger of those two numbers that can be the largest is positive.
    flip = jnp.where(jnp.abs(quat[3]) > jnp.abs(quat[0]), quat[3], quat[0]) < 0
    return tuple(jnp.where(flip, -number, number) for number in quat)
