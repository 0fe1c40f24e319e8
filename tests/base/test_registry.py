import pytest

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.registry import Registry
from usarmjx.models.arenas import ARENAS
from usarmjx.models.arenas.yellow import YELLOW
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT, P2DX


@pytest.fixture
def birds() -> Registry[int]:
    table: Registry[int] = Registry("bird")
    table.add("Swift", 1, aliases=("Apus",))
    table.add("Crow", 2)
    return table


def test_names_and_aliases_are_matched_without_case(birds: Registry[int]):
    assert [birds.get(name) for name in ("Swift", "SWIFT", "apus", "crow")] == [1, 1, 1, 2]
    assert "APUS" in birds
    assert "wren" not in birds


def test_listing_is_sorted_and_without_aliases(birds: Registry[int]):
    assert birds.names() == ["Crow", "Swift"]
    assert list(birds) == [("Crow", 2), ("Swift", 1)]
    assert len(birds) == 2


@pytest.mark.parametrize(
    ("name", "aliases"), [("swift", ()), ("APUS", ()), ("Wren", ("CROW",)), ("Wren", ("apus",))]
)
def test_taken_names_are_refused_and_nothing_is_added(birds: Registry[int], name, aliases):
    with pytest.raises(UsageError, match=r"bird '.*' is registered already"):
        birds.add(name, 3, aliases=aliases)
    assert birds.names() == ["Crow", "Swift"]
    assert birds.get("Swift") == 1


def test_replacing_keeps_the_spelling_and_the_aliases(birds: Registry[int]):
    assert birds.replace("APUS", 5) == 5
    birds.replace("crow", 6)
    birds.replace("Wren", 7)
    assert list(birds) == [("Crow", 6), ("Swift", 5), ("Wren", 7)]
    assert birds.get("apus") == 5


def test_unknown_name_lists_the_known_ones(birds: Registry[int]):
    with pytest.raises(UnknownNameError, match="unknown bird 'Wren'; known: Crow, Swift") as caught:
        birds.get("Wren")
    assert isinstance(caught.value, KeyError)
    with pytest.raises(UnknownNameError, match="known: none"):
        Registry("bird").get("Wren")


def test_what_ships_is_registered():
    assert ROBOTS.get("p2at") is P2AT
    assert ROBOTS.get("P2dx") is P2DX
    assert ARENAS.get("dm-usar_YELLOW") is ARENAS.get("yellow") is YELLOW
    with pytest.raises(
        UnknownNameError,
        match=r"unknown robot 'R2D2'; did you mean 'Kurt2D'[?] known: AirRobot, .*, P2AT, P2DX, .*, Zerg",
    ):
        ROBOTS.get("R2D2")
    with pytest.raises(UnknownNameError, match=r"unknown arena 'blue'; known: .*DM-USAR_yellow"):
        ARENAS.get("blue")
