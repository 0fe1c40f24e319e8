"""The GRU's kernels against their JAX twin, in one thread and as the threads of a GPU run them."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.engines.gpu_threads import COMPILER, run_as_on_a_gpu
from usarmjx.train.learning import networks, warp_gru
from usarmjx.train.learning.networks import recur
from usarmjx.train.learning.warp_gru import BACKWARD, FORWARD, ROWS, fits, native_code

STEPS, WORLDS, ROBOTS, UNITS = 4, 4, 2, 32
# Sums of 96 products of numbers of order 1 in another order, handed on over 4 steps, relative to the largest.
TOLERANCE = 2e-6


def drawn(seed=3):
    """Arguments of `recur`, and slopes of its result; episodes begin at three of the sixteen steps."""
    draw = np.random.default_rng(seed)
    shapes = ((STEPS, WORLDS, ROBOTS, 3 * UNITS), (UNITS, 3 * UNITS), (UNITS,), (WORLDS, ROBOTS, UNITS))
    values = [
        draw.normal(size=shape, scale=scale) for shape, scale in zip(shapes, (1, 0.2, 1, 1), strict=True)
    ]
    is_first = np.zeros((STEPS, WORLDS), bool)
    is_first[[0, 2, 3], [1, 0, 1]] = True
    slopes = draw.normal(size=(STEPS, WORLDS, ROBOTS, UNITS))
    return [*(value.astype(np.float32) for value in values), is_first], slopes.astype(np.float32)


def close(found, expected):
    assert_allclose(found, expected, rtol=0, atol=TOLERANCE * np.abs(expected).max())


def results(given, slopes):
    after, back = jax.vjp(lambda *values: recur(*values, given[-1]), *map(jnp.asarray, given[:-1]))
    return after, *back(jnp.asarray(slopes))


@pytest.mark.oracle
def test_the_kernels_do_what_the_twin_does(monkeypatch):
    given, slopes = drawn()
    expected = results(given, slopes)
    monkeypatch.setattr(networks, "warp_in_use", lambda: True)
    launched = []
    monkeypatch.setattr(warp_gru, "_launch", lambda *size: launched.append(size) or launch(*size))
    for found, twin in zip(results(given, slopes), expected, strict=True):
        close(found, twin)
    assert launched == [(WORLDS * ROBOTS, UNITS)] * 2  # forward and backward, each once


launch = warp_gru._launch


@pytest.mark.oracle
def test_networks_of_several_seeds_run_one_after_another(monkeypatch):
    """Mapped over seeds, each with its own weights, the kernels do what the twin does for each seed."""
    several = [drawn(seed) for seed in (3, 4)]
    expected = [results(*one) for one in several]
    monkeypatch.setattr(networks, "warp_in_use", lambda: True)
    given, slopes = jax.tree.map(lambda *leaves: jnp.stack(leaves), *several)
    found = jax.vmap(results)(given, slopes)
    for k, twins in enumerate(expected):
        for one, twin in zip(found, twins, strict=True):
            close(one[k], twin)


@pytest.mark.oracle
@pytest.mark.skipif(COMPILER is None, reason="needs a C++ compiler")
def test_threads_of_a_gpu_do_what_the_twin_does():
    given, slopes = drawn(5)
    gates, weights, bias, carry, is_first = given
    rows, block = WORLDS * ROBOTS, 3 * UNITS
    dim = -(-rows // ROWS) * block
    sizes = [STEPS, rows, ROBOTS]
    flat = [x.reshape(-1) for x in (gates, weights, bias, carry, is_first.astype(np.int32))]
    blank = np.full(STEPS * rows * UNITS, np.nan, np.float32)
    run = partial(run_as_on_a_gpu, dim=dim, block=block)
    ahead = run(native_code(FORWARD, UNITS), warp_gru.forward_kernel(UNITS), [*flat, *sizes, blank])
    after = recur(*map(jnp.asarray, given))
    close(ahead[-1].reshape(after.shape), after)

    before = np.concatenate([carry[None], after[:-1]]) * ~is_first[..., None, None]
    own, _, update = map(
        np.asarray, networks._step_derivatives(gates, jnp.asarray(before), before @ weights, bias)
    )
    flat = [x.reshape(-1) for x in (slopes, own, update, weights, is_first.astype(np.int32))]
    blank = np.full((STEPS + 1) * rows * UNITS, np.nan, np.float32)
    back = run(native_code(BACKWARD, UNITS), warp_gru.backward_kernel(UNITS), [*flat, *sizes, blank])
    found = back[-1].reshape(STEPS + 1, WORLDS, ROBOTS, UNITS)
    start, all_slopes = networks._gradients_sequentially(
        *map(jnp.asarray, (slopes, own, update, weights, is_first))
    )
    close(found[0], start)
    close(found[1:], all_slopes)


def test_other_sizes_and_precisions_are_left_to_jax():
    assert fits(64, np.float32)
    assert fits(128, np.float32)
    assert not fits(48, np.float32)
    assert not fits(160, np.float32)
    assert not fits(0, np.float32)
    assert not fits(64, np.float64)
