"""Services of a served world as options: its radio, its pictures, its spectator's page.

What can be known without JAX is known before JAX is imported; the classes here say how far that is: their
ports at once, the rest in `prepare`.
"""

import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Protocol, TypeAlias

import typer

from usarmjx.cli.access_options import AllowHostOption
from usarmjx.cli.tools import RadioIniOption
from usarmjx.server.ports import IMAGE_PORT, LAST_PORT, POSITION_PORT, WSS2_PORT, WSS_PORT

if TYPE_CHECKING:
    from usarmjx.cli.hosting import ListenOptions
    from usarmjx.comms.attenuation import RadioSettings
    from usarmjx.server.net import Service
    from usarmjx.server.worlds.served_world import ServedWorld

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
            listen: Where to listen, and who may connect.
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
        usual = self.constants.listen_port if self.radio_ini else WSS_PORT
        return {
            "--wss-port": usual if self.wss_port is None else self.wss_port,
            "--wss2-port": self.wss2_port,
            "--position-port": self.position_port,
        }

    def prepare(self, listen: "ListenOptions", ini: Sequence[Path]) -> ServiceMaker:
        """Return what makes the wireless servers of a world."""
        from usarmjx.server.wireless.comserver import check_addresses
        from usarmjx.server.wireless.net import WirelessSettings, make_wireless

        del ini
        allow = check_addresses(self.wireless_allow or ())

        def make(world: "ServedWorld", sockets: Sockets) -> "Service":
            bound = {name: sockets[f"--{name}-port"] for name in ("wss", "wss2", "position")}
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
        typer.Option(help="Width and height of pictures; else 320x240, or what a MultiView needs."),
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
        """Return what makes the image server of a world."""
        from usarmjx.server.pictures.image_server import SIZE, ImageServer, ImageSettings
        from usarmjx.server.protocol.images import format_number, parse_size
        from usarmjx.server.protocol.multi_view import read_multi_view

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
            return ImageServer(world, replace(settings, port=port_of(bound)), bound)

        return make


@dataclass(frozen=True, kw_only=True)
class SpectatorOptions:
    """The page that shows what the original's viewing client did; each field is an option."""

    panel: ClassVar[str] = "Pages"

    spectator_port: Annotated[
        int | None,
        typer.Option(min=0, max=LAST_PORT, help="Show each world on a page of this port; else no such page."),
    ] = None
    allow_host: AllowHostOption = None

    @property
    def wanted(self) -> bool:
        """Whether there is one."""
        return self.spectator_port is not None

    @property
    def ports(self) -> dict[str, int]:
        """Its port by its option."""
        return {"--spectator-port": self.spectator_port or 0}

    def prepare(self, listen: "ListenOptions", ini: Sequence[Path]) -> ServiceMaker:
        """Return what makes the page of a world."""
        from usarmjx.server.host_names import check_names
        from usarmjx.server.log_tail import keep_log
        from usarmjx.server.pictures.spectator_server import SpectatorServer, SpectatorSettings

        del ini
        names = check_names(self.allow_host or ())
        settings = SpectatorSettings(listen.host, access=listen.rules, names=names)

        def make(world: "ServedWorld", sockets: Sockets) -> "Service":
            bound = sockets["--spectator-port"]
            return SpectatorServer(world, replace(settings, port=port_of(bound)), bound, keep_log())

        return make


def port_of(bound: socket.socket) -> int:
    """Return the port that a socket is bound to."""
    return bound.getsockname()[1]
