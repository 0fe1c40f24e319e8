"""A cell that breaks its batch, or ends each worker that plays it: its neighbours are played all the same."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest

from usarmjx.base.errors import WriteError
from usarmjx.sweeps import play, run
from usarmjx.sweeps.play import BatchWork, failure
from usarmjx.sweeps.run import CellGroup, Prepared, SweepPlan, play_prepared
from usarmjx.sweeps.spec import read_spec
from usarmjx.sweeps.store import CellRecord
from usarmjx.sweeps.workers import Workers

CELLS, BAD = 100, 37


def key(number):
    return f"{number:020d}"


def work_of(numbers):
    cells = tuple((key(number), {"seed": number}) for number in numbers)
    return BatchWork(group="g", cells=cells, kin=(), size=len(cells), engine="c")


def record(key, settings, *_):
    return CellRecord(key=key, settings=dict(settings), scores=(1.0,), steps=(1,), bad=(False,))


@pytest.fixture
def batches(monkeypatch):
    """Sizes of the batches that were tried; one with the bad cell fails."""
    tried = []

    def episodes(work, watch):
        tried.append(len(work.cells))
        if key(BAD) in [name for name, _ in work.cells]:
            raise RuntimeError("no such floor")
        return [None] * len(work.cells)

    monkeypatch.setattr(play, "_episodes", episodes)
    monkeypatch.setattr(play, "_record", record)
    return tried


def test_a_batch_is_halved_until_the_broken_cell_is_alone(batches):
    found = play.play_batch(work_of(range(CELLS)))
    assert [one.key for one in found] == [key(number) for number in range(CELLS)]
    assert [one.key for one in found if one.failed] == [key(BAD)]
    assert found[BAD].failed == "RuntimeError: no such floor"
    assert len(batches) == 13, "the first one, and two for each of six halvings: 50, 25, 13, 6, 3, 1"


@dataclass(frozen=True, kw_only=True)
class Losing(Workers):
    """Workers that are lost with each batch that has the bad cell."""

    place: str = "processes"
    lost: list = field(default_factory=list)

    def run(self, work, pieces):
        for number, piece in enumerate(pieces):
            if key(BAD) in [name for name, _ in piece.cells]:
                self.lost.append(len(piece.cells))
                yield number, None, "its worker was lost 3 times"
            else:
                yield number, [record(*cell) for cell in piece.cells], None


def test_a_cell_that_ends_its_workers_fails_alone(tmp_path, monkeypatch):
    numbers = tuple(range(CELLS))
    group = CellGroup(cells=numbers, batches=(numbers[:50], numbers[50:]), size=50)
    prepared = Prepared(
        cells=work_of(numbers).cells,
        known=0,
        broken=(),
        engine=("c",) * CELLS,
        buildings=((),) * CELLS,
        plan=SweepPlan(groups=(group,), differing={}),
        keys=tuple(map(key, numbers)),
    )
    kept = {}
    monkeypatch.setattr(run, "write_cells", lambda folder, some: kept.update((one.key, one) for one in some))
    monkeypatch.setattr(run, "read_sweep", lambda folder: SimpleNamespace(records=list(kept.values())))
    spec = read_spec({"common": {"task": "drive-to-goal"}, "product": {"seed": [0]}})
    workers = Losing()
    found = play_prepared(spec, tmp_path, prepared, workers)
    assert sorted(one.key for one in found.records) == list(map(key, numbers)), "each once"
    assert [one.key for one in found.records if one.failed] == [key(BAD)]
    assert workers.lost == [50, 25, 13, 6, 3, 1]
    reason = failure(key(BAD), {"seed": BAD}, "its worker was lost 3 times").failed
    assert kept[key(BAD)].failed == reason


def test_a_full_disk_ends_a_sweep_and_breaks_no_cell(tmp_path, monkeypatch):
    """The first batch cannot be written; that comes to light while the second one is played."""
    numbers, played = tuple(range(4)), []
    group = CellGroup(cells=numbers, batches=(numbers[:2], numbers[2:]), size=2)
    prepared = Prepared(
        cells=work_of(numbers).cells,
        known=0,
        broken=(),
        engine=("c",) * 4,
        buildings=((),) * 4,
        plan=SweepPlan(groups=(group,), differing={}),
        keys=tuple(map(key, numbers)),
    )

    def full(folder, records):
        if records:
            raise WriteError("no space")

    def play_batch(work, watch):
        for share in (0.5, 1.0):
            watch(share)
        played.append(len(work.cells))
        return [record(*cell) for cell in work.cells]

    monkeypatch.setattr(run, "write_cells", full)
    monkeypatch.setattr(run, "play_batch", play_batch)
    seen = []
    spec = read_spec({"common": {"task": "drive-to-goal"}, "product": {"seed": [0]}})
    with pytest.raises(WriteError, match="no space"):
        play_prepared(spec, tmp_path, prepared, sinks=[seen.append])
    assert (played, seen) == ([2, 2], []), "no half is tried again, and no sink hears of lost cells"
