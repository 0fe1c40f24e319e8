"""Several arenas as one model: each world of a batch has one of them, and nothing is compiled again.

The model has a slot for every box that any of the arenas has, by surface and material, since those cannot
differ between worlds; where a box is and how large, is data. So are victims, start poses, and where loose
objects lie; slots that an arena does not need wait out of the way.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import jax
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.build.tags import TagTable, tag_table
from usarmjx.models.build.victims import VictimTable, pad_table, victim_table
from usarmjx.models.spec.arena import ArenaSpec, LooseObject, StartPose
from usarmjx.models.spec.shapes import Shape

PARKED_POS, PARKED_SIZE = (0.0, 0.0, -1000.0), (1e-3, 1e-3, 1e-3)
"""Where boxes wait that an arena does not have, and how large they are [m]: nothing comes there."""
LOOSE_PARK, LOOSE_STEP = (-20.0, -20.0, 30.0), 2.0
"""Where loose objects wait, pinned in the air, and how far apart [m]."""
STRIDE = 7919
"""So many arenas further is the one of a world's next episode: a prime, so that it comes to all of them."""


class ArenaState(struct.PyTreeNode, kw_only=True):
    """An arena as data: what may differ between the worlds of a batch.

    Attributes:
        pos: Centres of the boxes but for the victims', in the arena's axes [m] (boxes, 3).
        quat: Orientations (boxes, 4).
        size: Half lengths [m] (boxes, 3).
        rgb: Colours (boxes, 3).
        victims: The victims.
        tags: The RFID tags.
        starts: Start poses: x, y, z [m] and yaw [rad] (starts, 4).
        loose: Where loose objects start, in the world: position [m] and quaternion (objects, 7).
        present: Which of them there are (objects,).
        lamps: Where its lamps are, in the world [m], and their colour times brightness at 1 m; zero for those
            that it does not have (lamps, 6).
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


@dataclass(frozen=True, eq=False)
class ArenaSet:
    """Arenas, resolved.

    Attributes:
        arenas: What they are made from.
        template: The arena that the model is compiled from, with all boxes and loose objects parked; its last
            boxes are for victims.
        states: The arenas as data (arenas, ...); numpy arrays.
    """

    arenas: tuple[ArenaSpec, ...]
    template: ArenaSpec
    states: ArenaState

    @cached_property
    def max_half_length(self) -> np.ndarray:
        """The largest half length of each box in any arena, victims' boxes last [m] (boxes,)."""
        return np.concatenate([self.states.size.max((0, 2)), self.states.victims.size.max((0, 2))])


def arena_set(arenas: Sequence[ArenaSpec]) -> ArenaSet:
    """Resolve arenas for one batch.

    Raises:
        SpecError: No arenas; an arena with doors, water or solids other than boxes, which cannot differ
            between worlds; arenas with different floors; one without start poses.
    """
    arenas = tuple(arenas)
    if not arenas:
        raise SpecError("a batch needs at least one arena")
    for arena in arenas:
        _check(arena, arenas[0])
    boxes, boxed = _slots([sorted(arena.shapes, key=_longest) for arena in arenas], _form)
    objects, lying = _slots([arena.loose for arena in arenas], lambda loose: loose.shapes)
    tables = [victim_table(arena.victims, arena.false_alarms) for arena in arenas]
    most = max(table.num_boxes for table in tables), max(table.num_victims for table in tables)
    tables = [pad_table(table, *most) for table in tables]
    room = max(len(arena.tags) for arena in arenas)
    tags = [tag_table(arena.tags, room) for arena in arenas]
    parked = np.array([*PARKED_POS, 1.0, 0.0, 0.0, 0.0, *PARKED_SIZE])
    placed = np.array([[parked if shape is None else _box(shape) for shape in row] for row in boxed])
    placed = placed.reshape(len(arenas), len(boxes), 10).astype(np.float32)
    floor = arenas[0].floor
    lie = [[_lie(floor, k, loose) for k, loose in enumerate(row)] for row in lying]
    return ArenaSet(
        arenas=arenas,
        template=_template(arenas, boxes, objects, most[0]),
        states=ArenaState(
            pos=placed[..., :3],
            quat=placed[..., 3:7],
            size=placed[..., 7:],
            rgb=_colours(boxed),
            victims=jax.tree.map(lambda *rows: np.stack(rows), *tables),
            tags=jax.tree.map(lambda *rows: np.stack(rows), *tags),
            starts=_starts(arenas),
            loose=np.array(lie, np.float32).reshape(len(arenas), len(objects), 7),
            present=np.array([[one is not None for one in row] for row in lying], bool).reshape(
                len(arenas), len(objects)
            ),
            lamps=_lamps(arenas),
        ),
    )


def arena_index_of(number: Array, episode: Array, arenas: int) -> Array:
    """Return which arena a world has in an episode: worlds go through the arenas in turn (...,)."""
    return (number + STRIDE * episode) % arenas


def _check(arena: ArenaSpec, first: ArenaSpec) -> None:
    fixed = [name for name in ("doors", "waters") if getattr(arena, name)]
    fixed += sorted({f"solids of kind {shape.kind}" for shape in arena.shapes if shape.kind != "box"})
    if fixed:
        raise SpecError(
            f"arena {arena.name} has {', '.join(fixed)}, which cannot differ between the worlds of a batch: "
            "use it alone"
        )
    if (arena.floor, arena.has_floor) != (first.floor, first.has_floor):
        raise SpecError(f"arenas {first.name} and {arena.name} of one batch have different floors")
    if not arena.starts:
        raise SpecError(f"arena {arena.name} has no start pose")


def _form(shape: Shape) -> Hashable:
    return shape.surface, shape.material


def _longest(shape: Shape) -> float:
    """Sort key: the longest first, so that long walls share slots."""
    return -max(shape.size)


Thing = TypeVar("Thing")


def _slots(
    groups: Sequence[Sequence[Thing]], form: Callable[[Thing], Hashable]
) -> tuple[list[Thing], list[list[Thing | None]]]:
    """Return an example for every slot, and what each group has in it."""
    rows = []
    for group in groups:
        row: dict[Hashable, list[Thing]] = {}
        for one in group:
            row.setdefault(form(one), []).append(one)
        rows.append(row)
    examples: list[Thing] = []
    filled: list[list[Thing | None]] = [[] for _ in rows]
    for kind in dict.fromkeys(kind for row in rows for kind in row):
        most = max((row.get(kind, []) for row in rows), key=len)
        examples += most
        for slots, row in zip(filled, rows, strict=True):
            here = row.get(kind, [])
            slots += [*here, *[None] * (len(most) - len(here))]
    return examples, filled


def _box(shape: Shape) -> np.ndarray:
    return np.array([*shape.at, *quat_from_angles(*shape.rotation), *shape.size])


def _lie(floor: float, index: int, loose: LooseObject | None) -> np.ndarray:
    """Where a loose object is at the start, in the world; without one, where its slot is parked."""
    if loose is None:
        return np.array([*_park(index), 1.0, 0.0, 0.0, 0.0])
    x, y, z = loose.at
    return np.array([x, y, z + floor, *quat_from_angles(*loose.rotation)])


def _park(index: int) -> tuple[float, float, float]:
    x, y, z = LOOSE_PARK
    row, column = divmod(index, 16)
    return (x - LOOSE_STEP * column, y - LOOSE_STEP * row, z)


def _template(
    arenas: tuple[ArenaSpec, ...], boxes: Sequence[Shape], objects: Sequence[LooseObject], bones: int
) -> ArenaSpec:
    """Return the arena with all slots. Solids are turned, lest MuJoCo takes their frames for their body's."""
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
        loose=tuple(
            LooseObject(name=str(k), at=(x[k], y[k], z[k] - first.floor), shapes=loose.shapes)
            for k, loose in enumerate(objects)
        ),
        robots=first.robots,
    )


def _starts(arenas: Sequence[ArenaSpec]) -> np.ndarray:
    fewest = min(len(arena.starts) for arena in arenas)

    def row(start: StartPose) -> tuple[float, ...]:
        return (*start.at, start.yaw)

    return np.array([[row(start) for start in arena.starts[:fewest]] for arena in arenas], np.float32)


def _colours(boxed: Sequence[Sequence[Shape | None]]) -> np.ndarray:
    rows = [[(0.0, 0.0, 0.0) if shape is None else shape.rgba[:3] for shape in row] for row in boxed]
    return np.array(rows, np.float32).reshape(len(rows), -1, 3)


def _lamps(arenas: Sequence[ArenaSpec]) -> np.ndarray:
    rows = np.zeros((len(arenas), max(len(arena.lights) for arena in arenas), 6), np.float32)
    for row, arena in zip(rows, arenas, strict=True):
        for lamp, light in zip(row, arena.lights, strict=False):
            lamp[:3] = np.add(light.at, (0.0, 0.0, arena.floor))
            lamp[3:] = np.multiply(light.rgb, light.brightness)
    return rows
