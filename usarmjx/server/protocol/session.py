"""Dialogue of one client: bytes in -> commands, messages -> bytes out; it knows no socket.

A server feeds it as follows, where only the last command of a list can be an Init:

    commands = session.receive_data(data)
    while commands:
        for command in commands:
            ...
        commands = session.answer_init(accepted) if session.awaits_answer else []
    transport.write(session.data_to_send())
"""

from collections import deque

from usarmjx.base.errors import PeerError
from usarmjx.base.registry import is_name
from usarmjx.server.protocol.command_parsers import parse_command
from usarmjx.server.protocol.commands import (
    LEGAL_COMMANDS,
    Command,
    Ignored,
    Init,
    InvalidSet,
    SessionPhase,
)
from usarmjx.server.protocol.dialects import MANUAL, Dialect
from usarmjx.server.protocol.grammar import (
    DEFAULT_LIMIT,
    LineBuffer,
    Message,
    clip,
    format_message,
    is_auth,
    parse_message,
)

SEND_LIMIT = 1 << 20
"""Most that may wait to be sent [bytes].

A robot sends a few kB of reports per second: a peer this far behind has not read for minutes.
"""
MAX_FAULTS = 32
"""Faults kept for the log between two `take_faults`; the rest is only counted."""
MAX_FAULT_SIZE = 1000
"""Longest fault [characters]: room for the names of all robot classes."""
REFUSAL_FAULTS = 50
"""Faults in a row that a refused INIT counts as: a client that left may have many more under way."""
MAX_WAITING = 256
"""Lines kept while an INIT is not answered yet."""


class RobotSession:
    """The protocol state of one connection.

    A line that cannot be used becomes a fault for the log and has no other effect: the lines after
    it count, and the connection stays.

    Args:
        greeting: First line of the server.
        line_limit: Longest line accepted [bytes].
        send_limit: Most that may wait to be sent [bytes].
        dialect: Vocabulary of both sides.

    Attributes:
        phase: Phase of the dialogue.
        dialect: Vocabulary of both sides.
        robot_class: Class of the robot, as the last INIT named it; "" before.
        fault_count: Number of faults so far.
        faults_in_a_row: Number of unusable lines since the last usable one.
    """

    def __init__(
        self,
        greeting: Message,
        line_limit: int = DEFAULT_LIMIT,
        send_limit: int = SEND_LIMIT,
        dialect: Dialect = MANUAL,
    ) -> None:
        self.phase = SessionPhase.GREETED
        self.dialect, self.robot_class = dialect, ""
        self._lines = LineBuffer(line_limit)
        self._send_limit = send_limit
        self._outgoing = bytearray()
        self._faults: list[str] = []
        self._more_faults = self.fault_count = self.faults_in_a_row = 0
        self._awaits_answer = False
        self._refusal = ""
        self._waiting: deque[str] = deque()
        self.send(greeting)

    @property
    def awaits_answer(self) -> bool:
        """Whether an Init was returned that `answer_init` has not answered yet."""
        return self._awaits_answer

    def receive_data(self, data: bytes) -> list[Command]:
        """Take bytes in any chunking and return the legal commands that they complete, in order.

        An Init is the last command of the list, whatever follows it in the data: those lines wait
        for `answer_init`, because their legality depends on the answer.

        Raises:
            HttpRequestError: The peer speaks HTTP; hang up.
        """
        if self.phase is SessionPhase.CLOSED:
            return []
        lines = self._lines.feed(data)
        # A fault for each of them: a client that sends nothing else is dropped for faults in a row.
        for _ in range(self._lines.take_too_long()):
            self._fault(f"a line of more than {self._lines.limit} bytes is skipped")
        return self._take(lines)

    def receive_eof(self) -> list[Command]:
        """Return the command of a last line that the peer did not end before it stopped sending."""
        return [] if self.phase is SessionPhase.CLOSED else self._take(self._lines.end())

    def answer_init(self, accepted: bool) -> list[Command]:
        """Record whether the robot of the last Init exists now.

        Nothing is sent in either case. After a refusal (an unknown class, no room left) the client
        may send another INIT.

        Returns:
            The legal commands that waited for the answer; another Init among them is the last.
        """
        if not self._awaits_answer:
            return []
        self._awaits_answer = False
        if accepted:
            self.phase, self.faults_in_a_row = SessionPhase.ACTIVE, 0
        else:
            self._fault(f"INIT refused: {self._refusal}" if self._refusal else "INIT is refused")
            # `_fault` has counted one already.
            self.faults_in_a_row += REFUSAL_FAULTS - 1
        self._refusal = ""
        return self._take([])

    def note_refusal(self, reason: str) -> None:
        """Record the reason of the coming refusal of the last Init, for the log."""
        self._refusal = reason

    def add_fault(self, reason: str) -> None:
        """Add a fault of a legal command, for the log."""
        self.fault_count += 1
        if len(self._faults) < MAX_FAULTS:
            self._faults.append(reason if len(reason) <= MAX_FAULT_SIZE else f"{reason[:MAX_FAULT_SIZE]}...")
        else:
            self._more_faults += 1

    def take_faults(self) -> list[str]:
        """Return the faults since the last call, for the log."""
        faults, more = self._faults, self._more_faults
        self._faults, self._more_faults = [], 0
        return [*faults, f"{more} more faults"] if more else faults

    def send(self, message: Message) -> None:
        r"""Append a message and its end "\r\n" to the bytes that wait to be sent; nothing if closed.

        Segments without a value are left out: a segment is a pair (manual 9.2).

        Raises:
            PeerError: The peer does not read, more than the limit would wait. Drop it.
        """
        if self.phase is SessionPhase.CLOSED:  # a tick cannot know that its reader has just left
            return
        said = self.dialect.translate(message, self.robot_class)
        # All lines of a message before any is added: one that cannot be written leaves none of them.
        translated = [format_message(_in_pairs(one)) for one in said]
        line = "".join(f"{one}\r\n" for one in translated).encode("latin-1", "replace")
        # Checked before it is added: the bound holds whatever the length of a line.
        if len(self._outgoing) + len(line) > self._send_limit:
            raise PeerError(f"the peer does not read: {len(self._outgoing)} bytes wait for it")
        self._outgoing += line

    @property
    def has_data(self) -> bool:
        """Whether bytes wait to be sent."""
        return bool(self._outgoing)

    def data_to_send(self) -> bytes:
        """Return the bytes that wait and forget them.

        Call it when the socket can take them: bytes in the socket's own buffer are not counted.
        """
        data = bytes(self._outgoing)
        self._outgoing.clear()
        return data

    def close(self) -> None:
        """End the dialogue: nothing more is read or sent."""
        self.phase = SessionPhase.CLOSED
        self._awaits_answer = False
        self._waiting.clear()
        self._outgoing.clear()

    def _take(self, lines: list[str]) -> list[Command]:
        self._waiting.extend(lines)
        commands: list[Command] = []
        while self._waiting and not self._awaits_answer:
            command = self._parse(self._waiting.popleft())
            if command is not None:
                commands.append(command)
                # Lines behind an INIT wait: whether they are legal depends on its answer.
                self._awaits_answer = isinstance(command, Init)
        while len(self._waiting) > MAX_WAITING:
            # The last ones are dropped: those that came first are next to be carried out.
            self._fault(f"too many lines before the INIT is answered: {clip(self._waiting.pop())}")
        return commands

    def _parse(self, line: str) -> Command | None:
        """Return the line's command if it is legal now; otherwise note the fault."""
        if is_auth(line):  # said twice, or to a server without a token; its text must not get into a log
            return None
        message = None
        try:
            message = self.dialect.understand(parse_message(line))
            command = parse_command(message)
        except PeerError as error:
            self._fault(f"{error}: {clip(line)}")
            return self._invalid_set(message)
        if isinstance(command, Ignored):
            self._fault(f"{command.reason}: {clip(line)}")
            return self._invalid_set(message)
        if type(command) not in LEGAL_COMMANDS[self.phase]:
            self._fault(f"{type(command).__name__} is ignored when {self.phase.value}")
            return None
        if isinstance(command, Init):  # its answer decides whether it was of any use
            # In the client's spelling for now: the adapter has that of the class once the robot exists.
            self.robot_class = command.class_name
        else:
            self.faults_in_a_row = 0
        return command

    def _invalid_set(self, message: Message | None) -> InvalidSet | None:
        """Return the answer to an unusable line, if it is a robot's SET that names a type."""
        is_set = message is not None and message.kind == "SET" and self.phase is SessionPhase.ACTIVE
        if message is None or not is_set or not is_name(message.get("Type")):
            return None
        return InvalidSet(message.get("Type"), message.get("Name"))

    def _fault(self, reason: str) -> None:
        self.faults_in_a_row += 1
        self.add_fault(reason)


def _in_pairs(message: Message) -> Message:
    """Return a message without the segments that have no value."""
    if "" not in [value for _, value in message.segments]:
        return message
    return Message(message.kind, tuple(segment for segment in message.segments if segment[1]))
