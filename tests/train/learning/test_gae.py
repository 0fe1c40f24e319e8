"""Advantages against a scalar transcription of their definition."""

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

from usarmjx.train.learning.ppo import advantages

# Sums of at most 40 numbers of order 1 in single precision.
ROUNDING = 1e-5


def by_definition(reward, value, bootstrap, last_value, ends, discount, trace):
    """A(t) = sum of (discount trace)^k surprise(t + k) up to the end of the episode, step by step."""
    done, truncated, bad = ends
    steps, found = len(reward), []
    for t in range(steps):
        total, weight = 0.0, 1.0
        for k in range(t, steps):
            if bad[k]:
                break
            if done[k]:
                after = bootstrap[k] if truncated[k] else 0.0
            else:
                after = value[k + 1] if k + 1 < steps else last_value
            total += weight * (reward[k] + discount * after - value[k])
            if done[k]:
                break
            weight *= discount * trace
        found.append(total)
    return np.array(found)


@pytest.mark.oracle
@pytest.mark.parametrize(("discount", "trace"), [(0.9, 0.95), (1.0, 1.0), (0.99, 0.0)])
def test_advantages_are_those_of_the_definition(discount, trace):
    """Many random sequences with ends, time-outs and bad steps, as one batch."""
    draw = np.random.default_rng(1)
    steps, batch = 40, 64
    reward, value, bootstrap = draw.normal(size=(3, steps, batch)).astype(np.float32)
    last = draw.normal(size=batch).astype(np.float32)
    done = draw.random((steps, batch)) < 0.15
    truncated, bad = done & (draw.random((steps, batch)) < 0.5), draw.random((steps, batch)) < 0.05
    done, truncated = done | bad, truncated & ~bad
    ends = (done, truncated, bad)
    assert all(some.any() for some in (truncated, bad, done & ~truncated & ~bad))
    found = jax.jit(advantages, static_argnums=(5, 6))(reward, value, bootstrap, last, ends, discount, trace)
    for b in range(batch):
        expected = by_definition(
            reward[:, b], value[:, b], bootstrap[:, b], last[b], [one[:, b] for one in ends], discount, trace
        )
        assert_allclose(found[:, b], expected, atol=ROUNDING, rtol=ROUNDING)


def test_nothing_of_a_bad_step_gets_out():
    """Its reward and the values around it may be anything."""
    steps = 6
    draw = np.random.default_rng(2)
    reward, value = draw.normal(size=(2, steps, 1)).astype(np.float32)
    bad = np.zeros((steps, 1), bool)
    bad[3] = True
    ends, last = (bad, np.zeros_like(bad), bad), np.zeros(1, np.float32)
    expected = advantages(reward, value, value, last, ends, 0.9, 0.9)
    reward[3], bootstrap = np.nan, value.copy()
    bootstrap[3] = np.inf
    assert_allclose(advantages(reward, value, bootstrap, last, ends, 0.9, 0.9), expected, atol=0)
    assert expected[3] == 0
