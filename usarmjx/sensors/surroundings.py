"""What sensors can know of a world beside their own robot and what their rays meet: victims and RFID tags."""

from types import ModuleType

import jax
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.backend import numpy_backend, on_numpy, xp
from usarmjx.models.compile.tags import TagTable, tag_table
from usarmjx.models.compile.victims import (
    VictimTable,
    loudness,
    mouth_positions,
    orientations,
    segment_poses,
    segment_speeds,
    victim_table,
)
from usarmjx.models.effecters import DroppedTags, no_dropped_tags


class Surroundings(struct.PyTreeNode, kw_only=True):
    """Victims and tags of one world at one moment, in world axes. Shared by its robots.

    Attributes:
        box_pos: Centres of the victims' boxes and false alarms [m] (boxes, 3).
        box_mat: Their orientations (boxes, 3, 3).
        box_size: Their half lengths [m] (boxes, 3).
        box_part: What they are, as places in `victims.PART_NAMES` (boxes,).
        box_owner: Whose they are: a victim's place, or less than 0: see `VictimTable.owner` (boxes,).
        speed: How fast their fastest corners move [m/s] (boxes,).
        swing: Farthest that a corner of each gets from where it began [m] (boxes,).
        mouth: Where each victim cries and breathes [m] (victims, 3).
        loudness: How loud each cries now, measured at 1 m (victims,).
        duration: How long its cries last [s] (victims,).
        breathes: Whether it breathes (victims,).
        tag_pos: Where RFID tags are [m] (tags, 3).
        tag_id: Their IDs (tags,).
        tag_single: Whether they answer only once (tags,).
        tag_there: Whether there is such a tag (tags,).
    """

    box_pos: Array
    box_mat: Array
    box_size: Array
    box_part: Array
    box_owner: Array
    speed: Array
    swing: Array
    mouth: Array
    loudness: Array
    duration: Array
    breathes: Array
    tag_pos: Array
    tag_id: Array
    tag_single: Array
    tag_there: Array


def nearest(distance: Array, count: int) -> Array:
    """Return the places of the least of some distances (..., n), the nearest first (..., count)."""
    if on_numpy():
        return np.argsort(distance, stable=True)[..., :count]
    return jax.lax.top_k(-distance, count)[1]


def surroundings_at(
    victims: VictimTable,
    arena_tags: TagTable,
    dropped_tags: DroppedTags,
    time: Array,
    floor: Array,
    xp: ModuleType = xp,
) -> Surroundings:
    """Return what is around in one world.

    Args:
        victims: Victims and false alarms, in the arena's axes.
        arena_tags: The arena's own tags, in the arena's axes.
        dropped_tags: Tags that robots have dropped, in world axes.
        time: Simulated time, by which victims move and cry [s] ().
        floor: Height of the arena's floor in the world [m] ().
        xp: Array module of all of them.
    """
    up = xp.stack([0.0 * floor, 0.0 * floor, floor * xp.ones((), xp.float32)])
    pos, quat = segment_poses(victims, time, xp)
    return Surroundings(
        box_pos=pos + up,
        box_mat=orientations(quat, xp),
        box_size=victims.size,
        box_part=victims.part,
        box_owner=victims.owner,
        speed=segment_speeds(victims, time, xp),
        swing=victims.swing,
        mouth=mouth_positions(victims, pos, xp) + up,
        loudness=loudness(victims, time, xp),
        duration=victims.duration,
        breathes=victims.breathes,
        **_all_tags(arena_tags, dropped_tags, up, xp),
    )


def tags_at(arena_tags: TagTable, dropped_tags: DroppedTags, floor: Array) -> Surroundings:
    """Return what is around where nobody looks for victims; arguments are those of `surroundings_at`."""
    up = xp.stack([0.0 * floor, 0.0 * floor, floor])
    return NO_SURROUNDINGS.replace(**_all_tags(arena_tags, dropped_tags, up, xp))


def _all_tags(arena_tags: TagTable, dropped_tags: DroppedTags, up: Array, xp: ModuleType) -> dict[str, Array]:
    """Return the fields of `Surroundings` that are of tags: those of the arena, then those dropped."""
    room = len(dropped_tags.pos)
    return {
        "tag_pos": xp.concatenate([arena_tags.pos + up, dropped_tags.pos]),
        "tag_id": xp.concatenate([arena_tags.id, xp.arange(room, dtype=xp.int32)]),
        "tag_single": xp.concatenate([arena_tags.single, xp.zeros(room, bool)]),
        "tag_there": xp.concatenate([arena_tags.id >= 0, xp.arange(room) < dropped_tags.count]),
    }


with numpy_backend():
    NO_SURROUNDINGS = surroundings_at(
        victim_table([]), tag_table([]), no_dropped_tags(), xp.zeros(()), xp.zeros(())
    )
"""Of a world without victims, and without tags of its own."""
