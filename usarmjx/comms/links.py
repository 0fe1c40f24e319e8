"""Who hears whom in one world: a table of all pairs, symmetric, and what changed since the last one."""

import numpy as np
from flax import struct

from usarmjx.base import random
from usarmjx.base.arrays import Array, Bool, Float, Int
from usarmjx.base.backend import stop_gradient, vmap, xp
from usarmjx.comms.attenuation import AnyRadioSettings, received_power
from usarmjx.comms.walls import count_walls
from usarmjx.sensors.rays.targets import Geoms

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
