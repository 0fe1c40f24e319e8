"""AirRobot and Passarola: speeds, hover, drag, added mass, walls; oracles are the manual and closed forms."""

import math

import mujoco
import numpy as np
import pytest

from tests.rig import Rig
from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.drives.fluid import AIR_DENSITY, added_mass, shape_factors
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import Shape

G = 9.81
SPEED_RTOL = 0.05
HOVER, HOVER_TILT = 0.05, 2.0  # m, degrees
LAMB_RTOL = 0.006  # the tables' ellipsoid is 1.99 times as long as wide, and they have three digits
LAMB = {"k1": 0.209, "k2": 0.702, "k'": 0.240}  # Lamb, Hydrodynamics, 115
DRIFT_RTOL = 0.02  # forces that are held for 20 ms
NOWHERE = ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0)))
HIGH = 100.0  # m: enough to go down for some time


def tilt_of(rig):
    """How far the robots lean [degrees] (robots,)."""
    return np.degrees(np.arccos(np.clip(rig.up, -1, 1)))


def row(count):
    """Places far enough apart for robots that fly some 100 m."""
    return [(0.0, 300.0 * i, 0.0) for i in range(count)]


def motion(rig, robot=0):
    """Speed forward, to the right and up, and turning rate clockwise, by the robot's heading."""
    index = rig.indices[robot]
    mat = rig.data.xmat[index.body_ids[0]].reshape(3, 3)
    dof = slice(index.root_dofadr, index.root_dofadr + 6)
    v, spin = rig.data.qvel[dof][:3], mat @ rig.data.qvel[dof][3:]
    ahead = mat[:2, 0] / np.linalg.norm(mat[:2, 0])
    return np.array([v[:2] @ ahead, v[0] * ahead[1] - v[1] * ahead[0], v[2], -spin[2]])


def positions(rig, seconds):
    """Positions of all robots and how far they lean (steps, robots, 4) [m, degrees]."""
    rows = []
    for _ in range(round(seconds * 50)):
        rig.step()
        at = [rig.data.qpos[index.root_qposadr :][:3] for index in rig.indices]
        rows.append(np.column_stack([at, tilt_of(rig)]))
    return np.array(rows)


def push(rig, velocity, robot=0):
    """Change a robot's velocity at once (6,)."""
    dof = rig.indices[robot].root_dofadr
    rig.data.qvel[dof : dof + 6] += velocity


# What the drives reckon with


def test_added_mass_of_a_prolate_spheroid_is_that_of_lambs_table():
    along, about = added_mass((2.0, 1.0, 1.0))
    assert along == pytest.approx([LAMB["k1"], LAMB["k2"], LAMB["k2"]], rel=LAMB_RTOL)
    assert about == pytest.approx([0.0, LAMB["k'"], LAMB["k'"]], rel=LAMB_RTOL)


def test_added_mass_of_a_sphere_is_half_of_what_it_displaces():
    along, about = added_mass((0.7, 0.7, 0.7))
    assert along == pytest.approx([0.5] * 3, abs=1e-9)
    assert not about.any()


def test_added_mass_of_a_long_rod_across_the_flow_is_that_of_a_cylinder():
    """Per length an elliptic cylinder of half axes b, c drags along pi rho b^2 when it moves along c."""
    along, _ = added_mass((50.0, 1.0, 2.0))
    assert along[1:] == pytest.approx([2.0, 0.5], rel=0.01)


@pytest.mark.parametrize("radii", [(2.0, 1.0, 1.0), (3.27, 0.57, 1.0), (0.2, 5.0, 1.0)])
def test_shape_factors_add_up_to_two(radii):
    assert shape_factors(radii).sum() == pytest.approx(2.0, abs=1e-8)


@pytest.mark.parametrize("name", ["AirRobot", "Passarola", "Submarine"])
def test_mass_inertia_and_centre_of_gravity_are_those_of_the_built_model(name):
    robot = ROBOTS.get(name)
    figures = getattr(robot.drive, "hull", robot.drive)
    spec = new_spec(NOWHERE, Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    chassis = model.body("chassis").id
    middle, inertia = data.subtree_com[chassis], np.zeros((3, 3))
    for body in range(chassis, model.nbody):
        mat, arm = data.ximat[body].reshape(3, 3), data.xipos[body] - middle
        inertia += mat @ np.diag(model.body_inertia[body]) @ mat.T
        inertia += model.body_mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    assert model.body_subtreemass[chassis] == pytest.approx(robot.mass, rel=1e-6)
    assert figures.mass == robot.mass
    assert np.diag(inertia) == pytest.approx(figures.inertia, rel=0.01)
    # Forces act at the chassis' own centre of gravity: it is on the axis of the whole robot's.
    assert data.xipos[chassis][:2] == pytest.approx([0, 0], abs=1e-5)
    assert middle[:2] == pytest.approx([0, 0], abs=1e-5)


# AirRobot


@pytest.mark.parametrize("name", ["AirRobot", "Passarola"])
def test_a_flyer_starts_on_the_ground_and_stays_there(name):
    rig = Rig(name)
    start = rig.data.qpos[:3].copy()
    assert start[2] == pytest.approx(rig.robot.origin_height, abs=0.005)
    assert np.abs(rig.run(10.0)[-1, :3] - start).max() < 0.005


def test_airrobot_hovers_for_a_minute_undisturbed_after_a_command_and_after_a_push():
    rig = Rig("AirRobot", places=row(3), height=HIGH)
    rig.tell(robot=1, LinearVelocity=5.0, LateralVelocity=-5.0, RotationalVelocity=1.0)
    rig.run(5.0)
    rig.tell(robot=1, LinearVelocity=0.0, LateralVelocity=0.0, RotationalVelocity=0.0)
    push(rig, [3.0, 1.0, -1.0, 4.0, -3.0, 2.0], robot=2)
    rig.run(6.0)  # to come to rest: 7 m/s at 4.6 m/s2, then a lag of 0.5 s
    log = positions(rig, 60.0)
    assert np.abs(log[:, :, :3] - log[0, :, :3]).max() < HOVER
    assert log[:, :, 3].max() < HOVER_TILT


COMMANDS = [
    {"LinearVelocity": 5.0},
    {"LinearVelocity": -3.0},
    {"LateralVelocity": 5.0},
    {"AltitudeVelocity": 5.0},
    {"AltitudeVelocity": -5.0},
    {"RotationalVelocity": 1.5708},
    {"LinearVelocity": 2.0, "RotationalVelocity": -0.5},
    {"LinearVelocity": 5.0, "LateralVelocity": -5.0, "AltitudeVelocity": 5.0},
    {"LinearVelocity": 5.0, "LateralVelocity": 5.0, "AltitudeVelocity": 5.0, "RotationalVelocity": 1.5708},
    {"LinearVelocity": 5.0, "LateralVelocity": -5.0, "AltitudeVelocity": -5.0, "RotationalVelocity": -1.5708},
]


def test_airrobot_follows_every_velocity_to_its_limit_and_all_at_once():
    """Manual 12.20: 5 m/s up, forward, sideways; 1.5708 rad/s. Signs: up, forward, right, clockwise."""
    names = ("LinearVelocity", "LateralVelocity", "AltitudeVelocity", "RotationalVelocity")
    limits = ROBOTS.get("AirRobot").drive.full_scale
    rig = Rig("AirRobot", places=row(len(COMMANDS)), height=HIGH)
    for i, command in enumerate(COMMANDS):
        rig.tell(robot=i, **command)
    rig.run(14.0)  # all at once, going down, takes some time to settle
    for i, command in enumerate(COMMANDS):
        expected = [command.get(name, 0.0) for name in names]
        slack = [SPEED_RTOL * max(abs(v), 0.2 * limits[n]) for n, v in zip(names, expected, strict=True)]
        assert (np.abs(motion(rig, i) - expected) < slack).all(), (command, motion(rig, i))


def test_airrobot_holds_a_velocity_until_the_next_drive_and_clips_it():
    rig = Rig("AirRobot", height=HIGH).tell(LinearVelocity=2.0)
    rig.run(3.0)
    rig.tell(AltitudeVelocity=99.0)
    rig.run(4.0)
    assert motion(rig) == pytest.approx([2.0, 0.0, 5.0, 0.0], abs=0.05)


def test_airrobot_keeps_its_height_when_it_turns_back_at_full_speed():
    rig = Rig("AirRobot", height=HIGH).tell(LinearVelocity=5.0)
    rig.run(4.0)
    rig.tell(LinearVelocity=-5.0)
    assert np.abs(rig.run(6.0)[:, 2] - HIGH).max() < HOVER


def test_airrobot_without_power_falls_as_a_plate_does():
    """With quadratic drag v = v1 tanh(g t / v1), where the terminal speed v1 has drag equal to weight."""
    rig = Rig("AirRobot", height=HIGH)
    rig.powered = False
    terminal = math.sqrt(2 * 1.0 * G / (AIR_DENSITY * rig.robot.drive.drag_areas[2]))
    log = rig.run(8.0)[:, 5]
    for seconds in (0.5, 1.0, 2.0):
        expected = terminal * math.tanh(G * seconds / terminal)
        assert -log[round(seconds * 50) - 1] == pytest.approx(expected, rel=0.01)
    assert -log[-1] == pytest.approx(terminal, rel=1e-3)


@pytest.mark.every_run("0.0-command0", "0.7-command1")
@pytest.mark.parametrize("command", [{"LinearVelocity": 5.0}, {"LateralVelocity": -5.0}])
@pytest.mark.parametrize("askew", [0.0, 0.7])
def test_airrobot_flies_into_a_wall_stays_up_and_leaves(command, askew):
    wall = Shape(kind="box", size=(0.1, 20.0, 5.0), at=(6.0, 0.0, 5.0), surface="wall")
    yaw = askew - (math.pi / 2 if "LateralVelocity" in command else 0.0)
    rig = Rig("AirRobot", wall, places=((0.0, 0.0, yaw),), height=3.0).tell(**command)
    log = rig.run(8.0)
    assert 5.2 < log[-1, 0] < 5.9, "it is at the wall"
    assert log[:, 0].max() < 5.9
    assert np.abs(log[:, 2] - 3.0).max() < 0.5, "neither climbs nor falls"
    assert tilt_of(rig)[0] < 45, "it leans on it"
    rig.tell(**{key: -value for key, value in command.items()})
    assert rig.run(3.0)[-1, 0] < 0.0
    rig.tell(**dict.fromkeys(command, 0.0))
    rig.run(4.0)
    log = positions(rig, 5.0)
    assert np.ptp(log[:, 0, :3], axis=0).max() < HOVER
    assert log[:, 0, 3].max() < HOVER_TILT


def test_airrobot_lands_takes_off_and_gets_up_from_its_back():
    rig = Rig("AirRobot", height=2.0).tell(AltitudeVelocity=-2.0)
    rig.run(3.0)
    assert rig.data.qpos[2] == pytest.approx(rig.robot.origin_height, abs=0.005)
    rig.tell(AltitudeVelocity=1.0)
    assert rig.run(3.0)[-1, 2] > 2.0
    rig = Rig("AirRobot", roll=math.pi)
    assert rig.up[0] == pytest.approx(-1.0)
    rig.tell(AltitudeVelocity=1.0)
    rig.run(4.0)
    assert tilt_of(rig)[0] < HOVER_TILT
    assert rig.data.qpos[2] > 1.0


@pytest.mark.parametrize("name", ["AirRobot", "Passarola"])
def test_the_camera_only_tilts_and_looks_down_for_a_positive_angle(name):
    rig = Rig(name, height=5.0).move({"CameraPanTilt_Link1": 1.2})
    tilts = positions(rig, 1.2 / 0.17 + 2.0)[:, 0, 3]  # at the captured 0.17 rad/s
    axis = rig.mat("chassis").T @ rig.mat("CameraPanTilt_Link1")[:, 0]
    assert axis == pytest.approx([math.cos(1.2), 0.0, -math.sin(1.2)], abs=0.01)  # z up
    assert tilts.max() < 0.1, "and does not shake the robot"


# Passarola


def test_passarola_at_rest_weighs_nothing():
    """Its lift is its weight: nothing moves it but the rounding of forces, some 1e-7 of its weight."""
    rig = Rig("Passarola", height=HIGH)
    for powered in (True, False):
        rig.powered = powered
        log = rig.run(30.0)
        assert np.abs(log[-1, :3] - (0, 0, HIGH)).max() < 0.01
        assert tilt_of(rig)[0] < 0.1


BLIMP_COMMANDS = [
    ({"ThrustPropeller": 2.0}, (2.0, 0.0, 0.0)),
    ({"ThrustPropeller": -1.0}, (-1.0, 0.0, 0.0)),
    ({"ThrustPropeller": 2.0, "XZAngle": math.pi / 2}, (0.0, 2.0, 0.0)),
    ({"ThrustPropeller": 2.0, "XZAngle": -math.pi / 2}, (0.0, -2.0, 0.0)),
    ({"ThrustPropeller": 1.0, "XZAngle": 0.5}, (math.cos(0.5), math.sin(0.5), 0.0)),
    ({"TailPropeller": -0.3}, (0.0, 0.0, 0.3)),  # manual 12.21.3: 0.3 rad/s to the right
    ({"TailPropeller": 1.0}, (0.0, 0.0, -1.0)),
    # The keys of all that flies (manual 9.4), one command setting some of them after another.
    ({"AltitudeVelocity": 1.0, "LinearVelocity": -1.0, "LateralVelocity": 0.0}, (-1.0, 1.0, 0.0)),
    ({"RotationalVelocity": 0.3}, (0.0, 0.0, 0.3)),
    ({"AltitudeVelocity": -1.0}, (0.0, -1.0, 0.0)),
]


def test_passarola_keeps_what_an_aerial_command_leaves_out():
    rig = Rig("Passarola")
    told = [
        ({"LinearVelocity": 1.0}, (0.0, 1.0, 0.0)),
        ({"AltitudeVelocity": 1.0, "RotationalVelocity": 0.5}, (math.pi / 4, math.sqrt(2.0), -0.5)),
        ({"LinearVelocity": -1.0}, (-math.pi / 4, -math.sqrt(2.0), -0.5)),
        ({"LateralVelocity": 3.0}, (-math.pi / 4, -math.sqrt(2.0), -0.5)),  # it cannot
        ({"AltitudeVelocity": 9.0, "LinearVelocity": 0.0}, (math.pi / 2, 2.0, -0.5)),  # held to 2 m/s
        ({"AltitudeVelocity": 0.0, "RotationalVelocity": 0.0}, (math.pi / 2, 0.0, 0.0)),
    ]
    for command, setpoint in told:
        rig.tell(**command)
        assert rig.commands[0].setpoint.tolist() == pytest.approx(setpoint, abs=1e-6), command


def test_passarola_limits_each_key_by_itself():
    """Manual 9.4, 12.21: 2 m/s ahead and 2 m/s up, each for itself, as of an AirRobot."""
    commands = [
        ({"LinearVelocity": 100.0, "AltitudeVelocity": 0.3}, (2.0, 0.3, 0.0)),
        ({"LinearVelocity": -0.5, "AltitudeVelocity": -100.0}, (-0.5, -2.0, 0.0)),
        ({"LinearVelocity": 100.0, "AltitudeVelocity": 100.0}, (2.0, 2.0, 0.0)),
        ({"ThrustPropeller": 100.0, "XZAngle": 0.5}, (2 * math.cos(0.5), 2 * math.sin(0.5), 0.0)),
        ({"LinearVelocity": 1.0, "RotationalVelocity": 100.0}, (None, 0.0, 1.0)),
    ]
    rig = Rig("Passarola", places=row(len(commands)), height=HIGH)
    for i, (command, _) in enumerate(commands):
        rig.tell(robot=i, **command)
    rig.run(15.0)
    for i, (command, (forward, up, right)) in enumerate(commands):
        ahead, _, rise, turn = motion(rig, i)
        assert (rise, turn) == pytest.approx((up, right), rel=0.02, abs=0.02), command
        assert forward is None or ahead == pytest.approx(forward, rel=0.02, abs=0.02), command


def test_passarola_gets_the_speeds_that_it_is_asked_for_and_stops():
    """Manual 12.21: 2 m/s forward and up, 1 rad/s; positive angles of the thrusters send it up."""
    rig = Rig("Passarola", places=row(len(BLIMP_COMMANDS)), height=HIGH)
    for i, (command, _) in enumerate(BLIMP_COMMANDS):
        rig.tell(robot=i, **command)
    rig.run(15.0)
    for i, (command, (forward, up, right)) in enumerate(BLIMP_COMMANDS):
        assert motion(rig, i) == pytest.approx([forward, 0.0, up, right], rel=0.01, abs=0.01), command
        rig.tell(robot=i, ThrustPropeller=0.0, TailPropeller=0.0)
    rig.run(15.0)
    for i in range(len(BLIMP_COMMANDS)):
        assert np.abs(motion(rig, i)).max() < 0.01


@pytest.mark.every_run("1")
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_passarola_without_power_drifts_to_rest_against_quadratic_drag(axis):
    """v = v0 / (1 + v0 k t / m), m being the displaced air's mass with Lamb's added mass, k the drag's."""
    rig = Rig("Passarola", height=HIGH)
    rig.powered = False
    velocity = 2.0 * np.eye(6)[axis]
    push(rig, velocity)
    a, b, c = 2.0, 1.0, 1.0
    area = math.pi * np.array([b * c, a * c, a * b])[axis]
    drag = AIR_DENSITY / 2 * rig.robot.drive.hull.drag[axis] * area
    mass = AIR_DENSITY * 4 / 3 * math.pi * a * b * c * (1 + (LAMB["k2"] if axis else LAMB["k1"]))
    log = rig.run(60.0)[:, 3 + axis]
    for seconds in (5, 20, 60):
        expected = 2.0 / (1 + 2.0 * drag * seconds / mass)
        assert log[50 * seconds - 1] == pytest.approx(expected, rel=DRIFT_RTOL)


def test_passarola_without_power_stops_spinning_and_rights_itself():
    """As above; the drag's moment is that of strips of the ellipsoid, integrated here with a sum."""
    rig = Rig("Passarola", places=row(2), height=HIGH)
    rig.powered = False
    push(rig, [0, 0, 0, 0, 0, 1.0])
    push(rig, [0, 0, 0, 0, 0.3, 0], robot=1)
    x = np.linspace(-2, 2, 4001)
    strips = 2 * np.sqrt(1 - (x / 2) ** 2) * np.abs(x) ** 3
    ends = 2 * 2 * np.sqrt(1 - x[1000:3001] ** 2).clip(0) * np.abs(x[1000:3001]) ** 3 / 2
    drag = rig.robot.drive.hull.drag
    moment = AIR_DENSITY / 2 * (drag[1] * strips.sum() + drag[0] * ends.sum()) * (x[1] - x[0])
    inertia = AIR_DENSITY * 4 / 3 * math.pi * 2 * (4 + 1) / 5 * (1 + LAMB["k'"])
    log = rig.run(20.0)
    assert log[-1, 8] == pytest.approx(1 / (1 + moment * 20 / inertia), rel=DRIFT_RTOL)
    assert tilt_of(rig)[1] < 1.0


@pytest.mark.parametrize("speed", [2.0, -2.0])
def test_passarola_flies_into_a_wall_and_leaves(speed):
    walls = [
        Shape(kind="box", size=(0.1, 20.0, 5.0), at=(side * 8.0, 0.0, 5.0), surface="wall")
        for side in (1, -1)
    ]
    rig = Rig("Passarola", *walls, height=4.0).tell(ThrustPropeller=speed)
    log = rig.run(15.0)
    assert np.abs(log[:, 0]).max() == pytest.approx(8.0 - 0.1 - 2.0, abs=0.1), "half its length before it"
    assert np.abs(log[-1, 3:6]).max() < 0.05
    rig.tell(ThrustPropeller=-speed)
    assert abs(rig.run(4.0)[-1, 0]) < 3.0
    assert tilt_of(rig)[0] < 5.0


def test_passarola_lands_on_its_skids_and_takes_off():
    rig = Rig("Passarola", height=3.0).tell(XZAngle=-math.pi / 2, ThrustPropeller=1.0)
    rig.run(8.0)
    assert rig.data.qpos[2] == pytest.approx(rig.robot.origin_height, abs=0.01)
    assert tilt_of(rig)[0] < 1.0
    rig.tell(XZAngle=0.5, ThrustPropeller=1.0)
    assert rig.run(8.0)[-1, 2] > 3.0
