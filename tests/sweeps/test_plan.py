"""Which cells are played together: a pure function."""

from tests.sweeps.conftest import write
from usarmjx.sweeps.run import batches_of, plan_batches, prepare
from usarmjx.sweeps.spec import load_spec

DATA = {"engine": "c", "team": 4, "policy": "by hand"}


def test_cells_that_differ_in_data_share_one_compilation():
    plan = plan_batches([DATA] * 10, [20] * 10, 256)
    assert [group.batches for group in plan.groups] == [(tuple(range(10)),)]
    assert plan.as_text() == "10 cells in 1 batch of 10, 1 compilation: the cells differ in data only"


def test_batches_are_even_and_no_larger_than_may_be():
    plan = plan_batches([DATA] * 10, [20] * 10, 70)  # room for 3 cells
    (group,) = plan.groups
    assert group.size == 3
    assert [len(batch) for batch in group.batches] == [3, 3, 3, 1]
    assert sorted(place for batch in group.batches for place in batch) == list(range(10))
    plan = plan_batches([DATA] * 8, [20] * 8, 140)  # room for 7: two of 4 spare nothing, 7 and 1 would
    assert [len(batch) for batch in plan.groups[0].batches] == [4, 4]
    assert plan_batches([DATA], [500], 256).groups[0].size == 1


def test_what_keeps_cells_apart_is_said():
    signatures = [{**DATA, "team": team} for team in (2, 4, 2, 6)]
    plan = plan_batches(signatures, [20] * 4, 256)
    assert [group.cells for group in plan.groups] == [(0, 2), (1,), (3,)]
    assert plan.differing == {"team": 3}
    assert "4 cells in 3 batches of 1 to 2, 3 compilations" in plan.as_text()
    assert "team (3 kinds)" in plan.as_text()


def test_cells_of_clients_share_with_nobody():
    plan = plan_batches([DATA] * 3, [2] * 3, 256, [False, True, True])
    assert [group.cells for group in plan.groups] == [(0,), (1,), (2,)]
    assert plan_batches([], [], 256).as_text() == "no cells to play"


def test_a_batch_is_sent_with_its_cells_and_a_cell_for_each_set_of_buildings(tmp_path):
    """The size of messages grows with the cells, not with their square."""
    product = {"seed": [*range(6)], "arena.level": [0.1, 0.9]}
    prepared = prepare(load_spec(write(tmp_path, product=product)), tmp_path / "out")
    works = batches_of(prepared)
    assert [cell for work in works for cell in work.cells] == list(prepared.cells)
    assert [len(work.cells) for work in works] == [2] * 6
    assert {len(work.group) for work in works} == {64}
    assert [[settings["arena.level"] for settings in work.kin] for work in works] == [[0.1, 0.9]] * 6
