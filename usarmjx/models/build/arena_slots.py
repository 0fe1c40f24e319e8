"""What a model has room for that is compiled once for several arenas: slots for boxes and all else."""

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.models.build.victims import victim_table
from usarmjx.models.spec.arena import ArenaSpec, LooseObject
from usarmjx.models.spec.shapes import Shape

PARKED_SIZE = (1e-3, 1e-3, 1e-3)
"""Half lengths of boxes that an arena does not have [m]."""
Thing = TypeVar("Thing")


@dataclass(frozen=True, eq=False)
class ArenaSlots:
    """What a model has room for, whichever arena a world has.

    Attributes:
        boxes: An example for each slot, the longest of a form first.
        half_lengths: The largest half length that fits into each, those of victims last [m] (boxes,).
        objects: An example of the loose object for each slot.
        victims: Boxes of victims, and victims.
        tags: RFID tags.
        starts: Start poses, of which every arena has as many at least.
        lamps: Lamps.
    """

    boxes: tuple[Shape, ...]
    half_lengths: np.ndarray
    objects: tuple[LooseObject, ...]
    victims: tuple[int, int]
    tags: int
    starts: int
    lamps: int


def slots_for(arenas: Sequence[ArenaSpec], spare: float) -> ArenaSlots:
    """Return the slots that arenas need, and a share more of them, the largest of each form."""

    def room(count: int) -> int:
        return math.ceil(count * (1.0 + spare))

    boxes, lengths = list[Shape](), list[float]()
    for own in _by_form([sorted_boxes(arena) for arena in arenas], form_of):
        most = max(own, key=len)
        longest = [max(max(row[k].size) for row in own if k < len(row)) for k in range(len(most))]
        more = room(len(most)) - len(most)
        boxes += [*most[:1] * more, *most]
        lengths += [*longest[:1] * more, *longest]
    tables = [victim_table(arena.victims, arena.false_alarms) for arena in arenas]
    bones = max(table.num_boxes for table in tables)
    limbs = np.zeros((len(arenas), bones))
    for row, table in zip(limbs, tables, strict=True):
        row[: table.num_boxes] = np.asarray(table.size).max(-1)
    limbs = np.full(room(bones), limbs.max(initial=0.0)) if spare else limbs.max(0)
    return ArenaSlots(
        boxes=tuple(boxes),
        half_lengths=np.maximum(np.array([*lengths, *limbs], np.float32), np.float32(max(PARKED_SIZE))),
        objects=tuple(
            one for own in _by_form([arena.loose for arena in arenas], pieces_of) for one in max(own, key=len)
        ),
        victims=(len(limbs), room(max(table.num_victims for table in tables))),
        tags=room(max(len(arena.tags) for arena in arenas)),
        starts=min(len(arena.starts) for arena in arenas),
        lamps=max(len(arena.lights) for arena in arenas),
    )


def form_of(shape: Shape) -> Hashable:
    """Return what cannot differ between the boxes that take turns in a slot."""
    return shape.surface, shape.material


def sorted_boxes(arena: ArenaSpec) -> list[Shape]:
    """Return its solids, the longest first, so that long walls share slots."""
    return sorted(arena.shapes, key=lambda shape: -max(shape.size))


def pieces_of(loose: LooseObject) -> Hashable:
    """Return what cannot differ between the loose objects that take turns in a slot."""
    return loose.shapes


def _by_form(groups: Sequence[Sequence[Thing]], form: Callable[[Thing], Hashable]) -> list[list[list[Thing]]]:
    """Return what groups have of each form (forms, groups, ...)."""
    forms = dict.fromkeys(form(one) for group in groups for one in group)
    return [[[one for one in group if form(one) == kind] for group in groups] for kind in forms]


def fill_slots(
    slots: Sequence[Thing], group: Sequence[Thing], form: Callable[[Thing], Hashable], name: str
) -> list[Thing | None]:
    """Return what is in each slot: the first of a form in the first one of that form.

    Raises:
        SpecError: There are too few.
    """
    places: dict[Hashable, list[int]] = {}
    for place, example in enumerate(slots):
        places.setdefault(form(example), []).append(place)
    free = {kind: iter(own) for kind, own in places.items()}
    filled: list[Thing | None] = [None] * len(slots)
    for one in group:
        place = next(free.get(form(one), iter(())), None)
        if place is None:
            raise SpecError(
                f"arena {name} has more {type(one).__name__}s of a form than its batch has room for"
            )
        filled[place] = one
    return filled
