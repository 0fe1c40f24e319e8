"""`usarmjx serve`: one world of a batch over the Gamebots protocol."""

import logging
from pathlib import Path
from typing import Annotated

import typer

from usarmjx.cli.tools import (
    ArenaOption,
    EngineOption,
    ErrorExit,
    IniOption,
    SeedOption,
    UnitOption,
    configure_from,
)


def serve(
    arena: ArenaOption = "yellow",
    worlds: Annotated[int, typer.Option(min=1, help="Worlds in the batch.")] = 1,
    instance: Annotated[int, typer.Option(min=0, help="Which of them to serve.")] = 0,
    roster: Annotated[
        str, typer.Option(help="Robots that wait for clients, as P2AT:4,P2DX:2; engine c needs none.")
    ] = "P2AT:4,P2DX:4",
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="TCP port (0: a free one); else ListenPort of --ini, or 3000."),
    ] = None,
    max_connections: Annotated[
        int | None, typer.Option(min=1, help="Most clients at once; else MaxConnections of --ini, or 16.")
    ] = None,
    engine: EngineOption = "auto",
    realtime_factor: Annotated[
        float, typer.Option(min=0.0, help="Simulated seconds per second; 0: as fast as it can.")
    ] = 1.0,
    seed: SeedOption = 0,
    ini: IniOption = None,
    uu_per_metre: UnitOption = 250.0,
    wireless: Annotated[bool, typer.Option(help="Serve the radio too.")] = True,
    wss_port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Wireless server (REGISTER, OPEN); else ListenPort, or 5874."),
    ] = None,
    wss2_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Stand-alone wireless server (INIT, DNS).")
    ] = 50000,
    position_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Positions for a wireless server elsewhere (GETPOS).")
    ] = 7435,
    radio_ini: Annotated[
        Path | None, typer.Option(help="USARComServer.ini with the radio's constants.")
    ] = None,
    wireless_allow: Annotated[
        list[str] | None,
        typer.Option(help="IP address that may be dialled for others than itself; may be repeated."),
    ] = None,
    images: Annotated[bool, typer.Option(help="Serve the robots' cameras too.")] = True,
    image_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Image server (pictures, and OK for the next).")
    ] = 5003,
    image_size: Annotated[
        str | None,
        typer.Option(help="Width and height of pictures; else 320x240, or what a MultiView needs."),
    ] = None,
    image_fps: Annotated[
        float, typer.Option(min=0.1, max=100.0, help="Most pictures per second for each client.")
    ] = 10.0,
    image_format: Annotated[
        str, typer.Option(help="raw (0), or JPEG: super, good, normal, average, bad (1 to 5).")
    ] = "normal",
    multi_view: Annotated[
        bool,
        typer.Option(
            "--multi-view", help="All robots' first cameras in one picture, by [USARBot.MultiView] of --ini."
        ),
    ] = False,
    spectator_port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Show the world on a page of this port; else no page."),
    ] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log connections and spawns.")] = False,
) -> None:
    """Serve one world of a batch over the Gamebots protocol, its radio and its cameras."""
    logging.basicConfig(format="%(levelname)s %(name)s: %(message)s", level=logging.WARNING)
    logging.getLogger("usarmjx").setLevel(logging.INFO if verbose else logging.WARNING)
    with ErrorExit():
        from usarmjx.comms.attenuation import RadioSettings, radio_settings
        from usarmjx.server.bot_server import read_bot_server
        from usarmjx.server.net import BotServerSettings, Service
        from usarmjx.server.net import serve as run
        from usarmjx.server.pictures.image_server import SIZE, ImageServer, ImageSettings
        from usarmjx.server.pictures.spectator_server import SpectatorServer, SpectatorSettings
        from usarmjx.server.protocol.images import format_number, parse_size
        from usarmjx.server.protocol.multi_view import read_multi_view
        from usarmjx.server.wireless.net import WirelessSettings, check_addresses, make_wireless
        from usarmjx.server.worlds.make import make_worlds

        radio = radio_settings(radio_ini) if radio_ini else RadioSettings()
        air = WirelessSettings(
            host=host,
            wss_port=radio.listen_port if wss_port is None else wss_port,
            wss2_port=wss2_port,
            position_port=position_port,
            allow=check_addresses(wireless_allow or ()),
        )
        shared = read_multi_view(ini or ()) if multi_view else None
        size = parse_size(image_size) if image_size else shared.size if shared else SIZE
        number = format_number(image_format)
        pictures = ImageSettings(host, image_port, size, image_fps, number, multi_view=shared)
        given = {"port": port, "max_connections": max_connections}
        fields = read_bot_server(ini or ()) | {name: n for name, n in given.items() if n is not None}
        settings = BotServerSettings(host=host, realtime_factor=realtime_factor, **fields)
        configure_from(ini, uu_per_metre)
        (world,) = make_worlds(
            arena,
            engine=engine,
            worlds=worlds,
            instances=(instance,),
            roster=roster,
            max_robots=settings.max_connections,
            seed=seed,
        )
        services: list[Service] = [make_wireless(world, radio, air)] if wireless else []
        services += [ImageServer(world, pictures)] if images else []
        if spectator_port is not None:
            services.append(SpectatorServer(world, SpectatorSettings(host, spectator_port)))
        run(world, settings, services)
