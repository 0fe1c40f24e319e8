"""Slopes through drives and ranges, in both modes, by finite differences."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.engines.eager import AT_ONCE, EAGER, around
from usarmjx.base.rotations import mat_from_quat, parts
from usarmjx.engines.planar.flight import rotate, sinc
from usarmjx.engines.planar.footprints import (
    Footprints,
    apply_separation,
    contact_candidates,
    deepest_overlap,
    footprint_components,
    separation_step,
)
from usarmjx.engines.planar.neighbor_lists import obstacle_outlines
from usarmjx.engines.planar.responses import override_response
from usarmjx.engines.planar.solids import project_geoms
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import StartPose
from usarmjx.models.types.robot import Mount, options
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.rays import raycast
from usarmjx.sensors.rays.raycast import RayQuery, cast_rays
from usarmjx.sensors.rays.targets import make_geoms
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

GEOM = mujoco.mjtGeom
KINDS = np.array(
    [
        int(kind)
        for kind in (
            GEOM.mjGEOM_BOX,
            GEOM.mjGEOM_SPHERE,
            GEOM.mjGEOM_CAPSULE,
            GEOM.mjGEOM_CYLINDER,
            GEOM.mjGEOM_ELLIPSOID,
        )
    ]
)
AROUND = np.linspace(0.0, 2 * np.pi, len(KINDS), endpoint=False)
PLACES = np.column_stack([1.6 * np.cos(AROUND), 1.6 * np.sin(AROUND), 0.1 * AROUND])
BEAMS = np.linspace(-np.pi, np.pi, 60, endpoint=False)
NUDGE = 3e-3


def ranges_at(pose):
    """Ranges of a fan of beams at a pose (x, y, yaw), and of the geoms all turned by a fourth number."""
    half = pose[3] / 2 + 0.3
    turn = mat_from_quat(jnp.stack([jnp.cos(half), 0 * half, 0.6 * jnp.sin(half), 0.8 * jnp.sin(half)]))
    count = len(KINDS)
    geoms = make_geoms(
        KINDS,
        jnp.asarray(PLACES, jnp.float32) + pose[3] * jnp.array([0.2, -0.3, 0.1]),
        jnp.tile(turn, (count, 1, 1)),
        jnp.tile(jnp.array([0.5, 0.4, 0.6]), (count, 1)),
        jnp.full(count, -1),
    )
    way = pose[2] + BEAMS
    along = jnp.stack([jnp.cos(way), jnp.sin(way), 0 * way], -1)
    origin = jnp.tile(jnp.array([0.0, 0.0, 0.3]), (len(BEAMS), 1)).at[:, :2].add(pose[:2])
    return jnp.minimum(cast_rays(geoms, origin, along, RayQuery()).distance, 8.0)


@pytest.mark.parametrize("culling", [raycast.CULLING_THRESHOLD, 0], ids=["all", "culled"])
def test_ranges_change_with_poses_as_small_steps_show(culling, monkeypatch):
    """Of every kind of solid, beams that pass it included; by poses of who looks and of what is seen."""
    monkeypatch.setattr(raycast, "CULLING_THRESHOLD", culling)
    monkeypatch.setattr(raycast, "CULLING_GEOMS", 0)
    pose = jnp.array([0.2, -0.1, 0.4, 0.1])
    ranges = jax.jit(jax.vmap(ranges_at))
    steps = NUDGE * np.vstack([np.eye(4), -np.eye(4)])
    moved = np.asarray(ranges(jnp.asarray(pose + steps, jnp.float32)))
    apart = (moved[:4] - moved[4:]).T / (2 * NUDGE)
    forward = np.asarray(jax.jit(jax.jacfwd(ranges_at))(pose))
    weight = jnp.asarray(np.random.default_rng(0).normal(size=len(BEAMS)), jnp.float32)
    backward = np.asarray(jax.jit(jax.grad(lambda at: ranges_at(at) @ weight))(pose))
    here = np.asarray(ranges(pose[None]))[0]
    met = here < 8.0
    assert 20 < met.sum() < 50, "some beams pass all"
    assert not forward[~met].any()
    assert np.isfinite(forward).all()
    smooth = met & (np.abs(moved[:4] + moved[4:] - 2 * here).max(0) < 2e-3)  # no edge in between
    assert smooth.sum() > 15, "hit fairly"
    assert forward[smooth] == pytest.approx(apart[smooth], abs=0.02, rel=0.03)
    assert backward == pytest.approx(np.asarray(weight) @ forward, rel=1e-4)


@pytest.mark.slow
def test_where_robots_get_to_changes_with_what_wheels_are_told_as_small_steps_show():
    """Backwards through drives of twenty steps, beside what hovers at rest."""
    row = FLAT.__class__(
        name="row",
        starts=tuple(
            StartPose(tag=f"S{i}", at=(x, y, 0.188), yaw=yaw)
            for i, (x, y, yaw) in enumerate(((0.0, 0.0, 0.0), (0.8, 1.5, 0.3), (0.0, 3.0, 0.0)))
        ),
        extent=((-5, 5), (-5, 5)),
    )
    blimp = replace(ROBOTS.get("Passarola"), sensors=(), cameras=())
    batch = Batch(build_scene(row, [EAGER, EAGER, blimp]), 1, engine="planar")
    start = batch.drive(batch.reset(), 0, {"Left": 0.0, "Right": 0.0})
    _, inputs = batch._compute_inputs(start.worlds, batch.physics(start))
    wheels = batch.engine._robots.rolling[0].ctrl[0]
    roots = np.concatenate([group.root_qposadr for group in batch.scene.groups])
    weight = jnp.asarray(np.random.default_rng(1).normal(size=(3, 7)), jnp.float32)

    @jax.jit
    def ends(sides):
        ctrl = inputs.ctrl.at[0, wheels].set(jnp.repeat(sides, len(wheels) // 2))
        told = inputs.replace(ctrl=ctrl)
        step = lambda _, now: batch.engine.advance(now, told)  # noqa: E731
        return jax.lax.fori_loop(0, 20, step, start.physics).qpos[0, roots]

    sides = jnp.array([6.0, 6.4])
    backward = np.asarray(jax.jit(jax.grad(lambda told: (ends(told) * weight).sum()))(sides))
    near = [np.asarray(ends(sides + step)) for step in 0.05 * np.vstack([np.eye(2), -np.eye(2)])]
    apart = (np.array(near[:2]) - near[2:]) / 0.1
    assert np.abs(apart[:, 0, :2]).max(-1).min() > 1e-2, "both wheels matter"
    assert backward == pytest.approx((apart * np.asarray(weight)).sum((1, 2)), rel=0.05, abs=1e-3)


BEHIND = Shape(kind="cylinder", size=(0.3, 0.5, 0.0), at=(-0.6, 1.4, 0.5), surface="wall")
AHEAD = Shape(kind="box", size=(0.1, 4.0, 0.5), at=(2.0, 0.0, 0.5), rotation=(0.0, 0.0, 0.2), surface="wall")
SEEING = replace(
    EAGER,
    name="Seeing",
    sensors=(
        Mount(
            kind="RangeScanner",
            name="Scanner1",
            at=(0.1, 0.0, 0.0),
            defaults=options(MaxRange=8.0, Resolution=0.25, ScanFov=6.0, ScanInterval=0.1),
        ),
    ),
)
override_response(SEEING, replace(AT_ONCE, forward_lag=0.1, turn_lag=0.05, acceleration=50.0))


@pytest.mark.thorough
def test_ranges_change_with_what_wheels_are_told_as_small_steps_show():
    """From DRIVE to the readings of a scanner after half a second, through the batch that everyone uses."""
    batch = Batch(build_scene(replace(FLAT, shapes=(AHEAD, BEHIND)), [SEEING]), 1, engine="planar")
    begun = batch.reset()

    def scan(sides):
        state = batch.drive(begun, 0, {"Left": sides[0], "Right": sides[1]})
        state = jax.lax.fori_loop(0, 25, lambda _, now: batch.step(now), state)
        return batch.observe(state)[1][0][0].value[0, 0]

    sides, step = jnp.array([3.0, 4.0]), 0.02
    around_them = sides + step * np.array([(1, 0), (0, 1), (0, 0), (-1, 0), (0, -1)])
    near = np.asarray(jax.jit(jax.vmap(scan))(around_them))
    here, apart = near[2], (near[:2] - near[3:]) / (2 * step)
    bend = np.abs(near[:2] + near[3:] - 2 * here).max(0)
    met = (here < 8.0) & (bend < 1e-3)  # no edge in between
    assert (~met).any()
    assert met.sum() > 8
    assert np.abs(apart[:, met]).max(-1).min() > 0.02, "both wheels matter"
    forward = np.asarray(jax.jit(jax.jacfwd(scan))(sides)).T
    assert forward[:, met] == pytest.approx(apart[:, met], abs=2e-3, rel=0.03)
    weight = jnp.asarray(met * np.random.default_rng(3).normal(size=met.shape), jnp.float32)
    backward = np.asarray(jax.jit(jax.grad(lambda told: scan(told) @ weight))(sides))
    assert backward == pytest.approx(forward @ np.asarray(weight), rel=1e-3, abs=1e-5)


@pytest.mark.parametrize("angle", [0.0, 1e-24, 3e-3, 0.3])
def test_turns_have_slopes_however_small_they_are(angle):
    """By the exponential map: a quaternion changes with its vector by half of it at rest."""
    start, vector = jnp.array([[1.0, 0.0, 0.0, 0.0]]), jnp.array([[angle, 0.0, 0.0]])
    slopes = jax.jacrev(lambda by: jnp.stack(rotate(parts(start), parts(by)), -1)[0])(vector)
    slope = np.asarray(slopes)[:, 0]
    expected = np.zeros((4, 3))
    expected[:2, 0] = -np.sin(angle / 2) / 2, np.cos(angle / 2) / 2
    expected[[2, 3], [1, 2]] = 0.5 * np.sinc(angle / 2 / np.pi)
    assert slope == pytest.approx(expected, abs=1e-5)
    by_itself = jax.grad(sinc)(jnp.float32(angle))
    exact = -angle / 3 if angle < 0.01 else np.cos(angle) / angle - np.sin(angle) / angle**2
    assert float(by_itself) == pytest.approx(exact, abs=1e-4)


def test_a_push_has_the_slope_that_small_steps_show():
    """Where two that overlap come to, one of them with a corner in the other's side, a third far away."""
    overlapping = Footprints(
        pos=jnp.array([[0.3, 0.0], [0.8, 0.1], [0.0, 3.0]]),
        yaw=jnp.array([0.0, 0.3, 0.0]),
        half=jnp.array([[0.3, 0.25], [0.3, 0.25], [0.5, 0.3]]),
        low=jnp.zeros(3),
        high=jnp.ones(3),
        step=jnp.zeros(3),
        mass=jnp.array([20.0, 30.0, 1.0]),
    )
    none = project_geoms(np.zeros(0, int), jnp.zeros((0, 3)), jnp.zeros((0, 3, 3)), jnp.zeros((0, 3)))
    overlapping = jax.tree.map(lambda x: x[None], overlapping)
    near, moves = obstacle_outlines(overlapping, around(overlapping, none).near), jnp.ones((3, 1), bool)
    weight = jnp.asarray(np.random.default_rng(2).normal(size=(3, 3)), jnp.float32)

    @jax.jit
    def found(x):
        prints = footprint_components(overlapping.replace(pos=overlapping.pos.at[0, 0, 0].set(x)))
        others = contact_candidates(prints, prints, near, moves, None, discs=True)
        deepest = deepest_overlap(prints.outline, others, others.same_height)
        apart = apply_separation(prints, separation_step(prints.outline, others, deepest), moves)
        return (jnp.hstack([apart.outline.x, apart.outline.y, apart.yaw]) * weight).sum()

    slope = float(jax.jit(jax.grad(found))(0.3))
    assert slope == pytest.approx(float(found(0.31) - found(0.29)) / 0.02, rel=0.02)
