"""Odometry, INS, encoder and ground truth against scalar transcriptions of the manual's algorithms."""

import math
from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from usarmjx.base.clock import clock_at
from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import flip_angles, flip_vector
from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import Mount, options

DEAD_RECKONING_ATOL = 1e-5  # m, rad: float32 sums of some hundred steps within 2 m
INERTIAL_ATOL = 1e-4  # m, rad: float32 matrices multiplied some ten times, positions of some metres
POSE_ATOL = 2e-6  # m, rad: float32 at 2 m
TICK = 0.01745  # rad, manual 10.7.2
LEFT_F, RIGHT_F, LEFT_R, RIGHT_R, PAN, TILT = range(6)


# --- odometry ---------------------------------------------------------------------------------


class Reckoner:
    """The manual's odometry (10.4.1), one number at a time."""

    def __init__(self, left: float, right: float, resolution=0.01, radius=0.13, separation=0.4712):
        self.resolution, self.radius, self.separation = resolution, radius, separation
        self.x = self.y = self.heading = 0.0
        self.last = self.ticks(left), self.ticks(right)

    def ticks(self, angle: float) -> int:
        # The encoder divides in float32, like ours, so that both round the same way.
        return int(np.trunc(np.float32(angle) / np.float32(self.resolution)))

    def move(self, left: float, right: float) -> tuple[float, float, float]:
        now = self.ticks(left), self.ticks(right)
        way_left, way_right = (
            (new - old) * self.resolution * self.radius for new, old in zip(now, self.last, strict=True)
        )
        self.last = now
        advance = (way_left + way_right) / 2
        self.x += advance * math.cos(self.heading)
        self.y += advance * math.sin(self.heading)
        self.heading += (way_right - way_left) / self.separation
        self.heading = (self.heading + math.pi) % (2 * math.pi) - math.pi
        return self.x, self.y, self.heading


def wander(steps: int, seed: int) -> np.ndarray:
    """Wheel angles (steps, 4) of an irregular drive, backwards too."""
    rng = np.random.default_rng(seed)
    turns = rng.uniform(-0.3, 0.4, (steps, 4)) + rng.normal(0, 0.1, (1, 4))
    return np.cumsum(turns, axis=0) + rng.uniform(-5, 5, (1, 4))


@pytest.mark.oracle
def test_odometry_follows_the_manuals_algorithm(bench):
    path = wander(150, 1)
    inputs = bench.inputs(wheels=path[0])
    memory = bench.start(inputs)
    front = Reckoner(path[0, LEFT_F], path[0, RIGHT_F])
    rear = Reckoner(path[0, LEFT_R], path[0, RIGHT_R])
    turned = farthest = 0.0
    for i, wheels in enumerate(path):
        inputs = inputs.replace(
            clock=clock_at(0.02 * i, 1e-3), state=inputs.state.replace(joint_pos=joints(wheels))
        )
        memory, readings = bench.read(inputs, memory)
        expected = front.move(wheels[LEFT_F], wheels[RIGHT_F])
        ours = bench.value(readings, "Odometry", "Odometry")
        np.testing.assert_allclose(ours, expected, atol=DEAD_RECKONING_ATOL)
        # No tires named: the left-most and right-most, on this robot the rear ones.
        expected = rear.move(wheels[LEFT_R], wheels[RIGHT_R])
        ours = bench.value(readings, "Odometry", "Widest")
        np.testing.assert_allclose(ours, expected, atol=DEAD_RECKONING_ATOL)
        turned, farthest = max(turned, abs(ours[2])), max(farthest, math.hypot(*ours[:2]))
    assert turned > 3  # all the way round
    assert farthest > 0.2


def joints(wheels, pan=0.0, tilt=0.0) -> np.ndarray:
    return np.array([*wheels, pan, tilt], np.float32)


@pytest.mark.parametrize(
    ("left", "right", "pose"),
    [
        (10.0, 10.0, (1.3, 0, 0)),
        (-10.0, -10.0, (-1.3, 0, 0)),
        # Turning on the spot: to the left is counter-clockwise.
        (-1.0, 1.0, (0, 0, 2 * 0.13 / 0.4712)),
        (1.0, -1.0, (0, 0, -2 * 0.13 / 0.4712)),
    ],
)
def test_odometry_of_plain_moves(bench, left, right, pose):
    inputs = bench.inputs()
    memory = bench.start(inputs)
    half = 0.005  # rad, half a tick towards the turn, so that truncation cannot lose one
    wheels = [w + math.copysign(half, w) for w in (left, right, 0.0, 0.0)]
    _, readings = bench.read(inputs.replace(state=inputs.state.replace(joint_pos=joints(wheels))), memory)
    np.testing.assert_allclose(bench.value(readings, "Odometry", "Odometry"), pose, atol=DEAD_RECKONING_ATOL)


def test_odometry_counts_whole_ticks_and_loses_none(bench):
    """Sixty turns of a third of a tick are twenty ticks, not none."""
    inputs = bench.inputs(wheels=[0.005] * 4)
    memory = bench.start(inputs)
    for i in range(1, 61):
        state = inputs.state.replace(joint_pos=joints([0.005 + i * 0.01 / 3] * 4))
        memory, readings = bench.read(inputs.replace(state=state), memory)
    pose = bench.value(readings, "Odometry", "Odometry")
    np.testing.assert_allclose(pose, [20 * 0.01 * 0.13, 0, 0], atol=DEAD_RECKONING_ATOL)


def test_odometry_reset_makes_the_present_pose_the_reference(bench):
    inputs = bench.inputs(wheels=[3, 5, 3, 5])
    memory = bench.start(bench.inputs())
    memory, readings = bench.read(inputs, memory)
    assert abs(bench.value(readings, "Odometry", "Odometry")).max() > 0.3
    place = bench.suite.find("odometry", "ODOMETRY")
    assert bench.suite.handle_set(place, "SCAN", (), inputs, memory) is None
    memory = bench.suite.handle_set(place, "reset", (), inputs, memory)
    memory, readings = bench.read(inputs, memory)
    assert bench.value(readings, "Odometry", "Odometry").tolist() == [0, 0, 0]
    assert abs(bench.value(readings, "Odometry", "Widest")).max() > 0.3  # the others go on


@pytest.mark.parametrize("tire", ["LeftTire", "RightTire"])
def test_odometry_refuses_an_unknown_wheel_by_name(bench, make_bench, tire):
    mount = Mount(kind="Odometry", name="Odo", options=options(**{tire: "SpareWheel"}))
    robot = replace(P2AT, name="Spare", sensors=(mount,))
    with pytest.raises(SpecError, match=r"Odometry Odo: no wheel 'SpareWheel'; wheels: LeftFWheel, "):
        make_bench(robot).start(bench.inputs())


# --- INS --------------------------------------------------------------------------------------


def hilly_path(steps: int):
    """Times, positions and (roll, pitch, yaw) of a drive over hills that also backs up."""
    time = 0.1 * np.arange(steps)
    yaw = 0.8 * np.sin(0.7 * time) + 0.4 * time
    pitch, roll = 0.3 * np.sin(1.1 * time), 0.2 * np.cos(0.9 * time)
    speed = 0.5 * np.cos(0.4 * time)  # negative in the middle
    heading = np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)], -1)
    side = 0.05 * np.stack([-np.sin(yaw), np.cos(yaw), 0 * yaw], -1)  # it slips, too
    at = np.array([1, 2, 0.3]) + np.cumsum((speed[:, None] * heading + side) * 0.1, axis=0)
    return time, at, np.stack([roll, pitch, yaw], -1)


@pytest.mark.parametrize("name", ["Loud", "Polar"])
@pytest.mark.oracle
def test_ins_takes_the_manuals_seven_steps(bench, name):
    """With PolarStep to the letter, else with the displacement in the robot's axes in the last three."""
    mean, sigma = 0.05, 0.3
    time, at, angles = hilly_path(60)
    place = bench.suite.find("INS", name)
    inputs = bench.inputs(0.0, at[0], angles[0])
    memory = bench.start(inputs)
    true, where = Rotation.from_euler("ZYX", angles[0][::-1]), at[0]
    estimate, position = true, at[0].copy()
    for i in range(len(time)):
        inputs = bench.inputs(time[i], at[i], angles[i])
        memory, readings = bench.read(inputs, memory, seed=i)
        key = jax.random.fold_in(jax.random.key(i), place)
        *turn_noise, path_noise = np.asarray(jax.random.normal(key, (4,)), float).tolist()
        now = Rotation.from_euler("ZYX", angles[i][::-1])
        if i:
            rate = (true.inv() * now).as_rotvec() / 0.1  # 1
            rate = rate + rate * (mean + sigma * np.array(turn_noise))  # 2
            estimate = estimate * Rotation.from_rotvec(rate * 0.1)  # 3
            moved = at[i] - where
            if name == "Polar":
                distance = math.copysign(np.linalg.norm(moved), moved @ now.as_matrix()[:, 0])  # 4
                distance = distance + distance * (mean + sigma * path_noise)  # 5
                yaw, pitch, _ = estimate.as_euler("ZYX")
                steps = math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), -math.sin(pitch)
                position += distance * np.array(steps)  # 6, 7
            else:
                position += estimate.apply(now.inv().apply(moved) * (1 + mean + sigma * path_noise))
        true, where = now, at[i]
        ours = bench.value(readings, "INS", name)
        np.testing.assert_allclose(ours[:3], position, atol=INERTIAL_ATOL)
        apart = (estimate.inv() * Rotation.from_euler("ZYX", ours[:2:-1])).magnitude()
        assert apart < INERTIAL_ATOL
    assert np.linalg.norm(position - at[-1]) > 0.05  # the noise did something


def test_ins_of_the_manuals_step_is_turned_by_half_a_step_on_a_circle(bench):
    """Each step's distance is laid off along the heading after the turn instead of along the chord, so the
    estimate is the truth turned by half a step: an error of 2 sin(step / 4) of the way. Without PolarStep
    there is none."""
    radius, turn, steps = 2.0, 0.05, 40
    memory = None
    start = np.array([radius, 0.0, 0.26])
    for i in range(steps + 1):
        angle = turn * i
        at = (radius * math.cos(angle), radius * math.sin(angle), 0.26)
        inputs = bench.inputs(0.1 * i, at, (0, 0, angle + math.pi / 2))
        memory = bench.start(inputs) if memory is None else memory
        memory, readings = bench.read(inputs, memory, seed=i)
        way = np.linalg.norm(np.array(at) - start)
        for name, share in (("QuietPolar", 2 * math.sin(turn / 4)), ("Quiet", 0.0)):
            ours = bench.value(readings, "INS", name)
            error = np.linalg.norm(ours[:3] - at)
            assert error == pytest.approx(share * way, abs=INERTIAL_ATOL)
            apart = (ours[5] - (angle + math.pi / 2) + math.pi) % (2 * math.pi) - math.pi
            assert abs(apart) < INERTIAL_ATOL
            assert np.abs(ours[3:5]).max() < INERTIAL_ATOL
    assert way > 3


@pytest.mark.parametrize("name", ["Quiet", "QuietPolar"])
@pytest.mark.parametrize("way", [(0, 0, 1), (0, 1, 0), (1, 1, 0), (0.3, -0.4, -1)])
def test_ins_sees_climbs_and_sideways_motion_unless_it_takes_the_manuals_step(bench, name, way):
    """A level robot that looks along y is moved along `way` without turning. A polar step puts all of the
    path along the nose, so that a climb is an error of its length."""
    angles, memory, path = (0.0, 0.0, math.pi / 2), None, np.array(way, float)
    for i in range(6):
        at = np.array([1.0, 2.0, 0.3]) + 0.5 * i * path
        inputs = bench.inputs(0.2 * i, at, angles)
        memory = bench.start(inputs) if memory is None else memory
        memory, readings = bench.read(inputs, memory, seed=i)
    told = bench.value(readings, "INS", name)[:3] - (1.0, 2.0, 0.3)
    along_the_nose = np.array([0.0, np.sign(path[1]) * np.linalg.norm(path), 0.0])
    expected = 2.5 * (path if name == "Quiet" else along_the_nose)
    np.testing.assert_allclose(told, expected, atol=INERTIAL_ATOL)


def test_ins_follows_straight_drives_both_ways_exactly(bench):
    memory = None
    for i, x in enumerate([0.0, 0.4, 0.9, 0.5, -0.3]):
        inputs = bench.inputs(0.2 * i, (x, 1.0, 0.26))
        memory = bench.start(inputs) if memory is None else memory
        memory, readings = bench.read(inputs, memory, seed=i)
        ours = bench.value(readings, "INS", "Quiet")
        np.testing.assert_allclose(ours, [x, 1.0, 0.26, 0, 0, 0], atol=POSE_ATOL)


def test_ins_at_rest_has_no_noise(bench):
    inputs = bench.inputs(at=(1, 2, 0.26), angles=(0.1, -0.2, 3.0))
    memory = bench.start(inputs)
    for i in range(5):
        memory, readings = bench.read(inputs.replace(clock=clock_at(i, 1e-3)), memory, seed=i)
    ours = bench.value(readings, "INS", "Loud")
    np.testing.assert_allclose(ours, [1, 2, 0.26, 0.1, -0.2, 3.0], atol=POSE_ATOL)


def test_ins_pose_sets_the_estimate(bench):
    inputs = bench.inputs(at=(1, 2, 0.26))
    memory = bench.start(inputs)
    place = bench.suite.find("INS", "Quiet")
    for opcode, params in (("RESET", ()), ("POSE", (1.0, 2.0)), ("POSE", (0.0,) * 7)):
        assert bench.suite.handle_set(place, opcode, params, inputs, memory) is None
    pose = (5.0, -3.0, 0.5, 0.1, -0.2, 1.5)
    memory = bench.suite.handle_set(place, "pose", pose, inputs, memory)
    memory, readings = bench.read(inputs, memory)
    np.testing.assert_allclose(bench.value(readings, "INS", "Quiet"), pose, atol=POSE_ATOL)
    # From there on it goes on with what really moves: half a metre along its own idea of ahead.
    inputs = bench.inputs(0.2, at=(1.5, 2, 0.26))
    _, readings = bench.read(inputs, memory)
    ahead = np.array([math.cos(-0.2) * math.cos(1.5), math.cos(-0.2) * math.sin(1.5), math.sin(0.2)])
    ours = bench.value(readings, "INS", "Quiet")
    np.testing.assert_allclose(ours[:3], np.array(pose[:3]) + 0.5 * ahead, atol=POSE_ATOL)


def test_drifting_ins_drifts_evenly_and_at_most_by_its_precision(bench):
    """Precision 10: at most 0.1 m/s and 0.1 rad/s in each component (ours; the manual has no formula)."""
    inputs = bench.inputs()

    def drift(seed: int, until: float) -> np.ndarray:
        memory = bench.start(inputs, seed)
        for time in (0.0, until / 2, until):
            memory, readings = bench.read(inputs.replace(clock=clock_at(time, 1e-3)), memory)
        value = bench.value(readings, "INS", "Drifter")
        turned = Rotation.from_euler("ZYX", value[:2:-1]).as_rotvec()
        return np.array([*(value[:3] - (0, 0, 0.26)), *turned])

    short, long = drift(3, 2.0), drift(3, 4.0)
    np.testing.assert_allclose(long, 2 * short, atol=1e-5)
    assert len({round(abs(d), 6) for d in long}) == 6  # in different directions, at different rates
    many = np.array([drift(seed, 4.0) for seed in range(40)])
    assert np.abs(many).max() <= 4.0 / 10.0 + 1e-5
    assert np.abs(many).max() > 0.9 * 4.0 / 10.0
    # POSE ends it.
    memory = bench.start(inputs, 3)
    place = bench.suite.find("INS", "Drifter")
    memory = bench.suite.handle_set(place, "POSE", (0.0,) * 6, inputs, memory)
    _, readings = bench.read(inputs.replace(clock=clock_at(4.0, 1e-3)), memory)
    assert np.abs(bench.value(readings, "INS", "Drifter")).max() < POSE_ATOL


# --- encoder ----------------------------------------------------------------------------------


def test_encoder_counts_ticks_with_the_sign_of_its_mounting(bench):
    memory = bench.start(bench.inputs(wheels=[2.0, 2.0, 2.0, 2.0]))  # counts start here
    for ticks in (0, 1, 57, -57, 4000):
        angle = 2.0 + (ticks + math.copysign(0.5, ticks)) * TICK
        inputs = bench.inputs(wheels=[angle, 0, 0, 0])
        _, readings = bench.read(inputs, memory)
        # Looking left, along the axis about which a wheel rolls forward; looking right, against it.
        assert bench.value(readings, "Encoder", "Left") == ticks
        assert bench.value(readings, "Encoder", "Right") == -ticks


def test_encoder_measures_a_camera_joint(bench):
    """Mounted looking up, along the pan axis; the wire's pitch lifts the nose."""
    memory = bench.start(bench.inputs())
    inputs = bench.inputs(wheels=[0, 0, 0, 0, 0.5005, 0])
    _, readings = bench.read(inputs, memory)
    assert bench.value(readings, "Encoder", "Pan") == 500


def test_encoder_reset_starts_again_from_zero(bench):
    inputs = bench.inputs(wheels=[10 * TICK + 0.001, 0, 0, 0])
    memory = bench.start(bench.inputs())
    memory, readings = bench.read(inputs, memory)
    assert bench.value(readings, "Encoder", "Left") == 10
    place = bench.suite.find("Encoder", "Left")
    assert bench.suite.handle_set(place, "SCAN", (), inputs, memory) is None
    memory = bench.suite.handle_set(place, "RESET", (), inputs, memory)
    _, readings = bench.read(inputs, memory)
    assert bench.value(readings, "Encoder", "Left") == 0
    inputs = bench.inputs(wheels=[13 * TICK + 0.005, 0, 0, 0])
    _, readings = bench.read(inputs, memory)
    assert bench.value(readings, "Encoder", "Left") == 3


def test_encoder_noise_is_relative_and_falls_on_the_angle(bench):
    memory = bench.start(bench.inputs())
    inputs = bench.inputs(wheels=[0, 0, 0, 5.0])
    ticks = np.array(
        [bench.value(bench.read(inputs, memory, seed)[1], "Encoder", "Noisy") for seed in range(60)]
    )
    assert (ticks == np.trunc(ticks)).all()
    assert np.abs(ticks / 5000 - 1).max() <= 0.1 + 1 / 5000
    assert np.abs(ticks / 5000 - 1).max() > 0.08
    assert len(set(ticks.tolist())) > 50


def test_encoder_on_the_chassis_is_refused(bench, make_bench):
    robot = replace(P2AT, name="Still", sensors=(Mount(kind="Encoder", name="E"),))
    with pytest.raises(SpecError, match="a part that turns"):
        make_bench(robot).start(bench.inputs())


# --- ground truth -----------------------------------------------------------------------------


def test_ground_truth_of_the_chassis_is_its_pose(bench):
    pose = (1.0, -2.0, 0.5), (0.1, -0.2, 3.0)
    ours = bench.once("GroundTruth", "Chassis", at=pose[0], angles=pose[1])
    np.testing.assert_allclose(ours, [*pose[0], *pose[1]], atol=POSE_ATOL)


@pytest.mark.oracle
def test_ground_truth_on_a_moving_part_matches_c_mujoco(bench):
    at, angles, pan, tilt = (1.0, -2.0, 0.5), (0.1, -0.2, 2.0), 0.7, 0.3
    nowhere = ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0)))
    spec = new_spec(nowhere, Physics())
    add_robot(spec, bench.robot, "", (0.0, 0.0, 0.0))
    data = mujoco.MjData(spec.compile())
    data.joint("root").qpos = [*at, *Rotation.from_euler("ZYX", angles[::-1]).as_quat(scalar_first=True)]
    data.joint("CameraPanTilt_Link1").qpos = pan
    data.joint("CameraPanTilt_Link2").qpos = tilt
    mujoco.mj_kinematics(data.model, data)
    head = data.body("CameraPanTilt_Link2")
    turn = Rotation.from_matrix(head.xmat.reshape(3, 3))
    where = head.xpos + turn.apply(flip_vector((0.1, 0.2, -0.3)))
    turn = turn * Rotation.from_euler("ZYX", flip_angles((0.1, 0.2, 0.3))[::-1])
    ours = bench.once("GroundTruth", "Head", at=at, angles=angles, wheels=[0, 0, 0, 0, pan, tilt])
    np.testing.assert_allclose(ours, [*where, *turn.as_euler("ZYX")[::-1]], atol=POSE_ATOL)


def test_a_mount_on_an_unknown_part_lists_the_parts(bench, make_bench):
    mount = Mount(kind="GroundTruth", name="G", parent="Antenna")
    with pytest.raises(SpecError, match="GroundTruth G: no part 'Antenna'; parts: HARD, LeftFWheel"):
        make_bench(replace(P2AT, name="Bare", sensors=(mount,)))
