"""Options of the ROS 2 node of served worlds."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, TypeAlias

import typer

from usarmjx.base.errors import UsageError

if TYPE_CHECKING:
    from usarmjx.cli.serving_options import ListenOptions, ServiceMaker, Sockets
    from usarmjx.server.gamebots.server import Service
    from usarmjx.server.worlds.served_world import ServedWorld

ZENOH_RMW = "rmw_zenoh_cpp"
Ros2Option: TypeAlias = Annotated[
    bool, typer.Option("--ros2", help="Be a node of ROS 2, over DDS or Zenoh, without ROS (extra ros2).")
]


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
        if self.ros2_network and (listen.rules.token or listen.rules.allow):
            raise UsageError("--ros2-network lets everybody in: it has neither --token nor --allow")
        by_environment = "zenoh" if os.environ.get("RMW_IMPLEMENTATION") == ZENOH_RMW else "dds"
        settings = Ros2Settings(
            domain=self.ros_domain_id,
            transport=self.ros2_transport or by_environment,
            is_local=not self.ros2_network,
            publishes_map=self.ros2_map,
            infinite_ranges=self.ros2_infinite_ranges,
        )
        numbers = itertools.count(settings.domain)

        def make(world: "ServedWorld", sockets: "Sockets") -> "Service":
            del sockets
            return Ros2Server(world, replace(settings, domain=next(numbers)))

        return make
