"""Collision resolution of robots as rectangles on the plan, against solids and each other.

The deepest corner of an overlap defines a push: it moves and rotates both bodies according to their masses.
Overlaps that pushes do not resolve are undone by restoring the old pose.

Robots and worlds are the last axes of all arrays, so that the CPU's vector units are full.
"""

from collections.abc import Callable
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from usarmjx.base.backend import Array
from usarmjx.engines.planar.overlap import (
    Outlines,
    contact_coordinates,
    contact_point,
    disc_overlap,
    outlines,
    rectangle_overlap,
)
from usarmjx.engines.planar.solids import FAR_AWAY

PUSH_ITERATIONS = 6
"""Iterations of pushes out of the deepest overlap of each robot."""
RESTORE_ITERATIONS = 3
"""Iterations that restore the old pose of overlapping robots, before whole worlds are restored."""
OVERLAP_TOLERANCE = 1e-3
"""Accepted overlap [m]."""


class Footprints(struct.PyTreeNode, kw_only=True):
    """Robots on the plan.

    Attributes:
        pos: Centres of the rectangles [m] (..., robots, 2).
        yaw: Headings [rad] (..., robots).
        half: Half length and half width [m] (..., robots, 2).
        low: Lowest point [m] (..., robots).
        high: Highest point [m] (..., robots).
        step: Height above the lowest point up to which solids do not stop the robot [m] (..., robots).
        mass: Masses [kg] (..., robots).
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
        """Cosine and sine of the headings (..., robots, 2)."""
        return jnp.stack([jnp.cos(self.yaw), jnp.sin(self.yaw)], -1)

    @property
    def outlines(self) -> Outlines:
        """Rectangles (..., robots)."""
        return outlines(self.pos, self.axis, self.half, jnp.zeros_like(self.yaw))


class FootprintComponents(NamedTuple):
    """Footprints of many worlds by components, worlds last, so that vector units are full.

    Attributes:
        outline: Rectangles (robots, worlds).
        yaw: Headings [rad] (robots, worlds).
        low: Lowest point [m] (robots, worlds).
        high: Highest point [m] (robots, worlds).
        mass: Masses [kg] (robots, worlds).
    """

    outline: Outlines
    yaw: Array
    low: Array
    high: Array
    mass: Array


def footprint_components(footprints: Footprints) -> FootprintComponents:
    """Return the components of footprints (worlds, robots), worlds last."""
    outline = Outlines(*(part.T for part in footprints.outlines))
    return FootprintComponents(
        outline, footprints.yaw.T, footprints.low.T, footprints.high.T, footprints.mass.T
    )


class DeepestOverlap(NamedTuple):
    """Deepest overlap of each robot.

    Attributes:
        depth: Largest overlap with anything [m] (robots, worlds); negative: none.
        push: The robot's share of the way out [m] (robots, worlds).
        which: Index of the other: a solid near it, or, after these, a robot (robots, worlds).
    """

    depth: Array
    push: Array
    which: Array


class SeparationStep(NamedTuple):
    """Push of each robot out of its deepest overlap.

    Attributes:
        size: Length of the push [m] (robots, worlds).
        x: Direction, first component of a unit vector (robots, worlds).
        y: Second component (robots, worlds).
        at: Point of application, x and y [m] (robots, worlds).
    """

    size: Array
    x: Array
    y: Array
    at: tuple[Array, Array]


class ContactCandidates(NamedTuple):
    """Possible contacts of robots.

    Attributes:
        near: Solids that each may touch (k, robots, worlds).
        same_height: Which robots overlap in height at the proposed poses (robots, robots, worlds).
        same_height_before: The same at the old poses (robots, robots, worlds).
        share: Each robot's share of the way out of another; rows: the other (robots, robots, worlds).
        discs: Whether any solid may be a disc.
    """

    near: Outlines
    same_height: Array
    same_height_before: Array
    share: Array
    discs: bool


class Separation(NamedTuple):
    """Loop state of the separation.

    Attributes:
        footprints: The robots.
        first: Pushes out of the overlaps at the proposed poses.
        depth: Overlaps at the last evaluation of current poses [m] (robots, worlds).
        allowed: Accepted overlaps [m] (robots, worlds).
        touched: Whether each robot touched anything (robots, worlds).
        evaluated: Outlines to evaluate next: current ones or old ones (robots, worlds).
        unresolved: Whether any robot of any world overlaps more than accepted ().
    """

    footprints: FootprintComponents
    first: SeparationStep
    depth: Array
    allowed: Array
    touched: Array
    evaluated: Outlines
    unresolved: Array


def deepest_overlap(robots: Outlines, neighbors: ContactCandidates, same_height: Array) -> DeepestOverlap:
    """Return the deepest overlap of robots (robots, worlds)."""
    near, discs = neighbors.near, neighbors.discs

    def depth(mine: Outlines, solids: Outlines) -> Array:
        return _solid_overlap(mine, solids, discs)[0]

    # In most steps no robot is near anything: then the test of all solids is skipped.
    walls = _compute_if((near.x < FAR_AWAY).any(), depth, robots, near, otherwise=-1.0)
    others = _compute_if(same_height.any(), _robot_overlaps, robots, same_height, otherwise=-1.0)
    # Each of two robots moves its share of the way out.
    rows = [
        *walls,
        *(jnp.where(row > 0, row * share, row) for row, share in zip(others, neighbors.share, strict=True)),
    ]
    # A chain of comparisons: the first of equals wins, on JAX and Warp alike.
    push, which = rows[0], jnp.zeros(rows[0].shape, jnp.int32)
    for row, other in enumerate(rows[1:], 1):
        which, push = jnp.where(other > push, row, which), jnp.maximum(push, other)
    # Not below -1, from which Warp's version starts: a solid that is far away has -1e6 here.
    return DeepestOverlap(jnp.maximum(reduce(jnp.maximum, others, push), -1.0), push, which)


def _robot_overlaps(robots: Outlines, same_height: Array) -> Array:
    """Return the overlap of each two robots of a world (robots, robots, worlds)."""
    return jnp.where(
        same_height, rectangle_overlap(robots, Outlines(*(part[:, None] for part in robots)))[0], -1.0
    )


def separation_step(
    robots: Outlines, neighbors: ContactCandidates, found: DeepestOverlap, needed: Array | None = None
) -> SeparationStep:
    """Return the robots' pushes out of their deepest overlaps; arbitrary unless needed ()."""
    needed = jnp.bool_(True) if needed is None else needed

    def direction(mine: Outlines, solids: Outlines) -> tuple[Array, Array]:
        return _solid_overlap(mine, solids, neighbors.discs)[1:]

    worst = _compute_if(needed, _outlines_of, found.which, neighbors.near, robots)
    x, y = _compute_if(needed, direction, robots, worst)
    place = _compute_if(needed, contact_coordinates, robots, worst, (x, y))
    return SeparationStep(
        found.push, x, y, contact_point(robots, worst, (x, y), place, discs=neighbors.discs)
    )


def _compute_if(needed: Any, function: Callable[..., Any], *args: Any, otherwise: float = 0.0) -> Any:  # noqa: ANN401
    """Return a function's result if needed, otherwise constant arrays.

    `lax.cond` materialises the result; without it XLA on a CPU computes it again for each use.
    """
    shapes = jax.eval_shape(function, *args)
    nothing = jax.tree.map(lambda one: jnp.full(one.shape, otherwise, one.dtype), shapes)
    return jax.lax.cond(needed, function, lambda *_: nothing, *args)


def _outlines_of(which: Array, near: Outlines, robots: Outlines) -> Outlines:
    """Return for each robot the outline of a solid near it, or of a robot of its world, by index."""
    count, worlds = len(near.x), jnp.arange(which.shape[1])
    # Places in both tables end to end: solids (k, robots, worlds), then robots (robots, worlds).
    solid = (which * which.shape[0] + jnp.arange(len(which))[:, None]) * which.shape[1] + worlds
    robot = (which - count + count * which.shape[0]) * which.shape[1] + worlds
    place = jnp.where(which < count, solid, robot)

    def chosen(one: Array, other: Array) -> Array:
        # One flat table of solids and robots, so that a single gather serves both.
        return jnp.concatenate([one.reshape(-1), other.reshape(-1)]).at[place].get(mode="promise_in_bounds")

    return jax.tree.map(chosen, near, robots)


def _solid_overlap(mine: Outlines, solids: Outlines, discs: bool) -> tuple[Array, Array, Array]:
    """Return the overlaps of rectangles with solids, and the directions out (x and y)."""
    flat = rectangle_overlap(mine, solids)
    if not discs:
        return flat
    round_ = solids.radius > 0
    depth, x, y = (jnp.where(round_, *pair) for pair in zip(disc_overlap(mine, solids), flat, strict=True))
    return depth, x, y


def contact_candidates(
    before: FootprintComponents,
    after: FootprintComponents,
    near: Outlines,
    moves: Array,
    stacked: Array | None,
    *,
    discs: bool,
) -> ContactCandidates:
    """Return the possible contacts; arguments as for `separate_footprints`, worlds last."""
    # An immovable robot acts like a wall.
    weight = jnp.where(moves, after.mass, 1e9)[:, None]
    share = weight / (weight + after.mass)
    return ContactCandidates(near, _same_height(after, stacked), _same_height(before, stacked), share, discs)


def _same_height(footprints: FootprintComponents, stacked: Array | None) -> Array:
    """Return which robots are side by side, not above each other (robots, robots, worlds)."""
    low, high = footprints.low, footprints.high
    # The diagonal is left out: a robot always overlaps itself.
    same_height = (low < high[:, None]) & (low[:, None] < high) & ~jnp.eye(len(low), dtype=bool)[..., None]
    return same_height if stacked is None else same_height & ~stacked


def apply_separation(
    footprints: FootprintComponents, push: SeparationStep, moves: Array
) -> FootprintComponents:
    """Apply a push to robots."""
    one = footprints.outline
    lever = (push.at[0] - one.x) * push.y - (push.at[1] - one.y) * push.x
    # Inertia of a plate over mass: (l^2 + w^2) / 12, here of half sides.
    spread = (one.length**2 + one.width**2) / 3
    # A push off the middle turns the body as well: shift and turn together move the point of application by
    # the push.
    size = jnp.where(moves, jnp.maximum(push.size, 0.0), 0.0) / (1.0 + lever**2 / spread)
    x, y, yaw = one.x + size * push.x, one.y + size * push.y, footprints.yaw + size * lever / spread
    return footprints._replace(outline=one._replace(x=x, y=y, cos=jnp.cos(yaw), sin=jnp.sin(yaw)), yaw=yaw)


def separate_footprints(
    before: Footprints,
    after: Footprints,
    near: Outlines,
    moves: Array,
    stacked: Array | None = None,
    *,
    discs: bool = True,
) -> tuple[Footprints, Array]:
    """Return robots at proposed poses, pushed out of all overlaps.

    Once no robot in any world overlaps by more than `OVERLAP_TOLERANCE`, all further iterations are skipped;
    they leave a world without overlaps unchanged anyway.

    Args:
        before: Old poses (worlds, robots), without overlaps; a robot that already overlapped may stay as
            deep.
        after: Proposed poses.
        near: Solids that each robot may touch (k, robots, worlds).
        moves: Which robots can be pushed (worlds, robots).
        stacked: Which robots are above each other and do not collide on the plan (worlds, robots, robots);
            None: none.
        discs: Whether any solid may be a disc.

    Returns:
        Resolved poses, and which robots touched anything or were pushed (worlds, robots).
    """
    begin, end, pushable = footprint_components(before), footprint_components(after), moves.T
    over = None if stacked is None else jnp.moveaxis(stacked, 0, -1)
    candidates = contact_candidates(begin, end, near, pushable, over, discs=discs)

    def look(number: Array, now: Separation) -> Separation:
        # One evaluation for all kinds of iterations: it dominates both run time and compile time.
        same_height = jnp.where(number == 1, candidates.same_height_before, candidates.same_height)
        return _iterate(
            number, now, begin, pushable, candidates, deepest_overlap(now.evaluated, candidates, same_height)
        )

    def turn(number: Array, now: Separation) -> Separation:
        return jax.lax.cond(now.unresolved, look, lambda _, same: same, number, now)

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
    # Two more than pushes and restores: evaluations of the proposed and of the old poses.
    # A fixed number, `lax.cond` inside: JAX has no reverse gradient of a loop whose length depends on data.
    kept = jax.lax.fori_loop(0, 2 + PUSH_ITERATIONS + RESTORE_ITERATIONS, turn, start)
    x, y, yaw = kept.footprints.outline.x.T, kept.footprints.outline.y.T, kept.footprints.yaw.T
    # Robots pushed by others touched something, too, even if they end without an overlap.
    moved = (x != after.pos[..., 0]) | (y != after.pos[..., 1]) | (yaw != after.yaw)
    return after.replace(pos=jnp.stack([x, y], -1), yaw=yaw), kept.touched.T | moved


def _iterate(
    number: Array,
    now: Separation,
    before: FootprintComponents,
    moves: Array,
    neighbors: ContactCandidates,
    found: DeepestOverlap,
) -> Separation:
    """Make one iteration with the evaluated overlaps.

    Iteration 0 evaluates the proposed poses. Only if there are overlaps, iteration 1 evaluates the old poses,
    whose overlaps are accepted; the later ones separate.
    """
    is_first, is_second = number == 0, number == 1
    # A robot that starts inside something could else never move again.
    allowed = jnp.where(is_second, jnp.maximum(found.depth, OVERLAP_TOLERANCE), now.allowed)
    allowed = jnp.where(is_first, OVERLAP_TOLERANCE, allowed)
    depth = jnp.where(is_second, now.depth, found.depth)
    unresolved = depth > allowed
    push = separation_step(now.evaluated, neighbors, found, unresolved.any() & ~is_second)
    # The second iteration looks at old poses: its pushes are those found by the first.
    push = jax.tree.map(partial(jnp.where, is_second), now.first, push)
    in_world = unresolved.any(0)
    goes, pushes = in_world & ~is_first, number <= PUSH_ITERATIONS
    # A restored robot may overlap one that has moved into its place; at last whole worlds are restored.
    back = jnp.where(number > PUSH_ITERATIONS + RESTORE_ITERATIONS, in_world, unresolved)
    apart = apply_separation(now.footprints, push, moves)

    def next_of(start: Array, here: Array, pushed: Array) -> Array:
        return jnp.where(goes, jnp.where(pushes, pushed, jnp.where(back, start, here)), here)

    footprints = now.footprints._replace(
        outline=jax.tree.map(next_of, before.outline, now.footprints.outline, apart.outline),
        yaw=next_of(before.yaw, now.footprints.yaw, apart.yaw),
    )
    evaluated = jax.tree.map(partial(jnp.where, is_first), before.outline, footprints.outline)
    return Separation(
        footprints, push, depth, allowed, now.touched | (depth > 0), evaluated, unresolved.any()
    )
