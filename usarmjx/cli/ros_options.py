"""The rosbridge port as options of commands that serve."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, TypeAlias

import typer

from usarmjx.cli.service_options import ServiceMaker, Sockets, port_of
from usarmjx.server.ports import LAST_PORT

if TYPE_CHECKING:
    from usarmjx.cli.hosting import ListenOptions
    from usarmjx.server.net import BotServer, Service
    from usarmjx.server.worlds.served_world import ServedWorld


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
        return {"--rosbridge-port": self.rosbridge_port or 0}

    def prepare(self, listen: "ListenOptions", ini: Sequence[Path]) -> ServiceMaker:
        """Return what makes the service of a world."""
        from usarmjx.server.host_names import check_names
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


def connect_rosbridge(servers: "Sequence[BotServer]") -> None:
    """Let robots that appear by rosbridge report to the servers of their worlds."""
    from usarmjx.server.rosbridge.net import RosbridgeServer

    for server in servers:
        for service in server.services:
            if isinstance(service, RosbridgeServer):
                service.server = server
