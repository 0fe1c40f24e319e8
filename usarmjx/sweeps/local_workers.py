"""Worker processes of a sweep on this machine: each has its own pipe, so that a lost one names its piece.

A pool of Python's ends with its first lost worker, and so does the work of all others. Here only the piece of
the lost worker is done again: when the rest is finished, and with no other worker, as the system may have
ended one worker for the memory of another.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

from usarmjx.base.errors import quoted

TRIES = 3
"""Number of workers that a piece may end."""
GRACE = 5.0
"""Time for a worker to end before it is killed [s]."""
PieceWork = Callable[[Any], Any]
PieceOutcome = tuple[int, Any, str | None]
"""Number of a piece, its result, and why there is none."""


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
    for worker in there:
        worker.close()
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
        parent.join()
        os._exit(1)
