"""The table of kernels: what ran is named, counted and timed once, and nothing else."""

import jax
import jax.numpy as jnp
import pytest

from benchmarks.step import TOP, count_kernels, kernel_lines, profile_kernels
from usarmjx.base.errors import EngineError


def test_what_runs_within_another_is_not_counted_twice():
    """A loop of 100 ns around 30 and 20, and beside it, on another stream, 50."""
    lines = [
        [("loop", 0, 100), ("dot", 10, 30), ("add", 50, 20), ("dot", 100, 10)],
        [("copy", 20, 50)],
    ]
    found = count_kernels(lines)
    took = {one["name"]: (one["calls"], round(1e6 * one["ms"])) for one in found["top"]}
    assert took == {"loop": (1, 50), "dot": (2, 40), "copy": (1, 50), "add": (1, 20)}
    assert found["calls"] == 5
    assert 1e6 * found["ms"] == pytest.approx(160)
    assert 1e6 * found["span_ms"] == pytest.approx(110)
    assert sum(one["share"] for one in found["top"]) == pytest.approx(1)


def test_branches_of_a_graph_run_beside_each_other_and_count_each():
    """What begins within another one of a GPU is no part of it: shares were above 1, and sums too small."""
    found = count_kernels([[("a", 0, 100), ("b", 10, 80), ("b", 20, 90)]], nested=False)
    assert {one["name"]: round(1e6 * one["ms"]) for one in found["top"]} == {"a": 100, "b": 170}
    assert 1e6 * found["ms"] == pytest.approx(270)
    assert all(one["share"] < 1 for one in found["top"])


def test_the_longest_come_first_and_the_rest_is_left_out():
    found = count_kernels([[(f"k{i}", 1000 * i, i) for i in range(1, TOP + 11)]])
    assert [one["name"] for one in found["top"]] == [f"k{i}" for i in range(TOP + 10, 10, -1)]
    assert found["calls"] == TOP + 10


def test_nothing_seen_is_an_error():
    with pytest.raises(EngineError, match="saw no kernel"):
        count_kernels([[]])


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="a GPU's kernels have other names")
def test_a_loop_of_a_toy_is_told_with_its_calls():
    run = jax.jit(lambda x: jax.lax.fori_loop(0, 10, lambda _, y: jax.lax.sort(jnp.sin(y)), x))
    x = jnp.linspace(0.0, 1.0, 200_000)
    jax.block_until_ready(run(x))
    found = profile_kernels(run, x)
    sorts = [one for one in found["top"] if "sort" in one["name"]]
    assert sum(one["calls"] for one in sorts) == 10
    assert sum(one["share"] for one in sorts) > 0.3
    assert found["calls"] > 10
    assert any("sort" in line and " 10 x " in line for line in kernel_lines(found))
