"""What commands that serve make of their options: which worlds, which servers, which figures."""

import contextlib
import socket
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.service_options import ServiceMaker, Sockets, port_of
from usarmjx.server.instances import parse_instances
from usarmjx.server.ports import LAST_PORT, bound_socket

if TYPE_CHECKING:
    from usarmjx.server.access import AccessRules
    from usarmjx.server.bot_server import BotServerSettings
    from usarmjx.server.net import BotServer
    from usarmjx.server.worlds.served_world import ServedWorld

MetricsOption = Annotated[
    int | None,
    typer.Option(
        min=0, max=LAST_PORT, help="Figures for Prometheus at /metrics of this port, and /healthz; else none."
    ),
]


def instances_of(several: str | None, one: int | None, worlds: int) -> tuple[int, ...]:
    """Return which worlds are served: those of `--instances`, or that of `--instance`, or the first.

    Raises:
        UsageError: Both are given, or there is no such world.
    """
    if several is not None and one is not None:
        raise UsageError("give either --instance or --instances")
    return parse_instances(str(one or 0) if several is None else several, worlds)


def bot_settings(
    ini: Sequence[Path] | None,
    seats: int | None,
    *,
    host: str,
    port: int | None,
    max_connections: int | None,
    init_timeout: float,
    rules: "AccessRules",
    dialect: str,
) -> "BotServerSettings":
    """Return how to serve a world; an option overrides what BotAPI.ini among the ini files says.

    As a robot takes a connection, there are as many as seats at least, unless an option says otherwise.

    Raises:
        UsageError: There is no such dialect.
    """
    from usarmjx.server.bot_server import BotServerSettings, read_bot_server
    from usarmjx.server.protocol.dialects import find_dialect

    spoken = find_dialect(dialect)
    read = BotServerSettings(
        host, init_timeout=init_timeout, access=rules, dialect=spoken, **read_bot_server(ini or ())
    )
    return replace(
        read,
        port=read.port if port is None else port,
        max_connections=max_connections or max(read.max_connections, seats or 0),
    )


def make_servers(
    worlds: "Sequence[ServedWorld]",
    settings: "BotServerSettings",
    makers: Sequence[ServiceMaker],
    bound: Sequence[Sockets],
    instances: Sequence[int],
    batch_size: int,
) -> "list[BotServer]":
    """Return the servers of some worlds of a batch with their services, at the ports bound for each.

    Where one is served of a batch of one roster, whoever runs it can choose another while it runs.
    """
    from usarmjx.server.net import BotServer
    from usarmjx.server.switch import InstanceSwitch
    from usarmjx.server.worlds.batch_world import BatchWorld

    titles = [f"world {number}" for number in instances] if len(instances) > 1 else [""]
    servers: list[BotServer] = []
    for world, sockets, title in zip(worlds, bound, titles, strict=True):
        services = [make(world, sockets) for make in makers]
        if len(instances) == 1 and batch_size > 1 and isinstance(world, BatchWorld):
            services.append(InstanceSwitch(world, batch_size))
        own = sockets["--port"]
        servers.append(BotServer(world, replace(settings, port=port_of(own)), services, own, title))
    return servers


@contextlib.contextmanager
def metrics_socket(host: str, port: int | None, offset: int) -> Iterator[socket.socket | None]:
    """Take the port of the figures, moved by the offset unless it is 0; None: there are none.

    Raises:
        UsageError: It is taken, or there is no such port.
    """
    if port is None:
        yield None
        return
    port = port + offset if port else 0
    if port > LAST_PORT:
        raise UsageError(f"--metrics-port leads to port {port}; the last one is {LAST_PORT}")
    with bound_socket(host, port, "--metrics-port") as bound:
        yield bound


def add_metrics(
    servers: "Sequence[BotServer]", factor: float, bound: socket.socket, numbers: Sequence[int]
) -> None:
    """Let servers' figures be served at a socket; the factor is the simulated seconds per second wanted."""
    from usarmjx.server.metrics import MetricsServer

    servers[0].services.append(MetricsServer(servers, factor, bound, numbers))
