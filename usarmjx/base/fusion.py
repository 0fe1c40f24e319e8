"""What XLA is told for a GPU's sake: what it may not melt into one kernel, and which loops it unrolls."""

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


def rounds_at_once(count: int) -> int:
    """Return how many rounds of a small loop are to be one: on a GPU so many, elsewhere each is by itself.

    On a GPU a round costs launches of its own, more than what is in it.

    Args:
        count: How many on a GPU.
    """
    return count if jax.default_backend() == "gpu" else 1
