"""The console without panes: lines of a file or a pipe go out, messages come in, line by line."""

import asyncio
import os
import stat
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import IO

from usarmjx.base.errors import UsageError
from usarmjx.cli.console.client import READ_SIZE, ConsoleClient

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
        lines: What to send; empty ones and those that begin with `#` are not, `@sleep 1.5` waits, and
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
        await asyncio.wait([listener], timeout=linger)
        if listener.done():
            listener.result()
    finally:
        listener.cancel()
        client.close()


class _Talk:
    """A script that runs.

    Attributes:
        unseen: Lines since the last one sent, for `@until`.
    """

    def __init__(self, client: ConsoleClient, show: Callable[[str], None]) -> None:
        self._client, self._show = client, show
        self._unseen: list[str] = []
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
            self._unseen.clear()
            await self._client.send(line)

    async def _wait_for(self, beginning: str, patience: float) -> None:
        try:
            async with asyncio.timeout(patience):
                while True:
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
        return True


async def _lines_of(pipe: int) -> AsyncIterator[str]:
    """Yield the lines of a pipe or terminal."""
    reader, loop = asyncio.StreamReader(), asyncio.get_running_loop()

    def take() -> None:
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
