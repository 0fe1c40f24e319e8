"""A guard that ends processes which this one has started, as soon as this one ends, however that is."""

import os
import subprocess
import sys
from pathlib import Path

GUARD = """
import os, signal, sys
given = [line.split() for line in sys.stdin]
for number, began in given:
    try:
        with open(f"/proc/{number}/stat") as file:
            if file.read().rpartition(")")[2].split()[19] == began:
                os.kill(int(number), signal.SIGKILL)
    except OSError:
        pass
"""
"""Program that ends the processes whose numbers and times of start it is given, as soon as its input ends."""


def children() -> set[str]:
    """Return the processes that this one has started, as numbers and times of start; Linux only."""
    found = set[str]()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        except OSError:
            continue
        if fields[1] == str(os.getpid()):
            found.add(f"{stat.parent.name} {fields[19]}")
    return found


def end_with_this_process(processes: set[str]) -> "subprocess.Popen[bytes] | None":
    """Start a process that ends others if this one ends before it; None: there are none.

    Clients and Ray's own processes stay when the one that started them is killed.

    Args:
        processes: Some of `children`.
    """
    if not processes:
        return None
    guard = subprocess.Popen(
        [sys.executable, "-I", "-c", GUARD], stdin=subprocess.PIPE, start_new_session=True
    )
    assert guard.stdin is not None
    guard.stdin.write("".join(f"{one}\n" for one in sorted(processes)).encode())
    guard.stdin.flush()
    return guard
