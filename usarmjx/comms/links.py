"""Who hears whom in one world: a table of all pairs, symmetric, and what changed since the last one."""

import math
from functools import partial

import numpy as np
from flax import struct

from usarmjx.base import random
from usarmjx.base.arrays import Array, Bool, Float, Int
from usarmjx.base.backend import fori_loop, jit, stop_gradient, vmap, xp
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import Vec3, flip_vector
from usarmjx.comms.attenuation import AnyRadioSettings, received_power
from usarmjx.comms.walls import count_walls
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.rays.targets import Geoms

MIN_ANTENNA_HEIGHT = 0.01
"""No antenna is lower than this above the arena's floor: a robot on its back would have it below [m]."""


def antenna_of(robot: RobotSpec) -> Vec3:
    """Return where a class has its antenna, in USARSim's axes on the chassis [m].

    Without a place of its own it is half the robot's height above the chassis origin; a ComStation's is
    so on top of its mast.
    """
    return (0.0, 0.0, -robot.dimensions[2] / 2) if robot.antenna is None else robot.antenna


def antenna_positions(robot: RobotSpec, pos: Array, quat: Array, floor: float) -> Array:
    """Return where the antennas of robots of one class are in the world [m] (..., 3).

    Args:
        robot: The class.
        pos: Chassis origins [m] (..., 3).
        quat: Orientations, w first (..., 4).
        floor: Height of the arena's floor [m].
    """
    mat, (x, y, z) = mat_from_quat(quat), flip_vector(antenna_of(robot))
    position = pos + mat[..., 0] * x + mat[..., 1] * y + mat[..., 2] * z
    lowest = np.array([-np.inf, -np.inf, floor + MIN_ANTENNA_HEIGHT], np.float32)
    return xp.maximum(position, lowest)


def _squarings(robots: int) -> int:
    """How often a table of paths is joined with itself until it has the longest, of robots - 1 hops."""
    return math.ceil(math.log2(robots - 1)) if robots > 2 else 0


@jit
def transitive_closure(linked: Array) -> Array:
    """Return who reaches whom over any number of hops, everyone itself too (..., robots, robots)."""
    robots = linked.shape[-1]
    paths: Array = linked | np.eye(robots, dtype=bool)
    for _ in range(_squarings(robots)):
        paths = xp.any(paths[..., :, :, None] & paths[..., None, :, :], -2)
    return paths


@jit
def hops(linked: Array, base: Array | int) -> Array:
    """Return over how many links each robot reaches the base; as many as there are robots: it does not.

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
        via = xp.where(linked, count[..., None, :], robots).min(-1)
        return xp.minimum(count, via + 1)

    return fori_loop(max(robots - 1, 0), widen, start)


@partial(jit, static_argnames=("max_hops",))
def reachable(linked: Array, base: Array | int, max_hops: int | None = None) -> Array:
    """Return who reaches the base station, itself included (..., robots).

    Args:
        linked: Which links hold (..., robots, robots).
        base: Slot of the base station ().
        max_hops: Over so many hops at most; None: over any number.
    """
    if max_hops is None:
        return xp.take(transitive_closure(linked), base, -2)
    return hops(linked, base) <= min(max_hops, linked.shape[-1] - 1)


@jit
def connected_components(linked: Array) -> Array:
    """Return a number for each robot, the same for all that reach each other: the lowest slot among them.

    Args:
        linked: Which links hold (..., robots, robots).

    Returns:
        int32 (..., robots); a robot without links has its own slot.
    """
    return xp.argmax(transitive_closure(linked), -1).astype(xp.int32)


@jit
def bottleneck(power: Array) -> Array:
    """Return the power of the weakest link on the best way between each two robots [dBm].

    The best way is the one whose weakest link is strongest, whether it holds or not; so two robots reach
    each other exactly if this is not below the cutoff.

    Args:
        power: Power received (..., robots, robots), symmetric; -inf without a pair.

    Returns:
        (..., robots, robots), symmetric; inf from a robot to itself, -inf where no way leads.
    """
    robots = power.shape[-1]
    best = xp.where(np.eye(robots, dtype=bool), xp.inf, power)
    for _ in range(_squarings(robots)):
        best = xp.minimum(best[..., :, :, None], best[..., None, :, :]).max(-2)
    return best


MIN_SQUARED_DISTANCE = 1e-12
"""Keeps the square root of a distance differentiable where two antennas are in one place [m2]."""


class Links(struct.PyTreeNode, kw_only=True):
    """The radio links of one world; rows and columns are roster slots, and every table is symmetric.

    Attributes:
        power: Power received; -inf where there is no pair [dBm] (robots, robots).
        walls: Solids between the antennas; 0 where there is no pair (robots, robots).
        paired: Whether both robots are in use, and two: nobody has a link to itself (robots, robots).
        in_range: Whether the link holds: the power is not below the cutoff (robots, robots).
        delivery_probability: Probability that a message over it arrives; 0 if there is no link
            (robots, robots).
        went_down: Whether the link held at the last evaluation and does not now (robots, robots).
        came_up: Whether it holds now and did not then (robots, robots).
        evaluated: Whether this episode has been looked at; if not, there are no links yet ().
        step: Control step of the episode in which this was evaluated ().
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
    """Return the table of an episode that has not been looked at yet."""
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


def pairs_of(robots: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the slots of all unordered pairs: the lower ones and the higher ones (pairs,)."""
    return np.triu_indices(robots, 1)


def _square(values: Array, robots: int, diagonal: float) -> Array:
    """Return values of pairs (pairs,) as a symmetric table (robots, robots)."""
    # Gathered, not scattered: every entry of the table picks its pair.
    low, high = pairs_of(robots)
    index = np.zeros((robots, robots), int)
    index[low, high] = index[high, low] = np.arange(len(low))
    if not len(low):
        return xp.full((robots, robots), diagonal, values.dtype)
    return xp.where(np.eye(robots, dtype=bool), xp.asarray(diagonal, values.dtype), values[index])


def shadowing(settings: AnyRadioSettings, key: Array, robots: int) -> Array:
    """Return by how much surroundings strengthen or weaken each pair's link [dB] (pairs,).

    Log-normal: normal in decibels. A pair keeps its number as long as the key is the same, whoever else
    is there.
    """
    low, high = pairs_of(robots)
    if settings.shadowing == 0 or not len(low):
        return xp.zeros(len(low))
    keys = vmap(random.fold_in)(random.fold_in(key, np.arange(robots))[low], high)
    return settings.shadowing * random.normal(keys, (len(low),))


def delivery_probability(settings: AnyRadioSettings, power: Array) -> Array:
    """Return the probability that a message gets through at a power [dBm] (...)."""
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
    """Return the power received between all unordered pairs [dBm] and the solids between them (pairs,).

    Differentiable in the antennas' places; walls count as if they stayed as they are.

    Args:
        settings: The constants.
        geoms: The arena's solids.
        antennas: Where the antennas are [m] (robots, 3).
        shadow: What shadowing adds [dB] (pairs,).
    """
    low, high = pairs_of(len(antennas))
    start, end = antennas[low], antennas[high]
    way = end - start
    distance = xp.sqrt(xp.maximum((way * way).sum(-1), MIN_SQUARED_DISTANCE))
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
    """Return the links as they are now.

    Args:
        settings: The constants.
        geoms: The arena's solids: neither robots nor loose objects, which do not weaken a link.
        robots: Where their antennas are [m] (robots, 3), and which of them are in use; the others have no
            links (robots,).
        before: The last table; the first one of an episode has no events.
        key: The episode's, for shadowing.
        step: The present control step ().
    """
    antennas, in_use = robots
    count = len(antennas)
    power, walls = pair_powers(settings, geoms, antennas, shadowing(settings, key, count))
    paired = in_use[:, None] & in_use[None, :] & ~np.eye(count, dtype=bool)
    power = xp.where(paired, _square(power, count, -xp.inf), -xp.inf)
    in_range = paired & (power >= settings.cutoff)
    return Links(
        power=power,
        walls=xp.where(paired, _square(walls, count, 0), 0),
        paired=paired,
        in_range=in_range,
        delivery_probability=delivery_probability(settings, power),
        went_down=before.evaluated & before.in_range & ~in_range,
        came_up=before.evaluated & ~before.in_range & in_range,
        evaluated=xp.ones((), bool),
        step=xp.asarray(step, xp.int32),
    )


def is_due(links: Links, step: Array, every: int) -> Array:
    """Return whether it is time to evaluate again: so many control steps have passed, or none was yet ()."""
    return ~links.evaluated | (step >= links.step + every)


def without_old_events(links: Links, step: Array) -> Links:
    """Return the last table for another look at it: its events stay events of their own control step."""
    same = links.step == step
    return links.replace(went_down=links.went_down & same, came_up=links.came_up & same)
