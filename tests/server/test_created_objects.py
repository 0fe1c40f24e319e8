"""Objects that a world controller creates, moves and kills (WorldController.uc), and recordings of that."""

import math

import mujoco
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.server.test_world_controller import ARENA, objects, say
from usarmjx.recording.inputs import LooseAdded
from usarmjx.recording.reader import Recording
from usarmjx.recording.replay import check_recording
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.gamebots.world_objects import MASS, MAX_OBJECTS, SIZES
from usarmjx.server.protocol.dialects import UDK
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.recorded import record_worlds

CREATE = "CONTROL {Type Create} {ClassName WCCrate11401}"
CRATE = (0.3, 0.21, 0.15)


def controller(world):
    client = Client(world, "peer", dialect=UDK)
    client.session.data_to_send()
    (init,) = client.session.receive_data(b"INIT {ClassName USARBot.WorldController} {Name W}\r\n")
    assert client.becomes_controller(init)
    client.session.answer_init(True)
    return client


def driver(world, where="0,0,-0.3"):
    client = Client(world, "driver", dialect=UDK)
    line = f"INIT {{ClassName USARBot.P3AT}} {{Name R1}} {{Location {where}}}\r\n"
    (init,) = client.session.receive_data(line.encode())
    assert client.spawn(init, client.robot_class(init))
    client.session.answer_init(True)
    client.session.data_to_send()
    return client


@pytest.fixture
def world():
    return DynamicWorld(ARENA, max_robots=3)


@pytest.fixture
def client(world):
    return controller(world)


def steps(world, count):
    for _ in range(count):
        world.step()


def test_a_crate_has_the_size_of_its_class_and_falls(world, client):
    assert say(client, f"{CREATE} {{Name box}} {{Location 2,1,-0.575}} {{Physics RigidBody}}") == []
    size, location, rotation = objects(client, " {Name box}")["box"]
    np.testing.assert_allclose(size, (*CRATE[:2], -CRATE[2]), atol=1e-4)
    np.testing.assert_allclose((location, rotation), ((2.0, 1.0, -0.575), (0.0, 0.0, 0.0)), atol=1e-4)
    model = world.scene.model
    assert model.body("loose/box").mass[0] == pytest.approx(MASS)
    steps(world, 13)
    # Free fall: half of g t², before it lands after 0.32 s; Euler's steps add half of g t dt.
    fallen = -0.575 - objects(client, " {Name box}")["box"][1][2]
    time, step = 13 * world.period, world.scene.physics.timestep
    assert -fallen == pytest.approx(4.905 * time * (time + step), abs=2e-4)
    steps(world, 60)
    assert objects(client, " {Name box}")["box"][1][2] == pytest.approx(-0.075, abs=2e-3)


def test_without_physics_it_hangs_where_it_was_put_whatever_pushes_it(world, client):
    say(client, f"{CREATE} {{Name shelf}} {{Location 1,0,-0.2}} {{Scale 1,4,2}} {{Rotation 0,0,0}}")
    size, before, _ = objects(client, " {Name shelf}")["shelf"]
    np.testing.assert_allclose(size, (0.3, 0.84, -0.3), atol=1e-4)
    assert world.scene.model.body("loose/shelf").mass[0] == pytest.approx(MASS * 8)
    steps(world, 50)
    np.testing.assert_allclose(objects(client, " {Name shelf}")["shelf"][1], before, atol=1e-4)
    robot = driver(world)
    robot.handle(*robot.session.receive_data(b"DRIVE {Left 4} {Right 4}\r\n"))
    steps(world, 150)
    there = float(world.state(robot.robot).pos[0])
    assert 0.4 < there < 0.85, "it pushes against it"
    np.testing.assert_allclose(objects(client, " {Name shelf}")["shelf"][1], before, atol=2e-3)
    say(client, "CONTROL {Type RelMove} {Name shelf} {Location 2,0,-0.5} {Rotation 0,0,0.5}")
    steps(world, 100)
    _, location, rotation = objects(client, " {Name shelf}")["shelf"]
    np.testing.assert_allclose(location - before, (2.0, 0.0, -0.5), atol=2e-3)
    np.testing.assert_allclose(rotation, (0.0, 0.0, 0.5), atol=2e-3)
    assert float(world.state(robot.robot).pos[0]) > there + 0.5, "its way is free"
    robot.leave()  # the model is compiled once more
    steps(world, 5)
    np.testing.assert_allclose(objects(client, " {Name shelf}")["shelf"][1], location, atol=1e-4)
    world.reset()
    steps(world, 5)
    np.testing.assert_allclose(objects(client, " {Name shelf}")["shelf"][1], before, atol=1e-4)


def test_lasers_see_it_until_it_is_killed(world, client):
    robot = driver(world, "-2,0,-0.3")
    scanner = next(n for n, one in enumerate(robot.robot.suite.sensors) if one.kind == "RangeScanner")

    def ahead():
        steps(world, 20)
        world.observe([robot.robot])
        ranges = np.asarray(robot.robot.latest[scanner][1])
        return float(ranges[len(ranges) // 2])

    free = ahead()
    say(client, f"{CREATE} {{Name wall}} {{Location 1,0,-0.5}} {{Scale 1,4,6}}")
    state = world.state(robot.robot)
    seen = ahead()
    (mount,) = [one for one in robot.robot.spec.sensors if one.kind == "RangeScanner"]
    origin = float(state.pos[0]) + mount.at[0]
    assert seen == pytest.approx(1.0 - 0.15 - origin, abs=0.03)
    say(client, "CONTROL {Type Kill} {Name wall}")
    assert list(objects(client)) == ["crate", "Bar"]
    assert ahead() == free


def test_killall_clears_a_box_or_everything_but_what_is_permanent(client):
    for number, x in enumerate((1, 2, 3)):
        say(client, f"{CREATE} {{Name b{number}}} {{Location {x},3,-1}}")
    say(client, f"{CREATE} {{Name stays}} {{Location 2,4,-1}} {{Permanent True}}")
    say(client, f"{CREATE} {{Name too}} {{Location 2,4.5,-1}} {{Permanent 1}}")
    say(client, "CONTROL {Type KillAll} {MinPos 1.5,2,-2} {MaxPos 2.5,5,0}")
    assert list(objects(client)) == ["crate", "Bar", "b0", "b2", "stays", "too"]
    assert list(objects(client, " {ClassName USARPhysObj.WCCrate11401}")) == ["b0", "b2", "stays", "too"]
    assert list(objects(client, " {ClassName WCObject}")) == ["crate", "Bar", "b0", "b2", "stays", "too"]
    say(client, "CONTROL {Type KillAll}")
    assert list(objects(client)) == ["crate", "Bar", "stays", "too"]
    say(client, "CONTROL {Type Kill} {Name stays}")
    say(client, "CONTROL {Type Kill} {Name too}")
    assert list(objects(client)) == ["crate", "Bar"]


def test_the_others_move_by_no_bit_when_objects_come_and_go():
    def run(with_objects):
        world = DynamicWorld(ARENA, max_robots=2)
        robot, client = driver(world), controller(world)
        robot.handle(*robot.session.receive_data(b"DRIVE {Left 3} {Right 1}\r\n"))
        steps(world, 20)
        if with_objects:
            say(client, f"{CREATE} {{Name a}} {{Location 8,8,-1}}")
            say(client, "CONTROL {Type Kill} {Name a}")
        return np.array(world._single.engine.data.qpos)

    np.testing.assert_array_equal(run(True), run(False))


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("CONTROL {Type Create} {ClassName WCCrate} {Name new} {Location 1,1,-1}", "no objects of class"),
        (f"{CREATE} {{Location 1,1,-1}}", "needs a Name"),
        (f"{CREATE} {{Name CRATE}} {{Location 1,1,-1}}", "here already"),
        (f"{CREATE} {{Name new}} {{Location 1,1,-1}} {{Scale 0.001,1,1}}", "Scale"),
        (f"{CREATE} {{Name new}} {{Location 1,1,-1}} {{Scale -1,1,1}}", "Scale"),
        (f"{CREATE} {{Name new}} {{Location 1e9,1,-1}}", "position 1000000000.00,1.00,-1.00 is out of reach"),
        (f"{CREATE} {{Name new}} {{Start Nowhere}}", "no start pose"),
        (f"{CREATE} {{Name new}} {{Location 4,1,-0.05}} {{Physics Falling}}", "no room for new at 4.00,1.00"),
        ("CONTROL {Type Kill} {Name crate}", "was created"),
        ("CONTROL {Type Conveyor} {Name b} {Speed 1}", "no conveyor here is called 'b'; there are: none"),
    ],
)
def test_what_cannot_be_created_or_killed_changes_nothing(world, client, line, reason):
    steps(world, 20)
    before, state = objects(client), world._single.engine.data.qpos.copy()
    assert say(client, line) == []
    (fault,) = client.session.take_faults()
    assert reason in fault
    np.testing.assert_array_equal(world._single.engine.data.qpos, state)
    assert objects(client).keys() == before.keys()


def test_a_start_pose_is_a_place_and_the_number_of_objects_is_bounded(world, client):
    start = world.arena.starts[0]
    say(client, f"{CREATE} {{Name here}} {{Start {start.tag}}} {{Location 9,9,-9}}")
    _, location, _ = objects(client, " {Name here}")["here"]
    np.testing.assert_allclose(location, (start.at[0], -start.at[1], -start.at[2]), atol=1e-4)
    world.created.update({f"x{n}": world.created["here"] for n in range(MAX_OBJECTS - 1)})
    say(client, f"{CREATE} {{Name more}} {{Location 3,3,-2}}")
    assert "objects already" in client.session.take_faults()[0]


def test_every_class_has_the_size_in_the_name_of_its_mesh():
    """Sides are those of cartons and a robot; a pallet of 48 by 40 inches is that large."""
    assert all(min(size) >= 0.12 or name == "WCPallet48x40" for name, size in SIZES.items())
    inch = 0.0254
    np.testing.assert_allclose(SIZES["WCPallet48x40"][:2], (48 * inch, 40 * inch), atol=1.1e-3)


def test_a_recording_with_objects_is_replayed_to_the_bit(tmp_path):
    world = DynamicWorld(FLAT, max_robots=2)
    file = record_worlds([world], tmp_path / "objects.mcap")
    client, robot = controller(world), driver(world)
    robot.handle(*robot.session.receive_data(b"DRIVE {Left 4} {Right 4}\r\n"))
    say(client, f"{CREATE} {{Name a}} {{Location 0.8,0,-0.1}} {{Physics RigidBody}}")
    steps(world, 30)
    say(client, f"{CREATE} {{Name b}} {{Location 0.8,0,-0.1}} {{Physics RigidBody}}")  # no room
    say(client, f"{CREATE} {{Name c}} {{Location 2,0.1,-0.2}}")
    steps(world, 60)
    say(client, "CONTROL {Type AbsMove} {Name c} {Location 3,0,-0.2} {Rotation 0,0,0.3}")
    say(client, "CONTROL {Type RelMove} {Name R1} {Location 0,1,-0.1}")
    steps(world, 30)
    say(client, "CONTROL {Type Kill} {Name a}")
    steps(world, 10)
    world.reset()
    steps(world, 10)
    file.close()
    recording = Recording(tmp_path / "objects.mcap")
    given = [message.value for message in recording.messages(("inputs",), 0)]
    assert [one.thing.name for one in given if isinstance(one, LooseAdded)] == ["a", "b", "c"]
    result = check_recording(recording, 0)
    assert (result.difference, result.note, result.steps) == ("", "", 140)
    assert list(world.created) == ["c"]


def test_a_hold_gives_way_by_less_than_a_millimetre():
    world = DynamicWorld(FLAT)
    say(controller(world), f"{CREATE} {{Name a}} {{Location 0,0,-1}}")
    engine = world._single.engine
    body = engine.model.body("loose/a").id
    for _ in range(200):
        engine.data.xfrc_applied[body, :3] = (100.0, 0.0, 0.0)
        mujoco.mj_step(engine.model, engine.data)
    assert 0.0 < engine.data.body("loose/a").xpos[0] < 1e-3
    assert math.isclose(engine.data.body("loose/a").xpos[2], 1.0, abs_tol=1e-5)
