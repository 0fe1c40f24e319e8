"""Workers that play batches: this process, others of this machine, or a cluster by Ray.

A worker that is lost, by the system or with its machine, is replaced, and what it was doing is done again.
"""

import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from usarmjx.base.errors import UsageError
from usarmjx.sweeps.local_workers import PieceOutcome, PieceWork, work_in_processes
from usarmjx.sweeps.ray_workers import work_on_ray

PLACES = ("here", "processes", "ray")


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
        return len([one for one in said.split(",") if one.strip() and one.strip() != "-1"])
    if shutil.which("nvidia-smi") is None:
        return 0
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
    return [said[worker % there] if said else str(worker % there) for worker in range(count)]
