"""`usarmjx serve`: worlds of a batch over the Gamebots protocol."""

from pathlib import Path
from typing import Annotated

import typer

from usarmjx.cli.access_options import (
    AllowHostOption,
    AllowOption,
    PerAddressOption,
    TokenFileOption,
    TokenOption,
    access_rules,
    warn_if_open,
)
from usarmjx.cli.recordings import RecordOption, recorded
from usarmjx.cli.serve_run import (
    ImageChoice,
    MetricsOption,
    PageChoice,
    RadioChoice,
    ServiceChoice,
    add_metrics,
    bot_settings,
    instances_of,
    make_servers,
    metrics_socket,
)
from usarmjx.cli.tools import (
    ArenaOption,
    EngineOption,
    ErrorExit,
    IniOption,
    PortOffsetOption,
    SeedOption,
    UnitOption,
    configure_from,
)
from usarmjx.cli.viewer_options import (
    ViewerControlOption,
    ViewerOption,
    ViewerPortOption,
    add_controls,
    add_viewer,
    viewer_settings,
    viewer_socket,
)
from usarmjx.cli.waiting import announce
from usarmjx.server.json_log import configure_log
from usarmjx.server.ports import IMAGE_PORT, POSITION_PORT, WSS2_PORT, bound_ports, count_up
from usarmjx.server.signals import StopSignals


def serve(
    arena: ArenaOption = "yellow",
    worlds: Annotated[int, typer.Option(min=1, help="Worlds in the batch.")] = 1,
    instance: Annotated[
        int | None, typer.Option(min=0, help="Which of them to serve, if only one; else the first.")
    ] = None,
    instances: Annotated[
        str | None, typer.Option(help="Which of them to serve, if several: all, or numbers as 0,2-5.")
    ] = None,
    roster: Annotated[
        str, typer.Option(help="Robots that wait for clients, as P2AT:4,P2DX:2; engine c takes others too.")
    ] = "P2AT:4,P2DX:4",
    seats: Annotated[
        int | None, typer.Option(min=1, help="Most robots in one world; else as many as connections.")
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="TCP port (0: a free one); else ListenPort of --ini, or 3000."),
    ] = None,
    port_offset: PortOffsetOption = 0,
    max_connections: Annotated[
        int | None,
        typer.Option(
            min=1, help="Most clients of one world; else MaxConnections of --ini, or 16; or --seats."
        ),
    ] = None,
    init_timeout: Annotated[
        float,
        typer.Option(
            min=0.0,
            help="Seconds after which a client without a robot goes if it asks for nothing, or if others "
            "need its seat; 0: never.",
        ),
    ] = 60.0,
    allow: AllowOption = None,
    token: TokenOption = None,
    token_file: TokenFileOption = None,
    connections_per_address: PerAddressOption = None,
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
    ] = WSS2_PORT,
    position_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Positions for a wireless server elsewhere (GETPOS).")
    ] = POSITION_PORT,
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
    ] = IMAGE_PORT,
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
    viewer: ViewerOption = True,
    viewer_port: ViewerPortOption = None,
    viewer_control: ViewerControlOption = False,
    allow_host: AllowHostOption = None,
    metrics_port: MetricsOption = None,
    record: RecordOption = None,
    log_json: Annotated[bool, typer.Option("--log-json", help="Log a JSON object per line.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log connections and spawns.")] = False,
) -> None:
    """Serve worlds of a batch over the Gamebots protocol, their radio and their cameras.

    Several worlds have ports of their own: the first those of the options, the others count up from there.
    So robots have 3000, 3001, ..., pictures 5003, 5004, ...; what one kind has, another leaves out.
    """
    configure_log(verbose=verbose, as_json=log_json)
    with ErrorExit(), StopSignals() as signals:
        numbers = instances_of(instances, instance, worlds)
        rules = access_rules(allow, token, token_file, connections_per_address)
        settings = bot_settings(
            ini,
            seats,
            host=host,
            port=port,
            max_connections=max_connections,
            init_timeout=init_timeout,
            rules=rules,
        )
        choices: list[ServiceChoice] = []
        if wireless:
            ports = {"--wss-port": wss_port, "--wss2-port": wss2_port, "--position-port": position_port}
            choices.append(RadioChoice(ports, radio_ini, wireless_allow or ()))
        if images:
            shared = (ini or ()) if multi_view else None
            choices.append(ImageChoice(image_port, image_size, image_fps, image_format, shared))
        if spectator_port is not None:
            choices.append(PageChoice(spectator_port, allow_host or ()))
        first = {"--port": settings.port} | {key: n for choice in choices for key, n in choice.ports.items()}
        with (
            bound_ports(host, count_up(first, len(numbers), port_offset)) as bound,
            metrics_socket(host, metrics_port, port_offset) as metrics,
            viewer_socket(host, viewer_port, port_offset, viewer) as page,
        ):
            if not log_json:
                warn_if_open(bound[0]["--port"].getsockname()[0], rules)
            announce(f"building arena {arena}{f' for {worlds} worlds' if worlds > 1 else ''} ...")
            makers = [choice.prepare(host, rules) for choice in choices]
            looked_at = viewer_settings(host, rules, allow_host or (), viewer_control)
            configure_from(ini, uu_per_metre)
            from usarmjx.server.clock import StepClock
            from usarmjx.server.loop import serve as run
            from usarmjx.server.worlds.make import make_worlds

            served = make_worlds(
                arena,
                engine=engine,
                worlds=worlds,
                instances=numbers,
                roster=roster,
                max_robots=seats or settings.max_connections,
                seed=seed,
            )
            servers = make_servers(served, settings, makers, bound, numbers, worlds)
            if metrics is not None:
                add_metrics(servers, realtime_factor, metrics, numbers)
            clock = StepClock(realtime_factor)
            controls = add_controls(servers, clock)
            if page is not None:
                radios = [choice.radio for choice in choices if isinstance(choice, RadioChoice)]
                add_viewer(servers, controls, page, looked_at, next(iter(radios), None))
            with recorded(served, record):
                run(servers, clock, signals)
