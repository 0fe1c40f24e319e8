"""Workers that play batches: this process, others of this machine, or a cluster by Ray.

A worker that is lost, by the system or with its machine, is replaced, and what it was doing is done again.

A pool of Python's ends with its first lost worker, and so does the work of all others. Here only the piece of
the lost worker is done again: when the rest is finished, and with no other worker, as the system may have
ended one worker for the memory of another.
"""

import logging
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from usarmjx.base.errors import UsageError, quoted
from usarmjx.base.installation import install_command
from usarmjx.base.progress import clear_status

TRIES = 3
"""Number of workers that a piece may end."""
GRACE = 5.0
"""Time for a worker to end before it is killed [s]."""
PieceWork = Callable[[Any], Any]
PieceOutcome = tuple[int, Any, str | None]
"""Number of a piece, its result, and why there is none."""
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
log = logging.getLogger(__name__)
SILENCE, ANSWER = 20.0, 60.0
"""Time without a result after which the cluster is asked, and longest time for its answer [s]."""
RETURN = 300.0
"""Longest time for a cluster that was lost to come back [s]."""
MAX_LOSSES = 3
"""Most losses of the cluster without a result between them."""
PLACES = ("here", "processes", "ray")


def work_in_processes(
    work: PieceWork, pieces: Sequence[Any], count: int, devices: Sequence[str | None]
) -> Iterator[PieceOutcome]:
    """Do all pieces in worker processes, and yield each as soon as it is done.

    Args:
        work: Does a piece; another process must be able to import it.
        pieces: The pieces.
        count: Number of workers.
        devices: GPU of each worker, as CUDA_VISIBLE_DEVICES names it; None: all.
    """
    queue, alone = list(range(len(pieces))), list[int]()
    tries, reasons = dict.fromkeys(queue, 0), dict[int, str]()
    idle, busy = [_Worker(work, device) for device in devices[:count]], dict[Connection, _Worker]()
    try:
        while queue or alone or busy:
            while queue and idle:
                _give(idle.pop(), queue.pop(0), pieces, tries, busy)
            # Alone: what else was at work may have taken the memory.
            if not busy and alone:
                _give(idle.pop(), alone.pop(0), pieces, tries, busy)
            for connection in wait(list(busy)):
                worker = busy.pop(connection)  # type: ignore - only connections are waited for
                number, (value, fault) = worker.piece, worker.result()
                idle.append(worker)
                if fault is not None and worker.lost:
                    reasons[number] = fault
                    if tries[number] < TRIES:
                        alone.append(number)
                        continue
                    fault = f"its worker was lost {TRIES} times{reasons[number]}"
                yield number, value, fault
    finally:
        # A caller that stops before the last result comes here, too.
        _end([*idle, *busy.values()])


def _give(
    worker: "_Worker", number: int, pieces: Sequence[Any], tries: dict[int, int], busy: dict[Any, "_Worker"]
) -> None:
    tries[number] += 1
    worker.begin(number, pieces[number])
    busy[worker.connection] = worker


@dataclass(eq=False)
class _Worker:
    """A worker process, which is started for its first piece, and again after a loss.

    Attributes:
        work: Does a piece.
        device: The only GPU that it sees; None: all.
        piece: Number of the piece that it does.
        lost: Whether it ended without a result.
    """

    work: PieceWork
    device: str | None
    piece: int = -1
    lost: bool = False
    process: Any = None
    connection: Any = None

    def begin(self, number: int, piece: Any) -> None:  # noqa: ANN401 - any piece
        """Send a piece to the process."""
        self.piece, self.lost = number, False
        if self.process is None or not self.process.is_alive():  # an idle one may have been ended, too
            self._start()
        with suppress(OSError):  # it has just ended: its result says so
            self.connection.send(piece)

    def _start(self) -> None:
        self.close()
        context = multiprocessing.get_context("spawn")  # JAX does not live on in a fork
        self.connection, far = context.Pipe()
        arguments = self.work, far, self.device
        self.process = context.Process(target=_serve, args=arguments, daemon=True)
        # Ctrl-C is this process's own: in one that still imports it would be a traceback.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        far.close()  # so that the end of the process is the end of the pipe

    def result(self) -> tuple[Any, str | None]:
        """Return the result of the piece, and why there is none."""
        try:
            return self.connection.recv()
        except (EOFError, OSError):
            self.lost = True
            # The pipe may end before the process does; without its end there is no exit code.
            self.process.join(GRACE)
            return None, _ending(self.process.exitcode)
        except Exception as error:  # a result whose class is not known here
            return None, quoted(error)

    def close(self) -> None:
        """Close the pipe: an idle process ends then."""
        if self.connection is not None:
            self.connection.close()


def _ending(code: int | None) -> str:
    """Return how a process has ended, as the end of a sentence."""
    if code == -signal.SIGKILL:
        return ", by SIGKILL, as the system does when memory runs out"
    if code is not None and code < 0:
        with suppress(ValueError):
            return f", by {signal.Signals(-code).name}"
    return f", with exit status {code}"


def _end(workers: Sequence[_Worker]) -> None:
    there = [worker for worker in workers if worker.process is not None]
    # All are asked to end before any is waited for.
    for worker in there:
        worker.close()
        # A worker amid a piece does not read its pipe, so the pipe's end alone would not end it.
        worker.process.terminate()
    for worker in there:
        worker.process.join(GRACE)
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()
        worker.process.close()


def _serve(work: PieceWork, connection: Connection, device: str | None) -> None:
    """Do the pieces that come through a pipe, until it ends; the main function of a worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, who ends this process
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if device is not None:
        # Before the first piece: CUDA reads the variable once, when JAX starts its backend.
        os.environ["CUDA_VISIBLE_DEVICES"] = device
    while True:
        try:
            piece = connection.recv()
        except (EOFError, OSError):
            return
        except Exception as error:  # a piece whose class is not known here
            connection.send((None, quoted(error)))
            continue
        try:
            outcome = work(piece), None
        except Exception as error:
            outcome = None, quoted(error)
        except BaseException as error:  # as sys.exit of somebody's policy
            outcome = None, type(error).__name__
        try:
            connection.send(outcome)
        except OSError:
            return
        except Exception as error:  # a result that cannot be pickled
            connection.send((None, quoted(error)))


def _end_with_parent() -> None:
    """End this process as soon as its parent has ended, whatever it is doing."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        # Daemon processes end only if their parent ends in order; SIGKILL gives it no time for that.
        parent.join()
        # `sys.exit` would end this thread only.
        os._exit(1)


def children() -> set[str]:
    """Return the processes that this one has started, as numbers and times of start; Linux only."""
    found = set[str]()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        except OSError:
            continue
        # Behind the name in brackets, which may hold blanks itself: state, parent, and the start time as the
        # 20th.
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
    # Isolated and in a session of its own: Ctrl-C in the terminal must not end the guard first.
    guard = subprocess.Popen(
        [sys.executable, "-I", "-c", GUARD], stdin=subprocess.PIPE, start_new_session=True
    )
    assert guard.stdin is not None
    guard.stdin.write("".join(f"{one}\n" for one in sorted(processes)).encode())
    guard.stdin.flush()
    # The pipe stays open: its end is the sign that this process has ended.
    return guard


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
    # A connection that the caller made is the caller's to close.
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
        # Messages of Ray would stand between the lines of progress.
        quiet = {"log_to_driver": False, "include_dashboard": False, "logging_level": logging.ERROR}
        # Without an address Ray would look for a cluster that `ray start` noted, which may have ended.
        address = self._address or os.environ.get("RAY_ADDRESS") or "local"
        try:
            self._ray.init(address=address, **quiet)
        except Exception as error:
            where = f" at {self._address}" if self._address else ""
            raise UsageError(f"Ray does not start{where}: {quoted(error)}") from error
        # Only what Ray has started: earlier children have owners of their own.
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
            # In their order again: what was at work is lost, and is done first.
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
    # No restarts by Ray: a piece that ends its worker would be given to the next one without being counted.
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
        # The error itself has the whole traceback of the worker as its text.
        return None, quoted(getattr(error, "cause", None) or error), False
    except ray.exceptions.RayError as error:  # out of memory, lost objects and nodes, dead workers
        return None, f"{type(error).__name__}: {quoted(error)}", True
    except Exception as error:  # a result whose class is not known here
        return None, quoted(error), False


@dataclass(frozen=True, kw_only=True)
class Workers:
    """Workers that play batches.

    Attributes:
        place: One of `PLACES`.
        count: Number of workers; None: one for each GPU, else one.
        address: Of a Ray cluster; None: Ray on this machine.

    Raises:
        UsageError: No such place, or an address without Ray.
    """

    place: str = "here"
    count: int | None = None
    address: str | None = None

    def __post_init__(self) -> None:
        """Refuse what does not go together."""
        if self.place not in PLACES:
            raise UsageError(f"run on {self.place!r}: expected {', '.join(PLACES)}")
        if self.address is not None and self.place != "ray":
            raise UsageError(f"an address is for a cluster of Ray: run on ray, not on {self.place}")
        if self.count is not None and self.count < 1:
            raise UsageError(f"{self.count} workers, expected at least 1")

    def size(self, pieces: int) -> int:
        """Return the number of workers that share a number of pieces; on Ray, GPUs of this machine count."""
        if self.place == "here":
            return 1
        return max(1, min(self.count or max(1, gpus()), pieces))

    def run(self, work: PieceWork, pieces: Sequence[Any]) -> Iterator[PieceOutcome]:
        """Do all pieces, and yield each as soon as it is done.

        Args:
            work: Does a piece; another process must be able to import it.
            pieces: Task to run.

        Raises:
            UsageError: Ray is not installed, or its cluster is not there.
        """
        if self.place == "ray":
            return work_on_ray(work, pieces, self.count, self.address)
        if self.place == "processes":
            count = self.size(len(pieces))
            return work_in_processes(work, pieces, count, _devices(count))
        return _here(work, pieces)


def gpus() -> int:
    """Return the number of NVIDIA GPUs that this process may use."""
    said = os.environ.get("CUDA_VISIBLE_DEVICES")
    if said is not None:
        # An empty text or -1 hides all GPUs.
        return len([one for one in said.split(",") if one.strip() and one.strip() != "-1"])
    if shutil.which("nvidia-smi") is None:
        return 0
    # By device files: nvidia-smi takes a second, and may hang on a busy driver.
    return len([name for name in os.listdir("/dev") if name.startswith("nvidia") and name[6:].isdecimal()])


def _here(work: PieceWork, pieces: Sequence[Any]) -> Iterator[PieceOutcome]:
    for number, piece in enumerate(pieces):
        yield number, work(piece), None


def _devices(count: int) -> list[str | None]:
    """Return the GPU of each of some workers, in turns; None: there is none to choose from."""
    said = [one for one in os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",") if one]
    there = gpus()
    if not there:
        return [None] * count
    # The variable may hold UUIDs, or numbers that do not begin at 0.
    return [said[worker % there] if said else str(worker % there) for worker in range(count)]
