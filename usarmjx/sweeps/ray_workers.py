"""Workers of a sweep on a cluster, by Ray."""

import logging
import os
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from usarmjx.base.errors import UsageError, quoted
from usarmjx.base.installation import install_command
from usarmjx.base.progress import clear_status
from usarmjx.sweeps.guard import children, end_with_this_process
from usarmjx.sweeps.local_workers import TRIES, PieceOutcome, PieceWork

log = logging.getLogger(__name__)

SILENCE, ANSWER = 20.0, 60.0
"""Time without a result after which the cluster is asked, and longest time for its answer [s]."""
RETURN = 300.0
"""Longest time for a cluster that was lost to come back [s]."""
MAX_LOSSES = 3
"""Most losses of the cluster without a result between them."""


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
    connection = None if ray.is_initialized() else _Connection(ray, address)
    try:
        yield from _by_actors(ray, work, pieces, count, connection)
    finally:
        if connection is not None:
            connection.close()


class _Connection:
    """A connection to a cluster that this process made; on this machine, with the cluster.

    Args:
        ray: The module.
        address: Address of the cluster; None: Ray on this machine.

    Raises:
        UsageError: The cluster is not there.
    """

    def __init__(self, ray: Any, address: str | None) -> None:  # noqa: ANN401
        self._ray, self._address = ray, address
        self._guard: subprocess.Popen[bytes] | None = None
        self._open()

    def _open(self) -> None:
        before = children()
        quiet = {"log_to_driver": False, "include_dashboard": False, "logging_level": logging.ERROR}
        # Without an address Ray would look for a cluster that `ray start` noted, which may have ended.
        address = self._address or os.environ.get("RAY_ADDRESS") or "local"
        try:
            self._ray.init(address=address, **quiet)
        except Exception as error:
            where = f" at {self._address}" if self._address else ""
            raise UsageError(f"Ray does not start{where}: {quoted(error)}") from error
        self._guard = end_with_this_process(children() - before)

    def renew(self) -> None:
        """Connect again to a cluster that was lost, as soon as it is there again.

        Raises:
            UsageError: It does not come back within `RETURN`.
        """
        self.close()
        give_up = time.monotonic() + RETURN
        while True:
            try:
                return self._open()
            except UsageError as error:
                if time.monotonic() > give_up:
                    raise UsageError(f"{error}; finished cells are kept: run it again to go on") from error
                time.sleep(1.0)

    def close(self) -> None:
        """End the connection; on this machine, also Ray's processes."""
        self._ray.shutdown()
        if self._guard is not None:
            self._guard.kill()  # Ray has ended its processes itself
            self._guard.wait()


def _by_actors(
    ray: Any,  # noqa: ANN401
    work: PieceWork,
    pieces: Sequence[Any],
    count: int | None,
    connection: _Connection | None,
) -> Iterator[PieceOutcome]:
    """Have actors do the pieces: each has a GPU, where the cluster has some."""
    queue, alone, tries = list(range(len(pieces))), list[int](), dict.fromkeys(range(len(pieces)), 0)
    start, idle, sentinel = _actors(ray, work, count, len(pieces))
    busy: dict[Any, tuple[int, Any]] = {}

    def give(number: int) -> None:
        actor = idle.pop()
        tries[number] += 1
        busy[actor.do.remote(pieces[number])] = number, actor

    losses = 0
    while queue or alone or busy:
        while queue and idle:
            give(queue.pop(0))
        if not busy and alone:  # after a loss: what else is at work may have been the reason
            give(alone.pop(0))
        done = _next(ray, list(busy), sentinel)
        if done is None:
            queue = sorted([number for number, _ in busy.values()] + queue)
            busy.clear()
            idle.clear()
            losses += 1
            _renew(connection, losses)
            start, idle, sentinel = _actors(ray, work, count, len(pieces))
            continue
        losses = 0
        number, actor = busy.pop(done)
        value, fault, lost = _result(ray, done)
        idle.append(start() if lost else actor)
        if lost and tries[number] < TRIES:
            alone.append(number)
            continue
        yield number, value, f"its worker was lost {TRIES} times, {fault}" if lost else fault


def _next(ray: Any, busy: list[Any], sentinel: Any) -> Any:  # noqa: ANN401
    """Return the next result that is there; None: the cluster is lost.

    Ray waits for ever for the actors of a head that has ended or was started again. So an actor that has
    nothing to do is asked while no result comes.
    """
    while True:
        done, _ = ray.wait(busy, num_returns=1, timeout=SILENCE)
        if done:
            return done[0]
        asked = sentinel.answer.remote()
        if not ray.wait([asked], timeout=ANSWER)[0] or _result(ray, asked)[2]:
            return None


def _renew(connection: _Connection | None, losses: int) -> None:
    lost = "the cluster of Ray does not answer any more"
    if connection is None or losses > MAX_LOSSES:
        raise UsageError(f"{lost}; finished cells are kept: run it again to go on")
    clear_status()
    log.warning("%s; connecting to it again", lost)
    connection.renew()


def _actors(
    ray: Any,  # noqa: ANN401
    work: PieceWork,
    count: int | None,
    most: int,
) -> tuple[Callable[[], Any], list[Any], Any]:
    """Return a function that starts an actor, actors for at most some pieces, and the sentinel."""

    class Actor:
        def do(self, piece: Any) -> Any:  # noqa: ANN401
            return work(piece)

    class Sentinel:
        def answer(self) -> bool:
            return True

    devices = int(ray.cluster_resources().get("GPU", 0))
    start = ray.remote(num_gpus=1 if devices else 0, max_restarts=0)(Actor).remote
    many = min(count or max(1, devices), max(1, most))
    # The sentinel moves to another node if its own is lost: a cluster is more than one node.
    sentinel = ray.remote(num_cpus=0, max_restarts=-1, max_task_retries=-1)(Sentinel).remote()
    ray.wait([sentinel.answer.remote()], timeout=RETURN)  # a slow machine takes its time to start a process
    return start, [start() for _ in range(many)], sentinel


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
