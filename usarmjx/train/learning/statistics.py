"""Running means and deviations, which observations and values are shifted and scaled by."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from usarmjx.base.extras import extra

MAX_NORMALISED = 10.0
"""Normalised observations are cut to +- this many deviations."""
LEAST_DEVIATION = 1e-2
"""A quantity that has hardly changed so far is not blown up beyond this."""


class Statistics(struct.PyTreeNode, kw_only=True):
    """Mean and deviation of a quantity so far.

    Attributes:
        running: Brax's running statistics; leaves are () or (*shape).
    """

    running: Any

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
    with extra("train"):
        from brax.training.acme import running_statistics
    state = running_statistics.init_state(jnp.zeros(shape), std_eps=0.0)
    return Statistics(running=jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.result_type(leaf)), state))


def update_statistics(statistics: Statistics, values: jax.Array, valid: jax.Array, axis: str) -> Statistics:
    """Take in values (..., *shape) where valid (...), of all processes along a mesh axis."""
    with extra("train"):
        from brax.training.acme import running_statistics
    here = valid.reshape(*valid.shape, *[1] * (values.ndim - valid.ndim))
    weights = valid.astype(jnp.float32)
    new = running_statistics.update(
        statistics.running,
        jnp.where(here & jnp.isfinite(values), values, statistics.mean),
        weights=weights,
        std_min_value=LEAST_DEVIATION,
        pmap_axis_name=axis,
    )
    some = jax.lax.psum(weights.sum(), axis) > 0  # none at all would be a division by zero
    kept = jax.tree.map(lambda after, before: jnp.where(some, after, before), new, statistics.running)
    return Statistics(running=kept)


def normalise(mean: jax.Array, std: jax.Array, values: jax.Array) -> jax.Array:
    """Return values shifted and scaled, never beyond `MAX_NORMALISED`; what is not finite counts as usual."""
    return jnp.clip(
        (jnp.where(jnp.isfinite(values), values, mean) - mean) / std, -MAX_NORMALISED, MAX_NORMALISED
    )
