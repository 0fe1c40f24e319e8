"""`Batch` as a class: methods that `help` shows and subclasses override."""

import io
import pydoc

import jax.numpy as jnp
import numpy as np
import pytest

from tests.engines.eager import EAGER
from usarmjx import Batch, build_scene
from usarmjx.train import open_floor

STEPS = 3


class Ahead(Batch):
    """Its robots drive ahead in each step, and its worlds count resets."""

    resets = 0

    def step(self, state):
        return super().step(self.drive(state, 0, {"Left": 4.0, "Right": 4.0}))

    def reset_where(self, state, mask):
        self.resets += 1
        return super().reset_where(state, mask)


@pytest.fixture(scope="module", params=["c", "planar"])
def batches(request):
    scene = build_scene(open_floor(), [EAGER])
    return Ahead(scene, 2, engine=request.param), Batch(scene, 2, engine=request.param)


def moved(batch, state):
    """How far robots are from where they started [m]."""
    start = batch.physics(batch.reset()).qpos[:, :2]
    return np.linalg.norm(batch.physics(state).qpos[:, :2] - start, axis=-1)


@pytest.mark.parametrize("name", ["step", "reset_where", "run"])
def test_help_shows_the_methods(name):
    assert hasattr(Batch, name)
    page = io.StringIO()
    pydoc.Helper(output=page).help(Batch)
    assert f"{name}(self, state: " in page.getvalue()
    assert getattr(Batch, name).__doc__


@pytest.mark.every_run("c")
def test_a_subclass_steps_its_own_way(batches):
    ahead, plain = batches
    stepped = ahead.reset()
    for _ in range(STEPS):
        stepped = ahead.step(stepped)
    assert (moved(ahead, stepped) > 0.002).all()
    assert (moved(plain, plain.step(plain.reset())) < 1e-3).all()
    at_once = ahead.run(ahead.reset(), STEPS)
    np.testing.assert_allclose(ahead.physics(at_once).qpos, ahead.physics(stepped).qpos, atol=1e-5)
    assert (moved(plain, plain.run(plain.reset(), STEPS)) < 1e-3).all()


def test_a_subclass_resets_its_own_way(batches):
    ahead, _ = batches
    state = ahead.run(ahead.reset(), STEPS)
    again = ahead.reset_where(state, jnp.array([True, False]))
    assert ahead.resets == 1
    assert moved(ahead, again)[1] == moved(ahead, state)[1]
    assert np.asarray(again.worlds.episode).tolist() == [1, 0]
