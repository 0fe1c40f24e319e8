"""Dialect A of the wireless server, its control connection: the manual's messages (manual 3.2.4.3).

Bytes in, replies and links to open out; no socket. A message is words and a `;`:

    REGISTER R1 127.0.0.1;    OK;
    LISTEN R1 4001;           OK;
    OPEN R2 4002 R1 4001;     OK;               and the server connects to R2's port 4002 and R1's 4001
    GETSS R1 R2;              OK:-51.43;

What cannot be done is answered `Fail: ...;`, in the words of the in-engine server. A session is fed so:

    endpoints = session.receive_data(data)
    while endpoints:
        endpoints = session.answer_open(connect_both(endpoints))
    transport.write(session.data_to_send())
"""

from collections import deque
from collections.abc import Callable
from enum import Enum

from usarmjx.server.protocol.grammar import two_decimals
from usarmjx.server.protocol.lines import LineBuffer
from usarmjx.server.wireless.comserver import (
    INCORRECT,
    NO_CONNECTION,
    ComServer,
    EndpointPair,
    GetSS,
    Listen,
    Open,
    Refusal,
    Register,
    Request,
    normalize_address,
)

MESSAGE_END = b";"
"""Ends a message."""
MAX_MESSAGE_SIZE = 1024
"""Longest message accepted, its `;` not counted [bytes]: names and numbers need a few dozen."""
MAX_NAMES = 16
"""Of so many robots that a connection has registered it is asked whether they are in the world."""
UNKNOWN = "Unknown Message"


def _port(word: str) -> int:
    if not (word.isascii() and word.isdecimal() and len(word) <= 5 and 0 < int(word) < 65536):
        raise Refusal(INCORRECT)
    return int(word)


VERBS: dict[str, tuple[int, Callable[[list[str]], Request]]] = {
    "REGISTER": (2, lambda words: Register(words[0], words[1])),
    "LISTEN": (2, lambda words: Listen(words[0], _port(words[1]))),
    "OPEN": (4, lambda words: Open(words[0], _port(words[1]), words[2], _port(words[3]))),
    "GETSS": (2, lambda words: GetSS(words[0], words[1])),
}
"""How many words follow each verb, and what they mean."""


def parse_request(text: str) -> Request:
    """Return what a message, without its `;`, asks for; the verb in any case.

    Raises:
        Refusal: No such verb, the wrong number of words, or a port that is none.
    """
    verb, *words = text.split() or [""]
    if verb.upper() not in VERBS:
        raise Refusal(UNKNOWN)
    count, read = VERBS[verb.upper()]
    if len(words) != count:
        raise Refusal(INCORRECT)
    return read(words)


class DialectAPhase(Enum):
    """Where a control connection stands."""

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
        phase: Where it stands.
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
        self._text.feed(data)  # messages have no lines, but HTTP has
        *complete, rest = data.split(MESSAGE_END)
        for piece in complete:
            self._append(piece)
            self._waiting.append(None if self._skipping else self._pending.decode("latin-1"))
            self._pending.clear()
            self._skipping = False
        self._append(rest)
        return self._answer_all()

    def answer_open(self, done: bool) -> EndpointPair | None:
        """Say whether both ends of the last link answered; return the next link, or None."""
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
                if request.name not in self._names:
                    self._names.append(request.name)
            else:
                self._server.listen(self._caller, request)
            self._reply("OK")
        self.phase = TRANSITIONS[self.phase, type(request)]

    def _reply(self, text: str) -> None:
        self._outgoing += text.encode("latin-1", "replace") + MESSAGE_END
