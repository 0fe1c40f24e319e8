"""Messages under way: latency and bandwidth of each link, a queue per pair of robots; pure functions.

A link sends one message after the other at its bandwidth; the last byte arrives after the latency. Nothing
here depends on the age of the world: durations are counted in control steps.
"""

from typing import Protocol

import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.clock import Clock

ROUNDING = 1e-4
"""Share of a control step by which a message may be late and still counts as there."""


class LinkTiming(Protocol):
    """Settings that `Transit` uses; see `MessageSettings`."""

    @property
    def latency(self) -> float: ...  # noqa: D102
    @property
    def bandwidth(self) -> float | None: ...  # noqa: D102
    @property
    def capacity(self) -> int: ...  # noqa: D102
    @property
    def numbers(self) -> int: ...  # noqa: D102


class Transit(struct.PyTreeNode, kw_only=True):
    """Messages under way in one world, by sender and receiver; those beyond the first `count` are undefined.

    Attributes:
        count: Messages under way (robots, robots).
        arrival: Control steps of their arrival, in order (robots, robots, capacity).
        time: Times of sending [s] (robots, robots, capacity).
        size_bytes: Declared sizes [bytes] (robots, robots, capacity).
        payload: Contents (robots, robots, capacity, numbers).
        backlog: For how long each link is busy from `step` on [s] (robots, robots).
        step: Control step of `backlog` ().
    """

    count: Array
    arrival: Array
    time: Array
    size_bytes: Array
    payload: Array
    backlog: Array
    step: Array


def no_transit(settings: LinkTiming, robots: int) -> Transit:
    """Return the state in which nothing is under way."""
    pair = robots, robots
    queue = (*pair, settings.capacity)
    return Transit(
        count=xp.zeros(pair, xp.int32),
        arrival=xp.zeros(queue, xp.int32),
        time=xp.zeros(queue),
        size_bytes=xp.zeros(queue, xp.int32),
        payload=xp.zeros((*queue, settings.numbers)),
        backlog=xp.zeros(pair),
        step=xp.zeros((), xp.int32),
    )


def enqueue(
    settings: LinkTiming, transit: Transit, sent: Array, message: tuple[Array, Array], clock: Clock
) -> tuple[Transit, Array]:
    """Put messages on their links.

    Args:
        settings: Latency and bandwidth.
        transit: The messages under way.
        sent: Which sender has a message for which receiver that the link carries (robots, robots).
        message: Sizes [bytes] (robots,) and contents (robots, numbers) by sender.
        clock: The present.

    Returns:
        The messages under way, and which of the new ones found room in their queue (robots, robots).
    """
    size, payload = message
    fits = sent & (transit.count < settings.capacity)
    needs = 0.0 * size if settings.bandwidth is None else size / settings.bandwidth
    busy = xp.maximum(transit.backlog - clock.since(transit.step), 0.0)
    backlog = xp.where(fits, busy + needs[:, None], busy)
    delay = xp.ceil((backlog + settings.latency) / clock.period - ROUNDING).astype(xp.int32)
    new = fits[..., None] & (np.arange(settings.capacity) == transit.count[..., None])
    transit = transit.replace(
        count=transit.count + fits,
        arrival=xp.where(new, (clock.step + delay)[..., None], transit.arrival),
        time=xp.where(new, clock.seconds, transit.time),
        size_bytes=xp.where(new, size[:, None, None], transit.size_bytes),
        payload=xp.where(new[..., None], payload[:, None, None], transit.payload),
        backlog=xp.asarray(backlog, xp.float32),
        step=xp.asarray(clock.step, xp.int32),
    )
    return transit, fits


def dequeue(transit: Transit, clock: Clock) -> tuple[Transit, Array]:
    """Take what has arrived from the queues.

    Returns:
        The messages still under way, and how many of each queue's first have arrived (robots, robots).
    """
    capacity = transit.arrival.shape[-1]
    waits = np.arange(capacity) < transit.count[..., None]
    arrived = (waits & (clock.step - transit.arrival >= 0)).sum(-1, dtype=xp.int32)
    source = xp.minimum(np.arange(capacity) + arrived[..., None], capacity - 1)

    def shifted(values: Array) -> Array:
        index = source.reshape(*source.shape, *[1] * (values.ndim - source.ndim))
        return xp.take_along_axis(values, index, axis=2)

    moved = {name: shifted(getattr(transit, name)) for name in ("arrival", "time", "size_bytes", "payload")}
    return transit.replace(count=transit.count - arrived, **moved), arrived
