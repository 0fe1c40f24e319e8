"""Dialect B of the wireless server: who takes part, and which port numbers lead to whom.

Its messages are in `wireless_b`. A number is given out per caller, robot called and port, and stays the same
for as long as the caller takes part. It can be called only while the radio carries the pair, from the
address of the robot that it was given to. Names are matched exactly; robots in the world are found by name
in any case.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from usarmjx.server.wireless.channel import Air, Presence, reaches

MOST_NUMBERS = 64
"""Numbers that one robot may hold."""
NUMBERS_IN_ALL = 256
"""Numbers of all robots: a socket each, of the 1024 that a process often has."""
MOST_PIPES = 32
"""Pipes that one robot may have at a time."""
PIPES_IN_ALL = 128
"""Pipes of all robots, two sockets each."""
GRACE = 30.0
"""Whoever takes part and is not in the world yet has so long to appear [s of real time]."""


@dataclass(frozen=True, slots=True)
class Route:
    """A way from one robot to a port of another."""

    caller: str
    called: str
    port: int


@dataclass(slots=True)
class Number:
    """The port number that stands for a route.

    Attributes:
        number: The port on the server's machine.
        open: Whether it can be called.
    """

    number: int
    open: bool = False


@dataclass(slots=True)
class Station:
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
        air: The radio.
        allocate: Returns a port number for a route, None when there is none left. It stays ours.
        now: The time that passes for a client [s].
    """

    def __init__(self, air: Air, allocate: Callable[[Route], int | None], now: Callable[[], float]) -> None:
        self.air = air
        self._allocate, self._now = allocate, now
        self._stations: dict[str, Station] = {}
        self._numbers: dict[Route, Number] = {}
        self._opened: list[Route] = []
        self._pipes: dict[int, Route] = {}  # by the port that we dial from

    def has(self, name: str) -> bool:
        """Return whether a robot takes part."""
        return name in self._stations

    def join(self, name: str, address: str, ports: tuple[int, ...]) -> None:
        """Let a robot take part."""
        self._stations[name] = Station(address, ports, self._now(), seen=self.air.has(name))

    def leave(self, name: str) -> tuple[list[Route], list[Route]]:
        """Forget a robot; return the routes from it, which are gone, and those to it, which are closed."""
        self._stations.pop(name, None)
        gone = [route for route in self._numbers if route.caller == name]
        for route in gone:
            del self._numbers[route]
        closed = [route for route, number in self._numbers.items() if route.called == name and number.open]
        for route in closed:
            self._numbers[route].open = False
        return gone, closed

    def ports_of(self, name: str) -> tuple[int, ...]:
        """Return where a robot takes calls; nothing if it does not take part."""
        station = self._stations.get(name)
        return station.ports if station else ()

    def address_of(self, name: str) -> str:
        """Return where a robot's controller is, "" if it does not take part."""
        station = self._stations.get(name)
        return station.address if station else ""

    def number_of(self, route: Route) -> int | None:
        """Return the number that stands for a route, a new one if need be; None if none can be had."""
        if route not in self._numbers:
            held = sum(other.caller == route.caller for other in self._numbers)
            room = held < MOST_NUMBERS and len(self._numbers) < NUMBERS_IN_ALL
            port = self._allocate(route) if room else None
            if port is None:
                return None
            self._numbers[route] = Number(port)
        number = self._numbers[route]
        if not number.open and self._is_carried(route):
            number.open = True
            self._opened.append(route)
        return number.number

    def take_opened(self) -> list[Route]:
        """Return the routes that can be called since somebody asked for their numbers, and forget them."""
        opened, self._opened = self._opened, []
        return opened

    def failed(self, route: Route) -> None:
        """Note that a route's number could not be opened: the next look tries again."""
        if route in self._numbers:
            self._numbers[route].open = False

    def is_open(self, route: Route) -> bool:
        """Return whether the number of a route can be called as of the last look."""
        return route in self._numbers and self._numbers[route].open

    def look(self) -> Changes:
        """See who is in the world and which routes the radio carries."""
        present = {robot.name.lower(): robot for robot in reversed(self.air.present())}
        gone = tuple(name for name in self._stations if self._is_gone(name, present.get(name.lower())))
        opened: list[Route] = []
        closed: list[Route] = []
        for route, number in self._numbers.items():
            carried = self._is_carried(route) and not {route.caller, route.called} & set(gone)
            if carried != number.open:
                number.open = carried
                (opened if carried else closed).append(route)
        return Changes(gone, tuple(opened), tuple(closed))

    def may_call(self, route: Route, address: str) -> bool:
        """Return whether a call from an address on a route's number is let through now."""
        count = Counter(name for pipe in self._pipes.values() for name in (pipe.caller, pipe.called))
        return (
            self.is_open(route)
            and self._is_carried(route)
            and address == self.address_of(route.caller)
            and max(count[route.caller], count[route.called]) < MOST_PIPES
            and len(self._pipes) < PIPES_IN_ALL
        )

    def connected(self, route: Route, port: int) -> None:
        """Note a pipe by the port that we dialled its far end from."""
        self._pipes[port] = route

    def ended(self, *ports: int) -> None:
        """Note that the pipes dialled from these ports are gone."""
        for port in ports:
            self._pipes.pop(port, None)

    def caller_at(self, name: str, port: int) -> str:
        """Return who calls a robot from one of our ports, "" if nobody does."""
        pipe = self._pipes.get(port)
        return pipe.caller if pipe and pipe.called == name else ""

    def _is_carried(self, route: Route) -> bool:
        taken = route.port in self.ports_of(route.called) and route.caller in self._stations
        return taken and reaches(self.air, route.caller, route.called)

    def _is_gone(self, name: str, robot: Presence | None) -> bool:
        station = self._stations[name]
        if robot is not None and not robot.battery_empty:
            station.seen = True
            return False
        return robot is not None or station.seen or self._now() - station.since > GRACE
