"""Victims: their bodies, and the poses, speeds and sounds of their moving boxes over time (manual 14.1.3).

Bodies are built into a `VictimTable`; the rest are pure functions of it and the time, over numpy or JAX
arrays alike: `xp` is the array module.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from usarmjx.base.backend import Array
from usarmjx.base.clock import Time, cycle_share
from usarmjx.base.errors import SpecError
from usarmjx.base.nodes import Node
from usarmjx.base.rotations import Components, parts, plus, quat_times, rotated
from usarmjx.base.transforms import Vec3, quat_from_angles
from usarmjx.models.types.arena import FalseAlarm, SegmentMotion, Victim
from usarmjx.models.types.shapes import ZERO, Rgba

BODY_HEIGHT = 1.75
"""Height of a standing victim [m]."""

SKIN, SHIRT, TROUSERS = (0.85, 0.65, 0.55, 1.0), (0.75, 0.2, 0.2, 1.0), (0.2, 0.25, 0.45, 1.0)
"""Colours of bones."""
SHOES = (0.15, 0.12, 0.1, 1.0)

PART_NAMES = ("Head", "Arm", "Hand", "Chest", "Pelvis", "Leg", "Foot")
"""Part names of victim sensors (manual 9.3); `VictimTable.part` indexes them."""

QUARTER = math.pi / 2

MAX_SEGMENTS = 8
"""Largest number of segments with a motion of their own (manual 14.1.3)."""

PARKED_COORDINATE = 1e6
"""Coordinate along each axis of padding boxes, out of reach [m]."""

# False alarms have the owners -1, -2 and so on: this is far beyond them.
PADDING_OWNER = -(1 << 20)
"""Owner of a padding box."""

SPEED_STEP = 0.01
"""Half of the time over which a speed is measured [s]."""

SWING_STEPS = 9
"""Samples of a motion from which its largest displacement is found."""


@dataclass(frozen=True, kw_only=True)
class Bone:
    """One bone; lengths as shares of the body's height, in the axes of an unposed body.

    Attributes:
        parent: Parent bone; None: the root.
        part: Name of its part in reports of victim sensors (manual 9.3).
        joint: Position of its joint, relative to the parent's joint.
        half: Half lengths of its box.
        offset: Centre of the box, relative to its joint.
        rgba: Colour.
    """

    parent: str | None
    part: str
    joint: Vec3 = ZERO
    half: Vec3
    offset: Vec3 = ZERO
    rgba: Rgba = SKIN


# Heights: ankle 0.039, hip 0.530, shoulder 0.818; arm without hand 0.332, hand 0.108, foot 0.152 x 0.055,
# hips 0.191 wide. Seat 0.48, waist 0.62 and depths are chosen. The neck belongs to the head.
def _limbs(left: str, side: float) -> Iterator[tuple[str, Bone]]:
    """Yield the arm and the leg of a side; `side` is 1 on the left."""
    arm, leg = f"{left}Arm", f"{left}Leg"
    yield (
        arm,
        Bone(
            parent="Chest",
            part="Arm",
            joint=(0.0, 0.122 * side, 0.198),
            half=(0.026, 0.026, 0.166),
            offset=(0.0, 0.0, -0.166),
            rgba=SHIRT,
        ),
    )
    yield (
        f"{left}Hand",
        Bone(
            parent=arm,
            part="Hand",
            joint=(0.0, 0.0, -0.332),
            half=(0.024, 0.01, 0.054),
            offset=(0.0, 0.0, -0.054),
        ),
    )
    yield (
        leg,
        Bone(
            parent="Pelvis",
            part="Leg",
            joint=(0.0, 0.048 * side, -0.02),
            half=(0.043, 0.043, 0.2455),
            offset=(0.0, 0.0, -0.2455),
            rgba=TROUSERS,
        ),
    )
    yield (
        f"{left}Foot",
        Bone(
            parent=leg,
            part="Foot",
            joint=(0.0, 0.0, -0.491),
            half=(0.076, 0.0275, 0.0195),
            offset=(0.046, 0.0, -0.0195),
            rgba=SHOES,
        ),
    )


BONES: dict[str, Bone] = {
    "Pelvis": Bone(parent=None, part="Pelvis", half=(0.063, 0.0955, 0.07), rgba=TROUSERS),
    "Chest": Bone(
        parent="Pelvis",
        part="Chest",
        joint=(0.0, 0.0, 0.07),
        half=(0.063, 0.0945, 0.099),
        offset=(0.0, 0.0, 0.099),
        rgba=SHIRT,
    ),
    "Head": Bone(
        parent="Chest",
        part="Head",
        joint=(0.0, 0.0, 0.198),
        half=(0.055, 0.044, 0.091),
        offset=(0.0, 0.0, 0.091),
    ),
    **dict(_limbs("Left", 1.0)),
    **dict(_limbs("Right", -1.0)),
}
"""The bones, parents first; no bone has more than three above it."""

PART_OF_BONE: dict[str, str] = {name: bone.part for name, bone in BONES.items()}
"""Part name of each bone."""


def _both(part: str, angles: Vec3) -> dict[str, Vec3]:
    """Return the same pose on both sides, the right one mirrored."""
    pitch, yaw, roll = angles
    return {f"Left{part}": angles, f"Right{part}": (pitch, -yaw, -roll)}


POSTURES: dict[str, dict[str, Vec3]] = {
    "standing": {},
    # On its back, the head towards -x.
    "lying": {
        "Pelvis": (-QUARTER, 0.0, 0.0),
        **_both("Arm", (0.08, 0.0, 0.12)),
        **_both("Leg", (0.03, 0.0, 0.08)),
    },
    "sitting": {
        **_both("Leg", (-QUARTER, 0.1, 0.0)),
        **_both("Arm", (-0.8, 0.0, 0.1)),
        "Head": (0.3, 0.0, 0.0),
    },
    # On its seat, bent forward over its legs with the arms ahead: knees do not bend.
    "crouched": {
        "Pelvis": (0.3, 0.0, 0.0),
        "Chest": (0.9, 0.0, 0.0),
        "Head": (0.3, 0.0, 0.0),
        **_both("Leg", (-QUARTER - 0.3, 0.1, 0.0)),
        **_both("Arm", (0.3 - QUARTER - 1.2, 0.0, 0.1)),
    },
}
"""Angles (pitch, yaw, roll) of the bones in each posture [rad]; bones that are not named are straight."""


class VictimTable(Node, kw_only=True):
    """The boxes of an arena's victims and false alarms, and the sounds of the victims.

    Every number is an array leaf, so that the tables of several worlds can be stacked once `pad_table` has
    given them one size.

    Attributes:
        size: Half lengths of the boxes [m] (boxes, 3).
        part: Indices in `PART_NAMES` (boxes,).
        owner: Index of the victim; -1 - k for false alarm k; `PADDING_OWNER` for padding (boxes,).
        rgba: Colours (boxes, 4).
        parent: Parent box of each, -1 for none (boxes,).
        joint: Joint position relative to the parent's joint; without parent, in the arena [m] (boxes, 3).
        base: Orientation at zero angles, w first; of boxes without parent, in the arena (boxes, 4).
        initial: First pitch, yaw and roll [rad] (boxes, 3).
        final: Last pitch, yaw and roll [rad] (boxes, 3).
        rate: Rates of change [rad/s] (boxes, 3).
        offset: Centre of the box, relative to its joint [m] (boxes, 3).
        swing: Largest displacement of a corner from its initial position [m]; 0: it never moves (boxes,).
        at: Position of each victim's pelvis [m] (victims, 3).
        mouth: Box of the victim's mouth: head, or else pelvis; -1: `at` (victims,).
        loudness: Loudness of its cries at 1 m (victims,).
        duration: Duration of a cry [s] (victims,).
        pause: Time between two cries [s] (victims,).
        breathes: Whether it breathes (victims,).
    """

    size: Array
    part: Array
    owner: Array
    rgba: Array
    parent: Array
    joint: Array
    base: Array
    initial: Array
    final: Array
    rate: Array
    offset: Array
    swing: Array
    at: Array
    mouth: Array
    loudness: Array
    duration: Array
    pause: Array
    breathes: Array

    @property
    def num_boxes(self) -> int:
        """Number of boxes."""
        return self.size.shape[-2]

    @property
    def num_victims(self) -> int:
        """Number of victims."""
        return self.at.shape[-2]


@dataclass(frozen=True)
class _Box:
    """One row of the table; fields as in `VictimTable`, and the bone's name."""

    name: str
    size: np.ndarray
    part: int
    owner: int
    rgba: tuple[float, ...]
    parent: int = -1
    joint: tuple[float, ...] | np.ndarray = ZERO
    base: tuple[float, ...] | np.ndarray = (1.0, 0.0, 0.0, 0.0)
    initial: Vec3 = ZERO
    final: Vec3 = ZERO
    rate: tuple[float, ...] | np.ndarray = ZERO
    offset: tuple[float, ...] | np.ndarray = ZERO


def build_victim_table(victims: Sequence[Victim], false_alarms: Sequence[FalseAlarm] = ()) -> VictimTable:
    """Return the table of victims and false alarms with zero swings; see `victim_table`.

    Raises:
        SpecError: Two victims of one name; an unknown posture or bone; more than `MAX_SEGMENTS` segments or
            two of one name; a negative rate, scale, speed, loudness or time.
    """
    names = [victim.name for victim in victims]
    if len(set(names)) < len(names):
        raise SpecError(f"victims of one name among {', '.join(names)}")
    boxes: list[_Box] = []
    mouths: list[int] = []
    for owner, victim in enumerate(victims):
        check_victim(victim)
        rows = _body(victim, owner, len(boxes))
        bones = [row.name for row in rows]
        mouth = next((bones.index(name) for name in ("Head", "Pelvis") if name in bones), None)
        # Victims may have lost their head: the pelvis stands in for it, else the victim's own position.
        mouths.append(-1 if mouth is None else len(boxes) + mouth)
        boxes += rows
    for k, alarm in enumerate(false_alarms):
        boxes += _alarm(alarm, -1 - k)
    return _table(boxes, victims, mouths)


def box_names(victims: Sequence[Victim], false_alarms: Sequence[FalseAlarm] = ()) -> tuple[str, ...]:
    """Return a unique name of every box of `build_victim_table`: `<victim>/<bone>` or `alarm<k>/<bone>`."""
    names = [f"{victim.name}/{row.name}" for victim in victims for row in _body(victim, 0, 0)]
    names += [f"alarm{k}/{row.name}" for k, alarm in enumerate(false_alarms) for row in _alarm(alarm, 0)]
    return tuple(names)


def check_victim(victim: Victim) -> None:
    """Refuse an invalid victim; see `build_victim_table`."""
    where = f"victim {victim.name!r}"
    if victim.posture not in POSTURES:
        raise SpecError(f"{where}: unknown posture {victim.posture!r}; known: {', '.join(POSTURES)}")
    if len(victim.segments) > MAX_SEGMENTS:
        raise SpecError(f"{where}: {len(victim.segments)} segments, at most {MAX_SEGMENTS} are allowed")
    names = [segment.name for segment in victim.segments]
    if len(set(names)) < len(names):
        raise SpecError(f"{where}: segments of one name among {', '.join(names)}")
    _not_negative(where, AnimTimer=victim.anim_timer)
    for segment in victim.segments:
        _bone(segment.name, where)
        pitch, yaw, roll = segment.rates
        here = f"{where}, segment {segment.name}"
        _not_negative(here, PitchRate=pitch, YawRate=yaw, RollRate=roll, Scale=segment.scale)
    if victim.help_sound is not None:
        sound = victim.help_sound
        _not_negative(where, loudness=sound.loudness, duration=sound.duration, pause=sound.pause)


def _not_negative(where: str, **values: float) -> None:
    for name, value in values.items():
        if not value >= 0:  # also refuses NaN
            raise SpecError(f"{where}: {name} is {value}, expected at least 0")


def _bone(name: str, where: str) -> Bone:
    if name not in BONES:
        raise SpecError(f"{where}: unknown bone {name!r}; known: {', '.join(BONES)}")
    return BONES[name]


def _body(victim: Victim, owner: int, first: int) -> list[_Box]:
    """Return the visible boxes of a victim, parents first; `first` is the index of the first one.

    A segment whose poses are both zero has no pose of its own: it only scales its bone.
    """
    own = {segment.name: segment for segment in victim.segments}
    posture = POSTURES[victim.posture]
    scale: dict[str | None, float] = {None: BODY_HEIGHT}
    rows: dict[str, _Box] = {}
    for name, bone in BONES.items():
        segment = own.get(name, SegmentMotion(name=name))
        # A scaled bone scales all that hangs on it.
        scale[name] = scale[bone.parent] * segment.scale
        if segment.initial == segment.final == ZERO:  # no pose of its own
            segment = replace(segment, initial=posture.get(name, ZERO), final=posture.get(name, ZERO))
        # A scale of 0 hides a bone and all that hangs on it.
        if scale[name] == 0:
            continue
        root = bone.parent is None
        # Parents are indices in the whole table, where this body begins at `first`.
        above = -1 if bone.parent is None else first + list(rows).index(bone.parent)
        rows[name] = _Box(
            name=name,
            size=scale[name] * np.array(bone.half),
            part=PART_NAMES.index(bone.part),
            owner=owner,
            rgba=bone.rgba,
            parent=above,
            joint=victim.at if root else scale[bone.parent] * np.array(bone.joint),
            base=quat_from_angles(*victim.rotation) if root else (1.0, 0.0, 0.0, 0.0),
            initial=segment.initial,
            final=segment.final,
            rate=victim.anim_timer * np.array(segment.rates),
            offset=scale[name] * np.array(bone.offset),
        )
    return list(rows.values())


def _alarm(alarm: FalseAlarm, owner: int) -> list[_Box]:
    """Return the box of a false alarm; none when its scale is 0."""
    where = f"false alarm at {alarm.at}"
    bone = _bone(alarm.part, where)
    _not_negative(where, scale=alarm.scale)
    if alarm.scale == 0:
        return []
    return [
        _Box(
            name=alarm.part,
            size=BODY_HEIGHT * alarm.scale * np.array(bone.half),
            part=PART_NAMES.index(bone.part),
            owner=owner,
            rgba=bone.rgba,
            joint=alarm.at,
            base=quat_from_angles(*alarm.rotation),
        )
    ]


def _table(boxes: Sequence[_Box], victims: Sequence[Victim], mouths: Sequence[int]) -> VictimTable:
    def column(name: str, *shape: int) -> np.ndarray:
        return np.array([getattr(box, name) for box in boxes], np.float32).reshape(-1, *shape)

    def voice(name: str) -> np.ndarray:
        sounds = [victim.help_sound for victim in victims]
        return np.array([0.0 if sound is None else getattr(sound, name) for sound in sounds], np.float32)

    vectors = ("size", "joint", "initial", "final", "rate", "offset")
    return VictimTable(
        **{name: column(name, 3) for name in vectors},
        **{name: column(name, 4) for name in ("base", "rgba")},
        **{name: column(name).astype(np.int32) for name in ("part", "owner", "parent")},
        **{name: voice(name) for name in ("loudness", "duration", "pause")},
        swing=np.zeros(len(boxes), np.float32),
        at=np.array([victim.at for victim in victims], np.float32).reshape(-1, 3),
        mouth=np.array(mouths, np.int32),
        breathes=np.array([victim.breathes for victim in victims], bool),
    )


def pad_table(table: VictimTable, boxes: int, victims: int) -> VictimTable:
    """Return a table padded to a number of boxes and victims: numpy arrays.

    Padding boxes are 1 mm large, out of reach and without owner; padding victims are silent.

    Raises:
        SpecError: The table is larger already.
    """
    more, people = boxes - table.num_boxes, victims - table.num_victims
    if min(more, people) < 0:
        raise SpecError(
            f"{table.num_boxes} boxes of {table.num_victims} victims do not fit into room for "
            f"{boxes} of {victims}"
        )

    def filled(value: Array, rows: int, fill: float) -> np.ndarray:
        room = [(0, rows)] + [(0, 0)] * (value.ndim - 1)
        return np.pad(np.asarray(value), room, constant_values=fill)

    fills = {"size": 1e-3, "joint": PARKED_COORDINATE, "owner": PADDING_OWNER, "parent": -1, "rgba": 0.0}
    voices = ("at", "mouth", "loudness", "duration", "pause", "breathes")
    columns: dict[str, Any] = {}
    for name, value in vars(table).items():
        rows = people if name in voices else more
        fill = {"at": PARKED_COORDINATE, "mouth": -1}.get(name, fills.get(name, 0.0))
        columns[name] = filled(value, rows, fill)
    # Zeros are no orientation.
    columns["base"][table.num_boxes :, 0] = 1.0
    return VictimTable(**columns)


def victim_table(victims: Sequence[Victim], false_alarms: Sequence[FalseAlarm] = ()) -> VictimTable:
    """Return the boxes of an arena's victims, then those of its false alarms; numpy arrays.

    Raises:
        SpecError: Two victims of one name; an unknown posture or bone; more than `MAX_SEGMENTS` segments or
            two of one name; a negative rate, scale, speed, loudness or time.
    """
    table = build_victim_table(victims, false_alarms)
    share = np.linspace(0.0, 1.0, SWING_STEPS)[:, None, None]
    # An angle with rate 0 never leaves its initial value, whatever its final one.
    moving = np.where(table.rate > 0, table.final - table.initial, 0.0)
    corners = _corners(table, table.initial + share * moving, np)
    swing = np.linalg.norm(corners - corners[:1], axis=-1).max((0, 2), initial=0.0)
    return table.replace(swing=swing.astype(np.float32))


def segment_angles(table: VictimTable, time: Time, xp: ModuleType = np) -> tuple[Array, Array]:
    """Return the joints' angles [rad] and their rates [rad/s] at a time [s].

    Each angle goes from its initial value to its final one and back again, without end, at its rate.

    Args:
        table: The victims.
        time: Simulated time [s] or clock (...,).
        xp: Array module of both.

    Returns:
        Pitch, yaw and roll (..., boxes, 3) twice.
    """
    span = xp.abs(table.final - table.initial)
    way = xp.sign(table.final - table.initial)
    # An angle that does not move has no cycle; 1 avoids 0 / 0, and its rate decides nothing.
    turn = 2 * xp.where(span > 0, span, 1.0)
    # By shares of a cycle, which stay exact in worlds of any age; time times rate would lose digits.
    gone = turn * cycle_share(time, table.rate / turn, 2, xp)
    back = gone > span
    angle = table.initial + way * xp.where(back, turn - gone, gone)
    return angle, way * table.rate * xp.where(back, -1.0, 1.0)


def segment_poses(table: VictimTable, time: Time, xp: ModuleType = np) -> tuple[Array, Array]:
    """Return the poses of the boxes at a time.

    Args:
        table: The victims; numpy or JAX arrays, of one world (map over worlds by `jax.vmap`).
        time: Simulated time [s] or clock (...,).
        xp: Array module of both.

    Returns:
        Centres [m] (..., boxes, 3) and w-first quaternions (..., boxes, 4), in the arena's axes.
    """
    angles, _ = segment_angles(table, time, xp)
    return _poses(table, angles, xp)


def segment_speeds(table: VictimTable, time: Time, xp: ModuleType = np) -> Array:
    """Return the speeds of the boxes at a time (...,), each of its fastest corner [m/s] (..., boxes).

    Central differences over `SPEED_STEP` either way along the present direction of motion, which are exact at
    the turning points too, and independent of the resolution of the time.
    """
    angles, rates = segment_angles(table, time, xp)
    ahead = _corners(table, angles + SPEED_STEP * rates, xp)
    behind = _corners(table, angles - SPEED_STEP * rates, xp)
    return xp.sqrt(((ahead - behind) ** 2).sum(-1).max(-1)) / (2 * SPEED_STEP)


def loudness(table: VictimTable, time: Time, xp: ModuleType = np) -> Array:
    """Return the loudness of victims' cries at a time (...,), at 1 m; 0 while silent (..., victims).

    The first cry begins at time 0.
    """
    cycle = table.duration + table.pause
    # Silent victims have no cycle.
    cycle = xp.where(cycle > 0, cycle, 1.0)
    since = cycle * cycle_share(time, 1.0 / cycle, 1, xp)
    return xp.where(since < table.duration, table.loudness, 0.0)


def mouth_positions(table: VictimTable, pos: Array, xp: ModuleType = np) -> Array:
    """Return the positions of the victims' mouths [m] (..., victims, 3), from the boxes' centres `pos`."""
    if table.num_boxes == 0:
        # An axis of length 0 cannot be indexed, even where the result is not used.
        return xp.broadcast_to(table.at, (*pos.shape[:-2], *table.at.shape))
    # -1, no box, would read the last row; the next line drops what is read in its place.
    found = pos[..., xp.maximum(table.mouth, 0), :]
    return xp.where(table.mouth[:, None] >= 0, found, table.at)


@cache
def rest_height(posture: str) -> float:
    """Return the height of a pelvis above the ground [m] for a victim that rests on it in that posture.

    Raises:
        SpecError: No such posture.
    """
    table = victim_table([Victim(name="one", at=ZERO, posture=posture)])
    return -float(lowest_points(table, 0.0).min())


def lowest_points(table: VictimTable, time: Time) -> np.ndarray:
    """Return the height of every box's lowest point at a time (...,) [m] (..., boxes)."""
    pos, quat = segment_poses(table, time)
    # The half height of a turned box is the sum of its half lengths' shares along the vertical.
    return pos[..., 2] - (np.abs(orientations(quat)[..., 2, :]) * table.size).sum(-1)


def orientations(quat: Array, xp: ModuleType = np) -> Array:
    """Return the rotation matrices (..., 3, 3) of the boxes' quaternions (..., 4)."""
    numbers = parts(quat)
    columns = [xp.stack(rotated(numbers, parts(axis)), -1) for axis in np.eye(3, dtype=np.float32)]
    return xp.stack(columns, -1)


def _poses(table: VictimTable, angles: Array, xp: ModuleType) -> tuple[Array, Array]:
    """Return centres and orientations for joint angles (..., boxes, 3), by forward kinematics."""
    quat = quat_times(parts(table.base), _quat(angles, xp))
    pos = parts(xp.broadcast_to(table.joint, angles.shape))
    parent = table.parent
    if table.num_boxes == 0:
        return xp.stack(pos, -1), xp.stack(quat, -1)
    # Pointer doubling: each pass composes twice as many ancestors, so two passes reach four bones in a row.
    for _ in range(2):
        above, hangs = xp.maximum(parent, 0), parent >= 0
        turn, base = (tuple(number[..., above] for number in numbers) for numbers in (quat, pos))
        moved, more = plus(base, rotated(turn, pos)), quat_times(turn, quat)
        pos = tuple(xp.where(hangs, new, old) for new, old in zip(moved, pos, strict=True))
        quat = tuple(xp.where(hangs, new, old) for new, old in zip(more, quat, strict=True))
        parent = xp.where(parent >= 0, parent[above], -1)
    return xp.stack(plus(pos, rotated(quat, parts(table.offset))), -1), xp.stack(quat, -1)


def _corners(table: VictimTable, angles: Array, xp: ModuleType) -> Array:
    """Return the boxes' corners for joint angles (..., boxes, 3) [m] (..., boxes, 8, 3)."""
    pos, quat = _poses(table, angles, xp)
    signs = xp.asarray([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    # The table's precision: double precision of the signs would widen all corners.
    offsets = signs.astype(table.size.dtype) * table.size[:, None]
    away = rotated(parts(quat[..., None, :]), parts(offsets))
    return pos[..., None, :] + xp.stack(away, -1)


def _quat(angles: Array, xp: ModuleType) -> Components:
    """Return w-first quaternions (...,) of pitch, yaw and roll (..., 3), applied as ZYX."""
    cosine, sine = xp.cos(angles / 2), xp.sin(angles / 2)
    cp, cy, cr = cosine[..., 0], cosine[..., 1], cosine[..., 2]
    sp, sy, sr = sine[..., 0], sine[..., 1], sine[..., 2]
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return w, x, y, z
