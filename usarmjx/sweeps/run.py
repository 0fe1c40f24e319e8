"""A sweep from its file to its results: plan, play what is missing, keep each cell."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TextIO

from usarmjx.base.errors import UsageError
from usarmjx.engines import choose_engine
from usarmjx.sweeps.plan import WORLDS_OF_C, WORLDS_ON_CPU, WORLDS_ON_GPU, SweepPlan, plan_batches
from usarmjx.sweeps.play import BatchWork, failure, play_batch, resolved
from usarmjx.sweeps.progress import SweepProgress
from usarmjx.sweeps.resolve import key_of, signature_of
from usarmjx.sweeps.sinks import Sink
from usarmjx.sweeps.spec import SweepSpec, find_spec, load_spec, read_spec
from usarmjx.sweeps.store import CellRecord, StoredSweep, read_cell, read_sweep, write_cell, write_sweep
from usarmjx.sweeps.workers import Workers
from usarmjx.train.learning.defaults import on_gpu

KeyedSettings = tuple[str, dict[str, Any]]
"""Key and settings."""


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """What is to be done.

    Attributes:
        cells: Those that have no result yet.
        known: How many have one, or have failed before.
        broken: Those that stand for nothing.
        engine: Of each of `cells`.
        plan: How they are played.
        keys: Of all cells of the sweep.
    """

    cells: tuple[KeyedSettings, ...]
    known: int
    broken: tuple[CellRecord, ...]
    engine: tuple[str, ...]
    plan: SweepPlan
    keys: tuple[str, ...]


def prepare(spec: SweepSpec, folder: Path, retry: bool = False) -> Prepared:
    """Return what of a sweep is to be done: what is kept in its folder is not done again.

    Args:
        spec: The sweep.
        folder: Its folder.
        retry: Whether what has failed is done again.

    Raises:
        UsageError: No such engine.
    """
    keys: list[str] = []
    cells: list[KeyedSettings] = []
    broken: list[CellRecord] = []
    signatures: list[dict[str, Any]] = []
    engines: list[str] = []
    known = 0
    for asked in spec.cells:
        settings = {**asked, "engine": choose_engine(str(asked["engine"]), "train")}
        try:
            key = key_of(settings)
        except UsageError as error:
            key = hashlib.sha256(repr(sorted(settings.items())).encode()).hexdigest()[:20]
            broken.append(failure(key, settings, str(error)))
        if key in keys:
            continue
        keys.append(key)
        before = read_cell(folder, key)
        if before is not None and not (retry and before.failed is not None):
            known += 1
            continue
        if broken and broken[-1].key == key:
            continue
        try:
            signature = signature_of(resolved(settings), settings["engine"])
        except UsageError as error:
            broken.append(failure(key, settings, str(error)))
            continue
        cells.append((key, settings))
        signatures.append(signature)
        engines.append(settings["engine"])
    most = spec.worlds or _usual_worlds(engines[0] if engines else "c")
    episodes = [int(settings["episodes"]) for _, settings in cells]
    clients = [resolved(settings).driver.command is not None for _, settings in cells]
    plan = plan_batches(signatures, episodes, most, clients)
    return Prepared(
        cells=tuple(cells),
        known=known,
        broken=tuple(broken),
        engine=tuple(engines),
        plan=plan,
        keys=tuple(keys),
    )


def _usual_worlds(engine: str) -> int:
    if engine == "c":
        return WORLDS_OF_C
    return WORLDS_ON_GPU if on_gpu(engine) else WORLDS_ON_CPU


def batches_of(prepared: Prepared) -> list[BatchWork]:
    """Return the pieces of work of a plan."""
    works: list[BatchWork] = []
    for group in prepared.plan.groups:
        cells = tuple(prepared.cells[place] for place in group.cells)
        name = hashlib.sha256("".join(key for key, _ in cells).encode()).hexdigest()
        for batch in group.batches:
            works.append(
                BatchWork(
                    group=name,
                    cells=cells,
                    chosen=tuple(group.cells.index(place) for place in batch),
                    size=group.size,
                    engine=prepared.engine[group.cells[0]],
                )
            )
    return works


def run_sweep(
    spec: SweepSpec,
    folder: Path,
    workers: Workers | None = None,
    *,
    retry: bool = False,
    say: Callable[[str], None] | None = None,
    stream: TextIO | None = None,
    sinks: Sequence[Sink] = (),
) -> StoredSweep:
    """Play the cells of a sweep that have no result yet, and keep each.

    Args:
        spec: The sweep.
        folder: Where results are kept.
        workers: Where it is played; None: here.
        retry: Whether what has failed is done again.
        say: Is told the plan, in lines.
        stream: Where progress is said; None: nowhere.
        sinks: Are told of each cell that is finished or has failed.

    Raises:
        UsageError: No such engine or place.
        WriteError: The folder cannot be written to.
    """
    prepared = prepare(spec, folder, retry)
    return play_prepared(spec, folder, prepared, workers, say=say, stream=stream, sinks=sinks)


def play_prepared(
    spec: SweepSpec,
    folder: Path,
    prepared: Prepared,
    workers: Workers | None = None,
    *,
    say: Callable[[str], None] | None = None,
    stream: TextIO | None = None,
    sinks: Sequence[Sink] = (),
) -> StoredSweep:
    """Play what `prepare` has found, and keep each cell; see `run_sweep`.

    Raises:
        UsageError: No such place.
        WriteError: The folder cannot be written to.
    """
    workers, say = workers or Workers(), say or (lambda line: None)
    write_sweep(folder, spec.name, spec.about, spec.axes, prepared.keys)
    if prepared.known:
        say(f"{prepared.known} of {len(spec.cells)} cells are there already")
    if prepared.cells:
        say(prepared.plan.as_text())
    progress = SweepProgress(len(prepared.cells) + len(prepared.broken), stream)

    def keep(records: Sequence[CellRecord]) -> None:
        for record in records:
            write_cell(folder, record)
            for sink in sinks:
                sink(record)
        failed = sum(record.failed is not None for record in records)
        progress.add(len(records) - failed, failed)

    keep(prepared.broken)
    works = batches_of(prepared)
    try:
        for number, records, lost in workers.run(_work(workers, progress), works):
            keep(_lost(works[number], lost) if lost is not None else records)
    finally:
        progress.close()
    return read_sweep(folder)


def _work(workers: Workers, progress: SweepProgress) -> Callable[[BatchWork], list[CellRecord]]:
    """Return what plays a batch; here it tells how far it is."""
    if workers.place != "here":
        return play_batch

    def play(work: BatchWork) -> list[CellRecord]:
        return play_batch(work, partial(progress.within, len(work.chosen)))

    return play


def _lost(work: BatchWork, reason: str) -> list[CellRecord]:
    return [failure(*work.cells[place], reason) for place in work.chosen]


def sweep(
    what: str | Path | Mapping[str, Any],
    folder: str | Path,
    *,
    workers: Workers | None = None,
    retry: bool = False,
    **common: Any,  # noqa: ANN401 - settings of any kind
) -> Any:  # noqa: ANN401 - a table of pandas, or rows
    """Play a sweep and return its table: pandas' DataFrame where that is installed, else a list of rows.

    Args:
        what: A file, the name of a bundled sweep, or what a file would hold.
        folder: Where results are kept; what is there already is not played again.
        workers: Where it is played; None: in this process.
        retry: Whether what has failed is done again.
        common: CellSettings that replace those of all cells, as `engine="c"`, `episodes=5`.

    Raises:
        UsageError: Something that is not allowed; says what is.
        WriteError: The folder cannot be written to.
    """
    from usarmjx.sweeps.table import as_frame

    if isinstance(what, Mapping):
        spec = read_spec(what, common=common)
    else:
        spec = load_spec(find_spec(str(what)), common)
    return as_frame(run_sweep(spec, Path(folder), workers, retry=retry))
