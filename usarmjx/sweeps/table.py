"""Results as a table: a row for each cell, or for each episode; CSV, Parquet, pandas."""

import csv
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import interquartile_mean
from usarmjx.base.files import atomic_write
from usarmjx.sweeps.design import episodes_of, mean_score
from usarmjx.sweeps.spec import as_text
from usarmjx.sweeps.store import CellRecord, StoredSweep

SUFFIXES = (".csv", ".parquet")
TableRecord = dict[str, Any]


def cell_rows(found: StoredSweep) -> list[TableRecord]:
    """Return a row for each cell: settings, score with interval, means of the metrics, what went wrong."""
    return [_cell_row(record) for record in found.records]


def _cell_row(record: CellRecord) -> TableRecord:
    row = {name: _plain(value) for name, value in record.settings.items()}
    good = record.good
    row |= {"cell": record.key, "failed": record.failed or ""}
    score = mean_score(episodes_of([record], {}))
    middle = interquartile_mean(scores_of(record)) if good else np.nan
    row |= {"score": score.value, "low": score.low, "high": score.high, "interquartile_mean": float(middle)}
    row |= {"split": record.split, "buildings": score.drawn("buildings")}
    row |= {"good": len(good), "bad": len(record.bad) - len(good), "seconds": record.seconds}
    for name, values in record.metrics.items():
        row[f"metric.{name}"] = float(np.mean(np.array(values)[good])) if good else np.nan
    return row


def episode_rows(found: StoredSweep) -> list[TableRecord]:
    """Return a row for each episode of each finished cell."""
    rows: list[TableRecord] = []
    for record in found.finished:
        settings = {name: _plain(value) for name, value in record.settings.items()}
        for number, score in enumerate(record.scores):
            metrics = {f"metric.{name}": values[number] for name, values in record.metrics.items()}
            rows.append(
                {
                    **settings,
                    "cell": record.key,
                    "episode": number,
                    "split": record.split,
                    "building": record.buildings[number] if record.buildings else "",
                    "score": score,
                    "steps": record.steps[number],
                    "bad": record.bad[number],
                    **metrics,
                }
            )
    return rows


def _plain(value: object) -> object:
    return value if isinstance(value, str | int | float | bool) else as_text(value)


def scores_of(record: CellRecord) -> np.ndarray:
    """Return the scores of a cell's good episodes (n,)."""
    return np.array([record.scores[number] for number in record.good], float)


def as_frame(found: StoredSweep) -> Any:  # noqa: ANN401 - pandas' DataFrame, or rows
    """Return `cell_rows` as pandas' DataFrame where that is installed, else as they are."""
    rows = cell_rows(found)
    try:
        import pandas as pd  # pyright: ignore[reportMissingTypeStubs]
    except ImportError:
        return rows
    return pd.DataFrame(rows)


def check_table(path: Path) -> None:
    """Refuse a file that `export_rows` cannot write.

    Raises:
        UsageError: Another suffix, or pyarrow is missing.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"{path}: tables end in {', '.join(SUFFIXES)}")
    # The command line checks before hours of play, so a missing package shows by then.
    if path.suffix.lower() != ".csv":
        _parquet_writer()


def export_rows(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write rows as CSV, or as Parquet where pyarrow is installed.

    Raises:
        UsageError: Another suffix, or pyarrow is missing.
        WriteError: The file cannot be written.
    """
    path = Path(path)
    check_table(path)
    write = _write_csv if path.suffix.lower() == ".csv" else _parquet_writer()
    # Tasks have columns of their own: the table has all of them, in the order in which they come.
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with atomic_write(path) as fresh:
        write(fresh, columns, rows)


def _write_csv(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    # `csv` writes the ends of lines itself.
    with path.open("w", newline="", encoding="utf-8") as file:
        # Cells of other tasks lack some columns.
        writer = csv.DictWriter(file, columns, restval="")
        writer.writeheader()
        writer.writerows(rows)


def _parquet_writer() -> Callable[[Path, Sequence[str], Sequence[Mapping[str, Any]]], None]:
    try:
        import pyarrow  # pyright: ignore[reportMissingImports]
        import pyarrow.parquet  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise UsageError("Parquet needs pyarrow: pip install pyarrow; or write .csv") from error

    def write(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
        # A setting may be a number in one cell and a range in another: such a column is text.
        table: dict[str, list[Any]] = {}
        for name in columns:
            values = [row.get(name) for row in rows]
            kinds: set[type] = {type(value) for value in values if value is not None}
            mixed = len(kinds) > 1 and not kinds <= {int, float}
            table[name] = [None if v is None else str(v) if mixed else v for v in values]
        pyarrow.parquet.write_table(pyarrow.table(table), path)

    return write
