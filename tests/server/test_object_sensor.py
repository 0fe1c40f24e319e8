"""An object sensor of the later versions, in worlds whose objects are where closed forms put them."""

from dataclasses import replace

import numpy as np
import pytest

from tests.arenas import FLAT
from tests.engines.eager import AT_ONCE
from tests.handy import block
from tests.models.ini.texts import load_texts
from tests.server.test_world_controller import say
from usarmjx.engines.c.rays import CRayCaster
from usarmjx.engines.planar.responses import override_response
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import Victim
from usarmjx.models.types.robot import Mount, options
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.suite import suite_of
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.protocol.dialects import UDK
from usarmjx.server.worlds.batch_world import BatchWorld
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import RosterEntry, build_scene

HALF = (0.1, 0.4, 0.4)
WALL = Shape(kind="box", at=(3.0, 2.0, 0.5), size=(0.1, 0.5, 0.5))
ARENA = replace(
    FLAT,
    shapes=(WALL,),
    loose=(block((2.0, 0.0), HALF, name="Big crate"), block((3.0, 0.0), HALF, name="Behind")),
    victims=(Victim(name="Ada", at=(2.0, -1.5, 0.12), posture="lying"),),
)


def seer(**keys):
    """A P2AT that looks 45 degrees to each side, 0.1 m above the floor."""
    keys = {"ScanFov": 1.6, "Resolution": 0.02, "MaxRange": 4.0} | keys
    mount = Mount(kind="ObjectSensor", name="Finder", at=(0.3, 0.0, 0.15), options=options(**keys))
    return replace(P2AT, name="Seer", sensors=(mount,))


@pytest.fixture
def client(monkeypatch):
    world = DynamicWorld(ARENA, max_robots=3)
    monkeypatch.setattr(ROBOTS, "_entries", dict(ROBOTS._entries))
    ROBOTS.add("Seer", seer())
    client = Client(world, "peer", dialect=UDK)
    say_init(client, "INIT {ClassName USARBot.Seer} {Name R1} {Location 0,0,-0.3}")
    return client


def say_init(client, line):
    client.session.data_to_send()
    (init,) = client.session.receive_data(line.encode() + b"\r\n")
    assert client.spawn(init, client.robot_class(init))
    client.session.answer_init(True)


def heard(client, steps=30):
    """The last line of the sensor."""
    world, lines = client._world, []
    for _ in range(steps):
        world.step()
        if client.due():
            world.observe([client.robot])
            client.report()
            lines += client.session.data_to_send().decode().splitlines()
    return [line for line in lines if "ObjectSensor" in line][-1]


def objects_of(line):
    """Names and numbers of `{Object NAME x,y,z r,p,y}`."""
    head, *parts = line.split(" {Object ")
    found = []
    for part in parts:
        name, location, rotation = part.strip("{}").split(" ")
        found.append((name, np.array(location.split(","), float), np.array(rotation.split(","), float)))
    return head, found


def test_objects_in_sight_are_named_from_right_to_left_with_their_poses(client):
    """The sensor names no hidden objects, and names a wall StaticMeshActor, as Unreal does."""
    head, found = objects_of(heard(client))
    assert head.startswith("SEN {Time ")
    assert head.endswith("{Type ObjectSensor} {Name Finder}")
    assert [name for name, *_ in found] == ["Ada", "Big_crate", "StaticMeshActor"]
    (_, where, _), (_, crate, turned), (_, wall, _) = found
    assert np.linalg.norm(where[:2] - (2.0, 1.5)) < 1.2, "a part of her body"
    np.testing.assert_allclose(crate, (2.0, 0.0, -0.4), atol=0.011)  # two decimals
    np.testing.assert_allclose(turned, 0.0, atol=0.011)
    np.testing.assert_allclose(wall, (3.0, -2.0, -0.5), atol=0.011)


def test_a_robot_is_named_where_it_stands_and_the_sensor_sees_no_part_of_its_own(client):
    other = Client(client._world, "other", dialect=UDK)
    say_init(other, "INIT {ClassName USARBot.P3AT} {Name R2} {Location 1,0,-0.3} {Rotation 0,0,1.5708}")
    _, found = objects_of(heard(client))
    (pose,) = [(at, angles) for name, at, angles in found if name == "R2"]
    state = client._world.state(other.robot)
    np.testing.assert_allclose(pose[0], np.array(state.pos) * (1, -1, -1), atol=0.011)
    np.testing.assert_allclose(pose[1][2], 1.57, atol=0.03)
    assert "Big_crate" not in [name for name, *_ in found], "R2 hides it"
    assert "R1" not in [name for name, *_ in found]


def test_beyond_its_range_there_are_no_objects_and_other_worlds_do_not_know_any(client):
    robot = client.robot
    client._world.update_robot_spec(robot, seer(MaxRange=1.0))
    assert heard(client).endswith("{Type ObjectSensor} {Name Finder}")
    (answer,) = say(client, "SET {Type ObjectSensor} {Name Finder} {Opcode SCAN}")
    assert answer.endswith("{Status OK}")
    (conf,) = say(client, "GETCONF {Type ObjectSensor}")
    assert "{MaxRange 1.0000}" in conf


def test_a_single_world_casts_the_rays_of_a_reading_once(client, monkeypatch):
    """The reading's ranges and the objects of its message are of the same cast."""
    casts, cast = [], CRayCaster.hit_geoms

    def counted(own, start, *more):
        casts.append(len(start))
        return cast(own, start, *more)

    monkeypatch.setattr(CRayCaster, "hit_geoms", counted)
    beams = client.robot.suite.ray_counts[0]
    heard(client, steps=50)
    assert casts.count(beams) == 5, "5 readings in 1 s, 0.2 s apart"


@pytest.mark.parametrize(
    "engine", ["planar", *(pytest.param(name, marks=pytest.mark.thorough) for name in ("c", "jax"))]
)
def test_worlds_of_batches_name_the_same_objects(client, engine):
    """Nothing has moved: C MuJoCo meets what it met in the single world, wherever the batch is computed."""
    wanted = objects_of(heard(client))[1]
    override_response(seer(), AT_ONCE)
    roster = [RosterEntry(robot=robot, parked=True) for robot in (seer(), P2AT)]
    world = BatchWorld(Batch(build_scene(ARENA, roster), 2, engine=engine), 1)
    guest = Client(world, "peer", dialect=UDK)
    say_init(guest, "INIT {ClassName USARBot.Seer} {Name R1} {Location 0,0,-0.3}")
    found = objects_of(heard(guest))[1]
    assert (
        [name for name, *_ in found]
        == [name for name, *_ in wanted]
        == ["Ada", "Big_crate", "StaticMeshActor"]
    )
    for (_, where, turned), (_, there, angles) in zip(found, wanted, strict=True):
        np.testing.assert_allclose(where, there, atol=0.011)
        np.testing.assert_allclose(turned, angles, atol=0.011)
    other = Client(world, "other", dialect=UDK)
    say_init(other, "INIT {ClassName USARBot.P3AT} {Name R2} {Location 1,0,-0.3} {Rotation 0,0,1.5708}")
    names = [name for name, *_ in objects_of(heard(guest))[1]]
    assert "R2" in names
    assert "Big_crate" not in names, "R2 hides it"


def test_a_file_of_the_later_versions_mounts_one(tmp_path):
    """With the figures of a range scanner in their DefaultUSAR.ini."""
    part = "AddParts=(ItemClass=class'USARSensor.ObjectSensor',ItemName=Finder,Position=(X=0.2,Y=0,Z=0))"
    loaded = load_texts(tmp_path, [f"[USARBot.P3AT]\n{part}\n"], (P2AT,))
    (mounted,) = [one for one in loaded.robots if one.name == "P2AT"]
    (own,) = [one.settings[0] for one in suite_of(mounted).sensors if one.kind == "ObjectSensor"]
    assert (own.max_range, own.resolution, own.scan_fov, own.scan_interval) == (4.0, 0.157, 3.14, 0.2)
