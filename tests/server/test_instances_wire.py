"""Several worlds of C MuJoCo served by one process: what their clients hear of each other is nothing."""

import contextlib
import re

import pytest

from tests.server.peers import Peer, looping, wait_until
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.models.robots import ROBOTS
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.wireless.net import WirelessSettings, make_wireless
from usarmjx.server.worlds.make import make_worlds

AIR = WirelessSettings(wss_port=0, wss2_port=0, position_port=0)
INIT = "INIT {ClassName USARBot.P2DX} {Name %s} {Location 4.5,1.9,1.8}"
"""The manual's start in the yellow arena."""


def batch_of(*instances):
    """Those of three worlds that are served."""
    how = {"engine": "c", "worlds": 3, "roster": "", "max_robots": 4, "seed": 0}
    return make_worlds("yellow", instances=instances, **how)


@pytest.fixture
def houses():
    """Servers of two of three worlds, each with its radio."""
    batch = batch_of(0, 2)
    radios = [make_wireless(world, RadioSettings(), AIR) for world in batch]
    servers = [
        BotServer(world, BotServerSettings(port=0), [radio], title=f"world {number}")
        for world, radio, number in zip(batch, radios, (0, 2), strict=True)
    ]
    with looping(servers):
        yield list(zip(servers, radios, strict=True))


def enter(house, name="R1"):
    """A robot in one of the worlds; its first report has come."""
    peer = Peer(house[0].port, INIT % name)
    peer.until(b"STA")
    return peer


def ask(house, line):
    """The answer of a world's position service."""
    with contextlib.closing(Peer(house[1].ports["position"], line)) as peer:
        return peer.line().decode()


def first_sonar(world):
    """What a robot at the manual's start hears first [m]: with noise by seed, world and step."""
    robot = world.spawn(ROBOTS.get("P2DX"), "R1", (4.5, -1.9, -1.8), (0.0, 0.0, 0.0))
    for _ in range(10):
        world.step()
    world.observe([robot])
    return robot.pending[robot.suite.index("Sonar")].tolist()


def test_robots_of_one_name_stand_at_one_place_in_two_worlds(houses):
    peers = [enter(house) for house in houses]
    for house in houses:
        place = re.match(r"POSITIONS {Robots 1} {Name R1 Location ([\d.]+),", ask(house, "GETPOS"))
        assert place, "one robot"
        assert float(place[1]) == pytest.approx(4.5, abs=1e-3)  # it leans a little as it stands
    peers[0].close()
    wait_until(lambda: ask(houses[0], "GETPOS") == "POSITIONS {Robots 0}")
    peers[1].close()


def test_no_radio_reaches_another_world(houses):
    peers = [enter(houses[0], "Here"), enter(houses[1], "There"), enter(houses[1], "Beyond")]
    there = "{From There} {To Beyond}"
    assert ask(houses[1], f"GETOBS {there}") == f"NUMOBS {there} {{ObstCount 0.00}}"
    assert ask(houses[0], f"GETOBS {there}") == f"NUMOBS {there} {{ObstCount -1}}", "they are not here"
    across = "{From Here} {To There}"
    assert ask(houses[0], f"GETOBS {across}") == f"NUMOBS {across} {{ObstCount -1}}"
    for peer in peers:
        peer.close()


def test_a_view_that_is_bound_in_one_world_is_free_in_another(houses):
    peers = [enter(house) for house in houses]
    peers[0].say("SET {Type Camera} {Robot R1} {Client 127.0.0.1}")
    peers[0].say("GETSTARTPOSES")
    peers[0].until(b"NFO {StartPoses")
    bound = [server.world.view_bindings.get("127.0.0.1", 4711) for server, _ in houses]
    assert bound[0] is not None
    assert bound[1] is None
    for peer in peers:
        peer.close()


def test_each_world_has_its_own_noise_whichever_others_are_served():
    heard = [first_sonar(world) for world in batch_of(0, 2)]
    assert heard[0] != heard[1]
    assert [first_sonar(world) for world in batch_of(2)] == heard[1:]
