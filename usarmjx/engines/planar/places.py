"""Some numbers of a row replaced, at places that are known beforehand."""

import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array


def placed(values: Array, index: np.ndarray, new: Array) -> Array:
    """Return an array (n, ...) with others at some places of its first axis.

    It is read in another order, which is one pass over it; writing single places takes one after the other.

    Args:
        values: The array.
        index: The places (...).
        new: What is there then (..., ...).
    """
    count, places = len(values), np.asarray(index).reshape(-1)
    order = np.arange(count)
    order[places] = count + np.arange(len(places))
    rows = jnp.concatenate([values, new.reshape((len(places), *values.shape[1:]))])
    return rows.at[order].get(mode="promise_in_bounds")
