"""What commands share that let clients and browsers into worlds: options, and what comes of them."""

import contextlib
import socket
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple

import typer

from usarmjx.cli.access_options import (
    AllowOption,
    PerAddressOption,
    TokenFileOption,
    TokenOption,
    access_rules,
    warn_if_open,
)
from usarmjx.cli.recordings import RecordOption, recorded
from usarmjx.cli.ros_options import connect_rosbridge
from usarmjx.cli.serve_run import MetricsOption, add_metrics, bot_settings, make_servers, metrics_socket
from usarmjx.cli.service_options import ServiceMaker, ServiceOptions, Sockets, SpectatorOptions
from usarmjx.cli.tools import PortOffsetOption
from usarmjx.cli.viewer_options import (
    ViewerControlOption,
    ViewerPortOption,
    add_controls,
    add_viewer,
    viewer_settings,
    viewer_socket,
)
from usarmjx.server.ports import LAST_PORT, bound_ports, count_up

if TYPE_CHECKING:
    from usarmjx.comms.attenuation import RadioSettings
    from usarmjx.server.access import AccessRules
    from usarmjx.server.bot_server import BotServerSettings
    from usarmjx.server.net import Service
    from usarmjx.server.signals import StopSignals
    from usarmjx.server.viewing.viewer_service import ViewerSettings
    from usarmjx.server.worlds.served_world import ServedWorld


@dataclass(frozen=True, kw_only=True)
class ListenOptions:
    """Where clients connect, how many, and who may; each field is an option."""

    panel: ClassVar[str] = "Connections"

    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1"
    port: Annotated[
        int | None,
        typer.Option(
            min=0, max=LAST_PORT, help="TCP port (0: a free one); else ListenPort of --ini, or 3000."
        ),
    ] = None
    port_offset: PortOffsetOption = 0
    max_connections: Annotated[
        int | None,
        typer.Option(
            min=1, help="Most clients of one world; else MaxConnections of --ini, or 16; or --seats."
        ),
    ] = None
    init_timeout: Annotated[
        float,
        typer.Option(
            min=0.0,
            help="Seconds after which a client without a robot goes if it asks for nothing, or if others "
            "need its seat; 0: never.",
        ),
    ] = 60.0
    dialect: Annotated[
        str, typer.Option(help="manual: the wire protocol of its version; udk: that of the later ones.")
    ] = "manual"
    allow: AllowOption = None
    token: TokenOption = None
    token_file: TokenFileOption = None
    connections_per_address: PerAddressOption = None

    @cached_property
    def rules(self) -> "AccessRules":
        """Who may connect.

        Raises:
            UsageError: An option is wrong, or the token is given twice.
        """
        return access_rules(self.allow, self.token, self.token_file, self.connections_per_address)

    def settings(self, ini: Sequence[Path], seats: int | None) -> "BotServerSettings":
        """Return how to serve a world.

        Args:
            ini: Ini files, of which BotAPI.ini says what no option says.
            seats: Most robots in a world; None: as many as connections.
        """
        return bot_settings(
            ini,
            seats,
            host=self.host,
            port=self.port,
            max_connections=self.max_connections,
            init_timeout=self.init_timeout,
            rules=self.rules,
            dialect=self.dialect,
        )


@dataclass(frozen=True, kw_only=True)
class ViewerOptions:
    """The live page; each field is an option."""

    panel: ClassVar[str] = "Pages"

    viewer_port: ViewerPortOption = None
    viewer_control: ViewerControlOption = False


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """How fast worlds run, and what is told and kept of them; each field is an option."""

    panel: ClassVar[str] = "Time, figures, recording"

    realtime_factor: Annotated[
        float, typer.Option(min=0.0, help="Simulated seconds per second; 0: as fast as it can.")
    ] = 1.0
    time_limit: Annotated[
        int, typer.Option(min=0, help="Minutes of simulated time after which serving ends; 0: never.")
    ] = 0
    metrics_port: MetricsOption = None
    record: RecordOption = None


class OpenPorts(NamedTuple):
    """Ports that were taken.

    Attributes:
        bound: Of every world by the options that set them.
        metrics: Of the figures; None: there are none.
        page: Of the live page; None: there is none.
    """

    bound: "Sequence[Sockets]"
    metrics: socket.socket | None
    page: socket.socket | None


class Services(NamedTuple):
    """What is served beside robots.

    Attributes:
        makers: What makes the services of a world.
        viewer: How the live page is served.
    """

    makers: "Sequence[ServiceMaker]"
    viewer: "ViewerSettings"


@dataclass(frozen=True, kw_only=True)
class Host:
    """Takes ports at once, and serves worlds there once they are built.

    Attributes:
        listen: Where clients connect.
        settings: How each world is served.
        numbers: Which worlds of the batch are served.
        run: How fast they run.
        viewer: The live page.
        view: Whether there is one.
        spectator: The spectator's page, of which browsers may use the same names.
        services: Services of each world.
        layers: What the live page shows at first beside what it always does.
    """

    listen: ListenOptions
    settings: "BotServerSettings"
    numbers: Sequence[int]
    run: RunOptions
    viewer: ViewerOptions
    view: bool
    spectator: SpectatorOptions
    services: Sequence[ServiceOptions] = field(default_factory=list[ServiceOptions])
    layers: Sequence[str] = ()

    @contextlib.contextmanager
    def ports(self) -> "Iterator[OpenPorts]":
        """Take all ports while the context lasts.

        Raises:
            UsageError: One is taken, or there is no such port; names the option.
        """
        first = {"--port": self.settings.port}
        first |= {option: port for one in self._wanted for option, port in one.ports.items()}
        host, offset = self.listen.host, self.listen.port_offset
        with (
            bound_ports(host, count_up(first, len(self.numbers), offset)) as bound,
            metrics_socket(host, self.run.metrics_port, offset) as metrics,
            viewer_socket(host, self.viewer.viewer_port, offset, self.view) as page,
        ):
            yield OpenPorts(bound, metrics, page)

    @property
    def _wanted(self) -> list[ServiceOptions]:
        return [one for one in (*self.services, self.spectator) if one.wanted]

    def warn(self, ports: "OpenPorts") -> None:
        """Say what strangers could do here, if they can reach it."""
        warn_if_open(ports.bound[0]["--port"].getsockname()[0], self.listen.rules)

    def prepare(self, ini: Sequence[Path] = ()) -> "Services":
        """Read the options of all services.

        Raises:
            UsageError: One is wrong.
        """
        makers = [one.prepare(self.listen, ini) for one in self._wanted]
        names, control = self.spectator.allow_host or (), self.viewer.viewer_control
        return Services(makers, viewer_settings(self.listen.host, self.listen.rules, names, control))

    def serve(
        self,
        worlds: "Sequence[ServedWorld]",
        ports: "OpenPorts",
        services: "Services",
        signals: "StopSignals",
        *,
        batch_size: int,
        more: "Sequence[Service]" = (),
        radio: "RadioSettings | None" = None,
    ) -> None:
        """Serve worlds until a signal comes.

        Args:
            worlds: Those of `numbers`.
            ports: Where.
            services: What beside robots.
            signals: What ends it.
            batch_size: How many worlds there are in the batch.
            more: Services that all worlds share.
            radio: Constants of the radio for the live page and recordings; None: they have none to show.
        """
        from usarmjx.server.clock import StepClock
        from usarmjx.server.loop import serve as run

        settings = replace(self.settings, time_limit=self.run.time_limit)
        servers = make_servers(worlds, settings, services.makers, ports.bound, self.numbers, batch_size)
        connect_rosbridge(servers)
        servers[0].services.extend(more)
        if ports.metrics is not None:
            add_metrics(servers, self.run.realtime_factor, ports.metrics, self.numbers)
        clock = StepClock(self.run.realtime_factor)
        controls = add_controls(servers, clock)
        if ports.page is not None:
            add_viewer(servers, controls, ports.page, services.viewer, radio, self.layers)
        with recorded(worlds, self.run.record, radio) as file:
            if file is not None:
                signals.finish_files(file.close)
            run(servers, clock, signals)
