"""Clients over websockets that come, look for a while and go: browsers at the page, and ROS at rosbridge."""

import asyncio
import contextlib
import itertools
import json
from contextlib import AbstractContextManager
from importlib.metadata import version
from threading import Thread

import numpy as np
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import WebSocketException
from websockets.typing import Subprotocol

from benchmarks.chaos.target import Target
from benchmarks.onlooker import camera_message

STAY = (20.0, 120.0)
"""Time for which one looks before it comes again [s]."""
PAUSE = 1.0
"""Time after which one that was refused comes again [s]."""
TOPICS = ("/tf", "/clock")
"""Topics that a client of rosbridge subscribes to."""


class Onlookers(AbstractContextManager["Onlookers"]):
    """Websocket clients in a thread: at the page and at rosbridge in turn, where there are such ports.

    Args:
        target: The server.
        count: Number of clients at once.
        seed: Seed of their stays.
        stay: Shortest and longest stay [s].

    Attributes:
        visits: Number of connections so far.
        lost: Number of connections that were refused or broken off.
        received: Size of the messages so far [bytes].
    """

    def __init__(self, target: Target, count: int, seed: int = 0, stay: tuple[float, float] = STAY) -> None:
        self._random, self._stay, self._count = np.random.default_rng(seed), stay, count
        self._places = [
            (port, look)
            for port, look in ((target.page_port, _page), (target.rosbridge_port, _rosbridge))
            if port is not None
        ]
        self._host = target.host
        self.visits = self.lost = self.received = 0
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._run, name="onlookers", daemon=True)

    def __enter__(self) -> "Onlookers":
        """Let them come."""
        if self._places:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Let them go."""
        if self._places:
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._end)
            self._thread.join()
        self._loop.close()

    def _end(self) -> None:
        for task in asyncio.all_tasks(self._loop):
            task.cancel()

    def _run(self) -> None:
        async def main() -> None:
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.gather(*(self._visit(first) for first in range(self._count)))

        self._loop.run_until_complete(main())

    async def _visit(self, first: int) -> None:
        for number in itertools.count(first):
            port, look = self._places[number % len(self._places)]
            until = self._loop.time() + self._random.uniform(*self._stay)
            self.visits += 1
            try:
                async with look(self._host, port) as connection:
                    await self._listen(connection, port, until)
            except (OSError, WebSocketException):
                self.lost += 1
                await asyncio.sleep(PAUSE)

    async def _listen(self, connection: ClientConnection, port: int, until: float) -> None:
        if port == self._places[0][0] and self._places[0][1] is _page:
            await connection.send(camera_message())
        else:
            for topic in TOPICS:
                await connection.send(json.dumps({"op": "subscribe", "topic": topic}))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout_at(until):
                async for message in connection:
                    self.received += len(message)
                self.lost += 1


def _page(host: str, port: int) -> connect:
    protocol = Subprotocol(f"viser-v{version('viser')}")
    return connect(f"ws://{host}:{port}/", subprotocols=[protocol], max_size=None, compression=None)


def _rosbridge(host: str, port: int) -> connect:
    return connect(f"ws://{host}:{port}/", max_size=None, compression=None)
