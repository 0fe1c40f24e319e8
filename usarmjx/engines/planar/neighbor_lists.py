"""What is around robots: looked up among all solids only when they may have come to others.

Of each robot it is known which solids are nearest, and how far it can go before any other could matter.
"""

from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.compilation import unroll_on_gpu
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.movable import SolidPlacement
from usarmjx.engines.planar.overlap import Outlines
from usarmjx.engines.planar.solids import NOWHERE, PlanSolids, as_numbers, as_solids, tops_under

NEAR = 8
"""A robot looks at so many solids closely ..."""
LARGE, NEAR_LARGE = 0.5, 12
"""... in scenes where one reaches farther than that from its middle [m], at so many: more fits around it."""
LAYERS = 4
"""It looks for ground at so many; at all, where there are more."""
SLACK = 0.02
"""What overlaps may put robots beyond where pushes do [m]."""
NEARNESS = 0.01
"""Solids that are as near but for so much come in any order [m]."""
DEEPEST = 20.0
"""All in which a robot is deeper come in any order [m]."""
LAST = 1e3
"""What is at another height comes so much later than what stops a robot [m]."""
SWAY = 5e-3
"""So far up or down robots get by the way in a step [m]: on edges and ramps."""


class Margin(struct.PyTreeNode, kw_only=True):
    """How far robots can go until something else may matter to them.

    Attributes:
        aside: On the plan [m] (worlds, robots).
        height: Up or down [m] (worlds, robots).
    """

    aside: Array
    height: Array

    def exceeds(self, other: "Margin") -> Array:
        """Return who has more of both (worlds, robots)."""
        return (self.aside > other.aside) & (self.height > other.height)


class NeighborList(struct.PyTreeNode, kw_only=True):
    """What is around the robots of each world; of whom `room` is 0, it is not known.

    Where kernels of Warp keep it, solids are numbers of one array, see `solids.as_numbers`; a CPU is slower
    at reading that.

    Attributes:
        at: Where robots were when it was looked up: x, y, lowest point, and up to what height solids are
            ground for them [m] (worlds, robots, 4).
        room: The numbers of `free` and of `grounded` (worlds, robots, 4).
        left_out: Solids that stop them, are near and are not among those kept (worlds, robots).
        near_solids: Those that may stop them (worlds, k, robots), or these (worlds, numbers, k, robots).
        under_solids: Those that may be ground for them (worlds, layers, robots), or these (worlds, numbers,
            layers, robots).
        scene: Where the solids were that can be elsewhere.
        discs: Whether any may be a disc.
    """

    at: Array
    room: Array
    left_out: Array
    near_solids: PlanSolids | Array
    under_solids: PlanSolids | Array
    scene: SolidPlacement
    discs: bool = struct.field(pytree_node=False)

    @property
    def free(self) -> Margin:
        """How far they can go before another solid could stop them."""
        return Margin(aside=self.room[..., 0], height=self.room[..., 1])

    @property
    def grounded(self) -> Margin:
        """How far before another solid could be ground for them."""
        return Margin(aside=self.room[..., 2], height=self.room[..., 3])

    @property
    def near(self) -> PlanSolids:
        """Solids that may stop them (worlds, k, robots)."""
        return as_solids(self.near_solids, discs=self.discs)

    @property
    def under(self) -> PlanSolids:
        """Solids that may be ground for them (worlds, layers, robots)."""
        return as_solids(self.under_solids, discs=self.discs)

    @property
    def near_numbers(self) -> Array:
        """Numbers of those that may stop them (worlds, numbers, k, robots)."""
        return as_numbers(self.near_solids)

    @property
    def under_numbers(self) -> Array:
        """Numbers of those that may be ground for them (worlds, numbers, layers, robots)."""
        return as_numbers(self.under_solids)

    @property
    def packed(self) -> "NeighborList":
        """The same, with solids as numbers."""
        return self.replace(near_solids=self.near_numbers, under_solids=self.under_numbers)

    def went(self, at: Array) -> tuple[Margin, Margin]:
        """Return how far robots are from where it was looked up, with their lowest points and with limits."""
        x, y, low, limit = (at[..., i] - self.at[..., i] for i in range(4))
        aside = jnp.sqrt(x * x + y * y)
        return Margin(aside=aside, height=jnp.abs(low)), Margin(aside=aside, height=jnp.abs(limit))

    def holds(self, at: Array, loose: Array, reach: Margin) -> Array:
        """Return in which worlds no other solid can matter to any robot within a step (worlds,).

        Of geoms that are data it is not asked whether they have moved.

        Args:
            at: Where robots are (worlds, robots, 4).
            loose: As of `scene` (worlds, n).
            reach: How far each robot may get in a step.
        """
        return self.holds_for(at, reach).all(-1) & (self.scene.loose == loose).all(-1)

    def holds_for(self, at: Array, reach: Margin) -> Array:
        """Return to which robots no other solid can matter within a step, if none moves (worlds, robots)."""
        known = jnp.ones(at.shape[:2], bool)
        for margin, went in zip((self.free, self.grounded), self.went(at), strict=True):
            known &= margin.exceeds(jax.tree.map(jnp.add, went, reach))
        return known

    def knows_ground(self, at: Array) -> Array:
        """Return of which robots no other solid can be ground (worlds, robots)."""
        return self.grounded.exceeds(self.went(at)[1])


def most_near(half: np.ndarray) -> int:
    """Return at how many solids the robots of a scene look closely, by their half sides [m] (robots, 2)."""
    return NEAR_LARGE if (np.hypot(*half.T) > LARGE).any() else NEAR


def places_of(prints: Footprints, limit: Array) -> Array:
    """Return where robots are, as `NeighborList.at` has it (..., robots, 4)."""
    return jnp.stack([prints.pos[..., 0], prints.pos[..., 1], prints.low, limit], -1)


def farthest_in_a_step(left: Footprints, there: Footprints) -> Margin:
    """Return how far robots can get in a step, pushed by others (worlds, robots).

    Args:
        left: Where they are.
        there: Where they would get to; as low and as high as on the way.
    """
    x, y = (there.pos[..., i] - left.pos[..., i] for i in range(2))
    way = jnp.sqrt(x * x + y * y)
    height = jnp.maximum(left.low - there.low, there.high - left.high)
    return jax.lax.stop_gradient(Margin(aside=way + way.max(-1, keepdims=True) + SLACK, height=height))


def look_around(
    prints: Footprints,
    limit: Array,
    solids: PlanSolids,
    floor: float,
    reach: Margin,
    scene: SolidPlacement,
    most: int = NEAR,
) -> NeighborList:
    """Look up what is around the robots of one world.

    Args:
        prints: The robots.
        limit: Up to what height each finds ground [m] (robots,).
        solids: All solids.
        floor: Height of the floor [m]: no solid below it is ground.
        reach: How far each robot may get in a step (robots,); solids that are no farther from a circle around
            it count as near.
        scene: Where the solids are that can be elsewhere.
        most: So many solids are kept that may stop a robot, see `most_near`.
    """
    # Which ones are looked at has no slope, only what these do.
    (prints, limit, scene), found = jax.lax.stop_gradient(((prints, limit, scene), solids))
    one = found.outline
    x, y, low = prints.pos[:, :1], prints.pos[:, 1:], prints.low[:, None]
    dx, dy = x - one.x, y - one.y
    ahead = jnp.maximum(jnp.abs(dx * one.cos + dy * one.sin) - one.length, 0.0)
    aside = jnp.maximum(jnp.abs(dy * one.cos - dx * one.sin) - one.width, 0.0)
    size = jnp.linalg.norm(prints.half, axis=-1)[:, None]
    apart = jnp.sqrt(ahead * ahead + aside * aside) - one.radius - size
    higher = _height_apart(found, x, y, low, prints.high[:, None], prints.step[:, None])
    stops, may_stop = higher < 0, jnp.maximum(apart, higher)
    steep = jnp.abs(found.slope_x) + jnp.abs(found.slope_y)
    lowest = found.top + dx * found.slope_x + dy * found.slope_y - size * steep
    deep = lowest - limit[:, None]
    may_hold = jnp.where(found.highest < floor, NOWHERE, jnp.maximum(apart, deep))
    near, others = _nearest(solids, jnp.where(stops, apart, may_stop + LAST), most)
    free = _margin(apart, higher, steep, others, reach)
    under, others = _nearest(solids, may_hold, LAYERS)
    grounded = _margin(apart, deep, steep, others & (found.highest >= floor), reach)
    left_out = (stops & (apart < reach.aside[:, None])).sum(-1) - most
    return NeighborList(
        at=places_of(prints, limit),
        room=jnp.stack([free.aside, free.height, grounded.aside, grounded.height], -1),
        left_out=jnp.maximum(left_out, 0).astype(jnp.int32),
        near_solids=near,
        under_solids=under,
        scene=scene,
        discs=solids.discs,
    )


def _margin(apart: Array, higher: Array, steep: Array, others: Array, reach: Margin) -> Margin:
    """Return how far robots of one world can go until some solids may matter to them.

    A solid matters to who is both over or under it and at its height. So it is enough to stay away from it on
    the plan, or to stay at another height: as is likelier to last.

    Args:
        apart: How far away solids are on the plan [m] (robots, solids).
        higher: How far up or down they are [m] (robots, solids).
        steep: How much that may change with a way on the plan (solids,).
        others: Which solids these are (robots, solids).
        reach: How far each robot may get in a step.
    """
    by_height = apart * (reach.height + SWAY)[:, None] < higher * reach.aside[:, None]
    # Where heights change with the way, one half of the difference is for that.
    until = jnp.where(by_height, jnp.maximum(apart, higher / (2 * jnp.maximum(steep, 1e-6))), apart)
    aside = jnp.where(others, until, NOWHERE).min(-1, initial=NOWHERE)
    crossed = others & by_height & (apart < aside[:, None])
    height = jnp.where(steep > 0, higher / 2, higher)
    return Margin(aside=aside, height=jnp.where(crossed, height, NOWHERE).min(-1, initial=NOWHERE))


def _height_apart(solids: PlanSolids, x: Array, y: Array, low: Array, high: Array, step: Array) -> Array:
    """Return how far up or down robots would have to be for solids to stop them [m]; negative: these do.

    The arguments, numbers of robots, are broadcast to the solids.
    """
    one = solids.outline
    dx, dy = x - one.x, y - one.y
    ahead = jnp.clip(dx * one.cos + dy * one.sin, -one.length, one.length)
    aside = jnp.clip(dy * one.cos - dx * one.sin, -one.width, one.width)
    rise = (ahead * one.cos - aside * one.sin) * solids.slope_x
    rise += (ahead * one.sin + aside * one.cos) * solids.slope_y
    under = low + step - (solids.top + rise)
    return jnp.maximum(under, jnp.maximum(solids.low - high, low - solids.highest))


def _nearest(solids: PlanSolids, rank: Array, most: int) -> tuple[PlanSolids, Array]:
    """Return the first solids by rank (most, robots), and which are not among them (robots, solids).

    Args:
        solids: All solids (solids,).
        rank: Who comes first: the least [m] (robots, solids).
        most: So many, if there are so many.
    """
    count = solids.count
    if count <= most:
        everyone = jax.tree.map(lambda part: jnp.tile(part[:, None], (1, len(rank))), solids)
        return everyone, jnp.zeros(rank.shape, bool)
    steps = jnp.clip((rank + DEEPEST) / NEARNESS, 0.0, 2**30 // count - 1).astype(jnp.int32)
    key = steps * count + jnp.arange(count)

    # By the least of those that are greater than the last: sorting all of them takes a processor far longer.
    def next_one(last: Array, _: None) -> tuple[Array, Array]:
        last = jnp.min(jnp.where(key > last[:, None], key, 2**30), -1)
        return last, last

    keys = jax.lax.scan(next_one, jnp.full(len(rank), -1), None, most, unroll=unroll_on_gpu(most))[1]
    chosen = keys[:most] % count
    # In their own order, so that it does not matter from where they were looked up.
    place = (chosen < chosen[:, None]).sum(1)
    ids = jnp.where(place == jnp.arange(most)[:, None, None], chosen, 0).sum(1)
    return jax.tree.map(lambda part: part[ids], solids), key > keys[most - 1][:, None]


def stopping(prints: Footprints, near: PlanSolids) -> Outlines:
    """Return outlines of solids (worlds, k, robots), worlds last; what stops no robot is far away."""
    x, y = prints.pos[..., None, :, 0], prints.pos[..., None, :, 1]
    low, high, step = (part[..., None, :] for part in (prints.low, prints.high, prints.step))
    stops = _height_apart(near, x, y, low, high, step) < 0
    outline = near.outline._replace(x=jnp.where(stops, near.outline.x, NOWHERE))
    return Outlines(*(jnp.moveaxis(part, 0, -1) for part in outline))


def ground_of(under: PlanSolids, floor: float, points: Array, reach: Array) -> Array:
    """Return how high the ground is under points of robots.

    Args:
        under: Solids that may be ground for each robot (worlds, layers, robots).
        floor: Height of the floor [m].
        points: On the plan (worlds, points, robots, 2).
        reach: Heights up to which solids are ground (worlds, points, robots).
    """
    layers = jax.tree.map(lambda part: part[:, :, None], under)
    tops = tops_under(layers, points[:, None, ..., 0], points[:, None, ..., 1], reach[:, None])
    rows = [tops[:, layer] for layer in range(tops.shape[1])]
    return reduce(jnp.maximum, rows, jnp.full(reach.shape, floor))
