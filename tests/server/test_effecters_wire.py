"""Effecters on the wire: SET and RES, GEO and CONF, on a live world and on one of a batch.

Forms of the lines are those of manual 9.3, 9.4 and 11; orders of categories and echoes KRobot.uc's.
"""

import re
from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.arenas import FLAT, RAMP
from tests.handy import GRIPPER, TAGGER, known
from tests.server.peers import say
from usarmjx.models.compile.parts import joint_names
from usarmjx.models.compile.physics import Physics
from usarmjx.models.effecters import EFFECTERS, Effect, Effecter, Opcode
from usarmjx.models.effecters.standard import LEVER
from usarmjx.models.types.robot import Mount, options
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.protocol.grammar import parse_message
from usarmjx.server.worlds.batch_world import BatchWorld
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import RosterEntry, build_scene

F4, F2 = r"-?\d+\.\d{4}", r"-?\d+\.\d\d"
POSE = rf"Location {F4},{F4},{F4} Orientation {F4},{F4},{F4}"
ARENA = replace(FLAT, name="ramped", floor=-0.4, shapes=(RAMP,))
SPOTTER = replace(
    TAGGER,
    name="Spotter",
    sensors=(*TAGGER.sensors, Mount(kind="Sonar", name="Beacon")),
    effecters=(
        Mount(kind="Headlight", name="Beacon", at=(0.1, 0.0, -0.2)),
        Mount(kind="RollerTable", name="Roller", at=(0.0, 0.0, -0.2)),
        replace(GRIPPER, options=options(MaxAngle=1.5707963)),
    ),
)
"""One with two items of one name, and a limit that does not end after four decimals."""


@pytest.fixture(scope="module", autouse=True)
def robots():
    with known(TAGGER, SPOTTER):
        yield


@pytest.fixture(scope="module")
def live():
    world = DynamicWorld(ARENA, Physics(), 1, max_robots=2)
    for robot in (TAGGER, SPOTTER):
        world.prepare(robot)
    return world


@pytest.fixture(scope="module")
def claimed():
    scene = build_scene(ARENA, [RosterEntry(robot="Tagger", parked=True)] * 2)
    return BatchWorld(Batch(scene, 2, engine="c", seed=4), 1)


@pytest.fixture(params=["live", "claimed"])
def world(request):
    return request.getfixturevalue(request.param)


def connect(world, name="Tagger", start="S0"):
    client = Client(world, "peer")
    say(client, f"INIT {{ClassName {name}}} {{Start {start}}}")
    return client


def status(client, kind, name, opcode, params=None):
    """The Status of the RES to a SET; the answer names type and name as they were asked."""
    asked = f"SET {{Type {kind}}} {{Name {name}}} {{Opcode {opcode}}}"
    (line,) = say(client, asked if params is None else f"{asked} {{Params {params}}}")
    assert re.fullmatch(rf"RES {{Time {F2}}} {{Type {kind}}} {{Name {name}}} {{Status [^}}]+}}", line), line
    return parse_message(line).get("Status")


@pytest.fixture
def client(world):
    client = connect(world)
    yield client
    client.leave()


@pytest.fixture
def spotter(live):
    client = connect(live, "Spotter")
    yield client
    client.leave()


def tags_of(world):
    """Positions of the tags in a world (tags, 3)."""
    if isinstance(world, DynamicWorld):
        tags = world.one_world()[0].tags
        return tags.pos[: int(tags.count)]
    tags = jax.tree.map(lambda x: np.asarray(x[world._instance]), world._state.worlds.tags)
    return tags.pos[: int(tags.count)]


# SET


class Launcher(Effecter):
    """One of one's own (manual 14.3): it fires so hard, and shows that by the lamp alone."""

    kind = "Launcher"

    @property
    def opcodes(self):
        return (Opcode("Fire", max_val=2.0, min_val=0.5, default_val=None),)

    def effect(self, opcode, value, stock):
        return Effect(light=value > 0.5)


def test_an_effecter_of_ones_own_may_fire(live):
    """None of section 11 does, so that they fail; the vocabulary of section 8 has the word."""
    EFFECTERS.add(Launcher.kind, Launcher)
    own = replace(TAGGER, name="Launching", effecters=(Mount(kind="Launcher", name="Sling"), GRIPPER))
    try:
        with known(own):
            live.prepare(own)
            client = connect(live, "Launching")
            (told,) = say(client, "GETCONF {Type Effecter} {Name Sling}")
            assert told == "CONF {Type Effecter} {Name Sling} {Opcode Fire} {MaxVal 2.0000} {MinVal 0.5000}"
            assert status(client, "Launcher", "Sling", "fire", 3.0) == "Failed"
            assert not client.robot.command.light
            assert status(client, "Launcher", "Sling", "Fire", 1.5) == "OK"
            assert client.robot.command.light
            assert status(client, "Launcher", "Sling", "Release") == "Failed"
            assert status(client, "Gripper", "Gripper", "Fire", 1.0) == "Failed"
            client.leave()
    finally:
        EFFECTERS.discard(Launcher.kind)


def test_open_moves_the_fingers_and_what_is_out_of_range_fails(world, client):
    assert status(client, "Gripper", "Gripper", "Open", 1) == "OK"
    for _ in range(60):
        world.step()
    fingers = world.state(client.robot).joint_pos[-2:]
    np.testing.assert_allclose(fingers, LEVER * np.sin(0.5), atol=5e-4)
    for bad in ("2", "-0.5", "nan", ""):
        assert status(client, "Gripper", "Gripper", "Open", bad) == "Failed"
    assert status(client, "gripper", "GRIPPER", "open", "0.0") == "OK"
    for _ in range(60):
        world.step()
    np.testing.assert_allclose(world.state(client.robot).joint_pos[-2:], 0.0, atol=5e-4)


def test_open_and_drive_leave_each_others_orders_alone(world, client):
    say(client, "DRIVE {Left 1} {Right 2}")
    assert status(client, "Gripper", "Gripper", "Animate", 0.6) == "OK"
    say(client, "DRIVE {Light True}")
    told = client.robot.command.target
    finger = joint_names(TAGGER).index("LeftFinger")
    np.testing.assert_allclose(told[[0, 1, finger]], [1.0, 2.0, LEVER * np.sin(0.3)], rtol=1e-6)
    assert bool(client.robot.command.light)
    say(client, "DRIVE {Left 0} {Right 0} {Light False}")


@pytest.mark.parametrize(
    ("kind", "name", "opcode"),
    [
        ("Gripper", "Hand", "Open"),  # no such name
        ("RollerTable", "Gripper", "Open"),  # another type
        ("Gripper", "Gripper", "Fire"),  # no such operation
        ("Headlight", "Lamp", "Open"),
    ],
)
def test_what_nothing_matches_fails(client, kind, name, opcode):
    assert status(client, kind, name, opcode, 1) == "Failed"


def test_tags_fall_below_the_robot_until_there_are_none(world, client):
    before = len(tags_of(world))
    for _ in range(20):
        world.step()
    place = world.state(client.robot).pos + np.array([-0.3, -0.1, 0.0])
    for left in (3, 2, 1):
        assert status(client, "RFIDReleaser", "Gun", "TagsRemaining") == str(left)
        assert status(client, "RFIDReleaser", "Gun", "Release") == "OK"
    assert status(client, "RFIDReleaser", "Gun", "TagsRemaining") == "0"
    assert status(client, "RFIDReleaser", "Gun", "Release") == "Failed"
    tags = tags_of(world)[before:]
    assert len(tags) == 3
    np.testing.assert_allclose(tags[:, :2], np.tile(place[:2], (3, 1)), atol=2e-3)  # 0.3 m behind: its lean
    np.testing.assert_allclose(tags[:, 2], -0.4, atol=1e-5)
    assert status(client, "RFIDReleaser", "Gun", "Reset") == "OK"
    assert status(client, "RFIDReleaser", "Gun", "TagsRemaining") == "3"


def test_the_next_client_gets_a_full_releaser_and_the_tags_stay(world):
    first = connect(world)
    assert status(first, "RFIDReleaser", "Gun", "Release") == "OK"
    before = len(tags_of(world))
    first.leave()
    second = connect(world)
    assert status(second, "RFIDReleaser", "Gun", "TagsRemaining") == "3"
    assert len(tags_of(world)) == before
    second.leave()


def test_a_tag_falls_on_the_ramp_that_the_robot_stands_over(live):
    client = Client(live, "peer")
    say(client, "INIT {ClassName Tagger} {Location 1.2,0.0,-1.0}")
    assert status(client, "RFIDReleaser", "Gun", "Release") == "OK"
    x, y, z = tags_of(live)[-1]
    client.leave()
    # The ramp's upper face: through its centre, half its thickness up, rising by 15 degrees along x.
    rise = np.tan(np.radians(15))
    top = -0.4 + 0.055 + 0.1 / np.cos(np.radians(15)) + (x - 1.05) * rise
    assert (x, y) == pytest.approx((0.9, -0.1), abs=1e-5)
    assert z == pytest.approx(top, abs=1e-4)


def test_the_headlight_shows_in_sta_and_obeys_drive_too(world, client):
    def shown():
        for _ in range(10):
            world.step()
        client.session.data_to_send()
        client.robot.next_report = world.time
        client.report()
        return parse_message(client.session.data_to_send().decode().split("\r\n")[0]).get("LightToggle")

    assert shown() == "False"
    assert status(client, "Headlight", "Lamp", "Activate") == "OK"
    assert shown() == "True"
    assert status(client, "Headlight", "Lamp", "Activate", 0) == "OK"
    assert shown() == "False"
    say(client, "DRIVE {Light True}")
    assert shown() == "True"
    assert status(client, "Headlight", "Lamp", "NOP") == "OK"
    assert shown() == "False"


def test_an_empty_battery_answers_nothing_and_does_nothing(live):
    client = connect(live)
    before = len(tags_of(live))
    live.edit(client.robot, battery_start=round(-TAGGER.battery_life / live.period))
    assert say(client, "SET {Type RFIDReleaser} {Name Gun} {Opcode Release}") == []
    assert len(tags_of(live)) == before
    client.leave()


def test_of_a_sensor_and_an_effecter_the_type_decides(spotter):
    assert status(spotter, "Headlight", "Beacon", "Activate") == "OK"
    assert bool(spotter.robot.command.light)
    assert status(spotter, "Sonar", "Beacon", "Activate") == "Failed"


def test_rollers_turn_at_the_speed_that_was_set(live, spotter):
    assert status(spotter, "RollerTable", "Roller", "Animate", -4) == "OK"
    for _ in range(50):
        live.step()
    joints = [name.startswith("Roller") for name in joint_names(SPOTTER)]
    rates = live.state(spotter.robot).joint_vel[np.array(joints)]
    np.testing.assert_allclose(rates, -4.0, rtol=0.01)


def test_the_limit_that_conf_told_is_accepted(spotter):
    """CONF cuts 1.5707963 to 1.5707; a client may as well round it up."""
    assert status(spotter, "Gripper", "Gripper", "Open", 1.5707) == "OK"
    assert status(spotter, "Gripper", "Gripper", "Open", 1.5708) == "OK"


# GEO and CONF


@pytest.mark.parametrize(
    ("asked", "answer"),
    [
        ("GETGEO {Type Gripper}", rf"GEO {{Type Gripper}} {{Name Gripper {POSE} Mount Lift_Link1}}"),
        (
            "GETGEO {Type Headlight} {Name lamp}",
            r"GEO {Type Headlight} {Name Lamp Location 0\.2000,0\.0000,-0\.1000 "
            r"Orientation 0\.0000,0\.1000,0\.0000 Mount HARD}",
        ),
        (
            "GETGEO {Type Effecter}",
            rf"GEO {{Type Effecter}} {{Name Gun {POSE} Mount HARD}} {{Name Lamp {POSE} Mount HARD}} "
            rf"{{Name Gripper {POSE} Mount Lift_Link1}}",
        ),
        ("GETGEO {Type Gripper} {Name Hand}", r"GEO {Type Gripper} {Name Hand}"),
        (
            "GETCONF {Type Gripper}",
            r"CONF {Type Gripper} {Name Gripper} {Opcode Open} {MaxVal 1\.5700} {MinVal 0\.0000} .*",
        ),
        (
            "GETCONF {Type Effecter}",
            r"CONF {Type Effecter} {Name Gun} {Opcode Release} {MaxVal 0\.0000} {MinVal 0\.0000} "
            r"{Opcode TagsRemaining} .*{Name Lamp} {Opcode Activate} {MaxVal 1\.0000} {MinVal 0\.0000} .*"
            r"{Name Gripper} {Opcode Open} {MaxVal 1\.5700} {MinVal 0\.0000} {Opcode Animate} .*",
        ),
        ("GETCONF {Type Effecter} {Name None}", r"CONF {Type Effecter} {Name None}"),
        ("GETCONF {Type RollerTable}", r"CONF {Type RollerTable}"),
    ],
)
def test_effecters_tell_where_they_are_and_what_they_understand(live, asked, answer):
    client = connect(live)
    (line,) = say(client, asked)
    client.leave()
    assert re.fullmatch(answer, line), line


def test_conf_of_a_roller_table_begins_as_in_the_manual(spotter):
    """Manual 9.3: CONF {Type Effecter} {Name Roller} {Opcode Animate} {MaxVal 6}{MinVal -6}."""
    (line,) = say(spotter, "GETCONF {Type Effecter} {Name Roller}")
    start = "CONF {Type Effecter} {Name Roller} {Opcode Animate} {MaxVal 6.0000} {MinVal -6.0000}"
    assert line.startswith(start)
