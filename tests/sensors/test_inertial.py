"""IMU, magnetometer and battery meter against closed forms and C MuJoCo."""

import math
from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from usarmjx.base import random
from usarmjx.base.backend import numpy_backend
from usarmjx.base.clock import clock_at
from usarmjx.base.errors import UsarmjxError
from usarmjx.base.transforms import flip_angles, flip_vector, quat_from_angles
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.kinematic_tree import forward_kinematics
from usarmjx.models.compile.physics import Physics
from usarmjx.models.drives.base import RobotState
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import Mount, options
from usarmjx.sensors.base import SensorInput
from usarmjx.sensors.rays.raycast import NO_HITS
from usarmjx.sensors.suite import suite_of
from usarmjx.server.gamebots.sensors import sensor_report
from usarmjx.server.protocol.grammar import format_message
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.configure import configure

G = 9.81
SILENT = {f"{kind}{what}": 0.0 for kind in ("Gyro", "Accel") for what in ("Noise", "Bias", "BiasWalk")}
EXACT = 2e-4  # rad/s, m/s2: single precision of speeds of some m/s, over 0.1 s
DRAWS = 4000


def sensor(kind, at=(0.0, 0.0, 0.0), direction=(0.0, 0.0, 0.0), parent="HARD", robot=P2AT, **keys):
    mount = Mount(kind=kind, name=kind, at=at, direction=direction, parent=parent, options=options(**keys))
    return suite_of(replace(robot, name=f"With {kind}", sensors=(mount,))).sensors[0]


def moving(sensor, time=0.0, pos=(0, 0, 0.3), angles=(0, 0, 0), linear=(0, 0, 0), angular=(0, 0, 0), **more):
    """What a robot senses that moves; its joints at `joint_pos`, with `joint_vel`."""
    joints = len(sensor.plan.parts) - 1
    given = {"joint_pos": np.zeros(joints), "joint_vel": np.zeros(joints)} | more
    numbers = {"pos": pos, "quat": quat_from_angles(*angles), "linear": linear, "angular": angular} | given
    state = RobotState(**{name: np.asarray(value, np.float32) for name, value in numbers.items()})
    bodies = forward_kinematics(sensor.plan, state)
    return SensorInput(clock=clock_at(time, 1e-3), state=state, bodies=bodies, hits=NO_HITS)


def measure(sensor, *moments, seed=0):
    """What it tells at the last of some moments, read at each."""
    with numpy_backend():
        moments = [moving(sensor, **moment) for moment in moments]
        memory = sensor.init_memory(moments[0], random.key(seed))
        for i, moment in enumerate(moments):
            memory, value = sensor.read(moment, memory, random.key(seed + i))
    return np.asarray(value)


# --- IMU --------------------------------------------------------------------------------------


@pytest.mark.parametrize("angles", [(0, 0, 0), (0.3, 0, 1.0), (-0.2, 0.5, -2.0), (3.0, 0, 0)])
def test_at_rest_it_tells_what_carries_the_robot(angles):
    imu = sensor("IMU", **SILENT)
    told = measure(imu, {"angles": angles}, {"angles": angles, "time": 0.1})
    up = Rotation.from_euler("ZYX", angles[::-1]).inv().apply([0.0, 0.0, G])
    np.testing.assert_allclose(told, [0, 0, 0, *up], atol=1e-5)
    once = measure(imu, {"angles": angles})
    np.testing.assert_allclose(once, told, atol=1e-5, err_msg="the first measurement too")


def test_in_free_fall_it_is_weightless():
    imu = sensor("IMU", **SILENT)
    fall = [
        {"time": t, "linear": (1.0, 0.5, -G * t), "pos": (t, t / 2, 5 - G * t * t / 2)} for t in (0.0, 0.2)
    ]
    np.testing.assert_allclose(measure(imu, *fall), np.zeros(6), atol=EXACT)


@pytest.mark.parametrize("ahead", [0.0, 0.4])
def test_on_a_circle_it_tells_the_turn_and_the_pull_towards_the_middle(ahead):
    """With constant speed on a circle the velocity's change over a step is the chord of its turn, towards the
    middle as seen half way: 2 v sin(w dt / 2) / dt. A mount ahead of the origin adds its own circle."""
    imu, radius, turn, dt = sensor("IMU", at=(ahead, 0.0, 0.0), **SILENT), 2.0, 1.5, 0.1
    moments = []
    for i in range(4):
        angle = turn * dt * i
        moments.append({
            "time": dt * i,
            "pos": (radius * math.cos(angle), radius * math.sin(angle), 0.3),
            "angles": (0.0, 0.0, angle + math.pi / 2),
            "linear": (-radius * turn * math.sin(angle), radius * turn * math.cos(angle), 0.0),
            "angular": (0.0, 0.0, turn),
        })  # fmt: skip
    pull = 2 * turn * math.sin(turn * dt / 2) / dt
    np.testing.assert_allclose(
        measure(imu, *moments), [0, 0, turn, -ahead * pull, radius * pull, G], atol=EXACT
    )


def test_it_measures_in_the_axes_of_its_mount():
    """Turned by a quarter turn to the right: the robot's x is its y. The wire's yaw is clockwise."""
    plain, turned = sensor("IMU", **SILENT), sensor("IMU", direction=(0.0, 0.0, math.pi / 2), **SILENT)
    drive = [{"time": t, "linear": (3.0 * t, 0.0, 0.0), "pos": (1.5 * t * t, 0, 0.3)} for t in (0.0, 0.1)]
    np.testing.assert_allclose(measure(plain, *drive), [0, 0, 0, 3.0, 0, G], atol=EXACT)
    np.testing.assert_allclose(measure(turned, *drive), [0, 0, 0, 0, 3.0, G], atol=EXACT)


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "parent"), [("P2AT", "CameraPanTilt_Link2"), ("TeleMax", None), ("P2AT", "HARD")]
)
def test_a_mount_on_an_arm_moves_as_c_mujoco_says(name, parent):
    """Velocity and turn of a point of a part, all joints moving: `mj_jac` times qvel, at rest and then."""
    robot = ROBOTS.get(name)
    part = parent or robot.packages[0].name + f"_Link{robot.packages[0].links[-1].number}"
    at, direction = (0.1, 0.2, -0.3), (0.1, 0.2, 0.3)
    imu = sensor("IMU", at, direction, part, robot, **SILENT)
    spec = new_spec(ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0))), Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    data, rng = mujoco.MjData(spec.compile()), np.random.default_rng(3)
    joints = imu.plan.parts[1:]
    rest, motion = rng.uniform(-0.3, 0.3, len(joints)), rng.uniform(-1.0, 1.0, len(joints))
    angles, linear, angular = (0.1, -0.2, 2.0), (0.5, -0.3, 0.2), (0.4, 0.6, -0.8)
    quat = Rotation.from_euler("ZYX", angles[::-1]).as_quat(scalar_first=True)
    data.joint("root").qpos, data.joint("root").qvel = [1.0, -2.0, 0.5, *quat], [*linear, *angular]
    for joint, where, speed in zip(joints, rest, motion, strict=True):
        data.joint(joint).qpos, data.joint(joint).qvel = where, speed
    mujoco.mj_forward(data.model, data)
    body = data.body("chassis" if part == "HARD" else part)
    frame = Rotation.from_matrix(body.xmat.reshape(3, 3))
    point = body.xpos + frame.apply(flip_vector(at))
    frame = frame * Rotation.from_euler("ZYX", flip_angles(direction)[::-1])
    jac = np.zeros((2, 3, data.model.nv))
    mujoco.mj_jac(data.model, data, jac[0], jac[1], point, body.id)
    velocity, turn = jac @ data.qvel
    where = {"pos": (1.0, -2.0, 0.5), "angles": angles, "joint_pos": rest}
    now = {"linear": linear, "angular": angular, "joint_vel": motion}
    np.testing.assert_allclose(measure(imu, where | now)[:3], frame.inv().apply(turn), atol=EXACT)
    # From standing still to that speed within 0.1 s, at the same place.
    told = measure(imu, where, where | now | {"time": 0.1})
    np.testing.assert_allclose(told[3:], frame.inv().apply(velocity / 0.1 + [0, 0, G]), atol=10 * EXACT)


def many(sensor, steps, dt, draws=DRAWS):
    """What as many robots at rest tell at each step (steps, robots, n), and what their sensors remember."""
    with numpy_backend():
        one = moving(sensor)
        keys = random.fold_in(random.key(5), np.arange(draws))

        def repeated(values):
            return np.repeat(np.asarray(values)[None], draws, 0)

        own = {name: getattr(one, name) for name in ("state", "bodies", "hits")}
        team = one.replace(**jax.tree.map(repeated, own))
        memories = [sensor.init_memory(one, key) for key in keys]
        memory, told = jax.tree.map(lambda *rows: np.stack(rows), *memories), []
        for i in range(steps):
            team = team.replace(clock=clock_at(dt * i, 1e-3))
            memory, value = sensor.read(team, memory, random.fold_in(keys, np.array([i]))[:, 0])
            told.append(value)
    return np.array(told), memory


def test_noise_and_biases_are_as_large_as_their_settings_say():
    """Means over dt of white noise of a density n deviate by n / sqrt(dt), a walk by its rate times sqrt(t).
    The deviation of so many draws is good to 1 / sqrt(2 draws), 1.1 %; four times that."""
    near, dt = 4 / math.sqrt(2 * DRAWS), 0.04
    quiet = measure(sensor("IMU", **SILENT), {})
    for kind, mine in (("Gyro", slice(3)), ("Accel", slice(3, 6))):
        noisy, _ = many(sensor("IMU", **SILENT | {f"{kind}Noise": 0.01}), 2, dt)
        assert (noisy[1] - quiet)[:, mine].std(0) == pytest.approx(0.01 / math.sqrt(dt), rel=near)
        others = np.delete(noisy[1] - quiet, mine, 1)
        assert np.abs(others).max() < 1e-5
        biased, _ = many(sensor("IMU", **SILENT | {f"{kind}Bias": 0.2}), 2, dt)
        assert (biased[1] - quiet)[:, mine].std(0) == pytest.approx(0.2, rel=near)
        np.testing.assert_allclose(biased[0], biased[1], atol=1e-5, err_msg="a bias stays")
        walked, _ = many(sensor("IMU", **SILENT | {f"{kind}BiasWalk": 0.05}), 10, dt)
        spread = (walked - quiet)[..., mine].std(1).mean(-1)
        assert spread[[1, 4, 9]] == pytest.approx(0.05 * np.sqrt(dt * np.array([1, 4, 9])), rel=near)


def test_it_goes_up_to_its_limits():
    imu = sensor("IMU", **SILENT | {"GyroRange": 2.0, "AccelRange": 5.0})
    told = measure(imu, {}, {"time": 0.1, "angles": (0, 0, 0.5), "linear": (-4, 0, 0)})
    assert told[[2, 3, 5]].tolist() == [2.0, -5.0, 5.0]


# --- magnetometer -----------------------------------------------------------------------------


@pytest.mark.parametrize("angles", [(0, 0, 0), (0, 0, math.pi / 2), (0.4, -0.3, 2.5)])
@pytest.mark.parametrize("declination", [0.0, 0.2])
def test_the_field_points_north_and_down_whichever_way_it_looks(angles, declination):
    """Magnetic north is `declination` to the east, that is, to the right of x."""
    keys = {"Strength": 50.0, "Inclination": 1.0, "Declination": declination, "FieldNoise": 0.0}
    told = measure(sensor("Magnetometer", **keys), {"angles": angles})
    north = Rotation.from_euler("z", -declination).apply([math.cos(1.0), 0.0, -math.sin(1.0)])
    expected = 50.0 * Rotation.from_euler("ZYX", angles[::-1]).inv().apply(north)
    np.testing.assert_allclose(told, expected, atol=1e-4)
    assert np.linalg.norm(told) == pytest.approx(50.0, rel=1e-6)


def test_iron_of_the_robot_turns_with_it_and_noise_is_as_large_as_it_says():
    iron = {"HardIron": (("X", 3.0), ("Y", 2.0), ("Z", 1.0)), "FieldNoise": 0.0}
    told = measure(sensor("Magnetometer", **iron), {"angles": (0.1, 0.2, 0.3)})
    plain = measure(sensor("Magnetometer", FieldNoise=0.0), {"angles": (0.1, 0.2, 0.3)})
    np.testing.assert_allclose(told - plain, [3.0, -2.0, -1.0], atol=1e-5)  # the wire's y is right, z down
    loud = sensor("Magnetometer", FieldNoise=0.5)
    told = np.array([measure(loud, {}, seed=seed) for seed in range(400)])
    assert told.std(0) == pytest.approx(0.5, rel=4 / math.sqrt(2 * len(told)))
    with pytest.raises(UsarmjxError, match=r"HardIron is .* expected X, Y and Z"):
        sensor("Magnetometer", HardIron=(("W", 1.0),))


# --- battery ----------------------------------------------------------------------------------


def test_charge_and_voltage_fall_evenly_with_the_time_that_is_left():
    meter = sensor("Battery", FullVoltage=24.0, EmptyVoltage=20.0)
    life = meter.plan.robot.battery_life
    for left, share in ((life, 1.0), (life / 4, 0.25), (0.0, 0.0)):
        with numpy_backend():
            inputs = moving(meter).replace(battery=np.float32(left))
            _, told = meter.read(inputs, (), random.key(0))
        np.testing.assert_allclose(told, [share, 20.0 + 4.0 * share, left], rtol=1e-6)
    with pytest.raises(UsarmjxError, match=r"EmptyVoltage is 30, expected at most FullVoltage, 25.2"):
        sensor("Battery", EmptyVoltage=30.0)


INI = """[USARBot.IMU]
GyroNoise=0.0
GyroBias=0.0
GyroBiasWalk=0.0
[USARBot.P2AT]
batteryLife=40.0
AddSensors=(ItemClass=class'USARBot.IMU',ItemName="Chip",AccelNoise=0.0,AccelBias=0.0,AccelBiasWalk=0.0)
AddSensors=(ItemClass=class'USARBot.Magnetometer',ItemName="Needle",FieldNoise=0.0,HardIron=(X=1.0))
AddSensors=(ItemClass=class'USARBot.Battery',ItemName="Cells",FullVoltage=24.0,EmptyVoltage=20.0)
"""


def test_an_ini_file_mounts_them_and_a_client_hears_of_them(monkeypatch, tmp_path):
    """A served robot at rest, 10 s after its start: the lines, and the battery as the world has it."""
    monkeypatch.setattr(ROBOTS, "_entries", dict(ROBOTS._entries))
    (tmp_path / "chips.ini").write_text(INI)
    assert configure([tmp_path / "chips.ini"]).warnings == ()
    world = DynamicWorld(ARENAS.get("yellow"))
    robot = world.spawn(ROBOTS.get("P2AT"), "R1", (4.5, -1.9, 0.3), (0.0, 0.0, 0.0))
    for _ in range(500):
        world.step()
    world.observe([robot])
    lines = {}
    for place, value in robot.pending.items():
        one = robot.suite.sensors[place]
        lines[one.kind] = format_message(sensor_report(one, value, 10.0))
    assert world.battery(robot) == pytest.approx(30.0)
    cells = "SEN {Type Battery} {Name Cells} {Charge 0.7500} {Voltage 23.0000} {TimeLeft 30.0000}"
    assert lines["Battery"] == cells
    _, turn, pull = (part.split("}")[0].split(" ")[-1] for part in lines["IMU"].split("{")[2:])
    assert np.abs(np.array(turn.split(","), float)).max() < 1e-3
    assert np.array(pull.split(","), float) == pytest.approx([0.0, 0.0, -G], abs=0.05)
    field = [float(x) for x in lines["Magnetometer"].split("Field ")[1].rstrip("}").split(",")]
    assert field == pytest.approx([48 * math.cos(1.13) + 1.0, 0.0, 48 * math.sin(1.13)], abs=0.05)
    robot.drowned = True
    world.edit(robot, drowned=True)
    for _ in range(60):
        world.step()
    world.observe([robot])
    cells = robot.suite.index("Battery")
    assert robot.pending[cells].tolist() == pytest.approx([0.0, 20.0, 0.0])
