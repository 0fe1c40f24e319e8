"""SET {Type Joint} {Opcode Stiffness}: servos exert a share of their gains and torque (LeggedRobot.uc).

There a position drive has the spring MaxForce times the stiffness, and as much force at most.
"""

import re

import pytest

from tests.arenas import FLAT
from tests.server.peers import say
from usarmjx.models.compile.kinematic_tree import servos_of
from usarmjx.models.types.robot import HOLD_SUFFIX
from usarmjx.recording.reader import Recording
from usarmjx.recording.replay import check_recording
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.worlds.batch_world import BatchWorld
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.policy_world import PolicyWorld
from usarmjx.server.worlds.recorded import record_worlds
from usarmjx.server.worlds.served_world import ServedWorld

JOINT = "TalonArm_Link1"
SETTLING = 250
"""Control steps until an arm hangs still."""
LOAD_RTOL = 0.02
"""How well the load of a robot that still sways on its tracks agrees with the load at rest."""
MOTION_ATOL = 1e-6
"""Inputs are of single precision: scaled gains and scaled inputs round differently, here by 1e-8 [rad]."""


def talon(world, name="R", where="0,0,-0.5"):
    client = Client(world, name)
    say(client, f"INIT {{ClassName USARBot.Talon}} {{Name {name}}} {{Location {where}}}")
    return client


def soften(client, share, joint=JOINT):
    return say(client, f"SET {{Type Joint}} {{Name {joint}}} {{Opcode Stiffness}} {{Params {share}}}")


def steps(world, count):
    for _ in range(count):
        world.step()


def arm_of(client):
    """Index of the joint, its address in the positions, and its degree of freedom."""
    world, robot = client._world, client.robot
    group, member = world.scene.group_of(robot.slot)
    joint = robot.plan.joint_index(JOINT)
    index = world.scene.groups[group].indices[member]
    return joint, index.qposadr[joint], index.dofadr[joint]


def position(client):
    return float(client._world._single.engine.data.qpos[arm_of(client)[1]])


def torque_told(client):
    """The torque of the joint in MISSTA."""
    client.session.data_to_send()
    client.report()
    (line,) = (
        line for line in client.session.data_to_send().decode().splitlines() if line.startswith("MISSTA")
    )
    return float(re.search(r"{Link 1} {Value [^}]*} {Torque ([^}]*)}", line)[1])


@pytest.mark.parametrize("share", [1.0, 0.5, 0.1])
@pytest.mark.oracle
def test_an_arm_sags_by_its_load_over_its_stiffness(share):
    world = DynamicWorld(FLAT, max_robots=1)
    client = talon(world)
    assert soften(client, share) == []
    steps(world, SETTLING)
    joint, _, dof = arm_of(client)
    data = world._single.engine.data
    load, full = float(data.qfrc_bias[dof]), float(servos_of(client.robot.spec).stiffness[joint])
    assert load > 5.0  # N m: an outstretched arm
    assert -position(client) == pytest.approx(load / (share * full), rel=LOAD_RTOL)
    assert torque_told(client) == pytest.approx(load, rel=LOAD_RTOL)


@pytest.mark.oracle
@pytest.mark.parametrize("share", [0.3, 0.0])
def test_it_moves_as_c_mujoco_does_with_gains_of_that_share(share):
    soft, scaled = (talon(DynamicWorld(FLAT, max_robots=1)) for _ in range(2))
    for client in (soft, scaled):
        steps(client._world, 40)  # until it stands
    soften(soft, share)
    model = scaled._world._single.engine.model
    both = [model.actuator(f"r0/{name}").id for name in (JOINT, f"{JOINT}{HOLD_SUFFIX}")]
    model.actuator_gainprm[both] *= share
    for client in (soft, scaled):
        say(client, "MISPKG {Name TalonArm} {Link 1} {Value 0.4}")
        steps(client._world, 12)
    assert abs(position(soft)) > 0.04
    assert position(soft) == pytest.approx(position(scaled), abs=MOTION_ATOL)


def test_an_arm_that_is_too_soft_for_its_load_falls_and_comes_up_again():
    world = DynamicWorld(FLAT, max_robots=1)
    client = talon(world)
    steps(world, 40)
    soften(client, 0.02)  # of 120 N m, against 10
    steps(world, SETTLING)
    assert position(client) < -0.2
    soften(client, 1)
    before = position(client)
    steps(world, 1)
    assert abs(position(client) - before) < 0.02  # without a jump
    steps(world, SETTLING)
    assert position(client) == pytest.approx(0.0, abs=0.01)


def test_it_stays_soft_while_others_come_and_go_and_they_are_stiff():
    world = DynamicWorld(FLAT, max_robots=2)
    client = talon(world)
    soften(client, 0.1)
    steps(world, SETTLING)
    sag = position(client)
    other = talon(world, "S", "3,0,-0.5")
    steps(world, SETTLING)
    assert position(other) == pytest.approx(sag / 10, rel=LOAD_RTOL)
    assert position(client) == pytest.approx(sag, rel=LOAD_RTOL)
    other.leave()
    steps(world, 20)
    assert position(client) == pytest.approx(sag, rel=LOAD_RTOL)


def test_a_reset_makes_it_stiff():
    world = DynamicWorld(FLAT, max_robots=1)
    client = talon(world)
    soften(client, 0.1)
    steps(world, SETTLING)
    sag = position(client)
    world.reset()
    steps(world, SETTLING)
    assert position(client) == pytest.approx(sag / 10, rel=LOAD_RTOL)


def test_a_recording_with_soft_joints_is_replayed_to_the_bit(tmp_path):
    world = DynamicWorld(FLAT, max_robots=2)
    file = record_worlds([world], tmp_path / "soft.mcap")
    client = talon(world)
    steps(world, 10)
    soften(client, 0.2)
    steps(world, 10)
    other = talon(world, "S", "3,0,-0.5")
    say(other, "MISPKG {Name TalonArm} {Link 1} {Value 0.4}")
    steps(world, 10)
    soften(other, 0.0)
    soften(client, 0.7)
    steps(world, 10)
    other.leave()
    world.reset()
    steps(world, 10)
    soften(client, 0.4)
    steps(world, 10)
    file.close()
    result = check_recording(Recording(tmp_path / "soft.mcap"), 0)
    assert (result.difference, result.note, result.steps) == ("", "", 60)


@pytest.mark.parametrize(
    ("joint", "share"),
    [(JOINT, "1.5"), (JOINT, "-0.1"), (JOINT, "soft"), (JOINT, ""), ("LeftFWheel", "0.5"), ("Nose", "0.5")],
)
def test_what_is_no_share_or_no_servo_of_a_position_fails_and_nothing_changes(joint, share):
    client = talon(DynamicWorld(FLAT, max_robots=1))
    (line,) = soften(client, share, joint)
    assert line.endswith(f"{{Type Joint}} {{Name {joint}}} {{Status Failed}}")
    assert all(state.stiffness is None for state in client._world.one_world()[0].groups)


def test_worlds_of_other_engines_refuse_it(monkeypatch):
    for kind in (BatchWorld, PolicyWorld):
        assert kind.set_stiffness is ServedWorld.set_stiffness
    client = talon(DynamicWorld(FLAT, max_robots=1))
    monkeypatch.setattr(DynamicWorld, "set_stiffness", ServedWorld.set_stiffness)
    (line,) = soften(client, 0.5)
    assert line.endswith("{Status Failed}")
    assert client.session.take_faults() == [
        "R keeps its gains: only in a single world of engine c do they change"
    ]
