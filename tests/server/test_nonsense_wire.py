"""SET, GETGEO and GETCONF with nonsense, of the absent and of several: every type of one robot, one table.

Nothing changes, and the answer names what failed. Manual 8 (tables 6 and 8), 9.2, 9.3, 10.6.
"""

from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.handy import GRIPPER, TAGGER, known
from tests.server import peers
from tests.transcripts import strict
from usarmjx.base.settings import SHARE, Parameters
from usarmjx.models.compile.physics import Physics
from usarmjx.models.effecters import EFFECTERS, effecters_of
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount
from usarmjx.sensors.suite import SENSORS
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.protocol.dialects import UDK
from usarmjx.server.protocol.grammar import format_message, parse_message
from usarmjx.server.worlds.dynamic_world import DynamicWorld

CAMERA = P2AT.cameras[0]
# Tests of other files may register sensors of their own.
OF_SENSORS = {kind: sensor for kind, sensor in SENSORS if sensor.__module__.startswith("usarmjx.")}
KINDS = tuple(kind for kind in OF_SENSORS if kind != "Sonar")
PARENTS = {"Encoder": "LeftFWheel"}
EVERYTHING = replace(
    TAGGER,
    name="Everything",
    sensors=(
        *(Mount(kind=kind, name=f"{kind}1", parent=PARENTS.get(kind, "HARD")) for kind in KINDS),
        *(Mount(kind="Sonar", name=f"F{i}", at=(0.2, 0.1 * i, 0.0)) for i in range(2)),
    ),
    cameras=(CAMERA, replace(CAMERA, name="Second")),
    effecters=(
        *TAGGER.effecters[:2],
        Mount(kind="RollerTable", name="Roller", at=(0.0, 0.0, -0.2)),
        GRIPPER,
        Mount(kind="Vacuum", name="Cup", at=(0.3, 0.0, -0.1)),
    ),
)
OF_EFFECTERS = {effecter.kind: effecter for effecter in effecters_of(EVERYTHING)}
TYPES = (*OF_SENSORS, "Camera", *OF_EFFECTERS)
FORMS = {
    **{(kind, opcode): form for kind, one in OF_SENSORS.items() for opcode, form in one.opcodes.items()},
    **{(kind, code.name): code.parameters for kind, one in OF_EFFECTERS.items() for code in one.opcodes},
    # Those that no table has: the server itself carries them out (manual 10.9.3, KRobot.uc).
    **dict.fromkeys([("RFID", "Read"), ("RFID", "Write"), ("Camera", "Zoom")], Parameters(1, 1)),
    ("Joint", "Angle"): Parameters(0, 2),
    ("Joint", "Stiffness"): Parameters(1, 1, SHARE),
}
"""Form of the parameters of every opcode of every type."""
OPCODES = sorted({opcode for _, opcode in FORMS} | {"", "Explode"})
NONSENSE = ("abc", "1abc", "1 2 3 4 5 6 7", "a,b,c,d,e,f", "0.1 x", "nan", "inf", "1;2", "0.1,0.2,0.3")


def nonsense_for(form):
    """Every kind of nonsense for parameters of a form: words, too few, too many, out of range."""
    yield from NONSENSE
    yield " ".join(["1"] * (form.most + 1))
    if form.fewest:
        yield " ".join(["1"] * (form.fewest - 1))
    limits = form.note
    yield from (str(limit) for limit in (limits.ge and limits.ge - 1, limits.le and limits.le + 1) if limit)


def test_the_robot_has_every_type_of_the_tables():
    assert {mount.kind for mount in EVERYTHING.sensors} == set(OF_SENSORS)
    assert {kind for kind, one in EFFECTERS if one.__module__.startswith("usarmjx.")} == set(OF_EFFECTERS)
    assert len(FORMS) > len(OF_EFFECTERS) + 6


@pytest.fixture(scope="module")
def client():
    with known(EVERYTHING):
        world = DynamicWorld(FLAT, Physics(), 1, max_robots=1)
        client = Client(world, "peer")
        say(client, "INIT {ClassName Everything} {Name R}")
        for _ in range(20):
            world.step()
        client.session.data_to_send()
        yield client
        client.leave()


def say(client, line):
    """Let a client send a line; return the lines that it receives at once, which have no empty segment."""
    lines = peers.say(client, line)
    for message in map(parse_message, lines):
        assert all(value for _, value in message.segments), f"a segment without a value: {message}"
    return lines


def name_of(kind):
    """The name of the robot's first item of a type."""
    mounts = (*EVERYTHING.sensors, *EVERYTHING.effecters, *EVERYTHING.cameras)
    return "LeftFWheel" if kind == "Joint" else next(m.name for m in mounts if m.kind == kind)


def state_of(client):
    """All that a SET could change."""
    world = client.robot and client._world
    parts = (
        client.robot.command,
        world.memory(client.robot).own,
        world.one_world()[0].tags,
        client.robot.fovs,
    )
    return [np.array(leaf) for leaf in jax.tree.leaves(parts)]


@pytest.mark.parametrize("kind", [*TYPES, "Joint"])
def test_every_opcode_refuses_every_nonsense_and_nothing_changes(client, kind):
    """Those of all other types, too, which this one does not have."""
    before, name = state_of(client), name_of(kind)
    for opcode in OPCODES:
        for params in nonsense_for(FORMS.get((kind, opcode), Parameters())):
            (line,) = say(
                client, f"SET {{Type {kind}}} {{Name {name}}} {{Opcode {opcode}}} {{Params {params}}}"
            )
            assert line.startswith("RES {Time ")
            assert line.endswith(f"{{Type {kind}}} {{Name {name}}} {{Status Failed}}"), (opcode, params)
    for one, other in zip(before, state_of(client), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("kind", [*TYPES, "Joint", "Nonsense"])
def test_a_set_of_the_absent_fails_under_its_name(client, kind):
    for opcode in ("RESET", "Open", "Angle"):
        (line,) = say(client, f"SET {{Type {kind}}} {{Name Nobody}} {{Opcode {opcode}}} {{Params 0.1}}")
        assert line.endswith(f"{{Type {kind}}} {{Name Nobody}} {{Status Failed}}")


def test_a_set_without_a_name_fails_without_one(client):
    """Manual 9.2: a segment is a pair; a strict reader takes two words at a time."""
    (line,) = say(client, "SET {Type Gripper} {Opcode Open} {Params 0.2}")
    assert line.endswith("{Type Gripper} {Status Failed}")
    (line,) = say(client, "SET {Type Gripper} {Name two words} {Opcode Open} {Params 0.2}")
    assert line.endswith("{Type Gripper} {Status Failed}")


@pytest.mark.parametrize("ask", ["GETGEO", "GETCONF"])
@pytest.mark.parametrize("kind", TYPES)
def test_what_is_there_tells_more_than_an_echo_and_what_is_not_does_not(client, kind, ask):
    answer, name = ask[3:], name_of(kind)
    assert say(client, f"{ask} {{Type {kind}}} {{Name Nobody}}") == [
        f"{answer} {{Type {kind}}} {{Name Nobody}}"
    ]
    (line,) = say(client, f"{ask} {{Type {kind}}} {{Name {name}}}")
    assert line.startswith(f"{answer} {{Type {kind}}} {{")
    assert line != f"{answer} {{Type {kind}}} {{Name {name}}}"


@pytest.mark.parametrize("ask", ["GETGEO", "GETCONF"])
@pytest.mark.parametrize(("kind", "names"), [("Sonar", ("F0", "F1")), ("Camera", (CAMERA.name, "Second"))])
def test_of_several_each_is_named(client, kind, names, ask):
    (line,) = say(client, f"{ask} {{Type {kind}}}")
    assert [value.split()[0] for value in parse_message(line).all("Name")] == list(names)


def readings(client, seconds):
    """Lines of a client's reports while its world goes on."""
    world, lines = client._world, []
    client.session.data_to_send()
    for _ in range(round(seconds / world.period)):
        world.step()
        if client.due():
            world.observe([client.robot])
            client.report()
        lines += client.session.data_to_send().decode().splitlines()
    return lines


def test_messages_of_every_type_are_pairs_in_both_ages(client):
    """Manual 9.2: a segment is name/value pairs; the later versions have one pair in a segment."""
    releaser = name_of("RFIDReleaser")
    (released,) = say(client, f"SET {{Type RFIDReleaser}} {{Name {releaser}}} {{Opcode Release}}")
    assert released.endswith("{Status OK}")
    say(client, "SET {Type Kinect} {Name Kinect1} {Opcode SCAN}")
    lines = readings(client, 2.0)
    types = {parse_message(line).get("Type") for line in lines if line.startswith("SEN")}
    assert types >= set(OF_SENSORS)
    for ask in ("GETGEO", "GETCONF"):
        lines += [
            line
            for kind in (*TYPES, "MisPkg", "Actuator", "Robot")
            for line in say(client, f"{ask} {{Type {kind}}}")
        ]
    for line in lines:
        strict.parse(line, strict.MANUAL)
        for later in UDK.translate(parse_message(line), "P3AT"):
            strict.parse(format_message(later), strict.LATER)
