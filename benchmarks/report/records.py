"""Records of all benchmarks, as read from files: those of today and those of older versions."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.tools import FORM
from usarmjx.base.errors import UsageError

NEEDED = ("benchmark", "when", "device", "commit")
"""What every record has had since the first one."""


@dataclass(frozen=True)
class BenchRecord:
    """A line of a file of records.

    Attributes:
        file: Its file's name.
        data: Its text.
    """

    file: str
    data: Mapping[str, Any]

    @property
    def benchmark(self) -> str:
        """Which benchmark it is of."""
        return self.data["benchmark"]

    @property
    def when(self) -> str:
        """The minute, UTC."""
        return self.data["when"][:16].replace("T", " ")

    @property
    def where(self) -> str:
        """Machine: the accelerator, or the processor and how many cores were to be had."""
        hardware = self.data.get("hardware")
        if hardware is None or hardware["accelerator"] == self.data["device"]:
            return self.data["device"]
        return f"{hardware['processor']}, {hardware['cores']} cores"

    @property
    def case(self) -> Mapping[str, Any]:
        """Measurements."""
        return self.data.get("case", {})

    @property
    def roster(self) -> str:
        """The robots of each world, as `P2AT:4`."""
        case = self.case
        if "roster" in case:
            return case["roster"]
        return f"{case.get('robot', 'P2AT')}:{case.get('robots', 1)}"


def read_records(folder: Path) -> list[BenchRecord]:
    """Return all records of a folder, oldest first.

    Raises:
        UsageError: No such folder, or a line that is no record; names file and line.
    """
    files = sorted(folder.glob("*.jsonl"))
    if not files:
        raise UsageError(f"{folder} has no records: *.jsonl")
    found = [record for file in files for record in _records_of(file)]
    return sorted(found, key=lambda record: record.data["when"])


def _records_of(file: Path) -> list[BenchRecord]:
    found = []
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        try:
            data = json.loads(line)
        except json.JSONDecodeError as error:
            raise UsageError(f"{file}, line {number}: {error}") from error
        lacking = [name for name in NEEDED if name not in data]
        if lacking:
            raise UsageError(f"{file}, line {number}: has no {lacking[0]!r}")
        if data.get("form", FORM) > FORM:
            raise UsageError(f"{file}, line {number}: form {data['form']}, which is newer than {FORM}")
        found.append(BenchRecord(file.name, data))
    return found
