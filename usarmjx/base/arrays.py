"""Array types for annotations: `Float[Array, "worlds robots 3"]` is a float array of that shape.

The dimension names are those of the docstrings: worlds, robots (of a robot group unless stated otherwise),
joints, beams, geoms. Shapes are not checked at run time; `tests/test_shapes.py` compares the docstrings'
shapes with a built world.
"""

from typing import TypeAlias

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, PRNGKeyArray, UInt8

Array: TypeAlias = jax.Array | np.ndarray
"""NumPy or JAX array; a function that accepts both takes the array module as an argument where it matters."""
ArrayLike: TypeAlias = Array | float
"""Array, or one number for all elements."""
Key: TypeAlias = PRNGKeyArray
"""JAX random key."""

__all__ = ["Array", "ArrayLike", "Bool", "Float", "Int", "Key", "UInt8"]
