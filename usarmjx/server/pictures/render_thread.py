"""Pictures of a served world, drawn in a thread beside the loop.

The thread may be busy for a part of the time only: the robots' reports come first.
"""

import asyncio
import logging
import time
from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from usarmjx.server.pictures.views import View, expose
from usarmjx.server.worlds.host import HostWorld, Shot, Vista

log = logging.getLogger(__name__)

SHARE = 0.6
"""The thread works for no more than this part of the time."""
LONGEST_REST = 0.2
"""It rests no longer than this after a picture, whose first one of a kind takes seconds to compile [s]."""

Made = TypeVar("Made")
Wholes = Mapping[View, np.ndarray]
"""Pictures (height, width, 3) by what they are of."""


class Darkroom:
    """Draws for one service.

    Args:
        world: The served world.
    """

    def __init__(self, world: HostWorld) -> None:
        self._world = world
        self._beside = ThreadPoolExecutor(1, thread_name_prefix="pictures")
        self._job: asyncio.Task[None] | None = None
        self._rested = 0.0

    def free(self, now: float) -> bool:
        """Return whether it has done its last job and rested after it, at a time [s]."""
        return now >= self._rested and (self._job is None or self._job.done())

    def begin(self, job: Coroutine[None, None, None]) -> None:
        """Do a job, which is to call `take`; what goes wrong in it is logged."""
        self._job = asyncio.create_task(job)
        self._job.add_done_callback(_report)

    async def take(self, views: Collection[View], make: Callable[[Wholes], Made]) -> Made:
        """Return what is made in the thread of the pictures of some views, as they are now."""
        shots = list(dict.fromkeys(shot for view in views for shot, _, _ in view.tiles))
        draw = _draw, expose(self._world, shots), shots, set(views), make
        began = time.monotonic()
        made = await asyncio.get_running_loop().run_in_executor(self._beside, *draw)
        ended = time.monotonic()
        self._rested = ended + min(LONGEST_REST, (ended - began) * (1 - SHARE) / SHARE)
        return made

    def close(self) -> None:
        """Stop."""
        if self._job is not None:
            self._job.cancel()
        self._beside.shutdown(wait=False, cancel_futures=True)


def _draw(
    take: Callable[[], list[np.ndarray]],
    shots: Sequence[Shot | Vista],
    views: Collection[View],
    make: Callable[[Wholes], Made],
) -> Made:
    pictures = dict(zip(shots, take(), strict=True))
    return make({view: view.compose(pictures) for view in views})


def _report(task: asyncio.Task[None]) -> None:
    """Log what went wrong in a task that nobody waits for."""
    if not task.cancelled() and (error := task.exception()):
        log.error("no picture could be taken", exc_info=error)
