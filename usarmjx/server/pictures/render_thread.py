"""Pictures of a served world, rendered in a thread.

The thread works for a part of the time only: the robots' reports have precedence.
"""

import asyncio
import logging
import time
from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from usarmjx.server.pictures.views import CompositeView, snapshot
from usarmjx.server.worlds.served_world import CameraRequest, ServedWorld, ViewpointRequest

log = logging.getLogger(__name__)

MAX_TIME_SHARE = 0.6
"""Largest share of the time in which the thread works."""
MAX_PAUSE = 0.2
"""Longest pause after a picture, which may take seconds to compile or to render [s]."""

Made = TypeVar("Made")
ViewImages = Mapping[CompositeView, np.ndarray]
"""Pictures (height, width, 3) by their views."""


class RenderThread:
    """Renders for one service.

    Args:
        world: The served world.
    """

    def __init__(self, world: ServedWorld) -> None:
        self._world = world
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="pictures")
        self._job: asyncio.Task[None] | None = None
        self._rested = 0.0

    def is_ready(self, now: float) -> bool:
        """Return whether the last job and the pause after it are over at a time [s]."""
        return now >= self._rested and (self._job is None or self._job.done())

    def begin(self, job: Coroutine[None, None, None]) -> None:
        """Start a job, which calls `render`; its errors are logged."""
        self._job = asyncio.create_task(job)
        self._job.add_done_callback(_report)

    async def render(self, views: Collection[CompositeView], make: Callable[[ViewImages], Made]) -> Made:
        """Render views as they are now and return the result of `make`, both computed in the thread."""
        requests = list(dict.fromkeys(request for view in views for request, _, _ in view.tiles))
        job = _make, snapshot(self._world, requests), requests, set(views), make
        began = time.monotonic()
        made = await asyncio.get_running_loop().run_in_executor(self._executor, *job)
        ended = time.monotonic()
        # The pause makes the work `MAX_TIME_SHARE` of both together.
        self._rested = ended + min(MAX_PAUSE, (ended - began) * (1 - MAX_TIME_SHARE) / MAX_TIME_SHARE)
        return made

    def close(self) -> None:
        """Stop."""
        if self._job is not None:
            self._job.cancel()
        self._executor.shutdown(wait=False, cancel_futures=True)


def _make(
    render: Callable[[], list[np.ndarray]],
    requests: Sequence[CameraRequest | ViewpointRequest],
    views: Collection[CompositeView],
    make: Callable[[ViewImages], Made],
) -> Made:
    pictures = dict(zip(requests, render(), strict=True))
    return make({view: view.compose(pictures) for view in views})


def _report(task: asyncio.Task[None]) -> None:
    """Log the error of a task whose result nothing awaits."""
    if not task.cancelled() and (error := task.exception()):
        log.error("no picture could be rendered", exc_info=error)
