"""A server under the attacks of this suite: a table, and records for attacks/hostile.jsonl of the results.

python -m benchmarks.hostile --json benchmarks/results/attacks/hostile.jsonl --note "two cores, loaded"
"""

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.hostile.acts import ROS_DOMAIN
from benchmarks.hostile.attacks import ATTACKS, DATAGRAMS, PORTS
from benchmarks.hostile.frames import init_line
from benchmarks.hostile.stage import HOST, PortAttack, play
from benchmarks.hostile.table import read_records, worst_table
from benchmarks.tools import append_record, record_header
from usarmjx.server.runtime.signals import ParentPipe

LIMIT = 0.25
"""Most time of the server's main thread between two reports of a neighbour, docs/security.md [s]."""
PATIENCE = 60.0  # s, for the server to listen
JOIN = 75.0  # s, for a robot to report; connections without one may keep all seats for 60
PAUSE = 0.7  # s, between two attacks
RETRY = 0.3  # s, until a refused robot tries again
OPTIONS = {
    "robots": "--port",
    "wireless-a": "--wss-port",
    "wireless-b": "--wss2-port",
    "positions": "--position-port",
    "images": "--image-port",
    "page": "--viewer-port",
    "metrics": "--metrics-port",
    "rosbridge": "--rosbridge-port",
}


def free_ports(names: Sequence[str]) -> dict[str, int]:
    """Return a free port for each name."""
    held = [socket.create_server((HOST, 0)) for _ in names]
    found = {name: one.getsockname()[1] for name, one in zip(names, held, strict=True)}
    for one in held:
        one.close()
    return found


def wait_for(ports: dict[str, int], server: subprocess.Popen[bytes]) -> None:
    """Wait until all ports of a server take connections.

    Raises:
        RuntimeError: They do not.
    """
    end, waits = time.monotonic() + PATIENCE, list(ports.values())
    while waits:
        if server.poll() is not None or time.monotonic() > end:
            raise RuntimeError(f"the server does not listen at {waits}")
        try:
            socket.create_connection((HOST, waits[0]), timeout=1.0).close()
            waits.pop(0)
        except OSError:
            time.sleep(0.2)


@contextmanager
def served(log: Path, *, ros2: bool) -> Iterator[tuple[dict[str, int], subprocess.Popen[bytes]]]:
    """Serve the yellow arena with all ports open, and end the server afterwards."""
    ports = free_ports(PORTS)
    command = [sys.executable, "-m", "usarmjx", "serve", "--arena", "yellow", "--engine", "c", "--host", HOST]
    for name, port in ports.items():
        command += [OPTIONS[name], str(port)]
    command += ["--ros2", "--ros2-transport", "dds", "--ros-domain-id", str(ROS_DOMAIN)] if ros2 else []
    with (
        log.open("wb") as out,
        ParentPipe() as pipe,
        subprocess.Popen(
            command, stdout=out, stderr=out, env={**os.environ, **pipe.settings}, pass_fds=pipe.inherited
        ) as server,
    ):
        pipe.started()
        try:
            wait_for(ports, server)
            yield ports, server
        finally:
            server.terminate()


def newcomer(port: int, name: str) -> float | None:
    """Return the time until a new robot gets its first report [s], refusals included; None: too long."""
    began, number = time.monotonic(), 0
    while time.monotonic() < began + JOIN:
        number += 1
        try:
            if report_comes(port, f"{name}x{number}", began + JOIN):
                return round(time.monotonic() - began, 2)
        except OSError:
            pass
        time.sleep(RETRY)
    return None


def report_comes(port: int, name: str, until: float) -> bool:
    """Return whether a new robot reports before its connection is closed.

    Raises:
        OSError: The connection does not come about, breaks off, or lasts past a time.
    """
    got = b""
    with socket.create_connection((HOST, port), timeout=JOIN) as link:
        link.sendall(init_line(name))
        while b"STA " not in got[-100_000:]:
            link.settimeout(max(0.01, until - time.monotonic()))
            data = link.recv(65536)
            if not data:
                return False
            got += data
    return True


class NeighbourWatch:
    """The neighbour's process, and figures of the server's system and log.

    Args:
        ports: Ports of the server.
        server: Its process.
        log: File of its output.
    """

    def __init__(self, ports: dict[str, int], server: subprocess.Popen[bytes], log: Path) -> None:
        command = [
            sys.executable,
            "-m",
            "benchmarks.hostile.neighbour",
            str(ports["robots"]),
            str(server.pid),
        ]
        self._asked = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._log, self._server, self._at = log, server, 0

    def lap(self) -> dict[str, Any]:
        """Return the measurements since the last call.

        Raises:
            RuntimeError: The neighbour has gone.
        """
        if self._asked.stdin is None or self._asked.stdout is None:
            raise RuntimeError("the neighbour has no pipes")
        self._asked.stdin.write(b"\n")
        self._asked.stdin.flush()
        line = self._asked.stdout.readline()
        if not line:
            raise RuntimeError("the neighbour has gone")
        said = self._log.read_bytes()[self._at :]
        self._at += len(said)
        numbers = {"log_bytes": len(said), "tracebacks": said.count(b"Traceback")}
        return {**json.loads(line), **numbers, **self._system()}

    def _system(self) -> dict[str, Any]:
        folder = Path(f"/proc/{self._server.pid}")
        pages = int((folder / "statm").read_text(encoding="utf-8").split()[1])
        return {
            "memory_MB": round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 1),
            "descriptors": len(os.listdir(folder / "fd")),
        }

    def close(self) -> None:
        """End the neighbour."""
        self._asked.terminate()
        self._asked.wait(5.0)


def run_attack(
    attack: PortAttack, ports: dict[str, int], watch: NeighbourWatch, seconds: float, attackers: int
) -> dict[str, Any]:
    """Play an attack beside the neighbour; where connections are held, let another robot join meanwhile."""
    joined: list[float | None] = []
    name = f"New{time.monotonic_ns() % 10**8}"

    def join() -> None:
        time.sleep(seconds / 3)
        joined.append(newcomer(ports["robots"], name))

    beside = threading.Thread(target=join) if attack.name.startswith(("hoard", "quiet")) else None
    watch.lap()
    if beside is not None:
        beside.start()
    stage = play(attack, ports, seconds, attackers)
    figures = watch.lap()
    if beside is not None:
        beside.join()
    time.sleep(PAUSE)
    after = newcomer(ports["robots"], f"{name}b")
    return {
        "attack": attack.name,
        "port": attack.port,
        "sent": stage.sent,
        "connections": stage.connections,
        **{key: round(value, 3) for key, value in figures.items()},
        "newcomer_s": joined[0] if joined else None,
        "after_s": after,
        "case": {"attackers": attack.attackers or attackers, "seconds": seconds, "what": attack.what},
    }


def faults(found: dict[str, Any], *, joins: bool) -> list[str]:
    """Return the limits that an attack broke, a word or two each."""
    wrong = {
        "processor": found["processor"] > LIMIT,
        "no report": found["reports"] == 0,
        "order": found["irregular"] > 0,
        "damaged": found["damaged"] > 0,
        "lost": found["lost"] > 0,
        "traceback": found["tracebacks"] > 0,
        "newcomer": joins and found["newcomer_s"] is None,
        "seat": found["after_s"] is None,
    }
    return [word for word, holds in wrong.items() if holds]


def row(found: dict[str, Any]) -> str:
    """Return an attack's line of the table."""
    cells = [
        f"{found['attack']:22}",
        f"{found['gap']:7.2f}",
        f"{found['processor']:7.3f}",
        f"{found['process']:7.2f}",
    ]
    cells += [f"{found['sent'] / 1e6:8.1f}", f"{found['connections']:7}", f"{found['memory_MB']:7.0f}"]
    cells += [f"{found['descriptors']:5}", f"{found['log_bytes']:7}", " ".join(found["faults"]) or "-"]
    return " ".join(cells)


COLUMNS = {"wait/s": 7, "main/s": 7, "all/s": 7, "MB sent": 8, "links": 7, "MB": 7, "fds": 5, "log B": 7}
HEAD = " ".join([f"{'attack':22}", *(f"{word:>{width}}" for word, width in COLUMNS.items()), "faults"])


def main(args: Sequence[str] | None = None) -> int:
    """Play the attacks, print the table, write the records; return 1 if there are faults."""
    parser = argparse.ArgumentParser(prog="benchmarks.hostile", description="Attack a server of its own.")
    parser.add_argument("--json", type=Path, help="file to which a record for each attack is appended")
    parser.add_argument(
        "--attack", action="append", help="only attacks with this in their name or port; may be repeated"
    )
    parser.add_argument("--seconds", type=float, default=3.0, help="of each attack")
    parser.add_argument("--attackers", type=int, default=14)
    parser.add_argument("--ros2", action="store_true", help="serve ROS 2 by DDS, and send datagrams to it")
    parser.add_argument("--log", type=Path, help="keep the server's log in this file")
    parser.add_argument("--note", default="", help="a note for readers of the records")
    parser.add_argument("--table", type=Path, help="print the table of this file of records")
    options = parser.parse_args(args)
    if options.table is not None:
        print(worst_table(read_records(options.table)))
        return 0
    chosen = [*ATTACKS, *([DATAGRAMS] if options.ros2 else [])]
    if options.attack:
        chosen = [
            a for a in chosen if any(word in (a.name, a.port) or word in a.name for word in options.attack)
        ]
    records: list[dict[str, Any]] = []
    header = record_header("hostile", host=True, note=options.note)
    with tempfile.TemporaryDirectory() as folder:
        log = options.log or Path(folder) / "log.txt"
        with served(log, ros2=options.ros2) as (ports, server):
            watch = NeighbourWatch(ports, server, log)
            time.sleep(2.0)
            print(HEAD, flush=True)
            try:
                for attack in chosen:
                    found = run_attack(attack, ports, watch, options.seconds, options.attackers)
                    found["faults"] = faults(found, joins=attack.name.startswith("hoard"))
                    print(row(found), flush=True)
                    append_record({**header, **found}, options.json)
                    records.append(found)
            finally:
                watch.close()
    return summarize(records)


def summarize(found: Sequence[dict[str, Any]]) -> int:
    """Print the worst of all attacks; return 1 if one has faults."""
    for key, words in (("gap", "longest wait"), ("processor", "most processor time of the main thread")):
        one = max(found, key=lambda attack: attack[key])
        print(f"{words} {one[key]:.3f} s ({one['attack']})")
    fallen = [one["attack"] for one in found if one["faults"]]
    print(
        f"{len(found) - len(fallen)} of {len(found)} held"
        + (f"; fell: {', '.join(fallen)}" if fallen else "")
    )
    return int(bool(fallen))


if __name__ == "__main__":
    sys.exit(main())
