"""RFID tags of an arena as arrays (manual 9.3, 10.9)."""

from collections.abc import Sequence

import numpy as np

from usarmjx.base.backend import Array
from usarmjx.base.errors import SpecError
from usarmjx.base.nodes import Node
from usarmjx.models.types.arena import AUTOMATIC_TAG_ID, Tag

MAX_RELEASED_ID = 1000
"""Largest ID of releasers (manual 11.2.1); an arena's tags have larger ones."""


class TagTable(Node, kw_only=True):
    """The tags of an arena; every number is an array leaf, so that tables of several worlds can be stacked.

    Attributes:
        pos: Positions, in the arena's axes [m] (tags, 3).
        id: Their IDs, -1 for padding (tags,).
        single: Whether each answers only once (tags,).
    """

    pos: Array
    id: Array
    single: Array


def tag_ids(tags: Sequence[Tag]) -> tuple[int, ...]:
    """Return the IDs of an arena's tags; automatic ones take the smallest free IDs above `MAX_RELEASED_ID`.

    Raises:
        SpecError: An ID of releasers, or one that two tags have.
    """
    given = [tag.id for tag in tags if tag.id != AUTOMATIC_TAG_ID]
    for number in given:
        if number <= MAX_RELEASED_ID:
            raise SpecError(
                f"an arena has a tag {number}, expected {AUTOMATIC_TAG_ID} or one above {MAX_RELEASED_ID}"
            )
    if len(set(given)) < len(given):
        raise SpecError(f"tags of one ID among {', '.join(map(str, given))}")
    # One number more than tags: enough even if all given ones are among them.
    free = (
        number
        for number in range(MAX_RELEASED_ID + 1, MAX_RELEASED_ID + 2 + len(tags))
        if number not in given
    )
    return tuple(next(free) if tag.id == AUTOMATIC_TAG_ID else tag.id for tag in tags)


def tag_table(tags: Sequence[Tag], capacity: int | None = None) -> TagTable:
    """Return an arena's tags as numpy arrays.

    Args:
        tags: The tags.
        capacity: Number of rows of the table; the rest is padding. None: the number of tags.

    Raises:
        SpecError: An ID that is taken; more tags than there is room for.
    """
    more = 0 if capacity is None else capacity - len(tags)
    if more < 0:
        raise SpecError(f"{len(tags)} tags do not fit into room for {capacity}")
    # A negative ID marks room without a tag; see `Surroundings.tag_there`.
    return TagTable(
        pos=np.array([*(tag.at for tag in tags), *[(0.0, 0.0, 0.0)] * more], np.float32).reshape(-1, 3),
        id=np.array([*tag_ids(tags), *[-1] * more], np.int32),
        single=np.array([*(tag.single_shot for tag in tags), *[False] * more], bool),
    )
