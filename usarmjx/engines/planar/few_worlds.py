"""What only some worlds need, worked out in these.

Of many worlds one or another always needs it. So the few are put together, worked on as a batch of their own,
and put back; only where more of them need it, all are worked on.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from usarmjx.base.arrays import Array

FEW = 8
"""Few are at most one of so many worlds."""

T = TypeVar("T")


def few_of(worlds: int) -> int:
    """Return how many worlds are few; 0: there are too few in all for that to be less work."""
    return worlds // FEW


def picked(tree: T, places: Array) -> T:
    """Return some worlds of all (worlds, ...); anything at places beyond the last."""
    return jax.tree.map(lambda part: jnp.take(part, places, 0, mode="clip"), tree)


def put_back(tree: T, places: Array, new: T) -> T:
    """Return all worlds with some replaced; what is for places beyond the last is dropped."""

    def written(old: Array, part: Array) -> Array:
        return jnp.asarray(old).at[places].set(part, mode="drop")

    return jax.tree.map(written, tree, new)


def where_needed(needed: Array, function: Callable[..., T], known: T, *args: Any) -> T:  # noqa: ANN401
    """Return what is known, with what a function returns in worlds that need it.

    It is the same as if it were worked out in all, but for what XLA rounds otherwise in a smaller batch.

    Args:
        needed: Which worlds do (worlds,).
        function: Of many worlds, each by itself.
        known: Arrays like those that it returns (worlds, ...).
        args: Its arguments, PyTrees of arrays (worlds, ...).
    """
    worlds = len(needed)
    few = few_of(worlds)

    def in_all() -> T:
        def chosen(new: Array, old: Array) -> Array:
            return jnp.where(needed.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        return jax.tree.map(chosen, function(*args), known)

    def in_few() -> T:
        places = jnp.nonzero(needed, size=few, fill_value=worlds)[0]
        return put_back(known, places, function(*picked(args, places)))

    count = needed.sum()
    if not few:
        return jax.lax.cond(count > 0, in_all, lambda: known)
    which = (count > 0).astype(jnp.int32) + (count > few)
    return jax.lax.switch(which, [lambda: known, in_few, in_all])
