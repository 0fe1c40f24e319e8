"""Types of arrays, for annotations: `Float[Array, "worlds robots 3"]` is an array of floats of that shape.

The names in a shape are those of the docstrings: worlds, robots (of a group unless said otherwise), joints,
beams, geoms. Nothing checks them while the program runs; `tests/test_shapes.py` compares the docstrings'
shapes with a built world.
"""

from typing import TypeAlias

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, PRNGKeyArray, UInt8

Array: TypeAlias = jax.Array | np.ndarray
"""An array of either library: functions that take it are given the array module where it matters."""
ArrayLike: TypeAlias = Array | float
"""An array, or one number for all."""
Key: TypeAlias = PRNGKeyArray
"""A key of JAX's random numbers."""

__all__ = ["Array", "ArrayLike", "Bool", "Float", "Int", "Key", "UInt8"]
