"""Traced programs do not grow unnoticed: counts before XLA, which no load changes."""

import json

import jax
import jax.numpy as jnp
import pytest

from benchmarks.program_size import BOUNDS, PROGRAMS, growths, program_size


def test_sizes_of_a_product_are_its_closed_form():
    """A product of (3, 4) and (4, 5): 2 * 3 * 4 * 5 operations; both are read and the result is written."""
    one, other = jnp.ones((3, 4)), jnp.ones((4, 5))
    size = program_size(jax.jit(jnp.matmul).lower(one, other))
    assert size["flops"] == 120
    assert size["bytes"] == 4 * (12 + 20 + 15)
    assert 3 < size["lines"] < 10
    assert size["scatters"] == 0


def test_writes_at_computed_indices_are_counted():
    """One write; what is written at a known place of a whole array is none."""
    size = program_size(jax.jit(lambda x, i: (x.at[i].set(1.0), x + 1)).lower(jnp.zeros(8), jnp.arange(2)))
    assert size["scatters"] == 1


def test_a_count_beyond_its_bound_is_named():
    bound = {"lines": 100, "flops": 1000}
    assert growths({"lines": 105, "flops": 10}, bound) == []
    assert growths({"lines": 106, "flops": 1051}, bound) == [
        "lines: 106, bound 100 (+6.0%)",
        "flops: 1,051, bound 1,000 (+5.1%)",
    ]


@pytest.mark.every_run("planar, whole step")
@pytest.mark.parametrize("name", PROGRAMS)
def test_no_program_grows_unnoticed(name):
    """A program that must grow gets new bounds: python -m benchmarks.program_size --write."""
    bounds = json.loads(BOUNDS.read_text(encoding="utf-8"))
    if jax.__version__ != bounds["jax"]:
        pytest.skip(f"the bounds are those of jax {bounds['jax']}, this is {jax.__version__}")
    assert growths(PROGRAMS[name](), bounds["programs"][name]) == []
