"""The state of a batch of worlds, and what it reads."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from usarmjx.models.build.arena_set import ArenaState
from usarmjx.sensors.base import Reading
from usarmjx.sim.world import World

Readings = tuple[tuple[Reading, ...], ...]
"""Per group and sensor a reading with leading axes (worlds, robots of the group)."""


class BatchState(struct.PyTreeNode, kw_only=True):
    """A batch of worlds.

    Attributes:
        physics: The engine's own state.
        worlds: Everything else (worlds, ...).
        arenas: The arenas that resets draw from, which may be replaced by others of the same shapes
            (arenas, ...); None where all worlds have the same arena.
    """

    physics: Any
    worlds: World
    arenas: ArenaState | None = None


def select_worlds(mask: jax.Array, new: jax.Array, old: jax.Array) -> jax.Array:
    """Return new where masked (worlds,), else old (worlds, ...)."""
    return jnp.where(mask.reshape(-1, *[1] * (new.ndim - 1)), new, old)
