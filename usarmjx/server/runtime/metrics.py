"""Metrics of a running server for Prometheus, and a health line, over HTTP in the server's own loop.

Counters are incremented where the events happen; gauges are looked up at each request.
"""

import json
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from http import HTTPStatus
from itertools import accumulate

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4
from prometheus_client.registry import Collector
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.http11 import Request, Response

from usarmjx.base.errors import UsageError
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.network.gate import Gate
from usarmjx.server.network.ports import keep_reserve
from usarmjx.server.network.web_gate import asking_token, gated_connection
from usarmjx.server.ros2.server import Ros2Server
from usarmjx.server.runtime.loop import GAP_BOUNDS, StepMeter

REQUEST_LIMIT = 5.0
"""Time that a connection has for its request [s]."""
MAX_CONNECTIONS = 16
"""Capacity of the port; an address may have three quarters of it by default."""
IN_TIME = 0.9
"""Share of the wanted simulated time below which a world counts as behind."""
MAX_RECORDING_LAG = 1.0
"""Lag of a recording above which the server's health is a fault [s]."""


def recording_lag(meter: StepMeter) -> float:
    """Return how far a world's recording is behind [s]; 0 without one."""
    recorder = meter.server.world.recorder
    return 0.0 if recorder is None else recorder.file.lag


def frames_left_out(meter: StepMeter) -> float:
    """Return the number of frames that a world's recording has left out."""
    recorder = meter.server.world.recorder
    return 0.0 if recorder is None else float(recorder.file.left_out)


def ros2_count(name: str) -> Callable[[StepMeter], float]:
    """Return what reads a counter of a world's node of ROS 2; 0 without one."""

    def count(meter: StepMeter) -> float:
        nodes = [one for one in meter.server.services if isinstance(one, Ros2Server)]
        return float(sum(getattr(node.counts, name) for node in nodes))

    return count


GAUGES: tuple[tuple[str, str, Callable[[StepMeter], float]], ...] = (
    (
        "realtime_factor",
        "Simulated seconds per second, over the last five.",
        lambda meter: meter.realtime_factor(time.perf_counter()),
    ),
    ("clients", "Connections to the Gamebots port.", lambda meter: len(meter.server.clients)),
    (
        "recording_lag_seconds",
        "Age of the oldest state that is not written to the recording; 0 without one.",
        recording_lag,
    ),
    ("robots", "Robots that clients have.", lambda meter: len(meter.server.world.robots)),
)
"""Name, meaning and value of a world's gauges; all names begin with usarmjx_."""
COUNTERS: tuple[tuple[str, str, Callable[[StepMeter], float]], ...] = (
    ("simulated_seconds", "Simulated time.", lambda meter: meter.server.world.time),
    (
        "connections",
        "Connections to the Gamebots port so far.",
        lambda meter: meter.server.counts.connections,
    ),
    ("faults", "Lines that could not be used.", lambda meter: meter.server.faults),
    ("recording_frames_left_out", "Frames that the recording has left out.", frames_left_out),
    ("ros2_messages_sent", "Messages that the node of ROS 2 has sent.", ros2_count("sent")),
    ("ros2_bytes_sent", "Their bytes.", ros2_count("sent_bytes")),
    ("ros2_messages_received", "Commands and requests that it has received.", ros2_count("received")),
    ("ros2_messages_dropped", "Messages that waited too long for ROS 2.", ros2_count("dropped")),
    (
        "robots_put_back",
        "Robots whose physics went bad and that were put back.",
        lambda meter: meter.server.world.recovery_log.put_back,
    ),
    (
        "world_resets",
        "Resets of the whole world because its physics went bad.",
        lambda meter: meter.server.world.recovery_log.resets,
    ),
)
"""Name, meaning and value of a world's counters; all names begin with usarmjx_."""


class WorldCollector(Collector):
    """Collects the metrics of the served worlds at each request.

    Args:
        meters: Meter of each world, by its number.
    """

    def __init__(self, meters: Mapping[int, StepMeter]) -> None:
        self._meters = {str(number): meter for number, meter in meters.items()}

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics of all worlds."""
        for kind, metrics in ((GaugeMetricFamily, GAUGES), (CounterMetricFamily, COUNTERS)):
            for name, about, value in metrics:
                family = kind(f"usarmjx_{name}", about, labels=["world"])
                for world, meter in self._meters.items():
                    family.add_metric([world], value(meter))
                yield family
        commands = CounterMetricFamily(
            "usarmjx_commands", "Commands that were legal.", labels=["world", "kind"]
        )
        gaps = HistogramMetricFamily(
            "usarmjx_step_gap_seconds", "Time between two control steps.", labels=["world"]
        )
        bounds = [*map(str, GAP_BOUNDS), "+Inf"]
        for world, meter in self._meters.items():
            for command, count in meter.server.counts.commands.items():
                commands.add_metric([world, command.__name__], count)
            # A bucket of Prometheus counts all values up to its bound, those of the smaller buckets too.
            gaps.add_metric([world], list(zip(bounds, accumulate(meter.gaps), strict=True)), meter.gap_sum)
        yield commands
        yield gaps


class MetricsServer:
    """A `gamebots.server.Service` that answers `/metrics` and `/healthz` for all worlds.

    Args:
        servers: Servers of the worlds; each gets a `StepMeter`.
        factor: Wanted simulated seconds per second; 0: as many as possible.
        bound: A socket that is bound to the port.
        numbers: Numbers of the worlds in the batch; None: the first ones.
    """

    def __init__(
        self,
        servers: Sequence[BotServer],
        factor: float,
        bound: socket.socket,
        numbers: Sequence[int] | None = None,
    ) -> None:
        self._meters = [StepMeter(server) for server in servers]
        for server, meter in zip(servers, self._meters, strict=True):
            server.services.append(meter)
        self._factor, self._bound = factor, bound
        # One of its own: the global registry refuses the same metrics for a second server of this process.
        self._registry = CollectorRegistry()
        own = range(len(servers)) if numbers is None else numbers
        self._registry.register(WorldCollector(dict(zip(own, self._meters, strict=True))))
        ProcessCollector(namespace="usarmjx", registry=self._registry)
        self._gate = Gate(servers[0].settings.access, MAX_CONNECTIONS, "metrics")
        self._server: Server | None = None

    async def start(self) -> list[str]:
        """Listen; return lines for the user.

        Raises:
            UsageError: The port cannot be listened on.
        """
        host, port = self._bound.getsockname()[:2]
        keep_reserve(self._bound)
        try:
            self._server = await serve(
                _no_websocket,
                sock=self._bound,
                process_request=asking_token(self._gate, self._answer),
                create_connection=gated_connection(self._gate),
                open_timeout=REQUEST_LIMIT,
            )
        except OSError as error:
            raise UsageError(f"cannot listen on {host}:{port}: {error}") from error
        return [f"metrics at http://{host}:{port}/metrics"]

    def tick(self) -> None:
        """Do nothing: the meters count."""

    def stop(self) -> None:
        """Close all connections."""
        if self._server is not None:
            self._server.close()

    def health(self) -> dict[str, object]:
        """Return the server's state.

        `status` is ok, behind if a world makes too little simulated time, or recording behind.
        """
        now = time.perf_counter()
        factors = [meter.realtime_factor(now) for meter in self._meters]
        # With a factor of 0 no speed is wanted, and nothing is ever behind.
        behind = min(factors) < IN_TIME * self._factor
        late = max(map(recording_lag, self._meters)) > MAX_RECORDING_LAG
        return {
            "status": "behind" if behind else "recording behind" if late else "ok",
            "realtime_factor": round(min(factors), 3),
            "clients": sum(len(meter.server.clients) for meter in self._meters),
            "worlds": len(self._meters),
        }

    def _answer(self, connection: ServerConnection, request: Request) -> Response:
        path = request.path.partition("?")[0]
        if path == "/metrics":
            return _respond(connection, generate_latest(self._registry).decode(), CONTENT_TYPE_PLAIN_0_0_4)
        if path == "/healthz":
            return _respond(connection, json.dumps(self.health()) + "\n", "application/json")
        return connection.respond(HTTPStatus.NOT_FOUND, "there is /metrics and /healthz\n")


async def _no_websocket(connection: ServerConnection) -> None:
    """Do nothing: every request is answered before it gets here."""


def _respond(connection: ServerConnection, text: str, kind: str) -> Response:
    response = connection.respond(HTTPStatus.OK, text)
    # Headers are a multi-dict: an assignment would add a second value to that of respond.
    del response.headers["Content-Type"]
    response.headers["Content-Type"] = kind
    return response
