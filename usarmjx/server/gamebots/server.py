"""The Gamebots server of one world: sockets, and the order in which clients have their turns."""

import asyncio
import logging
import math
import socket
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol, TypeVar

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.models.types.robot import RobotSpec
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.gamebots.budget import INIT_COST, JOIN_SHARE, BudgetPool, ClientBudget
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.network.gate import Gate, peer_address
from usarmjx.server.network.loop_meter import loop_meter
from usarmjx.server.protocol.commands import Command, Init
from usarmjx.server.runtime.logs import FaultLog
from usarmjx.server.wireless.sockets import has_hung_up, limit_receive_buffer, listen
from usarmjx.server.worlds.served_world import ServedWorld

T = TypeVar("T")
log = logging.getLogger(__name__)
READ_SIZE = 256
"""Most bytes read at once from one client: between two pieces another client has its turn."""
RECEIVE_BUFFER = 32 * 1024
"""Receive buffer of the system; a client with more unread bytes waits [bytes]."""
MOST_STEPS_AFTER_LEAVING = 25
"""Most control steps for which a client that has closed its connection waits for turns, half a second."""
MAX_WRITE_BUFFER = 64 * 1024
"""Fill level of a socket's buffer from which reports wait in the session, which has its own bound [bytes]."""


@dataclass
class ConnectionCounts:
    """Counters of a server since its start.

    Attributes:
        connections: Clients that were accepted.
        commands: Legal commands by their types.
        faults: Faults of clients that have left.
    """

    connections: int = 0
    commands: Counter[type] = field(default_factory=Counter[type])
    faults: int = 0


@dataclass(eq=False)
class RobotConnection:
    """A client's connection.

    Attributes:
        client: The client.
        reader: Stream from the client.
        writer: Stream to the client.
        peer: Name of the client in the log.
        budget: Processing time of its lines.
        last_command_time: Time of its last legal command [s].
        since: Time at which it connected [s].
        steps_after_leaving: Control steps in which it waited for a turn after its other side had closed it.
    """

    client: Client
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    peer: str
    budget: ClientBudget
    last_command_time: float = field(default_factory=time.monotonic)
    since: float = field(default_factory=time.monotonic)
    steps_after_leaving: int = 0

    @property
    def is_idle(self) -> bool:
        """Whether it has no robot, and waits for none."""
        client = self.client
        has_place = client.robot is not None or client.is_controller or client.session.awaits_answer
        return not has_place and not self.writer.is_closing()

    @property
    def has_left(self) -> bool:
        """Whether either side has closed the connection, however much of it is still to be read."""
        return self.writer.is_closing() or has_hung_up(self.writer.get_extra_info("socket"))

    def flush(self) -> None:
        """Write the bytes that wait, if the socket can take them."""
        session = self.client.session
        # Beyond the mark the bytes stay in the session, whose bound drops the client; asyncio's has none.
        if session.has_data and not self.writer.is_closing() and self._unread < MAX_WRITE_BUFFER:
            data = session.data_to_send()
            self.writer.write(data)
            self.client.record_lines(self.peer, data, sent=True)

    def hang_up(self) -> None:
        """Close the connection; abort it if the client does not read: closing would wait for ever."""
        if self._unread:
            self.writer.transport.abort()
        else:
            self.writer.close()

    @property
    def _unread(self) -> int:
        return self.writer.transport.get_write_buffer_size()


class Service(Protocol):
    """Another service of the same loop, such as the radio."""

    async def start(self) -> list[str]:
        """Listen; return lines for the user.

        Raises:
            UsageError: A port is taken or the address is not ours.
        """
        ...

    def tick(self) -> None:
        """Do the work of a control step that the world has made; must be quick."""

    def stop(self) -> None:
        """Close all connections."""


class BotServer:
    """Serves one world to many clients, in the loop of `loop.ServerLoop`.

    Args:
        world: The world.
        settings: Settings of the server.
        services: Other services of the world.
        bound: A socket that is bound to the port already.
        title: Name of the world in the log; empty if it is the only one.

    Attributes:
        world: The world.
        settings: Settings of the server.
        services: Other services of the world.
        title: Name of the world in the log.
        counts: Counters of the server.
        port: The port in use, once started.
        budgets: Processing time of the clients, those of rosbridge too.
        guests: Dialogues of robots without a connection: their reports are thrown away.
    """

    def __init__(
        self,
        world: ServedWorld,
        settings: BotServerSettings,
        services: Iterable[Service] = (),
        bound: socket.socket | None = None,
        title: str = "",
    ) -> None:
        self.world, self.settings, self.services, self.title = world, settings, list(services), title
        # A port of 0 is replaced by the real one in `start`.
        self.port, self.counts = settings.port, ConnectionCounts()
        self.guests: list[Client] = []
        self._bound = bound
        self._gate = Gate(
            settings.access, settings.max_connections, f"{title}, robots" if title else "robots"
        )
        self._listener: asyncio.Server | None = None
        self._connections: dict[Client, RobotConnection] = {}
        self._joins = BudgetPool(world.period, JOIN_SHARE)
        self.budgets = BudgetPool(world.period, joins=self._joins)
        self._fault_log = FaultLog(log)
        self._stepped = asyncio.Event()
        self._joining = asyncio.Lock()
        self._leaving: deque[Client] = deque()
        self._stopped = False
        # `ServedWorld.prepare` compiles for seconds: in this thread, so that the loop steps on meanwhile.
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="prepare")

    @property
    def clients(self) -> Collection[Client]:
        """Connected clients."""
        return self._connections.keys()

    @property
    def faults(self) -> int:
        """Number of unusable lines of clients so far."""
        return self.counts.faults + sum(client.session.fault_count for client in self._connections)

    async def start(self) -> list[str]:
        """Listen, and let the services listen; return lines for the user.

        Raises:
            UsageError: A port is taken or the address is not ours.
        """
        host = self.settings.host
        address = host, self.settings.port
        # Robots listen first: the addresses of the services are printed beside this port.
        self._listener, self.port = await listen(address, self._accept, self._gate, self._bound)
        meter = self.budgets.meter = self._joins.meter = loop_meter()
        for listening in self._listener.sockets:
            meter.prefer(listening.fileno())
        more = [line for service in self.services for line in await service.start()]
        return [f"listening on {host}:{self.port}", *more]

    def tick(self, moves: bool = True) -> None:
        """Make a control step, unless the world is paused; send the reports that are due."""
        if moves:
            self.world.step()
            for client in self._connections:
                client.add_trace_point()
        # Readings are taken after the step and just before the reports: a report is never a step old.
        world_time = self.world.time
        everybody = (*self._connections, *self.guests)
        due = [client for client in everybody if client.due(world_time) and not client.lost]
        # One call for all robots that are due: the world renders what they share once.
        if due:
            self.world.observe([client.robot for client in due if client.robot is not None])
        for client in due:
            self._guarded(client, client.report)
        # Nobody reads a guest's reports: kept, they would fill its session until it faults.
        for guest in self.guests:
            guest.session.data_to_send()
        now = time.monotonic()
        for connection in list(self._connections.values()):
            self._serve_connection(connection, now)
        for service in self.services:
            service.tick()
        # Faults that were only counted get their line here, even if no further fault follows.
        self._fault_log.flush()
        self.budgets.refill()
        self._joins.refill()
        self._remove_next()
        # Set and cleared at once: wakes those that wait now, and later ones wait for the next step.
        self._stepped.set()
        self._stepped.clear()

    def stop(self) -> None:
        """Close all connections."""
        if self._listener is not None:
            self._listener.close()
        for service in self.services:
            service.stop()
        for connection in list(self._connections.values()):
            connection.writer.close()
        # From here on clients leave at once: no further step would take them from the queue.
        self._stopped = True
        while self._leaving:
            self._leaving.popleft().leave()
        # A compilation in this thread cannot be interrupted: the process ends without it.
        self._executor.shutdown(wait=False, cancel_futures=True)

    def _serve_connection(self, connection: RobotConnection, now: float) -> None:
        """Send a client's waiting bytes, or hang up if its robot is lost or it is silent without one."""
        client, patience = connection.client, self.settings.init_timeout
        if client.lost:
            # Closed, as nothing in the protocol says to a client that its robot is gone.
            log.warning("a client's robot is gone: its connection is closed")
            connection.writer.close()
        elif patience and now > connection.last_command_time + patience and connection.is_idle:
            self._fault_log.warning(
                "%s: no INIT for %g s: its connection is closed", connection.peer, patience
            )
            connection.hang_up()
        # A client that waits is not read, so the end of its stream would stay unseen until its turn. One with
        # a budget may wait because of others: many that left together would keep their seats for a minute.
        if connection.budget.is_waiting and connection.has_left:
            connection.steps_after_leaving += 1
            if connection.budget.balance <= 0.0 or connection.steps_after_leaving > MOST_STEPS_AFTER_LEAVING:
                connection.budget.dismiss("it has left, and the rest of its lines is dropped")
        connection.flush()

    def dismiss(self, client: Client) -> None:
        """Let a client's robot leave in its turn; at once if the server has stopped."""
        if client.robot is None or self._stopped:
            client.leave()
        else:
            self._leaving.append(client)
            self._remove_next()

    def _remove_next(self) -> None:
        """Remove the robot of the first client that left, unless others have just left or joined."""
        if self._leaving and not self._joins.is_spent:
            with self._joins.spending():
                self._leaving.popleft().leave()

    def _guarded(self, client: Client, action: Callable[[], None]) -> None:
        try:
            action()
        # Reported to the log only, as the tick has no client to raise to.
        except Exception as error:  # any error: the reports of the other clients must go out
            connection = self._connections.get(client)
            self._fault_log.warning("%s: dropped: %s", connection.peer if connection else "guest", error)
            # A peer's fault needs no traceback; any other error is the server's own.
            if not isinstance(error, PeerError):
                log.debug("because of", exc_info=error)
            if connection is not None:
                connection.writer.transport.abort()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = "{}:{}".format(*peer_address(writer))
        # All worlds share one log: `logs.PEER` reads the number of the world here.
        if self.title:
            peer = f"{self.title}, {peer}"
        if not self._make_room():
            self._gate.refuse(peer, f"{len(self._connections)} connections are open")
            writer.close()
            return
        # A full buffer stops the sender by TCP itself: unread lines of a flooding client stay on its machine.
        limit_receive_buffer(writer, RECEIVE_BUFFER)
        settings = self.settings
        client = Client(self.world, peer, self._fault_log, settings.dialect, settings.time_limit)
        budget = ClientBudget(self.budgets)
        # Registered before the first await: two clients that come together must not both take the last seat.
        connection = self._connections[client] = RobotConnection(client, reader, writer, peer, budget)
        self.counts.connections += 1
        log.info("%s: connected", peer)
        try:
            connection.flush()
            await self._listen(connection)
        except ConnectionResetError as error:  # as when a client closes before it has read all
            log.info("%s: %s", peer, error)
        except (ConnectionError, PeerError) as error:
            self._fault_log.warning("%s: %s", peer, error)
        except asyncio.CancelledError:
            log.info("%s: the server stops", peer)  # the end of this task; nothing awaits its result
        finally:
            # No await up to the sum below, so `faults` never misses or doubles this client's count.
            del self._connections[client]
            self.counts.faults += client.session.fault_count
            client.log_faults(is_last=True)
            self.dismiss(client)
            connection.hang_up()
            log.info("%s: disconnected", peer)

    def _make_room(self) -> bool:
        """Return whether another client fits; if need be the longest connected one without a robot yields."""
        if len(self._connections) < self.settings.max_connections:
            return True
        # A timeout of 0 makes nobody yield: no client has connected before minus infinity.
        latest = time.monotonic() - (self.settings.init_timeout or math.inf)
        idle = [
            connection
            for connection in self._connections.values()
            if connection.since < latest and connection.is_idle
        ]
        if idle:
            longest = min(idle, key=lambda connection: connection.since)
            self._fault_log.warning("%s: makes room, it has no robot", longest.peer)
            longest.hang_up()
        return bool(idle)

    async def _listen(self, connection: RobotConnection) -> None:
        client = connection.client
        while not connection.writer.is_closing():
            data = await connection.reader.read(READ_SIZE)
            client.record_lines(connection.peer, data, sent=False)
            # Parsing is charged, too: a flood of nonsense costs as much as legal commands.
            async with connection.budget:
                commands = client.session.receive_data(data) if data else client.session.receive_eof()
            await self._execute(connection, commands)
            client.log_faults()
            connection.flush()
            if not data:
                return
            if 0 < self.settings.max_faults <= client.session.faults_in_a_row:
                raise PeerError("dropped: too many faults in a row")

    async def _execute(self, connection: RobotConnection, commands: list[Command]) -> None:
        client = connection.client
        while commands:
            # An INIT is always the last: the session holds back the lines behind it until it is answered.
            for command in commands:
                self.counts.commands[type(command)] += 1
                if not isinstance(command, Init):
                    async with connection.budget:
                        client.handle(command)
            last, connection.last_command_time = commands[-1], time.monotonic()
            if not (client.session.awaits_answer and isinstance(last, Init)):
                return
            accepted = await self._init(connection, last)
            async with connection.budget:
                commands = client.session.answer_init(accepted)
            connection.last_command_time = time.monotonic()

    def _take_over_guest(self, client: Client, init: Init, spec: RobotSpec) -> bool:
        """Give a client the guest's robot of that class and name as it is; return whether there is one."""
        for guest in self.guests:
            robot = guest.robot
            if robot is None or guest.lost or (robot.name.lower(), robot.spec) != (init.name.lower(), spec):
                continue
            # A guest that still had the robot would take it along when it leaves.
            guest.robot, robot.controller = None, None
            client.attach_robot(robot, self.world.time)
            return True
        return False

    async def prepare(self, spec: RobotSpec) -> None:
        """Prepare the first robot of a class in a thread, which may take seconds.

        Raises:
            UsageError: No robot can be built of that class.
        """
        await asyncio.get_running_loop().run_in_executor(self._executor, self.world.prepare, spec)

    @staticmethod
    def _check_is_here(connection: RobotConnection) -> None:
        if connection.has_left:
            raise PeerError("it has left before its robot came")

    async def _init(self, connection: RobotConnection, init: Init) -> bool:
        client = connection.client
        async with connection.budget:
            # Charged before any check, so that a loop of refused INITs soon waits for its own budget.
            connection.budget.charge(INIT_COST)
            if client.becomes_controller(init):
                return True
            spec = client.robot_class(init)
        if spec is None:
            return False
        try:
            await self.prepare(spec)
        except UsageError as error:
            client.session.note_refusal(str(error))
            return False

        def spawn() -> bool:
            began = self._joins.clock()
            # A guest with that name comes first; spawning would refuse the name as taken.
            accepted = self._take_over_guest(client, init, spec) or client.spawn(init, spec)
            if not accepted:
                connection.budget.charge(self._joins.clock() - began)
            return accepted

        return await self.join(spawn, partial(self._check_is_here, connection))

    async def join(self, spawn: Callable[[], T], check: Callable[[], None] = lambda: None) -> T:
        """Spawn a robot within the share for joining: one in a control step, after those that leave.

        Args:
            spawn: Spawns it.
            check: Raises if its client has left.
        """
        # A queued waiter of the lock would keep the connection of a client that left until its turn comes:
        # therefore this polls once a step and checks.
        while self._joining.locked():
            await self._stepped.wait()
            check()
        async with self._joining:  # one robot in a control step, so that a crowd delays nobody's reports
            check()
            await self._stepped.wait()
            check()
            while self._leaving or self._joins.is_spent:
                await self._stepped.wait()
                check()
            with self._joins.spending():
                return spawn()
