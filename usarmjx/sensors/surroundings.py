"""What sensors can know of a world beside their own robot and what their rays meet: victims and RFID tags."""

from types import ModuleType

import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.transforms import Array
from usarmjx.models.build.tags import TagTable, tag_table
from usarmjx.models.build.victims import (
    VictimTable,
    loudness,
    mouths,
    orientations,
    segment_poses,
    segment_speeds,
    victim_table,
)
from usarmjx.models.effecters import Tags, no_tags


class Surroundings(struct.PyTreeNode, kw_only=True):
    """Victims and tags of one world at one moment, in world axes. Shared by its robots.

    Attributes:
        box_pos: Centres of the victims' boxes and false alarms [m] (boxes, 3).
        box_mat: Their orientations (boxes, 3, 3).
        box_size: Their half lengths [m] (boxes, 3).
        part: What they are, as places in `victims.PART_NAMES` (boxes,).
        owner: Whose they are: a victim's place, or less than 0: see `VictimTable.owner` (boxes,).
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
    part: Array
    owner: Array
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


def survey(
    people: VictimTable, lying: TagTable, dropped: Tags, time: Array, floor: Array, xp: ModuleType = jnp
) -> Surroundings:
    """Return what is around in one world.

    Args:
        people: Victims and false alarms, in the arena's axes.
        lying: The arena's own tags, in the arena's axes.
        dropped: Tags that robots have dropped, in world axes.
        time: Simulated time, by which victims move and cry [s] ().
        floor: Height of the arena's floor in the world [m] ().
        xp: Array module of all of them.
    """
    up = xp.stack([0.0 * floor, 0.0 * floor, floor * xp.ones((), xp.float32)])
    pos, quat = segment_poses(people, time, xp)
    room = len(dropped.pos)
    return Surroundings(
        box_pos=pos + up,
        box_mat=orientations(quat, xp),
        box_size=people.size,
        part=people.part,
        owner=people.owner,
        speed=segment_speeds(people, time, xp),
        swing=people.swing,
        mouth=mouths(people, pos, xp) + up,
        loudness=loudness(people, time, xp),
        duration=people.duration,
        breathes=people.breathes,
        tag_pos=xp.concatenate([lying.pos + up, dropped.pos]),
        tag_id=xp.concatenate([lying.id, xp.arange(room, dtype=xp.int32)]),
        tag_single=xp.concatenate([lying.single, xp.zeros(room, bool)]),
        tag_there=xp.concatenate([lying.id >= 0, xp.arange(room) < dropped.count]),
    )


NOTHING = survey(victim_table([]), tag_table([]), no_tags(np), np.zeros(()), np.zeros(()), np)
"""Of a world without victims, and without tags of its own."""
