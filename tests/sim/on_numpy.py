"""What tests of both libraries share: one tree compared with another, and what JAX traced meanwhile."""

from contextlib import contextmanager

import jax
import numpy as np

from tests.listening import compilations
from usarmjx.base.backend import numpy_backend


@contextmanager
def nothing_compiled():
    """On NumPy inside; afterwards nothing must have been traced or compiled: JAX tells of both."""
    with compilations() as events, numpy_backend():
        yield
    assert events == []


def as_numpy(tree):
    """Return a tree as worlds on NumPy have it: arrays of NumPy, keys by their two words."""

    def array(leaf):
        typed = isinstance(leaf, jax.Array) and jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        return np.array(jax.random.key_data(leaf) if typed else leaf)

    return jax.tree.map(array, tree)


def row(tree, i):
    """Return one row of a tree."""
    return jax.tree.map(lambda leaf: leaf[i], tree)


def assert_same(ours, theirs, rtol=0.0, atol=0.0):
    """A tree of NumPy's arrays is one of JAX's, types included; numbers may differ within tolerances."""
    paths, tree = jax.tree.flatten_with_path(ours)
    assert tree == jax.tree.structure(theirs)
    for (path, mine), other in zip(paths, jax.tree.leaves(theirs), strict=True):
        where = jax.tree_util.keystr(path)
        assert isinstance(mine, np.ndarray | np.generic), f"{where} is {type(mine)}"
        assert mine.dtype == other.dtype, f"{where}: {mine.dtype}, {other.dtype}"
        if mine.dtype == np.float32:
            np.testing.assert_allclose(mine, other, rtol=rtol, atol=atol, err_msg=where)
        else:
            np.testing.assert_array_equal(mine, other, err_msg=where)
