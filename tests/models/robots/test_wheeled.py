"""The wheeled robots: speeds, turns, brakes, slopes and springs, against the manual and closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.arenas import FLAT
from tests.rig import PERIOD, Rig, steady_speed, steady_spin
from usarmjx.base.backend import numpy_backend
from usarmjx.engines.base import check_features
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.drives import SkidSteer
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import SUSPENSION_SUFFIX
from usarmjx.sensors.suite import suite_of
from usarmjx.sim.scene import RosterEntry, build_scene

SKID = ("StereoP2AT", "ATRVJr", "Zerg", "Kurt2D", "Kurt3D")
CARS = ("Hummer", "SnowStorm", "Sedan", "Cooper")
ALL = (*SKID, "Lisa", *CARS)
every = pytest.mark.parametrize("name", ALL)
skid = pytest.mark.parametrize("name", SKID)
car = pytest.mark.parametrize("name", CARS)

# m/s: manual 12.1 (StereoP2AT, 12.2), 12.4, 12.11 and 12.16. The cars' are 100 rad/s (12.5, 12.7, 12.8) times
# their radius: manual 12.5 and 12.7, data sheets 215/75 R15 and 175/65 R15. Lisa has none there.
INCH = 0.0254
TOP_SPEED = {
    "StereoP2AT": 0.7,
    "ATRVJr": 1.0,
    "Zerg": 6.2832 * 0.0606,
    "Kurt2D": 4.0,
    "Kurt3D": 4.0,
    "Lisa": 1.0,
    "Hummer": 37.27,
    "SnowStorm": 100 * (15 * INCH / 2 + 0.75 * 0.215),
    "Sedan": 28.2,
    "Cooper": 100 * (15 * INCH / 2 + 0.65 * 0.175),
}
TOP_SPEED_RTOL = 0.02  # of rolling almost without slip
CIRCLE_RTOL = 0.05  # tyres creep sideways under the centripetal force, and steering gives in a little
GRAVITY, GRIP = 9.81, 0.8


def full_speed(name, sign=1.0):
    """The keys of DRIVE that send a robot straight ahead as fast as it can."""
    full = ROBOTS.get(name).drive.full_scale
    return {key: sign * value for key, value in full.items() if "Steer" not in key}


def seconds_to_top_speed(name):
    return 16.0 if name in CARS else 5.0


@pytest.mark.every_run("ATRVJr", "Hummer", "Lisa")
@every
def test_it_weighs_and_stands_as_described(name):
    robot = ROBOTS.get(name)
    plan = kinematic_tree_of(robot)
    assert plan.mass == pytest.approx(robot.mass, rel=1e-9)
    assert plan.clearance == pytest.approx(robot.origin_height, abs=1e-9)
    rig = Rig(name)
    log = rig.run(2.0)
    assert rig.up[0] > 0.99999  # 0.3 degrees
    assert log[-1, 2] == pytest.approx(robot.origin_height, abs=1e-3)
    assert np.abs(log[-1, 3:]).max() < 1e-4


@pytest.mark.every_run("ATRVJr", "Hummer")
@every
def test_top_speed_and_straightness(name):
    rig = Rig(name).tell(**full_speed(name))
    rig.run(seconds_to_top_speed(name))
    start, log = rig.data.qpos[:2].copy(), rig.run(2.0)
    assert np.hypot(log[:, 3], log[:, 4]).mean() == pytest.approx(TOP_SPEED[name], rel=TOP_SPEED_RTOL)
    ahead = rig.mat("chassis")[:, 0]
    assert math.degrees(abs(math.atan2(ahead[1], ahead[0]))) < 2.0
    assert abs(log[-1, 1] - start[1]) < 0.03 * abs(log[-1, 0] - start[0])
    assert np.abs(log[:, 2] - rig.robot.origin_height).max() < 0.02
    assert rig.up[0] > 0.999


@pytest.mark.every_run("ATRVJr", "Hummer")
@every
def test_it_brakes_from_top_speed_and_stays(name):
    """No sooner than tyres can stop it: v^2 / (2 mu g)."""
    rig = Rig(name).tell(**full_speed(name))
    rig.run(seconds_to_top_speed(name))
    start = rig.data.qpos[0]
    rig.tell(**full_speed(name, 0.0))
    lean, log = 1.0, []
    for _ in range(round(seconds_to_top_speed(name) / PERIOD)):
        rig.step()
        lean = min(lean, rig.up[0])
        log.append(rig.data.qpos[0] - start)
    shortest = TOP_SPEED[name] ** 2 / (2 * GRIP * GRAVITY)
    assert 0.9 * shortest < max(log) < (6.0 if name in CARS else 12.0) * shortest + 0.1
    assert max(log) - log[-1] < 0.05, "it rocks on its wheels, no more"
    assert lean > math.cos(math.radians(5))
    assert np.abs(rig.run(1.0)[:, 3:]).max() < 0.01


# Skid-steered robots


@skid
def test_one_radian_per_second_rolls_one_wheel_radius_per_second(name):
    rig = Rig(name).tell(Left=1.0, Right=1.0)
    assert steady_speed(rig) == pytest.approx(rig.robot.wheel_radius, rel=0.01)
    assert abs(rig.data.qpos[1]) < 0.002


def skidding_rate(robot, speed):
    """Turning rate of rigid wheels with Coulomb friction and equal loads [rad/s]: their moments cancel.

    Each rim has two points on the ground, at the edges of the tyre; a point at (x, y) slips by (speed - rate
    y, -rate x) and is pulled that way with the same force.
    """
    xs = np.array([wheel.at[0] for wheel in robot.wheels if wheel.at[1] > 0])
    half = robot.wheels[0].shapes[0].size[1]
    x, y = np.meshgrid(xs, robot.wheel_separation / 2 + half * np.array([-1, 1]))

    def moment(rate):
        ahead, aside = speed - rate * y, -rate * x
        return ((y * ahead + x * aside) / np.hypot(ahead, aside)).sum()

    low, high = 0.0, speed / y.min()
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if moment(middle) > 0 else (low, middle)
    return low


@pytest.mark.parametrize(("name", "sheet"), [("StereoP2AT", 140.0), ("ATRVJr", 120.0), ("P2DX", 300.0)])
def test_turning_in_place_and_top_speed_are_both_figures_of_the_data_sheet(name, sheet):
    """Manual 12.1.1, 12.3.1 and 12.4.1: degrees a second, within 10 %."""
    rig = Rig(name).tell(Left=-99.0, Right=99.0)
    assert math.degrees(steady_spin(rig, settle=3.0)) == pytest.approx(sheet, rel=0.1)
    assert np.linalg.norm(rig.data.qpos[:2]) < 0.2, "in place"


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.5, 5.385])
def test_a_p2at_slips_as_much_as_its_data_sheets_figures_say_at_any_speed(speed):
    """0.7 m/s and 140 degrees/s: 1.22; the software of the real one has 1.25 (588 mm)."""
    rig = Rig("P2AT").tell(Left=-speed, Right=speed)
    slip = 2 * speed * rig.robot.wheel_radius / (rig.robot.wheel_separation * steady_spin(rig, settle=3.0))
    assert slip == pytest.approx(1.22, rel=0.06)


def test_tyres_that_yield_push_nobody():
    """No torque without wheels that turn against each other, none on the back, and none to overtake them."""
    drive = ROBOTS.get("P2AT").drive
    with numpy_backend():
        assert drive.yaw_torque(np.zeros(3), np.array([-2.0, 0.0, 2.0])).tolist() == [0.0] * 3
        spin = np.array([5.0, -5.0])
        wheels = spin * drive.radius / drive.lever
        assert (drive.yaw_torque(spin, np.zeros(2)) * spin > 0.0).all()
        assert drive.yaw_torque(spin, 1.5 * wheels).tolist() == [0.0] * 2, "faster than the wheels"
        assert np.abs(drive.yaw_torque(spin, -9.0 * wheels)).max() <= 1.5 * drive.ease
    rig = Rig("P2AT", roll=math.pi, height=0.4).tell(Left=-5.0, Right=5.0)
    assert abs(steady_spin(rig, settle=1.0)) < 0.02


@pytest.mark.parametrize(("name", "low", "high"), [("ATRVJr", 0.8, 1.1), ("Zerg", 0.9, 1.1)])
def test_four_wheelers_turn_in_place_as_fast_as_rigid_wheels_skid(name, low, high):
    """The ATRVJr is slower: its wide tyres hop. Manual 12.4.1 says 120 degrees/s."""
    rig = Rig(name).tell(Left=-99.0, Right=99.0)
    expected = skidding_rate(rig.robot, TOP_SPEED[name])
    assert low * expected < steady_spin(rig, settle=3.0) < high * expected
    assert np.linalg.norm(rig.data.qpos[:2]) < 0.2, "in place"


@pytest.mark.parametrize("name", ["Kurt2D", "Kurt3D"])
def test_six_wheelers_turn_in_place(name):
    """Slower than rigid wheels, which turn at 1043 degrees/s: theirs hop, so that some of them do not pull.

    Were the middle ones without load, they would be four-wheelers with three quarters of the rate.
    """
    rig = Rig(name).tell(Left=-5.0, Right=5.0)
    rate = steady_spin(rig, settle=3.0)
    outer = replace(rig.robot, parts=tuple(wheel for wheel in rig.robot.wheels if wheel.at[0]))
    expected = skidding_rate(outer, 5.0 * rig.robot.wheel_radius)
    assert expected < skidding_rate(rig.robot, 5.0 * rig.robot.wheel_radius)
    assert 0.7 * expected < rate < 1.1 * expected
    assert np.linalg.norm(rig.data.qpos[:2]) < 0.2, "in place"


# Cars


@pytest.mark.every_run("0.1-Hummer", "-0.56-Cooper")
@car
@pytest.mark.parametrize("angle", [0.1, 0.3, -0.56])
def test_turning_circle(name, angle):
    """The rear axle's middle goes round at base / tan(angle); the origin is half a base before it."""
    rig = Rig(name)
    robot = rig.robot
    rig.tell(Speed=3.0 / robot.wheel_radius, FrontSteer=angle)
    rig.run(4.0)
    log = rig.run(4.0)
    radius = np.hypot(log[:, 3], log[:, 4]).mean() / log[:, 8].mean()
    expected = math.copysign(math.hypot(robot.wheel_base / math.tan(angle), robot.wheel_base / 2), angle)
    assert radius == pytest.approx(expected, rel=CIRCLE_RTOL)
    angles = robot.drive.steering_angles(
        {part.name: rig.joint(part.name) for part in robot.parts}, np.zeros(3)
    )
    assert angles["front_steer"] == pytest.approx(angle, abs=0.005)
    assert angles["rear_steer"] == 0.0
    # Speed is that of the powered wheels' middle: the front axle, or the middle between both.
    powered = [wheel.x for wheel in robot.drive.wheels if wheel.powered]
    middle = math.hypot(robot.wheel_base / math.tan(angle), np.mean(powered) + robot.wheel_base / 2)
    assert abs(log[:, 8].mean()) * middle == pytest.approx(3.0, rel=CIRCLE_RTOL)


@pytest.mark.every_run("Sedan")
@car
def test_a_swerve_at_15_m_s_does_not_turn_it_over(name):
    """Full lock at once, then the other way: it slides, as tyres pull less sideways than it takes to tip."""
    rig = Rig(name).tell(Speed=15.0 / ROBOTS.get(name).wheel_radius)
    rig.run(8.0)
    lean = 1.0
    for steer in (0.56, -0.56):
        rig.tell(FrontSteer=steer)
        lean = min(lean, *(rig.up.min() for _ in range(150) if rig.step() is None))
    assert lean > math.cos(math.radians(15))


@car
def test_wheels_steer_no_faster_than_they_can(name):
    """Manual 14.4.2.3: SteerSpeed 15000, 1.438 rad/s as Unreal counts angles."""
    rig = Rig(name).tell(FrontSteer=0.5)
    angles = [rig.joint("LeftFWheel_Steer") for _ in range(30) if rig.step() is None]
    rates = np.diff(angles) / PERIOD
    assert rates.max() < 1.2 * 1.438
    assert rates[5:15].mean() == pytest.approx(1.438, rel=0.05)
    rig.run(1.0)
    inner = math.atan(1 / (1 / math.tan(0.5) - rig.robot.wheel_separation / 2 / rig.robot.wheel_base))
    assert rig.joint("LeftFWheel_Steer") == pytest.approx(inner, abs=0.01)


@car
@pytest.mark.parametrize("load", [0.9, 1.15])
def test_suspension_gives_by_load_over_stiffness(name, load):
    """The car on a planet with other gravity. The springs carry all but wheels and hubs."""
    rig = Rig(name)
    rig.run(2.0)
    slides = [part for part in rig.robot.parts if part.name.endswith(SUSPENSION_SUFFIX)]
    assert len(slides) == 4
    for slide in slides:
        assert rig.joint(slide.name) == pytest.approx(0.0, abs=5e-4), "at rest they are as drawn"
    weight = sum(slide.spring.load for slide in slides)
    unsprung = sum(s.mass for p in rig.robot.parts for s in p.shapes)
    assert weight == pytest.approx((rig.robot.mass - unsprung) * GRAVITY, rel=1e-9)
    rig.model.opt.gravity[2] *= load
    rig.run(3.0)
    for slide in slides:
        expected = (load - 1) * slide.spring.load / slide.spring.stiffness
        assert rig.joint(slide.name) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("name", ["Sedan", "Cooper"])
def test_unpowered_wheels_roll_along(name):
    """Without torque they roll as fast as the road goes by, forward and back."""
    rig = Rig(name).tell(Speed=20.0)
    rig.run(4.0)
    rear = [rig.model.joint(f"r0/{side}RWheel").id for side in ("Left", "Right")]
    for sign in (1, -1):
        rig.tell(Speed=sign * 20.0)
        rig.run(5.0)
        spins = [rig.data.qvel[rig.model.jnt_dofadr[joint]] for joint in rear]
        assert spins == pytest.approx([sign * 20.0] * 2, rel=0.02)
        assert [rig.data.qfrc_actuator[rig.model.jnt_dofadr[joint]] for joint in rear] == pytest.approx(
            [0, 0]
        )


# All of them on slopes and on their backs


def creep(rig):
    """How far it creeps in 10 s [m], and root mean squares of its speed [m/s] and turning rate [rad/s]."""
    start = rig.data.qpos[:3].copy()
    log = rig.run(10.0)
    speeds = (math.sqrt((log[:, part] ** 2).sum(1).mean()) for part in (slice(3, 6), slice(6, 9)))
    return np.linalg.norm(log[-1, :3] - start), *speeds


@pytest.mark.every_run("0-ATRVJr", "40-Zerg", "90-Hummer")
@every
@pytest.mark.parametrize("yaw", [0, 40, 90, 180])
def test_it_holds_still_on_ten_degrees(name, yaw):
    rig = Rig(name, places=((0.0, 0.0, math.radians(yaw)),), tilt=math.radians(10))
    rig.run(1.0)
    way, speed, rate = creep(rig)
    assert way < 0.01
    assert speed < 1e-3
    assert math.degrees(rate) < 0.2


@pytest.mark.every_run("Sedan")
@car
def test_a_car_that_was_driven_stops_and_holds_on_ten_degrees(name):
    """Speed 0 brakes all four wheels, powered or not."""
    rig = Rig(name, tilt=math.radians(10)).tell(Speed=10.0)
    rig.run(2.0)
    rig.tell(Speed=0.0)
    rig.run(4.0)
    way, speed, _ = creep(rig)
    assert way < 0.01
    assert speed < 1e-3


# What they carry

EQUIPMENT = {  # manual 12.2, 12.4 to 12.8, 12.11 and 12.16 to 12.18; pose sensors besides
    "StereoP2AT": {"Sonar": 16, "RangeScanner": 1, "RFID": 1},
    "ATRVJr": {"Sonar": 17, "RangeScanner": 1},
    "Zerg": {},
    "Kurt2D": {"RangeScanner": 1, "Encoder": 2, "Sonar": 1, "IR": 7},
    "Kurt3D": {"RangeScanner": 1, "Encoder": 2, "Sonar": 1, "IR": 7},
    "Lisa": {"Encoder": 2},
    "Hummer": {"RangeScanner": 1},
    "SnowStorm": {"RangeScanner3D": 1, "GPS": 1},
    "Sedan": {},
    "Cooper": {},
}
CAMERAS = {"StereoP2AT": 2, "ATRVJr": 1, "Zerg": 1, "Kurt2D": 1, "Kurt3D": 2, "Hummer": 1, "SnowStorm": 2}


@every
def test_it_has_the_manuals_equipment_and_its_sensors_can_be_built(name):
    robot = ROBOTS.get(name)
    counts = {}
    for sensor in suite_of(robot).sensors:
        counts[sensor.kind] = counts.get(sensor.kind, 0) + len(sensor.mounts)
    chosen = {"INS": 1, "GroundTruth": 1} | ({} if name == "Lisa" else {"Odometry": 1})
    assert counts == EQUIPMENT[name] | chosen
    assert len(robot.cameras) == CAMERAS.get(name, 0)


def test_atrvjr_sonars_mirror_each_other():
    """Manual 12.4.1: five ahead, then down the right side, two behind, up the left side."""
    mounts = [mount for mount in ROBOTS.get("ATRVJr").sensors if mount.kind == "Sonar"]
    places = [(*mount.at[:2], math.degrees(mount.direction[2])) for mount in mounts]
    assert [mount.name for mount in mounts] == [f"S{i}" for i in range(1, 18)]
    for i, j in [(0, 4), (1, 3), (10, 11), *((k, 21 - k) for k in range(5, 10))]:
        x, y, yaw = places[i]
        assert places[j] == pytest.approx((x, -y, -yaw))
    assert places[2] == pytest.approx((0.34706, 0.0, 0.0))
    assert places[5] == pytest.approx((0.23023, 0.175, 45.0))
    assert all(abs(math.radians(yaw)) > math.pi / 4 - 1e-9 for _, y, yaw in places if abs(y) > 0.15)


def test_the_stereo_p2at_is_a_p2at_with_eyes_ten_centimetres_apart():
    """Manual 3.2.6.2: stereoSpacing=(Y=0.05), half the distance."""
    stereo, plain = ROBOTS.get("StereoP2AT"), ROBOTS.get("P2AT")
    left, right = stereo.cameras
    assert right.at[1] - left.at[1] == pytest.approx(0.10)
    assert left.parent == right.parent == plain.cameras[0].parent
    assert np.mean([left.at, right.at], 0) == pytest.approx(plain.cameras[0].at)
    same = replace(stereo, name="P2AT", cameras=plain.cameras, sources=plain.sources, looks=plain.looks)
    assert same == plain


def test_kurt3d_turns_its_scanner_up_and_down():
    """Manual 12.17: DRIVE {Name ScannerSides} {Value angle}; as the pitch that it reports, positive is up."""
    rig = Rig("Kurt3D")
    (scanner,) = (mount for mount in rig.robot.sensors if mount.kind == "RangeScanner")
    assert scanner.parent == "ScannerSides"
    for angle in (0.5, -0.8):
        rig.move({"ScannerSides": angle})
        rig.run(3.0)
        assert rig.joint("ScannerSides") == pytest.approx(angle, abs=0.01)
        ahead = rig.mat("ScannerSides")[:, 0]
        assert ahead == pytest.approx([math.cos(angle), 0.0, math.sin(angle)], abs=0.02)  # z up
    assert rig.up[0] > 0.9999


def test_all_together_are_a_scene_for_every_engine():
    """MJX-JAX has no reliable contacts of round things with each other; two of a kind meet themselves."""
    scene = build_scene(FLAT, [RosterEntry(robot=name, parked=True) for name in (*ALL, *ALL, "P2DX")])
    for engine in ("jax", "warp"):
        check_features(scene.model, engine)


def test_skid_steered_robots_have_left_and_right():
    for name in SKID:
        drive = ROBOTS.get(name).drive
        assert isinstance(drive, SkidSteer)
        assert {*drive.left, *drive.right} == {wheel.name for wheel in ROBOTS.get(name).wheels}
        assert all(wheel.startswith("Left") for wheel in drive.left)
