"""Start poses that clients of the original's maps ask for."""

import pytest

from usarmjx.models.arenas import ARENAS
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.train.envs.recipe import GeneratedArenas
from usarmjx.train.tasks import TASKS


@pytest.mark.parametrize("name", ARENAS.names())
def test_every_arena_has_one_player_start(name):
    """Manual 5.3.2: any map has at least one PlayerStart; controllers ask for it by that name."""
    assert [start.tag for start in ARENAS.get(name).starts].count("PlayerStart") == 1


@pytest.mark.parametrize("name", TASKS.names())
def test_the_first_start_of_a_tasks_own_arena_is_a_player_start(name):
    """Clients of a world that a policy drives ask for it, too."""
    arenas = TASKS.get(name).arenas
    if isinstance(arenas, GeneratedArenas):
        arenas = arenas.arena(0, arenas.seed)
    for arena in [arenas] if isinstance(arenas, str | ArenaSpec) else arenas:
        spec = ARENAS.get(arena) if isinstance(arena, str) else arena
        assert [i for i, start in enumerate(spec.starts) if start.tag == "PlayerStart"] == [0]
