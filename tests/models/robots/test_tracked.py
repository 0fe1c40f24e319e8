"""The tracked robots as built and as they drive, climb and reach, against manual 12 and closed forms."""

import math

import numpy as np
import pytest

from tests.climb import FOLDED, NEAR, Climb, flippers, stairs, step
from tests.rig import PERIOD, Rig, steady_speed, steady_spin
from usarmjx.base.transforms import flip_vector, mat_from_angles
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.parts import joint_names, parts_of
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.flippers import kenaf, tarantula
from usarmjx.models.robots.soryu import soryu
from usarmjx.models.robots.talon import rugbot, talon
from usarmjx.models.robots.telemax import L3, L4, L5, L6, L7, telemax

NAMES = ("Tarantula", "Talon", "Soryu", "TeleMax", "Rugbot", "Kenaf")
FLIPPERED = ("Tarantula", "TeleMax", "Kenaf")
EVERY = pytest.mark.parametrize("name", NAMES)
WITH_FLIPPERS = pytest.mark.parametrize("name", FLIPPERED)
EXACT = 1e-6  # float32 arrays of the body plan
SINK = 1e-3  # m: how deep MuJoCo's soft contacts let a robot sink
ARM_UP = {"TeleMaxArm_Link2": 2.0, "TeleMaxArm_Link4": -2.0}  # manual 12.19.1: the initial pose


def poised(name, pose):
    """A pose of the flippers, and of the TeleMax's arm, which else would reach over the obstacle."""
    return {**pose, **(ARM_UP if name == "TeleMax" else {})}


# As built

# Manual 12.10, 12.12, 12.15, 12.19, 12.22, 12.23: length, width, height [m]; mass where it is given [kg].
MANUAL = {
    "Tarantula": ((0.6778, 0.444, 0.1406), None),
    "Talon": ((0.9117, 0.5903, 0.3654), 34.0),
    "Soryu": ((1.21, 0.122, 0.145), 10.0),
    "TeleMax": ((0.80, 0.40, 0.75), None),
    "Rugbot": ((0.385, 0.255, 0.270), 34.0),
    "Kenaf": ((0.937, 0.429, 0.259), 20.0),
}


def track_extent(robot, axis):
    """Extent of the robot's wheels at rest, along x (0) or y (1) [m]."""
    plan = kinematic_tree_of(robot)
    where = {part: plan.rest_pos[i][axis] for i, part in enumerate(plan.parts)}
    half = [(where[w.name], w.shapes[0].size[0 if axis == 0 else 1]) for w in robot.wheels]
    return max(x + r for x, r in half) - min(x - r for x, r in half)


@EVERY
def test_dimensions_and_mass_are_the_manuals(name):
    robot, (dimensions, mass) = ROBOTS.get(name), MANUAL[name]
    assert robot.dimensions == dimensions
    assert mass is None or robot.mass == mass
    assert kinematic_tree_of(robot).mass == pytest.approx(robot.mass, abs=1e-9), "as reported, so built"
    assert kinematic_tree_of(robot).clearance == pytest.approx(robot.origin_height, abs=EXACT)
    assert track_extent(robot, 1) == pytest.approx(dimensions[1], abs=EXACT), "its tracks are its width"


@EVERY
def test_tracks_reach_as_far_as_the_robot_is_long(name):
    robot = ROBOTS.get(name)
    length = robot.dimensions[0]
    if name == "TeleMax":  # stowed: without what points up then
        base = [p for p in robot.wheels if p.parent == "HARD"]
        assert 2 * max(p.at[0] + p.shapes[0].size[0] for p in base) == pytest.approx(length)
    else:
        assert track_extent(robot, 0) == pytest.approx(length, abs=EXACT)


@EVERY
def test_wheel_names_say_which_is_in_front_and_the_drive_has_them_all(name):
    robot = ROBOTS.get(name)
    plan = kinematic_tree_of(robot)
    at = {part: plan.rest_pos[i] for i, part in enumerate(plan.parts)}
    for side, sign, driven in (("Left", 1, robot.drive.left), ("Right", -1, robot.drive.right)):
        row = {n: at[n][0] for n in driven if n.startswith(side)}
        assert max(row, key=row.get) == f"{side}FWheel"
        assert min(row, key=row.get) == f"{side}RWheel"
        assert all(sign * at[n][1] > 0 for n in driven)
    assert {*robot.drive.left, *robot.drive.right} == {part.name for part in parts_of(robot) if part.is_wheel}


@EVERY
def test_all_wheels_of_a_side_have_one_belt_speed(name):
    robot = ROBOTS.get(name)
    radius = {part.name: part.shapes[0].size[0] for part in robot.wheels}
    spins = robot.drive.targets(np.array([2.0, -1.0], np.float32))
    for aim, spin in zip(robot.drive.joint_controls, spins, strict=True):
        belt = 2.0 if aim.joint in robot.drive.left else -1.0
        assert spin * radius[aim.joint] == pytest.approx(belt * robot.wheel_radius, rel=1e-5)


@pytest.mark.parametrize("build", [tarantula, kenaf, telemax, talon, rugbot, soryu])
def test_the_number_of_wheels_is_a_parameter(build):
    few, many = build(3), build(7)
    assert len(many.wheels) - len(few.wheels) == (6 if build is soryu else 2) * 4
    assert {"LeftFWheel", "LeftWheel2", "LeftRWheel"} <= {wheel.name for wheel in few.wheels}
    assert few.wheel_base == pytest.approx(many.wheel_base)


@WITH_FLIPPERS
def test_flippers_point_outward_and_are_reported(name):
    robot = ROBOTS.get(name)
    assert robot.reported_joints == ("FRFlipper", "FLFlipper", "RRFlipper", "RLFlipper")
    for flipper in robot.reported_joints:
        row = [part for part in robot.parts if part.parent == flipper]
        radii = [part.shapes[0].size[0] for part in row]
        out = 1 if flipper.startswith("F") else -1
        assert radii == sorted(radii, reverse=True)
        assert radii[0] < robot.wheel_radius
        assert np.all(np.diff([0.0, *(out * part.at[0] for part in row)]) > 0)


# Speeds

TOP = {
    "Tarantula": 3.1416 * 0.1406 / 2,  # manual 12.10: rad/s; on wheels as high as the robot
    "Talon": 0.90,  # manual 12.12: 6.43 rad/s x 0.14 m
    "Soryu": 0.37,  # manual 12.15
    "TeleMax": 1.3,  # manual 12.19
    "Rugbot": 6.0 * 0.125,  # manual 12.22
    "Kenaf": 0.55,  # none in 12.23: the wheel joint's default of the UDK version
}
TOP_RTOL = 0.10
# Measured [rad/s]: half of what rigid wheels with Coulomb friction would do, as wheels that slide hop in
# MuJoCo's friction model. The Soryu stands on its middle car: flat on the ground it is too long to turn.
SPIN = {"Tarantula": 0.6, "Talon": 1.1, "Soryu": 1.0, "TeleMax": 1.5, "Rugbot": 2.8, "Kenaf": 0.7}
SPIN_RTOL = 0.4  # it is chaotic; a robot that does not turn, or turns as if on ice, is far off


@pytest.mark.every_run("Talon", "Kenaf")
@EVERY
def test_top_speed(name):
    rig = Rig(name).tell(Left=99.0, Right=99.0)
    assert steady_speed(rig) == pytest.approx(TOP[name], rel=TOP_RTOL)
    assert rig.up[0] > 0.999
    assert abs(rig.data.qpos[1]) < 0.05, "straight ahead"


@pytest.mark.every_run("Talon", "Kenaf")
@EVERY
def test_spins_in_place(name):
    rig = Rig(name)
    if name == "Soryu":
        rig.move({"FrontTilt": 0.5, "RearTilt": 0.5}).run(1.5)
    rig.tell(Left=-99.0, Right=99.0)
    assert steady_spin(rig) == pytest.approx(SPIN[name], rel=SPIN_RTOL)
    assert np.linalg.norm(rig.data.qpos[:2]) < 0.25, "in place, but for a stretched arm's weight"
    no_slip = 2 * rig.robot.drive.top_speed / rig.robot.wheel_separation
    assert steady_spin(rig) < no_slip


@pytest.mark.every_run("0-Talon", "90-Kenaf")
@EVERY
@pytest.mark.parametrize("yaw", [0, 90])
def test_a_robot_at_rest_on_a_slope_stays_where_it_is(name, yaw):
    rig = Rig(name, places=((0.0, 0.0, math.radians(yaw)),), tilt=math.radians(10))
    rig.run(1.0)
    start = rig.data.qpos[:3].copy()
    log = rig.run(10.0)
    assert np.linalg.norm(log[-1, :3] - start) < 0.005
    assert math.sqrt((log[:, 3:6] ** 2).sum(1).mean()) < 1e-3


@pytest.mark.every_run("0-Talon", "1-Kenaf")
@EVERY
@pytest.mark.parametrize("seed", [0, 1])
def test_random_driving_stays_on_the_ground(name, seed):
    """20 s with new wheel speeds every half second; sliding wheels lift a robot by up to 2 cm."""
    rig, random = Rig(name), np.random.default_rng(seed)
    top, fastest, path = rig.robot.drive.max_spin, 0.0, []
    for tick in range(round(20.0 / PERIOD)):
        if tick % 25 == 0:
            left, right = random.uniform(-top, top, 2)
            rig.tell(Left=left, Right=right)
        rig.step()
        fastest = max(fastest, np.linalg.norm(rig.data.qvel[:3]))
        path.append(rig.data.qpos[:3].copy())
        assert rig.up[0] > 0.98
    heights = np.array(path)[:, 2] - rig.plan.clearance
    assert fastest < 2 * rig.robot.drive.top_speed
    assert heights.min() > -4 * SINK
    assert heights.max() < 0.04
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() > rig.robot.drive.top_speed, "it did move"


# Climbing

# Steps [m] climbed with the flippers; without them one of two thirds of that is too high.
STEP = {"Tarantula": 0.14, "TeleMax": 0.26, "Kenaf": 0.26}
PRESS = {"Tarantula": 2.0, "TeleMax": 1.0, "Kenaf": 2.0}  # s after the start, with its nose on the edge


@pytest.mark.every_run("Kenaf")
@WITH_FLIPPERS
def test_flippers_help_up_a_step(name):
    """Nose on the edge, then the front flippers press down on it while the rear ones lift the tail."""
    press = PRESS[name]
    script = ((press, flippers(0.5, -0.9)), (press + 2.0, flippers(0.0, 0.0)))
    climb = Climb(name, step(STEP[name]), pose=poised(name, flippers(-0.6, 0.0)))
    climb.drive(0.5, 4.0 + 3.0 / TOP[name], script)
    assert STEP[name] >= 0.10
    assert climb.on_top(STEP[name])


@pytest.mark.every_run("0.25-Kenaf", "1.0-Tarantula")
@WITH_FLIPPERS
@pytest.mark.parametrize("share", [0.25, 1.0])
def test_without_flippers_a_step_of_two_thirds_is_too_high(name, share):
    for height, expected in ((0.04, True), (STEP[name] / 1.5, False)):
        climb = Climb(name, step(height), pose=poised(name, FOLDED))
        climb.drive(share, 2.0 + 1.0 / (share * TOP[name]))
        assert climb.on_top(height) is expected


RISE, GOING, COUNT = 0.18, 0.257, 6  # 35.0 degrees


def test_the_stairs_are_of_35_degrees():
    assert math.degrees(math.atan(RISE / GOING)) == pytest.approx(35.0, abs=0.1)


# With flippers straight down to the line of the tracks, a long flat underside: tapers of the flippers.
FLAT = {
    "Kenaf": math.asin((0.0875 - 0.04) / 0.2285),
    "TeleMax": math.asin((0.1905 - 0.06) / 0.34),
}


@pytest.mark.every_run("Talon-0.5", "Kenaf-1.0")
@pytest.mark.parametrize(
    ("name", "share"), [("Talon", 0.5), ("Talon", 1.0), ("Kenaf", 1.0), ("TeleMax", 0.3)]
)
def test_climbs_stairs(name, share):
    low = FLAT.get(name, 0.0)
    pose, script = {}, ()
    if name in FLAT:
        pose = flippers(-0.6, 0.0)
        script = (((0.3 if name == "TeleMax" else 0.9) / (share * TOP[name]), flippers(low, -low)),)
    climb = Climb(name, *stairs(COUNT, RISE, GOING), pose=poised(name, pose))
    climb.drive(share, 7.0 / (share * TOP[name]), script)
    assert climb.on_top(COUNT * RISE, NEAR + (COUNT - 1) * GOING)
    assert climb.worst > math.cos(math.radians(55)), "upright all the way"


def test_soryu_lifts_its_front_car_onto_a_step():
    height = 0.30
    climb = Climb("Soryu", step(height), pose={"FrontTilt": 1.0})
    climb.drive(1.0, 4.0, ((2.0, {"FrontTilt": 0.0}),))
    front = [climb.rig.data.body(f"r0/{name}").xpos for name in ("LeftFWheel", "RightFWheel", "LeftWheel4")]
    assert all(x > NEAR for x, _, _ in front)
    radius = climb.rig.robot.wheel_radius
    assert all(abs(z - height - radius) < 0.02 for _, _, z in front[:2]), "they stand on it"


# Joints

HOLD_ATOL = 0.02  # rad


@pytest.mark.every_run("Tarantula")
@WITH_FLIPPERS
def test_flippers_lift_and_lower_the_chassis(name):
    """Manual 12.19: on its tips it stands higher by their lever less the difference of the radii."""
    robot = ROBOTS.get(name)
    tip = [part for part in robot.parts if part.parent == "FRFlipper"][-1]
    rise = tip.at[0] * math.sin(1.5) + tip.shapes[0].size[0] - robot.wheel_radius
    rig = Rig(name)
    rig.run(1.0)
    low = rig.data.qpos[2]
    for front, expected in ((1.5, rise), (-1.5, 0.0)):
        pose = flippers(front, -front)
        rig.move(pose).run(8.0)
        assert rig.data.qpos[2] - low == pytest.approx(expected, abs=0.005)
        assert [rig.joint(j) for j in pose] == pytest.approx(list(pose.values()), abs=HOLD_ATOL)
        assert rig.up[0] > 0.999
    assert rise > 0.14


@WITH_FLIPPERS
def test_negative_in_front_and_positive_behind_is_up(name):
    rig = Rig(name)
    rig.move(flippers(-0.5, 0.5)).run(2.0)
    ends = [part.name for part in rig.robot.parts if part.name.endswith("FlipperWheel1")]
    rise = [rig.data.body(f"r0/{end}").xpos[2] - rig.data.qpos[2] for end in ends]
    reach = [abs(part.at[0]) for part in rig.robot.parts if part.name in ends]
    assert rise == pytest.approx([math.sin(0.5) * r for r in reach], abs=0.005)


def test_kenaf_camera_pans_left_and_tilts_up():
    rig = Rig("Kenaf").move({"kenafCameraPan": 1.0, "kenafCameraTilt": 0.5})
    rig.run(3.0)
    looks = rig.mat("chassis").T @ rig.mat("kenafCameraTilt")[:, 0]
    expected = (math.cos(1.0) * math.cos(0.5), math.sin(1.0) * math.cos(0.5), math.sin(0.5))
    np.testing.assert_allclose(looks, expected, atol=0.02)


def turn_z(angle):
    return mat_from_angles(*np.array([0.0, 0.0, angle]))


def arm_frames(package, joints):
    """Frames of a package's links on the chassis, wire axes: Denavit's way, from the table of links alone."""
    at, mat, frames = np.zeros(3), np.eye(3), []
    for link, q in zip(package.links, joints, strict=True):
        at = at + mat @ link.location
        mat = mat @ mat_from_angles(*np.array(link.orientation))
        if link.joint == "Revolute":
            mat = mat @ turn_z(q)
        else:
            at = at + mat[:, 2] * q
        frames.append((at, mat))
    return frames


def hand(rig, reach):
    """Place, on the chassis, of a point `reach` ahead on the arm's last part; wire axes [m]."""
    last = joint_names(rig.robot)[[n.endswith("Finger") for n in joint_names(rig.robot)].index(True) - 1]
    body, chassis = rig.data.body(f"r0/{last}"), rig.data.body("r0/chassis")
    point = body.xpos + body.xmat.reshape(3, 3)[:, 0] * reach
    return np.array(flip_vector(chassis.xmat.reshape(3, 3).T @ (point - chassis.xpos)))


def test_telemax_arm_stretches_to_the_sum_of_its_lengths():
    frames = arm_frames(ROBOTS.get("TeleMax").packages[0], np.zeros(7))
    tip = frames[6][0] + frames[6][1][:, 2] * L7
    assert tip - frames[1][0] == pytest.approx([L3 + L4 + L5 + L6 + L7, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(
    "pose",
    [
        (0.0, 2.0, 0.0, -2.0, 0.0, 0.0, 0.0),  # manual 12.19.1: the initial pose
        (1.0, 1.2, 0.3, -1.0, 0.5, 0.5, 1.0),
        (math.pi / 2, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0),  # stretched out to the side
    ],
)
def test_telemax_arm_reaches_its_pose(pose):
    rig = Rig("TeleMax")
    names = [f"TeleMaxArm_Link{i}" for i in range(1, 8)]
    rig.move(dict(zip(names, pose, strict=True)))
    rig.run(max(abs(q) for q in pose) / 0.17 + 2.0)
    assert [rig.joint(name) for name in names] == pytest.approx(pose, abs=0.02)
    at, mat = arm_frames(rig.robot.packages[0], pose)[6]
    assert np.linalg.norm(hand(rig, L7) - (at + mat[:, 2] * L7)) < 0.005
    assert rig.up[0] > 0.9999, "it does not tip"


@pytest.mark.parametrize("pose", [(0.7, 0.0, 0.1), (2.0, -1.5, 1.0), (0.0, 0.0, 0.0)])
def test_talon_arm_reaches_its_pose(pose):
    rig = Rig("Talon")
    names = [f"TalonArm_Link{i}" for i in range(1, 4)]
    rig.move(dict(zip(names, pose, strict=True)))
    rig.run(6.0)
    assert [rig.joint(name) for name in names] == pytest.approx(pose, abs=0.01)
    at, mat = arm_frames(rig.robot.packages[0], pose)[2]
    assert np.linalg.norm(hand(rig, 0.1) - (at + mat[:, 2] * 0.1)) < 0.005


def test_a_raised_talon_arm_is_higher():
    frames = arm_frames(ROBOTS.get("Talon").packages[0], (0.7, 0.0, 0.1))
    assert frames[0][0][2] - frames[1][0][2] == pytest.approx(0.45 * math.sin(0.7))


@pytest.mark.parametrize(
    ("name", "pose"),
    [
        *(
            (name, {"FRFlipper": 0.6, "FLFlipper": -0.4, "RRFlipper": -0.7, "RLFlipper": 0.3})
            for name in FLIPPERED
        ),
        ("Soryu", {"FrontPan": 0.3, "FrontTilt": -0.2, "RearPan": -0.25, "RearTilt": 0.15}),
    ],
)
def test_each_of_four_joints_obeys_alone(name, pose):
    """Afloat, so that the ground holds none of them back: servos get there but for a few hundredths."""
    rig = Rig(name, height=1.0)
    rig.model.opt.gravity[:] = 0.0
    rig.move(pose)
    rig.run(4.0)
    assert {joint: rig.joint(joint) for joint in pose} == pytest.approx(pose, abs=0.03)
