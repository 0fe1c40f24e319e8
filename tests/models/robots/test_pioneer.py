"""P2AT and P2DX as composed, against the manual, captured messages and USARBot.ini."""

import math
import pickle
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from usarmjx.base.transforms import flip_vector
from usarmjx.models.compile.compose import add_robot, index_robot, new_spec, remove_robot
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.parts import link_frames
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots.pioneer import P2AT, P2DX
from usarmjx.models.types.arena import ArenaSpec

ROBOTS = [P2AT, P2DX]
NOWHERE = ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0)))
EXACT = 1e-9  # float64 in the compiled model
SINK = 1e-3  # m: how deep MuJoCo's soft contacts let a robot of 14 kg sink at rest
ANGLE_ATOL = math.radians(0.11)  # the manual gives whole degrees, the ini's 0.8744 lies 0.1 off 50

# Manual 12.1.1: X [mm], Y [mm], theta [deg], F1..F8 and R1..R8.
P2AT_RINGS = [
    (145, -130, -90), (185, -115, -50), (220, -80, -30), (240, -25, -10),
    (240, 25, 10), (220, 80, 30), (185, 115, 50), (145, 130, 90),
    (-145, 130, 90), (-185, 115, 130), (-220, 80, 150), (-240, 25, 170),
    (-240, -25, -170), (-220, -80, -150), (-185, -115, -130), (-145, -130, -90),
]  # fmt: skip
# UsarCommander's SonarSensor.vb, from USARBot.ini (the manual's table names F1 twice): x [mm] of F1..F8.
P2DX_RING_X = [115, 155, 190, 210, 210, 190, 155, 115]


@pytest.fixture(scope="module", params=ROBOTS, ids=lambda robot: robot.name)
def stand(request):
    """A robot on a bare floor: description, model, data at the manual's height."""
    robot = request.param
    spec = new_spec(NOWHERE, Physics())
    add_robot(spec, robot, "it/", (0.0, 0.0, robot.origin_height))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return robot, model, data


def rings(robot):
    found = [mount for mount in robot.sensors if mount.kind == "Sonar"]
    assert all(mount.parent == "HARD" for mount in found)
    return found


@pytest.mark.parametrize(("robot", "mass"), [(P2AT, 14.0), (P2DX, 9.0)])
def test_mass_is_the_manuals(robot, mass):
    spec = new_spec(NOWHERE, Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 1.0))
    model = spec.compile()
    assert model.body("chassis").subtreemass[0] == pytest.approx(mass, abs=EXACT)
    assert robot.mass == mass


def test_p2at_geometry_is_the_captured_one():
    assert (P2AT.wheel_radius, P2AT.wheel_separation, P2AT.wheel_base) == (0.1300, 0.4712, 0.2884)
    assert P2AT.dimensions == (0.5238, 0.4968, 0.2913)


def test_reported_geometry_is_the_built_one(stand):
    robot, model, data = stand
    at = np.array([data.body(f"it/{wheel.name}").xpos for wheel in robot.wheels])
    left = np.array([wheel.name in robot.drive.left for wheel in robot.wheels])
    assert np.ptp(at[:, 0]) == pytest.approx(robot.wheel_base, abs=EXACT)
    assert at[left, 1] == pytest.approx(robot.wheel_separation / 2, abs=EXACT)  # ours: y to the left
    assert at[~left, 1] == pytest.approx(-robot.wheel_separation / 2, abs=EXACT)
    assert {wheel.shapes[0].size[0] for wheel in robot.wheels} == {robot.wheel_radius}
    assert all(wheel.name.startswith("Left") == (wheel.name in robot.drive.left) for wheel in robot.wheels)
    for wheel in robot.wheels:
        geom = model.geom(f"it/{wheel.name}/0")
        assert geom.type[0] == mujoco.mjtGeom.mjGEOM_CYLINDER
        assert geom.size[0] == robot.wheel_radius


def test_deck_has_the_reported_length_and_width(stand):
    """The rest does not: the captured wheel base and radius make the P2AT 2.5 cm longer than captured."""
    robot, model, data = stand
    hull = [model.geom("it/chassis/1").id]
    ends = np.array([data.geom_xpos[hull] + model.geom_size[hull] * s for s in (-1, 1)])
    length, width, _ = np.ptp(ends.reshape(-1, 3), axis=0)
    assert length == pytest.approx(robot.dimensions[0], abs=EXACT)
    assert width == pytest.approx(robot.dimensions[1], abs=EXACT)
    for wheel in robot.wheels:
        outer = abs(wheel.at[1]) + wheel.shapes[0].size[1]
        assert outer == pytest.approx(robot.dimensions[1] / 2, abs=EXACT)


def test_all_wheels_stand_on_the_ground(stand):
    robot, model, data = stand
    for wheel in robot.wheels:
        assert data.body(f"it/{wheel.name}").xpos[2] == pytest.approx(robot.wheel_radius, abs=EXACT)
    sphere = model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    casters = np.flatnonzero(sphere & (model.geom_contype > 0))
    assert len(casters) == (robot is P2DX)
    for g in casters:
        assert data.geom_xpos[g, 2] == pytest.approx(model.geom_size[g, 0], abs=EXACT)


def test_at_rest_only_wheels_and_caster_touch_and_only_the_floor(stand):
    robot, model, _ = stand
    data = mujoco.MjData(model)
    for _ in range(200):
        mujoco.mj_step(model, data)
    touching = [frozenset(int(g) for g in pair) for pair in data.contact.geom]
    assert all(0 in pair for pair in touching)  # geom 0 is the floor
    feet = {model.geom(max(pair)).name for pair in touching}
    expected = {f"it/{wheel.name}/0" for wheel in robot.wheels}
    assert feet == (expected | {"it/chassis/2"} if robot is P2DX else expected)
    assert data.body("it/chassis").xpos[2] == pytest.approx(robot.origin_height, abs=SINK)
    up = data.body("it/chassis").xmat.reshape(3, 3)[2, 2]
    assert up == pytest.approx(1.0, abs=1e-4)  # 0.8 degrees


def test_no_part_of_a_robot_collides_with_itself_in_any_camera_position(stand):
    robot, model, _ = stand
    data = mujoco.MjData(model)
    index = index_robot(model, robot, "it/")
    for pan in np.linspace(-math.pi, math.pi, 13):
        for tilt in (-0.16, 0.0, 0.40):
            mujoco.mj_resetData(model, data)
            data.qpos[index.root_qposadr + 2] = 1.0  # away from the floor
            data.qpos[list(index.qposadr)[-2:]] = pan, tilt
            mujoco.mj_forward(model, data)
            assert data.ncon == 0


def test_a_positive_wheel_angle_rolls_forward(stand):
    robot, model, _ = stand
    data = mujoco.MjData(model)
    for wheel in robot.wheels:
        # The wheel's contact point must move backwards for the robot to go ahead.
        axis = model.joint(f"it/{wheel.name}").axis
        assert np.cross(axis, [0, 0, -robot.wheel_radius])[0] < 0
    data.act[:] = 0
    index = index_robot(model, robot, "it/")
    data.ctrl[list(index.hold_actuator_ids)] = 1.0
    data.ctrl[list(index.actuator_ids)[: len(robot.wheels)]] = 2.0
    for _ in range(200):
        mujoco.mj_step(model, data)
    assert data.body("it/chassis").xpos[0] > 0.5 * 2.0 * robot.wheel_radius  # a second's way, less start
    assert abs(data.body("it/chassis").xpos[1]) < 0.01


def test_p2at_sonar_rings_are_the_manuals_table():
    mounts = rings(P2AT)
    assert [m.name for m in mounts] == [f"{r}{i}" for r in "FR" for i in range(1, 9)]
    for mount, (x, y, theta) in zip(mounts, P2AT_RINGS, strict=True):
        assert mount.at == pytest.approx((x / 1000, y / 1000, 0.0), abs=EXACT)
        assert mount.direction == pytest.approx((0, 0, math.radians(theta)), abs=ANGLE_ATOL)


def test_p2dx_sonar_ring_is_that_of_the_ini():
    mounts = rings(P2DX)
    assert [m.name for m in mounts] == [f"F{i}" for i in range(1, 9)]
    for mount, x, (_, y, theta) in zip(mounts, P2DX_RING_X, P2AT_RINGS[:8], strict=True):
        assert mount.at == pytest.approx((x / 1000, y / 1000, 0.0), abs=EXACT)
        assert mount.direction == pytest.approx((0, 0, math.radians(theta)), abs=ANGLE_ATOL)


def test_camera_axes_follow_from_the_manuals_orientations():
    """Manual 9.3: link 1 is rolled by pi, link 2 by another pi/2; joints turn about the link's z.

    In the wire's axes (z down) the first z points up, so a positive pan is counter-clockwise seen from
    above; rolled on by a quarter, the second z points to the right, and a right-handed turn about it
    carries forward (x) to up (-z).
    """
    frames = link_frames(P2AT.packages[0])
    np.testing.assert_allclose(frames[1][1][:, 2], [0, 0, -1], atol=EXACT)
    np.testing.assert_allclose(frames[2][1][:, 2], [0, 1, 0], atol=EXACT)
    assert flip_vector(tuple(frames[1][1][:, 2])) == pytest.approx((0, 0, 1), abs=EXACT)


@pytest.mark.parametrize(
    ("pan", "tilt", "looks"),
    [
        (0.0, 0.0, (1, 0, 0)),
        (math.pi / 2, 0.0, (0, 1, 0)),  # left
        (-math.pi / 2, 0.0, (0, -1, 0)),  # right
        (0.0, 0.4, (math.cos(0.4), 0, math.sin(0.4))),  # up
        (0.0, -0.16, (math.cos(0.16), 0, -math.sin(0.16))),  # down
        (math.pi / 2, 0.4, (0, math.cos(0.4), math.sin(0.4))),  # the tilt axis turns with the pan
    ],
)
def test_camera_pans_left_and_tilts_up(stand, pan, tilt, looks):
    _, model, _ = stand
    data = mujoco.MjData(model)
    data.joint("it/CameraPanTilt_Link1").qpos = pan
    data.joint("it/CameraPanTilt_Link2").qpos = tilt
    mujoco.mj_kinematics(model, data)
    head = data.body("it/CameraPanTilt_Link2").xmat.reshape(3, 3)
    np.testing.assert_allclose(head[:, 0], looks, atol=EXACT)


def test_camera_head_sits_where_the_captured_frames_put_it():
    spec = new_spec(NOWHERE, Physics())
    add_robot(spec, P2AT, "", (0.0, 0.0, 0.0))
    data = mujoco.MjData(spec.compile())
    mujoco.mj_kinematics(data.model, data)
    # Wire: pan at 0.1239,0,-0.2036; tilt 0.0599 along the pan's z, which points up.
    np.testing.assert_allclose(data.body("CameraPanTilt_Link1").xpos, [0.1239, 0, 0.2036], atol=EXACT)
    np.testing.assert_allclose(data.body("CameraPanTilt_Link2").xpos, [0.1239, 0, 0.2635], atol=EXACT)


def test_parts_are_named_as_on_the_wire():
    parts = kinematic_tree_of(P2AT).parts
    wheels = ("LeftFWheel", "RightFWheel", "LeftRWheel", "RightRWheel")
    assert parts == ("HARD", *wheels, "CameraPanTilt_Link1", "CameraPanTilt_Link2")


def test_a_removed_robot_leaves_no_trace():
    spec = new_spec(NOWHERE, Physics())
    add_robot(spec, P2AT, "a/", (0.0, 0.0, 0.3))
    before = spec.compile()
    sizes = (before.nq, before.nv, before.nu, before.na, before.ngeom, before.nexclude)
    add_robot(spec, P2DX, "b/", (2.0, 0.0, 0.3))
    assert spec.compile().nq > before.nq
    remove_robot(spec, "b/")
    after = spec.compile()
    assert (after.nq, after.nv, after.nu, after.na, after.ngeom, after.nexclude) == sizes
    assert kinematic_tree_of(P2AT).clearance == pytest.approx(0.26)


def test_a_robot_is_hashed_once_and_its_hash_stays_in_its_process():
    known = hash(P2AT)
    other = pickle.loads(pickle.dumps(P2AT))
    assert "_hash" not in vars(other)
    assert (other, hash(other)) == (P2AT, known)
    assert hash(replace(P2AT, name="Other")) != known
