"""Robots as rectangles on the plan that stay out of solids and of each other.

Where two overlap, the corner that is deepest says how they come apart: both move and turn as a push at that
place moves and turns bodies of their masses. What cannot be brought apart goes back to where it was.

Arrays have the robots last and, before them, what each may meet: so that a processor's vector units are full.
"""

from collections.abc import Callable
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.engines.planar.overlap import (
    Outlines,
    disc_depth,
    meeting_place,
    meeting_point,
    outlines,
    side_depth,
)
from usarmjx.engines.planar.solids import NOWHERE

ROUNDS = 6
"""So often robots are brought apart from what each is deepest in."""
RESTS = 3
"""So often robots that are still in something go back to where they were, before all of the world do."""
TOLERANCE = 1e-3
"""Robots may overlap by so much [m]."""


class Footprints(struct.PyTreeNode, kw_only=True):
    """Robots on the plan.

    Attributes:
        pos: Middles of the rectangles [m] (..., robots, 2).
        yaw: (..., robots).
        half: Half length and half width [m] (..., robots, 2).
        low: Lowest point [m] (..., robots).
        high: Highest point [m] (..., robots).
        step: What is no higher above the lowest point does not stop it [m] (..., robots).
        mass: [kg] (..., robots).
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
        """Cosine and sine of the way they head (..., robots, 2)."""
        return jnp.stack([jnp.cos(self.yaw), jnp.sin(self.yaw)], -1)

    @property
    def outlines(self) -> Outlines:
        """Their rectangles (..., robots)."""
        return outlines(self.pos, self.axis, self.half, jnp.zeros_like(self.yaw))


class Layout(NamedTuple):
    """Footprints of many worlds, numbers by themselves, worlds last: so that vector units are full.

    Attributes:
        outline: The rectangles (robots, worlds).
        yaw: (robots, worlds).
        low: Lowest point [m] (robots, worlds).
        high: Highest point [m] (robots, worlds).
        mass: [kg] (robots, worlds).
    """

    outline: Outlines
    yaw: Array
    low: Array
    high: Array
    mass: Array


def layout(prints: Footprints) -> Layout:
    """Return footprints (worlds, robots) with the worlds last."""
    outline = Outlines(*(part.T for part in prints.outlines))
    return Layout(outline, prints.yaw.T, prints.low.T, prints.high.T, prints.mass.T)


class DeepestOverlap(NamedTuple):
    """What each robot is deepest in.

    Attributes:
        depth: By how much the robot is in anything [m] (robots, worlds); negative: not at all.
        push: How far it has to go for its part [m] (robots, worlds).
        which: Out of which of the solids near it, or, after these, of the robots (robots, worlds).
    """

    depth: Array
    push: Array
    which: Array


class SeparationStep(NamedTuple):
    """How each robot gets out of what it is deepest in.

    Attributes:
        size: How far it has to go for its part [m] (robots, worlds).
        x: Which way: a unit vector's first number (robots, worlds).
        y: Its second (robots, worlds).
        at: Where the push is, x and y [m] (robots, worlds).
    """

    size: Array
    x: Array
    y: Array
    at: tuple[Array, Array]


class ContactCandidates(NamedTuple):
    """What robots may meet.

    Attributes:
        near: The solids that each may meet (k, robots, worlds).
        level: Which robots are at one height where they would go (robots, robots, worlds).
        level_before: Which were where they began (robots, robots, worlds).
        share: Of the way out of another that is each robot's; the other's by row (robots, robots, worlds).
        discs: Whether any solid may be a disc.
    """

    near: Outlines
    level: Array
    level_before: Array
    share: Array
    discs: bool


class Separation(NamedTuple):
    """How far robots have been brought apart.

    Attributes:
        prints: The robots.
        first: The pushes out of what they overlapped where they would go.
        depth: By how much robots overlapped when that was looked at last, not before [m] (robots, worlds).
        allowed: By how much each may overlap [m] (robots, worlds).
        touched: Whether each touched anything (robots, worlds).
        seen: What is looked at next: they, or where they were before (robots, worlds).
        stuck: Whether any robot of any world overlaps more ().
    """

    prints: Layout
    first: SeparationStep
    depth: Array
    allowed: Array
    touched: Array
    seen: Outlines
    stuck: Array


def deepest_of(robots: Outlines, around: ContactCandidates, level: Array) -> DeepestOverlap:
    """Return what robots (robots, worlds) are deepest in, for their part."""
    near, discs = around.near, around.discs

    def depth(mine: Outlines, solids: Outlines) -> Array:
        return _solid_depth(mine, solids, discs)[0]

    walls = _when((near.x < NOWHERE).any(), depth, robots, near, otherwise=-1.0)
    met = _when(level.any(), _robots_met, robots, level, otherwise=-1.0)
    # Of two robots each goes its share of the way.
    rows = [
        *walls,
        *(jnp.where(row > 0, row * share, row) for row, share in zip(met, around.share, strict=True)),
    ]
    push, which = rows[0], jnp.zeros(rows[0].shape, jnp.int32)
    for row, other in enumerate(rows[1:], 1):
        which, push = jnp.where(other > push, row, which), jnp.maximum(push, other)
    return DeepestOverlap(jnp.maximum(reduce(jnp.maximum, met, push), -1.0), push, which)


def _robots_met(robots: Outlines, level: Array) -> Array:
    """Return by how much each robot overlaps each other of its world (robots, robots, worlds)."""
    return jnp.where(level, side_depth(robots, Outlines(*(part[:, None] for part in robots)))[0], -1.0)


def push_of(
    robots: Outlines, around: ContactCandidates, found: DeepestOverlap, needed: Array | None = None
) -> SeparationStep:
    """Return how robots get out of what they are deepest in; anything, unless it is needed ()."""
    needed = jnp.bool_(True) if needed is None else needed

    def direction(mine: Outlines, solids: Outlines) -> tuple[Array, Array]:
        return _solid_depth(mine, solids, around.discs)[1:]

    worst = _when(needed, _outlines_of, found.which, around.near, robots)
    x, y = _when(needed, direction, robots, worst)
    place = _when(needed, meeting_place, robots, worst, (x, y))
    return SeparationStep(found.push, x, y, meeting_point(robots, worst, (x, y), place, discs=around.discs))


def _when(needed: Any, function: Callable[..., Any], *args: Any, otherwise: float = 0.0) -> Any:  # noqa: ANN401
    """Return what a function returns, or the same number everywhere if that is not needed.

    It is worked out once then, and kept: XLA on a processor would do so again for each use of it.
    """
    shapes = jax.eval_shape(function, *args)
    nothing = jax.tree.map(lambda one: jnp.full(one.shape, otherwise, one.dtype), shapes)
    return jax.lax.cond(needed, function, lambda *_: nothing, *args)


def _outlines_of(which: Array, near: Outlines, robots: Outlines) -> Outlines:
    """Return for each robot the outline of one of the solids that are near it, or of a robot of its world."""
    count, worlds = len(near.x), jnp.arange(which.shape[1])
    solid = (which * which.shape[0] + jnp.arange(len(which))[:, None]) * which.shape[1] + worlds
    robot = (which - count + count * which.shape[0]) * which.shape[1] + worlds
    place = jnp.where(which < count, solid, robot)

    def chosen(one: Array, other: Array) -> Array:
        return jnp.concatenate([one.reshape(-1), other.reshape(-1)]).at[place].get(mode="promise_in_bounds")

    return jax.tree.map(chosen, near, robots)


def _solid_depth(mine: Outlines, solids: Outlines, discs: bool) -> tuple[Array, Array, Array]:
    """Return by how much rectangles overlap solids, and which way they have to go (x and y)."""
    flat = side_depth(mine, solids)
    if not discs:
        return flat
    round_ = solids.radius > 0
    depth, x, y = (jnp.where(round_, *pair) for pair in zip(disc_depth(mine, solids), flat, strict=True))
    return depth, x, y


def meetings(
    before: Layout, after: Layout, near: Outlines, moves: Array, stacked: Array | None, *, discs: bool
) -> ContactCandidates:
    """Return what robots may meet; the arguments are those of `keep_apart`, worlds last."""
    # Who does not move is a wall.
    weight = jnp.where(moves, after.mass, 1e9)[:, None]
    share = weight / (weight + after.mass)
    return ContactCandidates(near, _level(after, stacked), _level(before, stacked), share, discs)


def _level(prints: Layout, stacked: Array | None) -> Array:
    """Return which robots are beside each other, not over or under (robots, robots, worlds)."""
    low, high = prints.low, prints.high
    level = (low < high[:, None]) & (low[:, None] < high) & ~jnp.eye(len(low), dtype=bool)[..., None]
    return level if stacked is None else level & ~stacked


def parted(prints: Layout, push: SeparationStep, moves: Array) -> Layout:
    """Return robots a push further out of what each is deepest in."""
    one = prints.outline
    lever = (push.at[0] - one.x) * push.y - (push.at[1] - one.y) * push.x
    # Inertia of a plate over mass: (l^2 + w^2) / 12, here of half sides.
    spread = (one.length**2 + one.width**2) / 3
    size = jnp.where(moves, jnp.maximum(push.size, 0.0), 0.0) / (1.0 + lever**2 / spread)
    x, y, yaw = one.x + size * push.x, one.y + size * push.y, prints.yaw + size * lever / spread
    return prints._replace(outline=one._replace(x=x, y=y, cos=jnp.cos(yaw), sin=jnp.sin(yaw)), yaw=yaw)


def keep_apart(
    before: Footprints,
    after: Footprints,
    near: Outlines,
    moves: Array,
    stacked: Array | None = None,
    *,
    discs: bool = True,
) -> tuple[Footprints, Array]:
    """Return robots that go from one place to another, brought apart from all that they meet.

    Once nobody in any world overlaps by more than `TOLERANCE`, all further rounds are left out: a world in
    which nobody does stays as it is in them anyway.

    Args:
        before: Where they were (worlds, robots), apart from each other; who began in something may stay as
            deep in it.
        after: Where they would go.
        near: The solids that each may meet (k, robots, worlds).
        moves: Which robots can be pushed (worlds, robots).
        stacked: Which are over or under each other, who do not meet on the plan (worlds, robots, robots);
            None: nobody is.
        discs: Whether any solid may be a disc.

    Returns:
        Where they come to, and which touched anything or were moved for others' sake (worlds, robots).
    """
    begin, end, pushable = layout(before), layout(after), moves.T
    over = None if stacked is None else jnp.moveaxis(stacked, 0, -1)
    met = meetings(begin, end, near, pushable, over, discs=discs)

    def look(number: Array, now: Separation) -> Separation:
        # One look at what overlaps, whatever is done then: it is what takes long to run and to compile.
        level = jnp.where(number == 1, met.level_before, met.level)
        return _turn(number, now, begin, pushable, met, deepest_of(now.seen, met, level))

    def turn(number: Array, now: Separation) -> Separation:
        return jax.lax.cond(now.stuck, look, lambda _, same: same, number, now)

    none = jnp.zeros(end.yaw.shape)
    start = Separation(
        end,
        SeparationStep(none, none, none, (none, none)),
        none,
        none,
        none > 0,
        end.outline,
        jnp.bool_(True),
    )
    kept = jax.lax.fori_loop(0, 2 + ROUNDS + RESTS, turn, start)
    x, y, yaw = kept.prints.outline.x.T, kept.prints.outline.y.T, kept.prints.yaw.T
    moved = (x != after.pos[..., 0]) | (y != after.pos[..., 1]) | (yaw != after.yaw)
    return after.replace(pos=jnp.stack([x, y], -1), yaw=yaw), kept.touched.T | moved


def _turn(
    number: Array,
    now: Separation,
    before: Layout,
    moves: Array,
    around: ContactCandidates,
    found: DeepestOverlap,
) -> Separation:
    """Do what it is the turn for with what robots are deepest in.

    First it is seen what they overlap where they would go; only if anybody does, how deep they were in it
    before, which they may stay; then they are brought apart.
    """
    is_first, is_second = number == 0, number == 1
    allowed = jnp.where(is_second, jnp.maximum(found.depth, TOLERANCE), now.allowed)
    allowed = jnp.where(is_first, TOLERANCE, allowed)
    depth = jnp.where(is_second, now.depth, found.depth)
    stuck = depth > allowed
    push = push_of(now.seen, around, found, stuck.any() & ~is_second)
    push = jax.tree.map(partial(jnp.where, is_second), now.first, push)
    in_world = stuck.any(0)
    goes, pushes = in_world & ~is_first, number <= ROUNDS
    back = jnp.where(number > ROUNDS + RESTS, in_world, stuck)
    apart = parted(now.prints, push, moves)

    def next_of(start: Array, here: Array, pushed: Array) -> Array:
        return jnp.where(goes, jnp.where(pushes, pushed, jnp.where(back, start, here)), here)

    prints = now.prints._replace(
        outline=jax.tree.map(next_of, before.outline, now.prints.outline, apart.outline),
        yaw=next_of(before.yaw, now.prints.yaw, apart.yaw),
    )
    seen = jax.tree.map(partial(jnp.where, is_first), before.outline, prints.outline)
    return Separation(prints, push, depth, allowed, now.touched | (depth > 0), seen, stuck.any())
