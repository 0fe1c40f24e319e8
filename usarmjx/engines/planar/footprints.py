"""Robots as rectangles on the plan that stay out of solids and of each other.

Where two overlap, the corner that is deepest says how they come apart: both move and turn as a push at that
place moves and turns bodies of their masses. What cannot be brought apart goes back to where it was.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.engines.planar.overlap import Outlines, disc_depth, meeting_point, outlines, side_depth
from usarmjx.engines.planar.solids import NOWHERE, PlanSolids

ROUNDS = 6
"""So often robots are brought apart from what each is deepest in."""
RESTS = 3
"""So often robots that are still in something go back to where they were, before all of the world do."""
TOLERANCE = 1e-3
"""Robots may overlap by so much [m]."""


class Footprints(struct.PyTreeNode, kw_only=True):
    """Robots on the plan.

    Attributes:
        pos: Middles of the rectangles [m] (robots, 2).
        yaw: (robots,).
        half: Half length and half width [m] (robots, 2).
        low: Lowest point [m] (robots,).
        high: Highest point [m] (robots,).
        step: What is no higher above the lowest point does not stop it [m] (robots,).
        mass: [kg] (robots,).
    """

    pos: Array
    yaw: Array
    half: Array
    low: Array
    high: Array
    step: Array
    mass: Array

    @property
    def axis(self) -> Array:
        """Cosine and sine of the way they head (robots, 2)."""
        return jnp.stack([jnp.cos(self.yaw), jnp.sin(self.yaw)], -1)


class Overlap(NamedTuple):
    """What each robot of a world is deepest in.

    Attributes:
        depth: By how much the robot is in anything [m] (robots,); negative: not at all.
        push: How far it has to go for its part [m] (robots,).
        normal: Which way (robots, 2).
        point: Where the push is [m] (robots, 2).
    """

    depth: Array
    push: Array
    normal: Array
    point: Array


Parting = tuple[Footprints, Array, Array, Array]
"""Robots, by how much each may overlap [m], whether each touched, whether any of its world overlaps more."""


def meets(prints: Footprints, solids: PlanSolids) -> Array:
    """Return which solids are at such a height that they stop a robot (robots, solids)."""
    dx, dy = (prints.pos[:, None, i] - solids.pos[:, i] for i in range(2))
    cos, sin = solids.axis[:, 0], solids.axis[:, 1]
    ahead = jnp.clip(dx * cos + dy * sin, -solids.half[:, 0], solids.half[:, 0])
    aside = jnp.clip(dy * cos - dx * sin, -solids.half[:, 1], solids.half[:, 1])
    rise = (ahead * cos - aside * sin) * solids.slope[:, 0] + (ahead * sin + aside * cos) * solids.slope[:, 1]
    above = solids.top + rise > (prints.low + prints.step)[:, None]
    return above & (solids.low < prints.high[:, None]) & (solids.highest > prints.low[:, None])


def near_solids(prints: Footprints, solids: PlanSolids, most: int, reach: float) -> tuple[PlanSolids, Array]:
    """Return the solids that a robot may meet soonest, and how many more are near.

    Args:
        prints: The robots.
        solids: All solids.
        most: So many for each robot.
        reach: What is farther from a robot's rectangle counts as far [m].

    Returns:
        Solids with another leading axis (robots, most), those that do not stop the robot far away; and how
        many were left out (robots,).
    """
    count = solids.radius.shape[0]
    if not count:
        return jax.tree.map(lambda x: jnp.zeros((len(prints.yaw), 0, *x.shape[1:]), x.dtype), solids), (
            jnp.zeros(prints.yaw.shape, jnp.int32)
        )
    dx, dy = (prints.pos[:, None, i] - solids.pos[:, i] for i in range(2))
    cos, sin = solids.axis[:, 0], solids.axis[:, 1]
    ahead = jnp.maximum(jnp.abs(dx * cos + dy * sin) - solids.half[:, 0], 0.0)
    aside = jnp.maximum(jnp.abs(dy * cos - dx * sin) - solids.half[:, 1], 0.0)
    gap = jnp.sqrt(ahead * ahead + aside * aside) - solids.radius
    gap = gap - jnp.linalg.norm(prints.half, axis=-1)[:, None]
    gap = jnp.where(meets(prints, solids), gap, NOWHERE)
    most = min(most, count)
    nearness, which = jax.lax.top_k(-gap, most)
    left_out = jnp.maximum((gap < reach).sum(-1) - most, 0)
    near = jax.tree.map(lambda x: x[which], solids)
    far = nearness < -reach
    return near.replace(pos=jnp.where(far[..., None], NOWHERE, near.pos)), left_out.astype(jnp.int32)


def overlaps(prints: Footprints, near: PlanSolids, moves: Array, stacked: Array | None = None) -> Overlap:
    """Return what each robot of a world is deepest in, for its part."""
    count = len(prints.yaw)
    zero = jnp.zeros(count)
    robots = outlines(prints.pos, prints.axis, prints.half, zero)
    walls = outlines(near.pos, near.axis, near.half, near.radius)
    others = Outlines(
        *(
            jnp.concatenate([w, jnp.broadcast_to(r, (count, count))], -1)
            for w, r in zip(walls, robots, strict=True)
        )
    )
    mine = Outlines(*(part[:, None] for part in robots))
    depth, x, y = side_depth(mine, others)
    if near.discs:
        round_ = others.radius > 0
        parts = zip(disc_depth(mine, others), (depth, x, y), strict=True)
        depth, x, y = (jnp.where(round_, disc, flat) for disc, flat in parts)
    # Of two robots each goes its share of the way; one that does not move is a wall.
    level = (prints.low[:, None] < prints.high) & (prints.low < prints.high[:, None])
    level &= ~(jnp.eye(count, dtype=bool) if stacked is None else stacked | jnp.eye(count, dtype=bool))
    weight = jnp.where(moves, prints.mass, 1e9)
    share = jnp.where(level, weight / (weight + prints.mass[:, None]), 0.0)
    walled = jnp.ones_like(near.radius)
    stops = jnp.concatenate([walled > 0, level], -1)
    depth = jnp.where(stops, depth, -1.0)
    push = depth * jnp.where(depth > 0, jnp.concatenate([walled, share], -1), 1.0)
    which = jnp.argmax(push, -1)[:, None]
    worst = [jnp.take_along_axis(part, which, -1)[:, 0] for part in (push, x, y, *others)]
    point = meeting_point(robots, Outlines(*worst[3:]), (worst[1], worst[2]))
    return Overlap(
        depth=depth.max(-1, initial=-1.0),
        push=worst[0],
        normal=jnp.stack(worst[1:3], -1),
        point=jnp.stack(point, -1),
    )


def parted(prints: Footprints, found: Overlap, moves: Array) -> Footprints:
    """Return robots of a world a push further out of what each is deepest in."""
    push = jnp.where(moves, jnp.maximum(found.push, 0.0), 0.0)
    arm = found.point - prints.pos
    lever = arm[:, 0] * found.normal[:, 1] - arm[:, 1] * found.normal[:, 0]
    # Inertia of a plate over mass: (l^2 + w^2) / 12, here of half sides.
    spread = (prints.half**2).sum(-1) / 3
    size = push / (1.0 + lever**2 / spread)
    return prints.replace(
        pos=prints.pos + size[:, None] * found.normal, yaw=prints.yaw + size * lever / spread
    )


def keep_apart(
    before: Footprints, after: Footprints, near: PlanSolids, moves: Array, stacked: Array | None = None
) -> tuple[Footprints, Array]:
    """Return robots that go from one place to another, brought apart from all that they meet.

    Once nobody in any world overlaps by more than `TOLERANCE`, all further rounds are left out: a world in
    which nobody does stays as it is in them anyway.

    Args:
        before: Where they were (worlds, robots), apart from each other; who began in something may stay as
            deep in it.
        after: Where they would go.
        near: The solids that each may meet (worlds, robots, k).
        moves: Which robots can be pushed (worlds, robots).
        stacked: Which are over or under each other, who do not meet on the plan (worlds, robots, robots);
            None: nobody is.

    Returns:
        Where they come to, and which touched anything or were moved for others' sake (worlds, robots).
    """

    def look(number: Array, now: Parting) -> Parting:
        # One look at what overlaps, whatever is done then: it is what takes long to run and to compile.
        return jax.vmap(_turn, (None, 0, 0, 0, 0, 0, 0))(number, now, before, after, near, moves, stacked)

    def turn(number: Array, now: Parting) -> Parting:
        goes_on = (number < 2) | now[3].any()
        return jax.lax.cond(goes_on, look, lambda _, same: same, number, now)

    none = jnp.zeros(before.yaw.shape)
    turns, start = 2 + ROUNDS + RESTS, (before, none, none > 0, none[:, 0] > 0)
    kept, _, touched, _ = jax.lax.fori_loop(0, turns, turn, start)
    moved = (kept.pos != after.pos).any(-1) | (kept.yaw != after.yaw)
    return kept, touched | moved


def _turn(
    number: Array,
    now: Parting,
    before: Footprints,
    after: Footprints,
    near: PlanSolids,
    moves: Array,
    stacked: Array | None,
) -> Parting:
    """Look at where the robots of a world overlap, and do what it is the turn for.

    `now` and the result are a world's part of `Parting`.
    """
    prints, allowed, touched, _ = now
    found = overlaps(prints, near, moves, stacked)
    stuck = found.depth > allowed
    apart = parted(prints, found, moves)
    back = jnp.where(number > ROUNDS + RESTS, stuck.any(), stuck)
    is_first = number == 0

    def next_of(start: Array, end: Array, pushed: Array) -> Array:
        rested = jnp.where(back[(...,) + (None,) * (start.ndim - 1)], start, end)
        return jnp.where(stuck.any(), jnp.where(number <= ROUNDS, pushed, rested), end)

    following = prints.replace(
        pos=next_of(before.pos, prints.pos, apart.pos), yaw=next_of(before.yaw, prints.yaw, apart.yaw)
    )
    return (
        jax.tree.map(partial(jnp.where, is_first), after, following),
        jnp.where(is_first, jnp.maximum(found.depth, TOLERANCE), allowed),
        touched | (~is_first & (found.depth > 0)),
        stuck.any() | is_first,
    )
