"""Rotations against MuJoCo's own and SciPy's, and the wire's axes against hand-made examples."""

import contextlib
import math

import jax
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import (
    mat_from_quat,
    mat_from_rotation_vector,
    quat_from_mat,
    rotation_vector,
    up_from_quat,
)
from usarmjx.base.transforms import (
    angles_from_mat,
    flip_angles,
    flip_vector,
    mat_from_angles,
    quat_from_angles,
)

DOUBLE_ATOL = 1e-9  # a few roundings of float64, amplified near the poles
FLOAT32_ATOL = 1e-4  # near half a turn the sine of 0.04 magnifies float32's 1e-7 some 25 times
FLIP = np.diag([1.0, -1.0, -1.0])

HALF_TURNS = [Rotation.from_rotvec(math.pi * axis) for axis in np.vstack([np.eye(3), np.ones(3) / 3**0.5])]

turns = st.floats(-math.pi + 1e-3, math.pi - 1e-3)
pitches = st.floats(-1.55, 1.55)  # at the poles roll and yaw are one
lengths = st.floats(-1e3, 1e3)
quick = settings(deadline=None)

to_vector = jax.jit(rotation_vector)
from_vector = jax.jit(mat_from_rotation_vector)


@quick
@given(st.tuples(lengths, lengths, lengths))
def test_flips_are_their_own_inverses(numbers):
    assert flip_vector(flip_vector(numbers)) == numbers
    assert flip_angles(flip_angles(numbers)) == numbers


@quick
@given(turns, pitches, turns)
def test_angles_survive_the_matrix(roll, pitch, yaw):
    back = angles_from_mat(mat_from_angles(roll, pitch, yaw))
    np.testing.assert_allclose(back, [roll, pitch, yaw], atol=DOUBLE_ATOL)


@quick
@given(turns, st.sampled_from([-math.pi / 2, math.pi / 2]), turns)
def test_at_the_poles_the_matrix_survives_with_all_of_the_turn_as_yaw(roll, pitch, yaw):
    mat = mat_from_angles(roll, pitch, yaw)
    angles = angles_from_mat(mat)
    assert angles[0] == 0
    np.testing.assert_allclose(mat_from_angles(*angles), mat, atol=1e-7)  # the arc sine's resolution there


@quick
@given(turns, pitches, turns)
def test_angles_mean_yaw_then_pitch_then_roll(roll, pitch, yaw):
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    np.testing.assert_allclose(mat_from_angles(roll, pitch, yaw), expected, atol=DOUBLE_ATOL)


@quick
@given(turns, pitches, turns)
def test_quaternion_is_the_one_mujoco_reads(roll, pitch, yaw):
    mat = np.zeros(9)
    mujoco.mju_quat2Mat(mat, quat_from_angles(roll, pitch, yaw))
    expected = mat_from_angles(roll, pitch, yaw)
    np.testing.assert_allclose(mat.reshape(3, 3), expected, atol=DOUBLE_ATOL)


@quick
@given(turns, pitches, turns)
def test_flipped_angles_turn_flipped_vectors(roll, pitch, yaw):
    ours = mat_from_angles(*flip_angles((roll, pitch, yaw)))
    np.testing.assert_allclose(ours, FLIP @ mat_from_angles(roll, pitch, yaw) @ FLIP, atol=DOUBLE_ATOL)


@pytest.mark.oracle
@quick
@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.floats(0.0, 3.1))
def test_rotation_vectors_against_scipy(axis, angle):
    norm = np.linalg.norm(axis)
    vector = np.asarray(axis) / norm * angle if norm > 1e-3 else np.zeros(3)
    mat = from_vector(vector.astype(np.float32))
    np.testing.assert_allclose(mat, Rotation.from_rotvec(vector).as_matrix(), atol=1e-6)
    np.testing.assert_allclose(to_vector(mat), vector, atol=FLOAT32_ATOL)


def test_matrices_come_in_batches():
    roll, pitch, yaw = np.random.default_rng(1).uniform(-1, 1, (3, 2, 4))
    batch = mat_from_angles(roll, pitch, yaw)
    assert batch.shape == (2, 4, 3, 3)
    one = mat_from_angles(roll[1, 2], pitch[1, 2], yaw[1, 2])
    np.testing.assert_allclose(batch[1, 2], one, atol=DOUBLE_ATOL)
    np.testing.assert_allclose(angles_from_mat(batch)[1, 2], [roll[1, 2], pitch[1, 2], yaw[1, 2]])


@pytest.mark.parametrize(
    ("wire", "ours"),
    [
        ((1.0, 2.0, 3.0), (1.0, -2.0, -3.0)),  # ahead, to the right, below
        ((-1.0, -2.0, -3.0), (-1.0, 2.0, 3.0)),  # behind, to the left, above
    ],
)
def test_vectors_of_the_wire(wire, ours):
    assert flip_vector(wire) == ours


# SAE J670 (manual 6.1): a positive yaw turns to the right, a positive pitch lifts the nose, a positive
# roll lowers the right side. Ours: x forward, y left, z up.
@pytest.mark.parametrize(
    ("angles", "carried", "lands_on"),
    [
        ((0, 0, math.pi / 2), (1, 0, 0), (0, -1, 0)),  # nose to the right
        ((0, 0, -math.pi / 2), (1, 0, 0), (0, 1, 0)),  # nose to the left
        ((0, math.pi / 2, 0), (1, 0, 0), (0, 0, 1)),  # nose up
        ((0, -math.pi / 2, 0), (1, 0, 0), (0, 0, -1)),  # nose down
        ((math.pi / 2, 0, 0), (0, -1, 0), (0, 0, -1)),  # right side down
        ((-math.pi / 2, 0, 0), (0, -1, 0), (0, 0, 1)),  # right side up
    ],
)
def test_angles_of_the_wire(angles, carried, lands_on):
    mat = mat_from_angles(*flip_angles(angles))
    np.testing.assert_allclose(mat @ carried, lands_on, atol=DOUBLE_ATOL)


def test_the_z_axis_of_frames_is_the_last_column_of_their_matrices():
    quats = np.random.default_rng(0).normal(size=(5, 4)).astype(np.float32)
    with numpy_backend():
        assert (up_from_quat(quats) == mat_from_quat(quats)[..., 2]).all()


def test_quaternions_of_matrices_are_scipys_also_at_half_turns():
    turns = Rotation.concatenate([Rotation.random(500, random_state=3), *HALF_TURNS])
    for backend in (contextlib.nullcontext, numpy_backend):
        with backend():
            found = np.asarray(quat_from_mat(turns.as_matrix().astype(np.float32)))
        expected = turns.as_quat(scalar_first=True)
        assert np.abs((found * expected).sum(-1)) == pytest.approx(1.0, abs=1e-6)
        assert np.linalg.norm(found, axis=-1) == pytest.approx(1.0, abs=1e-6)
