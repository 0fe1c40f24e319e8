"""A served world with its radio on real sockets, and the robots and controllers of a test in it."""

import contextlib
import itertools
import math
import re

from tests.scripts import load
from tests.server.lockstep import LOCKSTEP
from tests.server.peers import PATIENCE, Peer, serving, wait_until
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.server.wireless.net import WirelessSettings, make_wireless
from usarmjx.server.worlds.dynamic_world import DynamicWorld

REACH = 3.0  # m
SHORT = RadioSettings(cutoff=-49.67 - 10.9 * math.log10(REACH / 2))
"""A radio that reaches 3 m: the manual's formula with another cutoff."""


def crowded(arena, *kinds):
    """A world that is ready for robots of these classes, as many as come."""
    world = DynamicWorld(arena, Physics(), 1, max_robots=16)
    for kind in kinds:
        world.prepare(ROBOTS.get(kind))
    return world


def client():
    """The bundled client library."""
    return load("usarsim_client")


class Radio:
    """Connections to one running server; all are closed with it."""

    def __init__(self, port, service):
        self.port, self.ports, self.service = port, service.ports, service
        self._open = contextlib.ExitStack()

    def close(self):
        self._open.close()

    def robot(self, name, x, y=0.0, kind="ComStation"):
        """A robot's Gamebots connection; it stands there, facing along x."""
        text = f"INIT {{ClassName USARBot.{kind}}} {{Name {name}}} {{Location {x},{y},-0.9}}"
        peer = Peer(self.port, text)
        self._open.callback(peer.close)
        peer.until(b"STA")
        return peer

    def keep(self, thing):
        """Close a thing when the server goes."""
        return self._open.enter_context(thing)

    def control_a(self, *robots):
        """A control connection of dialect A that has registered some robots."""
        control = self.keep(client().WirelessA(port=self.ports["wss"], timeout=PATIENCE))
        for robot in robots:
            control.register(robot)
        return control

    def control_b(self, robot):
        """A robot's control connection of dialect B."""
        return self.keep(client().WirelessB(robot, port=self.ports["wss2"], timeout=PATIENCE))

    def link_a(self, control, one, other):
        """Both ends of a link of dialect A."""
        door = self.keep(control.listen(other))
        near = self.keep(control.connect(one, other, door.port))
        return near, self.keep(door.accept(PATIENCE))

    def pipe_b(self, one, other, name):
        """Both ends of a pipe of dialect B to the robot called so."""
        near = self.keep(one.connect(name))
        return near, self.keep(other.door.accept(PATIENCE))

    def ask_position(self, line):
        """The answer of the position service."""
        with contextlib.closing(Peer(self.ports["position"], line)) as peer:
            return peer.line().decode()

    def places(self):
        """Where the robots are, by name, in the wire's axes [m]."""
        answer = self.ask_position("GETPOS")
        found = re.findall(r"{Name (\S+) Location ([\d.,-]+) BatteryEmpty False}", answer)
        return {name: tuple(map(float, place.split(","))) for name, place in found}


@contextlib.contextmanager
def on_air(world, radio=SHORT, realtime_factor=LOCKSTEP, **settings):
    """A running server with its radio."""
    ports = WirelessSettings(wss_port=0, wss2_port=0, position_port=0, **settings)
    service = make_wireless(world, radio, ports)
    with serving(world, [service], realtime_factor=realtime_factor) as (port, _):
        connections = Radio(port, service)
        try:
            yield connections
        finally:
            connections.close()
            wait_until(lambda: not world.robots, "the robots to go")


def drain(link, size):
    """The next so many bytes of a link."""
    data = b""
    while len(data) < size:
        piece = link.receive(PATIENCE)
        assert piece, f"the link broke off after {len(data)} of {size} bytes"
        data += piece
    assert len(data) == size
    return data


def spread(count):
    """Places for robots of which all hear each other (x, y) [m]."""
    return itertools.islice(itertools.product((0.0, 0.8, 1.6), (0.0, 0.8, 1.6)), count)
