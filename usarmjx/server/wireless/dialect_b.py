r"""Dialect B of the wireless server, its control connection: that of the later stand-alone server.

A line, ended by "\r\n", and its answer:

    INIT {Robot R1} {Port 3333,2323}     INITREPLY {Status OK}
    GETSS {Robot R2}                     SS {Robot R2} {Strength -51.4309}
    DNS {Robot R2} {Port 3333}           DNSREPLY {Robot R2} {Port 43847}
    REVERSEDNS {Port 51234}              REVERSEDNSREPLY {Port 51234} {Robot R1}

INIT comes first and once. A robot that connects to the port of a DNSREPLY is connected to the other robot's
port; that one asks REVERSEDNS for the name of its caller. Errors are answered in the stand-alone server's
words, its misspelling included. Its parser is strict: verbs and keys with case, one space after the verb and
between segments, one word as a value.
"""

import re
from enum import Enum

from usarmjx.server.protocol.grammar import LineBuffer, Message, format_message, is_auth
from usarmjx.server.wireless.switchboard import Route, Switchboard

MAX_LINE_SIZE = 1024
"""Longest line accepted [bytes]."""

_SEGMENT = re.compile(r"\{([^{}\t]*)\}( |$)")


def parse_strict(line: str) -> tuple[str, dict[str, str]]:
    """Return verb and values of a line, up to where it leaves the form `VERB {Key Value} {Key Value}`.

    A segment without a value has the value ""; one with more than one word has none.
    """
    verb, _, rest = line.partition(" ")
    values: dict[str, str] = {}
    at = 0
    while found := _SEGMENT.match(rest, at):
        words = found[1].split(" ")
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
        elif power is None or not power <= 0:
            strength, error = "NaN", "Model.Returned.NaN"
        else:
            strength, error = f"{power:.6g}", ""  # as C++ streams print a double
        segments = (("Robot", other), ("Strength", strength))
        return Message("SS", (*segments, ("Error", error)) if error else segments)

    def _dns(self, values: dict[str, str]) -> Message:
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
