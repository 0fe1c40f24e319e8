"""Robots that roll: from what their wheels are told to where they come to, on the ground."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import set_at
from usarmjx.base.rotations import matmul, quat_from_mat
from usarmjx.engines.base import Inputs
from usarmjx.engines.planar.bodies import Motion, PlanarRobots, on_plan
from usarmjx.engines.planar.drives import follow
from usarmjx.engines.planar.flight import sine_over
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.overlap import SIGNS
from usarmjx.engines.planar.solids import PlanSolids, ground_under

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
        angle = before.qpos[places] + (spin + turned) * dt / 2
        # What a servo aims at is where its wheel is: it does not wind up.
        act = set_at(jnp.append(state.act, 0.0), group.act, angle)[:-1]
        state = state.replace(
            qpos=set_at(state.qpos, places, angle),
            qvel=set_at(state.qvel, np.s_[group.qvel[:, wheels.spin]], turned),
            act=act,
        )
        ahead, turn = answer.gain * now[:, 0], answer.turn_gain * now[:, 2]
        aside = answer.gain * now[:, 1] + answer.drift * ahead * turn
        twist = set_at(twist, group.members, jnp.stack([ahead, aside, turn], -1) * size)
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
    mat = motion.mat
    ahead = mat[..., 0] * twist[:, :1] + mat[..., 1] * twist[:, 1:2]
    angle = twist[:, 2] * dt
    way = on_plan(ahead[:, :2], angle / 2) * sine_over(angle / 2)[:, None]
    speed = on_plan(ahead[:, :2], angle)
    return motion.replace(
        pos=set_at(motion.pos, np.s_[:, :2], motion.pos[:, :2] + way * dt),
        quat=_about_z(motion.quat, angle),
        linear=jnp.concatenate([speed, motion.linear[:, 2:]], -1),
        angular=set_at(motion.angular, np.s_[:, 2], twist[:, 2]),
    )


def _about_z(quat: Array, angle: Array) -> Array:
    """Return orientations (n, 4) turned about the vertical (n,)."""
    c, s = jnp.cos(angle / 2), jnp.sin(angle / 2)
    w, x, y, z = (quat[:, i] for i in range(4))
    return jnp.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], -1)


def stopped(
    robots: PlanarRobots, before: Motion, after: Motion, kept: Footprints, touched: Array, dt: float
) -> Motion:
    """Return motions as they were kept apart: what touched something has the speed with which it got on."""
    turn = kept.yaw - after.yaw
    turn = jnp.arctan2(jnp.sin(turn), jnp.cos(turn))
    place = kept.pos - on_plan(robots.offset, kept.yaw)
    went = (place - before.pos[:, :2]) / dt
    angle = kept.yaw - before.yaw
    rate = jnp.arctan2(jnp.sin(angle), jnp.cos(angle)) / dt
    hit = touched[:, None]
    return after.replace(
        pos=jnp.where(hit, jnp.concatenate([place, after.pos[:, 2:]], -1), after.pos),
        quat=jnp.where(hit, _about_z(after.quat, turn), after.quat),
        linear=jnp.where(hit, jnp.concatenate([went, after.linear[:, 2:]], -1), after.linear),
        angular=jnp.where(hit, set_at(after.angular, np.s_[:, 2], rate), after.angular),
    )


def place_on_ground(
    robots: PlanarRobots, before: Motion, after: Motion, solids: PlanSolids, floor: float, dt: float
) -> Motion:
    """Return robots that roll on the ground below them, tilted as it is, or falling; others not below it."""
    yaw, half = after.yaw, STANCE * jnp.asarray(robots.half)
    corners = jnp.asarray(SIGNS) * half[:, None]
    stance = corners + jnp.asarray(robots.offset)[:, None]
    feet = after.pos[:, None, :2] + jax.vmap(on_plan, (1, None), 1)(stance, yaw)
    depth = jnp.concatenate(
        [stance, jnp.broadcast_to(-robots.clearance[:, None, None], (*stance.shape[:2], 1))], -1
    )
    bottom = before.pos[:, None, 2] + (before.mat[:, None, 2] * depth).sum(-1)
    ground = ground_under(solids, floor, feet, bottom + robots.step[:, None])
    height = ground.mean(-1) + robots.clearance
    limit = STEEPEST_TILT
    rise = jnp.clip((ground[:, :2].sum(-1) - ground[:, 2:].sum(-1)) / (4 * half[:, 0]), -limit, limit)
    lean = jnp.clip(
        (ground[:, 0] + ground[:, 3] - ground[:, 1] - ground[:, 2]) / (4 * half[:, 1]), -limit, limit
    )
    falling = before.pos[:, 2] + after.linear[:, 2] * dt - GRAVITY * dt * dt / 2
    z = jnp.where(robots.flies, jnp.maximum(after.pos[:, 2], height), jnp.maximum(height, falling))
    in_air = z > height + IN_THE_AIR
    tilted = _tilted(yaw, rise, lean)
    rolls = ~robots.flies & ~in_air
    quat = jnp.where(rolls[:, None], quat_from_mat(tilted), after.quat)
    # How the tilt changed, in the robot's own axes.
    relative = matmul(before.mat.mT, tilted)
    rate = jnp.stack([relative[:, 2, 1] - relative[:, 1, 2], relative[:, 0, 2] - relative[:, 2, 0]], -1)
    angular = jnp.concatenate([rate / (2 * dt), after.angular[:, 2:]], -1)
    climbed = (z - before.pos[:, 2]) / dt
    stands = robots.flies & (after.pos[:, 2] < height)
    upward = jnp.where(
        robots.flies, jnp.where(stands, jnp.maximum(after.linear[:, 2], 0.0), after.linear[:, 2]), climbed
    )
    return after.replace(
        pos=set_at(after.pos, np.s_[:, 2], z),
        quat=quat,
        linear=set_at(after.linear, np.s_[:, 2], upward),
        angular=jnp.where(rolls[:, None], angular, after.angular),
    )


def _tilted(yaw: Array, rise: Array, lean: Array) -> Array:
    """Return orientations (n, 3, 3) of robots on a plane that rises ahead and to the left of them."""
    zero = jnp.zeros_like(rise)
    ahead = jnp.stack([jnp.ones_like(rise), zero, rise], -1)
    ahead = ahead / jnp.linalg.norm(ahead, axis=-1, keepdims=True)
    up = jnp.cross(ahead, jnp.stack([zero, jnp.ones_like(rise), lean], -1))
    up = up / jnp.linalg.norm(up, axis=-1, keepdims=True)
    own = jnp.stack([ahead, jnp.cross(up, ahead), up], -1)
    c, s = jnp.cos(yaw), jnp.sin(yaw)
    one = jnp.ones_like(zero)
    turn = jnp.stack(
        [jnp.stack([c, -s, zero], -1), jnp.stack([s, c, zero], -1), jnp.stack([zero, zero, one], -1)], -2
    )
    return matmul(turn, own)
