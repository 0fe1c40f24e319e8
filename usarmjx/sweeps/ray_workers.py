"""Workers of a sweep on a cluster, by Ray."""

import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from usarmjx.base.errors import UsageError, quoted
from usarmjx.base.installation import install_command
from usarmjx.sweeps.local_workers import TRIES, PieceOutcome, PieceWork

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


def work_on_ray(
    work: PieceWork, pieces: Sequence[Any], count: int | None, address: str | None
) -> Iterator[PieceOutcome]:
    """Do all pieces by actors of Ray, and yield each as soon as it is done.

    Args:
        work: Does a piece.
        pieces: The pieces.
        count: Number of actors; None: one for each GPU, else one.
        address: Address of a cluster; None: Ray on this machine.

    Raises:
        UsageError: Ray is not installed, or its cluster is not there.
    """
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise UsageError(
            f"running on ray needs Ray: {install_command('sweep')}; or run on processes"
        ) from error
    started, guard = not ray.is_initialized(), None
    if started:
        before = children()
        try:
            quiet = {"log_to_driver": False, "include_dashboard": False, "logging_level": logging.ERROR}
            ray.init(address=address, **quiet)
        except Exception as error:
            raise UsageError(
                f"Ray does not start{f' at {address}' if address else ''}: {quoted(error)}"
            ) from error
        guard = end_with_this_process(children() - before)
    try:
        yield from _by_actors(ray, work, pieces, count)
    finally:
        if started:
            ray.shutdown()
        if guard is not None:
            guard.kill()  # Ray has ended its processes itself
            guard.wait()


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

    Ray's own processes stay when the one that started them is killed.

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


def _by_actors(ray: Any, work: PieceWork, pieces: Sequence[Any], count: int | None) -> Iterator[PieceOutcome]:  # noqa: ANN401
    """Have actors do the pieces: each has a GPU, where the cluster has some."""
    devices = int(ray.cluster_resources().get("GPU", 0))
    many = min(count or max(1, devices), max(1, len(pieces)))
    start = _actors(ray, work, devices)
    queue, alone, tries = list(range(len(pieces))), list[int](), dict.fromkeys(range(len(pieces)), 0)
    idle: list[Any] = [start() for _ in range(many)]
    busy: dict[Any, tuple[int, Any]] = {}

    def give(number: int) -> None:
        actor = idle.pop()
        tries[number] += 1
        busy[actor.do.remote(pieces[number])] = number, actor

    while queue or alone or busy:
        while queue and idle:
            give(queue.pop(0))
        if not busy and alone:  # after a loss: what else is at work may have been the reason
            give(alone.pop(0))
        (done,), _ = ray.wait(list(busy), num_returns=1)
        number, actor = busy.pop(done)
        value, fault, lost = _result(ray, done)
        idle.append(start() if lost else actor)
        if lost and tries[number] < TRIES:
            alone.append(number)
            continue
        yield number, value, f"its worker was lost {TRIES} times, {fault}" if lost else fault


def _actors(ray: Any, work: PieceWork, devices: int) -> Callable[[], Any]:  # noqa: ANN401
    class Actor:
        def do(self, piece: Any) -> Any:  # noqa: ANN401
            return work(piece)

    return ray.remote(num_gpus=1 if devices else 0, max_restarts=0)(Actor).remote


def _result(ray: Any, done: Any) -> tuple[Any, str | None, bool]:  # noqa: ANN401
    """Return a result, why there is none, and whether the worker was lost."""
    try:
        return ray.get(done), None, False
    except ray.exceptions.RayTaskError as error:
        return None, quoted(getattr(error, "cause", None) or error), False
    except ray.exceptions.RayError as error:  # out of memory, lost objects and nodes, dead workers
        return None, f"{type(error).__name__}: {quoted(error)}", True
    except Exception as error:  # a result whose class is not known here
        return None, quoted(error), False
