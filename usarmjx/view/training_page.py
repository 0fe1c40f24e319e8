"""The live page of worlds in which robots learn; it takes next to nothing of the training's time."""

import time
from collections.abc import Callable

import jax

from usarmjx.sim.batch import Batch
from usarmjx.sim.batch_state import BatchState
from usarmjx.view.batch_source import BatchSource
from usarmjx.view.page import MAX_WALL, ViewerPage

TIME_SHARE = 0.01
"""The page takes no more than this share of the training's time, except for what somebody asks of it."""


class TrainingPage:
    """Shows some worlds of a training.

    Args:
        batch: The training's worlds.
        make_page: Makes the page of what there is to see.
        now: The clock [s].
    """

    def __init__(
        self,
        batch: Batch,
        make_page: Callable[[BatchSource], ViewerPage],
        now: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._batch, self._make_page, self._now = batch, make_page, now
        self._source: BatchSource | None = None
        self._page: ViewerPage | None = None
        self._due = 0.0

    def show(self, state: BatchState) -> None:
        """Show the worlds as they are, if somebody looks and the page has not had its share of time."""
        if self._page is not None and (self._now() < self._due or not self._page.is_watched):
            return
        jax.block_until_ready(state.worlds.step)  # what the device still computes is not the page's time
        began = self._now()
        if self._source is None or self._page is None:
            self._source = BatchSource(self._batch, state, range(min(self._batch.worlds, MAX_WALL)))
            self._page = self._make_page(self._source)
        self._source.show(state)
        self._page.refresh()
        ended = self._now()
        self._due = ended + (ended - began) * (1.0 - TIME_SHARE) / TIME_SHARE

    def close(self) -> None:
        """Hang up on everybody."""
        if self._page is not None:
            self._page.close()
