"""Running means and deviations, which observations and values are shifted and scaled by."""

from typing import Any, cast

import jax
import jax.numpy as jnp
from flax import struct

from usarmjx.base.errors import extra

MAX_NORMALISED = 10.0
"""Normalised observations are cut to +- this many deviations."""
LEAST_DEVIATION = 1e-2
"""A quantity that has hardly changed so far is not blown up beyond this."""


class Count(struct.PyTreeNode, kw_only=True):
    """How many there were, in halves: JAX has no integers of 64 bits unless told to.

    Attributes:
        hi: Of 2^32 ().
        lo: The rest ().
    """

    hi: jax.Array
    lo: jax.Array

    def __int__(self) -> int:
        """Return the number."""
        return (int(self.hi) << 32) + int(self.lo)


class RunningStatistics(struct.PyTreeNode, kw_only=True):
    """Brax's running statistics, field by field: whoever imports Brax imports MJX and Warp, too.

    That takes two seconds of a start, of which only what is not traced yet has need.

    Attributes:
        mean: Mean so far (...).
        std: Deviation so far (...).
        count: How many values these are of.
        summed_variance: Sum of the squared differences from the mean (...).
        std_eps: What Brax adds to variances ().
    """

    mean: jax.Array
    std: jax.Array
    count: Count
    summed_variance: jax.Array
    std_eps: jax.Array


class Statistics(struct.PyTreeNode, kw_only=True):
    """Mean and deviation of a quantity so far.

    Attributes:
        running: As Brax goes on from.
    """

    running: RunningStatistics

    @property
    def mean(self) -> jax.Array:
        """Return the mean (*shape)."""
        return self.running.mean

    @property
    def std(self) -> jax.Array:
        """Return the deviation (*shape), at least `LEAST_DEVIATION`."""
        return self.running.std


def init_statistics(*shape: int) -> Statistics:
    """Return statistics of nothing yet: mean 0, deviation 1."""
    none, no = jnp.zeros(shape), jnp.uint32(0)
    return Statistics(
        running=RunningStatistics(
            mean=none,
            std=jnp.ones(shape),
            count=Count(hi=no, lo=no),
            summed_variance=none,
            std_eps=jnp.float32(0.0),
        )
    )


def update_statistics(statistics: Statistics, values: jax.Array, valid: jax.Array, axis: str) -> Statistics:
    """Take in values (..., *shape) where valid (...), of all processes along a mesh axis."""
    with extra("train"):
        from brax.training.acme import running_statistics
    before, library = statistics.running, cast(Any, running_statistics)
    none = library.init_state(before.mean)
    state = none.replace(
        mean=before.mean,
        std=before.std,
        count=none.count.replace(hi=before.count.hi, lo=before.count.lo),
        summed_variance=before.summed_variance,
        std_eps=before.std_eps,
    )
    here = valid.reshape(*valid.shape, *[1] * (values.ndim - valid.ndim))
    weights = valid.astype(jnp.float32)
    new = library.update(
        state,
        jnp.where(here & jnp.isfinite(values), values, statistics.mean),
        weights=weights,
        std_min_value=LEAST_DEVIATION,
        pmap_axis_name=axis,
    )
    after = before.replace(
        mean=new.mean,
        std=new.std,
        count=Count(hi=new.count.hi, lo=new.count.lo),
        summed_variance=new.summed_variance,
    )
    some = jax.lax.psum(weights.sum(), axis) > 0  # none at all would be a division by zero
    return Statistics(running=jax.tree.map(lambda one, old: jnp.where(some, one, old), after, before))


def normalise(mean: jax.Array, std: jax.Array, values: jax.Array) -> jax.Array:
    """Return values shifted and scaled, never beyond `MAX_NORMALISED`; what is not finite counts as usual."""
    return jnp.clip(
        (jnp.where(jnp.isfinite(values), values, mean) - mean) / std, -MAX_NORMALISED, MAX_NORMALISED
    )
