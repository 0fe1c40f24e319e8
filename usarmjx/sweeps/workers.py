"""Where batches are played: in this process, in others of this machine, or on a cluster by Ray.

A worker that is lost, by the system or with its machine, is replaced, and what it was doing is done again.
"""

import logging
import multiprocessing
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any

from usarmjx.base.errors import UsageError, quoted

PLACES = ("here", "processes", "ray")
TRIES = 3
"""So often a piece of work is begun before it counts as what kills its workers."""

PieceWork = Callable[[Any], Any]
PieceOutcome = tuple[int, Any, str | None]
"""Number of a piece of work, what came of it, and else why nothing did."""


@dataclass(frozen=True, kw_only=True)
class Workers:
    """Where batches are played.

    Attributes:
        place: One of `PLACES`.
        count: How many workers; None: one for each GPU, else one.
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

    def run(self, work: PieceWork, pieces: Sequence[Any]) -> Iterator[PieceOutcome]:
        """Do all pieces, and yield each as soon as it is done.

        Args:
            work: Does a piece; another process must be able to import it.
            pieces: What to do.

        Raises:
            UsageError: Ray is not installed, or its cluster is not there.
        """
        if self.place == "ray":
            return _on_ray(work, pieces, self.count, self.address)
        if self.place == "processes":
            return _in_processes(work, pieces, self.count or max(1, gpus()))
        return _here(work, pieces)


def gpus() -> int:
    """Return how many NVIDIA GPUs this process may use."""
    said = os.environ.get("CUDA_VISIBLE_DEVICES")
    if said is not None:
        return len([one for one in said.split(",") if one.strip() and one.strip() != "-1"])
    if shutil.which("nvidia-smi") is None:
        return 0
    return len([name for name in os.listdir("/dev") if name.startswith("nvidia") and name[6:].isdecimal()])


def _here(work: PieceWork, pieces: Sequence[Any]) -> Iterator[PieceOutcome]:
    for number, piece in enumerate(pieces):
        yield number, work(piece), None


def _take_gpu(numbers: Any) -> None:  # noqa: ANN401 - a queue of another process
    """Let this process see one GPU only."""
    number = numbers.get()
    if number is not None:
        os.environ["CUDA_VISIBLE_DEVICES"] = str(number)


def _in_processes(work: PieceWork, pieces: Sequence[Any], count: int) -> Iterator[PieceOutcome]:
    left, tries = dict(enumerate(pieces)), dict.fromkeys(range(len(pieces)), 0)
    while left:
        lost = False
        with _pool(min(count, len(left))) as pool:
            waiting: dict[Future[Any], int] = {}
            queue = list(left)
            while queue or waiting:
                # No more at work than there are workers: who is lost with one was at work.
                while queue and len(waiting) < count and not lost:
                    number = queue.pop(0)
                    tries[number] += 1
                    waiting[pool.submit(work, left[number])] = number
                if not waiting:
                    break
                for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                    number = waiting.pop(future)
                    try:
                        yield number, future.result(), None
                    except BrokenProcessPool:
                        lost = True
                        if tries[number] < TRIES:
                            continue
                        yield number, None, f"its worker was lost {TRIES} times"
                    except Exception as error:
                        yield number, None, quoted(error)
                    del left[number]


def _pool(count: int) -> ProcessPoolExecutor:
    context = multiprocessing.get_context("spawn")  # JAX does not live on in a fork
    said = os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",")
    there = gpus()
    numbers = context.Queue()
    for worker in range(count):
        own = None if not there else said[worker % there] if said != [""] else worker % there
        numbers.put(own)
    return ProcessPoolExecutor(count, mp_context=context, initializer=_take_gpu, initargs=(numbers,))


def _on_ray(
    work: PieceWork, pieces: Sequence[Any], count: int | None, address: str | None
) -> Iterator[PieceOutcome]:
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise UsageError(
            "running on ray needs Ray: pip install usarmjx[sweep]; or run on processes"
        ) from error
    started = not ray.is_initialized()
    if started:
        try:
            quiet = {"log_to_driver": False, "include_dashboard": False, "logging_level": logging.ERROR}
            ray.init(address=address, **quiet)
        except Exception as error:
            raise UsageError(
                f"Ray does not start{f' at {address}' if address else ''}: {quoted(error)}"
            ) from error
    try:
        yield from _by_actors(ray, work, pieces, count)
    finally:
        if started:
            ray.shutdown()


def _by_actors(ray: Any, work: PieceWork, pieces: Sequence[Any], count: int | None) -> Iterator[PieceOutcome]:  # noqa: ANN401
    """Have actors do the pieces: each has a GPU, where the cluster has some."""
    devices = int(ray.cluster_resources().get("GPU", 0))
    many = min(count or max(1, devices), max(1, len(pieces)))

    class Actor:
        def do(self, piece: Any) -> Any:  # noqa: ANN401
            return work(piece)

    kind = ray.remote(num_gpus=1 if devices else 0, max_restarts=0)(Actor)
    queue, tries = list(range(len(pieces))), dict.fromkeys(range(len(pieces)), 0)
    idle: list[Any] = [kind.remote() for _ in range(many)]
    busy: dict[Any, tuple[int, Any]] = {}
    while queue or busy:
        while queue and idle:
            number, actor = queue.pop(0), idle.pop()
            tries[number] += 1
            busy[actor.do.remote(pieces[number])] = number, actor
        (done,), _ = ray.wait(list(busy), num_returns=1)
        number, actor = busy.pop(done)
        try:
            found = ray.get(done)
        except ray.exceptions.RayActorError:
            idle.append(kind.remote())
            if tries[number] < TRIES:
                queue.append(number)
            else:
                yield number, None, f"its worker was lost {TRIES} times"
            continue
        except ray.exceptions.RayTaskError as error:
            idle.append(actor)
            yield number, None, quoted(error.cause if hasattr(error, "cause") else error)
            continue
        idle.append(actor)
        yield number, found, None
