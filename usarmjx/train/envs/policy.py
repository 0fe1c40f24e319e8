"""What acts in an environment: pure functions with a carry."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import jax

ObservationArrays = tuple[jax.Array, ...]
"""Per agent group (worlds, robots, obs_size)."""
ActionArrays = tuple[jax.Array, ...]
"""Per agent group (worlds, robots, action_size)."""
Carry: TypeAlias = Any
"""A policy's own between two steps: any tree of arrays (worlds, ...)."""


@dataclass(frozen=True)
class Policy:
    """A policy of all groups of an environment.

    Attributes:
        initial_carry: Returns the carry at the start of an episode, for a number of worlds.
        act: Returns the carry and the actions from the carry, the observations and a random key. It is pure.
    """

    initial_carry: Callable[[int], Carry]
    act: Callable[[Carry, ObservationArrays, jax.Array], tuple[Carry, ActionArrays]]
