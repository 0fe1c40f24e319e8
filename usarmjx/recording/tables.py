"""Recordings as tables: CSV by the standard library, Parquet where pyarrow is installed."""

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.recording.inputs import RobotRedescribed, RobotRemoved
from usarmjx.recording.reader import RecordedMessage, Recording
from usarmjx.view.drawing import Drawing, Frame

SUFFIXES = (".csv", ".parquet")
"""Suffixes of table files."""
COLUMNS = {
    "poses": (
        *("time", "world", "robot", "x", "y", "z", "qw", "qx", "qy", "qz"),
        *("vx", "vy", "vz", "wx", "wy", "wz", "battery"),
    ),
    "joints": ("time", "world", "robot", "joint", "position"),
    "commands": ("time", "world", "slot", "what", "index", "value"),
    "readings": ("time", "world", "robot", "sensor", "name", "index", "value"),
    "lines": ("time", "world", "robot", "peer", "sent", "text"),
    "events": ("time", "world", "kind", "robot", "text"),
    "scores": ("time", "world", "score"),
}
"""The tables and their columns; lengths in metres, angles in radians, times in seconds."""
TableRow = tuple[Any, ...]
_LINE_END = re.compile(r"[\r\n]+")


def rows_of(recording: Recording, table: str) -> Iterator[TableRow]:
    """Yield the rows of a table.

    Args:
        recording: The recording.
        table: One of `COLUMNS`.

    Raises:
        UsageError: There is no such table, or the file is broken.
    """
    if table not in COLUMNS:
        raise UsageError(f"no table {table!r}; known: {', '.join(COLUMNS)}")
    if table == "lines":
        yield from _line_rows(recording)
        return
    kinds = {"poses": "frames", "joints": "frames", "commands": "inputs", "scores": "score"}
    more = {"drawings", "inputs"} if table == "readings" else {"drawings"}
    drawings: dict[int, Drawing] = {}
    for message in recording.messages({kinds.get(table, table), *more}):
        world, content = message.channel.world, message.value
        if message.channel.kind == "drawings":
            drawings[world] = content
        elif table == "readings" and message.channel.kind == "inputs":
            # The slot may be another robot's before the next drawing.
            if isinstance(content, (RobotRemoved, RobotRedescribed)) and world in drawings:
                drawings[world] = _without(drawings[world], content.slot)
        else:
            yield from _rows(table, message, drawings.get(world))


def _without(drawing: Drawing, slot: int) -> Drawing:
    return replace(drawing, robots={key: robot for key, robot in drawing.robots.items() if key != slot})


def _rows(table: str, message: RecordedMessage, drawing: Drawing | None) -> Iterator[TableRow]:
    # Further digits are rounding errors of the sum of periods.
    time, world, content = round(message.time, 6), message.channel.world, message.value
    if table == "commands":
        for slot, order in getattr(content, "orders", {}).items():
            command = order.get("command")
            for what in ("target", "mode", "setpoint") if command is not None else ():
                for index, value in enumerate(np.asarray(getattr(command, what)).tolist()):
                    yield time, world, slot, what, index, value
    elif table == "events":
        yield time, world, content["kind"], content["robot"], content["text"]
    elif table == "scores":
        yield time, world, content["score"]
    elif drawing is not None and table == "readings":
        yield from _reading_rows(time, world, content, drawing)
    elif drawing is not None:
        yield from _frame_rows(table, (time, world), content, drawing)


def _line_rows(recording: Recording) -> Iterator[TableRow]:
    """Yield a row for each line of the protocol: one message may have many lines, or a part of one."""
    begun: dict[TableRow, tuple[TableRow, str]] = {}
    for message in recording.messages({"lines"}):
        content, world = message.value, message.channel.world
        # Each direction of each connection is a stream of its own: parts of lines join within it only.
        who = (world, content["peer"], content["sent"])
        row = (round(message.time, 6), world, content["robot"], content["peer"], content["sent"])
        *whole, rest = _LINE_END.split(begun.pop(who, (row, ""))[1] + content["text"])
        yield from ((*row, line) for line in whole if line)
        if rest:
            begun[who] = row, rest
    # A recording may end in the middle of a line: its part is a row, too.
    yield from ((*row, rest) for row, rest in begun.values())


def _frame_rows(table: str, when: tuple[float, int], frame: Frame, drawing: Drawing) -> Iterator[TableRow]:
    for slot, robot in frame.robots.items():
        drawn = drawing.robots[slot]
        if table == "joints":
            for joint, position in zip(drawn.joints, robot.joint_pos.tolist(), strict=True):
                yield *when, drawn.name, joint, position
        else:
            numbers = np.concatenate([robot.pos, robot.quat, robot.linear, robot.angular]).tolist()
            yield *when, drawn.name, *numbers, robot.battery


def _reading_rows(time: float, world: int, content: dict[str, Any], drawing: Drawing) -> Iterator[TableRow]:
    slots, sensors = cast(tuple[int, ...], content["slots"]), cast(tuple[int, ...], content["sensors"])
    for slot, sensor, value in zip(slots, sensors, content["values"], strict=True):
        if slot in drawing.robots:
            robot = drawing.robots[slot]
            mount = robot.sensors[sensor]
            for index, number in enumerate(np.asarray(value).reshape(-1).tolist()):
                yield time, world, robot.name, mount.kind, mount.names[0], index, number


def export_tables(recording: Recording, path: Path, tables: Sequence[str] = ()) -> list[Path]:
    """Write tables beside each other: out.csv becomes out-poses.csv, out-joints.csv and so on.

    Args:
        recording: The recording.
        path: Name of the files; its suffix selects their format.
        tables: Names of the tables; none: all that are not empty.

    Returns:
        The files.

    Raises:
        UsageError: Another suffix, no such table, or pyarrow is missing.
        WriteError: A file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"{path}: tables end in {', '.join(SUFFIXES)}")
    write = _write_csv if path.suffix.lower() == ".csv" else _parquet_writer()
    written: list[Path] = []
    for table in tables or COLUMNS:
        rows = rows_of(recording, table)
        # A file is begun only for a table that has rows.
        first = next(rows, None)
        # A table that is asked for by name is written even without rows.
        if first is None and not tables:
            continue
        file = path.with_name(f"{path.stem}-{table}{path.suffix}")
        with atomic_write(file) as fresh:
            write(fresh, COLUMNS[table], _with_first(first, rows))
        written.append(file)
    return written


def _with_first(first: TableRow | None, rest: Iterator[TableRow]) -> Iterator[TableRow]:
    if first is not None:
        yield first
    yield from rest


def _write_csv(path: Path, columns: Sequence[str], rows: Iterator[TableRow]) -> None:
    # `csv` writes the ends of lines itself.
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(rows)


def _parquet_writer() -> Any:  # noqa: ANN401 - a function like `_write_csv`
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise UsageError("Parquet needs pyarrow: pip install pyarrow; or write .csv") from error

    def write(path: Path, columns: Sequence[str], rows: Iterator[TableRow]) -> None:
        # Without rows there are no columns to turn them into.
        values = [*zip(*rows, strict=True)] or [() for _ in columns]
        table = pyarrow.table({name: [*column] for name, column in zip(columns, values, strict=True)})
        pyarrow.parquet.write_table(table, path)

    return write
