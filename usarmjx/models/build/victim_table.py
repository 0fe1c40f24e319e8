"""Victims resolved: the table of all their visible boxes, built from descriptions (manual 14.1.3)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import Vec3, quat_from_angles
from usarmjx.models.build.skeleton import BODY_HEIGHT, BONES, PART_NAMES, POSTURES, Bone
from usarmjx.models.spec.arena import FalseAlarm, SegmentMotion, Victim
from usarmjx.models.spec.shapes import ZERO

MAX_SEGMENTS = 8
"""Most segments with a motion of their own (manual 14.1.3)."""
PARKED_COORDINATE = 1e6
"""Where boxes wait that a world does not have, along each axis [m]."""
PADDING_OWNER = -(1 << 20)
"""Owner of such a box."""


class VictimTable(struct.PyTreeNode, kw_only=True):
    """The visible boxes of an arena's victims and false alarms, and what there is to hear of the victims.

    Every number is an array leaf, so that the tables of several worlds can be stacked once `pad_table` to one
    size.

    Attributes:
        size: Half lengths of the boxes [m] (boxes, 3).
        part: Places in `PART_NAMES` (boxes,).
        owner: Place of the victim; -1 - k for false alarm k; `PADDING_OWNER` for padding (boxes,).
        rgba: Colours (boxes, 4).
        parent: The box that each hangs on, -1 for none (boxes,).
        joint: Where its joint is, seen from the parent's joint; without parent, in the arena [m] (boxes, 3).
        base: Orientation that its angles turn, w first; of boxes without parent, in the arena (boxes, 4).
        initial: First pitch, yaw and roll [rad] (boxes, 3).
        final: Last pitch, yaw and roll [rad] (boxes, 3).
        rate: How fast they change [rad/s] (boxes, 3).
        offset: Centre of the box, seen from its joint [m] (boxes, 3).
        swing: Farthest that a corner of it gets from where it began [m]; 0: it never moves (boxes,).
        at: Where each victim's pelvis is [m] (victims, 3).
        mouth: The box that it cries and breathes from: head, or else pelvis; -1: `at` (victims,).
        loudness: Loudness of its cries at 1 m (victims,).
        duration: How long a cry lasts [s] (victims,).
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
    """One row of the table; fields as there, and the bone's name."""

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


def build_table(victims: Sequence[Victim], false_alarms: Sequence[FalseAlarm] = ()) -> VictimTable:
    """Return the table of victims and false alarms, swings left out; see `victims.victim_table`.

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
        check(victim)
        rows = _body(victim, owner, len(boxes))
        bones = [row.name for row in rows]
        mouth = next((bones.index(name) for name in ("Head", "Pelvis") if name in bones), None)
        mouths.append(-1 if mouth is None else len(boxes) + mouth)
        boxes += rows
    for k, alarm in enumerate(false_alarms):
        boxes += _alarm(alarm, -1 - k)
    return _table(boxes, victims, mouths)


def box_names(victims: Sequence[Victim], false_alarms: Sequence[FalseAlarm] = ()) -> tuple[str, ...]:
    """Return a unique name of every box of `build_table`: `<victim>/<bone>` or `alarm<k>/<bone>`."""
    names = [f"{victim.name}/{row.name}" for victim in victims for row in _body(victim, 0, 0)]
    names += [f"alarm{k}/{row.name}" for k, alarm in enumerate(false_alarms) for row in _alarm(alarm, 0)]
    return tuple(names)


def check(victim: Victim) -> None:
    """Find what is wrong with a victim; see `build_table`."""
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
        if not value >= 0:  # nor not a number
            raise SpecError(f"{where}: {name} is {value}, expected at least 0")


def _bone(name: str, where: str) -> Bone:
    if name not in BONES:
        raise SpecError(f"{where}: unknown bone {name!r}; known: {', '.join(BONES)}")
    return BONES[name]


def _body(victim: Victim, owner: int, first: int) -> list[_Box]:
    """The visible boxes of a victim, parents first; `first` is the place of the first one.

    A segment whose poses are both zero has no pose of its own: it only scales its bone.
    """
    own = {segment.name: segment for segment in victim.segments}
    posture = POSTURES[victim.posture]
    scale: dict[str | None, float] = {None: BODY_HEIGHT}
    rows: dict[str, _Box] = {}
    for name, bone in BONES.items():
        segment = own.get(name, SegmentMotion(name=name))
        scale[name] = scale[bone.parent] * segment.scale
        if segment.initial == segment.final == ZERO:  # no pose of its own
            segment = replace(segment, initial=posture.get(name, ZERO), final=posture.get(name, ZERO))
        if scale[name] == 0:
            continue
        root = bone.parent is None
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
    """The box of a false alarm; none when its scale is 0."""
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
    """Return a table with room for so many boxes and victims: numpy arrays.

    The boxes that it fills up with are 1 mm large, far away and nobody's; the victims make no sound.

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
    columns = {}
    for name, value in vars(table).items():
        rows = people if name in voices else more
        fill = {"at": PARKED_COORDINATE, "mouth": -1}.get(name, fills.get(name, 0.0))
        columns[name] = filled(value, rows, fill)
    columns["base"][table.num_boxes :, 0] = 1.0
    return VictimTable(**columns)
