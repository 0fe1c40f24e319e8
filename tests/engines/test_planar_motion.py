"""Engine `planar`: how robots move, by closed forms and C MuJoCo."""

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.fidelity.manoeuvres import BOARDS
from tests.arenas import COURSE, FLAT
from tests.engines.eager import AT_ONCE, BLIND, EAGER, SINGLE, drive, poses
from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.base.rotations import mat_from_quat
from usarmjx.engines.planar.bodies import Motion, move_joints, robots_of, servos_of
from usarmjx.engines.planar.drives import limited_lag, wheel_kinematics
from usarmjx.engines.planar.flight import fly
from usarmjx.engines.planar.footprints import OVERLAP_TOLERANCE
from usarmjx.engines.planar.responses import Response, check_robot, override_response, packaged_responses
from usarmjx.engines.planar.rolling import roll
from usarmjx.engines.planar.solids import ground_heights, project_geoms
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import DomainRandomization
from usarmjx.models.compile.reachability import STEP_SHARE
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

GEOM = mujoco.mjtGeom


class Record(SimpleNamespace):
    """Fields, some of which may be replaced."""

    def replace(self, **fields):
        return Record(**(vars(self) | fields))


@pytest.fixture(scope="module")
def flat():
    return Batch(build_scene(FLAT, [EAGER, EAGER]), 2, engine="planar", seed=3)


def test_wheels_at_odds_drive_an_arc_of_the_radius_that_they_make(flat):
    wheels, first = wheel_kinematics(EAGER), poses(flat, flat.reset())
    left, right, seconds = 2.0, 3.0, 1.0
    speed = wheels.radius * (left + right) / 2
    turn = wheels.radius * (right - left) / wheels.track
    state = drive(flat, left, right, 50)
    now = poses(flat, state)
    angle, radius = turn * seconds, speed / turn
    for robot, yaw in enumerate((0.0, math.pi)):
        chord = radius * np.array([math.sin(angle), 1 - math.cos(angle)])
        c, s = math.cos(yaw), math.sin(yaw)
        expected = first[0, robot, :2] + [c * chord[0] - s * chord[1], s * chord[0] + c * chord[1]]
        assert now[0, robot, :2] == pytest.approx(expected, abs=SINGLE)
        assert math.remainder(now[0, robot, 2] - yaw - angle, math.tau) == pytest.approx(0.0, abs=SINGLE)
    wheel_speeds = np.asarray(flat.physics(state).qvel)[0, flat.scene.groups[0].dofadr[0]]
    assert wheel_speeds[wheels.spin] == pytest.approx([left] * 2 + [right] * 2, abs=1e-3)


@pytest.mark.every_run("Eager-1.0", "Zerg-0.0")
@pytest.mark.parametrize(("name", "slip"), [("Eager", 1.0), ("P2AT", 0.0), ("Zerg", 0.0)])
def test_sides_that_go_against_each_other_turn_a_robot_on_the_spot(name, slip):
    """At 2 w r / track times the share of it that the class keeps: what was measured, where 0 is given."""
    robot = EAGER if name == "Eager" else replace(ROBOTS.get(name), sensors=(), cameras=())
    wheel, track = robot.wheel_radius, robot.wheel_separation
    share = slip or packaged_responses()[name]["response"]["turn_gain"]
    assert share == 1.0 or share < 0.97, "it slips"
    batch, spin, steps = Batch(build_scene(FLAT, [robot]), 1, engine="planar"), 1.5, 50
    begun = drive(batch, -spin, spin, 50)
    ended = drive(batch, -spin, spin, steps, begun)
    (first, _), (now, rate) = ((poses(batch, one)[0, 0], turn_rate(batch, one)) for one in (begun, ended))
    expected = share * 2 * spin * wheel / track
    assert rate == pytest.approx(expected, rel=1e-4)
    left = now[2] - first[2] - expected * steps * 0.02
    assert math.remainder(left, math.tau) == pytest.approx(0.0, abs=SINGLE)
    assert now[:2] == pytest.approx(poses(batch, batch.reset())[0, 0, :2], abs=1e-5), "it stays where it is"


def turn_rate(batch, state):
    """Of the first robot [rad/s]."""
    return float(np.asarray(batch.physics(state).qvel)[0, batch.scene.groups[0].root_dofadr[0, 5]])


def test_wheels_have_turned_as_far_as_they_went(flat):
    group, state = flat.scene.groups[0], drive(flat, 2.0, 2.0, 50)
    joints = np.asarray(flat.physics(state).qpos)[0, group.qposadr[0]][wheel_kinematics(EAGER).spin]
    assert joints == pytest.approx(2.0 * (50 - 0.5) * 0.02, abs=1e-3)  # the first step's mean is half


def test_a_lag_and_a_most_acceleration_are_those_of_the_closed_form():
    slow = replace(AT_ONCE, forward_lag=0.3)
    twist, speed_up = jnp.zeros((1, 3)), jax.jit(partial(limited_lag, slow, dt=0.02))
    for _ in range(10):
        twist = speed_up(twist, jnp.array([[1.0, 0.0, 0.0]]))
    assert float(twist[0, 0]) == pytest.approx(1 - math.exp(-0.2 / 0.3), rel=1e-5)
    braking, way = replace(AT_ONCE, acceleration=2.0), 0.0
    twist, slow_down = jnp.array([[1.5, 0.0, 0.0]]), jax.jit(partial(limited_lag, braking, dt=0.001))
    for _ in range(2000):
        now = slow_down(twist, jnp.zeros((1, 3)))
        way, twist = way + float(twist[0, 0] + now[0, 0]) / 2 * 0.001, now
    assert way == pytest.approx(1.5**2 / (2 * 2.0), rel=2e-3)  # the braking distance v^2 / 2a


def test_a_motor_with_more_torque_at_standstill_brakes_as_it_was_measured():
    """The bounds of its servo, which are for MuJoCo's solver, do not limit a P2DX a second time.

    From speed v it slows down by a in each second to v1, from where the lag takes over; each step is made at
    the speed of its end. On C MuJoCo it takes 1.10 m.
    """
    robot, period = replace(ROBOTS.get("P2DX"), sensors=(), cameras=()), 0.02
    answer = Response(**packaged_responses()["P2DX"]["response"])
    batch, v = Batch(build_scene(FLAT, [robot]), 1, engine="planar"), robot.drive.top_speed
    fast = drive(batch, robot.drive.max_spin, robot.drive.max_spin, 150)
    begun, ended = (poses(batch, one)[0, 0] for one in (fast, drive(batch, 0.0, 0.0, 150, fast)))
    v1 = answer.acceleration * period / -math.expm1(-period / answer.forward_lag)
    way = (v**2 - v1**2) / (2 * answer.acceleration) + v1 * answer.forward_lag - v * period / 2
    assert np.linalg.norm(ended[:2] - begun[:2]) == pytest.approx(answer.gain * way, rel=5e-3)


def test_longer_steps_lead_to_the_same():
    answer = Response(forward_lag=0.2, turn_lag=0.1, acceleration=1e3, turn_acceleration=1e3)
    told = jnp.array([[0.7, 0.0, 0.4]])
    fine, coarse = jnp.zeros((1, 3)), jnp.zeros((1, 3))
    for _ in range(5):
        fine = limited_lag(answer, fine, told, 0.02)
    for _ in range(2):
        coarse = limited_lag(answer, coarse, told, 0.05)
    assert np.asarray(fine) == pytest.approx(np.asarray(coarse), rel=1e-5)


def test_a_bend_is_no_sharper_than_its_cornering_allows():
    """Speed times rate of turn: at 2 m/s 3 m/s^2 leave 1.5 rad/s, either way."""
    careful, before = replace(AT_ONCE, cornering=3.0), jnp.array([[2.0, 0.0, 0.0]])
    for told, turn in ((5.0, 1.5), (-5.0, -1.5), (1.2, 1.2)):
        now = limited_lag(careful, before, jnp.array([[2.0, 0.0, told]]), 0.02)
        assert np.asarray(now)[0] == pytest.approx([2.0, 0.0, turn], abs=1e-5)


def test_what_drifts_goes_sideways_by_its_speed_times_its_turn():
    robot = replace(EAGER, name="Drifting")
    override_response(robot, replace(AT_ONCE, drift=-0.1))
    scene = build_scene(FLAT, [robot])
    model, wheels = scene.model, wheel_kinematics(robot)
    robots = robots_of(model, [(robot, scene.groups[0].indices[0])])
    places = robots.rolling[0].ctrl[0]  # the left ones first
    still = Record(qpos=jnp.asarray(model.qpos0), qvel=jnp.zeros(model.nv), act=jnp.zeros(model.na))
    for left, right in ((2.0, 3.0), (3.0, 2.0)):
        ctrl = jnp.zeros(model.nu).at[places].set(jnp.array([left, left, right, right]))
        _, twist = roll(robots, still, still, Record(ctrl=ctrl, varied=None), 0.02)
        ahead, turn = wheels.radius * (left + right) / 2, wheels.radius * (right - left) / wheels.track
        assert np.asarray(twist)[0] == pytest.approx([ahead, -0.1 * ahead * turn, turn], abs=1e-4)


def test_a_car_turns_as_a_bicycle_does():
    car = ROBOTS.get("Hummer")
    wheels, front = wheel_kinematics(car), 0.3
    keys = np.array([[4.0, front, 0.0]], np.float32)
    targets = np.asarray(car.drive.targets(keys))[0]
    names = [one.joint for one in car.drive.joint_controls]
    plan = build_scene(FLAT, [car]).groups[0].plan
    joints, wheel_speeds = (
        np.zeros((1, len(plan.parts) - 1), np.float32),
        np.zeros((1, len(wheels.spin)), np.float32),
    )
    for name, target in zip(names, targets, strict=True):
        joints[0, plan.joint_index(name)] = target
    wheel_speeds[0] = [joints[0, j] if wheels.powered[i] else 0.0 for i, j in enumerate(wheels.spin)]
    twist = np.asarray(wheels.twist(jnp.asarray(joints), jnp.asarray(wheel_speeds)))[0]
    rear = [wheel.x for wheel in car.drive.wheels if not wheel.steer]
    speed = 4.0 * car.drive.radius
    assert twist[2] * car.drive.wheel_base == pytest.approx(twist[0] * math.tan(front), rel=1e-3)
    assert twist[0] == pytest.approx(speed, rel=0.05)  # of the middle of the powered wheels, by the arc
    assert twist[1] == pytest.approx(-twist[2] * np.mean(rear), rel=1e-2)  # the rear axle does not slide
    again = np.asarray(wheels.wheel_speeds(jnp.asarray(joints), jnp.asarray(twist[None])))[0]
    assert again[wheels.powered] == pytest.approx(wheel_speeds[0][wheels.powered], rel=1e-3)


def test_a_joint_follows_its_target_as_a_servo_without_load():
    scene = build_scene(FLAT, ["Talon"])
    servos, model = servos_of(scene.model), scene.model

    zero = Record(qpos=jnp.asarray(model.qpos0), qvel=jnp.zeros(model.nv), act=jnp.zeros(model.na))
    which = next(i for i, name in enumerate(servos.pull) if "Arm" in model.actuator(int(name)).name)
    lag, q0 = servos.lag[which], model.qpos0[servos.qpos[which]]
    ctrl = jnp.zeros(model.nu).at[servos.hold].set(1.0).at[servos.pull[which]].set(0.1)
    act = jnp.asarray(model.qpos0[servos.qpos])
    full = jnp.zeros(model.na).at[servos.act].set(act)
    moved = move_joints(servos, zero, ctrl, full, 0.02)
    # dq/dt = (target - q) / lag with a target that moves at 0.1 from where the joint is.
    expected = q0 + 0.1 * (0.02 - lag * (1 - math.exp(-0.02 / lag)))
    assert float(moved.qpos[servos.qpos[which]]) == pytest.approx(expected, abs=1e-6)
    off = move_joints(servos, zero, ctrl.at[servos.hold[which]].set(0.0), full, 0.02)
    assert float(off.qpos[servos.qpos[which]]) == pytest.approx(q0)


# The ground


def test_a_ramp_tilts_as_it_slopes_and_a_step_too_high_stops():
    batch = Batch(build_scene(COURSE, [EAGER]), 1, engine="planar")
    state = drive(batch, 4.0, 4.0, 90)
    root = np.asarray(batch.physics(state).qpos)[0, batch.scene.groups[0].root_qposadr[0]]
    pitch = math.asin(2 * (root[3] * root[5] - root[6] * root[4]))
    on_c = Batch(build_scene(COURSE, [BLIND]), 1, engine="c")
    real = drive(on_c, 4.0, 4.0, 90)
    truth = np.asarray(on_c.physics(real).qpos)[0, on_c.scene.groups[0].root_qposadr[0]]
    assert root[0] > 0.6, "it has come onto the ramp"
    if truth[0] > 0.8:
        assert math.degrees(pitch) == pytest.approx(-15.0, abs=3.0)
    high = FLAT.__class__(
        name="kerb",
        starts=(StartPose(tag="S", at=(0.0, 0.0, 0.188), yaw=0.0),),
        extent=((-3, 3), (-3, 3)),
        shapes=(Shape(kind="box", size=(0.5, 1.0, 0.1), at=(1.5, 0.0, 0.1), surface="ground"),),
    )
    kerb = Batch(build_scene(high, [EAGER]), 1, engine="planar")
    state = drive(kerb, 4.0, 4.0, 200)
    front = poses(kerb, state)[0, 0, 0] + kerb.engine._robots.half[0, 0] + kerb.engine._robots.offset[0, 0]
    assert front == pytest.approx(1.0, abs=2 * OVERLAP_TOLERANCE)
    assert bool(np.asarray(state.physics.touched)[0, 0])


def test_boards_are_driven_over_that_are_on_c():
    """Generated mazes have boards of 4 cm across their ways; onto 6 cm a P2AT climbs on `c`, slowly."""
    boards = ((0.039, 0.09, True), (0.06, 2.0, True), (0.1, 2.0, False))  # height and length [m], driven over
    arena = replace(
        FLAT,
        name="boards",
        starts=tuple(StartPose(tag=f"S{i}", at=(0.0, 2.0 * i, 0.188), yaw=0.0) for i in range(len(boards))),
        shapes=tuple(
            Shape(
                kind="box",
                size=(length / 2, 0.5, height / 2),
                at=(0.75 + length / 2, 2.0 * i, height / 2),
                surface="ground",
            )
            for i, (height, length, _) in enumerate(boards)
        ),
    )
    for engine in ("c", "planar"):
        batch = Batch(build_scene(arena, [BLIND] * len(boards)), 1, engine=engine)
        start = poses(batch, batch.reset())[0, :, 0]
        way = poses(batch, drive(batch, 2.0, 2.0, 350))[0, :, 0] - start
        assert (way > 1.2).tolist() == [over for _, _, over in boards], engine


def test_how_high_a_step_wheels_climb_is_what_was_measured_on_c():
    """Of the boards that classes were driven at they get onto the same; tracks and flippers climb higher."""
    file = Path(__file__).parents[2] / "benchmarks/results/physics.jsonl"
    numbers = json.loads(file.read_text().splitlines()[-1])["numbers"]
    for name, row in numbers.items():
        if "climb" not in row:  # legs, and what flies or dives
            continue
        climbed, _ = row["climb"]
        higher = min((board for board in BOARDS if board > climbed), default=math.inf)
        assert (STEP_SHARE * ROBOTS.get(name).wheel_radius < higher) == (name != "Rugbot"), name


@pytest.mark.parametrize("pitch", [0.0, 0.2, -0.4])
def test_the_top_of_a_box_is_the_plane_that_mujoco_s_rays_meet(pitch):
    spec = mujoco.MjSpec()
    geom = spec.worldbody.add_geom(type=GEOM.mjGEOM_BOX, size=[0.6, 0.4, 0.1], pos=[0.3, -0.2, 0.5])
    geom.alt.type = mujoco.mjtOrientation.mjORIENTATION_EULER  # else the angles are not looked at
    geom.alt.euler = [0.0, math.degrees(pitch), 30.0]
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solids = project_geoms(
        model.geom_type,
        jnp.asarray(data.geom_xpos),
        jnp.asarray(data.geom_xmat.reshape(-1, 3, 3)),
        jnp.asarray(model.geom_size),
    )
    for x, y in ((0.3, -0.2), (0.4, -0.1), (0.1, -0.25)):
        out = np.zeros(1, np.int32)
        fall = mujoco.mj_ray(model, data, np.array([x, y, 5.0]), np.array([0.0, 0.0, -1.0]), None, 1, -1, out)
        height = float(ground_heights(solids, 0.0, jnp.array([x, y]), jnp.array(9.0)))
        assert height == pytest.approx(5.0 - fall, abs=1e-5)
    assert float(ground_heights(solids, 0.0, jnp.array([2.0, 2.0]), jnp.array(9.0))) == 0.0
    assert float(ground_heights(solids, 0.0, jnp.array([0.3, -0.2]), jnp.array(0.1))) == 0.0, "it is above"


def test_where_a_robot_gets_to_has_the_slope_that_small_changes_show(flat):
    start = flat.reset()
    slot = flat.scene.groups[0].root_qposadr[0, 0]
    state = flat.drive(start, 0, {"Left": 2.0, "Right": 2.2})
    _, inputs = flat._compute_inputs(state.worlds, flat.physics(state))
    wheels = flat.scene.groups[0].actuator_ids[0]

    @jax.jit
    def ends(speed):
        ctrl = inputs.ctrl.at[0, wheels].set(speed)
        after = jax.lax.fori_loop(
            0, 5, lambda _, now: flat.engine.advance(now, inputs.replace(ctrl=ctrl)), state.physics
        )
        return after.qpos[0, slot]

    slope = float(jax.jvp(ends, (2.0,), (1.0,))[1])
    assert slope == pytest.approx(float(ends(2.05) - ends(1.95)) / 0.1, rel=2e-2)
    assert slope > 0.0


@pytest.mark.parametrize(("name", "allowed"), [("ERS", "c, jax and warp"), ("QRIO", "legs")])
def test_what_it_cannot_move_is_refused_by_name(name, allowed):
    with pytest.raises(UnsupportedFeatureError, match=f"'planar' cannot run this scene: {name} .*{allowed}"):
        check_robot(ROBOTS.get(name))


def test_terrain_is_refused_by_name():
    with pytest.raises(UnsupportedFeatureError, match="meshes or height fields; engines c, jax and warp can"):
        Batch(build_scene("DM-Outdoor", [EAGER]), 1, engine="planar")


def test_long_steps_are_refused_for_what_flies():
    scene = build_scene(FLAT, ["AirRobot"], Physics(timestep=0.05, substeps=2))
    with pytest.raises(UnsupportedFeatureError, match=r"in control steps of up to 0\.05 s, not 0\.1 s"):
        Batch(scene, 1, engine="planar")


def test_what_flies_goes_where_mujoco_has_it():
    """The same forces on the same mass by the same steps, with another order within a step."""
    within = {"Passarola": 3e-3, "AirRobot": 0.05}  # an AirRobot that leans takes off from an edge
    starts = tuple(StartPose(tag=f"S{i}", at=(0.0, 100.0 * i, 0.188), yaw=0.0) for i in range(2))
    blind = [replace(ROBOTS.get(name), sensors=(), cameras=()) for name in within]
    scene, ways = build_scene(replace(FLAT, starts=starts), blind), []
    for engine in ("c", "planar"):
        batch = Batch(scene, 1, engine=engine, seed=1)
        state = batch.reset()
        roots = np.concatenate([group.root_qposadr for group in scene.groups])
        start = np.asarray(batch.physics(state).qpos)[0, roots]
        for step in range(150):
            if step in (10, 100):
                share = 0.3 if step == 10 else -0.3
                for number, group in enumerate(scene.groups):
                    keys = group.robot.drive.full_scale
                    state = batch.drive(state, number, {key: share * most for key, most in keys.items()})
            state = batch.step(state)
        ways.append(np.asarray(batch.physics(state).qpos)[0, roots])
    for number, group in enumerate(scene.groups):
        there, here = (way[number] for way in ways)
        assert np.linalg.norm(there[:3] - start[number, :3]) > 0.3, "it has gone somewhere"
        assert here == pytest.approx(there, abs=within[group.robot.name])


@pytest.mark.oracle
@pytest.mark.parametrize("where", ["cpu", "gpu"])
def test_what_tumbles_keeps_its_angular_momentum(where, monkeypatch):
    """That of a free body: an AirRobot, twice as hard to turn about its own z as about the others.

    A GPU has its steps in a row, not in a loop.
    """
    monkeypatch.setattr("jax.default_backend", lambda: where)
    scene = build_scene(FLAT, [replace(ROBOTS.get("AirRobot"), sensors=(), cameras=())])
    (group,) = scene.groups
    robots = robots_of(scene.model, [(group.robot, group.indices[0])])
    none = jnp.zeros((1, 3))
    begin = Motion(
        pos=none, quat=jnp.array([[1.0, 0.0, 0.0, 0.0]]), linear=none, angular=jnp.array([[3.0, 0.5, 2.0]])
    )
    free = jnp.zeros((scene.model.nbody, 6))
    step = jax.jit(lambda now: fly(robots, now, free, scene.model, 0.02))
    end = begin
    for _ in range(25):
        end = step(end)

    def momentum(now):
        return np.asarray(mat_from_quat(now.quat))[0] @ robots.inertia[0] @ np.asarray(now.angular)[0]

    first = momentum(begin)
    assert ("while" in step.lower(begin).as_text()) == (where == "cpu")
    assert np.linalg.norm(end.angular - begin.angular) > 2.0, "its axis has moved in it"
    assert momentum(end) == pytest.approx(first, abs=0.02 * np.linalg.norm(first))


VARIED = {
    "all": (DomainRandomization(wheel=(1.2, 1.2), mass=(2.0, 2.0), friction=(0.5, 0.5)), 1.2 * 0.5 / 2.0),
    "motors": (DomainRandomization(torque=(0.4, 0.4)), 0.4),
    "the scarcer": (DomainRandomization(torque=(0.4, 0.4), friction=(0.5, 0.5), mass=(0.8, 0.8)), 0.4 / 0.8),
}


@pytest.mark.every_run("all", "the scarcer")
@pytest.mark.parametrize("which", VARIED)
def test_larger_wheels_go_farther_and_more_mass_or_less_friction_or_torque_starts_slower(which):
    """By the factors: a wheel's radius is in the speed, grip over mass in the acceleration."""
    heavy, steps, dt = replace(EAGER, name="Heavy"), 10, 0.02
    override_response(heavy, replace(AT_ONCE, acceleration=1.0))
    vary, factor = VARIED[which]
    batch = Batch(build_scene(FLAT, [heavy], vary=vary), 1, engine="planar")
    way = poses(batch, drive(batch, 4.0, 4.0, steps))[0, 0, 0] - poses(batch, batch.reset())[0, 0, 0]
    # Each step goes by the speed at its end; 0.2 s do not bring it up to the 0.52 m/s that it is told.
    alike = 1.0 * dt * dt * steps * (steps + 1) / 2
    assert way == pytest.approx(factor * alike, rel=2e-3)


def test_robots_with_latency_do_so_many_steps_later_the_same():
    """Bit for bit what those without do, and the commanded speed is multiplied where speeds vary."""
    late = DomainRandomization(latency=(3, 3), speed=(0.5, 0.5))
    found = []
    for vary, speed, waits in ((late, 4.0, 0), (None, 2.0, 3)):
        batch = Batch(build_scene(FLAT, [EAGER], vary=vary), 1, engine="planar")
        state = batch.reset()
        for _ in range(waits):
            state = batch.step(state)
        state = drive(batch, speed, speed, 12 - waits, state)
        found.append(poses(batch, state))
    assert found[0][0, 0, 0] > 0.03
    assert np.array_equal(*found)


def test_a_floor_without_anything_on_it_is_ground():
    batch = Batch(build_scene(FLAT, [EAGER]), 1, engine="planar")
    state = drive(batch, 0.0, 0.0, 50)
    height = float(np.asarray(batch.physics(state).qpos)[0, batch.scene.groups[0].root_qposadr[0, 2]])
    assert height == pytest.approx(kinematic_tree_of(EAGER).clearance, abs=SINGLE)
