"""Messages between the robots of a world, for policies and tasks: fixed-size boxes, pure functions.

A message is a vector of numbers and stands for so many bytes. `deliver` hands messages over at once, over
links that hold; what does not arrive is counted, by sender and by cause.
"""

from dataclasses import dataclass

import numpy as np
from flax import struct

from usarmjx.base import random
from usarmjx.base.arrays import Array
from usarmjx.base.backend import set_at, xp
from usarmjx.base.errors import SpecError
from usarmjx.comms.links import Links

BYTES_PER_NUMBER = 4
"""What a message stands for if nothing else is said: numbers in single precision."""


@dataclass(frozen=True)
class MessageSettings:
    """Sizes of the mail of a scene.

    Attributes:
        numbers: Numbers in a message.
        capacity: Messages that a robot's box holds until it is emptied.
        bytes_per_step: Bytes that a robot may send in a control step, each receiver counted [bytes].

    Raises:
        SpecError: A size below 1.
    """

    numbers: int = 8
    capacity: int = 8
    bytes_per_step: int = 1500

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        for name in ("numbers", "capacity", "bytes_per_step"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1:
                raise SpecError(f"mail: {name} is {value}, allowed is a whole number from 1")


class DropCounts(struct.PyTreeNode, kw_only=True):
    """Messages that did not arrive since the episode began, by sender; a message to three counts thrice.

    Attributes:
        over_budget: The sender had no bytes left in the control step (robots,).
        no_link: There was no link that holds (robots,).
        lost: Lost near the cutoff (robots,).
        inbox_full: The receiver's box was full (robots,).
    """

    over_budget: Array
    no_link: Array
    lost: Array
    inbox_full: Array


class Inboxes(struct.PyTreeNode, kw_only=True):
    """The boxes of one world's robots; what lies behind the first `count` places means nothing.

    Attributes:
        count: Messages in the box (robots,).
        sender: Slots of their senders, in the order of arrival (robots, capacity).
        time: When they were sent [s] (robots, capacity).
        size_bytes: What they stand for [bytes] (robots, capacity).
        payload: What they say (robots, capacity, numbers).
        spent: Sent in the control step `step` [bytes] (robots,).
        step: Control step of the last sending ().
        sent: Messages sent since the episode began, arrived or not (robots,).
        dropped: Those of them that did not arrive.
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

    @property
    def valid(self) -> Array:
        """Which places hold a message (robots, capacity)."""
        return xp.arange(self.sender.shape[-1]) < self.count[..., None]


class OutgoingMessages(struct.PyTreeNode, kw_only=True):
    """What the robots of one world want to say: each one message, to any number of the others.

    Attributes:
        receivers: Receivers, row sender, column receiver (robots, robots).
        payload: The messages (robots, numbers).
        size_bytes: What each stands for; not below 0 [bytes] (robots,).
    """

    receivers: Array
    payload: Array
    size_bytes: Array


def empty_inboxes(settings: MessageSettings, robots: int) -> Inboxes:
    """Return empty boxes."""
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
    )


def _through(links: Links, key: Array) -> Array:
    """Return over which links a message gets through this time (robots, robots)."""
    return random.uniform(key, links.delivery_probability.shape) < links.delivery_probability


def deliver(
    settings: MessageSettings,
    inboxes: Inboxes,
    messages: OutgoingMessages,
    links: Links,
    moment: tuple[Array, Array],
    key: Array,
) -> Inboxes:
    """Return the boxes after everyone's message went to its receivers.

    A sender's bytes are spent in the order of the receivers' slots, and on messages that do not arrive
    too: it cannot know. A box takes what arrives in the order of the senders' slots. Messages to oneself
    find no link.

    Args:
        settings: Sizes.
        inboxes: The boxes.
        messages: What is said to whom.
        links: The links that there are.
        moment: Control step and simulated time [s] (), ().
        key: For losses near the cutoff; new for every delivery.
    """
    step, time = moment
    to, capacity = messages.receivers, settings.capacity
    spent = xp.where(inboxes.step == step, inboxes.spent, 0)
    length = xp.maximum(messages.size_bytes, 0).astype(xp.int32)
    # Counted in messages, not in bytes, whose sum over many receivers could overflow.
    left = xp.maximum(settings.bytes_per_step - spent, 0)
    affordable = xp.where(length > 0, left // xp.maximum(length, 1), to.shape[-1])
    paid = to & (xp.cumsum(to, -1) <= affordable[:, None])
    linked = paid & links.in_range
    arrived = linked & _through(links, key)

    index = inboxes.count[None, :] + xp.cumsum(arrived, 0) - 1  # in the receiver's box
    fits = arrived & (index < capacity)
    # Which sender's message goes where: all other tables are looked up by it.
    robots = len(to)
    sender, receiver = np.indices((robots, robots), np.int32)
    # What does not fit goes to a place behind the box.
    where = (receiver, xp.where(fits, index, capacity))
    new_sender = set_at(xp.full((robots, capacity + 1), -1), where, sender)[:, :capacity]
    fresh, source = new_sender >= 0, xp.maximum(new_sender, 0)

    def count(dropped: Array) -> Array:
        return dropped.sum(-1, dtype=xp.int32)

    before = inboxes.dropped
    return inboxes.replace(
        count=inboxes.count + fits.sum(0, dtype=xp.int32),
        sender=xp.where(fresh, source, inboxes.sender),
        time=xp.where(fresh, time, inboxes.time),
        size_bytes=xp.where(fresh, length[source], inboxes.size_bytes),
        payload=xp.where(fresh[..., None], messages.payload[source], inboxes.payload),
        spent=spent + length * count(paid),
        step=xp.asarray(step, xp.int32),
        sent=inboxes.sent + count(to),
        dropped=DropCounts(
            over_budget=before.over_budget + count(to & ~paid),
            no_link=before.no_link + count(paid & ~links.in_range),
            lost=before.lost + count(linked & ~arrived),
            inbox_full=before.inbox_full + count(arrived & ~fits),
        ),
    )


def clear_inboxes(inboxes: Inboxes, mask: Array | bool = True) -> Inboxes:
    """Return the boxes with those of the masked robots (robots,) emptied: they have read their mail."""
    return inboxes.replace(count=xp.where(mask, 0, inboxes.count))
