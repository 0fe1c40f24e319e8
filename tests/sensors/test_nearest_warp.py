"""Nearest of a few things on Warp, whose kernel runs here on its CPU device."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.sensors import surroundings

pytest.importorskip("warp", reason="needs warp-lang")
from usarmjx.sensors.nearest_warp import MOST, nearest_of_rows


@pytest.mark.parametrize("count", [5, 16, 40, 90])
def test_nearest_are_those_of_a_stable_sort(count):
    """Equal and infinite distances keep their order, under maps of one launch, too."""
    rng = np.random.default_rng(count)
    distance = rng.integers(0, 12, (3, 4, count)).astype(np.float32)
    distance[distance > 9] = np.inf
    expected = np.argsort(distance, stable=True)[..., :5]
    np.testing.assert_array_equal(nearest_of_rows(jnp.asarray(distance), 5), expected)
    mapped = jax.jit(jax.vmap(jax.vmap(partial(nearest_of_rows, count=5))))
    np.testing.assert_array_equal(mapped(distance), expected)
    assert mapped.lower(distance).as_text().count("stablehlo.custom_call @") == 1


def test_nearest_of_what_is_no_number_are_some_indices():
    found = np.asarray(nearest_of_rows(jnp.full(20, jnp.nan), 16))
    assert ((found >= 0) & (found < 20)).all()


def test_gradients_pass_what_is_nearest():
    def least(x):
        return x[nearest_of_rows(x, 1)[0]]

    np.testing.assert_array_equal(jax.grad(least)(jnp.array([2.0, 1.0, 3.0])), [0, 1, 0])


@pytest.mark.parametrize("size", [16, MOST + 1])
def test_rows_of_few_are_taken_on_warp(monkeypatch, size):
    asked = []
    monkeypatch.setattr(surroundings, "warp_in_use", lambda: asked.append(size) or True)
    distance = np.random.default_rng(1).random((2, size), np.float32)
    text = jax.jit(partial(surroundings.nearest, count=4)).lower(distance).as_text()
    assert ("select_nearest" in text) == (size <= MOST)
    assert asked == [size]
