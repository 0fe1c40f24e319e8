"""Engine `planar`: models of drives, time steps and what is refused, without a batch."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.engines.eager import AT_ONCE, BLIND, EAGER, around
from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.engines.planar.bodies import Motion
from usarmjx.engines.planar.drives import limited_lag, wheel_kinematics
from usarmjx.engines.planar.footprints import Footprints, separate_footprints
from usarmjx.engines.planar.neighbor_lists import obstacle_outlines
from usarmjx.engines.planar.responses import Response, packaged_responses
from usarmjx.engines.planar.rolling import integrate_twist
from usarmjx.engines.planar.solids import project_geoms
from usarmjx.models.compile.physics import PHYSICS, Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.sim.batch import Batch
from usarmjx.sim.calibration import DriveLog, fit_response, random_commands
from usarmjx.sim.scene import build_scene
from usarmjx.train.evaluation.engine_gap import place_of

FLYERS = 16
COARSE_LOSS = 0.03
"""Control steps of 50 ms lead no farther from those of 20 ms in 5 s [m]."""


def test_sides_that_answer_apart_speed_up_before_they_turn():
    """Both told more speed gain as much until the slower one has it: only then does the robot turn."""
    apart = replace(AT_ONCE, acceleration=2.0, turn_acceleration=8.0, sides_apart=True)
    step = replace(apart, sides_apart=False)
    told, dt = jnp.array([[1.0, 0.0, 1.0]]), 0.02  # a track of 2 * 2 / 8 = 0.5 m: sides at 0.75 and 1.25 m/s
    turns = {False: [], True: []}
    for answer in (apart, step):
        now = jnp.zeros((1, 3))
        for _ in range(40):
            now = limited_lag(answer, now, told, dt)
            turns[answer.sides_apart].append(float(now[0, 2]))
        assert np.asarray(now) == pytest.approx(np.asarray(told), abs=1e-4), "they get there"
    slower_has_it = round(0.75 / (2.0 * dt))
    assert np.abs(turns[True][: slower_has_it - 1]).max() < 1e-5
    assert turns[True][slower_has_it + 5] > 0.3
    assert turns[False][slower_has_it // 2] > 0.3, "in step it turns as it speeds up"


def test_a_fit_tells_which_way_sides_answer():
    """What a model of either kind does is explained by the same kind."""
    robot = ROBOTS.get("P2DX")
    wheels = wheel_kinematics(robot)
    orders = random_commands(robot, 4, 100, seed=3)
    for apart in (False, True):
        truth = Response(
            forward_lag=0.08, turn_lag=0.08, acceleration=1.5, turn_acceleration=9.0, sides_apart=apart
        )
        joints = np.zeros((100, 4, 4), np.float32)
        wanted = jax.vmap(wheels.twist)(joints, jnp.asarray(orders))

        def step(now, asked, truth=truth):
            now = limited_lag(truth, now, asked, 0.02)
            return now, now

        twist = np.asarray(jax.lax.scan(step, jnp.zeros((4, 3)), wanted)[1])
        log = DriveLog(
            period=0.02, wheel_speeds=orders, joints=joints, twist=twist, pose=np.zeros_like(twist)
        )
        found, left = fit_response(robot, log)
        assert found.sides_apart is apart
        assert found.acceleration == pytest.approx(1.5, rel=0.1)
        assert left[0] < 0.02


def test_a_p2dx_answers_with_its_sides_apart_as_measured():
    entry = packaged_responses()["P2DX"]
    assert entry["response"]["sides_apart"]
    assert entry["errors"]["5 s"]["distance"] < 0.55, "0.75 m with both sides in step"


def way_of(response, told, dt, every):
    """Where robots (n,) get to that are told other twists (orders, n, 3) every so often [s]."""
    static_solids = jnp.zeros((told.shape[1], 3))
    start = Motion(
        pos=static_solids,
        quat=jnp.tile(jnp.array([1.0, 0, 0, 0]), (len(static_solids), 1)),
        linear=static_solids,
        angular=static_solids,
    )

    def step(now, asked):
        motion, twist = now
        twist = limited_lag(response, twist, asked, dt)
        return (integrate_twist(motion, twist, dt), twist), 0

    asked = np.repeat(told, round(every / dt), axis=0)
    return np.asarray(jax.lax.scan(step, (start, static_solids), asked)[0][0].pos)


@pytest.mark.parametrize("name", ["P2AT", "Zerg", "Talon"])
def test_steps_of_50_ms_lead_to_where_those_of_20_ms_do(name):
    robot, rng = ROBOTS.get(name), np.random.default_rng(0)
    figures = Response(**packaged_responses()[name]["response"])
    speed = robot.drive.top_speed
    told = (rng.uniform(-1.0, 1.0, (5, 32, 3)) * [speed, 0.0, 1.0]).astype(np.float32)
    fine, coarse = (way_of(figures, told, dt, 1.0) for dt in (0.02, PHYSICS.get("coarse").period))
    assert np.median(np.linalg.norm(fine, axis=-1)) > 10 * COARSE_LOSS, "they have gone somewhere"
    assert np.median(np.linalg.norm(coarse - fine, axis=-1)) < COARSE_LOSS


@pytest.mark.every_run("Passarola-0.05")
@pytest.mark.oracle
@pytest.mark.parametrize(("name", "within"), [("AirRobot", 0.15), ("Passarola", 0.05)])
def test_what_flies_in_steps_of_50_ms_is_about_where_mujoco_has_it(name, within):
    """After 5 s of random orders: what holds it upright acts 30 ms later than in steps of 20 ms."""
    robot = replace(ROBOTS.get(name), sensors=(), cameras=())
    orders = random_commands(robot, FLYERS, 50, 2)[np.repeat(np.arange(0, 50, 10), 10)]  # each stands for 1 s
    ways: list[np.ndarray] = []
    for engine, physics in (("c", Physics()), ("planar", Physics.coarse())):
        scene = build_scene(place_of("air", robot), [robot], physics)
        batch, root = Batch(scene, FLYERS, engine=engine), scene.groups[0].root_qposadr[0, :3]
        state = batch.reset()
        for order in orders:
            told = {key: order[:, None, i] for i, key in enumerate(robot.drive.keys)}
            state = batch.drive(state, 0, told)
            for _ in range(round(0.1 / physics.period)):
                state = batch.step(state)
        ways.append(np.asarray(batch.physics(state).qpos)[:, root])
    assert np.median(np.linalg.norm(ways[0] - ways[0].mean(0), axis=-1)) > 1.0, "they have gone somewhere"
    assert np.median(np.linalg.norm(ways[1] - ways[0], axis=-1)) < within


def test_steps_of_50_ms_are_refused_where_contacts_are_solved():
    with pytest.raises(UnsupportedFeatureError, match=r"'c' .* steps of 0\.05 s are for engine planar"):
        Batch(build_scene(FLAT, [BLIND], PHYSICS.get("coarse")), 1, engine="c")
    assert (
        Batch(build_scene(FLAT, [EAGER], PHYSICS.get("coarse")), 1, engine="planar").engine.physics.period
        == 0.05
    )


def test_a_mirrored_world_stays_the_mirror_image():
    """Robots on top of each other and of a wall, and the same to the left instead of to the right."""
    rng, n = np.random.default_rng(4), 4
    start = Footprints(
        pos=jnp.asarray(rng.uniform(-0.7, 0.7, (8, n, 2)) + 3.0 * np.arange(n)[:, None], jnp.float32),
        yaw=jnp.asarray(rng.uniform(-3.0, 3.0, (8, n)), jnp.float32),
        half=jnp.tile(jnp.array([0.3, 0.2]), (8, n, 1)),
        low=jnp.zeros((8, n)),
        high=jnp.ones((8, n)),
        step=jnp.zeros((8, n)),
        mass=jnp.asarray(rng.uniform(5.0, 40.0, (8, n)), jnp.float32),
    )
    crowded = start.replace(pos=0.15 * start.pos)
    walls = project_geoms(
        np.full(1, 6), jnp.array([[0.5, 0.0, 0.5]]), jnp.eye(3)[None], jnp.array([[0.1, 2.0, 0.5]])
    )

    def mirrored(prints):
        return prints.replace(pos=prints.pos * jnp.array([1.0, -1.0]), yaw=-prints.yaw)

    moves = jnp.ones((8, n), bool)
    apart = jax.jit(
        lambda a, b: separate_footprints(a, b, obstacle_outlines(b, around(b, walls).near), moves)
    )
    one, touched = apart(start, crowded)
    other, also = apart(mirrored(start), mirrored(crowded))
    assert np.asarray(touched).mean() > 0.5
    assert np.array_equal(touched, also)
    assert np.asarray(mirrored(other).pos) == pytest.approx(np.asarray(one.pos), abs=1e-4)
    assert np.asarray(mirrored(other).yaw) == pytest.approx(np.asarray(one.yaw), abs=1e-3)
