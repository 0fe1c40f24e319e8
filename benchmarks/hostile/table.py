"""The table of docs/security.md: the worst of the attacks on each port, from records."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

PORT_NAMES = {
    "": "none",
    "robots": "robots",
    "wireless-a": "radio, dialect A",
    "wireless-b": "radio, dialect B",
    "positions": "positions",
    "images": "pictures",
    "rosbridge": "rosbridge",
    "page": "live page",
    "metrics": "figures",
    "dds": "ROS 2, DDS",
    "any": "all",
}
"""Names of the ports in the table, in its order."""
HEAD = """| port | attacks | longest wait [s] | in | most processor time [s] | in |
|---|---|---|---|---|---|"""


def read_records(path: Path) -> list[dict[str, Any]]:
    """Return the records of a file."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def worst_table(records: Sequence[Mapping[str, Any]]) -> str:
    """Return the worst wait and processor time of the attacks on each port, as Markdown."""
    rows: list[str] = []
    for port, name in PORT_NAMES.items():
        own = [record for record in records if record["port"] == port]
        if own:
            cells = [name, str(len(own))]
            for figure in ("gap", "processor"):
                worst = max(own, key=lambda record, figure=figure: record[figure])
                cells += [f"{worst[figure]:.2f}", f"`{worst['attack']}`"]
            rows.append(f"| {' | '.join(cells)} |")
    return "\n".join([HEAD, *rows])
