r"""Dialect B of the wireless server, that of the later stand-alone server: routes and control connection.

A line, ended by "\r\n", and its answer:

    INIT {Robot R1} {Port 3333,2323}     INITREPLY {Status OK}
    GETSS {Robot R2}                     SS {Robot R2} {Strength -51.4309}
    DNS {Robot R2} {Port 3333}           DNSREPLY {Robot R2} {Port 43847}
    REVERSEDNS {Port 51234}              REVERSEDNSREPLY {Port 51234} {Robot R1}

INIT comes first and once. A robot that connects to the port of a DNSREPLY is connected to the other robot's
port; that one asks REVERSEDNS for the name of its caller. Errors are answered in the stand-alone server's
words, its misspelling included. Its parser is strict: verbs and keys with case, one space after the verb and
between segments, one word as a value.

A port of the server is forwarded per caller, robot called and port, and
stays the same for as long as the caller is a participant. It is open only while the radio carries the pair,
to the address of the robot that it was given to. Names are matched exactly; robots in the world are found by
name in any case.
"""

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from usarmjx.server.protocol.grammar import LineBuffer, Message, format_message, is_auth
from usarmjx.server.wireless.channel import RadioAccess, RadioRobot, reaches

MAX_PORTS_PER_ROBOT = 64
"""Forwarded ports that one robot may hold."""
MAX_PORTS = 256
"""Forwarded ports of all robots: a socket each, of the 1024 that a process often has."""
MAX_CONNECTIONS_PER_ROBOT = 32
"""Proxied connections that one robot may have at a time."""
MAX_CONNECTIONS = 128
"""Proxied connections of all robots, two sockets each."""
JOIN_TIMEOUT = 30.0
"""Time that a participant has to enter the world after joining [s of real time]."""
MAX_LINE_SIZE = 1024
"""Longest line accepted [bytes]."""
_SEGMENT = re.compile(r"\{([^{}\t]*)\}( |$)")


@dataclass(frozen=True, slots=True)
class Route:
    """Route from one robot to a port of another."""

    caller: str
    callee: str
    port: int


@dataclass(slots=True)
class ForwardedPort:
    """The port of the server that is forwarded along a route.

    Attributes:
        port: The port on the server's machine.
        is_open: Whether it accepts connections.
    """

    port: int
    is_open: bool = False


@dataclass(slots=True)
class Participant:
    """A robot that has joined.

    Attributes:
        address: Address of its controller.
        ports: Listening ports of its controller; the first is meant when none is named.
        since: Time at which it joined [s of real time].
        seen: Whether the robot has been in the world since, or was then.
    """

    address: str
    ports: tuple[int, ...]
    since: float
    seen: bool = False


@dataclass(frozen=True, slots=True)
class Changes:
    """Changes since the last poll of the world.

    Attributes:
        gone: Participants that have to leave: not in the world, or without battery.
        opened: Routes whose ports open now.
        closed: Routes whose ports close; their proxied connections end.
    """

    gone: tuple[str, ...]
    opened: tuple[Route, ...]
    closed: tuple[Route, ...]


class Switchboard:
    """The participants, the forwarded ports, and the proxied connections.

    Args:
        radio: The radio.
        allocate: Reserves a port for a route; None when there is none left.
        now: Returns the real time [s].
        may_dial: Whether an address may be dialled at a port; other ports of a robot are ignored.
    """

    def __init__(
        self,
        radio: RadioAccess,
        allocate: Callable[[Route], int | None],
        now: Callable[[], float],
        may_dial: Callable[[str, int], bool] = lambda address, port: True,
    ) -> None:
        self.radio = radio
        self._allocate, self._now, self._may_dial = allocate, now, may_dial
        self._participants: dict[str, Participant] = {}
        self._forwarded_ports: dict[Route, ForwardedPort] = {}
        self._opened: list[Route] = []
        self._connections: dict[int, Route] = {}  # by the port that we connect from

    def has(self, name: str) -> bool:
        """Return whether a robot has joined."""
        return name in self._participants

    def join(self, name: str, address: str, ports: tuple[int, ...]) -> None:
        """Add a participant."""
        # Ports of the server itself are dropped without an answer: a forward to them would open its inside to
        # peers.
        ports = tuple(port for port in ports if self._may_dial(address, port))
        self._participants[name] = Participant(address, ports, self._now(), seen=self.radio.has_robot(name))

    def leave(self, name: str) -> tuple[list[Route], list[Route]]:
        """Remove a participant; return the routes from it, now gone, and those to it, now closed."""
        self._participants.pop(name, None)
        gone = [route for route in self._forwarded_ports if route.caller == name]
        for route in gone:
            del self._forwarded_ports[route]
        closed = [
            route
            for route, forwarded in self._forwarded_ports.items()
            if route.callee == name and forwarded.is_open
        ]
        # Routes to it keep their ports, only closed: their callers may have cached them.
        for route in closed:
            self._forwarded_ports[route].is_open = False
        return gone, closed

    def ports_of(self, name: str) -> tuple[int, ...]:
        """Return the listening ports of a robot; none if it has not joined."""
        participant = self._participants.get(name)
        return participant.ports if participant else ()

    def address_of(self, name: str) -> str:
        """Return the address of a robot's controller, "" if it has not joined."""
        participant = self._participants.get(name)
        return participant.address if participant else ""

    def forwarded_port(self, route: Route) -> int | None:
        """Return the forwarded port of a route, a new one if need be; None if there is none left."""
        if route not in self._forwarded_ports:
            held = sum(other.caller == route.caller for other in self._forwarded_ports)
            room = held < MAX_PORTS_PER_ROBOT and len(self._forwarded_ports) < MAX_PORTS
            port = self._allocate(route) if room else None
            if port is None:
                return None
            # A route keeps its port while its caller is here: clients cache the answer of DNS.
            self._forwarded_ports[route] = ForwardedPort(port)
        forwarded = self._forwarded_ports[route]
        # Opened at once, not with the next poll: the caller connects right after the answer.
        if not forwarded.is_open and self._is_carried(route):
            forwarded.is_open = True
            self._opened.append(route)
        return forwarded.port

    def take_opened(self) -> list[Route]:
        """Return the routes that opened on request since the last call."""
        opened, self._opened = self._opened, []
        return opened

    def failed(self, route: Route) -> None:
        """Record that a route's port could not be opened: the next poll tries again."""
        if route in self._forwarded_ports:
            self._forwarded_ports[route].is_open = False

    def is_open(self, route: Route) -> bool:
        """Return whether the port of a route is open as of the last poll."""
        return route in self._forwarded_ports and self._forwarded_ports[route].is_open

    def poll(self) -> Changes:
        """Return the changes of participants in the world and of routes that the radio carries."""
        # In reverse, so that of robots with one name the first counts.
        present = {robot.name.lower(): robot for robot in reversed(self.radio.present())}
        gone = tuple(name for name in self._participants if self._is_gone(name, present.get(name.lower())))
        opened: list[Route] = []
        closed: list[Route] = []
        for route, forwarded in self._forwarded_ports.items():
            carried = self._is_carried(route) and not {route.caller, route.callee} & set(gone)
            if carried != forwarded.is_open:
                forwarded.is_open = carried
                (opened if carried else closed).append(route)
        return Changes(gone, tuple(opened), tuple(closed))

    def may_call(self, route: Route, address: str) -> bool:
        """Return whether a connection from an address to a route's port is accepted now."""
        # Recounted from the connections: a counter of its own could drift when a peer vanishes.
        count = Counter(name for other in self._connections.values() for name in (other.caller, other.callee))
        return (
            self.is_open(route)
            and self._is_carried(route)
            and address == self.address_of(route.caller)
            and max(count[route.caller], count[route.callee]) < MAX_CONNECTIONS_PER_ROBOT
            and len(self._connections) < MAX_CONNECTIONS
        )

    def add_connection(self, route: Route, port: int) -> None:
        """Add a proxied connection, by our local port at its far end."""
        self._connections[port] = route

    def remove_connections(self, *ports: int) -> None:
        """Remove the proxied connections of these local ports."""
        for port in ports:
            self._connections.pop(port, None)

    def caller_at(self, name: str, port: int) -> str:
        """Return the robot that is connected to another through a local port, "" if there is none."""
        route = self._connections.get(port)
        return route.caller if route and route.callee == name else ""

    def _is_carried(self, route: Route) -> bool:
        listens = route.port in self.ports_of(route.callee) and route.caller in self._participants
        return listens and reaches(self.radio, route.caller, route.callee)

    def _is_gone(self, name: str, robot: RadioRobot | None) -> bool:
        participant = self._participants[name]
        if robot is not None and not robot.battery_empty:
            participant.seen = True
            return False
        # With an empty battery it is gone at once; a robot that never came has its time to enter the world.
        return robot is not None or participant.seen or self._now() - participant.since > JOIN_TIMEOUT


def parse_strict(line: str) -> tuple[str, dict[str, str]]:
    """Return verb and values of a line, up to where it leaves the form `VERB {Key Value} {Key Value}`.

    A segment without a value has the value ""; one with more than one word has none.
    """
    verb, _, rest = line.partition(" ")
    values: dict[str, str] = {}
    at = 0
    while found := _SEGMENT.match(rest, at):
        words = found[1].split(" ")
        # A segment of more words has no value, and the segments behind it still count.
        if len(words) <= 2:
            values[words[0]] = "".join(words[1:])
        at = found.end()
    return verb, values


class DialectBPhase(Enum):
    """Phase of a control connection."""

    NEW = "new"
    JOINED = "joined"


TRANSITIONS: dict[DialectBPhase, dict[str, DialectBPhase]] = {
    DialectBPhase.NEW: {"INIT": DialectBPhase.JOINED},
    DialectBPhase.JOINED: {
        "GETSS": DialectBPhase.JOINED,
        "DNS": DialectBPhase.JOINED,
        "REVERSEDNS": DialectBPhase.JOINED,
    },
}
WRONG_PHASE_REASONS = {
    DialectBPhase.NEW: "Must.Use.INIT.Method.First",
    DialectBPhase.JOINED: "Method.Unknown.Or.Can.INIT.only.once",
}
"""Reason of the error for any other verb."""
NO_NAME, NO_PORT = "Robot.Name.Must.Not.Be.Empty", "Port.Must.Be.Integer"


class _Error(Exception):
    """Error that is answered `ERROR {Reason ...}`."""


class DialectBSession:
    """One control connection: lines in any chunking, answered in order.

    Args:
        board: The participants.
        address: The peer's address, at which its robot listens.

    Attributes:
        phase: Phase of the connection.
        name: Name of the robot that it has joined as, "" before.
    """

    def __init__(self, board: Switchboard, address: str) -> None:
        self.phase = DialectBPhase.NEW
        self.name = ""
        self._board, self._address = board, address
        self._lines = LineBuffer(MAX_LINE_SIZE)
        self._answers = {
            "INIT": self._init,
            "GETSS": self._getss,
            "DNS": self._dns,
            "REVERSEDNS": self._reverse_dns,
        }

    @property
    def alive(self) -> bool:
        """Whether the peer has joined: then it may be silent, as it ends with its robot."""
        return bool(self.name)

    def receive_data(self, data: bytes) -> bytes:
        """Return the answers to the lines that `data` completes.

        Raises:
            HttpRequestError: The peer speaks HTTP; hang up.
        """
        return b"".join(self._answer(line) for line in self._lines.feed(data))

    def _answer(self, line: str) -> bytes:
        if is_auth(line):  # said twice, or to a server without a token
            return b""
        verb, values = parse_strict(line)
        try:
            if verb not in TRANSITIONS[self.phase]:
                raise _Error(WRONG_PHASE_REASONS[self.phase])
            answer = self._answers[verb](values)
            # After the answer: a refused INIT leaves the connection where it was.
            self.phase = TRANSITIONS[self.phase][verb]
        except _Error as error:
            answer = Message("ERROR", (("Reason", str(error)),))
        return format_message(answer).encode("latin-1", "replace") + b"\r\n"

    def _init(self, values: dict[str, str]) -> Message:
        listed, reason = values.get("Port", ""), "Ports.List.Must.Be.Integer"
        listed_ports = [_port(text, reason, least=0) for text in listed.split(",") if listed]
        ports = tuple(port for port in listed_ports if port)  # 0: a robot that only calls others
        name = _name(values)
        if self._board.has(name):
            # Misspelt in the stand-alone server: clients may compare the text.
            raise _Error("Robot.Alread.Exists")
        self._board.join(name, self._address, ports)
        self.name = name
        return Message("INITREPLY", (("Status", "OK"),))

    def _getss(self, values: dict[str, str]) -> Message:
        other = _name(values)
        power = self._board.radio.signal_strength(self.name, other)
        if other == self.name:
            strength, error = "INF", "SS.To.Self"
        elif not self._board.has(other):
            strength, error = "NaN", "Robot.Does.Not.Exist"
        elif power == float("inf"):
            strength, error = "INF", "Model.Returned.INF"
        # `not power <= 0` is true for NaN, too.
        elif power is None or not power <= 0:
            strength, error = "NaN", "Model.Returned.NaN"
        else:
            strength, error = f"{power:.6g}", ""  # as C++ streams print a double
        segments = (("Robot", other), ("Strength", strength))
        return Message("SS", (*segments, ("Error", error)) if error else segments)

    def _dns(self, values: dict[str, str]) -> Message:
        # Port 0 names none: then the first of the robot's ports is meant.
        asked = _port(values["Port"], NO_PORT, least=0) if "Port" in values else 0
        other = _name(values)
        ports = self._board.ports_of(other)
        if not self._board.has(other) or other == self.name:
            return _no_port(other, "NoSuchRobot")
        if not ports or (asked and asked not in ports):
            return _no_port(other, "RobotDoesNotListenOnThisPort")
        port = self._board.forwarded_port(Route(self.name, other, asked or ports[0]))
        if port is None:
            raise _Error("Could.Not.Allocate.Port")
        return Message("DNSREPLY", (("Robot", other), ("Port", str(port))))

    def _reverse_dns(self, values: dict[str, str]) -> Message:
        port = _port(values.get("Port", ""), NO_PORT, least=0)
        caller = self._board.caller_at(self.name, port)
        answer = ("Robot", caller) if caller else ("Error", "UnknownOrIllegalPort")
        return Message("REVERSEDNSREPLY", (("Port", str(port)), answer))


def _name(values: dict[str, str]) -> str:
    name = values.get("Robot", "")
    if not name:
        raise _Error(NO_NAME)
    return name


def _port(text: str, reason: str, least: int = 1) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) <= 5 and least <= int(text) < 65536):
        raise _Error(reason)
    return int(text)


def _no_port(robot: str, error: str) -> Message:
    return Message("DNSREPLY", (("Robot", robot), ("Port", "-1"), ("Error", error)))
