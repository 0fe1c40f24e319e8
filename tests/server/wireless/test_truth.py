"""True poses at the port of USARTruth: its lines, and who is in them."""

import contextlib
from dataclasses import replace

import pytest

from tests.arenas import FLAT
from tests.handy import block
from tests.server.peers import Peer
from tests.server.radio_servers import on_air
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.server.wireless.truth import TruthSession
from usarmjx.server.worlds.dynamic_world import DynamicWorld


@pytest.fixture(scope="module")
def world():
    world = DynamicWorld(replace(FLAT, loose=(block((4.0, 1.0), name="crate"),)))
    world.spawn(P2AT, "R1", (1.0, -2.0, 0.4), (0.0, 0.0, 0.5))
    world.spawn(ROBOTS.get("AirRobot"), "My flyer", (0.0, 3.0, 1.0), (0.0, 0.0, 0.0))
    world.step()
    return world


def ask(world, text):
    *found, end, rest = TruthSession(world).receive_data(text.encode()).decode().split("\r\n")
    assert (end, rest) == ("{End}", "")
    return found


# USARTruthConnection.uc: {Name} {Class} {Time} {Location} {Rotation}, metres and radians, y right and z down.
ROBOT = "{Name R1} {Class P3AT} {Time 0.0200} {Location 1.00,2.00,-0."
CRATE = "{Name crate} {Class WCObject} {Time 0.0200} {Location 4.00,-1.00,"


def test_a_line_of_each_robot_has_its_true_pose(world):
    first, second = ask(world, "{}\r\n")
    assert first.startswith(ROBOT)
    assert first.endswith(",-0.50}") or first.endswith(",-0.49}")
    assert second.startswith("{Name My_flyer} {Class AirRobot} {Time 0.0200} {Location 0.00,-3.00,")
    assert second.replace("-0.00", "0.00").endswith(" {Rotation 0.00,0.00,0.00}")


@pytest.mark.parametrize(
    ("line", "begins"),
    [
        ("{class P3AT} {name R1}", [ROBOT]),
        ("{Class USARBot.P2AT}", [ROBOT]),
        ("{name r1}", [ROBOT]),
        ("TRUTH {class p3at}", [ROBOT]),
        ("{class P3AT} {name R2}", []),
        ("{class Zerg}", []),
        ("{class WCObject}", [CRATE]),
        ("{class USARPhysObj.WCObject} {name crate}", [CRATE]),
        ("{name crate}", []),
        ("{class {Zerg}", []),
    ],
)
def test_class_and_name_select(world, line, begins):
    found = ask(world, f"{line}\r\n")
    assert len(found) == len(begins)
    for text, start in zip(found, begins, strict=True):
        assert text.startswith(start)


def test_lines_come_in_any_chunks(world):
    session = TruthSession(world)
    assert session.receive_data(b"{class Ze") == b""
    assert session.receive_data(b"rg}\r\n{class Zerg}\n") == b"{End}\r\n{End}\r\n"


def test_it_has_a_port_if_one_is_asked_for(world):
    with on_air(DynamicWorld(FLAT), truth_port=0) as radio:
        assert len({radio.port, *radio.ports.values()}) == 5
        radio.robot("R7", 1.0)
        with contextlib.closing(Peer(radio.ports["truth"], "{name R7}")) as peer:
            assert b"{Name R7} {Class ComStation}" in peer.line()
            assert peer.line() == b"{End}"
    with on_air(DynamicWorld(FLAT)) as radio:
        assert "truth" not in radio.ports
