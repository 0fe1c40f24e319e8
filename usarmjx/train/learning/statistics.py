"""Running means and deviations, which observations and values are shifted and scaled by."""

from typing import Any, cast

import jax
import jax.numpy as jnp
from flax import struct

from usarmjx.base.errors import extra

MAX_NORMALISED = 10.0
"""Normalised observations are cut to +- this many deviations."""
MIN_DEVIATION = 1e-2
"""Least deviation by which a quantity is divided: one that hardly changes is not blown up."""


class Count(struct.PyTreeNode, kw_only=True):
    """Number of values, in halves: JAX has no integers of 64 bits by default.

    Attributes:
        hi: Multiples of 2^32 ().
        lo: The rest ().
    """

    hi: jax.Array
    lo: jax.Array

    def __int__(self) -> int:
        """Return the number."""
        return (int(self.hi) << 32) + int(self.lo)


class RunningStatistics(struct.PyTreeNode, kw_only=True):
    """Brax's running statistics, field by field, because importing Brax imports MJX and Warp, too.

    That takes two seconds of a start, and only tracing needs it.

    Attributes:
        mean: Mean so far (...).
        std: Deviation so far (...).
        count: Number of values.
        summed_variance: Sum of the squared differences from the mean (...).
        std_eps: Constant that Brax adds to variances ().
    """

    mean: jax.Array
    std: jax.Array
    count: Count
    summed_variance: jax.Array
    std_eps: jax.Array


class Statistics(struct.PyTreeNode, kw_only=True):
    """Mean and deviation of a quantity so far.

    Attributes:
        running: Statistics that Brax continues.
    """

    running: RunningStatistics

    @property
    def mean(self) -> jax.Array:
        """Return the mean (*shape)."""
        return self.running.mean

    @property
    def std(self) -> jax.Array:
        """Return the deviation (*shape), at least `MIN_DEVIATION`."""
        return self.running.std


def init_statistics(*shape: int) -> Statistics:
    """Return statistics of nothing yet: mean 0, deviation 1."""
    zeros, zero = jnp.zeros(shape), jnp.uint32(0)
    return Statistics(
        running=RunningStatistics(
            mean=zeros,
            std=jnp.ones(shape),
            count=Count(hi=zero, lo=zero),
            summed_variance=zeros,
            std_eps=jnp.float32(0.0),
        )
    )


def update_statistics(statistics: Statistics, values: jax.Array, valid: jax.Array, axis: str) -> Statistics:
    """Include values (..., *shape) where valid (...), of all processes along a mesh axis."""
    with extra("train"):
        from brax.training.acme import running_statistics
    before, library = statistics.running, cast(Any, running_statistics)
    fresh = library.init_state(before.mean)
    state = fresh.replace(
        mean=before.mean,
        std=before.std,
        count=fresh.count.replace(hi=before.count.hi, lo=before.count.lo),
        summed_variance=before.summed_variance,
        std_eps=before.std_eps,
    )
    mask = valid.reshape(*valid.shape, *[1] * (values.ndim - valid.ndim))
    weights = valid.astype(jnp.float32)
    updated = library.update(
        state,
        jnp.where(mask & jnp.isfinite(values), values, statistics.mean),
        weights=weights,
        std_min_value=MIN_DEVIATION,
        pmap_axis_name=axis,
    )
    after = before.replace(
        mean=updated.mean,
        std=updated.std,
        count=Count(hi=updated.count.hi, lo=updated.count.lo),
        summed_variance=updated.summed_variance,
    )
    any_valid = jax.lax.psum(weights.sum(), axis) > 0  # none at all would be a division by zero
    return Statistics(running=jax.tree.map(lambda one, old: jnp.where(any_valid, one, old), after, before))


def normalise(mean: jax.Array, std: jax.Array, values: jax.Array) -> jax.Array:
    """Return values shifted and scaled, never beyond `MAX_NORMALISED`; what is not finite counts as usual."""
    return jnp.clip(
        (jnp.where(jnp.isfinite(values), values, mean) - mean) / std, -MAX_NORMALISED, MAX_NORMALISED
    )
