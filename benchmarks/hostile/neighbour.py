"""A robot beside the attacks, in its own process: it answers each line of input with its measurements.

python -m benchmarks.hostile.neighbour PORT PID
"""

import json
import os
import select
import socket
import sys
import time
from pathlib import Path

from benchmarks.hostile.frames import init_line
from benchmarks.hostile.meter import GapMeter

NANOSECONDS = 1e9
DRIVE = (b"DRIVE {Left 0.2} {Right 0.2}\r\n", b"DRIVE {Left -0.2} {Right -0.2}\r\n")
RECONNECT = 0.5  # s


def processor_time(pid: int) -> tuple[float, float]:
    """Return the time on a processor of a process' first thread and of all its threads [s]."""
    folder = Path(f"/proc/{pid}")
    words = (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    process = (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
    first = folder / "task" / str(pid)
    try:
        return int((first / "schedstat").read_text(encoding="utf-8").split()[0]) / NANOSECONDS, process
    except OSError:
        words = (first / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK"), process


def join(port: int, name: str) -> socket.socket:
    """Return a connection on which INIT has been sent."""
    made = socket.create_connection(("127.0.0.1", port), timeout=5.0)
    made.sendall(init_line(name))
    return made


def serve_laps(port: int, pid: int) -> None:
    """Drive to and fro, read all reports, and write a lap for each line of standard input, until it ends."""
    meter, turn, drive_at, number = GapMeter(), 0, 0.0, 0
    link = join(port, "Neighbour")
    while True:
        ready, _, _ = select.select([link, sys.stdin], [], [], 0.5)
        now = time.monotonic()
        if link in ready:
            try:
                data = link.recv(1 << 20)
            except OSError:
                data = b""
            if not data:
                meter.lap.lost += 1
                number += 1
                meter.forget()
                time.sleep(RECONNECT)
                link.close()
                link = join(port, f"Neighbour{number}")
                continue
            meter.feed(data, now, *processor_time(pid))
        if sys.stdin in ready:
            if not sys.stdin.readline():
                return
            print(json.dumps(meter.finish(now, *processor_time(pid))), flush=True)
        if now > drive_at:
            link.sendall(DRIVE[turn % 2])
            turn, drive_at = turn + 1, now + 1.0


if __name__ == "__main__":
    serve_laps(int(sys.argv[1]), int(sys.argv[2]))
