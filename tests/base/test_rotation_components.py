"""Rotations by their numbers: MuJoCo's own functions are the oracle, within rounding of single precision."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import (
    apply,
    cross,
    dot,
    matrix_rows,
    minus,
    parts,
    plus,
    quat_times,
    rotated,
    rotation,
    times,
    transposed,
)

NEAR = 2e-6
"""Some units in the last place of numbers of about one."""
RNG = np.random.default_rng(5)
QUATS, OTHERS = (q / np.linalg.norm(q, axis=-1, keepdims=True) for q in RNG.normal(size=(2, 20, 4)))
VECTORS, AXES = RNG.normal(size=(2, 20, 3))


def by_mujoco(function, size, *arguments):
    """Return what one of MuJoCo's functions writes, row by row."""
    found = np.zeros((len(arguments[0]), size))
    for row, given in zip(found, zip(*arguments, strict=True), strict=True):
        function(row, *given)
    return found


def single(values):
    """Return the numbers of vectors, in single precision."""
    return parts(jnp.asarray(values, jnp.float32))


@pytest.mark.oracle
def test_products_and_turns_of_quaternions_are_mujocos():
    product = np.stack(quat_times(single(QUATS), single(OTHERS)), -1)
    assert product == pytest.approx(by_mujoco(mujoco.mju_mulQuat, 4, QUATS, OTHERS), abs=NEAR)
    ahead = np.stack(rotated(single(QUATS), single(VECTORS)), -1)
    assert ahead == pytest.approx(by_mujoco(mujoco.mju_rotVecQuat, 3, VECTORS, QUATS), abs=3 * NEAR)


@pytest.mark.oracle
def test_matrices_are_mujocos_however_long_a_quaternion_is():
    expected = by_mujoco(mujoco.mju_quat2Mat, 9, QUATS).reshape(-1, 3, 3)
    mat = rotation(single(3 * QUATS))
    assert np.moveaxis(np.array(mat), -1, 0) == pytest.approx(expected, abs=NEAR)
    there = np.stack(apply(mat, single(VECTORS)), -1)
    assert there == pytest.approx(np.einsum("nij,nj->ni", expected, VECTORS), abs=3 * NEAR)
    back = np.stack(apply(transposed(mat), parts(jnp.asarray(there))), -1)
    assert back == pytest.approx(VECTORS, abs=5 * NEAR)


def test_sums_and_products_are_numpys():
    one, other = parts(VECTORS), parts(AXES)
    assert np.stack(plus(one, other), -1) == pytest.approx(VECTORS + AXES)
    assert np.stack(minus(one, other), -1) == pytest.approx(VECTORS - AXES)
    assert np.stack(times(one, 2.0), -1) == pytest.approx(2 * VECTORS)
    assert dot(one, other) == pytest.approx((VECTORS * AXES).sum(-1))
    assert np.stack(cross(one, other), -1) == pytest.approx(np.cross(VECTORS, AXES))
    square = RNG.normal(size=(4, 3, 3))
    assert np.array(matrix_rows(square)) == pytest.approx(np.moveaxis(square, 0, -1))


def test_numpy_and_jax_agree():
    with numpy_backend():
        mine = rotation(parts(np.float32(QUATS)))
        assert all(isinstance(number, np.ndarray) for row in mine for number in row)
    theirs = jax.jit(lambda quat: rotation(parts(quat)))(jnp.asarray(QUATS, jnp.float32))
    assert np.array(mine) == pytest.approx(np.array(theirs), abs=NEAR)
