"""Noise against its closed-form bounds and moments, the distortion curve against hand-made values."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.sensors.base import (
    NoisySensorSettings,
    apply_output_curve,
    noisy,
    relative_normal,
    relative_uniform,
)

DRAWS = 200_000
SIGMAS = 5  # a fair draw misses by more than this once in 1.7 million times; the keys are fixed
ROUNDING = 1e-6  # float32 near 1
CURVE = ((1.0, 0.0), (2.0, 10.0), (4.0, 6.0))


def test_uniform_noise_keeps_its_bounds_and_has_the_moments_of_a_uniform_one():
    amplitude = 0.2
    draws = np.asarray(relative_uniform(jax.random.key(1), jnp.ones(DRAWS), amplitude)) - 1
    assert np.abs(draws).max() <= amplitude + ROUNDING
    assert np.abs(draws).max() > 0.999 * amplitude
    variance = amplitude**2 / 3
    assert draws.mean() == pytest.approx(0, abs=SIGMAS * np.sqrt(variance / DRAWS))
    # The variance of a squared uniform is 4/45 of the amplitude's fourth power.
    assert (draws**2).mean() == pytest.approx(variance, abs=SIGMAS * np.sqrt(4 / 45 * amplitude**4 / DRAWS))


def test_normal_noise_has_its_mean_and_sigma():
    mean, sigma = 0.05, 0.3
    draws = np.asarray(relative_normal(jax.random.key(2), jnp.ones(DRAWS), mean, sigma)) - 1
    assert draws.mean() == pytest.approx(mean, abs=SIGMAS * sigma / np.sqrt(DRAWS))
    assert draws.std() == pytest.approx(sigma, abs=SIGMAS * sigma / np.sqrt(2 * DRAWS))
    within = (np.abs(draws - mean) < sigma).mean()
    assert within == pytest.approx(0.6827, abs=SIGMAS * np.sqrt(0.6827 * 0.3173 / DRAWS))


@pytest.mark.parametrize(
    "noise", [partial(relative_uniform, amplitude=0.5), partial(relative_normal, mean=0.0, sigma=1.0)]
)
def test_noise_is_proportional_and_the_keys_own(noise):
    data = jnp.array([0.0, 1.0, 1000.0, -1000.0])
    one, other = noise(jax.random.key(1), data), noise(jax.random.key(2), data)
    assert one[0] == other[0] == 0.0
    ratio = one[1:] / data[1:]
    assert len(set(np.asarray(ratio).tolist())) == 3  # a draw for each number
    assert (one == noise(jax.random.key(1), data)).all()
    assert (one[1:] != other[1:]).all()
    np.testing.assert_allclose(noise(jax.random.key(1), 10 * data)[1:] / 10, one[1:], rtol=1e-5)


def test_sensors_of_a_group_have_noise_of_their_own_whoever_comes_after_them():
    settings, key = (NoisySensorSettings(noise=0.5, sigma=0.1),) * 3, jax.random.key(3)
    told = np.asarray(noisy(key, jnp.ones((3, 2)), settings))
    assert len(set(told.ravel().tolist())) == 6
    np.testing.assert_array_equal(noisy(key, jnp.ones((2, 2)), settings[:2]), told[:2])


def test_no_noise_changes_nothing():
    data = jnp.array([0.1, -2.0, 30.0])
    assert (relative_uniform(jax.random.key(1), data, 0.0) == data).all()
    assert (relative_normal(jax.random.key(1), data, 0.0, 0.0) == data).all()


def test_distortion_curve_is_straight_between_its_points_and_zero_outside():
    data = jnp.array([0.0, 0.99, 1.0, 1.5, 2.0, 3.0, 3.5, 4.0, 4.01, 100.0])
    expected = [0.0, 0.0, 0.0, 5.0, 10.0, 8.0, 7.0, 6.0, 0.0, 0.0]
    np.testing.assert_allclose(apply_output_curve(data, CURVE), expected, atol=1e-5)


def test_no_curve_changes_nothing():
    data = jnp.array([0.0, 7.0])
    assert apply_output_curve(data, ()) is data
