"""Worlds served from a Python program, in a thread: the counterpart of `usarmjx serve`."""

import asyncio
import contextlib
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Self

from usarmjx.base.errors import UsageError
from usarmjx.models.files.load import find_arena
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.network.ports import BOT_PORT, bound_ports, count_up
from usarmjx.server.runtime.loop import ServerLoop
from usarmjx.server.worlds.batch_world import BatchWorld, SharedBatch, check_instances
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.sim.batch import Batch

START_LIMIT = 60.0
"""Longest time until the sockets listen [s]."""


class Serving(contextlib.AbstractContextManager["Serving"]):
    """Worlds that serve clients until `stop`, or until the end of `with`.

    Args:
        servers: Server of each world.
        realtime_factor: Simulated seconds per second; 0: as fast as possible.
        held: Resources to close at the end, such as bound ports.

    Attributes:
        ports: The TCP port of each world.
    """

    def __init__(
        self, servers: Sequence[BotServer], realtime_factor: float, held: contextlib.ExitStack
    ) -> None:
        self._servers, self._factor, self._held = servers, realtime_factor, held
        self._listening, self._fault = threading.Event(), list[BaseException]()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._all: ServerLoop | None = None
        # A daemon: a program that does not call `stop` must end all the same.
        self._thread = threading.Thread(target=self._run, name="usarmjx serving", daemon=True)
        self._thread.start()
        if not self._listening.wait(START_LIMIT):
            raise UsageError(f"the server did not listen within {START_LIMIT:g} s")
        if self._fault:
            raise self._fault[0]
        self.ports = [server.port for server in servers]

    @property
    def port(self) -> int:
        """The TCP port of the first world."""
        return self.ports[0]

    @property
    def running(self) -> bool:
        """Whether clients are still served."""
        return self._thread.is_alive()

    def wait(self, timeout: float | None = None) -> None:
        """Wait for the end of serving, such as Ctrl+C.

        Args:
            timeout: Longest wait [s]; None: no limit.

        Raises:
            Exception: The error that ended serving, if there was one.
        """
        try:
            self._thread.join(timeout)
        except KeyboardInterrupt:
            self.stop()
        if self._fault:
            raise self._fault[0]

    def stop(self) -> None:
        """Stop serving; a second call does nothing."""
        if self._loop is not None and self._all is not None:
            with contextlib.suppress(RuntimeError):  # it has ended meanwhile
                # An asyncio.Event may only be set in the loop's own thread.
                self._loop.call_soon_threadsafe(self._all.stop)
        self._thread.join()

    def __enter__(self) -> Self:
        """Serve until the end of `with`."""
        return self

    def __exit__(self, *error: object) -> None:
        """Stop."""
        self.stop()

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:
            self._fault.append(error)
        finally:
            # Also after a fault: the starter waits for this event and then raises what happened.
            self._held.close()
            self._listening.set()

    async def _serve(self) -> None:
        self._loop, self._all = asyncio.get_running_loop(), ServerLoop(self._servers, self._factor)
        running = asyncio.create_task(self._all.run())
        # Polled: `run` listens and serves in one coroutine, and a taken port ends it before it listens.
        while not self._all.listening and not running.done():
            await asyncio.sleep(0.01)
        if self._all.listening:
            self._listening.set()
        await running


def serve(
    what: Batch | ArenaSpec | str | Path = "yellow",
    *,
    instances: Sequence[int] = (0,),
    host: str = "127.0.0.1",
    port: int = BOT_PORT,
    max_connections: int = 16,
    realtime_factor: float = 1.0,
    seed: int = 0,
) -> Serving:
    """Serve worlds to clients of the Gamebots protocol, from a thread, while the program goes on.

    `usarmjx serve` has radio, pictures and pages, too.

    Args:
        what: An arena by name, file or description: a world on engine `c`, which any robot may join. Or a
            batch, which begins anew: clients take over the parked robots of its scene.
        instances: Numbers of the worlds of the batch; of an arena, of the worlds that follow from the seed.
        host: Address to listen on.
        port: TCP port of the first of them, others count up; 0: free ones.
        max_connections: Most clients of one world.
        realtime_factor: Simulated seconds per second; 0: as fast as possible.
        seed: Seed of all random numbers of an arena's worlds; a batch has its own.

    Returns:
        The running server, a context manager; see `Serving`.

    Raises:
        UsageError: No such world, or a port that is taken.
        UnknownNameError: No such arena; lists those there are.
    """
    if not instances:
        raise UsageError("instances is empty: name at least one world, as instances=(0,)")
    # An arena becomes as many worlds as are named, so only negative numbers are wrong.
    check_instances(instances, what.worlds if isinstance(what, Batch) else max(instances) + 1)
    with contextlib.ExitStack() as held:
        bound = held.enter_context(bound_ports(host, count_up({"port": port}, len(instances))))
        settings = BotServerSettings(host, max_connections=max_connections)
        servers = [
            BotServer(
                world,
                replace(settings, port=sockets["port"].getsockname()[1]),
                bound=sockets["port"],
                title=f"world {number}" if len(instances) > 1 else "",
            )
            for world, sockets, number in zip(
                _worlds(what, instances, seed, max_connections), bound, instances, strict=True
            )
        ]
        # Before the thread starts: the first client must not wait for compilers.
        for server in servers:
            server.world.warm_up()
        # The sockets now belong to the running server, and survive the end of this context.
        return Serving(servers, realtime_factor, held.pop_all())


def _worlds(
    what: Batch | ArenaSpec | str | Path, instances: Sequence[int], seed: int, max_robots: int
) -> list[ServedWorld]:
    if isinstance(what, Batch):
        shared = SharedBatch(what)
        return [BatchWorld(shared, number) for number in instances]
    arena = what if isinstance(what, ArenaSpec) else find_arena(what)
    return [DynamicWorld(arena, seed=seed, number=number, max_robots=max_robots) for number in instances]
