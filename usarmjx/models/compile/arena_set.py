"""Several arenas as one model: each world of a batch has one of them, without recompilation.

The model has a slot for every box of any arena, by surface and material, since those cannot differ between
worlds; positions and sizes of boxes are data. So are victims, start poses, and poses of loose objects; slots
that an arena does not use are parked out of reach.
"""

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import jax
import numpy as np
from flax import struct

from usarmjx.base.backend import Array
from usarmjx.base.errors import SpecError
from usarmjx.base.nodes import Node
from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.compile.tags import TagTable, tag_table
from usarmjx.models.compile.victims import VictimTable, pad_table, victim_table
from usarmjx.models.types.arena import ArenaSpec, LooseObject, StartPose
from usarmjx.models.types.shapes import Shape

PARKED_SIZE = (1e-3, 1e-3, 1e-3)
"""Half lengths of unused boxes [m]."""
Thing = TypeVar("Thing")

PARKED_POS = (0.0, 0.0, -1000.0)
"""Position of unused boxes, out of reach of everything [m]."""

LOOSE_PARKING_POS, LOOSE_PARKING_STEP = (-20.0, -20.0, 30.0), 2.0
"""Corner of the grid in the air where unused loose objects are pinned, and its spacing [m]."""

KEPT_GENERATIONS = 64
"""Number of generations of replaced arenas that `ArenaSet.arena_of` keeps."""

ARENA_STRIDE = 7919
"""Step between the arenas of a world's successive episodes: a prime, so that it visits all of them."""


@dataclass(frozen=True, eq=False)
class ArenaSlots:
    """Capacity of a model, whichever arena a world has.

    Attributes:
        boxes: An example for each slot, the longest of a form first.
        half_lengths: The largest half length that fits into each box, victims' boxes last [m] (boxes,).
        objects: An example of the loose object for each slot.
        victims: Numbers of victims' boxes and of victims.
        tags: Number of RFID tags.
        starts: Number of start poses, the fewest of any arena.
        lamps: Number of lamps.
    """

    boxes: tuple[Shape, ...]
    half_lengths: np.ndarray
    objects: tuple[LooseObject, ...]
    victims: tuple[int, int]
    tags: int
    starts: int
    lamps: int


def slots_for(arenas: Sequence[ArenaSpec], spare: float) -> ArenaSlots:
    """Return the slots that arenas need, plus a spare share, the largest of each form first."""

    def room(count: int) -> int:
        return math.ceil(count * (1.0 + spare))

    boxes, lengths = list[Shape](), list[float]()
    for own in _by_form([sorted_boxes(arena) for arena in arenas], box_form):
        most = max(own, key=len)
        # Slot k holds the k-th longest box of every arena, so its bound is tight for all.
        longest = [max(max(row[k].size) for row in own if k < len(row)) for k in range(len(most))]
        more = room(len(most)) - len(most)
        # Spare slots have the longest box as their example, so that they fit any later one.
        boxes += [*most[:1] * more, *most]
        lengths += [*longest[:1] * more, *longest]
    tables = [victim_table(arena.victims, arena.false_alarms) for arena in arenas]
    bones = max(table.num_boxes for table in tables)
    limbs = np.zeros((len(arenas), bones))
    for row, table in zip(limbs, tables, strict=True):
        row[: table.num_boxes] = np.asarray(table.size).max(-1)
    # With spare slots, bones of later arenas may come in any order: each fits the longest.
    limbs = np.full(room(bones), limbs.max(initial=0.0)) if spare else limbs.max(0)
    return ArenaSlots(
        boxes=tuple(boxes),
        # Parked boxes take slots, too, and must be within their bounds.
        half_lengths=np.maximum(np.array([*lengths, *limbs], np.float32), np.float32(max(PARKED_SIZE))),
        objects=tuple(
            one
            for own in _by_form([arena.loose for arena in arenas], loose_form)
            for one in max(own, key=len)
        ),
        victims=(len(limbs), room(max(table.num_victims for table in tables))),
        tags=room(max(len(arena.tags) for arena in arenas)),
        # The fewest: unlike boxes, start poses have no parking place that a robot could be put at.
        starts=min(len(arena.starts) for arena in arenas),
        lamps=max(len(arena.lights) for arena in arenas),
    )


def box_form(shape: Shape) -> Hashable:
    """Return the properties of a box that cannot differ between the boxes of one slot."""
    return shape.surface, shape.material


def sorted_boxes(arena: ArenaSpec) -> list[Shape]:
    """Return its solids, the longest first, so that long walls share slots."""
    return sorted(arena.shapes, key=lambda shape: -max(shape.size))


def loose_form(loose: LooseObject) -> Hashable:
    """Return the properties of a loose object that cannot differ between those of one slot."""
    return loose.shapes, loose.inertia


def _by_form(groups: Sequence[Sequence[Thing]], form: Callable[[Thing], Hashable]) -> list[list[list[Thing]]]:
    """Return the members of groups by their form (forms, groups, ...)."""
    # A dictionary keeps the order of appearance, which a set would not: slots are the same in every run.
    forms = dict.fromkeys(form(one) for group in groups for one in group)
    return [[[one for one in group if form(one) == kind] for group in groups] for kind in forms]


def fill_slots(
    slots: Sequence[Thing], group: Sequence[Thing], form: Callable[[Thing], Hashable], name: str
) -> list[Thing | None]:
    """Return the content of each slot: the first of a form in the first slot of that form.

    Raises:
        SpecError: There are too few slots.
    """
    indices: dict[Hashable, list[int]] = {}
    for index, example in enumerate(slots):
        indices.setdefault(form(example), []).append(index)
    free = {kind: iter(own) for kind, own in indices.items()}
    filled: list[Thing | None] = [None] * len(slots)
    for one in group:
        # Iterators: each slot is handed out once.
        slot = next(free.get(form(one), iter(())), None)
        if slot is None:
            raise SpecError(
                f"arena {name} has more {type(one).__name__}s of a form than its batch has room for"
            )
        filled[slot] = one
    return filled


class ArenaState(Node, kw_only=True):
    """An arena as data: the part that may differ between the worlds of a batch.

    Attributes:
        pos: Centres of the boxes except the victims', in the arena's axes [m] (boxes, 3).
        quat: Orientations (boxes, 4).
        size: Half lengths [m] (boxes, 3).
        rgb: Colours (boxes, 3).
        victims: The victims.
        tags: The RFID tags.
        starts: Start poses: x, y, z [m] and yaw [rad] (starts, 4).
        loose: Initial poses of loose objects in the world: position [m] and quaternion (objects, 7).
        present: Whether each of them exists (objects,).
        lamps: Positions of its lamps in the world [m], and their colour times brightness at 1 m; zero for
            unused ones (lamps, 6).
        serial: Its number, the argument of `ArenaSet.arena_of` ().
        notes: Further data of a task, by name.
    """

    pos: Array
    quat: Array
    size: Array
    rgb: Array
    victims: VictimTable
    tags: TagTable
    starts: Array
    loose: Array
    present: Array
    lamps: Array
    serial: Array
    notes: dict[str, Array] = struct.field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ArenaSet:
    """Arenas, resolved.

    Attributes:
        arenas: Descriptions of the first arenas.
        template: The arena that the model is compiled from, with all boxes and loose objects parked; its last
            boxes are for victims.
        states: The arenas as data (arenas, ...); numpy arrays.
        slots: Capacity of the template.
    """

    arenas: tuple[ArenaSpec, ...]
    template: ArenaSpec
    states: ArenaState
    slots: ArenaSlots
    _later: dict[int, ArenaSpec] = field(default_factory=dict[int, ArenaSpec])

    @property
    def max_half_length(self) -> np.ndarray:
        """Largest half length of each box in any arena, victims' boxes last [m] (boxes,)."""
        return self.slots.half_lengths

    def check_fits(self, arena: ArenaSpec) -> None:
        """Refuse an arena that exceeds the model's capacity.

        Raises:
            SpecError: Names the excess.
        """
        _check(arena, self.template)
        (low, high), (own_low, own_high) = (np.transpose(one.extent) for one in (self.template, arena))
        if (own_low < low).any() or (own_high > high).any():
            raise SpecError(f"arena {arena.name} reaches beyond {self.template.extent}")
        if len(arena.starts) < self.slots.starts:
            raise SpecError(f"arena {arena.name} has {len(arena.starts)} of {self.slots.starts} start poses")
        # Resolved as it would be later: sorting decides which box comes into which slot.
        own = _states([arena], self.slots, [0])
        sizes = np.concatenate([own.size[0], own.victims.size[0]])
        # Engines cut long boxes into fixed numbers of pieces by these bounds (`engines/mjx.py`).
        if (sizes.max(-1) > self.slots.half_lengths + 1e-6).any():
            raise SpecError(f"arena {arena.name} has longer boxes than its batch has room for")

    def resolve_later(self, arenas: Sequence[ArenaSpec], generation: int) -> ArenaState:
        """Return other arenas for the same model as data (arenas, ...), without notes; numpy arrays.

        Args:
            arenas: As many as the first ones; each fits, see `check_fits`.
            generation: Number of replacements so far; `arena_of` keeps the last `KEPT_GENERATIONS`.
        """
        serials = np.arange(len(arenas)) + generation * len(arenas)
        for serial in [one for one in self._later if one < serials[0] - KEPT_GENERATIONS * len(arenas)]:
            # Descriptions are kept for a while only: training replaces arenas without end.
            del self._later[serial]
        self._later.update(zip(serials.tolist(), arenas, strict=True))
        return _states(arenas, self.slots, serials)

    def arena_of(self, serial: int) -> ArenaSpec:
        """Return the description of an arena; long after its replacement, the template."""
        if serial < len(self.arenas):
            return self.arenas[serial]
        return self._later.get(serial, self.template)


def arena_set(arenas: Sequence[ArenaSpec], spare: float = 0.0) -> ArenaSet:
    """Resolve arenas for one batch.

    Args:
        arenas: Arenas, which worlds take in turn.
        spare: Share of additional slots, for later arenas: of boxes of each form, victims and tags.

    Raises:
        SpecError: No arenas; an arena with doors, water, conveyors or solids other than boxes, which cannot
            differ between worlds; arenas with different floors; one without start poses.
    """
    arenas = tuple(arenas)
    if not arenas:
        raise SpecError("a batch needs at least one arena")
    for arena in arenas:
        _check(arena, arenas[0])
    slots = slots_for(arenas, spare)
    return ArenaSet(
        arenas=arenas,
        template=_template(arenas, slots.boxes, slots.objects, slots.victims[0]),
        states=_states(arenas, slots, range(len(arenas))),
        slots=slots,
    )


def _states(
    arenas: Sequence[ArenaSpec], slots: ArenaSlots, serials: Sequence[int] | np.ndarray
) -> ArenaState:
    """Return arenas as data.

    Raises:
        SpecError: One that does not fit.
    """
    boxed = [fill_slots(slots.boxes, sorted_boxes(arena), box_form, arena.name) for arena in arenas]
    lying = [fill_slots(slots.objects, arena.loose, loose_form, arena.name) for arena in arenas]
    tables = [victim_table(arena.victims, arena.false_alarms) for arena in arenas]
    for arena, table in zip(arenas, tables, strict=True):
        wanted = table.num_boxes, table.num_victims, len(arena.tags), len(arena.lights)
        if any(
            own > there for own, there in zip(wanted, (*slots.victims, slots.tags, slots.lamps), strict=True)
        ):
            raise SpecError(f"arena {arena.name} has more victims, tags or lamps than its batch has room for")
    tables = [pad_table(table, *slots.victims) for table in tables]
    tags = [tag_table(arena.tags, slots.tags) for arena in arenas]
    # Unused boxes cannot be absent: all worlds share one model.
    parked = np.array([*PARKED_POS, 1.0, 0.0, 0.0, 0.0, *PARKED_SIZE])
    placed = np.array([[parked if shape is None else _box(shape) for shape in row] for row in boxed])
    # Of no boxes NumPy makes an array with fewer axes.
    placed = placed.reshape(len(arenas), len(slots.boxes), 10).astype(np.float32)
    lie = [
        [_lie(arena.floor, k, loose) for k, loose in enumerate(row)]
        for arena, row in zip(arenas, lying, strict=True)
    ]
    return ArenaState(
        pos=placed[..., :3],
        quat=placed[..., 3:7],
        size=placed[..., 7:],
        rgb=_colours(boxed),
        victims=jax.tree.map(lambda *rows: np.stack(rows), *tables),
        tags=jax.tree.map(lambda *rows: np.stack(rows), *tags),
        starts=_starts(arenas, slots.starts),
        loose=np.array(lie, np.float32).reshape(len(arenas), len(slots.objects), 7),
        present=np.array([[one is not None for one in row] for row in lying], bool).reshape(
            len(arenas), len(slots.objects)
        ),
        lamps=_lamps(arenas, slots.lamps),
        serial=np.array(serials, np.int32),
    )


def arena_index_of(number: Array, episode: Array, arenas: int) -> Array:
    """Return the arena of a world in an episode: worlds go through the arenas in turn (...,)."""
    # 7919 is coprime to every smaller number of arenas, and to all that are no multiples of it.
    return (number + ARENA_STRIDE * episode) % arenas


def _check(arena: ArenaSpec, first: ArenaSpec) -> None:
    fixed = [name for name in ("doors", "waters") if getattr(arena, name)]
    fixed += ["conveyors"] if any(shape.conveyor is not None for shape in arena.shapes) else []
    fixed += sorted({f"solids of kind {shape.kind}" for shape in arena.shapes if shape.kind != "box"})
    if fixed:
        raise SpecError(
            f"arena {arena.name} has {', '.join(fixed)}, which cannot differ between the worlds of a batch: "
            "use it alone"
        )
    # The floor is part of the one model that all worlds share.
    if (arena.floor, arena.has_floor) != (first.floor, first.has_floor):
        raise SpecError(f"arenas {first.name} and {arena.name} of one batch have different floors")
    if not arena.starts:
        raise SpecError(f"arena {arena.name} has no start pose")


def _box(shape: Shape) -> np.ndarray:
    return np.array([*shape.at, *quat_from_angles(*shape.rotation), *shape.size])


def _lie(floor: float, index: int, loose: LooseObject | None) -> np.ndarray:
    """Return the initial pose of a loose object in the world; without one, the pose of its parked slot."""
    if loose is None:
        return np.array([*_park(index), 1.0, 0.0, 0.0, 0.0])
    x, y, z = loose.at
    return np.array([x, y, z + floor, *quat_from_angles(*loose.rotation)])


def _park(index: int) -> tuple[float, float, float]:
    x, y, z = LOOSE_PARKING_POS
    row, column = divmod(index, 16)
    return (x - LOOSE_PARKING_STEP * column, y - LOOSE_PARKING_STEP * row, z)


def _template(
    arenas: tuple[ArenaSpec, ...], boxes: Sequence[Shape], objects: Sequence[LooseObject], bones: int
) -> ArenaSpec:
    """Return the arena with all slots.

    Solids are rotated: MuJoCo treats a geom with the frame of its body as such, and could not move it.
    """
    turned = (0.1, 0.2, 0.3)
    slots = [replace(shape, at=PARKED_POS, rotation=turned, size=PARKED_SIZE) for shape in boxes]
    skin = Shape(kind="box", size=PARKED_SIZE, at=PARKED_POS, rotation=turned, surface="ground")
    (low_x, high_x), (low_y, high_y) = np.array([arena.extent for arena in arenas]).transpose(1, 2, 0)
    first = arenas[0]
    x, y, z = zip(*(_park(k) for k in range(len(objects))), strict=True) if objects else ((), (), ())
    return ArenaSpec(
        name=first.name if len(arenas) == 1 else f"{first.name} and {len(arenas) - 1} more",
        floor=first.floor,
        has_floor=first.has_floor,
        shapes=(*slots, *[skin] * bones),
        starts=first.starts[: min(len(arena.starts) for arena in arenas)],
        extent=((float(low_x.min()), float(high_x.max())), (float(low_y.min()), float(high_y.max()))),
        # The grid is in the world's axes; heights in an arena count from its floor.
        loose=tuple(
            LooseObject(
                name=str(k), at=(x[k], y[k], z[k] - first.floor), shapes=loose.shapes, inertia=loose.inertia
            )
            for k, loose in enumerate(objects)
        ),
        robots=first.robots,
    )


def _starts(arenas: Sequence[ArenaSpec], fewest: int) -> np.ndarray:
    def row(start: StartPose) -> tuple[float, ...]:
        return (*start.at, start.yaw)

    return np.array([[row(start) for start in arena.starts[:fewest]] for arena in arenas], np.float32)


def _colours(boxed: Sequence[Sequence[Shape | None]]) -> np.ndarray:
    rows = [[(0.0, 0.0, 0.0) if shape is None else shape.rgba[:3] for shape in row] for row in boxed]
    return np.array(rows, np.float32).reshape(len(rows), -1, 3)


def _lamps(arenas: Sequence[ArenaSpec], most: int) -> np.ndarray:
    rows = np.zeros((len(arenas), most, 6), np.float32)
    for row, arena in zip(rows, arenas, strict=True):
        # Lamps that an arena does not have stay dark: zeros.
        for lamp, light in zip(row, arena.lights, strict=False):
            lamp[:3] = np.add(light.at, (0.0, 0.0, arena.floor))
            lamp[3:] = np.multiply(light.rgb, light.brightness)
    return rows
