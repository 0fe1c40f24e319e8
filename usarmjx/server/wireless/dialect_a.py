"""Dialect A of the wireless server (manual 3.2.4.3): its tables, control connection and data links.

Bytes in, replies and links to open out; no socket. A control message is words and a `;`:

    REGISTER R1 127.0.0.1;    OK;
    LISTEN R1 4001;           OK;
    OPEN R2 4002 R1 4001;     OK;               and the server connects to R2's port 4002 and R1's 4001
    GETSS R1 R2;              OK:-51.43;

A refusal is answered `Fail: ...;`, in the words of the in-engine server. A session is fed as follows:

    endpoints = session.receive_data(data)
    while endpoints:
        endpoints = session.answer_open(connect_both(endpoints))
    transport.write(session.data_to_send())

On a data link a robot sends `SEND 5 hello;` and `CLOSE;`, and the other one receives `hello`.

Names are matched exactly, as in the in-engine server;
robots in the world are found by name in any case. Our own rules beyond that server's: it connects to no
address but the registering peer's own, unless the operator has allowed it; no client makes it connect to a
port of another peer that has not asked for that with LISTEN; and a name whose robot has left the world may be
registered from another address.
"""

import ipaddress
from collections import Counter, deque
from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.server.protocol.grammar import LineBuffer, is_auth, two_decimals
from usarmjx.server.wireless.channel import RadioAccess, reaches

MAX_REGISTRATIONS = 256
"""Registered robots at a time."""
MAX_LISTEN_PORTS = 64
"""Ports that one robot may be listening on at a time."""
MAX_LINKS_PER_ROBOT = 32
"""Data links that one robot may have at a time."""
MAX_LINKS = 128
"""Data links of all robots: two sockets each, of the 1024 that a process often has."""
MESSAGE_END = b";"
"""End of a message."""
MAX_MESSAGE_SIZE = 1024
"""Longest message accepted, its `;` not counted [bytes]: names and numbers need a few dozen."""
MAX_NAMES = 16
"""Registered robots per connection whose presence in the world keeps the connection alive."""
UNKNOWN = "Unknown Message"
MAX_PAYLOAD = 1 << 20
"""Longest payload accepted [bytes]: a camera picture has a tenth of that."""
MAX_LENGTH_DIGITS = 16
"""Most digits of a payload's length, leading zeros included."""
WORD_SIZE = 5
"""Length of the words of a data link, `SEND ` and `CLOSE` [bytes]."""


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
        # Without the zone of a link-local address (fe80::1%eth0): it names an interface of this machine only.
        address = ipaddress.ip_address("127.0.0.1" if text.lower() == "localhost" else text.partition("%")[0])
    except ValueError as error:
        raise Refusal(INCORRECT) from error
    # A dual-stack socket reports IPv4 peers as ::ffff:1.2.3.4, and clients register the plain form.
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
        # A name may move to another address once its robot has been in the world and left: its owner is gone.
        if known and known.address != address and not self._has_left(ask.name):
            raise Refusal(f"Robot with name {ask.name} already registered")
        if not known and len(self._registrations) >= MAX_REGISTRATIONS:
            self._make_room()
        # Registering again at the same address must not forget ports that listen.
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
        # The caller's own end needs no LISTEN, by the in-engine server; another's port does.
        if not self._owns(caller, ask.name) and not self._listens(ask.name, ask.port):
            raise Refusal(f"{ask.name} not listening on port {ask.port}")
        endpoints = EndpointPair(
            Endpoint(ask.name, self._registrations[ask.name].address, ask.port),
            Endpoint(ask.host, self._registrations[ask.host].address, ask.host_port),
        )
        # Taken before the connection is made: a second OPEN in between must not get the same port.
        self._listening[ask.host].remove(ask.host_port)
        # Counted before the connection is made, too: OPENs under way must not exceed the limits together.
        self._links.update(endpoints.names)
        return endpoints

    def opened(self, endpoints: EndpointPair, done: bool) -> None:
        """Record whether both ends answered; if not, the host goes on listening."""
        if not done:
            self.closed(endpoints)
            ports = self._listening.get(endpoints.second.name)
            # The robot may have registered anew, or listened again, while the server dialled.
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
        # Above 0 dBm the robots are too close together for the formula.
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
        # Two addresses own a robot: where the operator allows it, another peer may register the controller.
        return registration is not None and caller in (registration.address, registration.owner)

    def _listens(self, name: str, port: int) -> bool:
        return port in self._listening.get(name, ())

    def _listener_last(self, ask: Open) -> Open:
        """Return an OPEN with the listening robot in second position.

        Raises:
            Refusal: Neither listens.
        """
        # The in-engine server's order first: it counts when both robots listen.
        if self._listens(ask.host, ask.host_port):
            return ask
        if self._listens(ask.name, ask.port):
            return Open(ask.host, ask.host_port, ask.name, ask.port)
        raise Refusal(f"{ask.host} not listening on port {ask.host_port}")

    def _has_left(self, name: str) -> bool:
        return name in self._seen and not self._radio.has_robot(name)

    def _is_full(self, ask: Open) -> bool:
        # A link counts at both of its ends, hence twice the number of links in the total.
        busiest = max(self._links[ask.name], self._links[ask.host])
        return busiest >= MAX_LINKS_PER_ROBOT or self._links.total() >= 2 * MAX_LINKS

    def _make_room(self) -> None:
        """Forget the oldest registration without a robot."""
        # A dict keeps the order of registration: the first one without a robot is the oldest.
        for name in self._registrations:
            if not self._radio.has_robot(name):
                return self._forget(name)
        raise Refusal("Too many robots registered")

    def _forget(self, name: str) -> None:
        self._registrations.pop(name, None)
        self._listening.pop(name, None)
        # A robot must be seen under the new registration before that one may move to another address.
        self._seen.discard(name)


class DataLinkPhase(Enum):
    """Kind of the next byte of a data link."""

    WORD = "word"
    LENGTH = "length"
    PAYLOAD = "payload"
    TRAILER = "trailer"
    SKIPPING = "skipping"
    CLOSING = "closing"
    CLOSED = "closed"


WORDS = {b"SEND ": DataLinkPhase.LENGTH, b"CLOSE": DataLinkPhase.CLOSING}
"""Phase after each word; SKIPPING follows any other."""
DATA_LINK_TRANSITIONS: dict[DataLinkPhase, frozenset[DataLinkPhase]] = {
    DataLinkPhase.WORD: frozenset({*WORDS.values(), DataLinkPhase.SKIPPING}),
    DataLinkPhase.LENGTH: frozenset({DataLinkPhase.PAYLOAD, DataLinkPhase.TRAILER, DataLinkPhase.SKIPPING}),
    DataLinkPhase.PAYLOAD: frozenset({DataLinkPhase.TRAILER}),
    DataLinkPhase.TRAILER: frozenset({DataLinkPhase.WORD}),
    DataLinkPhase.SKIPPING: frozenset({DataLinkPhase.WORD}),
    DataLinkPhase.CLOSING: frozenset({DataLinkPhase.CLOSED}),
    DataLinkPhase.CLOSED: frozenset(),
}


class DataLinkParser:
    """One direction of a data link: bytes in any chunking -> messages.

    Args:
        most: Longest payload accepted [bytes].

    Attributes:
        phase: Kind of the next byte; CLOSED after a CLOSE.
    """

    def __init__(self, most: int = MAX_PAYLOAD) -> None:
        self.phase = DataLinkPhase.WORD
        self._most = most
        self._kept = bytearray()  # of the word, the length or the payload
        self._left = 0
        self._messages: list[bytes] = []
        self._take: dict[DataLinkPhase, Callable[[bytes, int], int]] = {
            DataLinkPhase.WORD: self._word,
            DataLinkPhase.LENGTH: self._length,
            DataLinkPhase.PAYLOAD: self._payload,
            DataLinkPhase.TRAILER: self._trailer,
            DataLinkPhase.SKIPPING: self._skip,
            DataLinkPhase.CLOSING: self._skip,
        }

    def receive_data(self, data: bytes) -> list[bytes]:
        """Return the messages that `data` completes, in order; none after a CLOSE.

        Raises:
            PeerError: A message is announced that is longer than allowed.
        """
        at = 0
        while at < len(data) and self.phase is not DataLinkPhase.CLOSED:
            at = self._take[self.phase](data, at)
        messages, self._messages = self._messages, []
        return messages

    # Each of these consumes bytes from `at` on and returns the next position.

    def _go(self, phase: DataLinkPhase) -> None:
        assert phase in DATA_LINK_TRANSITIONS[self.phase]
        self.phase = phase

    def _word(self, data: bytes, at: int) -> int:
        # Line ends between messages are allowed, as typed in a terminal; within a word they are not.
        while not self._kept and at < len(data) and data[at] in b"\r\n":
            at += 1
        end = at + WORD_SIZE - len(self._kept)
        self._kept += data[at:end]
        if len(self._kept) == WORD_SIZE:
            self._go(WORDS.get(bytes(self._kept), DataLinkPhase.SKIPPING))
            self._kept.clear()
        return min(end, len(data))

    def _length(self, data: bytes, at: int) -> int:
        byte = data[at : at + 1]
        if byte.isdigit():
            self._kept += byte
            # Checked digit by digit: an announced length must not be stored before it is known to be allowed.
            if len(self._kept) > MAX_LENGTH_DIGITS or int(self._kept) > self._most:
                raise PeerError(f"a message of more than {self._most} bytes is announced")
        elif byte == b" " and self._kept:
            self._left = int(self._kept)
            self._kept.clear()
            self._go(DataLinkPhase.PAYLOAD if self._left else DataLinkPhase.TRAILER)
        else:  # no number: the end of its payload is unknown, so skip to the next `;`
            self._kept.clear()
            self._go(DataLinkPhase.SKIPPING)
            return at
        return at + 1

    def _payload(self, data: bytes, at: int) -> int:
        piece = data[at : at + self._left]
        self._kept += piece
        self._left -= len(piece)
        if not self._left:
            self._go(DataLinkPhase.TRAILER)
        return at + len(piece)

    def _trailer(self, data: bytes, at: int) -> int:
        # The byte itself does not matter: any one ends a payload, whose length is known.
        del data
        self._messages.append(bytes(self._kept))
        self._kept.clear()
        self._go(DataLinkPhase.WORD)
        return at + 1

    def _skip(self, data: bytes, at: int) -> int:
        end = data.find(b";", at)
        if end < 0:
            return len(data)
        self._go(DataLinkPhase.WORD if self.phase is DataLinkPhase.SKIPPING else DataLinkPhase.CLOSED)
        return end + 1


def _port(word: str) -> int:
    # ASCII, as isdecimal takes the digits of every script; five of them, as leading zeros may be any
    # number of digits.
    if not (word.isascii() and word.isdecimal() and len(word) <= 5 and 0 < int(word) < 65536):
        raise Refusal(INCORRECT)
    return int(word)


VERBS: dict[str, tuple[int, Callable[[list[str]], Request]]] = {
    "REGISTER": (2, lambda words: Register(words[0], words[1])),
    "LISTEN": (2, lambda words: Listen(words[0], _port(words[1]))),
    "OPEN": (4, lambda words: Open(words[0], _port(words[1]), words[2], _port(words[3]))),
    "GETSS": (2, lambda words: GetSS(words[0], words[1])),
}
"""Number of words after each verb, and their parser."""


def parse_request(text: str) -> Request:
    """Return the request of a message without its `;`; the verb in any case.

    Raises:
        Refusal: No such verb, the wrong number of words, or no valid port.
    """
    verb, *words = text.split() or [""]
    if verb.upper() not in VERBS:
        raise Refusal(UNKNOWN)
    count, read = VERBS[verb.upper()]
    if len(words) != count:
        raise Refusal(INCORRECT)
    return read(words)


class DialectAPhase(Enum):
    """Phase of a control connection."""

    READY = "ready"
    OPENING = "opening"


TRANSITIONS: dict[tuple[DialectAPhase, type[Request]], DialectAPhase] = {
    (DialectAPhase.READY, Register): DialectAPhase.READY,
    (DialectAPhase.READY, Listen): DialectAPhase.READY,
    (DialectAPhase.READY, GetSS): DialectAPhase.READY,
    (DialectAPhase.READY, Open): DialectAPhase.OPENING,  # until `answer_open`; messages wait
}


class DialectASession:
    """One control connection: messages in any chunking, answered in order.

    Args:
        server: The tables.
        caller: The peer's address.

    Attributes:
        phase: Phase of the connection.
    """

    def __init__(self, server: ComServer, caller: str) -> None:
        self.phase = DialectAPhase.READY
        self._server, self._caller = server, normalize_address(caller)
        self._names: deque[str] = deque(maxlen=MAX_NAMES)
        self._pending = bytearray()
        self._skipping = False
        self._text = LineBuffer()
        self._waiting: deque[str | None] = deque()  # None: a message that was too long
        self._pending_link: EndpointPair | None = None
        self._outgoing = bytearray()

    @property
    def alive(self) -> bool:
        """Whether a robot that was registered here is in the world."""
        return any(self._server.alive(name) for name in self._names)

    def receive_data(self, data: bytes) -> EndpointPair | None:
        """Take bytes; return a link that has to be opened before anything else is answered, or None.

        Until `answer_open` messages wait, without a bound: read no more from the peer.

        Raises:
            HttpRequestError: The peer speaks HTTP; hang up.
        """
        self._text.feed(data)  # only for its refusal of HTTP: these messages have no lines
        *complete, rest = data.split(MESSAGE_END)
        for piece in complete:
            self._append(piece)
            self._waiting.append(None if self._skipping else self._pending.decode("latin-1"))
            self._pending.clear()
            self._skipping = False
        self._append(rest)
        return self._answer_all()

    def answer_open(self, done: bool) -> EndpointPair | None:
        """Record whether both ends of the last link answered; return the next link, or None."""
        if self._pending_link is None:
            return None
        self._server.opened(self._pending_link, done)
        self._pending_link, self.phase = None, DialectAPhase.READY
        self._reply("OK" if done else f"Fail: {NO_CONNECTION}")
        return self._answer_all()

    def data_to_send(self) -> bytes:
        """Return the replies that wait and forget them."""
        data = bytes(self._outgoing)
        self._outgoing.clear()
        return data

    def _append(self, piece: bytes) -> None:
        # Too long: the rest up to `;` is dropped, and one refusal answers the whole message.
        if len(self._pending) + len(piece) > MAX_MESSAGE_SIZE:
            self._pending.clear()
            self._skipping = True
        elif not self._skipping:
            self._pending += piece

    def _answer_all(self) -> EndpointPair | None:
        while self._waiting and self.phase is DialectAPhase.READY:
            text = self._waiting.popleft()
            try:
                if text is None:
                    raise Refusal(INCORRECT)
                if is_auth(text):  # said twice, or to a server without a token
                    continue
                self._answer(parse_request(text))
            except Refusal as refusal:
                self._reply(f"Fail: {refusal}")
        return self._pending_link

    def _answer(self, request: Request) -> None:
        if isinstance(request, GetSS):
            self._reply(f"OK:{two_decimals(self._server.signal_strength(self._caller, request))}")
        elif isinstance(request, Open):
            self._pending_link = self._server.open(self._caller, request)
        else:
            if isinstance(request, Register):
                self._server.register(self._caller, request)
                # A name kept twice would push another one out of the bounded queue.
                if request.name not in self._names:
                    self._names.append(request.name)
            else:
                self._server.listen(self._caller, request)
            self._reply("OK")
        # Last: a refusal leaves the method before, and the connection stays ready.
        self.phase = TRANSITIONS[self.phase, type(request)]

    def _reply(self, text: str) -> None:
        self._outgoing += text.encode("latin-1", "replace") + MESSAGE_END
