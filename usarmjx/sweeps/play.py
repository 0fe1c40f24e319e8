"""A batch as a piece of work: what is sent to a worker, and what it makes of it."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any

from jax import monitoring

from usarmjx.base.compilation import COMPILE_EVENT_PREFIX
from usarmjx.base.errors import UsarmjxError, quoted
from usarmjx.recording.inputs import versions
from usarmjx.sweeps.batch import CellEpisodes, GroupRunner
from usarmjx.sweeps.resolve import Resolved, base_settings, base_task, resolve
from usarmjx.sweeps.spec import CellSettings
from usarmjx.sweeps.store import CellRecord
from usarmjx.train.envs.task import Task

CompileSpan = tuple[float, float]
"""Begin and end [s]."""


def covered(spans: Iterable[CompileSpan]) -> float:
    """Return the time covered by at least one span [s]: a trace within a trace counts once."""
    whole, until = 0.0, -float("inf")
    # Sorted by their beginnings: spans are heard at their ends, an outer one after those within it.
    for begin, end in sorted(spans):
        whole += max(0.0, end - max(begin, until))
        until = max(until, end)
    return whole


class CompileClock:
    """Hears of all compilations of this process."""

    def __init__(self) -> None:
        self._spans: list[CompileSpan] = []

    def hear(self, event: str, duration_secs: float, **_: object) -> None:
        """Take note of what has just ended and how long it took [s]; JAX calls it."""
        if event.startswith(COMPILE_EVENT_PREFIX):
            now = time.monotonic()
            # JAX reports a compilation at its end only: its beginning is counted back.
            self._spans.append((now - duration_secs, now))

    def taken(self) -> float:
        """Return the time of compilation since the last call [s]."""
        spans, self._spans = self._spans, []
        return covered(spans)


@cache
def compile_clock() -> CompileClock:
    """Return the clock of this process; it hears what is compiled from the first call on."""
    clock = CompileClock()
    monitoring.register_event_duration_secs_listener(clock.hear)
    return clock


@dataclass(frozen=True, kw_only=True)
class BatchWork:
    """A batch to be played.

    Attributes:
        group: Name of its group: what is compiled for one batch of it does for the others.
        cells: Keys and settings of its cells.
        kin: Settings of cells of the group that have all of its arenas between them.
        size: Number of cells played at once.
        engine: The physics engine.
    """

    group: str
    cells: tuple[tuple[str, CellSettings], ...]
    kin: tuple[CellSettings, ...]
    size: int
    engine: str


ShareWatch = Callable[[float], None]
"""Receives the share of a batch that is done."""


class _Kept:
    """The last group's environment, which its next batch needs again."""

    name: str = ""
    runner: GroupRunner | None = None


def kept_runner() -> GroupRunner | None:
    """Return what played the last batch of this process; None: there was none, or it failed."""
    return _Kept.runner


def play_batch(work: BatchWork, watch: ShareWatch | None = None) -> list[CellRecord]:
    """Play a batch; where it fails, its halves, so that one broken cell does not stop the others."""
    clock = compile_clock()
    clock.taken()  # what was compiled before is not of this batch
    try:
        found = _episodes(work, watch)
    except Exception as error:  # whatever a policy or the device does
        # Its worlds may be in any state, and the halves need their memory.
        _Kept.runner = None
        if len(work.cells) == 1:
            return [failure(*work.cells[0], _reason(error))]
        # Without the watch, as shares of a half would read as shares of the whole batch.
        return [record for half in halves(work) for record in play_batch(half)]
    compiling = clock.taken() / len(work.cells)
    return [_record(*cell, work.engine, one, compiling) for cell, one in zip(work.cells, found, strict=True)]


def _reason(error: Exception) -> str:
    return str(error) if isinstance(error, UsarmjxError) else f"{type(error).__name__}: {quoted(error)}"


def failure(key: str, settings: CellSettings, reason: str) -> CellRecord:
    """Return the record of a cell that has no result."""
    return CellRecord(key=key, settings=dict(settings), versions=versions(), failed=reason)


def _episodes(work: BatchWork, watch: ShareWatch | None) -> Sequence[CellEpisodes]:
    own = [resolved(settings) for _, settings in work.cells]
    # A cell with a client is a batch of its own, so the first cell is the only one.
    if own[0].driver.command is not None:
        # Here, as most sweeps have no clients and need no server.
        from usarmjx.sweeps.clients import play_client

        return [play_client(cell, cell.driver, work.engine) for cell in own]
    if _Kept.runner is None or _Kept.name != work.group:
        _Kept.runner = None  # so that its memory is free before the next one's is taken
        kin = [resolved(settings) for settings in work.kin]
        _Kept.runner, _Kept.name = GroupRunner(kin, work.size, work.engine), work.group
    return _Kept.runner.run(own, watch)


def halves(work: BatchWork) -> list[BatchWork]:
    """Return a batch as two, each a group of its own."""
    middle = len(work.cells) // 2
    return [
        BatchWork(
            # Another name: `_Kept` must not serve a half with the environment of the whole batch.
            group=f"{work.group}:{cells[0][0]}-{len(cells)}",
            cells=cells,
            kin=tuple(settings for _, settings in cells),
            size=len(cells),
            engine=work.engine,
        )
        for cells in (work.cells[:middle], work.cells[middle:])
    ]


def _record(key: str, settings: CellSettings, engine: str, one: CellEpisodes, compiling: float) -> CellRecord:
    cell = resolved(settings)
    return CellRecord(
        key=key,
        settings=dict(settings),
        engine=engine,
        scores=tuple(one.scores.tolist()),
        steps=tuple(one.steps.tolist()),
        bad=tuple(one.bad.tolist()),
        metrics={name: tuple(values.tolist()) for name, values in one.metrics.items()},
        split=cell.split,
        buildings=cell.buildings,
        strata=cell.strata,
        note=cell.training_note,
        seconds=one.seconds,
        compile_seconds=compiling,
        agents=one.agents,
        versions=versions(),
    )


def resolved(settings: CellSettings) -> Resolved:
    """Return resolved settings; repeated ones come from a cache, for any seed.

    Raises:
        UsageError: See `resolve`.
    """
    # Without the seed: cells that repeat one another differ in it alone, and share one entry.
    found = _resolved(_Frozen({name: value for name, value in settings.items() if name != "seed"}))
    return replace(found, settings=settings)


class _Frozen:
    """Settings as a key of a cache."""

    def __init__(self, settings: CellSettings) -> None:
        # By text: settings hold lists and mappings, which have no hash.
        self.settings, self._text = settings, repr(sorted(settings.items()))

    def __hash__(self) -> int:
        return hash(self._text)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Frozen) and self._text == other._text


def forget_resolved() -> None:
    """Forget what settings stood for: the files that they name may have changed."""
    _resolved.cache_clear()
    _base.cache_clear()


@lru_cache(maxsize=4096)
def _resolved(frozen: Any) -> Resolved:  # noqa: ANN401 - a _Frozen
    return resolve(frozen.settings, _base(_Frozen(base_settings(frozen.settings))))


@lru_cache(maxsize=256)
def _base(frozen: Any) -> Task:  # noqa: ANN401 - a _Frozen
    return base_task(frozen.settings)
