"""Options that let clients, browsers and ROS into worlds, and the servers that they make."""

import contextlib
import ipaddress
import itertools
import socket
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple, Protocol, TypeAlias

import typer

from usarmjx.base.errors import UsageError
from usarmjx.base.process import limit_fragmentation
from usarmjx.cli.common import PortOffsetOption, RadioIniOption
from usarmjx.cli.recordings import RecordOption, recorded
from usarmjx.cli.viewer_options import (
    ViewerControlOption,
    ViewerPortOption,
    add_controls,
    add_viewer,
    viewer_settings,
    viewer_socket,
)
from usarmjx.server.network.access import AccessRules, check_token, parse_networks, read_token
from usarmjx.server.network.ports import (
    IMAGE_PORT,
    LAST_PORT,
    POSITION_PORT,
    WSS2_PORT,
    WSS_PORT,
    bound_ports,
    bound_socket,
    count_up,
)

if TYPE_CHECKING:
    from usarmjx.comms.attenuation import RadioSettings
    from usarmjx.server.gamebots.server import BotServer, Service
    from usarmjx.server.gamebots.settings import BotServerSettings
    from usarmjx.server.runtime.signals import StopSignals
    from usarmjx.server.viewing.viewer_service import ViewerSettings
    from usarmjx.server.worlds.served_world import ServedWorld


TOKEN_VARIABLE = "USARMJX_TOKEN"
AllowHostOption = Annotated[
    list[str] | None,
    typer.Option(help="Name under which browsers may ask for the page, beside localhost; may be repeated."),
]
AllowOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="CIDR,...",
        help="Networks or addresses that may connect, to all ports; may be repeated; else all may.",
    ),
]
TokenOption = Annotated[
    str | None,
    typer.Option(
        envvar=TOKEN_VARIABLE,
        help="A secret that clients have to say first, as AUTH {Token ...}. Other users can see it in the "
        "list of processes: better a file or the variable.",
    ),
]
TokenFileOption = Annotated[Path | None, typer.Option(help="A file that holds the token.")]
PerAddressOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Most connections of one address to one kind of port, loopback apart; else three quarters of "
        "the port's places.",
    ),
]
ZENOH_RMW = "rmw_zenoh_cpp"
Ros2Option: TypeAlias = Annotated[
    bool, typer.Option("--ros2", help="Be a node of ROS 2, over DDS or Zenoh, without ROS (extra ros2).")
]


def access_rules(
    allow: Sequence[str] | None, token: str | None, token_file: Path | None, per_address: int | None
) -> AccessRules:
    """Return the rules that the options make.

    Raises:
        UsageError: One is wrong, or the token is given twice.
    """
    if token is not None and token_file is not None:
        raise UsageError(f"give either --token (or {TOKEN_VARIABLE}) or --token-file")
    if token_file is not None:
        token = read_token(token_file)
    elif token is not None:
        token = check_token(token, f"--token or {TOKEN_VARIABLE}")
    return AccessRules(parse_networks(allow or ()), token or "", per_address)


def warn_if_open(address: str, rules: AccessRules) -> None:
    """Say on the standard error stream what strangers can do, or see, at an address that they can reach.

    Args:
        address: IP address that is listened on.
        rules: Clients admitted.
    """
    # Behind % stands the zone of a link-local address.
    if ipaddress.ip_address(address.partition("%")[0]).is_loopback:
        return
    where = f"usarmjx: warning: {address} is not this machine's loopback:"
    if rules.token:
        typer.echo(f"{where} the token crosses the network readable (docs/security.md has a proxy)", err=True)
    elif not rules.allow:
        typer.echo(
            f"{where} anybody with access may drive robots, look through their cameras and take all "
            "seats; --allow lists addresses that may connect, --token asks for a secret (docs/security.md)",
            err=True,
        )


Sockets = Mapping[str, socket.socket]
"""The bound sockets of one world, by the options that set their ports."""
ServiceMaker: TypeAlias = "Callable[[ServedWorld, Sockets], Service]"
"""Makes the service of a world."""


class ServiceOptions(Protocol):
    """A service that the command line may ask for."""

    @property
    def wanted(self) -> bool:
        """Whether it does."""
        ...

    @property
    def ports(self) -> Mapping[str, int]:
        """Its ports for the first world, by the options that set them."""
        ...

    def prepare(self, listen: "ListenOptions", ini: Sequence[Path]) -> ServiceMaker:
        """Read the other options; return what makes the service of a world.

        Args:
            listen: Addresses to listen on, and clients admitted.
            ini: Ini files with robots and more.

        Raises:
            UsageError: One of them is wrong.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class RadioOptions:
    """The wireless servers; each field is an option."""

    panel: ClassVar[str] = "Radio"

    wireless: Annotated[bool, typer.Option(help="Serve the radio too.")] = True
    wss_port: Annotated[
        int | None,
        typer.Option(
            min=0, max=LAST_PORT, help="Wireless server (REGISTER, OPEN); else ListenPort, or 5874."
        ),
    ] = None
    wss2_port: Annotated[
        int, typer.Option(min=0, max=LAST_PORT, help="Stand-alone wireless server (INIT, DNS).")
    ] = WSS2_PORT
    position_port: Annotated[
        int, typer.Option(min=0, max=LAST_PORT, help="Positions for a wireless server elsewhere (GETPOS).")
    ] = POSITION_PORT
    truth_port: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=LAST_PORT,
            help="True poses of robots and loose objects for anybody (USARTruth, usually 3989); else none.",
        ),
    ] = None
    radio_ini: RadioIniOption = None
    wireless_allow: Annotated[
        list[str] | None,
        typer.Option(help="IP address that may be dialled for others than itself; may be repeated."),
    ] = None

    @property
    def wanted(self) -> bool:
        """Whether there are any."""
        return self.wireless

    @cached_property
    def constants(self) -> "RadioSettings":
        """The radio's constants."""
        from usarmjx.comms.attenuation import RadioSettings, radio_settings

        return radio_settings(self.radio_ini) if self.radio_ini else RadioSettings()

    @property
    def ports(self) -> dict[str, int]:
        """Their ports by their options."""
        # Without an ini nothing of the radio is imported only to know a port.
        usual = self.constants.listen_port if self.radio_ini else WSS_PORT
        ports = {
            "--wss-port": usual if self.wss_port is None else self.wss_port,
            "--wss2-port": self.wss2_port,
            "--position-port": self.position_port,
        }
        return ports if self.truth_port is None else {**ports, "--truth-port": self.truth_port}

    def prepare(self, listen: "ListenOptions", ini: Sequence[Path]) -> ServiceMaker:
        """Return the maker of the wireless servers of a world."""
        from usarmjx.server.wireless.dialect_a import check_addresses
        from usarmjx.server.wireless.net import WirelessSettings, make_wireless

        del ini
        allow = check_addresses(self.wireless_allow or ())

        def make(world: "ServedWorld", sockets: Sockets) -> "Service":
            names = ("wss", "wss2", "position", "truth")
            bound = {name: sockets[f"--{name}-port"] for name in names if f"--{name}-port" in sockets}
            ports = {f"{name}_port": port_of(own) for name, own in bound.items()}
            settings = WirelessSettings(listen.host, allow=allow, access=listen.rules, **ports)
            return make_wireless(world, self.constants, settings, bound)

        return make


@dataclass(frozen=True, kw_only=True)
class ImageOptions:
    """The image server; each field is an option."""

    panel: ClassVar[str] = "Pictures"

    images: Annotated[bool, typer.Option(help="Serve the robots' cameras too.")] = True
    image_port: Annotated[
        int, typer.Option(min=0, max=LAST_PORT, help="Image server (pictures, and OK for the next).")
    ] = IMAGE_PORT
    image_size: Annotated[
        str | None,
        typer.Option(help="Width and height of pictures; else 320x240, or as large as a MultiView needs."),
    ] = None
    image_fps: Annotated[
        float, typer.Option(min=0.1, max=100.0, help="Most pictures per second for each client.")
    ] = 10.0
    image_format: Annotated[
        str, typer.Option(help="raw (0), or JPEG: super, good, normal, average, bad (1 to 5).")
    ] = "normal"
    multi_view: Annotated[
        bool,
        typer.Option(
            "--multi-view", help="All robots' first cameras in one picture, by [USARBot.MultiView] of --ini."
        ),
    ] = False

    @property
    def wanted(self) -> bool:
        """Whether there is one."""
        return self.images

    @property
    def ports(self) -> dict[str, int]:
        """Its port by its option."""
        return {"--image-port": self.image_port}

    def prepare(self, listen: "ListenOptions", ini: Sequence[Path]) -> ServiceMaker:
        """Return the maker of the image server of a world."""
        from usarmjx.server.pictures.image_server import SIZE, ImageServer, ImageSettings
        from usarmjx.server.protocol.images import format_number, parse_size
        from usarmjx.server.protocol.viewports import read_multi_view

        shared = read_multi_view(ini) if self.multi_view else None
        settings = ImageSettings(
            listen.host,
            self.image_port,
            parse_size(self.image_size) if self.image_size else shared.size if shared else SIZE,
            self.image_fps,
            format_number(self.image_format),
            multi_view=shared,
            access=listen.rules,
        )

        def make(world: "ServedWorld", sockets: Sockets) -> "Service":
            bound = sockets["--image-port"]
            # The port as bound: the option's may be 0, or moved by the offset.
            return ImageServer(world, replace(settings, port=port_of(bound)), bound)

        return make


def port_of(bound: socket.socket) -> int:
    """Return the port that a socket is bound to."""
    return bound.getsockname()[1]


RosbridgePortOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        min=0, max=LAST_PORT, help="Serve rosbridge clients of ROS at this port, usually 9090; else none."
    ),
]


@dataclass(frozen=True, kw_only=True)
class RosOptions:
    """Robots as ROS sees them; each field is an option."""

    panel: ClassVar[str] = "ROS"

    rosbridge_port: RosbridgePortOption = None
    ros_version: Annotated[
        int,
        typer.Option(
            min=1, max=2, help="1 or 2: whose names of types and times they hear, unless they ask otherwise."
        ),
    ] = 2
    rosbridge_allow_host: Annotated[
        list[str] | None,
        typer.Option(help="Host whose pages may connect to it, beside localhost; may be repeated."),
    ] = None

    @property
    def wanted(self) -> bool:
        """Whether there is such a port."""
        return self.rosbridge_port is not None

    @property
    def ports(self) -> dict[str, int]:
        """Its port by its option."""
        # 0 is for the type only: without a port the service is not wanted, and nobody asks.
        return {"--rosbridge-port": self.rosbridge_port or 0}

    def prepare(self, listen: "ListenOptions", ini: Sequence[Path]) -> ServiceMaker:
        """Return the maker of the service of a world."""
        from usarmjx.server.network.web_gate import check_names
        from usarmjx.server.rosbridge.definitions import RosVersion
        from usarmjx.server.rosbridge.net import RosbridgeServer, RosSettings

        del ini
        names = check_names(self.rosbridge_allow_host or (), "--rosbridge-allow-host")
        settings = RosSettings(
            listen.host, version=RosVersion(self.ros_version), access=listen.rules, names=names
        )

        def make(world: "ServedWorld", sockets: Sockets) -> "Service":
            bound = sockets["--rosbridge-port"]
            return RosbridgeServer(world, replace(settings, port=port_of(bound)), bound)

        return make


def connect_ros(servers: "Sequence[BotServer]") -> None:
    """Let robots that appear by ROS report to the servers of their worlds."""
    from usarmjx.server.ros2.server import Ros2Server
    from usarmjx.server.rosbridge.net import RosbridgeServer

    for server in servers:
        # Afterwards, as a server is made of its services.
        for service in server.services:
            if isinstance(service, RosbridgeServer | Ros2Server):
                service.server = server


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
    from usarmjx.server.worlds.instances import parse_instances

    # As text, so that one parser checks both options.
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
    """Return the settings of a world's server; an option overrides BotAPI.ini among the ini files.

    As a robot takes a connection, there is at least one for each seat, unless an option sets fewer.

    Raises:
        UsageError: There is no such dialect.
    """
    from usarmjx.server.gamebots.settings import BotServerSettings, read_bot_server
    from usarmjx.server.protocol.dialects import find_dialect

    spoken = find_dialect(dialect)
    # From weak to strong: the dialect's default, the ini file, the option below.
    given = {"max_connections": spoken.max_connections, **read_bot_server(ini or ())}
    read = BotServerSettings(host, init_timeout=init_timeout, access=rules, dialect=spoken, **given)
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

    If one world of a batch of one roster is served, its terminal can choose another while it runs.
    """
    from usarmjx.server.gamebots.server import BotServer
    from usarmjx.server.worlds.batch_world import BatchWorld, InstanceSwitch

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
def metrics_socket(host: str, port: int | None, offset: int) -> Generator[socket.socket | None]:
    """Take the port of the figures, moved by the offset unless it is 0; None: there are none.

    Raises:
        UsageError: It is taken, or there is no such port.
    """
    if port is None:
        yield None
        return
    # 0 means any free port, which an offset would turn into a fixed one.
    port = port + offset if port else 0
    if port > LAST_PORT:
        raise UsageError(f"--metrics-port leads to port {port}; the last one is {LAST_PORT}")
    with bound_socket(host, port, "--metrics-port") as bound:
        yield bound


def add_metrics(
    servers: "Sequence[BotServer]", factor: float, bound: socket.socket, numbers: Sequence[int]
) -> None:
    """Let servers' figures be served at a socket; the factor is the simulated seconds per second wanted."""
    from usarmjx.server.runtime.metrics import MetricsServer

    # To one server only, as it serves the figures of all.
    servers[0].services.append(MetricsServer(servers, factor, bound, numbers))


@dataclass(frozen=True, kw_only=True)
class ListenOptions:
    """Options of the clients' port, their number and their addresses; each field is an option."""

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
            min=1,
            help="Most clients of one world; else MaxConnections of --ini, or 16 (udk: 64); or --seats.",
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
        """Access rules of clients.

        Raises:
            UsageError: An option is wrong, or the token is given twice.
        """
        return access_rules(self.allow, self.token, self.token_file, self.connections_per_address)

    def settings(self, ini: Sequence[Path], seats: int | None) -> "BotServerSettings":
        """Return the settings of a world's server.

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
    allow_host: AllowHostOption = None


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of a run: pace, limits, metrics and recording; each field is an option."""

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
    """Services beside the robots' ports.

    Attributes:
        makers: Factories of a world's services.
        viewer: Settings of the live page.
    """

    makers: "Sequence[ServiceMaker]"
    viewer: "ViewerSettings"


@dataclass(frozen=True, kw_only=True)
class Host:
    """Takes ports at once, and serves worlds there once they are built.

    Attributes:
        listen: Port of clients.
        settings: Settings of serving each world.
        numbers: Which worlds of the batch are served.
        run: Their speed.
        viewer: The live page.
        view: Whether there is one.
        services: Services of each world.
        layers: Layers that the live page shows at first beside the default ones.
    """

    listen: ListenOptions
    settings: "BotServerSettings"
    numbers: Sequence[int]
    run: RunOptions
    viewer: ViewerOptions
    view: bool
    services: Sequence[ServiceOptions] = field(default_factory=list[ServiceOptions])
    layers: Sequence[str] = ()

    @contextlib.contextmanager
    def ports(self) -> "Generator[OpenPorts]":
        """Take all ports while the context lasts.

        Raises:
            UsageError: One is taken, or there is no such port; names the option.
        """
        limit_fragmentation()  # the first step of every server
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
        return [one for one in self.services if one.wanted]

    def warn(self, ports: "OpenPorts") -> None:
        """Say what strangers could do here, if they can reach it."""
        # As bound: --host may be a name, which does not show whether it leads to the loopback.
        warn_if_open(ports.bound[0]["--port"].getsockname()[0], self.listen.rules)

    def prepare(self, ini: Sequence[Path] = ()) -> "Services":
        """Read the options of all services.

        Raises:
            UsageError: One is wrong.
        """
        makers = [one.prepare(self.listen, ini) for one in self._wanted]
        names, control = self.viewer.allow_host or (), self.viewer.viewer_control
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
            ports: Bound ports.
            services: Layers beside robots.
            signals: Signals that end it.
            batch_size: Number of worlds in the batch.
            more: Services that all worlds share.
            radio: Constants of the radio for the live page and recordings; None: they have none to show.
        """
        from usarmjx.server.runtime.loop import StepClock
        from usarmjx.server.runtime.loop import serve as run

        settings = replace(self.settings, time_limit=self.run.time_limit)
        servers = make_servers(worlds, settings, services.makers, ports.bound, self.numbers, batch_size)
        connect_ros(servers)
        # To one server only: what all worlds share must run once.
        servers[0].services.extend(more)
        if ports.metrics is not None:
            add_metrics(servers, self.run.realtime_factor, ports.metrics, self.numbers)
        clock = StepClock(self.run.realtime_factor)
        controls = add_controls(servers, clock)
        if ports.page is not None:
            add_viewer(servers, controls, ports.page, services.viewer, radio, self.layers)
        with recorded(worlds, self.run.record, radio) as file:
            if file is not None:
                # When a signal ends the process at once, the process waits until the file is complete.
                signals.finish_files(file.close)
            run(servers, clock, signals)


@dataclass(frozen=True, kw_only=True)
class Ros2Options:
    """The ROS 2 node; each field is an option."""

    panel: ClassVar[str] = "ROS"

    ros2: Ros2Option = False
    ros2_transport: Annotated[
        str | None,
        typer.Option(help="dds or zenoh; else zenoh if RMW_IMPLEMENTATION is rmw_zenoh_cpp, and dds."),
    ] = None
    ros_domain_id: Annotated[
        int,
        typer.Option(envvar="ROS_DOMAIN_ID", help="ROS 2's domain; further worlds have the next ones."),
    ] = 0
    ros2_network: Annotated[
        bool,
        typer.Option("--ros2-network", help="Let nodes on other machines find it: DDS asks for no token."),
    ] = False
    ros2_map: Annotated[
        bool,
        typer.Option(help="Publish /map and the frame map; a node that maps or localises does so itself."),
    ] = True
    ros2_infinite_ranges: Annotated[
        bool,
        typer.Option("--ros2-infinite-ranges", help="A beam without an echo is infinite, as REP 117 has it."),
    ] = False

    @property
    def wanted(self) -> bool:
        """Whether there is one."""
        return self.ros2

    @property
    def ports(self) -> dict[str, int]:
        """None: the middleware has its own."""
        return {}

    def prepare(self, listen: "ListenOptions", ini: Sequence[Path]) -> "ServiceMaker":
        """Return the maker of the node of a world; each world has a domain of its own.

        Raises:
            UsageError: An option is not valid, or others ask for what a middleware cannot do.
        """
        import os

        from usarmjx.server.ros2.server import Ros2Server, Ros2Settings

        del ini
        # DDS asks for no token and no address: these options would promise a guard that is not there.
        if self.ros2_network and (listen.rules.token or listen.rules.allow):
            raise UsageError("--ros2-network lets everybody in: it has neither --token nor --allow")
        # Nodes of ROS choose their middleware by this variable: both sides then speak the same.
        by_environment = "zenoh" if os.environ.get("RMW_IMPLEMENTATION") == ZENOH_RMW else "dds"
        settings = Ros2Settings(
            domain=self.ros_domain_id,
            transport=self.ros2_transport or by_environment,
            is_local=not self.ros2_network,
            publishes_map=self.ros2_map,
            infinite_ranges=self.ros2_infinite_ranges,
        )
        # Worlds are made in their order, each in the next domain.
        numbers = itertools.count(settings.domain)

        def make(world: "ServedWorld", sockets: "Sockets") -> "Service":
            del sockets
            return Ros2Server(world, replace(settings, domain=next(numbers)))

        return make
