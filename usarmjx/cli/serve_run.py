"""What `usarmjx serve` makes of its options: which worlds, which ports, which servers.

What can be known without JAX is known before JAX is imported; the classes here say how far that is: their
ports at once, the rest in `prepare`.
"""

import contextlib
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Protocol

import typer

from usarmjx.base.errors import UsageError
from usarmjx.server.instances import parse_instances
from usarmjx.server.ports import LAST_PORT, WSS_PORT, bound_socket

if TYPE_CHECKING:
    from usarmjx.comms.attenuation import RadioSettings
    from usarmjx.server.access import AccessRules
    from usarmjx.server.bot_server import BotServerSettings
    from usarmjx.server.net import BotServer, Service
    from usarmjx.server.worlds.served_world import ServedWorld

Sockets = Mapping[str, socket.socket]
"""The bound sockets of one world, by the options that set their ports."""
MetricsOption = Annotated[
    int | None,
    typer.Option(
        min=0, max=LAST_PORT, help="Figures for Prometheus at /metrics of this port, and /healthz; else none."
    ),
]


class ServiceChoice(Protocol):
    """A service that the command line asks for."""

    @property
    def ports(self) -> Mapping[str, int]:
        """Its ports for the first world, by the options that set them."""
        ...

    def prepare(self, host: str, rules: "AccessRules") -> Callable[["ServedWorld", Sockets], "Service"]:
        """Read the other options; return what makes the service of a world.

        Args:
            host: Address to listen on.
            rules: Who may connect.

        Raises:
            UsageError: One of them is wrong.
        """
        ...


@dataclass(frozen=True)
class RadioChoice:
    """The wireless servers.

    Attributes:
        given: Their ports by their options; None for that of the ini file.
        ini: USARComServer.ini.
        allow: Addresses that may be dialled for others.
    """

    given: Mapping[str, int | None]
    ini: Path | None
    allow: Sequence[str]

    @cached_property
    def radio(self) -> "RadioSettings":
        """The radio's constants."""
        from usarmjx.comms.attenuation import RadioSettings, radio_settings

        return radio_settings(self.ini) if self.ini else RadioSettings()

    @property
    def ports(self) -> dict[str, int]:
        """Their ports by their options."""
        usual = self.radio.listen_port if self.ini else WSS_PORT
        return {option: usual if port is None else port for option, port in self.given.items()}

    def prepare(self, host: str, rules: "AccessRules") -> Callable[["ServedWorld", Sockets], "Service"]:
        """Return what makes the wireless servers of a world."""
        from usarmjx.server.wireless.comserver import check_addresses
        from usarmjx.server.wireless.net import WirelessSettings, make_wireless

        allow = check_addresses(self.allow)

        def make(world: "ServedWorld", sockets: Sockets) -> "Service":
            bound = {name: sockets[f"--{name}-port"] for name in ("wss", "wss2", "position")}
            ports = {f"{name}_port": port_of(own) for name, own in bound.items()}
            settings = WirelessSettings(host, allow=allow, access=rules, **ports)
            return make_wireless(world, self.radio, settings, bound)

        return make


@dataclass(frozen=True)
class ImageChoice:
    """The image server.

    Attributes:
        port: Its port.
        size: Width and height as typed, or None for the usual ones.
        fps: Most pictures per second for each client.
        format: Type of picture as typed.
        shared: Ini files of a MultiView, or None without one.
    """

    port: int
    size: str | None
    fps: float
    format: str
    shared: Sequence[Path] | None

    @property
    def ports(self) -> dict[str, int]:
        """Its port by its option."""
        return {"--image-port": self.port}

    def prepare(self, host: str, rules: "AccessRules") -> Callable[["ServedWorld", Sockets], "Service"]:
        """Return what makes the image server of a world."""
        from usarmjx.server.pictures.image_server import SIZE, ImageServer, ImageSettings
        from usarmjx.server.protocol.images import format_number, parse_size
        from usarmjx.server.protocol.multi_view import read_multi_view

        shared = None if self.shared is None else read_multi_view(self.shared)
        size = parse_size(self.size) if self.size else shared.size if shared else SIZE
        number = format_number(self.format)
        settings = ImageSettings(host, self.port, size, self.fps, number, multi_view=shared, access=rules)

        def make(world: "ServedWorld", sockets: Sockets) -> "Service":
            bound = sockets["--image-port"]
            return ImageServer(world, replace(settings, port=port_of(bound)), bound)

        return make


@dataclass(frozen=True)
class PageChoice:
    """The page that shows a world.

    Attributes:
        port: Its port.
        names: What browsers may call the server, as typed.
    """

    port: int
    names: Sequence[str] = ()

    @property
    def ports(self) -> dict[str, int]:
        """Its port by its option."""
        return {"--spectator-port": self.port}

    def prepare(self, host: str, rules: "AccessRules") -> Callable[["ServedWorld", Sockets], "Service"]:
        """Return what makes the page of a world."""
        from usarmjx.server.host_names import check_names
        from usarmjx.server.log_tail import keep_log
        from usarmjx.server.pictures.spectator_server import SpectatorServer, SpectatorSettings

        settings = SpectatorSettings(host, access=rules, names=check_names(self.names))

        def make(world: "ServedWorld", sockets: Sockets) -> "Service":
            bound = sockets["--spectator-port"]
            return SpectatorServer(world, replace(settings, port=port_of(bound)), bound, keep_log())

        return make


def port_of(bound: socket.socket) -> int:
    """Return the port that a socket is bound to."""
    return bound.getsockname()[1]


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
) -> "BotServerSettings":
    """Return how to serve a world; an option overrides what BotAPI.ini among the ini files says.

    As a robot takes a connection, there are as many as seats at least, unless an option says otherwise.
    """
    from usarmjx.server.bot_server import BotServerSettings, read_bot_server

    read = BotServerSettings(host, init_timeout=init_timeout, access=rules, **read_bot_server(ini or ()))
    return replace(
        read,
        port=read.port if port is None else port,
        max_connections=max_connections or max(read.max_connections, seats or 0),
    )


def make_servers(
    worlds: "Sequence[ServedWorld]",
    settings: "BotServerSettings",
    makers: Sequence[Callable[["ServedWorld", Sockets], "Service"]],
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
