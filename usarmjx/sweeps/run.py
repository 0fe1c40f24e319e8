"""A sweep from its file to its results: plan, play what is missing, keep each cell."""

import hashlib
import sys
from collections.abc import Callable, Hashable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from usarmjx.base.errors import UsageError, quoted
from usarmjx.base.installation import install_command
from usarmjx.engines import choose_engine
from usarmjx.sweeps.contents import KnownDigests, key_of
from usarmjx.sweeps.play import BatchWork, failure, forget_resolved, halves, play_batch, resolved
from usarmjx.sweeps.progress import SweepProgress
from usarmjx.sweeps.resolve import signature_of
from usarmjx.sweeps.spec import CellSettings, SweepSpec, as_text, find_spec, load_spec, read_spec
from usarmjx.sweeps.store import CellRecord, StoredSweep, read_cell, read_sweep, write_cells, write_sweep
from usarmjx.sweeps.table import scores_of
from usarmjx.sweeps.workers import Workers
from usarmjx.train.learning.config import on_gpu
from usarmjx.train.learning.metrics import find_wandb

WORLDS_OF_C, WORLDS_ON_CPU, WORLDS_ON_GPU = 256, 1024, 8192
"""Default limit of worlds in a batch: engine `c`, and the others by JAX's device."""

Signature = Mapping[str, Hashable]
"""Settings that all cells of a batch share, by their names."""


@dataclass(frozen=True, kw_only=True)
class CellGroup:
    """Cells that differ in data only.

    Attributes:
        cells: Their numbers.
        batches: The same in batches, one after the other.
        size: Cells that a batch has room for: the last one's spare places repeat its last cell.
    """

    cells: tuple[int, ...]
    batches: tuple[tuple[int, ...], ...]
    size: int


@dataclass(frozen=True, kw_only=True)
class SweepPlan:
    """Cells that are played together.

    Attributes:
        groups: The groups.
        differing: In what the groups differ, and in how many ways.
    """

    groups: tuple[CellGroup, ...]
    differing: dict[str, int]

    @property
    def batches(self) -> int:
        """Number of batches."""
        return sum(len(group.batches) for group in self.groups)

    def as_text(self) -> str:
        """Return the numbers of batches and cells and the reason for them, in a line."""
        cells = sum(len(group.cells) for group in self.groups)
        if not self.groups:
            return "no cells to play"
        sizes = sorted({len(batch) for group in self.groups for batch in group.batches})
        each = f"{sizes[0]}" if len(sizes) == 1 else f"{sizes[0]} to {sizes[-1]}"
        said = f"{_many(cells, 'cell')} in {_many(self.batches, 'batch')} of {each}, "
        # JAX compiles once for each group: all its batches have the same size.
        said += f"{_many(len(self.groups), 'compilation')}"
        if self.differing:
            parts = ", ".join(f"{what} ({count} kinds)" for what, count in self.differing.items())
            return f"{said}: compiled parts differ in {parts}; all else is data"
        return f"{said}: the cells differ in data only"


def _many(count: int, what: str) -> str:
    plural = "es" if what.endswith("ch") else "s"
    return f"{count} {what}{'' if count == 1 else plural}"


def plan_batches(
    signatures: Sequence[Signature],
    episodes: Sequence[int],
    most_worlds: int,
    alone: Sequence[bool] | None = None,
) -> SweepPlan:
    """Return which cells are played together.

    Args:
        signatures: Of each cell (cells,).
        episodes: Of each cell, one world each; those of one signature have as many (cells,).
        most_worlds: Worlds that a batch has at most; a cell that has more is a batch of its own.
        alone: Which cells share a batch with no other (cells,); None: none of them.
    """
    together: dict[Hashable, list[int]] = {}
    for number, signature in enumerate(signatures):
        # A client drives by the clock over its own connections, so its cell cannot share a batch.
        own = number if alone is not None and alone[number] else None
        together.setdefault((own, tuple(signature.items())), []).append(number)
    groups: list[CellGroup] = []
    for cells in together.values():
        # A cell of more worlds than the limit still has a place: it is a batch of its own.
        room = max(1, most_worlds // episodes[cells[0]])
        count = -(-len(cells) // room)
        size = -(-len(cells) // count)  # as even as can be: few places are spare
        rows = tuple(tuple(cells[i : i + size]) for i in range(0, len(cells), size))
        groups.append(CellGroup(cells=tuple(cells), batches=rows, size=size))
    kinds = {name: len({row[name] for row in signatures}) for name in (signatures[0] if signatures else ())}
    return SweepPlan(
        groups=tuple(groups), differing={name: count for name, count in kinds.items() if count > 1}
    )


def usual_stream() -> TextIO:
    """Return the stream of progress: the error stream, so that output holds the results only."""
    return sys.stderr


Sink = Callable[[CellRecord], None]
"""Receives each cell that is finished or has failed."""


def numbers_of(record: CellRecord) -> dict[str, float]:
    """Return the numbers shown of a cell: mean score, means of the metrics, numbers among its settings."""
    good = record.good
    # Of no numbers the mean would be NaN, with a warning of NumPy.
    shown = {"score": float(scores_of(record).mean())} if good else {}
    for name, values in record.metrics.items():
        if good:
            shown[f"metric/{name}"] = float(np.mean([values[number] for number in good]))
    return shown


def tensorboard_sink(folder: Path) -> Sink:
    """Return a sink that writes cells to TensorBoard: step k is the k-th cell that was played.

    Raises:
        UsageError: tensorboardX is missing.
    """
    try:
        from usarmjx.train.learning.tensorboard import TensorBoardLog
    except ImportError as error:
        raise UsageError(f"TensorBoard needs tensorboardX: {install_command('train')}") from error
    board, count = TensorBoardLog(Path(folder), 0), [0]

    def show(record: CellRecord) -> None:
        count[0] += 1
        settings = {
            f"setting/{key}": float(value)
            for key, value in record.settings.items()
            # A bool is an int to Python: a switch would get a curve of zeros and ones.
            if isinstance(value, int | float) and not isinstance(value, bool)
        }
        board.show(count[0], {**settings, **numbers_of(record)})

    return show


def wandb_sink(project: str, name: str) -> Sink:
    """Return a sink that sends cells to Weights & Biases, each as a run of one group.

    Raises:
        UsageError: wandb is missing, or cannot begin.
    """
    module = find_wandb()

    def show(record: CellRecord) -> None:
        config = {key: as_text(value) for key, value in record.settings.items()}
        try:
            # Without its option to begin anew, wandb returns the run of the cell before, which then gets
            # the numbers of both.
            run = module.init(
                project=project, group=name, name=record.key, config=config, reinit="finish_previous"
            )
            run.log(numbers_of(record))
            run.finish(exit_code=0 if record.failed is None else 1)
        except Exception as error:  # of a service elsewhere
            raise UsageError(f"Weights & Biases: {quoted(error)}") from error

    return show


KeyedSettings = tuple[str, dict[str, Any]]
"""Key and settings."""


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """Cells to play.

    Attributes:
        cells: Those that have no result yet.
        known: Number that have one, or have failed before.
        broken: Those that stand for nothing.
        engine: Of each of `cells`.
        buildings: Of each of `cells`, by name and hash.
        plan: The way they are played.
        keys: Of all cells of the sweep.
    """

    cells: tuple[KeyedSettings, ...]
    known: int
    broken: tuple[CellRecord, ...]
    engine: tuple[str, ...]
    buildings: tuple[tuple[str, ...], ...]
    plan: SweepPlan
    keys: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class _Identity:
    """A cell before it is played.

    Attributes:
        key: Its key.
        signature: Settings that all cells of its batch share; None: it stands for nothing.
        fault: Why it stands for nothing.
        alone: Whether it shares a batch with no other.
        buildings: Name and hash of each of its buildings.
    """

    key: str
    signature: Signature | None = None
    fault: str = ""
    alone: bool = False
    buildings: tuple[str, ...] = ()


def _identify(settings: CellSettings, digests: KnownDigests) -> _Identity:
    """Return what is known of a cell before it is played."""
    try:
        cell = resolved(settings)
        return _Identity(
            key=key_of(settings, cell, digests),
            signature=signature_of(cell, settings["engine"]),
            alone=cell.driver.command is not None,
            buildings=cell.labels,
        )
    except UsageError as error:
        # A cell that stands for nothing has no files to hash: its settings alone name it.
        key = hashlib.sha256(repr(sorted(settings.items())).encode()).hexdigest()[:20]
        return _Identity(key=key, fault=str(error))


def parse_part(text: str) -> tuple[int, int]:
    """Return the number of a part, from 1 on, and the number of all parts, of a text as "2/10".

    Raises:
        UsageError: It is none.
    """
    number, slash, count = text.partition("/")
    if not (slash and number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise UsageError(f"--part {text}: expected a number and a count as 2/10, from 1/10 to 10/10")
    return int(number), int(count)


def prepare(spec: SweepSpec, folder: Path, retry: bool = False, part: tuple[int, int] = (1, 1)) -> Prepared:
    """Return the cells of a sweep that its folder has no results of.

    Args:
        spec: The sweep.
        folder: Its folder.
        retry: Whether what has failed is done again.
        part: Number of the part that is played, from 1 on, and the number of parts. Cells are in the same
            part whatever the folder has.

    Raises:
        UsageError: No such engine.
    """
    keys: dict[str, None] = {}
    cells: list[KeyedSettings] = []
    broken: list[CellRecord] = []
    found: list[_Identity] = []
    known, digests = 0, KnownDigests()
    forget_resolved()  # files may have changed since
    (number, count), total = part, len(spec.cells)
    # By places in the whole sweep, not among missing cells: parts on several machines must not overlap.
    mine = range((number - 1) * total // count, number * total // count)
    for place, asked in enumerate(spec.cells):
        settings = {**asked, "engine": choose_engine(str(asked["engine"]), "train")}
        one = _identify(settings, digests)
        # Two spellings of the same settings are one cell.
        if one.key in keys:
            continue
        keys[one.key] = None
        if place not in mine:
            continue
        before = read_cell(folder, one.key)
        if one.signature is None:
            # A broken cell is tried again when its fault reads differently: a name may exist by now.
            if before is not None and before.failed == one.fault and not retry:
                known += 1
            else:
                broken.append(failure(one.key, settings, one.fault))
        elif before is not None and not (retry and before.failed is not None):
            known += 1
        else:
            cells.append((one.key, settings))
            found.append(one)
    engines = tuple(str(settings["engine"]) for _, settings in cells)
    most = spec.worlds or _usual_worlds(engines[0] if engines else "c")
    plan = plan_batches(
        [one.signature for one in found if one.signature is not None],
        [int(settings["episodes"]) for _, settings in cells],
        most,
        [one.alone for one in found],
    )
    return Prepared(
        cells=tuple(cells),
        known=known,
        broken=tuple(broken),
        engine=engines,
        buildings=tuple(one.buildings for one in found),
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
        # Of all cells of the group: what is compiled for it depends on all of their arenas.
        name = hashlib.sha256("".join(prepared.cells[place][0] for place in group.cells).encode())
        # Not all cells of the group with each batch: what is sent would grow as the square of the cells.
        kin: dict[tuple[str, ...], dict[str, Any]] = {}
        for place in group.cells:
            kin.setdefault(prepared.buildings[place], prepared.cells[place][1])
        for batch in group.batches:
            # The engine is part of the signature, so the first cell's is that of the group.
            works.append(
                BatchWork(
                    group=name.hexdigest(),
                    cells=tuple(prepared.cells[place] for place in batch),
                    kin=tuple(kin.values()),
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
        folder: Store of results.
        workers: Place to play it; None: here.
        retry: Whether what has failed is done again.
        say: Receives the plan, in lines.
        stream: Stream of progress; None: none.
        sinks: Receive each cell that is finished or has failed.

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
    # Before the first cell is played: an interrupted sweep can be read as far as it came.
    write_sweep(folder, spec.name, spec.about, spec.axes, prepared.keys, spec.sampled, spec.normalise)
    if prepared.known:
        say(f"{prepared.known} of {len(spec.cells)} cells are there already")
    if prepared.cells:
        say(prepared.plan.as_text())
    works = batches_of(prepared)
    progress = SweepProgress(
        len(prepared.cells) + len(prepared.broken),
        stream,
        compilations=len({work.group for work in works}),
        workers=workers.size(len(works)),
    )
    try:
        with _Keeper(folder, progress, sinks) as keeper:
            keeper.keep(prepared.broken, "")
            # Batches that end workers come back in halves, until the cell that does it is alone.
            while works:
                suspects: list[BatchWork] = []
                for number, records, lost in workers.run(_work(workers, progress, keeper), works):
                    if lost is not None and len(works[number].cells) > 1:
                        suspects += halves(works[number])  # one of its cells ends workers: the others do not
                    else:
                        there = _lost(works[number], lost) if lost is not None else records
                        keeper.keep(there, works[number].group)
                    if workers.place != "here":
                        keeper.settle()  # the worker plays meanwhile
                works = suspects
    finally:
        progress.close()
    # From the folder, which also has the cells of earlier runs.
    return read_sweep(folder)


class _Keeper:
    """Writer of the cells of a batch during the next batch; a cell counts when its file is complete.

    Args:
        folder: Folder of the sweep.
        progress: Counts the cells.
        sinks: Receive each cell.
    """

    def __init__(self, folder: Path, progress: SweepProgress, sinks: Sequence[Sink]) -> None:
        self._folder, self._progress, self._sinks = folder, progress, sinks
        # One thread: batches are written in order, and each starts `WRITERS` threads of its own.
        self._writer = ThreadPoolExecutor(1)
        self._pending: tuple[Future[None], Sequence[CellRecord], str] | None = None
        self._counted = False

    def __enter__(self) -> "_Keeper":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            # After an error `settle` would raise another one in its place.
            if kind is None:
                self.settle()
        finally:
            self._writer.shutdown()  # it completes the files of all played cells first

    def keep(self, records: Sequence[CellRecord], group: str) -> None:
        """Begin to write cells of a group.

        Raises:
            WriteError: The cells before these cannot be written.
        """
        # One batch is pending at most: memory holds no more, and an error shows with the next batch.
        self.settle()
        self._pending = self._writer.submit(write_cells, self._folder, records), records, group

    def count(self) -> None:
        """Count the cells if their files are complete; do not wait. `settle` raises a failure."""
        if self._pending is None or self._counted:
            return
        written, records, group = self._pending
        if written.done() and written.exception() is None:
            failed = sum(record.failed is not None for record in records)
            compiling = sum(record.compile_seconds for record in records)
            self._progress.add(len(records) - failed, failed, group, compiling)
            self._counted = True

    def settle(self) -> None:
        """Wait for the files of the pending cells; count the cells and pass them to the sinks.

        Raises:
            WriteError: A cell could not be written.
        """
        if self._pending is None:
            return
        written, records, _ = self._pending
        written.result()
        self.count()
        self._pending, self._counted = None, False
        for record in records:
            for sink in self._sinks:
                sink(record)


def _work(
    workers: Workers, progress: SweepProgress, keeper: _Keeper
) -> Callable[[BatchWork], list[CellRecord]]:
    """Return the function that plays a batch and reports its progress."""
    if workers.place != "here":
        # Another process imports the function: one that holds the progress could not be sent there.
        return play_batch

    def play(work: BatchWork) -> list[CellRecord]:
        def watch(share: float) -> None:
            # Files of the batch before are complete by now or soon: their cells count without a wait.
            keeper.count()
            progress.within(len(work.cells), share)

        progress.begin(work.group)
        return play_batch(work, watch)

    return play


def _lost(work: BatchWork, reason: str) -> list[CellRecord]:
    return [failure(*cell, reason) for cell in work.cells]


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
        folder: Store of results; what is there already is not played again.
        workers: Place to play it; None: in this process.
        retry: Whether what has failed is done again.
        common: CellSettings that replace those of all cells, as `engine="c"`, `episodes=5`.

    Raises:
        UsageError: A setting that is not allowed; names those that are.
        WriteError: The folder cannot be written to.
    """
    from usarmjx.sweeps.table import as_frame

    if isinstance(what, Mapping):
        spec = read_spec(what, common=common)
    else:
        spec = load_spec(find_spec(str(what)), common)
    return as_frame(run_sweep(spec, Path(folder), workers, retry=retry))
