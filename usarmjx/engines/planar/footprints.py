"""Robots as rectangles on the plan that stay out of solids and of each other.

Where two overlap, the corner that is deepest says how they come apart: both move and turn as a push at that
place moves and turns bodies of their masses. What cannot be brought apart goes back to where it was.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.engines.planar.solids import NOWHERE, PlanSolids

ROUNDS = 6
"""So often robots are brought apart from what each is deepest in."""
RESTS = 3
"""So often robots that are still in something go back to where they were, before all of the world do."""
TOLERANCE = 1e-3
"""Robots may overlap by so much [m]."""
FLAT = 1e-3
"""A side whose corners are as near but for so much lies flat [m]."""
CORNERS = ((1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0))


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


class Overlap(NamedTuple):
    """Where a robot and another thing overlap most; leading axes over the pairs.

    Attributes:
        depth: By how much [m] (...,); negative: not at all.
        normal: Which way the robot has to go (..., 2).
        point: Where [m] (..., 2).
    """

    depth: Array
    normal: Array
    point: Array


def _turned(vector: Array, axis: Array) -> Array:
    """Return vectors (..., 2) given along an axis (..., 2), on the plan."""
    x, y = vector[..., 0], vector[..., 1]
    return jnp.stack([x * axis[..., 0] - y * axis[..., 1], x * axis[..., 1] + y * axis[..., 0]], -1)


def _within(vector: Array, axis: Array) -> Array:
    """Return vectors (..., 2) of the plan along an axis (..., 2)."""
    x, y = vector[..., 0], vector[..., 1]
    return jnp.stack([x * axis[..., 0] + y * axis[..., 1], y * axis[..., 0] - x * axis[..., 1]], -1)


def _corners(pos: Array, axis: Array, half: Array) -> Array:
    """Return the corners (..., 4, 2) of rectangles."""
    signs = jnp.array(CORNERS)
    return pos[..., None, :] + _turned(signs * half[..., None, :], axis[..., None, :])


def _deepest(depth: Array, normal: Array, point: Array) -> Overlap:
    """Return the deepest of several touches along the last axis (..., n)."""
    which = jnp.argmax(depth, -1)[..., None]
    pick = partial(jnp.take_along_axis, axis=-2)
    return Overlap(
        depth=jnp.take_along_axis(depth, which, -1)[..., 0],
        normal=pick(normal, which[..., None])[..., 0, :],
        point=pick(point, which[..., None])[..., 0, :],
    )


def touch(pos: Array, axis: Array, half: Array, other: tuple[Array, Array, Array, Array]) -> Overlap:
    """Return by how much rectangles overlap with other things; arguments are broadcast (..., 2).

    By the theorem of the separating axis: the way out is the shortest of those along the four sides' normals,
    to the side where the rectangle's middle is, so that nothing gets through a thin wall.

    Args:
        pos: Middles [m] (..., 2).
        axis: Cosine and sine of their ways (..., 2).
        half: Half sides [m] (..., 2).
        other: The same of the other things, and their radius (...,), which of rectangles is 0.
    """
    there, along, sides, radius = other
    shape = np.broadcast_shapes(pos.shape, there.shape)
    pos, axis, half, there, along, sides = (
        jnp.broadcast_to(x, shape) for x in (pos, axis, half, there, along, sides)
    )
    normals = jnp.stack([axis, _across(axis), along, _across(along)], -2)
    apart = ((pos - there)[..., None, :] * normals).sum(-1)
    depth = _reach(axis, half, normals) + _reach(along, sides, normals) - jnp.abs(apart)
    which = jnp.argmin(depth, -1)[..., None]
    normal = jnp.take_along_axis(normals * jnp.sign(apart + 1e-12)[..., None], which[..., None], -2)[
        ..., 0, :
    ]
    flat = Overlap(
        depth=jnp.take_along_axis(depth, which, -1)[..., 0],
        normal=normal,
        point=_meeting_point(_corners(pos, axis, half), _corners(there, along, sides), normal),
    )
    disc = _disc(pos, axis, half, there, radius)
    round_ = jnp.broadcast_to(radius, shape[:-1]) > 0
    return Overlap(
        depth=jnp.where(round_, disc.depth, flat.depth),
        normal=jnp.where(round_[..., None], disc.normal, flat.normal),
        point=jnp.where(round_[..., None], disc.point, flat.point),
    )


def _across(axis: Array) -> Array:
    """Return axes (..., 2) turned to the left."""
    return jnp.stack([-axis[..., 1], axis[..., 0]], -1)


def _reach(axis: Array, half: Array, normals: Array) -> Array:
    """Return how far rectangles reach from their middles along directions (..., 4, 2)."""
    ahead = jnp.abs((axis[..., None, :] * normals).sum(-1))
    aside = jnp.abs((_across(axis)[..., None, :] * normals).sum(-1))
    return half[..., :1] * ahead + half[..., 1:] * aside


def _meeting_point(mine: Array, theirs: Array, normal: Array) -> Array:
    """Return where two rectangles meet (..., 2): in the middle of what their nearest corners have in common.

    Args:
        mine: Corners of what has to go along the normal [m] (..., 4, 2).
        theirs: Corners of the other [m] (..., 4, 2).
        normal: The way out (..., 2).
    """
    across = _across(normal)
    low, high = (mine * normal[..., None, :]).sum(-1), (theirs * normal[..., None, :]).sum(-1)
    bottom, top = low.min(-1, keepdims=True), high.max(-1, keepdims=True)

    def span(corners: Array, nearest: Array) -> tuple[Array, Array]:
        place = (corners * across[..., None, :]).sum(-1)
        return jnp.where(nearest, place, jnp.inf).min(-1), jnp.where(nearest, place, -jnp.inf).max(-1)

    first, last = span(mine, low < bottom + FLAT)
    start, end = span(theirs, high > top - FLAT)
    middle = (jnp.maximum(first, start) + jnp.minimum(last, end)) / 2
    return middle[..., None] * across + (bottom + top) / 2 * normal


def _disc(pos: Array, axis: Array, half: Array, there: Array, radius: Array) -> Overlap:
    """Return where rectangles and discs overlap."""
    own = _within(there - pos, axis)
    nearest = jnp.clip(own, -half, half)
    apart = own - nearest
    far = jnp.linalg.norm(apart, axis=-1)
    out = apart / jnp.maximum(far, 1e-9)[..., None]
    # A middle inside: by the nearest side.
    gap = half - jnp.abs(own)
    side = jnp.arange(2) == jnp.argmin(gap, -1)[..., None]
    inner = jnp.where(side, jnp.where(own < 0, -1.0, 1.0), 0.0)
    is_in = far < 1e-9
    depth = jnp.where(is_in, radius + gap.min(-1), radius - far)
    normal = -_turned(jnp.where(is_in[..., None], inner, out), axis)
    return Overlap(depth, normal, pos + _turned(nearest, axis))


def meets(prints: Footprints, solids: PlanSolids) -> Array:
    """Return which solids are at such a height that they stop a robot (robots, solids)."""
    apart = prints.pos[:, None] - solids.pos
    own = _within(apart, solids.axis)
    over = _turned(jnp.clip(own, -solids.half, solids.half), solids.axis)
    height = solids.top + (over * solids.slope).sum(-1)
    above = height > (prints.low + prints.step)[:, None]
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
    own = _within(prints.pos[:, None] - solids.pos, solids.axis)
    gap = jnp.linalg.norm(own - jnp.clip(own, -solids.half, solids.half), axis=-1) - solids.radius
    gap = gap - jnp.linalg.norm(prints.half, axis=-1)[:, None]
    gap = jnp.where(meets(prints, solids), gap, NOWHERE)
    most = min(most, count)
    nearness, which = jax.lax.top_k(-gap, most)
    left_out = jnp.maximum((gap < reach).sum(-1) - most, 0)
    near = jax.tree.map(lambda x: x[which], solids)
    far = nearness < -reach
    return near.replace(pos=jnp.where(far[..., None], NOWHERE, near.pos)), left_out.astype(jnp.int32)


def _touches(prints: Footprints, near: PlanSolids) -> tuple[Overlap, Overlap]:
    """Return touches with solids (robots, k) and with robots (robots, robots)."""
    axis = jnp.stack([jnp.cos(prints.yaw), jnp.sin(prints.yaw)], -1)
    mine = prints.pos[:, None], axis[:, None], prints.half[:, None]
    walls = touch(*mine, (near.pos, near.axis, near.half, near.radius))
    zero = jnp.zeros(len(prints.yaw))
    robots = touch(*mine, (prints.pos, axis, prints.half, zero))
    level = (prints.low[:, None] < prints.high) & (prints.low < prints.high[:, None])
    level &= ~jnp.eye(len(prints.yaw), dtype=bool)
    return walls, robots._replace(depth=jnp.where(level, robots.depth, -1.0))


def _pushes(prints: Footprints, touches: tuple[Overlap, Overlap], moves: Array) -> Footprints:
    """Bring robots apart from what each is deepest in, once."""
    walls, robots = touches
    # Of two robots each goes its share of the way; one that does not move is a wall.
    other = jnp.where(moves, prints.mass, 1e9)
    share = other / (other + prints.mass[:, None])
    worst = _deepest(
        jnp.concatenate([walls.depth, robots.depth * share], -1),
        jnp.concatenate([walls.normal, robots.normal], -2),
        jnp.concatenate([walls.point, robots.point], -2),
    )
    push = jnp.where(moves, jnp.maximum(worst.depth, 0.0), 0.0)
    arm = worst.point - prints.pos
    lever = arm[:, 0] * worst.normal[:, 1] - arm[:, 1] * worst.normal[:, 0]
    # Inertia of a plate over mass: (l^2 + w^2) / 12, here of half sides.
    spread = (prints.half**2).sum(-1) / 3
    size = push / (1.0 + lever**2 / spread)
    return prints.replace(
        pos=prints.pos + size[:, None] * worst.normal, yaw=prints.yaw + size * lever / spread
    )


def keep_apart(
    before: Footprints, after: Footprints, near: PlanSolids, moves: Array
) -> tuple[Footprints, Array]:
    """Return robots that go from one place to another, brought apart from all that they meet.

    Args:
        before: Where they were, apart from each other; who began in something may stay as deep in it.
        after: Where they would go.
        near: The solids that each may meet (robots, k).
        moves: Which robots can be pushed (robots,).

    Returns:
        Where they come to, and which of them touched anything or were moved for others' sake (robots,).
    """

    def back(prints: Footprints, where: Array) -> Footprints:
        return prints.replace(
            pos=jnp.where(where[:, None], before.pos, prints.pos),
            yaw=jnp.where(where, before.yaw, prints.yaw),
        )

    def turn(number: Array, now: tuple[Footprints, Array, Array]) -> tuple[Footprints, Array, Array]:
        # One look at what overlaps, whatever is done then: it is what takes long to run and to compile.
        prints, allowed, touched = now
        walls, robots = _touches(prints, near)
        depth = jnp.maximum(walls.depth.max(-1, initial=-1.0), robots.depth.max(-1, initial=-1.0))
        stuck = depth > allowed
        parted = _pushes(prints, (walls, robots), moves)
        rested = back(prints, jnp.where(number > ROUNDS + RESTS, stuck.any(), stuck))
        parting = number <= ROUNDS
        following = jax.tree.map(lambda a, b: jnp.where(parting, a, b), parted, rested)
        following = jax.tree.map(lambda a, b: jnp.where(number == 0, a, b), after, following)
        return (
            following,
            jnp.where(number == 0, jnp.maximum(depth, TOLERANCE), allowed),
            touched | ((number > 0) & (depth > 0)),
        )

    none = jnp.zeros(before.yaw.shape)
    turns = 2 + ROUNDS + RESTS
    kept, _, touched = jax.lax.fori_loop(0, turns, turn, (before, none, none > 0))
    moved = (kept.pos != after.pos).any(-1) | (kept.yaw != after.yaw)
    return kept, touched | moved
