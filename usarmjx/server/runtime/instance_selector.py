"""Selection of the served world of a batch: a line with its number on standard input."""

import asyncio
import logging
import sys
from typing import TextIO

from usarmjx.base.errors import UsageError
from usarmjx.server.worlds.batch_world import BatchWorld

log = logging.getLogger(__name__)


class InstanceSwitch:
    """Reads numbers of worlds from a terminal; a `gamebots.server.Service`.

    Args:
        world: The served world.
        worlds: Number of worlds in its batch.
        stream: The terminal.
    """

    def __init__(self, world: BatchWorld, worlds: int, stream: TextIO = sys.stdin) -> None:
        self._world, self._worlds, self._stream = world, worlds, stream
        self._listening = False

    async def start(self) -> list[str]:
        """Listen, if the stream is a terminal."""
        self._listening = self._stream.isatty()
        if not self._listening:
            return []
        asyncio.get_running_loop().add_reader(self._stream, self._read)
        return [f"another world: type its number, 0 to {self._worlds - 1}"]

    def _read(self) -> None:
        line = self._stream.readline()
        if not line:  # the terminal has gone
            self.stop()
        elif line.strip():
            self.select(line.strip())

    def select(self, line: str) -> None:
        """Serve the world of that number; log the reason if it cannot be served."""
        try:
            if not line.isdecimal():
                raise UsageError(f"{line!r} is not the number of a world")
            self._world.switch(int(line))
        except UsageError as error:
            log.warning("the world stays: %s", error)
        else:
            print(f"usarmjx: world {line} is served now", flush=True)

    def tick(self) -> None:
        """Do nothing."""

    def stop(self) -> None:
        """Stop listening."""
        if self._listening:
            self._listening = False
            asyncio.get_running_loop().remove_reader(self._stream)
