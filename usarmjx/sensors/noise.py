"""Noise and distortion that the manual lets every sensor have (section 10)."""

import math
from collections.abc import Sequence
from itertools import pairwise

import jax
import numpy as np

from usarmjx.base import random
from usarmjx.base.arrays import Array
from usarmjx.base.backend import on_numpy, xp
from usarmjx.sensors.base import NoisySensorSettings

OutputCurve = tuple[tuple[float, float], ...]
"""Points (input, output) of an OutputCurve, inputs ascending."""


def relative_uniform(key: Array, data: Array, amplitude: Array | float) -> Array:
    """Return data + random(amplitude) * data, random in [-amplitude, amplitude] (manual 10.2.2)."""
    return data * (1 + random.uniform(key, data.shape, minval=-amplitude, maxval=amplitude))


def relative_normal(key: Array, data: Array, mean: Array | float, sigma: Array | float) -> Array:
    """Return data * (1 + N(mean, sigma)): noise proportional to the rate of change (manual 10.6)."""
    return data * normal_factor(key, data.shape, mean, sigma)


def normal_factor(key: Array, shape: Sequence[int], mean: Array | float, sigma: Array | float) -> Array:
    """Return 1 + N(mean, sigma) of a shape; keys as of `random.normal`."""
    if isinstance(sigma, float) and not sigma:
        return xp.broadcast_to(xp.asarray(1 + mean, xp.float32), tuple(shape))
    return 1 + mean + sigma * random.normal(key, shape)


def setting_values(settings: Sequence[NoisySensorSettings], name: str) -> Array:
    """Return a setting of each sensor (sensors,): numbers, or arrays where `with_noise` has scaled it."""
    values = [getattr(s, name) for s in settings]
    if not on_numpy() and any(isinstance(value, jax.Array) for value in values):
        return xp.stack([xp.asarray(value, xp.float32) for value in values])
    return np.array(values, np.float32)


def noisy(key: Array, data: Array, settings: Sequence[NoisySensorSettings]) -> Array:
    """Return data (sensors, ...) with each sensor's noise: uniform, then Gaussian where one is set.

    Keys are folded by place: a sensor's noise does not depend on those after it. On NumPy of robots' keys
    (robots,) and data (robots, sensors, ...) as well.
    """
    noise, mean, sigma = (setting_values(settings, name) for name in ("noise", "mean", "sigma"))
    keys = random.fold_in(key, np.arange(len(settings)))
    rows = (-1, *[1] * (data.ndim - random.axes(keys)))
    told = data if _is_zero(noise) else relative_uniform(keys, data, noise.reshape(rows))
    if _is_zero(mean) and _is_zero(sigma):
        return told
    return relative_normal(random.fold_in(keys, 1), told, mean.reshape(rows), sigma.reshape(rows))


def _is_zero(values: Array) -> bool:
    """Return whether numbers that are known by now are all 0."""
    return isinstance(values, np.ndarray) and not values.any()


def curve_problem(points: OutputCurve) -> str:
    """Return what is wrong with the points of an OutputCurve, "" if nothing is."""
    pairs = all(len(point) == 2 and all(map(math.isfinite, point)) for point in points)
    if pairs and all(a[0] < b[0] for a, b in pairwise(points)):
        return ""
    return f"the points of OutputCurve are {points!r}, expected finite ones with growing inputs"


def apply_output_curve(data: Array, points: OutputCurve) -> Array:
    """Distort data by straight lines between points, zero outside them; no points: unchanged (manual 10)."""
    if not points:
        return data
    inputs, outputs = zip(*points, strict=True)
    return xp.interp(data, xp.array(inputs), xp.array(outputs), left=0.0, right=0.0)
