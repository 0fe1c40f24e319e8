"""The command line. Imports happen inside the commands, so that `--help` answers at once."""

import logging
import sys
from pathlib import Path
from typing import Annotated

import typer

from usarmjx import cli_arena, cli_play, cli_sensors, cli_train
from usarmjx.cli_tools import Failure, SeedOption

app = typer.Typer(
    help="USARSim rebuilt as a GPU-batched simulator of multi-robot swarms.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
bench_app = typer.Typer(help="Measure how fast things go on this machine.", no_args_is_help=True)
app.add_typer(bench_app, name="bench")
app.add_typer(cli_arena.app, name="arena")
app.add_typer(cli_train.app)
app.add_typer(cli_play.app)
app.command("sensor-plots")(cli_sensors.sensor_plots)

EngineOption = Annotated[str, typer.Option(help="warp, jax, c, or auto: the best for the purpose here.")]
ArenaOption = Annotated[str, typer.Option(help="Arena name, as `usarmjx list` shows them, or a file.")]
IniOption = Annotated[
    list[Path] | None,
    typer.Option("--ini", help="USARBot.ini or USARMisPkg.ini with robots; may be given several times."),
]
UnitOption = Annotated[float, typer.Option(help="Unreal units in a metre, for ini files with bMountByUU.")]


def _configure(files: list[Path] | None, uu_per_metre: float) -> None:
    """Put the robots of ini files in force; what they say in vain goes to the standard error stream."""
    if not files:
        return
    from usarmjx.configure import configure

    for warning in configure(files, uu_per_metre).warnings:
        typer.echo(f"usarmjx: warning: {warning}", err=True)


@app.command("list")
def list_everything(
    what: Annotated[
        str, typer.Argument(help="everything; robots or sensors: the full tables.")
    ] = "everything",
    ini: IniOption = None,
    uu_per_metre: UnitOption = 250.0,
) -> None:
    """List robots, arenas, sensors and engines."""
    with Failure():
        _configure(ini, uu_per_metre)
        from usarmjx.catalogue import catalogue, robots_table
        from usarmjx.errors import UsageError
        from usarmjx.sensor_tables import sensors_table

        listings = {"everything": catalogue, "robots": robots_table, "sensors": sensors_table}
        if what not in listings:
            raise UsageError(f"cannot list {what!r}; there is: {', '.join(listings)}")
        typer.echo(listings[what]())


@app.command()
def portraits(
    out: Annotated[Path, typer.Argument(help="PNG file to write.")],
    robots: Annotated[list[str] | None, typer.Argument(help="Robot classes; all without any.")] = None,
) -> None:
    """Draw robots with the sensors' raycaster."""
    with Failure():
        from usarmjx.models.robots import ROBOTS
        from usarmjx.portrait import portraits as draw_all

        draw_all(robots or ROBOTS.names(), out)
        typer.echo(f"wrote {out}")


@app.command()
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
    with Failure():
        from usarmjx.comms.attenuation import RadioSettings, radio_settings
        from usarmjx.server.bot_server import read_bot_server
        from usarmjx.server.image_net import SIZE, ImageServer, ImageSettings
        from usarmjx.server.images import format_number, parse_size
        from usarmjx.server.multi_view import read_multi_view
        from usarmjx.server.net import Service, Settings
        from usarmjx.server.net import serve as run
        from usarmjx.server.spectator_net import SpectatorServer, SpectatorSettings
        from usarmjx.server.wireless_net import WirelessSettings, check_addresses, make_wireless
        from usarmjx.server.worlds import make_world

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
        told = read_bot_server(ini or ()) | {name: n for name, n in given.items() if n is not None}
        settings = Settings(host=host, realtime_factor=realtime_factor, **told)
        _configure(ini, uu_per_metre)
        world = make_world(
            arena,
            engine=engine,
            worlds=worlds,
            instance=instance,
            roster=roster,
            seats=settings.max_connections,
            seed=seed,
        )
        services: list[Service] = [make_wireless(world, radio, air)] if wireless else []
        services += [ImageServer(world, pictures)] if images else []
        if spectator_port is not None:
            services.append(SpectatorServer(world, SpectatorSettings(host, spectator_port)))
        run(world, settings, services)


@app.command("radio-map")
def radio_map(
    arena: Annotated[str, typer.Argument(help="Arena name, or a file.")],
    out: Annotated[Path, typer.Argument(help="PNG file to write.")],
    source: Annotated[
        str, typer.Option("--from", help="The sender's antenna: x,y or x,y,z [m], z above the floor.")
    ],
    height: Annotated[
        float | None,
        typer.Option(help="Height of the receivers above the floor [m]; the sender's, if not given."),
    ] = None,
    ini: Annotated[Path | None, typer.Option(help="USARComServer.ini with the radio's constants.")] = None,
) -> None:
    """Draw a map of the power that a radio's signal has all over an arena."""
    with Failure():
        from usarmjx.comms.attenuation import RadioSettings, radio_settings
        from usarmjx.models.arena_files import find_arena
        from usarmjx.radio_map import radio_picture, read_place

        settings = RadioSettings() if ini is None else radio_settings(ini)
        radio_picture(find_arena(arena), out, read_place(source), settings, height=height)
        typer.echo(f"wrote {out}")


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the picture and the log.")] = Path("out"),
    seconds: Annotated[float, typer.Option(min=1.0, help="Simulated seconds to wander.")] = 20.0,
) -> None:
    """Run the main job: serve a batch, let the example client drive a P2AT, draw what it did."""
    with Failure():
        from usarmjx.demo import run_demo

        sys.exit(run_demo(out, seconds))


@bench_app.command("radio")
def bench_radio(
    worlds: Annotated[int, typer.Option(min=1, help="Worlds at once.")] = 64,
    robots: Annotated[int, typer.Option(min=2, help="Robots in each; all pairs are evaluated.")] = 16,
    walls: Annotated[int, typer.Option(min=1, help="Walls in each.")] = 100,
    steps: Annotated[int, typer.Option(min=1, help="Evaluations per repeat.")] = 20,
    repeats: Annotated[int, typer.Option(min=1, help="Repeats; the median counts.")] = 5,
    seed: SeedOption = 0,
    json: Annotated[Path | None, typer.Option(help="Append the record to this file.")] = None,
) -> None:
    """Measure the links of all pairs of robots, walls counted."""
    with Failure():
        from usarmjx.bench_radio import RadioCase, measure_radio

        case = RadioCase(worlds=worlds, robots=robots, walls=walls, steps=steps, repeats=repeats, seed=seed)
        typer.echo(measure_radio(case, json))


@bench_app.command("rays")
def bench_rays(
    worlds: Annotated[int, typer.Option(min=1, help="Worlds at once.")] = 4,
    robots: Annotated[int, typer.Option(min=1, help="Robots in each; all of them scan.")] = 16,
    robot: Annotated[str, typer.Option(help="Their class, which needs a range scanner.")] = "P2AT",
    walls: Annotated[int, typer.Option(min=1, help="Walls in each.")] = 100,
    steps: Annotated[int, typer.Option(min=1, help="Scans per repeat.")] = 10,
    repeats: Annotated[int, typer.Option(min=1, help="Repeats; the median counts.")] = 5,
    seed: SeedOption = 0,
    json: Annotated[Path | None, typer.Option(help="Append the record to this file.")] = None,
) -> None:
    """Measure laser scans of all robots, and the same by brute force."""
    with Failure():
        from usarmjx.bench_rays import RayCase, measure_rays

        size = {"worlds": worlds, "robots": robots, "walls": walls, "steps": steps, "repeats": repeats}
        typer.echo(measure_rays(RayCase(robot=robot, seed=seed, **size), json))


@bench_app.command("camera")
def bench_camera(
    worlds: Annotated[int, typer.Option(min=1, help="Worlds in the batch.")] = 16,
    robots: Annotated[int, typer.Option(min=1, help="Robots in each; all of them look.")] = 1,
    robot: Annotated[str, typer.Option(help="Their class.")] = "P2AT",
    arena: Annotated[str, typer.Option(help="Arena name, or a file.")] = "yellow",
    size: Annotated[str, typer.Option(help="Width and height of a picture, as 64x64.")] = "64x64",
    engine: EngineOption = "auto",
    steps: Annotated[int, typer.Option(min=1, help="Rounds of pictures per repeat.")] = 5,
    repeats: Annotated[int, typer.Option(min=1, help="Repeats; the median counts.")] = 5,
    seed: SeedOption = 0,
    peer: Annotated[bool, typer.Option("--peer", help="Measure MuJoCo Warp's renderer too.")] = False,
    json: Annotated[Path | None, typer.Option(help="Append the record to this file.")] = None,
) -> None:
    """Measure pictures of all robots' main cameras: colours, depth and segmentation."""
    with Failure():
        from usarmjx.bench_camera import CameraCase, measure_camera
        from usarmjx.server.images import parse_size

        width, height = parse_size(size)
        case = CameraCase(
            worlds=worlds,
            robots=robots,
            robot=robot,
            arena=arena,
            width=width,
            height=height,
            engine=engine,
            steps=steps,
            repeats=repeats,
            seed=seed,
            peer=peer,
        )
        typer.echo(measure_camera(case, json))


@bench_app.command("train")
def bench_train(
    runs: Annotated[list[Path], typer.Argument(help="Folders of runs that were trained here just now.")],
    baseline: Annotated[float | None, typer.Option(help="Score of the policy by hand.")] = None,
    json: Annotated[Path | None, typer.Option(help="Append the records to this file.")] = None,
) -> None:
    """Record runs of `usarmjx train`: their speed and curves, and when they were as good as by hand."""
    with Failure():
        from usarmjx.bench_train import record_run

        for run in runs:
            typer.echo(record_run(run, baseline, json))


@bench_app.command("step")
def bench_step(
    worlds: Annotated[int, typer.Option(min=1, help="Worlds in the batch.")] = 4,
    roster: Annotated[str, typer.Option(help="Robots of each world, as P2AT:4,Zerg:2.")] = "P2AT:4",
    arena: Annotated[str, typer.Option(help="Arena name, or with --generated the kind.")] = "yellow",
    generated: Annotated[
        int, typer.Option(min=0, help="So many generated arenas, which the worlds have in turn.")
    ] = 0,
    engine: EngineOption = "auto",
    radio: Annotated[bool, typer.Option("--radio", help="Evaluate all radio links too.")] = False,
    substeps: Annotated[int, typer.Option(min=1, help="Physics steps per control step.")] = 10,
    steps: Annotated[int, typer.Option(min=1, help="Control steps per repeat.")] = 20,
    repeats: Annotated[int, typer.Option(min=1, help="Repeats; the median counts.")] = 5,
    seed: SeedOption = 0,
    ini: IniOption = None,
    uu_per_metre: UnitOption = 250.0,
    json: Annotated[Path | None, typer.Option(help="Append the record to this file.")] = None,
) -> None:
    """Measure bare physics and the whole step (control, physics, sensors, resets) in one run."""
    with Failure():
        _configure(ini, uu_per_metre)
        from usarmjx.bench import Case, measure

        case = Case(
            worlds=worlds,
            roster=roster,
            arena=arena,
            generated=generated,
            engine=engine,
            radio=radio,
            substeps=substeps,
            steps=steps,
            repeats=repeats,
            seed=seed,
        )
        typer.echo(measure(case, json))
