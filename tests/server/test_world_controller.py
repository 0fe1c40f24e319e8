"""CONTROL of the later versions: a client without a robot that moves loose objects and robots.

Forms of the lines are those of WorldController.uc and BotConnection.uc (hrnr/robocup-usarsim).
"""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from tests.arenas import FLAT
from tests.handy import block
from tests.server.peers import Peer, serving
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import angles_from_mat
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.protocol.commands import Init
from usarmjx.server.protocol.dialects import MANUAL, UDK
from usarmjx.server.worlds.dynamic_world import DynamicWorld

ARENA = replace(
    FLAT, loose=(block((4.0, 1.0), name="crate"), block((0.0, 6.0), (0.2, 0.05, 0.03), name="Bar"))
)
F4 = r"-?\d+\.\d{4}"
VECTOR = rf"({F4}),({F4}),({F4})"


@pytest.fixture(scope="module")
def world():
    world = DynamicWorld(ARENA, max_robots=3)
    for _ in range(50):
        world.step()
    return world


@pytest.fixture(scope="module")
def client(world):
    client = Client(world, "peer", dialect=UDK)
    session = client.session
    session.data_to_send()
    (init,) = session.receive_data(b"INIT {ClassName USARBot.WorldController} {Name W}\r\n")
    assert client.becomes_controller(init)
    assert session.answer_init(True) == []
    return client


def say(client, line):
    for command in client.session.receive_data(line.encode() + b"\r\n"):
        client.handle(command)
    return client.session.data_to_send().decode().splitlines()


def objects(client, more=""):
    """What GetSTA tells, by name: size, location and rotation."""
    (line,) = say(client, f"CONTROL {{Type GetSTA}}{more}")
    assert line.startswith("STA")
    one = rf" {{Name (\w+)}} {{Size {VECTOR}}} {{Location {VECTOR}}} {{Rotation {VECTOR}}}"
    assert re.fullmatch(f"STA(?:{one})*", line), line
    found = (found.groups() for found in re.finditer(one, line))
    return {name: np.array(numbers, float).reshape(3, 3) for name, *numbers in found}


def test_getsta_tells_size_and_pose_of_what_is_loose(client):
    told = objects(client)
    assert list(told) == ["crate", "Bar"]
    size, location, rotation = told["crate"]
    # Lengths from Unreal's units have z turned, sizes too (LengthVectorFromUU).
    np.testing.assert_allclose(size, [0.06, 0.06, -0.06], atol=1e-3)
    np.testing.assert_allclose(location, [4.0, -1.0, -0.03], atol=2e-3)
    np.testing.assert_allclose(rotation, 0.0, atol=5e-3)
    assert list(objects(client, " {Name bar}")) == ["Bar"]
    assert list(objects(client, " {ClassName USARPhysObj.WCObject}")) == ["crate", "Bar"]
    assert objects(client, " {ClassName WCCrate}") == objects(client, " {Name nothing}") == {}


def test_an_object_is_moved_absolutely_and_relatively(client, world):
    assert say(client, "CONTROL {Type AbsMove} {Name BAR} {Location 2,3,-0.5} {Rotation 0,0,1.5707963}") == []
    size, location, rotation = objects(client, " {Name Bar}")["Bar"]
    np.testing.assert_allclose(location, [2.0, 3.0, -0.5], atol=2e-4)
    np.testing.assert_allclose(rotation, [0.0, 0.0, math.pi / 2], atol=2e-4)
    np.testing.assert_allclose(size, [0.1, 0.4, -0.06], atol=2e-3, err_msg="along the world's axes")
    assert say(client, "CONTROL {Type RelMove} {Name Bar} {Location -1,0.5,0.1} {Rotation 0,0,-0.5}") == []
    _, location, rotation = objects(client, " {Name Bar}")["Bar"]
    np.testing.assert_allclose(location, [1.0, 3.5, -0.4], atol=2e-4)
    np.testing.assert_allclose(rotation, [0.0, 0.0, math.pi / 2 - 0.5], atol=2e-4)
    for _ in range(60):
        world.step()
    _, location, _ = objects(client, " {Name Bar}")["Bar"]
    assert location[2] == pytest.approx(-0.03, abs=5e-3), "it falls"


def test_a_robot_is_moved_where_there_is_room(client, world):
    driver = Client(world, "driver", dialect=UDK)
    (init,) = driver.session.receive_data(b"INIT {ClassName USARBot.P3AT} {Name R1} {Location 0,0,-0.4}\r\n")
    assert driver.spawn(init, driver.robot_class(init))
    faults = client.session.fault_count
    say(client, "CONTROL {Type AbsMove} {Name r1} {Location -3,2,-0.5} {Rotation 0,0,0.7}")
    state = world.state(driver.robot)
    np.testing.assert_allclose(state.pos, [-3.0, -2.0, 0.5], atol=1e-3)
    angles = angles_from_mat(np.asarray(mat_from_quat(np.asarray(state.quat))))
    np.testing.assert_allclose(angles, [0.0, 0.0, -0.7], atol=1e-3)
    say(client, "CONTROL {Type RelMove} {Name R1} {Location 1,0,0}")
    np.testing.assert_allclose(world.state(driver.robot).pos, [-2.0, -2.0, 0.5], atol=1e-3)
    assert client.session.fault_count == faults
    _, crate, _ = objects(client, " {Name crate}")["crate"]
    x, y = crate[0] - 0.1442, crate[1] - 0.2356  # its right front wheel would stand in the crate
    say(client, f"CONTROL {{Type AbsMove}} {{Name R1}} {{Location {x},{y},-0.26}}")
    np.testing.assert_allclose(world.state(driver.robot).pos, [-2.0, -2.0, 0.5], atol=1e-3, err_msg="no room")
    assert client.session.fault_count == faults + 1
    driver.leave()


@pytest.mark.parametrize(
    "line",
    [
        "CONTROL {Type AbsMove} {Name nobody} {Location 1,1,-1}",
        "CONTROL {Type AbsMove} {Name crate} {Location a,b,c}",
        "CONTROL {Type AbsMove} {Name crate} {Location 1e9,0,0}",
        "CONTROL {Type Create} {ClassName WCCrate} {Name new} {Location 1,1,-1}",
        "CONTROL {Name crate}",
        "DRIVE {Left 1} {Right 1}",
        "GETCONF {Type Robot}",
    ],
)
def test_what_it_cannot_do_changes_nothing_and_is_a_fault(client, line):
    before, faults = objects(client), client.session.fault_count
    assert say(client, line) == []
    assert client.session.fault_count == faults + 1
    for name, pose in objects(client).items():
        np.testing.assert_array_equal(pose, before[name])


def test_only_the_later_dialect_has_controllers_and_only_they_control(world):
    manual = Client(world, "peer", dialect=MANUAL)
    assert not manual.becomes_controller(Init("WorldController", "W"))
    assert manual.robot_class(Init("WorldController", "W")) is None
    driver = Client(world, "driver", dialect=UDK)
    (init,) = driver.session.receive_data(b"INIT {ClassName USARBot.P3AT} {Name R2} {Location 0,0,-0.4}\r\n")
    assert not driver.becomes_controller(init)
    assert driver.spawn(init, driver.robot_class(init))
    driver.session.answer_init(True)
    driver.session.data_to_send()
    assert say(driver, "CONTROL {Type GetSTA}") == []
    driver.leave()


def test_a_controller_keeps_its_connection_without_a_robot():
    with serving(DynamicWorld(ARENA), realtime_factor=5.0, dialect=UDK, init_timeout=0.5) as (port, server):
        peer = Peer(port, "INIT {ClassName USARBot.WorldController} {Name W}")
        idle = Peer(port)
        idle.line()
        assert idle.socket.recv(100) == b"", "a client that asks for nothing goes"
        peer.say("CONTROL {Type GetSTA} {Name crate}")
        assert peer.until(b"STA").startswith(b"STA {Name crate} {Size ")
        assert not server.world.robots
        peer.close()
