"""A sweep's folder: `sweep.json` says which cells it has, `cells/KEY.json` holds one finished or failed cell.

A cell's file is written beside its place and renamed, so it is whole or not there; its name is a hash of its
settings, so a changed sweep finds what it has in common with the one before.
"""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write, writing

FORMAT = 1
SWEEP_FILE, CELLS = "sweep.json", "cells"


@dataclass(frozen=True, kw_only=True)
class CellRecord:
    """What is kept of a cell.

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
        about: What it asks.
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


def write_sweep(  # noqa: PLR0913 - what a sweep is
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
        fresh.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    with writing(folder / CELLS):
        (folder / CELLS).mkdir(exist_ok=True)


def write_cell(folder: Path, record: CellRecord) -> None:
    """Keep a cell.

    Raises:
        WriteError: It cannot be written.
    """
    with atomic_write(folder / CELLS / f"{record.key}.json") as fresh:
        fresh.write_text(json.dumps(asdict(record), default=str) + "\n", encoding="utf-8")


def read_cell(folder: Path, key: str) -> CellRecord | None:
    """Return what is kept of a cell; None: nothing, or nothing that reads."""
    try:
        content = json.loads((folder / CELLS / f"{key}.json").read_text(encoding="utf-8"))
        return CellRecord(**{**content, **_tuples(content)})
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _tuples(content: Mapping[str, Any]) -> dict[str, Any]:
    rows = {name: tuple(content.get(name, ())) for name in ("scores", "steps", "bad", "buildings")}
    return {**rows, "metrics": {name: tuple(values) for name, values in content["metrics"].items()}}


def read_sweep(folder: Path) -> StoredSweep:
    """Return the sweep in a folder.

    Raises:
        UsageError: There is none.
    """
    path = Path(folder) / SWEEP_FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        keys = tuple(str(key) for key in content["cells"])
        found = [read_cell(Path(folder), key) for key in keys]
        return StoredSweep(
            name=content["name"],
            about=content["about"],
            axes=tuple(content["axes"]),
            keys=keys,
            sampled=content.get("sampled", {}),
            normalise=content.get("normalise", {}),
            records=tuple(one for one in found if one is not None),
        )
    except OSError as error:
        raise UsageError(f"{folder} holds no sweep: {SWEEP_FILE}: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UsageError(f"{path} is broken: {error}") from error
