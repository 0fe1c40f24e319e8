"""Clients of a server on this machine: one loop reads them all and notes when what came."""

import contextlib
import selectors
import socket
import statistics
import struct
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, TypeVar

import numpy as np

from usarmjx.base.errors import UsageError, UsarmjxError
from usarmjx.server.protocol.grammar import Message, parse_message

Measured = TypeVar("Measured")
DIGITS = 5
"""Decimals of figures."""


@dataclass(frozen=True)
class Missing:
    """Stands for a figure that could not be measured.

    Attributes:
        reason: Why.
    """

    reason: str


Figure: TypeAlias = float | Missing | Sequence[float | Missing]
"""A measurement, none, or several of the same."""
FigureTree: TypeAlias = Mapping[str, Any]
"""Figures by name; whole parts may be missing or have names of their own."""


def attempt(measure: Callable[[], Measured]) -> Measured | Missing:
    """Return what is measured, or why it cannot be: others are not to fail with it."""
    try:
        return measure()
    except (UsarmjxError, OSError) as error:
        return Missing(str(error))


def gather(runs: Sequence[Figure | FigureTree]) -> dict[str, Any]:
    """Return the figures of several runs by name, each as `spread` has it."""
    trees = [run for run in runs if isinstance(run, Mapping)]
    if not trees:
        return spread([run for run in runs if not isinstance(run, Mapping)])
    names = dict.fromkeys(name for tree in trees for name in tree)
    return {
        name: gather(
            [run.get(name, Missing("not reached")) if isinstance(run, Mapping) else run for run in runs]
        )
        for name in names
    }


def spread(figures: Sequence[Figure]) -> dict[str, Any]:
    """Return median, least and most of measurements and all of them, and why some are missing."""
    values: list[float] = []
    reasons: dict[str, None] = {}
    for figure in figures:
        for one in figure if isinstance(figure, Sequence) else [figure]:
            if isinstance(one, Missing):
                reasons[one.reason] = None
            else:
                values.append(round(one, DIGITS))
    found: dict[str, Any] = {"median": None}
    if values:
        median = round(statistics.median(values), DIGITS)
        found = {"median": median, "least": min(values), "most": max(values), "values": values}
    return found | ({"missing": list(reasons)} if reasons else {})


def rows(gathered: Mapping[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the name and the spread of every figure; a name is that of its part, parts, and its own."""
    if "median" in gathered:
        yield " ".join(path), gathered
        return
    for name, inner in gathered.items():
        yield from rows(inner, (*path, name))


def ratios(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the other medians as multiples of ours, by name; None where that makes no sense."""
    other = dict(rows(theirs))
    found: dict[str, float | None] = {}
    for name, figure in rows(ours):
        own, their = figure["median"], other.get(name, {"median": None})["median"]
        found[name] = round(their / own, 3) if own and their and own > 0 < their else None
    return found


def show(figure: Mapping[str, Any]) -> str:
    """Return a figure as text: its median, and in brackets least and most if there are several."""
    if figure["median"] is None:
        return "-"
    if len(figure["values"]) == 1:
        return f"{figure['median']:.3f}"
    return f"{figure['median']:.3f} ({figure['least']:.3f}-{figure['most']:.3f})"


HOST = "127.0.0.1"
CONNECT_LIMIT = 60.0
"""How long a connection may take [s]: the system accepts it for a server that is busy."""
READ_SIZE = 1 << 18
"""Most bytes taken from a socket at once."""
PATIENCE = 0.02
"""How often a condition is looked at while nothing comes [s]."""
FRAME_HEAD = struct.Struct(">BI")
"""Of a picture: its type and the bytes that follow."""
RAW_HEAD = 4
"""Bytes in front of a raw picture's colours: width and height."""


class Connection(Protocol):
    """Readings of a `Crowd`."""

    socket: socket.socket

    def take(self, data: bytes, now: float) -> None:
        """Note bytes that came at a time [s]."""
        ...

    def flush(self) -> None:
        """Send what waits to be sent, as far as the system takes it."""
        ...


AnyClient = TypeVar("AnyClient", bound=Connection)


def connect(port: int, host: str = HOST) -> socket.socket:
    """Return a connection to a port, of this machine by default, that never blocks."""
    made = socket.create_connection((host, port), CONNECT_LIMIT)
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    made.setblocking(False)
    return made


class RobotClient:
    """A client of the Gamebots port.

    Args:
        port: The port.
        host: Whose it is.

    Attributes:
        socket: Its connection.
        began: When it connected, by the performance counter [s].
        reports: When each STA came by the performance counter, and its own time [s, simulated s].
        unsent: Bytes that the system has not taken yet.
        answer: The line that `expect` asked for, and when it came.
    """

    def __init__(self, port: int, host: str = HOST) -> None:
        self.began = time.perf_counter()
        self.socket = connect(port, host)
        self.reports: list[tuple[float, float]] = []
        self.unsent = b""
        self.answer: tuple[Message, float] | None = None
        self._wanted: Callable[[Message], bool] | None = None
        self._rest = b""

    def say(self, *lines: str) -> None:
        """Send lines."""
        self.unsent += "".join(f"{line}\r\n" for line in lines).encode("latin-1")
        self.flush()

    def flush(self) -> None:
        """Send what waits to be sent, as far as the system takes it."""
        if self.unsent:
            with contextlib.suppress(BlockingIOError):
                self.unsent = self.unsent[self.socket.send(self.unsent) :]

    def expect(self, wanted: Callable[[Message], bool]) -> None:
        """Keep the next message that is wanted as the answer."""
        self._wanted, self.answer = wanted, None

    def take(self, data: bytes, now: float) -> None:
        """Note lines that came at a time [s]."""
        *lines, self._rest = (self._rest + data).split(b"\r\n")
        for line in lines:
            status = line.startswith(b"STA ")
            if not status and self._wanted is None:
                continue
            message = parse_message(line.decode("latin-1"))
            if status:
                self.reports.append((now, float(message.get("Time"))))
            if self._wanted is not None and self._wanted(message):
                self._wanted, self.answer = None, (message, now)


class PictureClient:
    """A client of the image server that asks for the next picture as soon as it has one.

    Args:
        port: The port.

    Attributes:
        socket: Its connection.
        frames: When each picture came by the performance counter [s], and whether it shows anything.
    """

    def __init__(self, port: int) -> None:
        self.socket = connect(port)
        self.frames: list[tuple[float, bool]] = []
        self._rest = b""

    def flush(self) -> None:
        """Send nothing: the few bytes of an OK never have to wait."""

    def take(self, data: bytes, now: float) -> None:
        """Note pictures that came at a time [s]; they must be raw."""
        self._rest += data
        while len(self._rest) >= FRAME_HEAD.size:
            _, size = FRAME_HEAD.unpack_from(self._rest)
            end = FRAME_HEAD.size + size
            if len(self._rest) < end:
                return
            self.frames.append((now, bool(self._rest[FRAME_HEAD.size + RAW_HEAD : end].strip(b"\0"))))
            self._rest = self._rest[end:]
            self.socket.send(b"OK")


class Crowd(AbstractContextManager["Crowd"]):
    """Clients of one server; they leave with the context.

    Args:
        port: Its Gamebots port.
        on_close: Is told whose connection the server has closed; None: that is an error.
    """

    def __init__(self, port: int, on_close: Callable[[Connection], None] | None = None) -> None:
        self._port, self._selector, self._on_close = port, selectors.DefaultSelector(), on_close

    def robot(self) -> RobotClient:
        """Return a new client of the Gamebots port."""
        return self.add(RobotClient(self._port))

    def pictures(self, port: int) -> PictureClient:
        """Return a new client of an image server."""
        return self.add(PictureClient(port))

    def add(self, client: AnyClient) -> AnyClient:
        """Read a client, too; return it."""
        self._selector.register(client.socket, selectors.EVENT_READ, client)
        return client

    def leave(self, client: Connection) -> None:
        """Close a client's connection."""
        self._selector.unregister(client.socket)
        client.socket.close()

    def pump(self, seconds: float) -> None:
        """Read whatever comes in that time [s].

        Raises:
            ConnectionError: The server has closed a connection.
        """
        for _ in self._rounds(seconds):
            pass

    def wait(self, done: Callable[[], bool], limit: float) -> bool:
        """Read until something is done; return whether that was so within a time [s].

        Raises:
            ConnectionError: The server has closed a connection.
        """
        return done() or any(done() for _ in self._rounds(limit))

    def report_after(self, client: RobotClient, moment: float, limit: float) -> tuple[float, float]:
        """Wait for a client's first report after a moment [s]; return when it came, and its own time.

        Raises:
            UsageError: None came within the limit [s].
            ConnectionError: The server has closed a connection.
        """
        if not self.wait(lambda: bool(client.reports) and client.reports[-1][0] > moment, limit):
            raise UsageError(f"no report within {limit:g} s")
        return next(report for report in client.reports if report[0] > moment)

    def __exit__(self, *_: object) -> None:
        """Close all connections."""
        for key in list(self._selector.get_map().values()):
            self.leave(key.data)
        self._selector.close()

    def _rounds(self, seconds: float) -> Iterator[None]:
        """Read what comes again and again for so long [s]."""
        end = time.perf_counter() + seconds
        while (left := end - time.perf_counter()) > 0:
            for key in list(self._selector.get_map().values()):
                try:
                    key.data.flush()
                except ConnectionError:
                    self._lose(key.data)
            for key, _ in self._selector.select(min(left, PATIENCE)):
                data = _received(key.data.socket)
                if data:
                    key.data.take(data, time.perf_counter())
                else:
                    self._lose(key.data)
            yield

    def _lose(self, client: Connection) -> None:
        if self._on_close is None:
            raise ConnectionError("the server has closed a connection")
        self.leave(client)
        self._on_close(client)


def _received(connection: socket.socket) -> bytes:
    """Return what has come; nothing if the connection is closed or broken off."""
    try:
        return connection.recv(READ_SIZE)
    except ConnectionError:
        return b""


REPORT_PERIOD = 0.2
"""A robot's report is due so often (KRobot.uc: msgTimer) [s]."""
MIX = ("P2AT", "P2DX")
"""Classes of many robots, in turn."""
TURNING = "DRIVE {Left 2.0} {Right -2.0}"
"""Turns a robot of the mix on the spot, so that none meets another."""


class RunningServer(Protocol):
    """A server that can be measured."""

    port: int
    image_port: int

    def cpu_seconds(self) -> float:
        """Return the processor time that it has used so far [s]."""
        ...


@dataclass(frozen=True)
class Bounds:
    """Durations of measuring and waiting.

    Attributes:
        seconds: Length of one measurement of what goes on and on [s].
        windows: Number of them.
        limit: Anything longer is given up [s].
        settling: Time for what has begun or ended to take effect [s].
    """

    seconds: float
    windows: int
    limit: float
    settling: float = 1.0


class Watcher:
    """A robot that stands and reads its reports while others are busy.

    Args:
        crowd: Whose loop reads them.
        client: The robot's client, which has had a report.
        limit: A report that takes longer than this does not come any more [s].
    """

    def __init__(self, crowd: Crowd, client: RobotClient, limit: float) -> None:
        self._crowd, self._client, self._limit = crowd, client, limit

    def during(self, action: Callable[[], dict[str, Figure]]) -> dict[str, Figure]:
        """Return an action's figures, and by how much the watcher's longest gap meanwhile was too long."""
        began, _ = self._crowd.report_after(self._client, time.perf_counter(), self._limit)
        figures = action()
        try:
            ended, _ = self._crowd.report_after(self._client, time.perf_counter(), self._limit)
        except UsageError as error:
            return figures | {"beyond_due_s": Missing(f"the watcher: {error}")}
        came = [arrival for arrival, _ in self._client.reports if began <= arrival <= ended]
        return figures | {"beyond_due_s": float(np.diff(came).max() - REPORT_PERIOD)}


def start_tags(crowd: Crowd, robots: int, limit: float) -> list[str]:
    """Return start poses for so many robots, evenly spread over the arena's list.

    Raises:
        UsageError: There are not so many, or they do not come within the limit [s].
    """
    asking = crowd.robot()
    asking.expect(lambda message: bool(message.get("StartPoses")))
    asking.say("GETSTARTPOSES")
    crowd.wait(lambda: asking.answer is not None, limit)
    crowd.leave(asking)
    if asking.answer is None:
        raise UsageError(f"no start poses within {limit:g} s")
    words = " ".join(f"{key} {value}" for key, value in asking.answer[0].segments[1:]).split()
    tags = words[::3]
    if robots > len(tags):
        raise UsageError(f"the arena has {len(tags)} start poses, not {robots}")
    return [tags[i * len(tags) // robots] for i in range(robots)]


def join(crowd: Crowd, kind: str, tag: str) -> RobotClient:
    """Return a new client that has asked for a robot of a class at a start pose."""
    client = crowd.robot()
    client.say(f"INIT {{ClassName USARBot.{kind}}} {{Name At{tag}}} {{Start {tag}}}")
    return client


def wait_for_reports(crowd: Crowd, clients: Sequence[RobotClient], limit: float) -> float | Missing:
    """Return the time from the first client's connection to the last one's first report [s]."""
    if crowd.wait(lambda: all(client.reports for client in clients), limit):
        return max(client.reports[0][0] for client in clients) - min(client.began for client in clients)
    there = sum(bool(client.reports) for client in clients)
    return Missing(f"{there} of {len(clients)} robots reported within {limit:g} s")


def ask(
    crowd: Crowd, client: RobotClient, line: str, wanted: Callable[[Message], bool], limit: float
) -> float | Missing:
    """Return how long it takes from a command to the first message that is wanted [s]."""
    client.expect(wanted)
    began = time.perf_counter()
    client.say(line)
    crowd.wait(lambda: client.answer is not None, limit)
    return client.answer[1] - began if client.answer else Missing(f"no answer within {limit:g} s")


def measure_inits(server: RunningServer, kinds: Sequence[str], bounds: Bounds) -> dict[str, Any]:
    """Measure INIT to the first STA of robots of several classes, one after another.

    The first of them watches the others come.
    """
    figures: dict[str, Any] = {}
    with Crowd(server.port) as crowd:
        watcher: Watcher | None = None
        for kind, tag in zip(kinds, start_tags(crowd, len(kinds), bounds.limit), strict=True):

            def act(kind: str = kind, tag: str = tag) -> dict[str, Figure]:
                return {"first_sta_s": wait_for_reports(crowd, [join(crowd, kind, tag)], bounds.limit)}

            if watcher is not None:
                figures[kind] = watcher.during(act)
                continue
            first = join(crowd, kind, tag)
            figures[kind] = {"first_sta_s": wait_for_reports(crowd, [first], bounds.limit)}
            if first.reports:
                watcher = Watcher(crowd, first, bounds.limit)
    return figures
