"""The same functions and random numbers on NumPy as on JAX."""

import gc
import weakref

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.base import random
from usarmjx.base.backend import (
    MAX_RUNS,
    get_rows,
    jit,
    named_scope,
    numpy_backend,
    on_numpy,
    set_at,
    set_rows,
    stop_gradient,
    traced_once,
    vmap,
    xp,
)

ULPS = 4
"""XLA's logarithm and its fused products differ from NumPy's by so many units in the last place."""
SEEDS = (0, 1, 12345, 2**31 + 7)


def words(key):
    return np.asarray(jax.random.key_data(key))


@pytest.mark.oracle
@pytest.mark.parametrize("seed", SEEDS)
def test_keys_are_jaxs_to_the_bit(seed):
    key = jax.random.key(seed)
    with numpy_backend():
        ours = random.key(seed)
        folded, children = random.fold_in(ours, 2**32 - 3), random.split(ours, 7)
    np.testing.assert_array_equal(ours, words(key))
    np.testing.assert_array_equal(folded, words(jax.random.fold_in(key, np.uint32(2**32 - 3))))
    np.testing.assert_array_equal(children, words(jax.random.split(key, 7)))


@pytest.mark.oracle
@pytest.mark.parametrize("shape", [(), (1,), (3,), (5,), (40, 3), (0,)])
def test_uniform_numbers_are_jaxs_to_the_bit(shape):
    key = jax.random.key(3)
    with numpy_backend():
        ours = random.uniform(random.key(3), shape, -0.3, 0.7)
    theirs = jax.random.uniform(key, shape, minval=-0.3, maxval=0.7)
    assert ours.dtype == np.float32
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.oracle
def test_normal_numbers_are_jaxs_but_for_the_last_places():
    with numpy_backend():
        ours = random.normal(random.key(3), (100_000,))
    np.testing.assert_array_max_ulp(ours, np.asarray(jax.random.normal(jax.random.key(3), (100_000,))), ULPS)


def test_the_library_is_numpy_only_inside_and_numbers_stay_single():
    assert not on_numpy()
    with numpy_backend():
        assert on_numpy()
        made = [
            xp.zeros(2),
            xp.full(2, 1.5),
            xp.arange(3),
            xp.asarray([1.0]),
            xp.eye(2),
            xp.where(True, 1.0, 2),
        ]
        assert all(isinstance(one, np.ndarray) and one.dtype.itemsize == 4 for one in made)
        assert xp.full(2, True).dtype == bool
        with named_scope("anything"):
            x, y, z = xp.cross(xp.array([1.0, 2.0, 3.0]), xp.array([0.5, -1.0, 4.0]))
        assert (x, y, z) == (11.0, -2.5, -2.0)
    assert isinstance(xp.zeros(2), jax.Array)
    assert not on_numpy()


def test_the_library_comes_back_after_an_error():
    with pytest.raises(KeyError), numpy_backend():
        raise KeyError
    assert not on_numpy()


@pytest.mark.parametrize("axes", [0, (0, None, 0), ({"a": 0, "b": None}, None, 0)])
def test_mapping_over_rows_is_jaxs(axes):
    if axes == 0:
        args = ({"a": np.arange(6.0).reshape(2, 3), "b": np.ones((2, 3))}, np.ones((2, 1)), np.arange(2.0))
    elif isinstance(axes[0], dict):
        args = ({"a": np.arange(6.0).reshape(2, 3), "b": np.ones(3)}, np.ones(1), np.arange(2.0))
    else:
        args = ({"a": np.arange(6.0).reshape(2, 3), "b": np.ones((2, 3))}, np.ones(1), np.arange(2.0))

    def function(tree, shared, number):
        return {"sum": tree["a"] + tree["b"] * shared, "number": number * 2}

    with numpy_backend():
        ours = vmap(function, axes)(*args)
    theirs = jax.vmap(function, axes)(*jax.tree.map(jnp.asarray, args))
    jax.tree.map(np.testing.assert_array_equal, ours, jax.device_get(theirs))


@pytest.mark.parametrize("axis", [0, 1, -1])
@pytest.mark.parametrize("dtype", [np.float32, np.int32, bool])
def test_stacking_and_spreading_are_jaxs(axis, dtype):
    parts = [np.arange(6).reshape(2, 3).astype(dtype), np.ones((2, 3), dtype)]
    with numpy_backend():
        stacked, spread = xp.stack(parts, axis), xp.broadcast_to(parts[0], (4, 2, 3))
    for ours, theirs in (
        (stacked, jnp.stack(parts, axis)),
        (spread, jnp.broadcast_to(parts[0], (4, 2, 3))),
    ):
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)


def test_mapping_over_one_row_is_jaxs():
    args = {"a": np.arange(3.0, dtype=np.float32)[None]}, np.ones(1, np.float32)

    def function(row, number):
        return {"sum": row["a"].sum() + number, "row": row["a"]}

    with numpy_backend():
        ours = vmap(function)(*args)
    theirs = jax.vmap(function)(*args)
    for name, values in ours.items():
        assert values.shape == theirs[name].shape
        np.testing.assert_array_equal(values, theirs[name])


def test_setting_leaves_the_original():
    before = np.zeros(3)
    with numpy_backend():
        after = set_at(before, 1, 5.0)
    assert before.tolist() == [0, 0, 0]
    assert after.tolist() == [0, 5, 0]
    assert set_at(jnp.zeros(3), np.array([0, 2]), 1.0).tolist() == [1, 0, 1]


def test_rows_are_set_part_by_part_as_numpy_assigns_them():
    """Places of any shape, numbers that broadcast to them, and the last of what is set twice."""
    before = np.arange(14.0, dtype=np.float32).reshape(7, 2)
    parts = [
        (np.array([[0, 1], [5, 3]]), np.arange(2.0)[:, None, None]),
        (np.array([3]), np.array([[8.0, 9.0]])),
        (np.zeros(0, int), np.zeros((0, 2))),
    ]
    expected = before.copy()
    for places, new in parts:
        expected[places] = new
    with numpy_backend():
        np.testing.assert_array_equal(set_rows(before, *parts), expected)
    np.testing.assert_array_equal(set_rows(jnp.asarray(before), *parts), expected)
    assert before[0, 0] == 0.0, "NumPy's array is left as it was"
    assert set_rows(jnp.zeros(3, bool), (np.array([2]), np.array([1.0]))).tolist() == [False, False, True]


def test_a_map_over_worlds_sets_rows_of_each():
    worlds, new = jnp.arange(6.0).reshape(2, 3), jnp.array([[7.0], [8.0]])
    after = jax.vmap(lambda values, one: set_rows(values, (np.array([1]), one)))(worlds, new)
    assert after.tolist() == [[0, 7, 2], [3, 8, 5]]


def test_compiled_functions_run_as_they_are_on_numpy():
    seen = []

    @jit
    def total(values):
        seen.append(type(values))
        return xp.cumsum(xp.clip(stop_gradient(values), 0, 2))[-1]

    values = np.array([-1, 1, 5], np.int32)
    with numpy_backend():
        ours = total(values)
    assert seen == [np.ndarray]
    assert total(jnp.asarray(values)) == ours == 3
    assert ours.dtype == np.int32
    assert total(jnp.asarray(values)) == 3
    assert len(seen) == 2, "compiled once"


def test_parts_of_a_tick_are_named_in_compiled_code_only():
    @named_scope("outer")
    def function(x):
        with named_scope("inner"):
            return xp.sin(x)

    text = jax.jit(function).lower(1.0).as_text(debug_info=True)
    assert "outer/inner" in text
    with numpy_backend():
        assert function(np.float32(0.0)) == 0.0


@pytest.mark.parametrize("places", [[2, 3, 4], [0, 1, 2, 3, 4, 5], [4, 2], [], [[0, 2], [4, 1]]])
def test_rows_are_got_as_numpy_indexes_them(places):
    rows, values = np.array(places, int), np.arange(12.0, dtype=np.float32).reshape(6, 2)
    if rows.ndim == 1:
        with numpy_backend():
            np.testing.assert_array_equal(get_rows(values, rows), values[rows])
        np.testing.assert_array_equal(get_rows(jnp.asarray(values), rows), values[rows])
    expected = values.copy()
    expected[rows] = -1.0
    np.testing.assert_array_equal(set_rows(jnp.asarray(values), (rows, -1.0)), expected)


def test_many_blocks_of_rows_are_set_as_few_are():
    """More than `MAX_RUNS` blocks are gathered; both give what NumPy does."""
    values, odd = np.arange(80.0, dtype=np.float32), np.arange(1, 80, 2)
    expected = values.copy()
    expected[odd] = -odd
    assert len(odd) > MAX_RUNS
    np.testing.assert_array_equal(set_rows(jnp.asarray(values), (odd, -odd)), expected)


def test_successive_rows_take_no_gather():
    rows = np.array([2, 3])
    whole = jax.make_jaxpr(lambda x: set_rows(x, (rows, get_rows(x, rows) + 1)))(jnp.zeros(6))
    assert {str(one.primitive) for one in whole.eqns}.isdisjoint({"gather", "scatter"})


class Scale:
    """Owner of traced functions."""

    def __init__(self, factor):
        self.factor = factor


def test_a_function_is_traced_once_for_each_owner_and_lets_it_go():
    """By two programs, for each value of a static argument; on NumPy it is called as it is."""
    calls = []

    @traced_once("shift")
    def scaled(scale, values, *, shift=0.0):
        calls.append((scale.factor, shift))
        return scale.factor * values + shift

    def programs_of(scale):
        return jax.jit(lambda x: scaled(scale, x)), jax.jit(lambda x: -scaled(scale, x))

    values = np.arange(3, dtype=np.float32)
    scales = [Scale(2.0), Scale(3.0)]
    for sign in (0, 1):
        for i, factor in enumerate((2.0, 3.0)):
            found = programs_of(scales[i])[sign](values)
            np.testing.assert_array_equal(found, (-1) ** sign * factor * values)
    np.testing.assert_array_equal(scaled(scales[0], values, shift=1.0), 2.0 * values + 1.0)
    assert calls == [(2.0, 0.0), (3.0, 0.0), (2.0, 1.0)]
    with numpy_backend():
        assert type(scaled(scales[0], values)) is np.ndarray
    gone = weakref.ref(scales.pop(0))
    gc.collect()
    assert gone() is None
