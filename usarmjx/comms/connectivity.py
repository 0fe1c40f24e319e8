"""Who reaches whom over several hops: for rewards, scores and tasks.

All functions take square tables of one world, (robots, robots), and can be mapped over worlds; leading
axes are allowed too. `linked` is `Links.in_range`, `power` is `Links.power`; both are symmetric.
"""

import math
from functools import partial

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import fori_loop, jit, xp


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
