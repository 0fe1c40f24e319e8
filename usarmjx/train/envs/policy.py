"""What acts in an environment: pure functions with a memory."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax

ObservationArrays = tuple[jax.Array, ...]
ActionArrays = tuple[jax.Array, ...]


@dataclass(frozen=True)
class Policy:
    """A policy of all groups of an environment.

    Attributes:
        initial_carry: Returns the memory at the start of an episode, for a number of worlds (worlds, ...).
        act: Returns the memory and the actions, per group (worlds, robots, action_size), from the memory, the
            observations, per group (worlds, robots, obs_size), and a random key. It is pure.
    """

    initial_carry: Callable[[int], Any]
    act: Callable[[Any, ObservationArrays, jax.Array], tuple[Any, ActionArrays]]
