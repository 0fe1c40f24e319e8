"""What each robot of a team knows: its own map, what others told it, and where it will go next.

Pure functions; leading axes are over the robots of one world, by roster slot. Nothing of this is known to a
robot but by its own sensors and by mail that came over the radio.
"""

import itertools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.transforms import Array
from usarmjx.comms.mail import Letters, Mail
from usarmjx.sensors.ranging import ScannerSettings
from usarmjx.train.mapping import maps
from usarmjx.train.mapping.maps import MapGrid
from usarmjx.train.mapping.wavefront import FAR

HEADER = 6
"""Numbers of a message before the map: where the sender is (x, y, yaw), where it is going (x, y), and its
last contact with the base (a time)."""
SECTORS = 12
"""Sectors in which scans are looked at for what is near."""
RANGE = 4.0
"""Of the scanners [m]: see `equip`."""
OPEN = 100.0
"""What a robot without a scanner sees in every sector [m]."""
STALE = 20.0
"""After so long without a word a robot does not know where another one is [s]."""
RECENT = 1.0
"""For so long after its last word a robot is taken to be where it was [s]."""
BESIDE = 0.75
"""A robot has been at a place that it was so near to [m]."""
BODY = 0.65
"""What a scanner meets so near to another robot's middle is that robot, not a wall [m]."""


class Knowledge(struct.PyTreeNode, kw_only=True):
    """What the robots of one world know (robots, ...).

    Attributes:
        evidence: Their own looks at squares; see `maps.weigh` (robots, i, j).
        marked: Where they have seen what they look for (robots, i, j).
        told: What others told them of squares (robots, i, j).
        been: Where they have been (robots, i, j).
        pose: Where they believe to be: x, y [m] and yaw [rad] (robots, 3).
        mates: What they last heard of each other: the header of the message; row listener, column sender
            (robots, robots, HEADER).
        heard: When that was; at the start they know where all are [s] (robots, robots).
        since: Since when each hears from each without a break [s] (robots, robots).
        contact: What each knew until then has come to the base, as far as it can know [s] (robots,).
        news: When each last learned of a mark [s] (robots,).
        clear: How far they see: the shortest beam of each of `SECTORS` sectors of their scanners, from right
            to left [m] (robots, SECTORS).
        trail: Where they were some time ago, smoothed [m] (robots, 2).
        next: The next place on their way [m] (robots, 2).
        goal: Where that leads, as they tell it [m] (robots, 2).
        far: How long it is, with all penalties; `wavefront.FAR`: there is no way [squares] (robots,).
    """

    evidence: Array
    marked: Array
    told: Array
    been: Array
    pose: Array
    mates: Array
    heard: Array
    since: Array
    contact: Array
    news: Array
    clear: Array
    trail: Array
    next: Array
    goal: Array
    far: Array

    @property
    def squares(self) -> jax.Array:
        """What each knows of each square; see `maps.known` (robots, i, j)."""
        return maps.known(self.evidence, self.marked, self.told)


def ignorance(grid: MapGrid, pose: Array) -> Knowledge:
    """Return what robots know that stand at poses (robots, 3) and have seen nothing yet.

    They know where the others start.
    """
    robots = pose.shape[0]
    table = (robots, *grid.shape)
    others = jnp.concatenate([pose, pose[:, :2], jnp.zeros((robots, 1))], -1)
    return Knowledge(
        evidence=jnp.zeros(table, jnp.int8),
        marked=jnp.zeros(table, bool),
        told=jnp.zeros(table, jnp.uint8),
        been=jnp.zeros(table, bool),
        pose=pose,
        mates=jnp.broadcast_to(others, (robots, robots, HEADER)),
        heard=jnp.zeros((robots, robots)),
        since=jnp.zeros((robots, robots)),
        contact=jnp.zeros(robots),
        news=jnp.zeros(robots),
        clear=jnp.full((robots, SECTORS), OPEN),
        trail=pose[:, :2] + 1.0,  # not here: they have not stood still yet
        next=pose[:, :2],
        goal=pose[:, :2],
        far=jnp.full(robots, FAR),
    )


def others(robots: int) -> np.ndarray:
    """Return the slots of all others for each of some robots, in order (robots, robots - 1)."""
    return np.array([[j for j in range(robots) if j != i] for i in range(robots)], int).reshape(robots, -1)


@dataclass(frozen=True)
class Scan:
    """What the scanners of some robots say.

    Attributes:
        slots: Whose they are.
        settings: Of the scanner.
        poses: Where the scanners believe to be: x, y [m], yaw [rad] (robots here, 3).
        ranges: What they measured [m] (robots here, beams).
        fresh: Whether that was now (robots here,).
    """

    slots: np.ndarray
    settings: ScannerSettings
    poses: Array
    ranges: Array
    fresh: Array


def sectors(ranges: Array) -> jax.Array:
    """Return the shortest beam of each of `SECTORS` sectors of a scan (..., beams) [m] (..., SECTORS)."""
    beams = ranges.shape[-1]
    edges = np.round(np.linspace(0, beams, SECTORS + 1)).astype(int)
    return jnp.stack([ranges[..., a:b].min(-1) for a, b in itertools.pairwise(edges)], -1)


def see(grid: MapGrid, mind: Knowledge, scan: Scan, time: Array) -> Knowledge:
    """Return what robots know after their scanners looked.

    Walls are not drawn where another robot said a moment ago to be.
    """
    evidence, heard = mind.evidence[scan.slots], mind.heard[scan.slots]
    mates = mind.mates[scan.slots, :, :2]

    def one(old: Array, pose: Array, ranges: Array, others: Array, when: Array) -> jax.Array:
        free, wall = maps.look(grid, scan.settings, pose, ranges)
        gap = jnp.linalg.norm(grid.middles[:, :, None] - others, axis=-1)
        robot = ((gap < BODY) & (time - when < RECENT)).any(-1)
        return maps.weigh(old, free, wall & ~robot)

    drawn = jax.vmap(one)(evidence, scan.poses, scan.ranges, mates, heard)
    drawn = jnp.where(scan.fresh[:, None, None], drawn, evidence)
    return mind.replace(
        evidence=mind.evidence.at[scan.slots].set(drawn),
        clear=mind.clear.at[scan.slots].set(sectors(scan.ranges)),
    )


def letters(mind: Knowledge, to: Array, flyers: np.ndarray | None = None) -> Letters:
    """Return what all robots say to others (robots, robots): where they are and go, and all they know.

    What flying robots (robots,) have looked at they keep for themselves: it says nothing of walls.
    """
    header = jnp.concatenate([mind.pose, mind.goal, mind.contact[:, None]], -1)
    if flyers is not None:
        mind = mind.replace(evidence=jnp.where(flyers[:, None, None], 0, mind.evidence))
    payload = jnp.concatenate([header, jax.vmap(maps.pack)(mind.squares)], -1)
    length = jnp.full(len(header), 4 * payload.shape[-1], jnp.int32)
    return Letters(to=to, payload=payload, length=length)


def listen(grid: MapGrid, mind: Knowledge, mail: Mail, period: float) -> Knowledge:
    """Return what robots know after they read their mail.

    A robot that hears from another every time has told it all it knew each time: links go both ways. So, if
    that one says when it had contact with the base, what the robot had told it before has come there.

    Args:
        grid: The squares.
        mind: What they knew.
        mail: Their boxes.
        period: Time between two messages of a robot [s].
    """

    def one(own: tuple[Array, ...], box: Mail) -> tuple[Array, ...]:
        def word(state: tuple[Array, ...], place: Array) -> tuple[tuple[Array, ...], None]:
            told, mates, heard, since, contact = state
            there, sender = place < box.count, box.sender[place]
            payload, time = box.payload[place], box.time[place]
            news = maps.unpack(payload[HEADER:], grid.shape)
            begun = jnp.where(time - heard[sender] > 1.5 * period, time, since[sender])
            passed_on = jnp.minimum(payload[HEADER - 1] - period, heard[sender])
            passed_on = jnp.where(passed_on >= begun - 1e-3, passed_on, contact)
            new = (
                maps.hear(told, news),
                mates.at[sender].set(payload[:HEADER]),
                heard.at[sender].set(time),
                since.at[sender].set(begun),
                jnp.maximum(contact, passed_on),
            )
            return tuple(jnp.where(there, a, b) for a, b in zip(new, state, strict=True)), None

        return jax.lax.scan(word, own, jnp.arange(box.sender.shape[-1]))[0]

    box = mail.replace(spent=mail.count, step=mail.count, sent=mail.count)  # an axis over robots for all
    before = (mind.told, mind.mates, mind.heard, mind.since, mind.contact)
    told, mates, heard, since, contact = jax.vmap(one)(before, box)
    return mind.replace(told=told, mates=mates, heard=heard, since=since, contact=contact)


def touch_base(mind: Knowledge, linked: Array, base: int, time: Array) -> Knowledge:
    """Return what robots know that see which links of theirs hold (robots, robots)."""
    direct = linked[:, base] | (jnp.arange(linked.shape[0]) == base)
    return mind.replace(contact=jnp.where(direct, time, mind.contact))


def moved(grid: MapGrid, mind: Knowledge, pose: Array, share: float = 0.05) -> Knowledge:
    """Return what robots know after they looked at their INS: poses (robots, 3).

    Args:
        grid: The squares.
        mind: What they knew.
        pose: Where they believe to be.
        share: Of the way to the present place that `trail` goes: with 0.05, it is some 20 steps late.
    """
    trail = mind.trail + share * (pose[:, :2] - mind.trail)
    here = jnp.linalg.norm(grid.middles - pose[:, None, None, :2], axis=-1) < BESIDE
    return mind.replace(pose=pose, trail=trail, been=mind.been | here)
