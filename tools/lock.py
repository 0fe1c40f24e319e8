"""Hashes and licences of all packages that an image installs, from pip's report of a dry run.

    python3.12 -m pip install --dry-run --ignore-installed --report report.json -c constraints.txt .
    python3 -m tools.lock report.json

for the image for a CPU; with `".[cuda,train]"` in place of `.` for that for CUDA. Reports of pip 23 lack most
licences.

The file has no address of an index; pip compares the hash of each package that it downloads. Hashes are of
the wheels for one Python and one machine, which the name of the file says. The licences are those that the
packages state, in a file beside it.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from packaging.utils import canonicalize_name

from tools.dependencies import licence_names, stated_licences

ROOT = Path(__file__).resolve().parents[1]
PRODUCT = "usarmjx"
HEAD = "# Made by tools/lock.py, which says how: `pip install --require-hashes --no-deps -r` this file.\n"


def lock_file(report: dict[str, Any]) -> Path:
    """Return the file for the image and the environment of a report."""
    environment = report["environment"]
    asked = next((one for one in report["install"] if one["metadata"]["name"] == PRODUCT), {})
    image = "cuda" if "cuda" in asked.get("requested_extras", ()) else "cpu"
    where = f"{environment['python_version']}-{environment['sys_platform']}-{environment['platform_machine']}"
    return ROOT / "locks" / f"{image}-{where}.txt"


def lock_text(report: dict[str, Any]) -> str:
    """Return the lines of a lock: name, version and hash of each package but our own.

    Raises:
        ValueError: A package has no hash; names it.
    """
    lines: list[str] = []
    for one in report["install"]:
        name = canonicalize_name(one["metadata"]["name"])
        if name == PRODUCT:
            continue
        digest = one["download_info"].get("archive_info", {}).get("hashes", {}).get("sha256")
        if digest is None:
            raise ValueError(f"{name} has no sha256 in the report")
        lines.append(f"{name}=={one['metadata']['version']} --hash=sha256:{digest}\n")
    return HEAD + "".join(sorted(lines))


def licences_file(lock: Path) -> Path:
    """Return the file of licences beside a lock."""
    return lock.with_suffix(".licences.tsv")


def licences_text(report: dict[str, Any]) -> str:
    """Return lines with name, version and licence of each package but our own, tabs between them.

    Raises:
        ValueError: A package states no licence; names it.
    """
    lines: list[str] = []
    for one in report["install"]:
        about = one["metadata"]
        name = canonicalize_name(about["name"])
        if name == PRODUCT:
            continue
        found = licence_names(stated_licences(about))
        if not found:
            raise ValueError(f"{name} states no licence in the report")
        lines.append(f"{name}\t{about['version']}\t{found}\n")
    return "".join(sorted(lines))


def main(args: Sequence[str]) -> int:
    """Write the lock of a report, and the licences."""
    if len(args) != 1:
        sys.stderr.write("lock: expected one argument, the report of pip\n")
        return 2
    report = json.loads(Path(args[0]).read_text(encoding="utf-8"))
    file = lock_file(report)
    file.parent.mkdir(exist_ok=True)
    file.write_text(lock_text(report), encoding="utf-8")
    licences_file(file).write_text(licences_text(report), encoding="utf-8")
    print(file.relative_to(ROOT))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
