"""The Gamebots server: the one module that knows sockets and the clock."""

import asyncio
import contextlib
import gc
import logging
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.server.adapter import Client
from usarmjx.server.protocol.commands import Command, Init
from usarmjx.server.worlds.served_world import ServedWorld

log = logging.getLogger(__name__)

READ_SIZE = 4096
"""Most bytes taken from a socket at once."""
MAX_SLICE = 1e-3
"""Once a client's lines have taken this long in a control step, the rest of them wait for the next [s]."""
MAX_WRITE_BUFFER = 64 * 1024
"""While this much waits in a socket's buffer, reports queue up in the session, which has its own bound."""
MAX_LAG = 0.5
"""A server that is further behind the clock than this gives up catching up [s]."""
GC_THRESHOLD = 1000
"""Young objects are looked through for garbage so often before old ones are; Python's default is 10."""
SWITCH_INTERVAL = 5e-4
"""The loop gets its turn so soon when another thread runs Python, as when JAX traces a function [s]."""


@dataclass(frozen=True)
class BotServerSettings:
    """How to serve.

    Attributes:
        host: Address to bind; loopback by default.
        port: TCP port (BotAPI.ini: ListenPort); 0 picks a free one.
        max_connections: Most clients at once (BotAPI.ini: MaxConnections).
        realtime_factor: Simulated seconds per second; 0 runs as fast as it can.
    """

    host: str = "127.0.0.1"
    port: int = 3000
    max_connections: int = 16
    realtime_factor: float = 1.0


@dataclass
class TimeSlice:
    """What a client has used of a control step.

    Attributes:
        step: World time of that step [s].
        spent: How long its lines have taken [s].
    """

    step: float = -1.0
    spent: float = 0.0


class Service(Protocol):
    """Something else that is served in the same loop, as the radio is."""

    async def start(self) -> list[str]:
        """Listen; return lines for the user.

        Raises:
            UsageError: A port is taken or the address is not ours.
        """
        ...

    def tick(self) -> None:
        """The world has made a control step; must be quick."""

    def stop(self) -> None:
        """Close all connections."""


class BotServer:
    """Serves one world to many clients until told to stop.

    Args:
        world: The world.
        settings: How to serve it.
        services: What else to serve.

    Attributes:
        port: The port in use, once all is listening.
    """

    def __init__(
        self, world: ServedWorld, settings: BotServerSettings, services: Sequence[Service] = ()
    ) -> None:
        self._services = services
        self._world = world
        self._settings = settings
        self._clients: dict[Client, asyncio.StreamWriter] = {}
        self._stepped = asyncio.Event()
        self._stop = asyncio.Event()
        # `ServedWorld.prepare` runs here, for seconds: the loop steps on meanwhile.
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="prepare")
        self._busy = 0.0
        self.port = settings.port

    async def run(self) -> None:
        """Listen and step until SIGINT or SIGTERM.

        Raises:
            UsageError: A port is taken or the address is not ours.
        """
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            # Not in a thread that may not set signal handlers, nor on platforms without them.
            with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):
                loop.add_signal_handler(number, self._stop.set)
        try:
            server = await asyncio.start_server(self._accept, self._settings.host, self._settings.port)
        except OSError as error:
            raise UsageError(
                f"cannot listen on {self._settings.host}:{self._settings.port}: {error}"
            ) from error
        port = server.sockets[0].getsockname()[1]
        try:
            more = [line for service in self._services for line in await service.start()]
            for line in (f"listening on {self._settings.host}:{port}", *more):
                print(f"usarmjx: {line}", flush=True)
            self.port = port
            await self._pace()
        finally:
            server.close()
            for service in self._services:
                service.stop()
            for writer in list(self._clients.values()):
                writer.close()
            self._executor.shutdown(wait=False, cancel_futures=True)

    def stop(self) -> None:
        """End `run` after the present step."""
        self._stop.set()

    async def _pace(self) -> None:
        period, factor = self._world.period, self._settings.realtime_factor
        began, start = time.perf_counter(), self._world.time
        deadline = began
        while not self._stop.is_set():
            self._tick()
            for service in self._services:
                service.tick()
            self._stepped.set()
            self._stepped.clear()
            if factor <= 0:
                await asyncio.sleep(0)
                continue
            deadline += period / factor
            behind = time.perf_counter() - deadline
            if behind > MAX_LAG:
                log.warning("%.2f s behind the clock: giving up catching up", behind)
                deadline += behind
            await asyncio.sleep(max(0.0, -behind))
        spent = max(time.perf_counter() - began, 1e-9)
        reached = (self._world.time - start) / spent
        share = self._busy / spent
        print(
            f"usarmjx: stopped after {self._world.time - start:.1f} simulated s; real-time factor "
            f"{reached:.2f}, busy {100 * share:.0f} % of the time",
            flush=True,
        )

    def _tick(self) -> None:
        began = time.perf_counter()
        self._world.step()
        for client in self._clients:
            client.add_trace_point()
        # Readings are taken after the step and just before the reports: what clients get is never a step old.
        due = [client for client in self._clients if client.due() and not client.lost]
        if due:
            self._world.observe([client.robot for client in due if client.robot is not None])
        for client in due:
            self._guarded(client, client.report)
        for client, writer in list(self._clients.items()):
            if client.lost:
                log.warning("a client's robot is gone: its connection is closed")
                writer.close()
            self._flush(client, writer)
        self._busy += time.perf_counter() - began

    def _guarded(self, client: Client, action: Callable[[], None]) -> None:
        try:
            action()
        except PeerError as error:
            log.warning("dropping a client: %s", error)
            self._clients[client].transport.abort()

    def _flush(self, client: Client, writer: asyncio.StreamWriter) -> None:
        if not writer.is_closing() and writer.transport.get_write_buffer_size() < MAX_WRITE_BUFFER:
            data = client.session.data_to_send()
            if data:
                writer.write(data)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = "{}:{}".format(*writer.get_extra_info("peername")[:2])
        if len(self._clients) >= self._settings.max_connections:
            log.warning("%s: refused, %d connections are open", peer, len(self._clients))
            writer.close()
            return
        client = Client(self._world, peer)
        self._clients[client] = writer
        log.info("%s: connected", peer)
        try:
            self._flush(client, writer)
            await self._listen(client, reader, writer)
        except (ConnectionError, PeerError) as error:
            log.warning("%s: %s", peer, error)
        except asyncio.CancelledError:
            log.info("%s: the server stops", peer)  # the end of this task; nobody waits for its result
        finally:
            del self._clients[client]
            client.leave()
            if writer.transport.get_write_buffer_size():
                writer.transport.abort()  # it does not read: closing would wait for it for ever
            else:
                writer.close()
            log.info("%s: disconnected", peer)

    async def _listen(
        self, client: Client, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        used = TimeSlice()
        while not writer.is_closing():
            data = await reader.read(READ_SIZE)
            began = time.perf_counter()
            commands = client.session.receive_data(data) if data else client.session.receive_eof()
            await self._charge(used, began)
            await self._obey(client, commands, used)
            client.log_faults()
            self._flush(client, writer)
            if not data:
                return

    async def _charge(self, used: TimeSlice, began: float) -> None:
        """Let a client that has used up its slice wait: no one may keep the world from stepping."""
        if used.step != self._world.time:
            used.step, used.spent = self._world.time, 0.0
        used.spent += time.perf_counter() - began
        if used.spent > MAX_SLICE:
            await self._stepped.wait()

    async def _obey(self, client: Client, commands: list[Command], used: TimeSlice) -> None:
        while commands:
            for command in commands:
                if not isinstance(command, Init):
                    began = time.perf_counter()
                    client.handle(command)
                    await self._charge(used, began)
            last = commands[-1]
            if not (client.session.awaits_answer and isinstance(last, Init)):
                return
            commands = client.session.answer_init(await self._init(client, last))

    async def _init(self, client: Client, init: Init) -> bool:
        spec = client.class_of(init)
        if spec is None:
            return False
        await asyncio.get_running_loop().run_in_executor(self._executor, self._world.prepare, spec)
        return client.spawn(init, spec)


@contextlib.contextmanager
def low_latency() -> Iterator[None]:
    """Let no other thread and no search for garbage hold up the loop; on leaving all is as it was.

    To look for garbage among the hundreds of thousands of objects that JAX keeps holds up all threads, and
    that again and again while a function is traced.
    """
    switch_interval, thresholds = sys.getswitchinterval(), gc.get_threshold()
    sys.setswitchinterval(SWITCH_INTERVAL)
    gc.freeze()
    gc.set_threshold(*thresholds[:2], GC_THRESHOLD)
    try:
        yield
    finally:
        sys.setswitchinterval(switch_interval)
        gc.set_threshold(*thresholds)
        gc.unfreeze()


def serve(world: ServedWorld, settings: BotServerSettings, services: Sequence[Service] = ()) -> None:
    """Serve a world until SIGINT or SIGTERM.

    Raises:
        UsageError: A port is taken or the address is not ours.
    """

    async def main() -> None:
        await BotServer(world, settings, services).run()

    world.warm_up()
    with low_latency():
        asyncio.run(main())
