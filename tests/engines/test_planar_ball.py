"""Engine `planar`: a ball rolls, bounces and is pushed as on C MuJoCo, and stops robots where it is stuck."""

from dataclasses import replace

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from usarmjx.engines.planar.responses import override_response, response_of
from usarmjx.models.arenas.soccer import BALL_RADIUS
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene
from usarmjx.train.tasks.soccer_field import BLUE, SOCCER_FIELD, soccer_robot

WALL = Shape(kind="box", size=(0.1, 2.0, 0.3), at=(2.0, 0.0, 0.3), surface="wall")
"""Sizes are half sides: its face is at x = 1.9."""
YARD = ArenaSpec(
    name="yard",
    starts=(StartPose(tag="S", at=(0.0, 0.0, 0.2), yaw=0.0),),
    extent=((-5, 5), (-5, 5)),
    shapes=(WALL,),
    loose=SOCCER_FIELD.loose,
)
PERIOD = 0.02
FACE = 1.9 - BALL_RADIUS


@pytest.fixture(scope="module")
def scene():
    return yard(YARD)


def yard(arena):
    # Measuring takes seconds; at the speeds here it answers its motors as the class that it is made of. A
    # name of its own: other tests measure the soccer robot.
    kicker = replace(soccer_robot(BLUE), name="Kicker")
    override_response(kicker, response_of(ROBOTS.get("P2DX")))
    return build_scene(arena, [kicker])


def indices(scene):
    return scene.loose_geoms.root_qposadr[0], scene.loose_geoms.root_dof[0]


def turning(balls, roll):
    """Rates about x and y of balls that roll by a share (worlds, 2)."""
    return roll[:, None] * balls[:, [3, 2]] * [-1, 1] / BALL_RADIUS


def on_planar(scene, balls, roll, seconds, speed=0.0):
    """Positions, velocities and rates of balls (x, y, vx, vy) that roll by a share, and the robot's x.

    Each (steps, worlds, n); the robot drives ahead at a speed [m/s].
    """
    batch = Batch(scene, len(balls), engine="planar")
    root, dof = indices(scene)
    state = batch.reset()
    qpos, qvel = np.array(state.physics.qpos), np.array(state.physics.qvel)
    qpos[:, root[:2]], qvel[:, dof[:2]], qvel[:, dof[3:5]] = balls[:, :2], balls[:, 2:], turning(balls, roll)
    state = state.replace(physics=state.physics.replace(qpos=jnp.array(qpos), qvel=jnp.array(qvel)))
    return driven(batch, state, seconds, speed)


def driven(batch, state, seconds, speed):
    scene = batch.scene
    root, dof = indices(scene)
    wheel = jnp.full((batch.worlds, 1), speed / scene.groups[0].robot.wheel_radius)
    state, rows = batch.drive(state, 0, {"Left": wheel, "Right": wheel}), []
    for _ in range(round(seconds / PERIOD)):
        state = batch.step(state)
        now = batch.physics(state)
        q, v = np.array(now.qpos), np.array(now.qvel)
        robot = q[:, scene.groups[0].root_qposadr[0, :1]]
        rows.append((q[:, root[:2]], v[:, dof[:2]], v[:, dof[3:]], robot))
    return [np.stack(part) for part in zip(*rows, strict=True)]


def on_c(scene, ball, roll, seconds):
    """Positions, velocities and rates of one ball on MuJoCo itself, each (steps, n); the robot stands."""
    model, data = scene.model, mujoco.MjData(scene.model)
    root, dof = indices(scene)
    data.qpos[root[:2]], data.qpos[root[2]], data.qvel[dof[:2]] = ball[:2], BALL_RADIUS, ball[2:]
    data.qvel[dof[3:5]] = turning(ball[None], np.array([roll]))[0]
    rows = []
    for _ in range(round(seconds / PERIOD)):
        for _ in range(round(PERIOD / model.opt.timestep)):
            mujoco.mj_step(model, data)
        rows.append((data.qpos[root[:2]].copy(), data.qvel[dof[:2]].copy(), data.qvel[dof[3:]].copy()))
    return [np.stack(part) for part in zip(*rows, strict=True)]


def test_a_ball_slides_until_it_rolls_and_then_rolls_on(scene):
    """Closed form: friction slows it by mu g and turns it up by 5/2 mu g / r, until v = w r at 5/7 v."""
    balls = np.array([[-3.0, 1.0, 0.5, 0.0], [-3.0, -1.0, 0.5, 0.0]], np.float32)
    _, speed, rate, _ = on_planar(scene, balls, np.array([0.0, 1.0]), 2.0)
    drag = 0.01 * 9.81
    time = PERIOD * np.arange(1, 101)
    rolls = 0.5 * 5 / 7
    np.testing.assert_allclose(speed[:, 0, 0], np.maximum(0.5 - drag * time, rolls), atol=1e-4)
    np.testing.assert_allclose(speed[:, 1, 0], 0.5, atol=1e-5)
    # Rates about the body's own axes: their size is that about y.
    turns = np.linalg.norm(rate[:, 0], axis=-1) * BALL_RADIUS
    np.testing.assert_allclose(turns, np.minimum(2.5 * drag * time, rolls), atol=1e-4)
    assert not speed[:, :, 1].any()


def test_balls_bounce_off_a_wall_as_on_c(scene):
    """Within 0.1 m/s, of speeds that change by up to 2.3 m/s: MuJoCo's contacts are springs."""
    balls = np.array([(1.4, 1.0, 0.5, 0.0), (1.4, 1.0, 2.0, 0.0), (1.4, 0.5, 1.0, 1.0)], np.float32)
    place, speed, *_ = on_planar(scene, balls, np.ones(3), 1.6)
    assert place[:, :, 0].max() <= FACE + 1e-3
    assert (speed[-1, :, 0] < 0).all(), "they come back"
    for world, one in enumerate(balls):
        real_place, real_speed, _ = on_c(scene, one, 1.0, 1.6)
        np.testing.assert_allclose(speed[-1, world], real_speed[-1], atol=0.1)
        np.testing.assert_allclose(place[-1, world], real_place[-1], atol=0.1)


def test_robots_push_a_ball_as_on_c(scene):
    """At 1 m/s, square, off the middle and with the edge: 3 cm and 5 cm/s after a way of 0.4 m."""
    aside, found = (0.0, 0.1, 0.2), []
    for engine in ("planar", "c"):
        batch = Batch(scene, len(aside), engine=engine)
        state = batch.reset()
        qpos = np.array(batch.physics(state).qpos)
        root = indices(scene)[0]
        qpos[:, root[0]], qpos[:, root[1]] = 0.8, aside
        inner = batch.engine.reset(state.physics, jnp.ones(len(aside), bool), jnp.asarray(qpos))
        found.append(driven(batch, state.replace(physics=inner), 1.2, 1.0))
    (place, speed, *_), (real_place, real_speed, *_) = found
    assert (real_place[-1, :, 0] > 1.2).all()
    np.testing.assert_allclose(place[-1], real_place[-1], atol=0.03)
    np.testing.assert_allclose(speed[-1], real_speed[-1], atol=0.05)


def test_a_ball_at_a_wall_stops_the_robot_that_pushes_it(scene):
    """The robot ends at the ball, the ball at the wall, none within another; without a ball it drives on."""
    balls = np.array([[FACE, 0.0, 0.0, 0.0], [-3.0, 1.0, 0.0, 0.0]], np.float32)
    place, _, _, robot = on_planar(scene, balls, np.zeros(2), 4.0, speed=1.0)
    half = 0.22
    ends = 1.9 - 2 * BALL_RADIUS - half
    assert robot[:, 0, 0].max() < ends + 2e-3
    assert robot[-1, 0, 0] > ends - 0.03, "no farther off than it drives in a step"
    np.testing.assert_allclose(place[-1, 0], [FACE, 0.0], atol=2e-3)
    assert robot[-1, 1, 0] > 1.9 - half - 0.03


def test_only_a_ball_that_is_alone_moves():
    """Two stay in place, as walls: docs/fidelity.md says so."""
    ball = SOCCER_FIELD.loose[0]
    other = replace(ball, name="Other", at=(0.0, 2.0, BALL_RADIUS))
    batch = Batch(
        yard(replace(YARD, loose=(replace(ball, at=(0.8, 0.0, BALL_RADIUS)), other))), 1, engine="planar"
    )
    state = batch.reset()
    before = np.array(batch.physics(state).qpos)
    place, *_, robot = driven(batch, state, 1.5, 1.0)
    np.testing.assert_array_equal(place[-1, 0], before[0, batch.scene.loose_geoms.root_qposadr[0, :2]])
    assert robot[-1, 0, 0] < 0.8 - BALL_RADIUS - 0.22 + 2e-3
