"""Engine `planar`: what is known of what is around robots is forgotten where a victim's limb comes near."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.engines.eager import EAGER
from usarmjx.engines.base import GeomPoses
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.neighbor_lists import LIST_LENGTH
from usarmjx.engines.planar.proposed_motion import MovableSolids
from usarmjx.models.compile.physics import Physics
from usarmjx.models.types.arena import ArenaSpec, SegmentMotion, StartPose, Victim
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

SWEEP = SegmentMotion(name="LeftArm", final=(0.0, 0.0, 1.2), initial=(0.0, 0.0, 0.01), rates=(0.0, 0.0, 1.0))
"""Lying on its back the victim sweeps the ground beside it, out to 0.9 m and back."""
RING = np.linspace(0, math.tau, 3 * LIST_LENGTH, endpoint=False)
WARD = ArenaSpec(
    name="ward",
    starts=tuple(
        StartPose(tag=f"S{i}", at=(x, y, 0.188), yaw=yaw)
        for i, (x, y, yaw) in enumerate(((0.4, 1.6, -math.pi / 2), (2.5, 0.0, 3.0), (-3.0, -3.0, 0.3)))
    ),
    extent=((-6, 6), (-6, 6)),
    shapes=tuple(
        Shape(
            kind="box",
            size=(0.3, 0.1, 0.5),
            at=(5 * math.cos(way), 5 * math.sin(way), 0.5),
            rotation=(0.0, 0.0, way + 1.0),
            surface="wall",
        )
        for way in RING
    ),
    victims=(Victim(name="Ada", at=(0.0, 0.0, 0.12), segments=(SWEEP,)),),
)
WORLDS, STEPS = 6, 80


def ward():
    return Batch(build_scene(WARD, [EAGER] * 3, Physics(timestep=0.05, substeps=1)), WORLDS, engine="planar")


@pytest.fixture(scope="module")
def batch():
    return ward()


def ends(batch, *, forgetful=False):
    """Where robots get to (worlds, nq), told anything every 0.5 s, and how often they look."""
    rng, looks = np.random.default_rng(3), []
    state = batch.reset()
    for step in range(STEPS):
        if step % 10 == 0:
            told = rng.uniform(-1.0, 5.0, (2, WORLDS, 3)).astype(np.float32)
            state = batch.drive(state, 0, {"Left": told[0], "Right": told[1]})
        around = state.physics.neighbors
        if forgetful:
            around = jax.tree.map(jnp.zeros_like, around)
            state = state.replace(physics=state.physics.replace(neighbors=around))
        state = batch.step(state)
        looks.append((np.asarray(around.at) != state.physics.neighbors.at).any((1, 2)))
    return np.asarray(batch.physics(state).qpos), np.mean(looks)


@pytest.fixture(scope="module")
def truth(batch):
    return ends(batch, forgetful=True)


def test_robots_meet_limbs_as_if_all_was_looked_up_in_each_step(batch, truth):
    found, looks = ends(batch)
    assert looks < 0.7 < truth[1], "it is not, though limbs move in each step"
    assert np.array_equal(found, truth[0])


@pytest.mark.thorough
def test_limbs_that_come_near_are_noticed(truth, monkeypatch):
    monkeypatch.setattr(MovableSolids, "moved_nearby", lambda *_: jnp.bool_(False))
    assert not np.array_equal(ends(ward())[0], truth[0]), "robots pass through limbs otherwise"


@pytest.mark.parametrize(
    ("then", "now", "near"),
    [(0.79, 5.0, True), (5.0, 0.79, True), (0.5, 0.5, False), (0.81, 5.0, False), (5.0, 4.0, False)],
)
def test_near_is_what_has_moved_and_is_near_now_or_was(then, now, near):
    """A ball of 0.1 m, on a body where a robot is, whose circle has 0.5 m and that gets 0.2 m far: 0.8 m."""
    place = np.array([[1.0, 2.0, 0.0]])
    ball = MovableSolids(
        loose=np.zeros(0, int),
        pose_index=np.zeros(1, int),
        size=np.array([[0.1, 0.0, 0.0]]),
        origin=place,
        turn=np.array([[[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]]),  # its x is the plan's y
    )
    prints = Footprints(
        pos=jnp.asarray(place[:, :2]),
        yaw=jnp.zeros(1),
        half=jnp.array([[0.3, 0.4]]),
        low=jnp.zeros(1),
        high=jnp.ones(1),
        step=jnp.zeros(1),
        mass=jnp.ones(1),
    )

    def at(x):
        poses = GeomPoses(pos=jnp.array([[x, 0.0, 0.0]]), quat=jnp.array([[1.0, 0.0, 0.0, 0.0]]))
        return ball.placement(jnp.zeros(0), poses).geoms

    assert bool(ball.moved_nearby(at(then), at(now), prints, jnp.array([0.2]))) == near
