"""A sweep's folder: `sweep.json` lists its cells, `cells/KEY.json` holds one finished or failed cell.

A cell's file is written beside its place and renamed, so it is whole or not there; its name is a hash of its
settings, so a changed sweep finds what it has in common with the one before. Both files carry a checksum; a
cell that is damaged, or that stands in the place of another, counts as none.
"""

import logging
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from usarmjx.base.errors import SpecError, UsageError
from usarmjx.base.files import atomic_write, writing
from usarmjx.base.settings import default_reader
from usarmjx.base.settings.json_file import NotWholeError, kept_text, read_kept
from usarmjx.sweeps.spec import rename_keys, rename_policy, rename_tasks
from usarmjx.train.task_names import recorded_name

log = logging.getLogger(__name__)

FORMAT = 1
MOST_CELL_BYTES = 64_000_000
"""Largest file of a cell: a million episodes."""
MOST_SWEEP_BYTES = 64_000_000
"""Largest `sweep.json`: a million keys."""
WRITERS = 8
"""Number of threads that write files of cells."""
SWEEP_FILE, CELLS = "sweep.json", "cells"


@dataclass(frozen=True, kw_only=True)
class CellRecord:
    """Record of a cell.

    Attributes:
        key: Hash of its settings.
        settings: All that were in force.
        engine: The physics engine that it ran on.
        scores: Final scores (episodes,).
        steps: Steps of the episodes (episodes,).
        bad: Episodes whose physics went wrong (episodes,).
        metrics: The task's metrics at their ends, by name (episodes,).
        split: Split of its arenas; empty: they are not generated.
        buildings: Name and hash of the building of each episode; empty: all have the same (episodes,).
        strata: Number of levels and sizes that the buildings of episodes have in turn.
        note: Warning about the result: the policy was trained in buildings that it played.
        seconds: Its share of the time that its batch took [s].
        compile_seconds: Its share of the time that JAX compiled for its batch [s].
        agents: Robots that act in each world; 0: not known.
        versions: Of what computed it.
        failed: Why there is no result; None: there is one.
    """

    key: str
    settings: dict[str, Any]
    engine: str = ""
    scores: tuple[float, ...] = ()
    steps: tuple[int, ...] = ()
    bad: tuple[bool, ...] = ()
    metrics: dict[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    split: str = ""
    buildings: tuple[str, ...] = ()
    strata: int = 1
    note: str = ""
    seconds: float = 0.0
    compile_seconds: float = 0.0
    agents: int = 0
    versions: dict[str, str] = field(default_factory=dict[str, str])
    failed: str | None = None

    @property
    def good(self) -> list[int]:
        """The episodes whose physics went well, by number."""
        return [number for number, bad in enumerate(self.bad) if not bad]


@dataclass(frozen=True, kw_only=True)
class StoredSweep:
    """A sweep as its folder has it.

    Attributes:
        name: Of its file.
        about: Its question.
        axes: Settings that differ between cells.
        sampled: Lowest and highest number of each setting that was sampled.
        normalise: Policies or scores that count as 0 and as 1, see `SweepFile`.
        keys: Of all cells.
        records: Those that are finished or have failed, in the order of the sweep.
    """

    name: str
    about: str
    axes: tuple[str, ...]
    keys: tuple[str, ...]
    records: tuple[CellRecord, ...]
    sampled: Mapping[str, Sequence[float]] = field(default_factory=dict[str, Sequence[float]])
    normalise: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @property
    def finished(self) -> list[CellRecord]:
        """The cells that have a result."""
        return [record for record in self.records if record.failed is None]


@dataclass(frozen=True, kw_only=True)
class _SweepContent:
    """Content of `sweep.json`."""

    format: int
    name: str
    about: str
    axes: tuple[str, ...]
    cells: tuple[str, ...]
    begun: str = ""
    sampled: Mapping[str, Any] = field(default_factory=dict[str, Any])
    normalise: Mapping[str, Any] = field(default_factory=dict[str, Any])


def write_sweep(
    folder: Path,
    name: str,
    about: str,
    axes: Sequence[str],
    keys: Sequence[str],
    sampled: Mapping[str, Sequence[float]] | None = None,
    normalise: Mapping[str, Any] | None = None,
) -> None:
    """Say which cells the sweep in a folder has; see `StoredSweep`.

    Raises:
        WriteError: It cannot be written.
    """
    content = {"format": FORMAT, "name": name, "about": about, "axes": [*axes], "cells": [*keys]}
    content |= {"sampled": dict(sampled or {}), "normalise": dict(normalise or {})}
    content["begun"] = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    with atomic_write(folder / SWEEP_FILE) as fresh:
        fresh.write_text(kept_text(content), encoding="utf-8")
    with writing(folder / CELLS):
        (folder / CELLS).mkdir(exist_ok=True)


def write_cell(folder: Path, record: CellRecord) -> None:
    """Keep a cell.

    Raises:
        WriteError: It cannot be written.
    """
    content = {one.name: getattr(record, one.name) for one in fields(record)}  # `asdict` copies each number
    with atomic_write(folder / CELLS / f"{record.key}.json") as fresh:
        # With an indent each number of a row would have a line of its own.
        fresh.write_text(kept_text(content, indent=None), encoding="utf-8")


def write_cells(folder: Path, records: Sequence[CellRecord]) -> None:
    """Write cells, several at a time, because a disk takes long to confirm each file.

    Raises:
        WriteError: A cell cannot be written; the others are.
    """
    if len(records) < 2:
        for record in records:
            write_cell(folder, record)
        return
    with ThreadPoolExecutor(WRITERS) as pool:
        for kept in [pool.submit(write_cell, folder, record) for record in records]:
            # Only raises: all files are submitted already, and the others are written whatever happens to
            # one.
            kept.result()


def read_cell(folder: Path, key: str) -> CellRecord | None:
    """Return the record of a cell; None: there is none, or, with a warning, none that is whole."""
    file = folder / CELLS / f"{key}.json"
    if not file.exists():
        return None
    try:
        # Cells that earlier versions kept have no checksum.
        record = _record(file, read_kept(file, needs_checksum=False, most=MOST_CELL_BYTES))
        # A copied or renamed file must not pass as the result of other settings.
        if record.key != key:
            raise NotWholeError(f"{file}: is the result of another cell, {record.key[:40]}")
    except SpecError as error:
        log.warning("%s; the cell counts as not played", error)
        return None
    return record


def _record(file: Path, content: Mapping[str, Any]) -> CellRecord:
    """Return the record of a file's content.

    Raises:
        NotWholeError: Something is missing, unknown or of another type.
    """
    try:
        numbers: dict[str, Any] = {
            "scores": tuple(map(float, content["scores"])),
            "steps": tuple(map(int, content["steps"])),
            "bad": tuple(map(bool, content["bad"])),
            "buildings": tuple(map(str, content.get("buildings", ()))),
            "metrics": {name: tuple(map(float, row)) for name, row in content["metrics"].items()},
        }
        record = CellRecord(**{**content, **numbers})
        if "policy" in record.settings.keys():  # noqa: SIM118 - a mapping, or none that is whole
            record.settings["policy"] = rename_policy(record.settings["policy"])
        # Cells that were kept before a task was renamed have its name of that time.
        record = replace(record, settings=rename_tasks(record.settings, recorded_name))
        rows: list[tuple[Any, ...]] = [record.steps, record.bad, *record.metrics.values()]
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError) as error:
        # Cut, as a damaged file may hold anything.
        raise NotWholeError(f"{file}: is no result of a cell: {error!r}"[:300]) from error
    # Empty where all episodes have the same building: then there is no row to compare.
    if record.buildings:
        rows.append(record.buildings)
    if any(len(row) != len(record.scores) for row in rows):
        raise NotWholeError(f"{file}: its rows have different numbers of episodes")
    return record


def read_sweep(folder: Path) -> StoredSweep:
    """Return the sweep in a folder.

    Raises:
        UsageError: There is none.
    """
    path = Path(folder) / SWEEP_FILE
    if not path.is_file():
        raise UsageError(f"{folder} holds no sweep: it has no {SWEEP_FILE}")
    file = default_reader().from_data(
        _SweepContent, read_kept(path, needs_checksum=False, most=MOST_SWEEP_BYTES), where=str(path)
    )
    found = [read_cell(Path(folder), key) for key in file.cells]
    return StoredSweep(
        name=file.name,
        about=file.about,
        axes=file.axes,
        keys=file.cells,
        sampled=file.sampled,
        normalise={name: rename_keys(one, recorded_name) for name, one in file.normalise.items()},
        records=tuple(one for one in found if one is not None),
    )
