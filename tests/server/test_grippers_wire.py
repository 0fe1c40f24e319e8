"""Grippers as the later versions have them: ACT, SET, CONF and EFF of a Talon, and nothing of it in the manual's dialect.

Forms of the lines are those of Gripper.uc, Effector.uc and BotConnection.uc (hrnr/robocup-usarsim).
"""  # noqa: E501 - one sentence

import numpy as np
import pytest

from tests.arenas import FLAT
from tests.server.peers import say
from usarmjx.models.compile.parts import parts_of
from usarmjx.models.robots import ROBOTS
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.protocol.dialects import MANUAL, UDK
from usarmjx.server.worlds.dynamic_world import DynamicWorld

CLOSED, OPEN = (f"EFF {{Type Gripper}} {{Name Gripper}} {{Status {word}}}" for word in ("CLOSED", "OPEN"))
FAILED, DONE = "Failed", "OK"


def joined(dialect):
    client = Client(DynamicWorld(FLAT, max_robots=1), "peer", dialect=dialect)
    say(client, "INIT {ClassName USARBot.Talon} {Name R} {Location 0,0,-0.5}")
    return client


@pytest.fixture(scope="module")
def client():
    return joined(UDK)


def report(client):
    client.session.data_to_send()
    client.report()
    return client.session.data_to_send().decode().splitlines()


def fingers(client):
    """The ordered positions of the fingers."""
    (gripper,) = client.robot.effecters
    joints = [client.robot.plan.joint_index(name) for name in gripper.joints]
    return np.array(client.robot.command.target)[joints]


@pytest.mark.parametrize("name", ["TalonArm", "talonarm", "Gripper"])
def test_act_opens_and_closes_the_gripper_on_a_package_or_of_that_name(client, name):
    for number, status in ((0, OPEN), (1, CLOSED), (0, OPEN), (2, CLOSED)):
        assert say(client, f"ACT {{Name {name}}} {{Gripper {number}}}") == []
        assert [line for line in report(client) if line.startswith("EFF")] == [status]
    np.testing.assert_allclose(fingers(client), 0.0, atol=1e-6)
    say(client, f"ACT {{Name {name}}} {{Gripper 0}}")
    assert (fingers(client) > 0.05).all()


def test_a_gripper_and_a_link_move_by_one_line_and_a_sequence_does_nothing(client):
    say(client, "ACT {Name TalonArm} {Gripper 1}")
    joint = client.robot.plan.joint_index("TalonArm_Link1")
    say(client, "ACT {Name TalonArm} {Link 0} {Value 0.3} {Gripper 0}")
    assert client.robot.command.target[joint] == pytest.approx(0.3)
    assert OPEN in report(client)
    before = np.array(client.robot.command.target)
    say(client, "ACT {Name TalonArm} {Sequence 1}")
    np.testing.assert_array_equal(before, client.robot.command.target)
    say(client, "ACT {Name TalonArm} {Sequence 1} {Gripper 1}")
    assert CLOSED in report(client)


@pytest.mark.parametrize(
    ("opcode", "status", "after"),
    [
        ("{Opcode Grip} {Params 1}", DONE, CLOSED),
        ("{Opcode Grip} {Params 0}", DONE, OPEN),
        ("{Opcode close}", DONE, CLOSED),
        ("{Opcode OPEN}", DONE, OPEN),
        ("{Opcode Open} {Params 0.3}", DONE, OPEN),
        ("{Opcode Grip} {Params 2}", FAILED, OPEN),
        ("{Opcode Grip} {Params -1}", FAILED, OPEN),
        ("{Opcode Grip} {Params shut}", FAILED, OPEN),
        ("{Opcode Grip}", FAILED, OPEN),
        ("{Opcode Squeeze}", FAILED, OPEN),
    ],
)
def test_set_grips_opens_and_closes(client, opcode, status, after):
    (line,) = say(client, f"SET {{Type Gripper}} {{Name Gripper}} {opcode}")
    assert line.endswith(f"{{Type Gripper}} {{Name Gripper}} {{Status {status}}}")
    assert after in report(client)


def test_nonsense_changes_nothing(client):
    before = np.array(client.robot.command.target)
    for line in (
        "{Name TalonArm} {Gripper shut}",
        "{Name Nobody} {Gripper 1}",
        "{Gripper 1}",
        "{Name TalonArm}",
    ):
        say(client, f"ACT {line}")
    np.testing.assert_array_equal(before, client.robot.command.target)


def test_conf_names_the_operations_of_a_binary_gripper(client):
    operations = "{Opcode Grip} {MaxVal 1} {MinVal 0} {Opcode Close} {Opcode Open}"
    assert say(client, "GETCONF {Type Gripper}") == [f"CONF {{Type Gripper}} {{Name Gripper}} {operations}"]
    assert say(client, "GETCONF {Type Gripper} {Name None}") == ["CONF {Type Gripper} {Name None}"]


@pytest.mark.parametrize("name", ["AllAngles", "alljoints"])
def test_one_set_turns_all_joints_but_wheels(client, name):
    """SetAllJointTargets (BotConnection.uc); a joint that moves is not answered."""
    parts = {part.name: part for part in parts_of(client.robot.spec)}
    for value in (0.25, 0.125):
        before = np.array(client.robot.command.target)
        assert say(client, f"SET {{Type Joint}} {{Name {name}}} {{Opcode Target}} {{Params {value}}}") == []
        for index, joint in enumerate(client.robot.plan.parts[1:]):
            expected = before[index] if joint in parts and parts[joint].is_wheel else value
            assert client.robot.command.target[index] == pytest.approx(expected), joint
    (line,) = say(client, f"SET {{Type Joint}} {{Name {name}}} {{Opcode Velocity}} {{Params 1}}")
    assert line.endswith("{Status Failed}"), "angles only"


def test_the_manuals_dialect_has_none_of_it():
    client = joined(MANUAL)
    assert not [line for line in report(client) if line.startswith("EFF")]
    for opcode in ("{Opcode Grip} {Params 1}", "{Opcode Close}", "{Opcode Open}"):
        (line,) = say(client, f"SET {{Type Gripper}} {{Name Gripper}} {opcode}")
        assert line.endswith("{Status Failed}")
    (line,) = say(client, "GETCONF {Type Gripper}")
    assert "{Opcode Open} {MaxVal" in line
    (line,) = say(client, "SET {Type Joint} {Name AllAngles} {Opcode Angle} {Params 0.1}")
    assert line.endswith("{Status Failed}")


def test_telemax_and_talon_are_the_arms_with_a_gripper():
    gripping = [name for name, robot in ROBOTS if any(mount.kind == "Gripper" for mount in robot.effecters)]
    assert set(gripping) >= {"Talon", "TeleMax"}
