"""Victims and tags found over the wire, on a live world and on one of a batch (manual 10.9 to 10.12)."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.arenas import FLAT
from tests.handy import TAGGER, known
from tests.server.peers import say
from usarmjx.models.compile.physics import Physics
from usarmjx.models.types.arena import HelpSound, SegmentMotion, Tag, Victim
from usarmjx.models.types.robot import Mount, options
from usarmjx.models.types.shapes import Shape
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.pictures.views import snapshot
from usarmjx.server.worlds.batch_world import BatchWorld
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.served_world import CameraRequest
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import RosterEntry, build_scene

WAVE = SegmentMotion(name="RightArm", initial=(-1.6, 0, 0), final=(-0.8, 0, 0), rates=(1, 0, 0))
VICTIM = Victim(
    name="v",
    at=(2.0, 0.0, 0.12),
    rotation=(0.0, 0.0, 1.5),
    segments=(WAVE,),
    help_sound=HelpSound(loudness=8.0, duration=2.0, pause=0.0),
)
WALL = Shape(kind="box", size=(0.3, 0.05, 0.4), at=(0.0, 1.0, 0.4), surface="wall")
ARENA = replace(
    FLAT,
    name="found",
    floor=-0.4,
    victims=(VICTIM,),
    shapes=(WALL,),
    tags=(Tag(at=(1.5, 0.5, 0.0), memory="go on"), Tag(at=(0.0, 1.5, 0.0), id=3000)),
)
FINDER = replace(
    TAGGER,
    name="Finder",
    sensors=(
        Mount(kind="VictSensor", name="VictSensor", options=options(Sigma=0.0, bShowResults=True)),
        Mount(kind="RFID", name="Reader", options=options(bAlwaysReadRFIDmem=True)),
        Mount(kind="RFID", name="Strict", options=options(SensingMode="Obstacle", bTraceRFIDs=True)),
        Mount(kind="Sound", name="Ear", options=options(Noise=0.0)),
        Mount(kind="HumanMotion", name="Motion"),
        Mount(kind="CO2Sensor", name="CO2"),
    ),
    cameras=(Mount(kind="Camera", name="Camera", at=(0.2, 0.0, -0.2), options=options(CameraDefFov=1.5)),),
)


@pytest.fixture(scope="module", autouse=True)
def robots():
    with known(FINDER):
        yield


@pytest.fixture(scope="module")
def live():
    world = DynamicWorld(ARENA, Physics(), 1, max_robots=2)
    world.prepare(FINDER)
    return world


@pytest.fixture(scope="module")
def claimed():
    scene = build_scene(ARENA, [RosterEntry(robot="Finder", parked=True)])
    return BatchWorld(Batch(scene, 2, engine="c", seed=4), 1)


@pytest.fixture(params=["live", pytest.param("claimed", marks=pytest.mark.thorough)])
def client(request):
    client = Client(request.getfixturevalue(request.param), "peer")
    say(client, "INIT {ClassName Finder} {Location 0,0,0.14} {Rotation 0,0,0}")
    yield client
    client.leave()


def heard(client):
    return client.session.data_to_send().decode().split("\r\n")[:-1]


def report(client, seconds=0.0):
    world = client._world
    for _ in range(round(seconds / world.period)):
        world.step()
    heard(client)
    world.observe([client.robot])
    client.report()
    lines = [line for line in heard(client) if line.startswith("SEN") and "{Name Strict}" not in line]
    return {re.search(r"{Type (\w+)}", line).group(1): line for line in lines}


def test_victims_and_tags_are_found(client):
    lines = report(client, 0.2)
    assert re.fullmatch(
        r"SEN {Time \d+\.\d{4}} {Type VictSensor} {Name VictSensor}( {PartName \w+} {Location [-.\d,]+})+",
        lines["VictSensor"],
    )
    assert "{PartName Chest}" in lines["VictSensor"]
    found = re.search(r"{Name Reader}.* {ID 1001} {Location (.*?),(.*?),(.*?)} {Mem go on}", lines["RFID"])
    assert found is not None
    np.testing.assert_allclose([float(v) for v in found.groups()], (1.5, -0.5, 0.26), atol=0.02)
    loud = float(re.search(r"{Loudness (.*?)}", lines["Sound"]).group(1))
    assert 8 / 2.3**2 < loud < 8 / 1.7**2
    assert "{Duration 2.00}" in lines["Sound"]
    assert float(re.search(r"{Prob (.*?)}", lines["HumanMotion"]).group(1)) > 0.2
    assert re.fullmatch(r"SEN {Type CO2Sensor} {Name CO2} {Gas CO2} {Density 0.01}", lines["CO2Sensor"])


def test_a_dropped_tag_is_read_and_written_by_its_number(client):
    assert "{Status OK}" in say(client, "SET {Type RFIDReleaser} {Name Gun} {Opcode Release}")[0]
    lines = report(client, 0.2)
    assert "{ID 0} " in lines["RFID"]
    assert lines["RFID"].index("{ID 0}") < lines["RFID"].index("{ID 1001}")  # the nearer one comes first
    (answer,) = say(client, "SET {Type RFID} {Name Reader} {Opcode Write} {Params 0 Bob was here}")
    assert answer.endswith("{Type RFID} {Name Reader} {Status OK}")
    (answer,) = say(client, "SET {Type RFID} {Name Reader} {Opcode Read} {Params 0}")
    assert answer.endswith("{Type RFID} {Name Reader} {Status OK} {ID 0} {Mem Bob was here}")
    (answer,) = say(client, "SET {Type RFID} {Name Reader} {Opcode Read} {Params 7}")
    assert answer.endswith("{Type RFID} {Name Reader} {Status Failed}")
    assert "{Mem Bob was here}" in report(client, 0.2)["RFID"]


def test_walls_hide_tags(client):
    """3000 lies behind a wall, which costs the one reader 3.5 dB and takes it from the other."""
    report(client, 0.2)
    client._world.observe([client.robot])
    for name, ids in (("Reader", {1001, 3000}), ("Strict", {1001})):
        value = client.robot.pending[client.robot.suite.find("RFID", name)]
        assert {int(row[1]) for row in value if row[0]} - {0} == ids


def test_pictures_show_the_lines_to_tags_and_where_the_victim_sensor_looks(client, monkeypatch):
    """Manual 10.9.3.2 and 10.10.2; the picture itself is black here."""
    world, (height, width) = client._world, (240, 320)
    report(client, 0.2)
    black = SimpleNamespace(
        rgb=np.zeros((height, width, 3), np.uint8), depth=np.full((height, width), np.inf)
    )
    monkeypatch.setattr(world, "snapshot", lambda shots: lambda: [black for _ in shots])
    shot = CameraRequest(client.robot, 0, width, height)
    (picture,) = snapshot(world, [shot])()
    assert not black.rgb.any()
    colors = {tuple(color) for color in np.unique(picture.reshape(-1, 3), axis=0).tolist()}
    assert colors == {(0, 0, 0), (0, 255, 0), (255, 0, 0), (255, 255, 255)}, "a body, the floor, and nothing"
    # From the reader, in the middle of the robot, to the tag left of what the victim sensor sees.
    eye, reader = world.viewpoint(shot), world.state(client.robot).pos
    tag = np.add(ARENA.tags[0].at, (0.0, 0.0, ARENA.floor))
    focal = width / 2 / np.tan(1.5 / 2)
    for share in (0.6, 0.8, 0.95):
        x, y, z = (reader + share * (tag - reader) - eye.pos) @ eye.mat
        column, row = int(width / 2 - focal * y / x), int(height / 2 - focal * z / x)
        near = picture[row - 1 : row + 2, column - 1 : column + 2].reshape(-1, 3)
        assert (near == (0, 255, 0)).all(1).any(), share


def test_far_away_there_is_no_line_of_tags_and_no_victim(client):
    robot, world = client.robot, client._world
    world.remove(robot)
    client.robot = world.spawn(robot.spec, "far", (-20.0, 0.0, -0.1), (0.0, 0.0, 3.1))
    lines = report(client, 0.2)
    assert "RFID" not in lines
    assert re.fullmatch(r"SEN {Time \d+\.\d{4}} {Type VictSensor} {Status NoVictims}", lines["VictSensor"])


@pytest.mark.thorough
def test_worlds_with_arenas_of_their_own_find_what_is_in_theirs():
    empty = replace(ARENA, name="empty", victims=(), tags=())
    tagged = replace(ARENA, name="tagged", victims=(), tags=(Tag(at=(0.5, 0.0, 0.0), id=2000), *ARENA.tags))
    batch = Batch(build_scene([ARENA, empty, tagged], ["Finder"]), 3, engine="c", seed=4)
    _, ((eye, reader, strict, ear, _, _),) = batch.observe(batch.reset())
    seen, read = np.asarray(eye.value)[:, 0, :, 0], np.asarray(reader.value)[:, 0]
    assert seen.any(-1).tolist() == [True, False, False]
    assert [[int(row[1]) for row in world if row[0]] for world in read] == [
        [3000, 1001],
        [],
        [2000, 3000, 1001],
    ]
    clear = np.asarray(strict.value)[:, 0]
    assert [[int(row[1]) for row in world if row[0]] for world in clear] == [[1001], [], [2000, 1001]]
    assert (np.asarray(ear.value)[:, 0, 0] > 0).tolist() == [True, False, False]
