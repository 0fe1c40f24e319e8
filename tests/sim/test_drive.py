"""How the robots drive: speeds, turns, slopes, obstacles and walls; oracles are the manual and closed forms.

Most tests run on plain C MuJoCo with the product's own control function, as a served world does; the
last ones compare the engines.
"""

import math
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.rig import PERIOD, Rig, steady_speed, steady_spin
from usarmjx.base.transforms import angles_from_mat
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.shapes import Shape
from usarmjx.server.protocol.frames import flip_wire_angles
from usarmjx.sim.batch import Batch
from usarmjx.sim.control import FLIP_TIME
from usarmjx.sim.scene import build_scene

BOTH = pytest.mark.parametrize("name", ["P2AT", "P2DX"])
TOP_SPEED = {"P2AT": 0.7, "P2DX": 1.8}  # m/s: captured CONF of the P2AT; manual 12.3.1
TOP_SPEED_RTOL, ROLLING_RTOL, TURN_RTOL, ENGINE_RTOL = 0.10, 0.05, 0.05, 0.10
CAMERA_SPEED, TILT_MAX = 0.17, 0.40  # rad/s, rad: manual 9.3
SERVO_ATOL = 0.01  # rad: how far the camera may be from where it was sent


@BOTH
def test_top_speed(name):
    rig = Rig(name)
    rig.tell(Left=99.0, Right=99.0)  # more than any wheel can do
    assert steady_speed(rig) == pytest.approx(TOP_SPEED[name], rel=TOP_SPEED_RTOL)


@BOTH
def test_one_radian_per_second_rolls_one_wheel_radius_per_second(name):
    rig = Rig(name).tell(Left=1.0, Right=1.0)
    assert steady_speed(rig) == pytest.approx(rig.robot.wheel_radius, rel=ROLLING_RTOL)
    assert abs(rig.data.qpos[1]) < 0.02, "straight ahead"


@BOTH
def test_braking_from_top_speed_does_not_tip_the_robot_over(name):
    """A P2DX has nothing before its wheels: it bows by some 20 degrees and comes down again."""
    rig = Rig(name).tell(Left=99.0, Right=99.0)
    rig.run(2.0)
    rig.tell(Left=0.0, Right=0.0)
    worst = min(rig.up.min() for _ in range(100) if rig.step() is None)
    assert worst > math.cos(math.radians(30))
    assert rig.up[0] > 0.999
    assert np.abs(rig.run(1.0)[-1, 3:]).max() < 0.01


def test_p2dx_turns_in_place_as_its_wheels_say():
    rig = Rig("P2DX").tell(Left=-5.0, Right=5.0)
    expected = 2 * 5.0 * rig.robot.wheel_radius / rig.robot.wheel_separation
    assert steady_spin(rig) == pytest.approx(expected, rel=TURN_RTOL)


def test_p2at_top_spin_is_its_data_sheets():
    """Manual 12.1.1: 140 deg/s; within 5 %, as single instants vary by 4 deg/s.

    Rigid wheels with Coulomb friction would turn at v b / (a^2 + b^2), for half the wheel base a and half the
    track b: its tyres yield sideways.
    """
    rig = Rig("P2AT").tell(Left=-99.0, Right=99.0)
    v, a, b = 0.7, rig.robot.wheel_base / 2, rig.robot.wheel_separation / 2
    assert math.degrees(v * b / (a * a + b * b)) == pytest.approx(123.8, abs=0.1)
    assert math.degrees(steady_spin(rig)) == pytest.approx(140.0, rel=0.05)


@BOTH
@pytest.mark.parametrize(("tilt", "yaw"), [(0, 0), (10, 0), (10, 40), (10, 90)])
def test_a_robot_at_rest_stays_where_it_is(name, tilt, yaw):
    rig = Rig(name, places=((0.0, 0.0, math.radians(yaw)),), tilt=math.radians(tilt))
    rig.run(1.0)
    start = rig.data.qpos[:3].copy()
    log = rig.run(10.0)
    assert np.linalg.norm(log[-1, :3] - start) < 0.01
    assert math.sqrt((log[:, 3:6] ** 2).sum(1).mean()) < 1e-3
    assert math.degrees(math.sqrt((log[:, 6:9] ** 2).sum(1).mean())) < 0.2


@pytest.mark.parametrize(("height", "length"), [(0.04, 0.09), (0.06, 1.0)])
def test_p2at_climbs_boards_and_steps(height, length):
    near = 0.6
    step = Shape(
        kind="box",
        size=(length / 2, 1.0, height / 2),
        at=(near + length / 2, 0.0, height / 2),
        surface="ground",
    )
    rig = Rig("P2AT", step).tell(Left=3.0, Right=3.0)
    log = rig.run(5.0)
    assert log[:, 2].max() > rig.robot.origin_height + 0.4 * height, "an axle at a time: half of it"
    assert log[-1, 0] > near + 0.5
    assert rig.up[0] > 0.95


@BOTH
def test_a_robot_against_a_wall_stays_down_and_backs_off_at_once(name):
    wall = Shape(kind="box", size=(0.05, 2.0, 0.5), at=(1.0, 0.0, 0.5), surface="wall")
    rig = Rig(name, wall).tell(Left=99.0, Right=99.0)
    log = rig.run(5.0)
    assert np.abs(log[:, 2] - rig.robot.origin_height).max() < 0.05
    assert rig.up[0] > 0.99
    assert 0.5 < log[-1, 0] < 1.0, "it is at the wall"
    rig.tell(Left=-99.0, Right=-99.0)
    assert rig.run(0.5)[-1, 0] < log[-1, 0] - 0.05, "the wheels need not unwind first"


@BOTH
def test_left_slower_than_right_turns_left(name):
    """Left is a negative yaw on the wire, whose yaw is clockwise seen from above (manual 6.1)."""
    rig = Rig(name).tell(Left=1.0, Right=3.0)
    rig.run(1.0)
    mat = rig.mat("chassis")
    assert rig.data.qpos[1] > 0.01, "it went to its left"
    assert flip_wire_angles(angles_from_mat(mat))[2] < -0.1


@pytest.fixture(scope="module")
def camera():
    """Pan and tilt of a P2AT's camera, stepped: (rig, fastest joint speed seen)."""

    def aim(pan, tilt, seconds):
        rig = Rig("P2AT").move({"CameraPanTilt_Link1": pan, "CameraPanTilt_Link2": tilt})
        pair, rates = list(rig.indices[0].qposadr[-2:]), []
        before = rig.data.qpos[pair].copy()
        for _ in range(round(seconds / PERIOD)):
            rig.step()
            rates.append(np.abs(rig.data.qpos[pair] - before).max() / PERIOD)
            before = rig.data.qpos[pair].copy()
        return rig, np.array(rates), before

    return aim


def test_camera_pans_left_and_tilts_up_no_faster_than_it_can(camera):
    rig, rates, joints = camera(0.5, 0.3, 4.0)
    assert joints == pytest.approx([0.5, 0.3], abs=SERVO_ATOL)
    assert rates.max() < CAMERA_SPEED * 1.1
    assert rates[50:100].mean() == pytest.approx(CAMERA_SPEED, rel=0.02), "but as fast as it can"
    ahead = rig.mat("chassis").T @ rig.mat("CameraPanTilt_Link2")[:, 0]
    expected = (math.cos(0.5) * math.cos(0.3), math.sin(0.5) * math.cos(0.3), math.sin(0.3))
    np.testing.assert_allclose(ahead, expected, atol=2 * SERVO_ATOL)  # +y is left, +z up


def test_camera_stops_at_the_end_of_its_range(camera):
    _, _, joints = camera(0.0, 1.0, 5.0)
    assert joints[1] == pytest.approx(TILT_MAX, abs=SERVO_ATOL)


def heading(rig):
    """Where the nose of the first robot points [rad]."""
    w, x, y, z = rig.data.qpos[3:7]
    return math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))


TURNS = 0.1
"""How far robots turn [rad]: a TeleMax by 0.09 from its back, a Rugbot by 0.06, all others by less."""
LEANING = math.pi + 0.02
"""Nearly on its back, from where a Rugbot falls onto a corner [rad]."""
SHIFT = {math.pi: 0.17, math.pi / 2: 0.17, LEANING: 0.2}
"""How far robots move, over their longest dimension: a Rugbot by 0.11 from its back and 0.17 from its corner,
all others by less than 0.1."""


@pytest.mark.every_run(
    "P2AT-3.141592653589793",
    "Talon-1.5707963267948966",
    "Hummer-3.141592653589793",
    "kenaf-1.5707963267948966",
    "OmniP2AT-3.141592653589793",
)
@pytest.mark.parametrize("roll", [math.pi, math.pi / 2, LEANING])
@pytest.mark.parametrize("name", [name for name, robot in ROBOTS if robot.drive.is_wheeled])
def test_flip_puts_every_wheeled_or_tracked_robot_back_on_its_feet(name, roll):
    """Manual 9.4; within KRobot.uc's flip time."""
    rig = Rig(name, roll=roll)
    rig.run(1.0)
    assert rig.up[0] < (0.4 if roll == LEANING else 0.3)  # a P2DX leans at 0.32
    place, nose = rig.data.qpos[:2].copy(), heading(rig)
    rig.tell(flip_until=rig.data.time + FLIP_TIME)
    rig.run(FLIP_TIME)
    assert rig.up[0] > math.cos(math.radians(10))
    rig.run(1.0)
    assert rig.up[0] > 0.999
    assert rig.data.qpos[2] == pytest.approx(rig.plan.clearance, abs=0.01)
    assert np.linalg.norm(rig.data.qpos[:2]) < 2 * max(rig.robot.dimensions), "over its edge, no farther"
    shift = np.linalg.norm(rig.data.qpos[:2] - place)
    assert shift < SHIFT[roll] * max(rig.robot.dimensions), "it keeps its place"
    turned = abs(math.remainder(heading(rig) - nose, 2 * math.pi))
    assert turned < TURNS, "and its heading"
    assert not any(warning.number for warning in rig.data.warning), "MuJoCo did not have to start again"


def wall(x, y, half_x, half_y):
    return Shape(kind="box", size=(half_x, half_y, 0.6), at=(x, y, 0.6), surface="wall")


@pytest.mark.every_run("0")
@pytest.mark.parametrize("seed", [0, 1])
def test_a_brawl_in_a_small_room_stays_on_the_ground(seed):
    """Four robots at full throttle in 2.4 m, with a ramp and a step to be pushed onto."""
    walls = (
        wall(1.25, 0, 0.05, 1.3),
        wall(-1.25, 0, 0.05, 1.3),
        wall(0, 1.25, 1.3, 0.05),
        wall(0, -1.25, 1.3, 0.05),
    )
    ramp = Shape(
        kind="box",
        size=(0.4, 0.4, 0.2),
        at=(0.8, 0.8, 0.0),
        rotation=(0, -math.radians(15), 0),
        surface="ground",
    )
    step = Shape(kind="box", size=(0.3, 0.3, 0.025), at=(-0.8, -0.8, 0.025), surface="ground")
    places = ((0.6, 0.0, 0.0), (-0.6, 0.3, 1.3), (0.2, -0.75, 2.6), (-0.1, 0.8, 3.9))
    rig, random = Rig("P2AT", *walls, ramp, step, places=places), np.random.default_rng(seed)
    top, fastest, highest, travelled = rig.robot.drive.max_speed, 0.0, 0.0, 0.0
    for tick in range(round(20.0 / PERIOD)):
        if tick % 5 == 0:
            for robot in range(len(places)):
                left, right = random.uniform(-top, top, 2)
                rig.tell(robot, Left=left, Right=right)
        rig.step()
        for index in rig.indices:
            speed = np.linalg.norm(rig.data.qvel[index.root_dofadr : index.root_dofadr + 3])
            fastest, travelled = max(fastest, speed), travelled + speed * PERIOD
            highest = max(highest, rig.data.qpos[index.root_qposadr + 2])
            assert rig.up.min() > 0.0
    assert fastest < 3.0
    assert highest < 0.5
    assert travelled > 4.0, "they did move"


# Engines


@pytest.fixture(scope="module")
def flat():
    return build_scene(FLAT, ["P2AT"])


@cache
def batch_on(engine, scene):
    return Batch(scene, 1, engine=engine)


def batch_rates(batch):
    """Straight speed at the top of a P2AT [m/s] and its rate of turning in place [rad/s]."""
    top, dof = batch.scene.groups[0].robot.drive.max_speed, batch.scene.groups[0].root_dofadr[0]

    def steady(left, right):
        state, rows = batch.drive(batch.reset(), 0, {"Left": left, "Right": right}), []
        for _ in range(100):
            state = batch.step(state)
            rows.append(np.asarray(batch.physics(state).qvel)[0, dof])
        batch.check_overflow(state)
        return np.array(rows[50:])

    speed = np.linalg.norm(steady(top, top)[:, :2], axis=1).mean()
    return speed, steady(-top, top)[:, 5].mean()


@pytest.mark.thorough
@pytest.mark.oracle
@pytest.mark.parametrize("engine", [pytest.param("jax", marks=pytest.mark.slow), "warp"])
def test_engines_drive_and_turn_alike(flat, engine):
    if engine == "warp":
        pytest.importorskip("warp", reason="needs warp-lang")
    expected = batch_rates(batch_on("c", flat))
    assert expected[0] == pytest.approx(TOP_SPEED["P2AT"], rel=TOP_SPEED_RTOL)
    assert batch_rates(batch_on(engine, flat)) == pytest.approx(expected, rel=ENGINE_RTOL)


def test_an_empty_battery_brakes(flat):
    batch = batch_on("c", flat)
    state = batch.drive(batch.reset(), 0, {"Left": 4.0, "Right": 4.0})
    members = state.worlds.groups[0]
    life = batch.scene.groups[0].robot.battery_life
    state = batch.with_group(
        state,
        0,
        members.replace(
            battery_start=jnp.full_like(
                members.battery_start, round((1.0 - life) / batch.scene.physics.period)
            )
        ),
    )
    dof, speeds = batch.scene.groups[0].root_dofadr[0], []
    for _ in range(100):
        state = batch.step(state)
        speeds.append(np.linalg.norm(np.asarray(batch.physics(state).qvel)[0, dof[:3]]))
    assert np.mean(speeds[30:50]) == pytest.approx(4.0 * 0.13, rel=0.1), "driving while it lasts"
    assert np.mean(speeds[90:]) < 0.01
