"""Random numbers of many keys at once, and of distributions with bounds: on NumPy as on JAX."""

import jax
import numpy as np
import pytest

from usarmjx.base import random
from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsageError

# Near its bounds the inverse error function makes 200 times as much of the last place of what it is given.
NEAR_BOUNDS = 1e-4
ULPS = 4  # as in test_backend.py
SHAPES = [(3, 1), (2, random.MAX_LANES // 2), (2, random.MAX_LANES // 2 + 1), (1, 2, 3)]


def keys(count):
    """Keys of NumPy and of JAX, the same ones."""
    numbers = np.arange(7, 7 + count)
    with numpy_backend():
        ours = random.fold_in(random.key(3), numbers)
    return ours, random.fold_in(jax.random.key(3), numbers)


@pytest.mark.oracle
@pytest.mark.parametrize("count", [1, 2, 40])
def test_keys_of_many_numbers_are_those_of_each(count):
    ours, theirs = keys(count)
    each = [jax.random.key_data(jax.random.fold_in(jax.random.key(3), 7 + i)) for i in range(count)]
    np.testing.assert_array_equal(ours, each)
    np.testing.assert_array_equal(jax.random.key_data(theirs), each)


@pytest.mark.oracle
@pytest.mark.parametrize("shape", SHAPES)
def test_each_row_has_the_numbers_of_its_key(shape):
    ours, theirs = keys(shape[0])
    bound = np.linspace(0.1, 0.5, shape[0], dtype=np.float32).reshape(-1, *[1] * (len(shape) - 1))
    with numpy_backend():
        even, bell = random.uniform(ours, shape, -bound, bound), random.normal(ours, shape)
    for i, key in enumerate(theirs):
        shares = jax.random.uniform(key, shape[1:], minval=-bound[i], maxval=bound[i])
        np.testing.assert_array_equal(even[i], shares)
        np.testing.assert_array_max_ulp(bell[i], np.asarray(jax.random.normal(key, shape[1:])), ULPS)
    if shape == SHAPES[0]:  # JAX's own rows do not depend on how many there are
        np.testing.assert_array_equal(random.uniform(theirs, shape, -bound, bound), even)
        np.testing.assert_array_max_ulp(np.asarray(random.normal(theirs, shape)), bell, ULPS)


@pytest.mark.oracle
@pytest.mark.parametrize("bounds", [(-3.0, 3.0), (-0.5, 2.0)])
def test_what_is_cut_off_lies_within_and_is_jaxs(bounds):
    with numpy_backend():
        ours = random.truncated_normal(random.key(3), *bounds, (10_000,))
    theirs = random.truncated_normal(jax.random.key(3), *bounds, (10_000,))
    assert ours.dtype == np.float32
    assert bounds[0] < ours.min()
    assert ours.max() < bounds[1]
    np.testing.assert_allclose(ours, theirs, atol=NEAR_BOUNDS)


@pytest.mark.oracle
@pytest.mark.parametrize("bounds", [(0, 3), (-5, 100), (2, 3), (0, 70_000), (0, 2**31 - 1)])
@pytest.mark.parametrize("seed", [0, 1, 12345])
def test_whole_numbers_are_jaxs(seed, bounds):
    with numpy_backend():
        ours = random.randint(random.key(seed), *bounds)
    theirs = random.randint(jax.random.key(seed), *bounds)
    assert ours == theirs
    assert (ours.dtype, ours.shape) == (np.int32, ())
    assert bounds[0] <= ours < bounds[1]


@pytest.mark.oracle
@pytest.mark.parametrize("count", [0, 1, 7, 100, 2000])  # from 1626 on JAX sorts twice
def test_orders_are_jaxs(count):
    values = np.arange(count, dtype=np.int32)
    with numpy_backend():
        ours = random.permutation(random.key(3), values)
    np.testing.assert_array_equal(ours, random.permutation(jax.random.key(3), values))
    assert sorted(ours) == values.tolist()


SEEDS = (0, 1, 2**32 - 1, 2**32, 2**32 + 1, 2**33, 2**63, 2**64 - 1, np.int64(2**40), np.uint64(2**50))


def test_every_seed_has_a_key_of_its_own_on_both_libraries():
    with numpy_backend():
        ours = [tuple(random.key(seed).tolist()) for seed in SEEDS]
    theirs = [tuple(jax.random.key_data(random.key(seed)).tolist()) for seed in SEEDS]
    assert ours == theirs
    assert len(set(ours)) == len(SEEDS)
    np.testing.assert_array_equal(theirs[1], jax.random.key_data(jax.random.key(1)), err_msg="as ever")


@pytest.mark.parametrize("seed", [-1, 2**64, 1.5, "3", None])
def test_other_seeds_are_refused_with_the_range(seed):
    with pytest.raises(UsageError, match=r"expected a whole number from 0 to 2\^64 - 1"):
        random.key(seed)
