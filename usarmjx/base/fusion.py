"""What XLA may melt into one kernel, and what it may not."""

from typing import TypeVar

import jax

T = TypeVar("T")


def kept_on_gpu(tree: T) -> T:
    """Return arrays that a GPU works out once and keeps; on a CPU they are what they were.

    What is made of many worlds' numbers and read in another order, or in sums beside, XLA works out again for
    each of those: it puts all that leads there into the kernel that reads it.

    Args:
        tree: A PyTree of arrays.
    """
    if jax.default_backend() != "gpu":
        return tree
    return jax.lax.optimization_barrier(tree)  # pyright: ignore[reportUnknownMemberType] - JAX has no type
