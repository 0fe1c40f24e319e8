"""Beliefs of each robot of a team: its own map, the maps it received, where it is and will go next.

Pure functions; leading axes are over the robots of one world, by roster slot. Beliefs come from a robot's own
sensors and from mail that came over the radio, never from the truth.
"""

import itertools
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.backend import Array, get_rows, set_rows
from usarmjx.comms.mail import Inboxes, OutgoingMessages
from usarmjx.sensors.ranging import ScannerSettings
from usarmjx.train.mapping import maps
from usarmjx.train.mapping.maps import MapGrid
from usarmjx.train.mapping.wavefront import UNREACHABLE

HEADER_SIZE = 6
"""Numbers of a message before the map: where the sender is (x, y, yaw), where it is going (x, y), and its
last contact with the base (a time)."""
ABSENT = 1e6
"""Number of a header that a message does not have."""
SECTOR_COUNT = 12
"""Sectors that scans are reduced to."""
SCANNER_RANGE = 4.0
"""Of the scanners [m]: see `equip.HOKUYO`."""
NO_SCANNER_RANGE = 100.0
"""Range in every sector of a robot without a scanner [m]."""
STALE_AGE = 20.0
"""After so long without a message a robot does not know where another one is [s]."""
RECENT_AGE = 1.0
"""For so long after its last message a robot is taken to be where it was [s]."""
VISITED_RADIUS = 0.75
"""A robot has visited squares whose middles it was so near to [m]."""
BODY = 0.65
"""Distance from another robot's middle within which an echo is that robot, not a wall [m]."""


class Belief(struct.PyTreeNode, kw_only=True):
    """Beliefs of the robots of one world.

    Attributes:
        evidence: Evidence of their own scans about squares; see `maps.update_evidence` (robots, i, j).
        marks: Sightings of what they look for (robots, i, j).
        received_map: Squares in the maps that came by mail (robots, i, j).
        visited: Squares visited (robots, i, j).
        pose: Believed poses: x, y [m] and yaw [rad] (robots, 3).
        mate_headers: Headers of the last messages from each other; row receiver, column sender
            (robots, robots, HEADER_SIZE).
        heard_time: When those came; at the start they know where all are [s] (robots, robots).
        link_since: Since when each hears from each without a break [s] (robots, robots).
        base_contact_time: Time until which each one's beliefs have come to the base, as far as it can know
            [s] (robots,).
        mark_time: When each last learned of a mark [s] (robots,).
        sector_ranges: The shortest beam of each sector of their scanners, from right to left [m]
            (robots, SECTOR_COUNT).
        lagged_position: Smoothed positions of some time ago [m] (robots, 2).
        waypoint: The next position on their path [m] (robots, 2).
        goal: End of that way, as they send it [m] (robots, 2).
        path_length: Length of that way, with all costs; `wavefront.UNREACHABLE`: there is none [squares]
            (robots,).
    """

    evidence: jax.Array
    marks: jax.Array
    received_map: jax.Array
    visited: jax.Array
    pose: jax.Array
    mate_headers: jax.Array
    heard_time: jax.Array
    link_since: jax.Array
    base_contact_time: jax.Array
    mark_time: jax.Array
    sector_ranges: jax.Array
    lagged_position: jax.Array
    waypoint: jax.Array
    goal: jax.Array
    path_length: jax.Array

    @property
    def squares(self) -> jax.Array:
        """Belief of each robot about each square; see `maps.fuse_maps` (robots, i, j)."""
        return maps.fuse_maps(self.evidence, self.marks, self.received_map)


def initial_belief(grid: MapGrid, pose: jax.Array) -> Belief:
    """Return the belief of robots that stand at poses (robots, 3) and have scanned nothing yet.

    They know where the others start.
    """
    robots = pose.shape[0]
    table = (robots, *grid.shape)
    # The goal of each is where it stands, until its first message says more.
    others = jnp.concatenate([pose, pose[:, :2], jnp.zeros((robots, 1))], -1)
    return Belief(
        evidence=jnp.zeros(table, jnp.int8),
        marks=jnp.zeros(table, bool),
        received_map=jnp.zeros(table, jnp.uint8),
        visited=jnp.zeros(table, bool),
        pose=pose,
        mate_headers=jnp.broadcast_to(others, (robots, robots, HEADER_SIZE)),
        heard_time=jnp.zeros((robots, robots)),
        link_since=jnp.zeros((robots, robots)),
        base_contact_time=jnp.zeros(robots),
        mark_time=jnp.zeros(robots),
        sector_ranges=jnp.full((robots, SECTOR_COUNT), NO_SCANNER_RANGE),
        lagged_position=pose[:, :2] + 1.0,  # not here: they have not stood still yet
        waypoint=pose[:, :2],
        goal=pose[:, :2],
        path_length=jnp.full(robots, UNREACHABLE),
    )


def other_slots(robots: int) -> np.ndarray:
    """Return the slots of all others for each of some robots, in order (robots, robots - 1)."""
    return np.array([[j for j in range(robots) if j != i] for i in range(robots)], int).reshape(robots, -1)


@dataclass(frozen=True)
class GroupScan:
    """Readings of the scanners of one group's robots.

    Attributes:
        slots: Whose they are (robots,).
        settings: Of the scanner.
        poses: Believed poses of the scanners: x, y [m], yaw [rad] (robots, 3).
        ranges: Ranges [m] (robots, beams).
        fresh: Whether that was now (robots,).
    """

    slots: np.ndarray
    settings: ScannerSettings
    poses: jax.Array
    ranges: jax.Array
    fresh: jax.Array


def sectors(ranges: Array) -> jax.Array:
    """Return the shortest beam of each sector of a scan (..., beams) [m] (..., SECTOR_COUNT)."""
    beams = ranges.shape[-1]
    # Rounded edges: sectors differ by a beam at most when their number does not divide the beams.
    edges = np.round(np.linspace(0, beams, SECTOR_COUNT + 1)).astype(int)
    return jnp.stack([ranges[..., a:b].min(-1) for a, b in itertools.pairwise(edges)], -1)


def update_from_scan(
    grid: MapGrid, belief: Belief, scan: GroupScan, time: Array, recent: float = RECENT_AGE
) -> Belief:
    """Return the belief after a group's scans.

    Walls are not drawn where another robot said a moment ago to be.

    Args:
        grid: The squares.
        belief: That before it.
        scan: The scans.
        time: The time [s] ().
        recent: Age of a message from which on it does not count [s].
    """
    evidence, heard = (get_rows(rows, scan.slots) for rows in (belief.evidence, belief.heard_time))
    mates = get_rows(belief.mate_headers, scan.slots)[..., :2]

    def one(
        old: jax.Array, pose: jax.Array, ranges: jax.Array, others: jax.Array, when: jax.Array
    ) -> jax.Array:
        free, wall = maps.classify_scan(grid, scan.settings, pose, ranges)
        # The margin is of single precision: ages are whole steps, and one of them may be just this age.
        new = (time - when < recent - 1e-3)[:, None, None]
        robot = ((grid.squared_gaps(others) < BODY**2) & new).any(0)
        return maps.update_evidence(old, free, wall & ~robot)

    drawn = jax.vmap(one)(evidence, scan.poses, scan.ranges, mates, heard)
    # Evidence counts scans: an old reading that is seen again must not count twice.
    drawn = jnp.where(scan.fresh[:, None, None], drawn, evidence)
    return belief.replace(
        evidence=set_rows(belief.evidence, (scan.slots, drawn)),
        sector_ranges=set_rows(belief.sector_ranges, (scan.slots, sectors(scan.ranges))),
    )


def headers(belief: Belief) -> jax.Array:
    """Return the headers of the robots' messages (robots, HEADER_SIZE)."""
    return jnp.concatenate([belief.pose, belief.goal, belief.base_contact_time[:, None]], -1)


def compose_messages(belief: Belief, to: Array, flyers: np.ndarray | None = None) -> OutgoingMessages:
    """Return the messages of all robots to others (robots, robots): where they are and go, and their maps.

    Flying robots (robots,) do not send their sightings: it says nothing of walls.
    """
    header = headers(belief)
    if flyers is not None:
        belief = belief.replace(evidence=jnp.where(flyers[:, None, None], 0, belief.evidence))
    payload = jnp.concatenate([header, jax.vmap(maps.pack)(belief.squares)], -1)
    # A number of single precision takes 4 bytes.
    length = jnp.full(len(header), 4 * payload.shape[-1], jnp.int32)
    return OutgoingMessages(receivers=to, payload=payload, size_bytes=length)


def update_from_mail(grid: MapGrid, belief: Belief, mail: Inboxes, period: float) -> Belief:
    """Return the belief after robots read their mail.

    A robot that hears from another every time has sent it all it believed each time: links go both ways. So,
    if that one says when it had contact with the base, what the robot had sent it before has come there.

    Args:
        grid: The squares.
        belief: That before it.
        mail: Their boxes.
        period: Time between two messages of a robot [s]; 0: messages hold parts of maps only, and nothing
            follows from their times.
    """
    told = jnp.asarray(mail.payload)[..., :HEADER_SIZE]
    packed = jnp.asarray(mail.payload)[..., HEADER_SIZE : HEADER_SIZE + grid.packed_size]
    read = jax.vmap(partial(_read_headers, period))(
        (belief.mate_headers, belief.heard_time, belief.link_since, belief.base_contact_time),
        (mail.valid, mail.sender, mail.time, told),
    )
    mates, heard, since, contact = read
    return belief.replace(
        received_map=jax.vmap(maps.merge_packed)(belief.received_map, packed, mail.valid),
        mate_headers=mates,
        heard_time=heard,
        link_since=since,
        base_contact_time=contact,
    )


def _read_headers(
    period: float, before: tuple[Array, Array, Array, Array], box: tuple[Array, Array, Array, Array]
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return a robot's rows of `Belief` after it read its box; at once what one after another comes to.

    Args:
        period: See `update_from_mail`.
        before: Its `mate_headers` (robots, HEADER_SIZE), `heard_time` and `link_since` (robots,), and
            `base_contact_time` ().
        box: Which places hold a message, senders, times (capacity,), and headers (capacity, HEADER_SIZE).
    """
    (mates, heard, since, contact), (there, sender, time, told) = before, box
    place, robots = np.arange(len(sender)), np.arange(len(heard))
    same = (sender[:, None] == sender) & there & (place[:, None] > place)  # its sender's, and before it

    def last(which: Array) -> jax.Array:
        """Return the last place of some (..., capacity); -1: there is none."""
        return jnp.max(jnp.where(which, place, -1), -1, initial=-1)

    ago = last(same)
    # An index of -1 reads the last message, which this discards: the sender's one before came in an earlier
    # box.
    until_then = jnp.where(ago < 0, heard[sender], time[ago])
    # A message that did not come breaks the link: what was sent in between was not received.
    # One and a half periods: one message may be late by rounding, none may be missing.
    broken = last((same | (place[:, None] == place)) & (time - until_then > 1.5 * period))
    begun = jnp.where(broken < 0, since[sender], time[broken])
    # All that it had from this robot by its contact is at the base: a message takes a period.
    passed_on = jnp.minimum(told[:, HEADER_SIZE - 1] - period, until_then)
    # The margin is of single precision: times of some thousand seconds are exact to a tenth of that.
    known = jnp.where(there & (passed_on >= begun - 1e-3), passed_on, -jnp.inf)
    newest = last(there & (sender == robots[:, None]))
    # An index of -1 reads the last message: this mask discards it below.
    news = newest >= 0
    return (
        jnp.where(news[:, None] & (told[newest] != ABSENT), told[newest], mates),
        jnp.where(news, time[newest], heard),
        jnp.where(news, begun[newest], since),
        jnp.maximum(contact, jnp.max(known, initial=-jnp.inf)),
    )


def update_base_contact(belief: Belief, linked: Array, base: int, time: Array) -> Belief:
    """Return the belief of robots that see which links of theirs hold (robots, robots)."""
    # A base needs no radio to know its own beliefs.
    direct = linked[:, base] | (jnp.arange(linked.shape[0]) == base)
    return belief.replace(base_contact_time=jnp.where(direct, time, belief.base_contact_time))


def update_pose(grid: MapGrid, belief: Belief, pose: jax.Array, share: float = 0.05) -> Belief:
    """Return the belief after robots read their INS: poses (robots, 3).

    Args:
        grid: The squares.
        belief: That before it.
        pose: Believed poses.
        share: Of the way to the present position that `lagged_position` goes: with 0.05 it is some 20 steps
            late.
    """
    lagged = belief.lagged_position + share * (pose[:, :2] - belief.lagged_position)
    here = grid.squared_gaps(pose[:, :2]) < VISITED_RADIUS**2
    return belief.replace(pose=pose, lagged_position=lagged, visited=belief.visited | here)
