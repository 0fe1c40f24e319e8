"""Radio links of one world: a symmetric table of all pairs, its changes, and multi-hop reachability."""

import math
from functools import partial

import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from usarmjx.base import random
from usarmjx.base.backend import Array, fori_loop, jit, stop_gradient, vmap, xp
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import Vec3, flip_vector
from usarmjx.comms.attenuation import AnyRadioSettings, received_power
from usarmjx.comms.walls import count_walls
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.rays.targets import Geoms

MIN_ANTENNA_HEIGHT = 0.01
"""Lowest height of an antenna above the arena's floor [m]; an overturned robot's would be below it."""
MIN_SQUARED_DISTANCE = 1e-12
"""Lower bound of squared distances, for a differentiable square root at coincident antennas [m2]."""


def antenna_offset(robot: RobotSpec) -> Vec3:
    """Return a class's antenna position on the chassis, in USARSim's axes [m].

    The default is half the robot's height above the chassis origin; for a ComStation that is the top of its
    mast.
    """
    return (0.0, 0.0, -robot.dimensions[2] / 2) if robot.antenna is None else robot.antenna


def antenna_positions(robot: RobotSpec, pos: Array, quat: Array, floor: float) -> Array:
    """Return the world positions of the antennas of robots of one class [m] (..., 3).

    Args:
        robot: The class.
        pos: Chassis origins [m] (..., 3).
        quat: Orientations, w first (..., 4).
        floor: Height of the arena's floor [m].
    """
    mat, (x, y, z) = mat_from_quat(quat), flip_vector(antenna_offset(robot))
    position = pos + mat[..., 0] * x + mat[..., 1] * y + mat[..., 2] * z
    # Only z has a lower bound.
    lowest = np.array([-np.inf, -np.inf, floor + MIN_ANTENNA_HEIGHT], np.float32)
    return xp.maximum(position, lowest)


def _squarings(robots: int) -> int:
    """Return how often a path table is multiplied by itself until it covers paths of robots - 1 hops."""
    # Each squaring doubles the covered length, and two robots are linked or not.
    return math.ceil(math.log2(robots - 1)) if robots > 2 else 0


@jit
def transitive_closure(linked: Array) -> Array:
    """Return which robots reach which over any number of hops, itself included (..., robots, robots)."""
    robots = linked.shape[-1]
    # With the diagonal set, squaring covers paths of all lengths up to the double.
    paths: Array = linked | np.eye(robots, dtype=bool)
    for _ in range(_squarings(robots)):
        paths = xp.any(paths[..., :, :, None] & paths[..., None, :, :], -2)
    return paths


@jit
def hops(linked: Array, base: Array | int) -> Array:
    """Return the number of links from each robot to the base; the number of robots if it is unreachable.

    Args:
        linked: Which links hold (..., robots, robots).
        base: Slot of the base station ().

    Returns:
        int32 (..., robots); 0 at the base itself.
    """
    robots = linked.shape[-1]
    start = xp.where(xp.arange(robots) == base, 0, robots)
    start = xp.broadcast_to(start, (*linked.shape[:-2], robots)).astype(xp.int32)

    def widen(_: int, count: Array) -> Array:
        # Bellman-Ford: after k rounds all counts up to k are right, so robots - 1 rounds are enough.
        via = xp.where(linked, count[..., None, :], robots).min(-1)
        return xp.minimum(count, via + 1)

    return fori_loop(max(robots - 1, 0), widen, start)


@partial(jit, static_argnames=("max_hops",))
def reachable(linked: Array, base: Array | int, max_hops: int | None = None) -> Array:
    """Return which robots reach the base station, itself included (..., robots).

    Args:
        linked: Which links hold (..., robots, robots).
        base: Slot of the base station ().
        max_hops: Largest number of hops; None: unlimited.
    """
    if max_hops is None:
        return xp.take(transitive_closure(linked), base, -2)
    # An unreachable robot counts as many hops as there are robots: no limit may let it in.
    return hops(linked, base) <= min(max_hops, linked.shape[-1] - 1)


@jit
def connected_components(linked: Array) -> Array:
    """Return a component label for each robot: the lowest slot that it reaches.

    Args:
        linked: Which links hold (..., robots, robots).

    Returns:
        int32 (..., robots); a robot without links has its own slot.
    """
    # Of equal values argmax takes the first, which is the lowest slot.
    return xp.argmax(transitive_closure(linked), -1).astype(xp.int32)


@jit
def bottleneck(power: Array) -> Array:
    """Return the power of the weakest link on the best route between each two robots [dBm].

    The best route is the one whose weakest link is strongest, whether it holds or not; two robots reach each
    other exactly if this power is not below the cutoff.

    Args:
        power: Power received (..., robots, robots), symmetric; -inf without a pair.

    Returns:
        (..., robots, robots), symmetric; inf from a robot to itself, -inf without a route.
    """
    robots = power.shape[-1]
    best = xp.where(np.eye(robots, dtype=bool), xp.inf, power)
    for _ in range(_squarings(robots)):
        # The closure again, with min for "and" and max for "or".
        best = xp.minimum(best[..., :, :, None], best[..., None, :, :]).max(-2)
    return best


class Links(struct.PyTreeNode, kw_only=True):
    """The radio links of one world; rows and columns are roster slots, and every table is symmetric.

    Attributes:
        power: Power received; -inf where there is no pair [dBm] (robots, robots).
        walls: Solids between the antennas; 0 where there is no pair (robots, robots).
        paired: Whether both robots are in use; false on the diagonal (robots, robots).
        in_range: Whether the link holds: power at or above the cutoff (robots, robots).
        delivery_probability: Probability that a message arrives; 0 without a link (robots, robots).
        went_down: Whether the link held at the last evaluation and no longer does (robots, robots).
        came_up: Whether the link holds and did not at the last evaluation (robots, robots).
        evaluated: Whether links were evaluated in this episode; if not, there are none yet ().
        step: Control step of the evaluation, in the episode ().
    """

    power: Array
    walls: Array
    paired: Array
    in_range: Array
    delivery_probability: Array
    went_down: Array
    came_up: Array
    evaluated: Array
    step: Array


def no_links(robots: int) -> Links:
    """Return the table of an episode before its first evaluation."""
    never = xp.zeros((robots, robots), bool)
    return Links(
        power=xp.full((robots, robots), -xp.inf, xp.float32),
        walls=xp.zeros((robots, robots), xp.int32),
        paired=never,
        in_range=never,
        delivery_probability=xp.zeros((robots, robots)),
        went_down=never,
        came_up=never,
        evaluated=xp.zeros((), bool),
        step=xp.zeros((), xp.int32),
    )


def pair_slots(robots: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the slots of all unordered pairs: lower and higher slots (pairs,)."""
    return np.triu_indices(robots, 1)


def _square(values: Array, robots: int, diagonal: float) -> Array:
    """Return values of pairs (pairs,) as a symmetric table (robots, robots)."""
    # A gather instead of a scatter: every entry of the table picks its pair.
    low, high = pair_slots(robots)
    index = np.zeros((robots, robots), int)
    index[low, high] = index[high, low] = np.arange(len(low))
    # One robot makes no pair, and nothing can be gathered from an empty array.
    if not len(low):
        return xp.full((robots, robots), diagonal, values.dtype)
    return xp.where(np.eye(robots, dtype=bool), xp.asarray(diagonal, values.dtype), values[index])


def shadowing(settings: AnyRadioSettings, key: Array, robots: int) -> Array:
    """Return the log-normal shadowing of each pair's link [dB] (pairs,): normal in decibels.

    A pair's value depends only on the key and its two slots, not on which other robots exist.
    """
    low, high = pair_slots(robots)
    if settings.shadowing == 0 or not len(low):
        return xp.zeros(len(low))
    # Folded in twice, once per slot: a key from the pair's index would change with the number of robots.
    keys = vmap(random.fold_in)(random.fold_in(key, np.arange(robots))[low], high)
    return settings.shadowing * random.normal(keys, (len(low),))


def delivery_probability(settings: AnyRadioSettings, power: Array) -> Array:
    """Return the probability of delivery at a received power [dBm] (...)."""
    margin = power - settings.cutoff
    if settings.loss_band == 0:
        return (margin >= 0).astype(xp.float32)
    return xp.clip(margin / settings.loss_band, 0.0, 1.0)


def pair_powers(
    settings: AnyRadioSettings,
    geoms: Geoms,
    antennas: Float[Array, "robots 3"],
    shadow: Float[Array, " pairs"] | float = 0.0,
) -> tuple[Float[Array, " pairs"], Int[Array, " pairs"]]:
    """Return the received power of all unordered pairs [dBm] and the solids between them (pairs,).

    Differentiable in the antennas' positions, with constant wall counts.

    Args:
        settings: The constants.
        geoms: The arena's solids.
        antennas: Antenna positions [m] (robots, 3).
        shadow: Shadowing to add [dB] (pairs,).
    """
    low, high = pair_slots(len(antennas))
    start, end = antennas[low], antennas[high]
    way = end - start
    # Bounded before the root, whose derivative at 0 is infinite.
    distance = xp.sqrt(xp.maximum((way * way).sum(-1), MIN_SQUARED_DISTANCE))
    # A count is constant almost everywhere; tracing derivatives through ray tests would only cost time.
    walls = count_walls(geoms, stop_gradient(start), stop_gradient(end))
    return received_power(settings, distance, walls) + shadow, walls


def evaluate_links(
    settings: AnyRadioSettings,
    geoms: Geoms,
    robots: tuple[Float[Array, "robots 3"], Bool[Array, " robots"]],
    before: Links,
    key: Array,
    step: Int[Array, ""],
) -> Links:
    """Evaluate the links.

    Args:
        settings: The constants.
        geoms: The arena's solids. Robots and loose objects do not attenuate.
        robots: Antenna positions [m] (robots, 3), and which robots are in use; the others have no links
            (robots,).
        before: Previous table; the first one of an episode has no events.
        key: The episode's key, for shadowing.
        step: Current control step ().
    """
    antennas, in_use = robots
    count = len(antennas)
    power, walls = pair_powers(settings, geoms, antennas, shadowing(settings, key, count))
    paired = in_use[:, None] & in_use[None, :] & ~np.eye(count, dtype=bool)
    # -inf is below every cutoff and has a delivery probability of 0; NaN would spread.
    power = xp.where(paired, _square(power, count, -xp.inf), -xp.inf)
    in_range = paired & (power >= settings.cutoff)
    return Links(
        power=power,
        walls=xp.where(paired, _square(walls, count, 0), 0),
        paired=paired,
        in_range=in_range,
        delivery_probability=delivery_probability(settings, power),
        # Without an evaluation before, every link of the first step would count as one that came up.
        went_down=before.evaluated & before.in_range & ~in_range,
        came_up=before.evaluated & ~before.in_range & in_range,
        evaluated=xp.ones((), bool),
        step=xp.asarray(step, xp.int32),
    )


def is_due(links: Links, step: Array, every: int) -> Array:
    """Return whether the next evaluation is due: `every` control steps have passed, or there was none ()."""
    return ~links.evaluated | (step >= links.step + every)


def drop_old_events(links: Links, step: Array) -> Links:
    """Return the last table without events of earlier control steps, for a later read of it."""
    same = links.step == step
    return links.replace(went_down=links.went_down & same, came_up=links.came_up & same)
