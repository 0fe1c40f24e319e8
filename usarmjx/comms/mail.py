"""Messages between the robots of a world, for policies and tasks: fixed-size inboxes, pure functions.

A message is a vector of numbers with a declared size in bytes. `deliver` delivers over links that hold, at
once or with a latency and bandwidth, after which `receive` puts it into the box; undelivered messages are
counted by sender and cause.

A link sends one message after the other at its bandwidth; the last byte arrives after the latency. Nothing
here depends on the age of the world: durations are counted in control steps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np
from flax import struct

from usarmjx.base import random
from usarmjx.base.backend import Array, set_at, xp
from usarmjx.base.clock import Clock
from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE, POSITIVE, validate
from usarmjx.comms.links import Links

ROUNDING = 1e-4
"""Share of a control step by which a message may be late and still counts as there."""
BYTES_PER_NUMBER = 4
"""Default size of a number of a message: single precision [bytes]."""


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
    # At most one message per pair and call: counting those under way is enough.
    fits = sent & (transit.count < settings.capacity)
    # Times 0.0 keeps the shape and makes it a float.
    needs = 0.0 * size if settings.bandwidth is None else size / settings.bandwidth
    # The backlog was counted at `transit.step`; since then the link has worked it off.
    busy = xp.maximum(transit.backlog - clock.since(transit.step), 0.0)
    backlog = xp.where(fits, busy + needs[:, None], busy)
    # Rounded up to whole control steps; the margin keeps 0.2 s at 0.1 s from becoming three steps.
    delay = xp.ceil((backlog + settings.latency) / clock.period - ROUNDING).astype(xp.int32)
    # A mask over the queue instead of an index: it is the same for NumPy and for traced arrays.
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
    # By their difference, not by comparing counts: these are 32-bit and wrap around.
    arrived = (waits & (clock.step - transit.arrival >= 0)).sum(-1, dtype=xp.int32)
    # Entries beyond the count are undefined, so the last one may be repeated.
    source = xp.minimum(np.arange(capacity) + arrived[..., None], capacity - 1)

    # Queues stay in order with their first message at index 0, so arrivals are always a prefix.
    def shifted(values: Array) -> Array:
        index = source.reshape(*source.shape, *[1] * (values.ndim - source.ndim))
        return xp.take_along_axis(values, index, axis=2)

    moved = {name: shifted(getattr(transit, name)) for name in ("arrival", "time", "size_bytes", "payload")}
    return transit.replace(count=transit.count - arrived, **moved), arrived


@dataclass(frozen=True)
class MessageSettings:
    """Sizes of a scene's messages and inboxes.

    Attributes:
        numbers: Numbers in a message.
        capacity: Messages that a robot's inbox holds until it is emptied.
        bytes_per_step: Bytes that a robot may send in a control step, each receiver counted [bytes].
        latency: Time between the last byte of a message and its arrival [s].
        bandwidth: Bytes that each link carries in a second [bytes/s]; None: any number at once.

    Raises:
        SpecError: A size is below 1, or a time or bandwidth makes no sense.
    """

    numbers: Annotated[int, AT_LEAST_ONE] = 8
    capacity: Annotated[int, AT_LEAST_ONE] = 8
    bytes_per_step: Annotated[int, AT_LEAST_ONE] = 1500
    latency: Annotated[float, NOT_NEGATIVE] = 0.0
    bandwidth: Annotated[float, POSITIVE] | None = None

    def __post_init__(self) -> None:
        """Check the sizes."""
        validate(self)

    @property
    def takes_time(self) -> bool:
        """Whether messages are under way for a time."""
        return self.latency > 0 or self.bandwidth is not None


class DropCounts(struct.PyTreeNode, kw_only=True):
    """Undelivered messages since the episode began, by sender; a message to three receivers counts thrice.

    Attributes:
        over_budget: The sender's bytes of the control step were spent (robots,).
        no_link: No link holds (robots,).
        lost: Lost at random near the cutoff (robots,).
        inbox_full: The receiver's inbox was full, or the link's queue (robots,).
    """

    over_budget: Array
    no_link: Array
    lost: Array
    inbox_full: Array


class Inboxes(struct.PyTreeNode, kw_only=True):
    """Inboxes of one world's robots; entries beyond the first `count` are undefined.

    Attributes:
        count: Messages in the inbox (robots,).
        sender: Senders' slots, in the order of arrival (robots, capacity).
        time: Times of sending [s] (robots, capacity).
        size_bytes: Declared sizes [bytes] (robots, capacity).
        payload: Contents (robots, capacity, numbers).
        spent: Bytes sent in the control step `step` [bytes] (robots,).
        step: Control step of the last delivery ().
        sent: Messages sent since the episode began, delivered or not (robots,).
        dropped: Undelivered ones among them.
        transit: Messages under way; None: they arrive at once.
    """

    count: Array
    sender: Array
    time: Array
    size_bytes: Array
    payload: Array
    spent: Array
    step: Array
    sent: Array
    dropped: DropCounts
    transit: Transit | None = None

    @property
    def valid(self) -> Array:
        """Mask of entries that hold a message (robots, capacity)."""
        return xp.arange(self.sender.shape[-1]) < self.count[..., None]


class OutgoingMessages(struct.PyTreeNode, kw_only=True):
    """Messages of the robots of one world: one each, to any number of receivers.

    Attributes:
        receivers: Receivers, row sender, column receiver (robots, robots).
        payload: Contents (robots, numbers).
        size_bytes: Declared sizes, not below 0 [bytes] (robots,).
    """

    receivers: Array
    payload: Array
    size_bytes: Array


def empty_inboxes(settings: MessageSettings, robots: int) -> Inboxes:
    """Return empty inboxes."""
    box, none = (robots, settings.capacity), xp.zeros(robots, xp.int32)
    return Inboxes(
        count=none,
        sender=xp.zeros(box, xp.int32),
        time=xp.zeros(box),
        size_bytes=xp.zeros(box, xp.int32),
        payload=xp.zeros((*box, settings.numbers)),
        spent=none,
        step=xp.zeros((), xp.int32),
        sent=none,
        dropped=DropCounts(over_budget=none, no_link=none, lost=none, inbox_full=none),
        transit=no_transit(settings, robots) if settings.takes_time else None,
    )


def _through(links: Links, key: Array) -> Array:
    """Draw over which links a message gets through (robots, robots)."""
    # Below, not at: draws may be 0 and are never 1, so probability 0 loses all and 1 none.
    return random.uniform(key, links.delivery_probability.shape) < links.delivery_probability


def _count(messages: Array) -> Array:
    """Return the count of masked messages of each sender (robots,)."""
    return messages.sum(-1, dtype=xp.int32)


def deliver(
    settings: MessageSettings,
    inboxes: Inboxes,
    messages: OutgoingMessages,
    links: Links,
    clock: Clock,
    key: Array,
) -> Inboxes:
    """Return the inboxes after all messages were sent; those that take time are under way then.

    A sender's bytes are spent in the order of the receivers' slots, also on messages that do not arrive: a
    sender cannot know. Inboxes fill in the order of the senders' slots. A message to oneself has no link.

    Args:
        settings: Sizes.
        inboxes: Inboxes before.
        messages: The messages.
        links: Current links.
        clock: The present.
        key: Key of random losses near the cutoff; a new one for every delivery.
    """
    to = messages.receivers
    # Several deliveries in one control step share the budget.
    spent = xp.where(inboxes.step == clock.step, inboxes.spent, 0)
    length = xp.maximum(messages.size_bytes, 0).astype(xp.int32)
    # Counted in messages: a sum of bytes over many receivers could overflow int32.
    left = xp.maximum(settings.bytes_per_step - spent, 0)
    # Messages without bytes cost nothing: then any number of receivers is affordable.
    affordable = xp.where(length > 0, left // xp.maximum(length, 1), to.shape[-1])
    paid = to & (xp.cumsum(to, -1) <= affordable[:, None])
    linked = paid & links.in_range
    # Drawn for all pairs: shapes are fixed, and whether a message is lost does not depend on the others.
    arrived = linked & _through(links, key)
    if inboxes.transit is not None:
        transit, fits = enqueue(settings, inboxes.transit, arrived, (length, messages.payload), clock)
        boxes = inboxes.replace(transit=transit)
    else:

        def contents(source: Array) -> tuple[Array, Array, Array]:
            return clock.seconds, length[source], messages.payload[source]

        boxes, fits = _put(inboxes, arrived, contents)
    before = inboxes.dropped
    return boxes.replace(
        # Also of messages that get lost: the sender's radio has sent them.
        spent=spent + length * _count(paid),
        step=xp.asarray(clock.step, xp.int32),
        sent=inboxes.sent + _count(to),
        dropped=DropCounts(
            over_budget=before.over_budget + _count(to & ~paid),
            no_link=before.no_link + _count(paid & ~links.in_range),
            lost=before.lost + _count(linked & ~arrived),
            inbox_full=before.inbox_full + _count(arrived & ~fits),
        ),
    )


def _put(
    inboxes: Inboxes, arrived: Array, contents: Callable[[Array], tuple[Array, Array, Array]]
) -> tuple[Inboxes, Array]:
    """Put messages into the inboxes, in the order of the senders' slots.

    Args:
        inboxes: Inboxes before.
        arrived: Which sender's message has reached which receiver (robots, robots).
        contents: Function of senders (robots, capacity), a row for each receiver, that returns the times of
            sending [s], sizes [bytes] and payloads of their messages.

    Returns:
        The inboxes, and which messages found room (robots, robots).
    """
    robots, capacity = inboxes.sender.shape
    index = inboxes.count[None, :] + xp.cumsum(arrived, 0) - 1  # in the receiver's inbox
    fits = arrived & (index < capacity)
    # One scatter of the senders' slots; all other fields are gathered by it.
    sender, receiver = np.indices((robots, robots), np.int32)
    # A message that does not fit is written to an extra column, which is cut off.
    where = (receiver, xp.where(fits, index, capacity))
    new_sender = set_at(xp.full((robots, capacity + 1), -1), where, sender)[:, :capacity]
    fresh, source = new_sender >= 0, xp.maximum(new_sender, 0)
    time, size_bytes, payload = contents(source)
    boxes = inboxes.replace(
        count=inboxes.count + fits.sum(0, dtype=xp.int32),
        sender=xp.where(fresh, source, inboxes.sender),
        time=xp.where(fresh, time, inboxes.time),
        size_bytes=xp.where(fresh, size_bytes, inboxes.size_bytes),
        payload=xp.where(fresh[..., None], payload, inboxes.payload),
    )
    return boxes, fits


def receive(inboxes: Inboxes, clock: Clock) -> Inboxes:
    """Return the inboxes with the messages that have arrived by now, the first of each link first."""
    before = inboxes.transit
    if before is None:
        return inboxes
    transit, arrived = dequeue(before, clock)
    boxes, to = inboxes.replace(transit=transit), np.arange(len(arrived))[:, None]
    # Place by place, so that nobody's second message comes before another's first.
    for place in range(before.arrival.shape[-1]):
        here = place < arrived

        def contents(source: Array, place: int = place) -> tuple[Array, Array, Array]:
            at = source, to, place
            return before.time[at], before.size_bytes[at], before.payload[at]

        boxes, fits = _put(boxes, here, contents)
        dropped = boxes.dropped
        boxes = boxes.replace(dropped=dropped.replace(inbox_full=dropped.inbox_full + _count(here & ~fits)))
    return boxes


def clear_inboxes(inboxes: Inboxes, mask: Array | bool = True) -> Inboxes:
    """Return the inboxes with those of the masked robots (robots,) emptied."""
    # Entries beyond the count are undefined, so the count alone is reset.
    return inboxes.replace(count=xp.where(mask, 0, inboxes.count))
