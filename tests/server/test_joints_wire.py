"""Joints told one by one over the wire: wheels that steer, flippers, grippers, two mission packages."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.handy import known
from tests.server.test_adapter import House, heard
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.server.worlds.dynamic_world import DynamicWorld

CLOSE = 0.03
"""Servos get there but for what they carry [rad]."""
MAX_SPEED = 0.17  # rad/s, CONF of a P2AT's camera (manual 9.3)
SPEED_MARGIN = 1.1
"""A link may be this much faster for a moment: its robot gives a little."""
TALON, P2AT = ROBOTS.get("Talon"), ROBOTS.get("P2AT")
TWO = replace(TALON, name="TwoPackages", packages=(*TALON.packages, *P2AT.packages))


@pytest.fixture(scope="module")
def world():
    with known(TWO):
        world = DynamicWorld(ARENAS.get("field"), Physics(), 1, max_robots=2)
        for name in ("Hummer", "TeleMax", "kenaf", TWO.name):
            world.prepare(ROBOTS.get(name))
        yield world


@pytest.fixture
def house(world):
    house = House(world)
    yield house
    for client in list(house.clients):
        house.leave(client)


def angle(house, client, joint):
    """How far a joint has turned [rad]."""
    return float(house.world.state(client.robot).joint_pos[client.robot.plan.joint_index(joint)])


def test_wheels_that_steer_are_told_one_by_one(house):
    client = house.connect("INIT {ClassName Hummer} {Name Car}")
    house.say(client, "DRIVE {Name LeftFWheel} {Steer 0.3}")  # manual 9.4: its example has 90 degrees
    house.run(100)
    assert angle(house, client, "LeftFWheel_Steer") == pytest.approx(0.3, abs=CLOSE)
    assert angle(house, client, "RightFWheel_Steer") == pytest.approx(0.0, abs=CLOSE)
    for wheel in ("LeftF", "RightF"):
        house.say(client, f"SET {{Type Joint}} {{Name {wheel}Wheel}} {{Opcode Velocity}} {{Params 1.5,-0.1}}")
    for wheel in ("LeftR", "RightR"):
        house.say(client, f"DRIVE {{Name {wheel}Wheel}} {{Order 1}} {{Value 1.5}}")
    house.run(100)
    before = angle(house, client, "LeftFWheel")
    house.run(50)
    for wheel in ("LeftF", "RightF"):
        assert angle(house, client, f"{wheel}Wheel_Steer") == pytest.approx(-0.1, abs=CLOSE)
    assert angle(house, client, "LeftFWheel") - before == pytest.approx(1.5 * 50 * 0.02, rel=0.1)


def test_set_joint_angle_and_the_telemax_gripper(house):
    client = house.connect("INIT {ClassName TeleMax} {Name Arm}")
    house.say(client, "SET {Type Joint} {Name FRFlipper} {Opcode Angle} {Params -0.4}")
    house.say(client, "SET {Type Joint} {Name FLFlipper} {Opcode 0} {Params -0.6}")
    fingers = [name for name in client.robot.plan.parts if "Finger" in name]
    shut = [angle(house, client, name) for name in fingers]
    (answer,) = house.say(client, "SET {Type Gripper} {Name Gripper} {Opcode Open} {Params 1}")
    assert answer.endswith("{Type Gripper} {Name Gripper} {Status OK}")
    house.run(100)
    assert angle(house, client, "FRFlipper") == pytest.approx(-0.4, abs=CLOSE)
    assert angle(house, client, "FLFlipper") == pytest.approx(-0.6, abs=CLOSE)
    opened = [angle(house, client, name) for name in fingers]
    assert len(fingers) == 2
    assert all(abs(b - a) > 0.01 for a, b in zip(shut, opened, strict=True))
    house.say(client, "SET {Type Gripper} {Name Gripper} {Opcode Open} {Params 0}")
    house.run(100)
    assert [angle(house, client, name) for name in fingers] == pytest.approx(shut, abs=2e-3)


def test_each_mission_package_obeys_its_own_name(house):
    """The manual's example of a Talon with a camera and an arm (9.4, MISPKG)."""
    client = house.connect("INIT {ClassName TwoPackages} {Name Both}")
    house.say(client, "MISPKG {Name CameraPanTilt} {Link 1} {Value 0.5} {Link 2} {Value 0.1}")
    house.run(200)  # at 0.17 rad/s
    joints = ("CameraPanTilt_Link1", "CameraPanTilt_Link2", "TalonArm_Link1", "TalonArm_Link3")
    assert [angle(house, client, joint) for joint in joints] == pytest.approx([0.5, 0.1, 0.0, 0.0], abs=CLOSE)
    house.say(client, "MISPKG {Name TalonArm} {Link 1} {Value 0.7} {Link 3} {Value 0.1}")
    house.run(150)
    assert [angle(house, client, joint) for joint in joints] == pytest.approx([0.5, 0.1, 0.7, 0.1], abs=CLOSE)
    lines = [line for line in heard(client) if line.startswith("MISSTA")][-2:]
    told = dict(re.search(r"{Name (\w+)} {Link 1} {Value ([-\d.]+)", line).groups() for line in lines)
    assert told.keys() == {"CameraPanTilt", "TalonArm"}
    assert [float(told[name]) for name in sorted(told)] == pytest.approx([0.5, 0.7], abs=CLOSE)


def test_a_link_under_torque_keeps_its_max_speed_and_its_robot_in_place(house):
    """All of the pan motor's torque for 3 s, then its brake, which is order 3."""
    client = house.connect("INIT {ClassName TwoPackages} {Name Both}")
    house.run(50)
    start = house.world.state(client.robot).pos.copy()
    house.say(client, "MISPKG {Name CameraPanTilt} {Link 1} {Value 20} {Order 2}")
    pan = client.robot.plan.joint_index("CameraPanTilt_Link1")
    speeds = []
    for _ in range(150):
        house.run(1)
        speeds.append(float(house.world.state(client.robot).joint_vel[pan]))
    assert speeds[-1] > 0.95 * MAX_SPEED
    assert max(speeds) < MAX_SPEED * SPEED_MARGIN
    assert house.world.state(client.robot).pos == pytest.approx(start, abs=0.01)
    there = angle(house, client, "CameraPanTilt_Link1")
    house.say(client, "MISPKG {Name CameraPanTilt} {Link 1} {Value 0} {Order 3}")
    house.run(50)
    assert angle(house, client, "CameraPanTilt_Link1") == pytest.approx(there, abs=CLOSE)


def efforts(lines, package):
    """What the last MISSTA of a package says of each link: value [rad] and torque [N m]."""
    (line,) = [line for line in lines if line.startswith("MISSTA") and f"{{Name {package}}}" in line][-1:]
    links = re.findall(r"{Link \d} {Value ([-\d.]+)} {Torque ([-\d.]+)}", line)
    return np.array(links, float).T


def exerted(house, client, joints):
    """C MuJoCo's actuator forces at joints of a robot, where the world stands now [N m]."""
    world, physics = house.world.one_world()
    model, data = house.world.scene.model, mujoco.MjData(house.world.scene.model)
    data.qpos[:], data.qvel[:], data.act[:] = physics.qpos, physics.qvel, physics.act
    group, member = house.world.scene.group_of(client.robot.slot)
    index = house.world.scene.groups[group].indices[member]
    data.ctrl[list(index.hold_actuator_ids)] = world.groups[group].hold[member]
    mujoco.mj_forward(model, data)
    dofs = [index.dofadr[client.robot.plan.joint_index(name)] for name in joints]
    return data.qfrc_actuator[dofs]


def test_missta_tells_what_each_joint_exerts(house):
    """An arm that is held out against its weight, and a joint that is told a torque."""
    client = house.connect("INIT {ClassName TwoPackages} {Name Both}")
    house.say(client, "MISPKG {Name TalonArm} {Link 1} {Value 0.7}")
    house.run(100)
    heard(client)
    house.say(client, "MISPKG {Name CameraPanTilt} {Link 1} {Value -2} {Order 2}")
    for wait in (1, 9, 100):  # at once, on its way, and at its top speed
        house.run(wait)
        client.report()
        lines = heard(client)
        for package in ("TalonArm", "CameraPanTilt"):
            links = [f"{package}_Link{number + 1}" for number in range(efforts(lines, package).shape[1])]
            oracle = exerted(house, client, links)
            np.testing.assert_allclose(efforts(lines, package)[1], oracle, atol=0.006)  # two decimals
    assert np.abs(efforts(lines, "TalonArm")[1]).max() > 1.0, "it weighs something"


def test_joints_of_one_multidrive_are_one_order(house, monkeypatch):
    """A gait sends a dozen joints in each control step: one by one they took more than a client's budget."""
    orders, update = [], house.world.update_command
    monkeypatch.setattr(
        house.world, "update_command", lambda robot, order: (orders.append(order), update(robot, order))
    )
    client = house.connect("INIT {ClassName kenaf} {Name K}")
    house.say(client, "MULTIDRIVE {kenafCameraPan -1.0} {Nobody 1} {KENAFCAMERATILT 0.5}")
    assert [order.joints for order in orders] == [{"kenafCameraPan": -1.0, "kenafCameraTilt": 0.5}]
    assert client.session.fault_count == 1
    house.run(150)
    assert efforts(heard(client), "CameraPanTilt")[0] == pytest.approx([-1.0, 0.5], abs=CLOSE)
    house.say(client, "MULTIDRIVE {Nobody 1}")
    assert (len(orders), client.session.fault_count) == (1, 2)


def test_a_camera_moved_by_joints_of_its_own_names_is_a_mission_package_too(house):
    """Kenaf's: MULTIDRIVE (manual 12.23.1) and MISPKG move it, MISSTA, GEO and CONF tell of it."""
    client = house.connect("INIT {ClassName kenaf} {Name K}")
    house.say(client, "MULTIDRIVE {kenafCameraPan -1.0} {kenafCameraTilt 0.5}")
    house.run(150)
    assert efforts(heard(client), "CameraPanTilt")[0] == pytest.approx([-1.0, 0.5], abs=CLOSE)
    house.say(client, "MISPKG {Name CameraPanTilt} {Link 1} {Value 0.5} {Link 2} {Value -0.2}")
    house.run(150)
    assert efforts(heard(client), "CameraPanTilt")[0] == pytest.approx([0.5, -0.2], abs=CLOSE)
    assert angle(house, client, "kenafCameraPan") == pytest.approx(0.5, abs=CLOSE)
    (geometry,) = house.say(client, "GETGEO {Type Camera} {Name Camera}")
    assert geometry.endswith("Mount kenafCameraTilt}")
    (limits,) = house.say(client, "GETCONF {Type MisPkg}")
    assert re.search(
        r"{Link 1} .*{MinRange 1.00} {MaxRange 0.00} {Link 2} .*{MinRange -1.00} {MaxRange 1.50}", limits
    )
