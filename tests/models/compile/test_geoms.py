"""Masses and inertias of bodies, as MuJoCo takes them."""

import mujoco
import numpy as np
import pytest

from usarmjx.models.compile.geoms import BALANCE, Inertia, set_inertia

ROUNDING = 5e-7  # half of what readers of files accept


@pytest.mark.parametrize("excess", [0.0, 1e-12, ROUNDING])
def test_moments_that_rounding_puts_out_of_balance_compile(excess):
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="plate")
    body.add_freejoint()
    moments = np.array([1.0, 1.3, 2.3 * (1.0 + excess)])
    set_inertia(body, Inertia(2.0, np.zeros(3), np.diag(moments)), [])
    # Ascending here, descending in MuJoCo; the largest one comes down to the sum of the others.
    found = np.sort(spec.compile().body_inertia[1])
    assert found[2] <= found[:2].sum()
    np.testing.assert_allclose(found, moments, rtol=2 * ROUNDING + (1.0 - BALANCE))
