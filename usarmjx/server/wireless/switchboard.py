"""Dialect B of the wireless server: who takes part, and which port numbers lead to whom.

Its messages are in `wireless_b`. A number is given out per caller, robot called and port, and stays the same
for as long as the caller takes part. It can be called only while the radio carries the pair, from the
address of the robot that it was given to. Names are matched exactly; robots in the world are found by name
in any case.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from usarmjx.server.wireless.channel import Presence, RadioAccess, reaches

MAX_PORTS_PER_ROBOT = 64
"""Numbers that one robot may hold."""
MAX_PORTS = 256
"""Numbers of all robots: a socket each, of the 1024 that a process often has."""
MAX_CONNECTIONS_PER_ROBOT = 32
"""Pipes that one robot may have at a time."""
MAX_CONNECTIONS = 128
"""Pipes of all robots, two sockets each."""
JOIN_TIMEOUT = 30.0
"""Whoever takes part and is not in the world yet has so long to appear [s of real time]."""


@dataclass(frozen=True, slots=True)
class Route:
    """A way from one robot to a port of another."""

    caller: str
    callee: str
    port: int


@dataclass(slots=True)
class ForwardedPort:
    """The port number that stands for a route.

    Attributes:
        port: The port on the server's machine.
        is_open: Whether it can be called.
    """

    port: int
    is_open: bool = False


@dataclass(slots=True)
class Participant:
    """A robot that takes part.

    Attributes:
        address: Where its controller is.
        ports: Where that takes calls; the first is meant when none is named.
        since: When it came [s of real time].
        seen: Whether the robot has been in the world since, or was then.
    """

    address: str
    ports: tuple[int, ...]
    since: float
    seen: bool = False


@dataclass(frozen=True, slots=True)
class Changes:
    """What a look at the world has changed.

    Attributes:
        gone: Robots that no longer take part: not in the world, or without battery.
        opened: Routes that can be called now.
        closed: Routes that no longer can; their pipes end.
    """

    gone: tuple[str, ...]
    opened: tuple[Route, ...]
    closed: tuple[Route, ...]


class Switchboard:
    """Who takes part, the numbers, and the pipes.

    Args:
        radio: The radio.
        allocate: Returns a port number for a route, None when there is none left. It stays ours.
        now: The time that passes for a client [s].
    """

    def __init__(
        self, radio: RadioAccess, allocate: Callable[[Route], int | None], now: Callable[[], float]
    ) -> None:
        self.radio = radio
        self._allocate, self._now = allocate, now
        self._stations: dict[str, Participant] = {}
        self._forwarded_ports: dict[Route, ForwardedPort] = {}
        self._opened: list[Route] = []
        self._connections: dict[int, Route] = {}  # by the port that we dial from

    def has(self, name: str) -> bool:
        """Return whether a robot takes part."""
        return name in self._stations

    def join(self, name: str, address: str, ports: tuple[int, ...]) -> None:
        """Let a robot take part."""
        self._stations[name] = Participant(address, ports, self._now(), seen=self.radio.has_robot(name))

    def leave(self, name: str) -> tuple[list[Route], list[Route]]:
        """Forget a robot; return the routes from it, which are gone, and those to it, which are closed."""
        self._stations.pop(name, None)
        gone = [route for route in self._forwarded_ports if route.caller == name]
        for route in gone:
            del self._forwarded_ports[route]
        closed = [
            route
            for route, number in self._forwarded_ports.items()
            if route.callee == name and number.is_open
        ]
        for route in closed:
            self._forwarded_ports[route].is_open = False
        return gone, closed

    def ports_of(self, name: str) -> tuple[int, ...]:
        """Return where a robot takes calls; nothing if it does not take part."""
        station = self._stations.get(name)
        return station.ports if station else ()

    def address_of(self, name: str) -> str:
        """Return where a robot's controller is, "" if it does not take part."""
        station = self._stations.get(name)
        return station.address if station else ""

    def forwarded_port(self, route: Route) -> int | None:
        """Return the number that stands for a route, a new one if need be; None if none can be had."""
        if route not in self._forwarded_ports:
            held = sum(other.caller == route.caller for other in self._forwarded_ports)
            room = held < MAX_PORTS_PER_ROBOT and len(self._forwarded_ports) < MAX_PORTS
            port = self._allocate(route) if room else None
            if port is None:
                return None
            self._forwarded_ports[route] = ForwardedPort(port)
        number = self._forwarded_ports[route]
        if not number.is_open and self._is_carried(route):
            number.is_open = True
            self._opened.append(route)
        return number.port

    def take_opened(self) -> list[Route]:
        """Return the routes that can be called since somebody asked for their numbers, and forget them."""
        opened, self._opened = self._opened, []
        return opened

    def failed(self, route: Route) -> None:
        """Note that a route's number could not be opened: the next look tries again."""
        if route in self._forwarded_ports:
            self._forwarded_ports[route].is_open = False

    def is_open(self, route: Route) -> bool:
        """Return whether the number of a route can be called as of the last look."""
        return route in self._forwarded_ports and self._forwarded_ports[route].is_open

    def poll(self) -> Changes:
        """See who is in the world and which routes the radio carries."""
        present = {robot.name.lower(): robot for robot in reversed(self.radio.present())}
        gone = tuple(name for name in self._stations if self._is_gone(name, present.get(name.lower())))
        opened: list[Route] = []
        closed: list[Route] = []
        for route, number in self._forwarded_ports.items():
            carried = self._is_carried(route) and not {route.caller, route.callee} & set(gone)
            if carried != number.is_open:
                number.is_open = carried
                (opened if carried else closed).append(route)
        return Changes(gone, tuple(opened), tuple(closed))

    def may_call(self, route: Route, address: str) -> bool:
        """Return whether a call from an address on a route's number is let through now."""
        count = Counter(name for pipe in self._connections.values() for name in (pipe.caller, pipe.callee))
        return (
            self.is_open(route)
            and self._is_carried(route)
            and address == self.address_of(route.caller)
            and max(count[route.caller], count[route.callee]) < MAX_CONNECTIONS_PER_ROBOT
            and len(self._connections) < MAX_CONNECTIONS
        )

    def add_connection(self, route: Route, port: int) -> None:
        """Note a pipe by the port that we dialled its far end from."""
        self._connections[port] = route

    def remove_connections(self, *ports: int) -> None:
        """Note that the pipes dialled from these ports are gone."""
        for port in ports:
            self._connections.pop(port, None)

    def caller_at(self, name: str, port: int) -> str:
        """Return who calls a robot from one of our ports, "" if nobody does."""
        pipe = self._connections.get(port)
        return pipe.caller if pipe and pipe.callee == name else ""

    def _is_carried(self, route: Route) -> bool:
        taken = route.port in self.ports_of(route.callee) and route.caller in self._stations
        return taken and reaches(self.radio, route.caller, route.callee)

    def _is_gone(self, name: str, robot: Presence | None) -> bool:
        station = self._stations[name]
        if robot is not None and not robot.battery_empty:
            station.seen = True
            return False
        return robot is not None or station.seen or self._now() - station.since > JOIN_TIMEOUT
