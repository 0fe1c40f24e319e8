"""The record of a run of ours and others: whole in its file after each row, and as a table for people."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from usarmjx.bench.peering.peers import ON_HOST
from usarmjx.bench.tools import append_record, rewrite_record

OURS = "usarmjx"
"""Who we are in a record's rows."""
UNFINISHED, INTERRUPTED = (f"{what}: what came later is not here" for what in ("not finished", "interrupted"))


class GrowingRecord:
    """A record that gets rows, and is written anew with each: what ends the run leaves those that there are.

    Args:
        header: Its first entries, of `tools.record_header`.
        case: What is measured.
        file: Of records; None: it is in none. What is no file, such as a pipe, gets it when it is finished.

    Attributes:
        rows: What was measured by now.
    """

    def __init__(self, header: Mapping[str, Any], case: Mapping[str, Any], file: Path | None) -> None:
        self.rows: list[dict[str, Any]] = []
        self._header, self._case, self._file = header, case, file
        self._rewritten = file is not None and (file.is_file() or not file.exists())
        self._line = b""

    def add(self, row: dict[str, Any]) -> None:
        """Add a row.

        Raises:
            WriteError: The file has the rows before.
        """
        self.rows.append(row)
        if self._file is not None and self._rewritten:
            self._line = rewrite_record(self._record(UNFINISHED), self._file, self._line)

    def finish(self, note: str = "") -> dict[str, Any]:
        """Write it for the last time and return it.

        Args:
            note: What a reader must know beside what the header says.

        Raises:
            WriteError: The file has it as it was after the last row.
        """
        record = self._record(note)
        if self._file is not None and self._rewritten:
            self._line = rewrite_record(record, self._file, self._line)
        else:
            append_record(record, self._file)
        return record

    def _record(self, note: str) -> dict[str, Any]:
        return {
            **self._header,
            "note": "; ".join(filter(None, [self._header["note"], note])),
            "case": self._case,
            "scene": None,
            "rates": {
                f"{row['who']}, {row['variant']}, {row['worlds']} x {row['robots']}": row["speed"]
                for row in self.rows
                if "speed" in row
            },
            "baselines": {
                "mujoco_rollout": {"missing": "among the rows"},
                "bare_mjx": {"missing": "among the rows: the part `bare` of engine jax or warp"},
            },
            "in_the_step": "told in each row",
            "rows": self.rows,
        }


def device_of(row: Mapping[str, Any]) -> str:
    """Return what a row was measured on, `host` for any processor; a dash where nothing ran."""
    device = row.get("device", "-")
    return "host" if device in ON_HOST else device


def devices_differ(rows: Sequence[Mapping[str, Any]]) -> bool:
    """Whether rows were measured on several devices."""
    return len({device_of(row) for row in rows if "device" in row}) > 1


def outcome(row: Mapping[str, Any]) -> str:
    """Return a row's rate and device for people, or why there is none."""
    return row.get("missing") or f"{row['robot_steps_per_s']:,.0f} robot-steps/s on {row['device']}"


def summary(record: Mapping[str, Any]) -> str:
    """Return the rows as a table for people."""
    lines = [
        f"on {record['device']}, {record['hardware']['cores']} cores",
        f"{'':44} {'worlds x robots':>15} {'robot-steps/s':>15} {'simulated s/s':>14}",
    ]
    differ = devices_differ(record["rows"])
    for row in record["rows"]:
        who, size = f"{row['who']}, {row['variant']}", f"{row['worlds']} x {row['robots']}"
        where = f"  {device_of(row)}" if differ else ""
        figures = row.get("missing") or (
            f"{row['robot_steps_per_s']:15,.0f} {row['robot_seconds_per_s']:14,.0f}{where}"
        )
        lines.append(f"{who:44} {size:>15} {figures}")
    return "\n".join(lines)
