"""Start poses that clients of the original's maps ask for."""

import pytest

from usarmjx.models.arenas import ARENAS


@pytest.mark.parametrize("name", ARENAS.names())
def test_every_arena_has_one_player_start(name):
    """Manual 5.3.2: any map has at least one PlayerStart; controllers ask for it by that name."""
    assert [start.tag for start in ARENAS.get(name).starts].count("PlayerStart") == 1
