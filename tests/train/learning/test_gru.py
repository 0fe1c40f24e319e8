"""The GRU's own gradient against that which JAX makes of a plain loop, and against finite differences."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params
from numpy.testing import assert_allclose, assert_array_equal

from usarmjx.train.learning.networks import recur

STEPS, WORLDS, ROBOTS, MEMORY = 6, 3, 2, 5
# Sums of at most 36 products, handed on over 6 steps, of numbers of order 1, relative to the largest.
SINGLE, DOUBLE = 1e-5, 1e-13
# Central differences over 1e-5 in double precision: 1e-10 of what is left out, 1e-11 of rounding, of order 1.
DIFFERENCES = 1e-8
NAMES = ("gates", "weights", "bias", "carry")


def plain(gates, weights, bias, carry, is_first):
    """The carry after each step, by a scan that JAX differentiates."""

    def step(carry, now):
        gates, is_first = now
        carry = jnp.where(is_first[:, None, None], 0.0, carry)
        reset, update, new = jnp.split(gates, 3, axis=-1)
        own_reset, own_update, own_new = jnp.split(carry @ weights, 3, axis=-1)
        update = jax.nn.sigmoid(update + own_update)
        new = jnp.tanh(new + jax.nn.sigmoid(reset + own_reset) * (own_new + bias))
        carry = (1.0 - update) * new + update * carry
        return carry, carry

    return jax.lax.scan(step, carry, (gates, is_first))[1]


def firsts(*steps, length=STEPS):
    """Episodes begin at these steps, in the first two worlds of three (steps, worlds)."""
    found = np.zeros((length, WORLDS), bool)
    found[list(steps), :2] = True
    return found


BEGINNINGS = {
    "never": firsts(),
    "first": firsts(0),
    "middle": firsts(3),
    "last": firsts(STEPS - 1),
    "several": firsts(0, 2, 3, STEPS - 1),
    "one step": firsts(length=1),
    "one step, the first": firsts(0, length=1),
}


def drawn(is_first, dtype: Any = np.float32):
    """Random arguments of `recur` but the last, and what is summed for a loss: weights of what comes out."""
    draw, steps = np.random.default_rng(6), len(is_first)
    shapes = (
        (steps, WORLDS, ROBOTS, 3 * MEMORY),
        (MEMORY, 3 * MEMORY),
        (MEMORY,),
        (WORLDS, ROBOTS, MEMORY),
        (steps, WORLDS, ROBOTS, MEMORY),
    )
    *values, cost = (draw.normal(size=shape).astype(dtype) for shape in shapes)
    return tuple(values), cost


def loss(function, is_first, cost, values):
    gates, weights, bias, carry = values
    return (cost * function(gates, weights, bias, carry, is_first)).sum()


def gradient(function, is_first, values, cost):
    """Of the loss by each of `NAMES`."""
    return jax.jit(jax.grad(partial(loss, function, is_first, cost)))(values)


@pytest.mark.oracle
@pytest.mark.parametrize("beginnings", BEGINNINGS)
def test_what_comes_out_is_that_of_the_plain_loop(beginnings):
    """Bit for bit, also where it is asked for beside the gradient: policies of old runs act as they did."""
    is_first = BEGINNINGS[beginnings]
    given: Any = (*drawn(is_first)[0], is_first)
    expected = jax.jit(plain)(*given)
    assert_array_equal(jax.jit(recur)(*given), expected)
    assert_array_equal(jax.jit(lambda *given: jax.vjp(recur, *given)[0])(*given), expected)


@pytest.mark.oracle
@pytest.mark.parametrize("beginnings", BEGINNINGS)
@pytest.mark.parametrize("dtype", [np.float32, pytest.param(np.float64, marks=pytest.mark.thorough)])
def test_the_gradient_is_that_of_the_plain_loop(beginnings, dtype):
    """By gates, weights, bias and first carry, whichever steps begin an episode."""
    is_first = BEGINNINGS[beginnings]
    with jax.enable_x64(dtype == np.float64):
        given = drawn(is_first, dtype)
        pairs = zip(NAMES, gradient(recur, is_first, *given), gradient(plain, is_first, *given), strict=True)
        for name, found, expected in pairs:
            assert found.dtype == dtype
            tolerance = (SINGLE if dtype == np.float32 else DOUBLE) * np.abs(expected).max()
            assert_allclose(found, expected, rtol=0, atol=tolerance, err_msg=name)


@pytest.mark.oracle
def test_the_gradient_is_that_of_finite_differences():
    """Along a random direction of each argument."""
    is_first = BEGINNINGS["middle"]
    with jax.enable_x64(True):
        values, cost = drawn(is_first, np.float64)
        slopes = gradient(recur, is_first, values, cost)
        draw, step = np.random.default_rng(7), 1e-5
        for n, value in enumerate(values):
            way = draw.normal(size=value.shape)
            way /= np.linalg.norm(way)
            ends = [(*values[:n], value + side * way, *values[n + 1 :]) for side in (step, -step)]
            ahead, behind = (loss(recur, is_first, cost, end) for end in ends)
            slope = (slopes[n] * way).sum()
            assert abs(slope) > 1e-2
            assert_allclose(slope, (ahead - behind) / (2 * step), rtol=0, atol=DIFFERENCES)


def test_nothing_is_learned_across_the_beginning_of_an_episode():
    """The carry that is thrown away has no gradient, and spoils no other even if it is not a number."""
    is_first = BEGINNINGS["first"]
    values, cost = drawn(is_first)
    found = gradient(recur, is_first, values, cost)[3]
    assert (found[:2] == 0).all()
    assert (found[2] != 0).all()
    carry = values[3].copy()
    carry[:2] = np.nan
    after = gradient(recur, is_first, (*values[:3], carry), cost)
    for name, one in zip(NAMES, after, strict=True):
        assert np.isfinite(one).all(), name


def test_a_step_of_the_gradient_has_one_product_and_hands_on_one_array():
    """What makes it fast on a GPU: all else is done for all steps at once."""
    values, cost = drawn(BEGINNINGS["middle"])
    jaxpr = jax.make_jaxpr(partial(gradient, recur, BEGINNINGS["middle"]))(values, cost).jaxpr
    scans = list(scans_of(jaxpr))
    assert [scan.params["reverse"] for scan in scans] == [False, True]
    for scan in scans:
        inside = [eqn.primitive.name for eqn in scan.params["jaxpr"].eqns]
        assert inside.count("dot_general") == 1
        assert len(scan.outvars) == 2, "the carry, and what is handed on"


def scans_of(jaxpr):
    """The scans of a program, of those that it calls too."""
    for eqn in jaxpr.eqns:
        if eqn.primitive.name == "scan":
            yield eqn
        for inner in jaxprs_in_params(eqn.params):
            yield from scans_of(inner)
