"""Noise and distortion that the manual lets every sensor have (section 10)."""

import jax
import jax.numpy as jnp

from usarmjx.transforms import Array

Curve = tuple[tuple[float, float], ...]
"""Points (input, output) of an OutputCurve, inputs ascending."""


def relative_uniform(key: jax.Array, data: jax.Array, amplitude: Array | float) -> jax.Array:
    """Return data + random(amplitude) * data, random in [-amplitude, amplitude] (manual 10.2.2)."""
    return data * (1 + jax.random.uniform(key, data.shape, minval=-amplitude, maxval=amplitude))


def relative_normal(key: jax.Array, data: jax.Array, mean: float, sigma: float) -> jax.Array:
    """Return data * (1 + N(mean, sigma)): noise proportional to the rate of change (manual 10.6)."""
    return data * (1 + mean + sigma * jax.random.normal(key, data.shape))


def output_curve(data: jax.Array, points: Curve) -> jax.Array:
    """Distort data by straight lines between points, zero outside them; no points: unchanged (manual 10)."""
    if not points:
        return data
    inputs, outputs = zip(*points, strict=True)
    return jnp.interp(data, jnp.array(inputs), jnp.array(outputs), left=0.0, right=0.0)
