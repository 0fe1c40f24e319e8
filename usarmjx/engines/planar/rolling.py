"""Rolling robots: from wheel inputs to poses on the ground."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array, set_rows
from usarmjx.base.compilation import materialize
from usarmjx.base.rotations import parts, quat_times
from usarmjx.engines.base import Inputs
from usarmjx.engines.planar.bodies import Motion, PlanarRobots, rotate_by_yaw
from usarmjx.engines.planar.drives import limited_lag
from usarmjx.engines.planar.flight import sinc
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.overlap import CORNER_SIGNS

GRAVITY = 9.81
"""Gravity of falling robots [m/s^2]."""
STANCE = 0.8
"""Position of the feet, as a fraction of the footprint's half sides."""
MAX_TILT = 0.6
"""Largest tilt, as rise over run: a robot that overhangs an edge does not stand on its nose."""
AIRBORNE_HEIGHT = 0.02
"""Height above ground from which a robot keeps its tilt [m]."""
Quaternion = tuple[Array, ...]
"""Components (n,) of quaternions, w first."""


def roll(robots: PlanarRobots, before: Any, state: Any, inputs: Inputs, dt: float) -> tuple[Any, Array]:  # noqa: ANN401
    """Return the state with the wheels turned, and the chassis twists.

    Args:
        robots: The robots.
        before: State of one world at the beginning of the step, with qpos and qvel.
        state: The same with the other joints moved, and act.
        inputs: Engine inputs.
        dt: Length of a control step [s].

    Returns:
        The state; forward speed, lateral speed and yaw rate of each robot (robots, 3).
    """
    twist = jnp.zeros((robots.count, 3))
    # The index of a wheel without a motor is one past the end (`drives.RollingGroup`): it reads 0 here, and
    # what it writes to act below is cut off.
    ctrl = jnp.append(inputs.ctrl, 0.0)
    for group in robots.rolling:
        wheels, answer = group.wheels, group.response
        joints = state.qpos[group.qpos]
        places = group.qpos[:, wheels.spin]
        spin = before.qvel[group.qvel[:, wheels.spin]]
        grip, size = _variation(inputs, group.members)
        # Both twists are of rims: what the chassis makes of them is in the gains below.
        now = limited_lag(
            answer, wheels.twist(joints, spin), wheels.twist(joints, ctrl[group.ctrl]), dt, grip
        )
        turned_speed = wheels.wheel_speeds(joints, now)
        angle, turned_speed = materialize(
            (before.qpos[places] + (spin + turned_speed) * dt / 2, turned_speed)
        )
        # The servo's target follows the wheel's angle, so that it does not wind up.
        act = set_rows(jnp.append(state.act, 0.0), (group.act, angle))[:-1]
        state = state.replace(
            qpos=set_rows(state.qpos, (places, angle)),
            qvel=set_rows(state.qvel, (group.qvel[:, wheels.spin], turned_speed)),
            act=act,
        )
        ahead, turn = answer.gain * now[:, 0], answer.turn_gain * now[:, 2]
        # In a turn at speed tyres slip outward, in proportion to the lateral acceleration.
        aside = answer.gain * now[:, 1] + answer.drift * ahead * turn
        twist = set_rows(twist, (group.members, jnp.stack([ahead, aside, turn], -1) * size))
    return state, twist


def _variation(inputs: Inputs, members: np.ndarray) -> tuple[Array | float, Array | float]:
    """Return factors on the acceleration limits (n, 1) and on the speed (n, 1) of randomized robots.

    Less friction, weaker motors and more mass reduce the acceleration; of friction and motors the smaller
    factor counts. Larger wheels increase the speed.
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


def integrate_twist(motion: Motion, twist: Array, dt: float) -> Motion:
    """Integrate the twists over a time step: an arc, by its chord."""
    w, x, y, z = motion.unit
    ahead, aside, turn = parts(twist)
    # Rows x and y of the rotation matrix: up a slope the way on the plan is the shorter.
    velocity = jnp.stack(
        [
            (1 - 2 * (y * y + z * z)) * ahead + 2 * (x * y - w * z) * aside,
            2 * (x * y + w * z) * ahead + (1 - 2 * (x * x + z * z)) * aside,
        ],
        -1,
    )
    angle = turn * dt
    # Chord of an arc: length v dt sin(a/2) / (a/2), direction half the angle.
    share = sinc(angle / 2) * dt
    (x, y, height), (dx, dy) = parts(motion.pos), parts(rotate_by_yaw(velocity, angle / 2))
    return motion.replace(
        pos=jnp.stack([x + dx * share, y + dy * share, height], -1),
        quat=_rotate_about_vertical(motion.quat, angle),
        linear=jnp.stack([*parts(rotate_by_yaw(velocity, angle)), motion.linear[:, 2]], -1),
        angular=_replace_third(motion.angular, turn),
    )


def _replace_third(vectors: Array, third: Array) -> Array:
    """Return vectors (n, 3) with the third component (n,) replaced."""
    return jnp.stack([vectors[:, 0], vectors[:, 1], third], -1)


def _select_components(mask: Array, new: Sequence[Array], old: Array) -> Array:
    """Return vectors, some of them replaced, by components."""
    return jnp.stack([jnp.where(mask, *pair) for pair in zip(new, parts(old), strict=True)], -1)


def _rotate_about_vertical(quat: Array, angle: Array) -> Array:
    """Rotate orientations (n, 4) about the vertical (n,)."""
    c, s = jnp.cos(angle / 2), jnp.sin(angle / 2)
    w, x, y, z = parts(quat)
    return jnp.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], -1)


def apply_contacts(
    robots: PlanarRobots, before: Motion, after: Motion, kept: Footprints, touched: Array, dt: float
) -> Motion:
    """Apply the resolved poses: robots that touched something get their actual velocity."""
    # Wrapped to half a turn each way: on the other side of +-pi the difference would be a whole turn.
    turn = kept.yaw - after.yaw
    turn = jnp.arctan2(jnp.sin(turn), jnp.cos(turn))
    x, y = parts(kept.pos - rotate_by_yaw(robots.offset, kept.yaw))
    angle = kept.yaw - before.yaw
    rate = jnp.arctan2(jnp.sin(angle), jnp.cos(angle)) / dt
    # Positions before have a third part, the height, which the plan leaves out.
    displacement = [(now - then) / dt for now, then in zip((x, y), parts(before.pos), strict=False)]
    return after.replace(
        pos=_select_components(touched, (x, y, after.pos[:, 2]), after.pos),
        quat=_select_components(touched, parts(_rotate_about_vertical(after.quat, turn)), after.quat),
        linear=_select_components(touched, (*displacement, after.linear[:, 2]), after.linear),
        angular=_replace_third(after.angular, jnp.where(touched, rate, after.angular[:, 2])),
    )


def ground_limits(robots: PlanarRobots, before: Motion) -> Array:
    """Return the height limits of ground under the robots' feet [m] (4, robots)."""
    w, x, y, z = before.unit
    limits: list[Array] = []
    for stance in _stances(robots):
        # Third row of the rotation matrix: how far a foot is above the chassis's middle.
        down = 2 * (x * z - w * y) * stance[:, 0] + 2 * (y * z + w * x) * stance[:, 1]
        bottom = before.pos[:, 2] + down - (1 - 2 * (x * x + y * y)) * robots.clearance
        limits.append(bottom + robots.step)
    return jnp.stack(limits)


def foot_positions(footprints: Footprints) -> Array:
    """Return the feet of robots (robots,) on the plan (4, robots, 2)."""
    stances = [STANCE * jnp.asarray(corner) * footprints.half for corner in CORNER_SIGNS]
    return jnp.stack([footprints.pos + rotate_by_yaw(stance, footprints.yaw) for stance in stances])


def _stances(robots: PlanarRobots) -> list[Array]:
    half, offset = (jnp.asarray(part, jnp.float32) for part in (robots.half, robots.offset))
    return [STANCE * jnp.asarray(corner) * half + offset for corner in CORNER_SIGNS]


def place_on_ground(robots: PlanarRobots, before: Motion, after: Motion, ground: Array, dt: float) -> Motion:
    """Put rolling robots on the ground, tilted along it or falling; keep flying robots above it.

    Args:
        robots: The robots.
        before: Old motion.
        after: Resolved motion on the plan.
        ground: Ground heights under their feet [m] (4, robots).
        dt: Length of a control step [s].
    """
    half, limit = STANCE * jnp.asarray(robots.half, jnp.float32), MAX_TILT
    height = ground.mean(0) + robots.clearance
    # Feet are in the order of CORNER_SIGNS: 0 and 1 in front, 0 and 3 on the left. Sums of two over 4 half
    # sides are means over the distance between them.
    rise = jnp.clip((ground[0] + ground[1] - ground[2] - ground[3]) / (4 * half[:, 0]), -limit, limit)
    lean = jnp.clip((ground[0] + ground[3] - ground[1] - ground[2]) / (4 * half[:, 1]), -limit, limit)
    old, upward = before.pos[:, 2], after.linear[:, 2]
    falling = old + upward * dt - GRAVITY * dt * dt / 2
    z = jnp.where(robots.flies, jnp.maximum(after.pos[:, 2], height), jnp.maximum(height, falling))
    # In the air a robot keeps its tilt: there is no ground to lie along.
    rolls = ~robots.flies & (z <= height + AIRBORNE_HEIGHT)
    tilted = _orientation_on_slope(_heading(robots, after), rise, lean, parts(robots.tilt))
    # Rotation from the old to the new tilt, in the robot's axes.
    rate = _tilt_change(before.unit, tilted)
    # On the ground it may still take off: only a downward speed is taken away.
    stands = robots.flies & (after.pos[:, 2] < height)
    held = jnp.where(stands, jnp.maximum(upward, 0.0), upward)
    return after.replace(
        pos=_replace_third(after.pos, z),
        quat=_select_components(rolls, tilted, after.quat),
        # The vertical speed follows from the heights, so that a robot which lands stops falling.
        linear=_replace_third(after.linear, jnp.where(robots.flies, held, (z - old) / dt)),
        angular=_select_components(rolls, (rate[0] / dt, rate[1] / dt, after.angular[:, 2]), after.angular),
    )


def _tilt_change(one: Quaternion, other: Quaternion) -> tuple[Array, Array]:
    """Return the sines of the rotations between orientations, about their own first and second axes."""
    (w, x, y, z), (w2, x2, y2, z2) = one, other
    turn = w * w2 + x * x2 + y * y2 + z * z2
    first = w * x2 - x * w2 - y * z2 + z * y2
    second = w * y2 - y * w2 - z * x2 + x * z2
    return 2 * turn * first, 2 * turn * second


def _heading(robots: PlanarRobots, motion: Motion) -> Array:
    """Return the yaw of robots without their own tilt [rad] (robots,): with it, it creeps on a slope."""
    return robots.without_tilt(motion).yaw


def _orientation_on_slope(yaw: Array, rise: Array, lean: Array, tilt: Quaternion) -> Quaternion:
    """Return orientations of robots on planes with slopes ahead and to the left (n,), with their own tilt.

    The columns of the matrix are the robot's axes: ahead along the rise, up perpendicular to rise and lean.
    """
    long = jnp.sqrt(1 + rise * rise)
    high = jnp.sqrt(1 + rise * rise + lean * lean)
    up = -rise / high, -lean / high, 1 / high
    ahead = 1 / long, rise / long
    # The left axis is up x ahead; the quaternion follows from the matrix of the three axes.
    left_x, left_y, left_z = up[1] * ahead[1], up[2] * ahead[0] - up[0] * ahead[1], -up[1] * ahead[0]
    # Tilts are below half a right angle, so the trace is positive and this root never near 0.
    w = jnp.sqrt(1 + ahead[0] + left_y + up[2]) / 2
    x, y, z = (left_z - up[1]) / (4 * w), (up[0] - ahead[1]) / (4 * w), -left_x / (4 * w)
    c, s = jnp.cos(yaw / 2), jnp.sin(yaw / 2)
    quat = quat_times((c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w), tilt)
    # Canonical sign: the larger of w and z, one of which is the largest component, is positive.
    flip = jnp.where(jnp.abs(quat[3]) > jnp.abs(quat[0]), quat[3], quat[0]) < 0
    return tuple(jnp.where(flip, -number, number) for number in quat)
