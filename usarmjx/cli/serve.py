"""`usarmjx serve`: worlds of a batch over the Gamebots protocol."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from usarmjx.cli.common import (
    ArenaOption,
    EngineOption,
    ErrorExit,
    IniOption,
    PackagesOption,
    PiecesOption,
    RobotFilesOption,
    SeedOption,
    UnitOption,
    WorldsOption,
    add_robots,
    announce,
    configure_from,
)
from usarmjx.cli.known_names import check_roster
from usarmjx.cli.serving_options import (
    Host,
    ImageOptions,
    ListenOptions,
    RadioOptions,
    Ros2Options,
    RosOptions,
    RunOptions,
    ViewerOptions,
    instances_of,
)
from usarmjx.cli.setting_options import with_config, with_settings
from usarmjx.cli.viewer_options import ViewOption
from usarmjx.server.runtime.logs import configure_log
from usarmjx.server.runtime.signals import StopSignals

if TYPE_CHECKING:
    from usarmjx.server.worlds.served_world import ServedWorld


RosterOption = Annotated[
    str,
    typer.Option(
        help="Robots that wait for clients, as P2AT:4,P2DX:2 or cart.urdf:2; engine c takes others too."
    ),
]


@dataclass(frozen=True, kw_only=True)
class WorldsOptions:
    """Worlds, and those of them that are served; each field is an option."""

    panel: ClassVar[str] = "Worlds"

    arena: ArenaOption = "yellow"
    worlds: WorldsOption = 1
    instance: Annotated[
        int | None, typer.Option(min=0, help="Which of them to serve, if only one; else the first.")
    ] = None
    instances: Annotated[
        str | None, typer.Option(help="Which of them to serve, if several: all, or numbers as 0,2-5.")
    ] = None
    roster: RosterOption = "P2AT:4,P2DX:4"
    seats: Annotated[
        int | None, typer.Option(min=1, help="Most robots in one world; else as many as connections.")
    ] = None
    engine: EngineOption = "auto"
    seed: SeedOption = 0
    robot: RobotFilesOption = None
    packages: PackagesOption = None
    pieces: PiecesOption = None
    ini: IniOption = None
    uu_per_metre: UnitOption = 250.0

    @property
    def numbers(self) -> tuple[int, ...]:
        """The numbers of the worlds that are served.

        Raises:
            UsageError: There is no such world.
        """
        return instances_of(self.instances, self.instance, self.worlds)

    @property
    def ini_files(self) -> Sequence[Path]:
        """The ini files."""
        return self.ini or ()

    def make(self, most_robots: int) -> "list[ServedWorld]":
        """Build the worlds that are served, with room for the given number of robots each."""
        add_robots(self.robot)
        configure_from(self.ini, self.uu_per_metre)
        from usarmjx.server.worlds.make import make_worlds

        return make_worlds(
            self.arena,
            engine=self.engine,
            worlds=self.worlds,
            instances=self.numbers,
            roster=self.roster,
            max_robots=most_robots,
            seed=self.seed,
        )


@with_config
@with_settings
def serve(
    which: WorldsOptions,
    listen: ListenOptions,
    run: RunOptions,
    radio: RadioOptions,
    images: ImageOptions,
    ros: RosOptions,
    ros2: Ros2Options,
    viewer: ViewerOptions,
    view: ViewOption = True,
    log_json: Annotated[bool, typer.Option("--log-json", help="Log a JSON object per line.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log connections and spawns.")] = False,
) -> None:
    """Serve worlds of a batch over the Gamebots protocol, with their radio and cameras.

    Several worlds have ports of their own: the first those of the options, the others count up from there.
    So robots have 3000, 3001, ..., pictures 5003, 5004, ...; no two kinds share a port.
    """
    configure_log(verbose=verbose, as_json=log_json)
    # Signals are caught from here on: to build the worlds may take minutes, and Ctrl-C must end that.
    with ErrorExit(), StopSignals() as signals:
        # Before JAX is imported and the arena is built.
        check_roster(which.roster, (*(which.robot or ()), *which.ini_files))
        host = Host(
            listen=listen,
            settings=listen.settings(which.ini_files, which.seats),
            numbers=which.numbers,
            run=run,
            viewer=viewer,
            view=view,
            services=(radio, images, ros, ros2),
        )
        # Ports first: one that is taken is refused at once, not after the arena is built.
        with host.ports() as ports:
            # A reader of JSON lines expects no others.
            if not log_json:
                host.warn(ports)
            many = f" for {which.worlds} worlds" if which.worlds > 1 else ""
            announce(f"building arena {which.arena}{many} ...")
            # All options are read before the worlds are built, so that a wrong one is refused first.
            services = host.prepare(which.ini_files)
            worlds = which.make(which.seats or host.settings.max_connections)
            heard = radio.constants if radio.wanted else None
            host.serve(worlds, ports, services, signals, batch_size=which.worlds, radio=heard)
