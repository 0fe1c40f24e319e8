"""Dialect A of the wireless server: tables of registrations, listening ports and links.

Its messages and replies are in `dialect_a`. Names are matched exactly here, as in the in-engine server;
robots in the world are found by name in any case. Our own rules beyond that server's: it connects to no
address but the registering peer's own, unless the operator has allowed it; no client makes it connect to a
port of another peer that has not asked for that with LISTEN; and a name whose robot has left the world may be
registered from another address.
"""

import ipaddress
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from typing import TypeAlias

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.server.wireless.channel import RadioAccess, reaches

MAX_REGISTRATIONS = 256
"""Registered robots at a time."""
MAX_LISTEN_PORTS = 64
"""Ports that one robot may be listening on at a time."""
MAX_LINKS_PER_ROBOT = 32
"""Data links that one robot may have at a time."""
MAX_LINKS = 128
"""Data links of all robots: two sockets each, of the 1024 that a process often has."""


class Refusal(PeerError):
    """Refusal of a message; its text follows `Fail: `."""


INCORRECT = "Incorrect Message"
NO_CONNECTION = "Could not establish connection"
THIRD_PARTY = "Server does not accept third party requests"


@dataclass(frozen=True, slots=True)
class Register:
    """REGISTER RobotName IPAddress: address of a robot's controller."""

    name: str
    address: str


@dataclass(frozen=True, slots=True)
class Listen:
    """LISTEN RobotName Port: a robot's controller accepts a link there."""

    name: str
    port: int


@dataclass(frozen=True, slots=True)
class Open:
    """OPEN RobotName Port HostRobot HostPort: link two robots, one of which must have sent a LISTEN.

    The in-engine server and its tools looked for the last two in the table; by the manual (3.2.4.3)
    the first two listen: either is accepted.
    """

    name: str
    port: int
    host: str
    host_port: int


@dataclass(frozen=True, slots=True)
class GetSS:
    """GETSS Robot1 Robot2: the power received between them."""

    one: str
    other: str


Request: TypeAlias = Register | Listen | Open | GetSS


@dataclass(frozen=True, slots=True)
class Endpoint:
    """Address of one end of a link."""

    name: str
    address: str
    port: int


@dataclass(frozen=True, slots=True)
class EndpointPair:
    """Link to make: the server connects to both ends."""

    first: Endpoint
    second: Endpoint

    @property
    def names(self) -> tuple[str, str]:
        """Names of the robots at the two ends."""
        return self.first.name, self.second.name


def normalize_address(text: str) -> str:
    """Return an IP address in its usual form, so that two spellings of one compare equal.

    Raises:
        Refusal: It is no IP address; "localhost" is taken as 127.0.0.1.
    """
    try:
        address = ipaddress.ip_address("127.0.0.1" if text.lower() == "localhost" else text.partition("%")[0])
    except ValueError as error:
        raise Refusal(INCORRECT) from error
    mapped = getattr(address, "ipv4_mapped", None)
    return str(mapped or address)


def check_addresses(addresses: Collection[str]) -> tuple[str, ...]:
    """Return IP addresses in their usual form.

    Raises:
        UsageError: One is no address.
    """
    try:
        return tuple(normalize_address(address) for address in addresses)
    except Refusal as error:
        raise UsageError(f"{', '.join(addresses)}: an IP address is expected") from error


@dataclass(frozen=True, slots=True)
class Registration:
    """A registered robot.

    Attributes:
        address: Address at which its controller takes links.
        owner: Address of the peer that registered it; differs from `address` only where the operator allows
            that.
    """

    address: str
    owner: str


class ComServer:
    """State shared by all control connections: registrations, and listening ports. Names are matched exactly.

    Args:
        radio: The radio.
        allowed: Addresses that anyone may register, beside his own.
    """

    def __init__(self, radio: RadioAccess, allowed: Collection[str] = ()) -> None:
        self._radio = radio
        self._allowed = frozenset(normalize_address(address) for address in allowed)
        self._registrations: dict[str, Registration] = {}
        self._listening: dict[str, list[int]] = {}
        self._links: Counter[str] = Counter()
        self._seen: set[str] = set()

    def register(self, caller: str, ask: Register) -> None:
        """Register a robot, or register it again.

        Raises:
            Refusal: The address is not the caller's, or the name is taken.
        """
        address = normalize_address(ask.address)
        if address != caller and address not in self._allowed:
            raise Refusal(f"Address {ask.address} is not yours")
        known = self._registrations.get(ask.name)
        if known and known.address != address and not self._has_left(ask.name):
            raise Refusal(f"Robot with name {ask.name} already registered")
        if not known and len(self._registrations) >= MAX_REGISTRATIONS:
            self._make_room()
        if not known or known.address != address:
            self._forget(ask.name)
            self._registrations[ask.name] = Registration(address, caller)

    def listen(self, caller: str, ask: Listen) -> None:
        """Record that a robot's controller takes a link on a port; one OPEN uses it up.

        Raises:
            Refusal: The robot is not registered, not the caller's, or listens there already.
        """
        if ask.name not in self._registrations:
            raise Refusal(f"Robot {ask.name} not registered")
        if not self._owns(caller, ask.name):
            raise Refusal(THIRD_PARTY)
        ports = self._listening.setdefault(ask.name, [])
        if ask.port in ports:
            raise Refusal(f"Robot with name {ask.name} already listening at port {ask.port}")
        if len(ports) >= MAX_LISTEN_PORTS:
            raise Refusal(f"Robot with name {ask.name} already listening at {MAX_LISTEN_PORTS} ports")
        ports.append(ask.port)

    def open(self, caller: str, ask: Open) -> EndpointPair:
        """Return the ends to connect to; report the result with `opened`.

        Raises:
            Refusal: Neither robot listens there, they do not reach each other, or one is unknown.
        """
        # Clients disagree on the order of an OPEN's robots, see `Open`.
        ask = self._listener_last(ask)
        if not self._owns(caller, ask.name) and not self._owns(caller, ask.host):
            raise Refusal(THIRD_PARTY)
        if not reaches(self._radio, ask.name, ask.host):
            raise Refusal(f"Cannot connect to {ask.host}")
        if ask.name not in self._registrations or self._is_full(ask):
            raise Refusal(NO_CONNECTION)
        if not self._owns(caller, ask.name) and not self._listens(ask.name, ask.port):
            raise Refusal(f"{ask.name} not listening on port {ask.port}")
        endpoints = EndpointPair(
            Endpoint(ask.name, self._registrations[ask.name].address, ask.port),
            Endpoint(ask.host, self._registrations[ask.host].address, ask.host_port),
        )
        self._listening[ask.host].remove(ask.host_port)
        self._links.update(endpoints.names)
        return endpoints

    def opened(self, endpoints: EndpointPair, done: bool) -> None:
        """Record whether both ends answered; if not, the host goes on listening."""
        if not done:
            self.closed(endpoints)
            ports = self._listening.get(endpoints.second.name)
            if ports is not None and endpoints.second.port not in ports:
                ports.append(endpoints.second.port)

    def closed(self, endpoints: EndpointPair) -> None:
        """Record the end of a link."""
        self._links.subtract(endpoints.names)
        self._links += Counter()  # forgets names at zero

    def signal_strength(self, caller: str, ask: GetSS) -> float:
        """Return the power received between two robots [dBm].

        Raises:
            Refusal: None of them is the caller's, one is not in the world, or they are too close together.
        """
        if not self._owns(caller, ask.one) and not self._owns(caller, ask.other):
            raise Refusal(THIRD_PARTY)
        power = self._radio.signal_strength(ask.one, ask.other)
        if power is None or power > 0:
            raise Refusal("Could not calculate signal strength")
        return power

    def alive(self, name: str) -> bool:
        """Return whether a name is registered and such a robot in the world."""
        return name in self._registrations and self._radio.has_robot(name)

    def poll_presence(self) -> None:
        """Record the robots in the world, so that `_has_left` can tell departed robots from expected ones."""
        self._seen |= {name for name in self._registrations if self._radio.has_robot(name)}

    def _owns(self, caller: str, name: str) -> bool:
        registration = self._registrations.get(name)
        return registration is not None and caller in (registration.address, registration.owner)

    def _listens(self, name: str, port: int) -> bool:
        return port in self._listening.get(name, ())

    def _listener_last(self, ask: Open) -> Open:
        """Return an OPEN with the listening robot in second position.

        Raises:
            Refusal: Neither listens.
        """
        if self._listens(ask.host, ask.host_port):
            return ask
        if self._listens(ask.name, ask.port):
            return Open(ask.host, ask.host_port, ask.name, ask.port)
        raise Refusal(f"{ask.host} not listening on port {ask.host_port}")

    def _has_left(self, name: str) -> bool:
        return name in self._seen and not self._radio.has_robot(name)

    def _is_full(self, ask: Open) -> bool:
        busiest = max(self._links[ask.name], self._links[ask.host])
        return busiest >= MAX_LINKS_PER_ROBOT or self._links.total() >= 2 * MAX_LINKS

    def _make_room(self) -> None:
        """Forget the oldest registration without a robot."""
        for name in self._registrations:
            if not self._radio.has_robot(name):
                return self._forget(name)
        raise Refusal("Too many robots registered")

    def _forget(self, name: str) -> None:
        self._registrations.pop(name, None)
        self._listening.pop(name, None)
        self._seen.discard(name)
