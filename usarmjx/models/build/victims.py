"""Victims in motion: where every box of theirs is at a time, and what is heard of them (manual 14.1.3).

Pure functions of a `VictimTable` and the time, over numpy or JAX arrays alike: `xp` is the array module.
"""

from collections.abc import Sequence
from functools import cache
from types import ModuleType

import numpy as np

from usarmjx.base.arrays import Array, ArrayLike
from usarmjx.base.components import Numbers, parts, plus, quat_times, rotated
from usarmjx.models.build.skeleton import BODY_HEIGHT, BONES, PART_NAMES, PART_OF_BONE, POSTURES
from usarmjx.models.build.victim_table import (
    PADDING_OWNER,
    PARKED_COORDINATE,
    VictimTable,
    box_names,
    build_table,
    pad_table,
)
from usarmjx.models.spec.arena import FalseAlarm, Victim
from usarmjx.models.spec.shapes import ZERO

__all__ = [
    "BODY_HEIGHT",
    "BONES",
    "PADDING_OWNER",
    "PARKED_COORDINATE",
    "PART_NAMES",
    "PART_OF_BONE",
    "POSTURES",
    "VictimTable",
    "box_names",
    "loudness",
    "lowest",
    "mouth_positions",
    "orientations",
    "pad_table",
    "rest_height",
    "segment_angles",
    "segment_poses",
    "segment_speeds",
    "victim_table",
]

SPEED_STEP = 0.01
"""Half of the time that a speed is measured over [s]."""
SWING_STEPS = 9
"""In how many places a motion is looked at to find how far it goes."""


def victim_table(victims: Sequence[Victim], false_alarms: Sequence[FalseAlarm] = ()) -> VictimTable:
    """Return the boxes of an arena's victims, then those of its false alarms; numpy arrays.

    Raises:
        SpecError: Two victims of one name; an unknown posture or bone; more than `MAX_SEGMENTS` segments or
            two of one name; a negative rate, scale, speed, loudness or time.
    """
    table = build_table(victims, false_alarms)
    share = np.linspace(0.0, 1.0, SWING_STEPS)[:, None, None]
    moving = np.where(table.rate > 0, table.final - table.initial, 0.0)
    corners = _corners(table, table.initial + share * moving, np)
    swing = np.linalg.norm(corners - corners[:1], axis=-1).max((0, 2), initial=0.0)
    return table.replace(swing=swing.astype(np.float32))


def segment_angles(table: VictimTable, time: ArrayLike, xp: ModuleType = np) -> tuple[Array, Array]:
    """Return the joints' angles [rad] and how fast they change [rad/s] at a time [s].

    Each angle goes from its initial value to its final one and back again, over and over, at its rate.

    Args:
        table: The victims.
        time: Simulated time [s] (...,).
        xp: Array module of both.

    Returns:
        Pitch, yaw and roll (..., boxes, 3) twice.
    """
    span = xp.abs(table.final - table.initial)
    way = xp.sign(table.final - table.initial)
    turn = 2 * xp.where(span > 0, span, 1.0)
    gone = xp.mod(xp.asarray(time)[..., None, None] * table.rate, turn)
    back = gone > span
    angle = table.initial + way * xp.where(back, turn - gone, gone)
    return angle, way * table.rate * xp.where(back, -1.0, 1.0)


def segment_poses(table: VictimTable, time: ArrayLike, xp: ModuleType = np) -> tuple[Array, Array]:
    """Return where the boxes are at a time.

    Args:
        table: The victims; numpy or JAX arrays, of one world (map over worlds by `jax.vmap`).
        time: Simulated time [s] (...,).
        xp: Array module of both.

    Returns:
        Centres [m] (..., boxes, 3) and w-first quaternions (..., boxes, 4), in the arena's axes.
    """
    angles, _ = segment_angles(table, time, xp)
    return _poses(table, angles, xp)


def segment_speeds(table: VictimTable, time: ArrayLike, xp: ModuleType = np) -> Array:
    """Return how fast the boxes move at a time (...,), each by its fastest corner [m/s] (..., boxes).

    Central differences over `SPEED_STEP` either way along the present direction of motion, which do not
    suffer from the turning points, nor from the resolution of the time.
    """
    angles, rates = segment_angles(table, time, xp)
    ahead = _corners(table, angles + SPEED_STEP * rates, xp)
    behind = _corners(table, angles - SPEED_STEP * rates, xp)
    return xp.sqrt(((ahead - behind) ** 2).sum(-1).max(-1)) / (2 * SPEED_STEP)


def loudness(table: VictimTable, time: ArrayLike, xp: ModuleType = np) -> Array:
    """Return how loud each victim cries at a time (...,), measured at 1 m; 0 while silent (..., victims).

    The first cry begins at time 0.
    """
    cycle = table.duration + table.pause
    since = xp.mod(xp.asarray(time)[..., None], xp.where(cycle > 0, cycle, 1.0))
    return xp.where(since < table.duration, table.loudness, 0.0)


def mouth_positions(table: VictimTable, pos: Array, xp: ModuleType = np) -> Array:
    """Return where the victims cry and breathe [m] (..., victims, 3), from the boxes' centres `pos`."""
    if table.num_boxes == 0:
        return xp.broadcast_to(table.at, (*pos.shape[:-2], *table.at.shape))
    found = pos[..., xp.maximum(table.mouth, 0), :]
    return xp.where(table.mouth[:, None] >= 0, found, table.at)


@cache
def rest_height(posture: str) -> float:
    """Return how high above the ground a pelvis is [m] when a victim in that posture lies or stands on it.

    Raises:
        SpecError: No such posture.
    """
    table = victim_table([Victim(name="one", at=ZERO, posture=posture)])
    return -float(lowest(table, 0.0).min())


def lowest(table: VictimTable, time: ArrayLike) -> np.ndarray:
    """Return the height of every box's lowest point at a time (...,) [m] (..., boxes)."""
    pos, quat = segment_poses(table, time)
    return pos[..., 2] - (np.abs(orientations(quat)[..., 2, :]) * table.size).sum(-1)


def orientations(quat: Array, xp: ModuleType = np) -> Array:
    """Return the rotation matrices (..., 3, 3) of the boxes' quaternions (..., 4)."""
    numbers = parts(quat)
    columns = [xp.stack(rotated(numbers, parts(axis)), -1) for axis in np.eye(3, dtype=np.float32)]
    return xp.stack(columns, -1)


def _poses(table: VictimTable, angles: Array, xp: ModuleType) -> tuple[Array, Array]:
    """Forward kinematics: centres and orientations for joint angles (..., boxes, 3)."""
    quat = quat_times(parts(table.base), _quat(angles, xp))
    pos = parts(xp.broadcast_to(table.joint, angles.shape))
    parent = table.parent
    if table.num_boxes == 0:
        return xp.stack(pos, -1), xp.stack(quat, -1)
    # Twice as far up the chain each time, so twice is enough for four bones in a row.
    for _ in range(2):
        above, hangs = xp.maximum(parent, 0), parent >= 0
        turn, base = (tuple(number[..., above] for number in numbers) for numbers in (quat, pos))
        moved, more = plus(base, rotated(turn, pos)), quat_times(turn, quat)
        pos = tuple(xp.where(hangs, new, old) for new, old in zip(moved, pos, strict=True))
        quat = tuple(xp.where(hangs, new, old) for new, old in zip(more, quat, strict=True))
        parent = xp.where(parent >= 0, parent[above], -1)
    return xp.stack(plus(pos, rotated(quat, parts(table.offset))), -1), xp.stack(quat, -1)


def _corners(table: VictimTable, angles: Array, xp: ModuleType) -> Array:
    """Where the boxes' corners are for joint angles (..., boxes, 3) [m] (..., boxes, 8, 3)."""
    pos, quat = _poses(table, angles, xp)
    signs = xp.asarray([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    offsets = signs.astype(table.size.dtype) * table.size[:, None]
    away = rotated(parts(quat[..., None, :]), parts(offsets))
    return pos[..., None, :] + xp.stack(away, -1)


def _quat(angles: Array, xp: ModuleType) -> Numbers:
    """The numbers of w-first quaternions (...,) of pitch, yaw and roll (..., 3), applied as ZYX."""
    cosine, sine = xp.cos(angles / 2), xp.sin(angles / 2)
    cp, cy, cr = cosine[..., 0], cosine[..., 1], cosine[..., 2]
    sp, sy, sr = sine[..., 0], sine[..., 1], sine[..., 2]
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return w, x, y, z
