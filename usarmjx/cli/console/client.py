"""A connection to a server's port for robots, and the console without panes: lines out, messages in."""

import asyncio
import os
import re
import stat
import sys
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import IO

from usarmjx.base.errors import PeerError, UsageError, WriteError
from usarmjx.cli.console.knowledge import Knowledge
from usarmjx.server.network.access import AUTH
from usarmjx.server.protocol.grammar import LineBuffer, Message, parse_message

SENT, RECEIVED, NOTE = ">", "<", "#"
"""Directions: from us, to us; and what is no message, as that the connection was lost."""


class Transcript:
    """A file of lines `2026-01-31T12:00:00.123Z > DRIVE {Left 1}`; `>` was sent, `<` came, `#` is a remark.

    Args:
        path: The file, which is continued if it is there; None: nothing is kept.
        now: Tells the time.

    Raises:
        WriteError: It cannot be written.
    """

    def __init__(self, path: Path | None, now: Callable[[], datetime] = lambda: datetime.now(UTC)) -> None:
        self._path, self._now = path, now
        self._file: IO[str] | None = None
        if path is not None:
            try:
                # Line by line, so that what there was is there whatever becomes of the console.
                self._file = path.open("a", encoding="utf-8", buffering=1)
            except OSError as error:
                raise WriteError(f"--transcript: cannot write {path}: {error.strerror}") from error

    def write(self, direction: str, line: str) -> None:
        """Add a line.

        Raises:
            WriteError: It cannot be written.
        """
        if self._file is None:
            return
        when = self._now().astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        try:
            self._file.write(f"{when} {direction} {line}\n")
        except OSError as error:
            # Given up: otherwise each further line would raise anew.
            self._file = None
            raise WriteError(f"--transcript: cannot write {self._path}: {error.strerror}") from error

    def __enter__(self) -> "Transcript":
        """Begin."""
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()


LONGEST_LINE = 1 << 20
"""Longest line that is taken [bytes]: a scan in three dimensions has many numbers."""
READ_SIZE = 65536
TIMEOUT = 10.0
"""Longest time for a connection [s]."""
SECRET = re.compile(rf"^(\s*{AUTH}\b).*", re.IGNORECASE | re.DOTALL)
"""A line with a token, which no transcript and no pane shows."""


@dataclass(frozen=True)
class Received:
    """A line of the server.

    Attributes:
        line: The line, without its end.
        message: Meaning; None: nothing that the protocol has.
    """

    line: str
    message: Message | None

    @property
    def kind(self) -> str:
        """Its type, for the panes."""
        return self.message.kind if self.message else "?"


class ConsoleClient:
    """A connection, which is a robot's once INIT was sent.

    Args:
        host: The server.
        port: Its port for robots.
        token: Line that it expects first; empty: it does not.
        transcript: Record of all lines; None: none.

    Attributes:
        knowledge: Facts from its messages.
    """

    def __init__(self, host: str, port: int, token: str = "", transcript: Transcript | None = None) -> None:
        self.host, self.port, self.knowledge = host, port, Knowledge()
        self._token, self._transcript = token, transcript or Transcript(None)
        self._reader: asyncio.StreamReader | None = None
        self._writer: asyncio.StreamWriter | None = None

    @property
    def is_connected(self) -> bool:
        """Whether it is connected."""
        # A writer that closes is still there, but what is written to it is lost.
        return self._writer is not None and not self._writer.is_closing()

    async def connect(self) -> None:
        """Connect; what was known is forgotten.

        Raises:
            UsageError: There is no such server.
        """
        self.close()
        self.knowledge = Knowledge()
        try:
            # The system's own limit for a connection is minutes.
            async with asyncio.timeout(TIMEOUT):
                self._reader, self._writer = await asyncio.open_connection(self.host, self.port)
        except (OSError, TimeoutError) as error:
            reason = failure_of(error)
            raise UsageError(f"no connection to {self.host}:{self.port}: {reason}") from error
        self._transcript.write(NOTE, f"connected to {self.host}:{self.port}")
        if self._token:
            # By `send`, which keeps the token out of the transcript.
            await self.send(f"{AUTH} {{Token {self._token}}}")

    async def send(self, line: str) -> str:
        """Send a line.

        Returns:
            The line without secrets.

        Raises:
            UsageError: There is no connection, or a line end in the line.
        """
        if self._writer is None or self._writer.is_closing():
            raise UsageError(f"not connected to {self.host}:{self.port}")
        # The server would read two commands there, the second one past the check for secrets below.
        if "\n" in line or "\r" in line:
            raise UsageError("a line has no line end inside")
        shown = SECRET.sub(r"\1 ...", line)
        self._transcript.write(SENT, shown)
        try:
            # Latin-1, as the server reads; letters that it lacks become question marks.
            self._writer.write(line.encode("latin-1", "replace") + b"\r\n")
            await self._writer.drain()
        except ConnectionError as error:
            self._writer.close()
            raise UsageError(f"{self.host}:{self.port} has hung up") from error
        # Only now: what did not go out must not count as said.
        message = _parsed(line)
        if message is not None:
            self.knowledge.said(message)
        return shown

    async def messages(self) -> AsyncIterator[Received]:
        """Yield the server's lines until it hangs up."""
        lines = LineBuffer(LONGEST_LINE)
        while self._reader is not None:
            try:
                data = await self._reader.read(READ_SIZE)
            except ConnectionError:
                # Some servers hang up by a reset of the connection.
                data = b""
            # At the end, also a last line without its line end.
            for line in lines.feed(data) if data else lines.end():
                received = Received(line, _parsed(line))
                self._transcript.write(RECEIVED, line)
                if received.message is not None:
                    self.knowledge.hear(received.message)
                yield received
            if not data:
                break
        self._transcript.write(NOTE, f"{self.host}:{self.port} has hung up")
        self.close()

    def close(self) -> None:
        """Hang up; the robot leaves."""
        if self._writer is not None:
            self._writer.close()
        self._writer = None


def failure_of(error: OSError) -> str:
    """Return why there is no connection, in words."""
    # Failed look-ups of names have negative numbers, which strerror does not know.
    if error.errno and error.errno > 0:
        return os.strerror(error.errno)
    # A timeout has no text of its own.
    return str(error) or f"no answer in {TIMEOUT:g} s"


def fault_of(line: str) -> str:
    """Return why a server cannot read a line; nothing if it can."""
    try:
        parse_message(line)
    except PeerError as error:
        return str(error)
    return ""


def _parsed(line: str) -> Message | None:
    try:
        return parse_message(line)
    except PeerError:
        return None


def parse_place(text: str, what: str = "HOST:PORT") -> tuple[str, int]:
    """Return host and port of `HOST:PORT`; only a port means this machine, `[::1]:3000` is IPv6.

    Raises:
        UsageError: It is neither.
    """
    host, _, port = text.rpartition(":")
    # Not int() alone, which also takes signs, blanks and digits of other scripts.
    if not (port.isdecimal() and port.isascii() and len(port) <= 5 and 0 < int(port) < 1 << 16):
        raise UsageError(f"{text!r} is no place; expected {what}, as 127.0.0.1:3000 or 3000")
    return host.strip("[]") or "127.0.0.1", int(port)


LONGEST_SLEEP = 86400.0
SLEEP, UNTIL = "@sleep", "@until"
"""Lines of a script that are not sent: wait for seconds, or until a message begins so."""


async def run_script(
    client: ConsoleClient,
    lines: AsyncIterator[str],
    show: Callable[[str], None],
    *,
    linger: float,
    patience: float,
) -> None:
    """Send lines and show messages, until `linger` after the last line, or the server hangs up.

    Args:
        client: A client that is connected.
        lines: Lines to send, but for empty ones and comments, which begin with `#`; `@sleep 1.5` waits, and
            `@until STA` waits for a message that begins so.
        show: Takes each message's line.
        linger: Time for which messages are shown after the last line [s].
        patience: Longest wait of `@until` [s].

    Raises:
        UsageError: A line that cannot be, `@until` has waited in vain, or the server has hung up before the
            last line.
    """
    talk = _Talk(client, show)
    listener = asyncio.create_task(talk.listen())
    try:
        async for line in lines:
            if listener.done():
                listener.result()  # what is shown goes nowhere
            await talk.carry_out(line.strip(), patience)
        # Not wait_for, which cancels the listener and raises when the time is up.
        await asyncio.wait([listener], timeout=linger)
        if listener.done():
            listener.result()
    finally:
        listener.cancel()
        client.close()


class _Talk:
    """A script that runs."""

    def __init__(self, client: ConsoleClient, show: Callable[[str], None]) -> None:
        self._client, self._show = client, show
        self._unseen: list[str] = []  # since the last line that was sent, for `@until`
        self._news = asyncio.Event()
        self._over = False

    async def listen(self) -> None:
        """Show what comes."""
        try:
            async for received in self._client.messages():
                self._show(received.line)
                self._unseen.append(received.line)
                self._news.set()
        finally:
            # After a failure, too, or `@until` would wait in vain.
            self._over = True
            self._news.set()

    async def carry_out(self, line: str, patience: float) -> None:
        """Send a line, or carry out its wait."""
        if not line or line.startswith("#"):
            return
        word, _, rest = line.partition(" ")
        if word == SLEEP:
            await asyncio.sleep(_seconds(rest))
        elif word == UNTIL:
            await self._wait_for(rest.strip(), patience)
        elif word.startswith("@"):
            raise UsageError(f"{word} is none of {SLEEP} SECONDS, {UNTIL} BEGINNING")
        else:
            # Before the line goes out: the answer may come while it is being sent.
            self._unseen.clear()
            await self._client.send(line)

    async def _wait_for(self, beginning: str, patience: float) -> None:
        try:
            async with asyncio.timeout(patience):
                while True:
                    # Cleared before looking: what comes meanwhile sets it again and is not missed.
                    self._news.clear()
                    while self._unseen:
                        if self._unseen.pop(0).startswith(beginning):
                            return
                    if self._over:
                        raise UsageError(f"{UNTIL} {beginning}: the server has hung up")
                    await self._news.wait()
        except TimeoutError as error:
            raise UsageError(f"{UNTIL} {beginning}: nothing like that came within {patience:g} s") from error


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0 <= seconds <= LONGEST_SLEEP:
        raise UsageError(f"{SLEEP} {text}: expected a number of seconds from 0 to {LONGEST_SLEEP:g}")
    return seconds


async def read_script(path: Path) -> AsyncIterator[str]:
    """Yield the lines of a file; `-` is the standard input, whose lines are taken as they come.

    Raises:
        UsageError: It cannot be read.
    """
    if str(path) == "-" and not _is_file(sys.stdin):
        async for line in _lines_of(sys.stdin.fileno()):
            yield line
        return
    try:
        text = sys.stdin.read() if str(path) == "-" else path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"--script: cannot read {path}: {error}") from error
    for line in text.splitlines():
        yield line


def _is_file(stream: IO[str]) -> bool:
    """Whether all of a stream is there: an event loop cannot wait for such ones, and need not."""
    try:
        return stat.S_ISREG(os.fstat(stream.fileno()).st_mode)
    except (OSError, ValueError):
        # A replaced standard input, as in a notebook, has no descriptor.
        return True


async def _lines_of(pipe: int) -> AsyncIterator[str]:
    """Yield the lines of a pipe or terminal."""
    reader, loop = asyncio.StreamReader(), asyncio.get_running_loop()

    def take() -> None:
        # Only bytes that have come: the stream's readline would block the loop.
        data = os.read(pipe, READ_SIZE)
        if data:
            reader.feed_data(data)
        else:
            loop.remove_reader(pipe)
            reader.feed_eof()

    loop.add_reader(pipe, take)
    try:
        while line := await reader.readline():
            yield line.decode("utf-8", "replace")
    finally:
        loop.remove_reader(pipe)
