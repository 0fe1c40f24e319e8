"""The live page of a training's worlds, which takes a small share of the training's time."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.engines.base import PhysicsState
from usarmjx.sim.batch import Batch, BatchState
from usarmjx.sim.world import World
from usarmjx.view.capture import Capture
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.page import MAX_SIDE_BY_SIDE, ViewerPage

TIME_SHARE = 0.01
"""Largest share of the training's time that the page takes, except for users' requests."""


class BatchSource:
    """A `FrameSource` of a batch, whose state `show` sets.

    Args:
        batch: The batch.
        state: Its state.
        worlds: Numbers of the worlds to choose from.
    """

    def __init__(self, batch: Batch, state: BatchState, worlds: Sequence[int]) -> None:
        self._batch, self._state = batch, state
        self._worlds = np.asarray(worlds, np.int32)
        self._capture = Capture(batch.scene)
        # Compiled, so that the device sends the few shown worlds and not the whole batch.
        self._pick = jax.jit(_picked)
        self._fetched: tuple[Any, ...] | None = None
        self._drawings: dict[int, tuple[int, Drawing]] = {}

    @property
    def num_worlds(self) -> int:
        """Number of worlds to choose from."""
        return len(self._worlds)

    def show(self, state: BatchState) -> None:
        """Set the state of the batch; it is fetched from its device only for a watched page."""
        self._state, self._fetched = state, None

    def drawing(self, world: int) -> Drawing:
        """Return a world's drawing: a new one when an episode brings another arena."""
        state, physics = self._one(world)
        # A single arena looks the same in all episodes.
        episode = 0 if state.arena_state is None else int(state.episode)
        known = self._drawings.get(world)
        if known is None or known[0] != episode:
            known = self._drawings[world] = episode, self._capture.drawing(state, physics)
        return known[1]

    def frame(self, world: int) -> Frame:
        """Return a world's frame of the last shown state."""
        return self._capture.frame(*self._one(world))

    def _one(self, world: int) -> tuple[World, PhysicsState]:
        if self._fetched is None:
            worlds, physics = self._state.worlds, self._batch.physics(self._state)
            # Typed random keys cannot become NumPy arrays, their data can.
            keyed = worlds.replace(key=jax.random.key_data(worlds.key))
            # All worlds in one transfer: its fixed cost is larger than that of the data.
            self._fetched = jax.device_get(self._pick((keyed, physics), self._worlds))
        assert self._fetched is not None
        return jax.tree.map(lambda x: x[world], self._fetched)


def _picked(tree: tuple[World, PhysicsState], worlds: Array) -> tuple[World, PhysicsState]:
    return jax.tree.map(lambda x: x[worlds], tree)


class TrainingPage:
    """Shows some worlds of a training.

    Args:
        batch: The training's worlds.
        make_page: Makes the page of a source.
        now: Returns the time [s].
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
        """Show the worlds, if a user watches and the page has not used its share of time."""
        # The first page is made at once: before it exists nobody can watch it.
        if self._page is not None and (self._now() < self._due or not self._page.is_watched):
            return
        jax.block_until_ready(state.worlds.step)  # time of the device's pending work is not the page's
        began = self._now()
        if self._source is None or self._page is None:
            # Only now: a page takes its first drawing from a state.
            self._source = BatchSource(self._batch, state, range(min(self._batch.worlds, MAX_SIDE_BY_SIDE)))
            self._page = self._make_page(self._source)
        self._source.show(state)
        self._page.refresh()
        ended = self._now()
        # Solved for the wait after which this refresh is `TIME_SHARE` of the time from its begin on.
        self._due = ended + (ended - began) * (1.0 - TIME_SHARE) / TIME_SHARE

    def close(self) -> None:
        """Disconnect all users."""
        if self._page is not None:
            self._page.close()
