"""Neighbor lists (Verlet lists): the nearest solids of each robot, with margins of validity.

A list is rebuilt from all solids only when its robot, by moving, may have come near another solid. The margin
is the distance that the robot can move until then.
"""

from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.backend import Array
from usarmjx.base.compilation import unroll_on_gpu
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.overlap import Outlines
from usarmjx.engines.planar.proposed_motion import SolidPlacement
from usarmjx.engines.planar.solids import FAR_AWAY, PlanSolids, pack_solids, top_heights, unpack_solids

LIST_LENGTH = 8
"""Number of solids in an obstacle list."""
LARGE_RADIUS, LARGE_LIST_LENGTH = 0.5, 12
"""Footprint radius above which a scene's lists are longer [m], and their length: more solids fit around."""
GROUND_LIST_LENGTH = 4
"""Number of solids in a ground list; if more are below, all solids are searched."""
SEPARATION_SLACK = 0.02
"""Displacement beyond the pushes' by overlaps [m]."""
RANK_RESOLUTION = 0.01
"""Resolution of distance ranks [m]; solids within it come in any order."""
MAX_RANKED_DEPTH = 20.0
"""Depth below which ranks are equal [m]."""
OTHER_HEIGHT_RANK = 1e3
"""Rank offset of solids at another height, after those that stop a robot [m]."""
HEIGHT_SLACK = 5e-3
"""Vertical displacement of robots in a step on edges and ramps [m]."""


class Margin(struct.PyTreeNode, kw_only=True):
    """Distances that robots can move until another solid may matter.

    Attributes:
        aside: Horizontal [m] (worlds, robots).
        height: Vertical [m] (worlds, robots).
    """

    aside: Array
    height: Array

    def exceeds(self, other: "Margin") -> Array:
        """Return where both components exceed the other's (worlds, robots)."""
        return (self.aside > other.aside) & (self.height > other.height)


class NeighborList(struct.PyTreeNode, kw_only=True):
    """Neighbor lists of the robots of all worlds; a list with `room` 0 is invalid.

    With Warp, solids are packed in one array, see `solids.pack_solids`; a CPU is slower at reading that.

    Attributes:
        at: Robot poses at the build: x, y, lowest point, and height limit of ground [m] (worlds, robots, 4).
        room: Components of `obstacle_margin` and `ground_margin` (worlds, robots, 4).
        omitted: Number of near obstacles that exceed the list (worlds, robots).
        obstacles: Obstacles (worlds, k, robots), or packed (worlds, numbers, k, robots).
        ground_solids: Ground solids (worlds, layers, robots), or packed (worlds, numbers, layers, robots).
        scene: Placement of movable solids at the build.
        discs: Whether any may be a disc.
    """

    at: Array
    room: Array
    omitted: Array
    obstacles: PlanSolids | Array
    ground_solids: PlanSolids | Array
    scene: SolidPlacement
    discs: bool = struct.field(pytree_node=False)

    @property
    def obstacle_margin(self) -> Margin:
        """Margin until another solid could be an obstacle."""
        return Margin(aside=self.room[..., 0], height=self.room[..., 1])

    @property
    def ground_margin(self) -> Margin:
        """Margin until another solid could be ground."""
        return Margin(aside=self.room[..., 2], height=self.room[..., 3])

    @property
    def near(self) -> PlanSolids:
        """Obstacles (worlds, k, robots)."""
        return unpack_solids(self.obstacles, discs=self.discs)

    @property
    def under(self) -> PlanSolids:
        """Ground solids (worlds, layers, robots)."""
        return unpack_solids(self.ground_solids, discs=self.discs)

    @property
    def packed_obstacles(self) -> Array:
        """Packed obstacles (worlds, numbers, k, robots)."""
        return pack_solids(self.obstacles)

    @property
    def packed_ground(self) -> Array:
        """Packed ground solids (worlds, numbers, layers, robots)."""
        return pack_solids(self.ground_solids)

    @property
    def packed(self) -> "NeighborList":
        """The same lists with packed solids."""
        return self.replace(obstacles=self.packed_obstacles, ground_solids=self.packed_ground)

    def displacement(self, at: Array) -> tuple[Margin, Margin]:
        """Return the displacements since the build, with those of lowest points and of height limits."""
        x, y, low, limit = (at[..., i] - self.at[..., i] for i in range(4))
        aside = jnp.sqrt(x * x + y * y)
        return Margin(aside=aside, height=jnp.abs(low)), Margin(aside=aside, height=jnp.abs(limit))

    def stays_valid(self, at: Array, loose: Array, reach: Margin) -> Array:
        """Return in which worlds the lists of all robots stay valid during a step (worlds,).

        The motion of geoms that are inputs is not tested.

        Args:
            at: Robot poses (worlds, robots, 4).
            loose: Coordinates of loose bodies, as in `scene` (worlds, n).
            reach: Largest displacement of each robot in a step.
        """
        return self.lists_stay_valid(at, reach).all(-1) & (self.scene.loose == loose).all(-1)

    def lists_stay_valid(self, at: Array, reach: Margin) -> Array:
        """Return which robots' lists stay valid during a step if no solid moves (worlds, robots)."""
        known = jnp.ones(at.shape[:2], bool)
        for margin, displacement in zip(
            (self.obstacle_margin, self.ground_margin), self.displacement(at), strict=True
        ):
            known &= margin.exceeds(jax.tree.map(jnp.add, displacement, reach))
        return known

    def ground_is_valid(self, at: Array) -> Array:
        """Return which robots' ground lists are valid (worlds, robots)."""
        return self.ground_margin.exceeds(self.displacement(at)[1])


def neighbor_capacity(half: np.ndarray) -> int:
    """Return the length of obstacle lists for a scene's robots, given their half sides [m] (robots, 2)."""
    return LARGE_LIST_LENGTH if (np.hypot(*half.T) > LARGE_RADIUS).any() else LIST_LENGTH


def list_poses(footprints: Footprints, limit: Array) -> Array:
    """Return robot poses as in `NeighborList.at` (..., robots, 4)."""
    return jnp.stack([footprints.pos[..., 0], footprints.pos[..., 1], footprints.low, limit], -1)


def max_displacement(left: Footprints, there: Footprints) -> Margin:
    """Return the largest displacement of robots in a step, pushes of others included (worlds, robots).

    Args:
        left: Old footprints.
        there: Proposed footprints, with the height range of the whole step.
    """
    x, y = (there.pos[..., i] - left.pos[..., i] for i in range(2))
    distance = jnp.sqrt(x * x + y * y)
    height = jnp.maximum(left.low - there.low, there.high - left.high)
    return jax.lax.stop_gradient(
        # A push by another robot is at most as long as that one's own motion.
        Margin(aside=distance + distance.max(-1, keepdims=True) + SEPARATION_SLACK, height=height)
    )


def build_neighbor_list(
    footprints: Footprints,
    limit: Array,
    solids: PlanSolids,
    floor: float,
    reach: Margin,
    scene: SolidPlacement,
    most: int = LIST_LENGTH,
) -> NeighborList:
    """Build the neighbor lists of one world.

    Args:
        footprints: The robots.
        limit: Height limit of ground for each [m] (robots,).
        solids: All solids.
        floor: Height of the floor [m]; solids below it are not ground.
        reach: Largest displacement of each robot in a step (robots,), which defines near obstacles.
        scene: Placement of the movable solids.
        most: Length of the obstacle lists, see `neighbor_capacity`.
    """
    # The selection has no gradient; only the selected solids do.
    (footprints, limit, scene), found = jax.lax.stop_gradient(((footprints, limit, scene), solids))
    one = found.outline
    x, y, low = footprints.pos[:, :1], footprints.pos[:, 1:], footprints.low[:, None]
    dx, dy = x - one.x, y - one.y
    ahead = jnp.maximum(jnp.abs(dx * one.cos + dy * one.sin) - one.length, 0.0)
    aside = jnp.maximum(jnp.abs(dy * one.cos - dx * one.sin) - one.width, 0.0)
    # The bounding circle: a list stays valid however the robot turns, as margins count displacements only.
    size = jnp.linalg.norm(footprints.half, axis=-1)[:, None]
    apart = jnp.sqrt(ahead * ahead + aside * aside) - one.radius - size
    higher = _height_gap(found, x, y, low, footprints.high[:, None], footprints.step[:, None])
    stops, may_stop = higher < 0, jnp.maximum(apart, higher)
    steep = jnp.abs(found.slope_x) + jnp.abs(found.slope_y)
    # A sloped top is lowest at the robot's lower end: a bound from below for all of its feet.
    lowest = found.top + dx * found.slope_x + dy * found.slope_y - size * steep
    deep = lowest - limit[:, None]
    # Solids that lie below the floor everywhere can never be ground: it is higher.
    may_hold = jnp.where(found.highest < floor, FAR_AWAY, jnp.maximum(apart, deep))
    near, others = _first_by_rank(solids, jnp.where(stops, apart, may_stop + OTHER_HEIGHT_RANK), most)
    obstacle_margin = _margin(apart, higher, steep, others, reach)
    under, others = _first_by_rank(solids, may_hold, GROUND_LIST_LENGTH)
    ground_margin = _margin(apart, deep, steep, others & (found.highest >= floor), reach)
    # Only those within a step's reach: farther ones are found when the list is rebuilt.
    omitted = (stops & (apart < reach.aside[:, None])).sum(-1) - most
    return NeighborList(
        at=list_poses(footprints, limit),
        room=jnp.stack(
            [obstacle_margin.aside, obstacle_margin.height, ground_margin.aside, ground_margin.height], -1
        ),
        omitted=jnp.maximum(omitted, 0).astype(jnp.int32),
        obstacles=near,
        ground_solids=under,
        scene=scene,
        discs=solids.discs,
    )


def _margin(apart: Array, higher: Array, steep: Array, others: Array, reach: Margin) -> Margin:
    """Return the distances that robots of one world can move until some solids may matter.

    A solid matters to a robot that overlaps it both horizontally and vertically. Either separation is
    sufficient: the one that lasts longer is used.

    Args:
        apart: Horizontal distances of solids [m] (robots, solids).
        higher: Vertical distances of solids [m] (robots, solids).
        steep: Change of the vertical distance per horizontal displacement (solids,).
        others: Solids to consider (robots, solids).
        reach: Largest displacement of each robot in a step.
    """
    by_height = apart * (reach.height + HEIGHT_SLACK)[:, None] < higher * reach.aside[:, None]
    # On slopes half of the vertical distance is reserved for the change along the way.
    until = jnp.where(by_height, jnp.maximum(apart, higher / (2 * jnp.maximum(steep, 1e-6))), apart)
    # Solids in the list need no margin: they are tested in every step.
    aside = jnp.where(others, until, FAR_AWAY).min(-1, initial=FAR_AWAY)
    # Solids that come within the margin sideways matter only by their height.
    crossed = others & by_height & (apart < aside[:, None])
    height = jnp.where(steep > 0, higher / 2, higher)
    return Margin(aside=aside, height=jnp.where(crossed, height, FAR_AWAY).min(-1, initial=FAR_AWAY))


def _height_gap(solids: PlanSolids, x: Array, y: Array, low: Array, high: Array, step: Array) -> Array:
    """Return the vertical distance between robots and obstacles [m]; negative: the solid stops the robot.

    The arguments, values of robots, are broadcast to the solids.
    """
    one = solids.outline
    dx, dy = x - one.x, y - one.y
    ahead = jnp.clip(dx * one.cos + dy * one.sin, -one.length, one.length)
    aside = jnp.clip(dy * one.cos - dx * one.sin, -one.width, one.width)
    rise = (ahead * one.cos - aside * one.sin) * solids.slope_x
    rise += (ahead * one.sin + aside * one.cos) * solids.slope_y
    # The highest point of a sloped top within the outline that is nearest to the robot's middle.
    under = low + step - (solids.top + rise)
    return jnp.maximum(under, jnp.maximum(solids.low - high, low - solids.highest))


def _first_by_rank(solids: PlanSolids, rank: Array, most: int) -> tuple[PlanSolids, Array]:
    """Return the first solids by rank (most, robots), and the remaining ones as a mask (robots, solids).

    Args:
        solids: All solids (solids,).
        rank: Ranks, smallest first [m] (robots, solids).
        most: Number of solids to return, if there are as many.
    """
    count = solids.count
    if count <= most:
        # All solids fit: the list never becomes invalid by motion.
        everyone = jax.tree.map(lambda part: jnp.tile(part[:, None], (1, len(rank))), solids)
        return everyone, jnp.zeros(rank.shape, bool)
    # Rank and index in one integer: unique keys, equal order on JAX and Warp.
    steps = jnp.clip((rank + MAX_RANKED_DEPTH) / RANK_RESOLUTION, 0.0, 2**30 // count - 1).astype(jnp.int32)
    key = steps * count + jnp.arange(count)

    # Repeated minimum above the previous one: sorting all keys takes a CPU far longer.
    def next_one(last: Array, _: None) -> tuple[Array, Array]:
        last = jnp.min(jnp.where(key > last[:, None], key, 2**30), -1)
        return last, last

    keys = jax.lax.scan(next_one, jnp.full(len(rank), -1), None, most, unroll=unroll_on_gpu(most))[1]
    chosen = keys[:most] % count
    # In index order, so that results do not depend on the pose at which the list was built.
    place = (chosen < chosen[:, None]).sum(1, dtype=jnp.int32)
    ids = jnp.where(place == jnp.arange(most)[:, None, None], chosen, 0).sum(1)
    return jax.tree.map(lambda part: part[ids], solids), key > keys[most - 1][:, None]


def obstacle_outlines(footprints: Footprints, near: PlanSolids) -> Outlines:
    """Return obstacles' outlines (worlds, k, robots), worlds last; solids that stop no robot are far away."""
    x, y = footprints.pos[..., None, :, 0], footprints.pos[..., None, :, 1]
    low, high, step = (part[..., None, :] for part in (footprints.low, footprints.high, footprints.step))
    stops = _height_gap(near, x, y, low, high, step) < 0
    outline = near.outline._replace(x=jnp.where(stops, near.outline.x, FAR_AWAY))
    return Outlines(*(jnp.moveaxis(part, 0, -1) for part in outline))


def ground_from_list(under: PlanSolids, floor: float, points: Array, reach: Array) -> Array:
    """Return the ground heights under points of robots.

    Args:
        under: Ground solids of each robot (worlds, layers, robots).
        floor: Height of the floor [m].
        points: Points on the plan (worlds, points, robots, 2).
        reach: Height limits of ground (worlds, points, robots).
    """
    layers = jax.tree.map(lambda part: part[:, :, None], under)
    tops = top_heights(layers, points[:, None, ..., 0], points[:, None, ..., 1], reach[:, None])
    rows = [tops[:, layer] for layer in range(tops.shape[1])]
    return reduce(jnp.maximum, rows, jnp.full(reach.shape, floor))
