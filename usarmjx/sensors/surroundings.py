"""Surroundings of the sensors besides their robot and ray hits: victims and RFID tags."""

from types import ModuleType

import jax
import numpy as np

from usarmjx.base.backend import Array, numpy_backend, on_numpy, xp
from usarmjx.base.clock import Time
from usarmjx.base.nodes import Node
from usarmjx.base.warp_functions import warp_in_use
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


class Surroundings(Node, kw_only=True):
    """Victims and tags of one world at one moment, in world axes. Shared by its robots.

    Attributes:
        box_pos: Centres of the boxes of victims and false alarms [m] (boxes, 3).
        box_mat: Their orientations (boxes, 3, 3).
        box_size: Their half lengths [m] (boxes, 3).
        box_part: Body parts, as indices in `victims.PART_NAMES` (boxes,).
        box_owner: Victim's index, or a negative number: see `VictimTable.owner` (boxes,).
        speed: Speeds of their fastest corners [m/s] (boxes,).
        swing: Largest amplitude of each box's corners from the initial position [m] (boxes,).
        mouth: Victims' mouths, where they cry and breathe [m] (victims, 3).
        loudness: Current loudness of each at 1 m (victims,).
        duration: Duration of its cries [s] (victims,).
        breathes: Whether it breathes (victims,).
        tag_pos: Positions of RFID tags [m] (tags, 3).
        tag_id: Their IDs (tags,).
        tag_single: Whether they answer only once (tags,).
        tag_there: Whether the tag exists (tags,).
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
    """Return the indices of the smallest distances (..., n), in ascending order (..., count)."""
    if on_numpy():
        # Stable, as top_k is: equal distances keep the order of both libraries alike.
        return np.argsort(distance, stable=True)[..., :count]
    if warp_in_use():
        from usarmjx.sensors.nearest_warp import MOST, nearest_of_rows

        # On a GPU top_k sorts whole rows.
        if count <= distance.shape[-1] <= MOST:
            return nearest_of_rows(distance, count)
    return jax.lax.top_k(-distance, count)[1]


def surroundings_at(
    victims: VictimTable,
    arena_tags: TagTable,
    dropped_tags: DroppedTags,
    time: Time,
    floor: Array,
    xp: ModuleType = xp,
) -> Surroundings:
    """Return the surroundings of one world.

    Args:
        victims: Victims and false alarms, in the arena's axes.
        arena_tags: The arena's own tags, in the arena's axes.
        dropped_tags: Tags dropped by robots, in world axes.
        time: Simulated time [s] or clock, on which victims' motion and cries depend ().
        floor: Height of the arena's floor in the world [m] ().
        xp: Array module of all arguments.
    """
    # Times 0.0 gives zeros of the floor's kind: it may be traced or have an axis over worlds.
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
    """Return surroundings with tags only; arguments as for `surroundings_at`."""
    up = xp.stack([0.0 * floor, 0.0 * floor, floor])
    return NO_SURROUNDINGS.replace(**_all_tags(arena_tags, dropped_tags, up, xp))


def _all_tags(arena_tags: TagTable, dropped_tags: DroppedTags, up: Array, xp: ModuleType) -> dict[str, Array]:
    """Return the tag fields of `Surroundings`: those of the arena, then dropped ones."""
    room = len(dropped_tags.pos)
    return {
        "tag_pos": xp.concatenate([arena_tags.pos + up, dropped_tags.pos]),
        "tag_id": xp.concatenate([arena_tags.id, xp.arange(room, dtype=xp.int32)]),
        "tag_single": xp.concatenate([arena_tags.single, xp.zeros(room, bool)]),
        # Room for tags is of fixed size: entries without one have a negative ID, or are beyond the count.
        "tag_there": xp.concatenate([arena_tags.id >= 0, xp.arange(room) < dropped_tags.count]),
    }


with numpy_backend():
    NO_SURROUNDINGS = surroundings_at(
        victim_table([]), tag_table([]), no_dropped_tags(), xp.zeros(()), xp.zeros(())
    )
    """Surroundings without victims and tags."""
"""Of a world without victims, and without tags of its own."""
