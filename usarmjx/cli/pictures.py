"""`usarmjx radio-map`: how strong a signal is all over an arena."""

from pathlib import Path
from typing import Annotated

import typer

from usarmjx.cli.common import (
    ArenaArgument,
    ErrorExit,
    OldOutArgument,
    OutOption,
    PackagesOption,
    PiecesOption,
    RadioIniOption,
    announce,
    chosen_out,
)
from usarmjx.cli.known_names import check_name, complete_robots


def portraits(
    robots: Annotated[
        list[str] | None,
        typer.Argument(help="Robot classes or files; all without any.", autocompletion=complete_robots),
    ] = None,
    robot: Annotated[
        list[str] | None,
        typer.Option(
            help="Robot class or file, as the arguments; may be repeated.", autocompletion=complete_robots
        ),
    ] = None,
    out: OutOption = None,
    packages: PackagesOption = None,
    pieces: PiecesOption = None,
) -> None:
    """Draw robots with the sensors' raycaster."""
    with ErrorExit():
        named = [*(robots or ())]
        # Once the file came first.
        old = Path(named.pop(0)) if out is None and named and named[0].lower().endswith(".png") else None
        where = chosen_out(out, old)
        named += robot or ()
        # Before JAX is imported: a misspelt name is refused at once.
        for name in named:
            check_name("robot", name)
        announce("drawing robots ...")
        from usarmjx.models.robots import ROBOTS
        from usarmjx.plots.gallery import portraits as draw_all

        draw_all(named or ROBOTS.names(), where)
        typer.echo(f"wrote {where}")


def radio_map(
    arena: ArenaArgument,
    source: Annotated[
        str, typer.Option("--from", help="The sender's antenna: x,y or x,y,z [m], z above the floor.")
    ],
    height: Annotated[
        float | None,
        typer.Option(help="Height of the receivers above the floor [m]; the sender's, if not given."),
    ] = None,
    radio_ini: RadioIniOption = None,
    out: OutOption = None,
    old_out: OldOutArgument = None,
    packages: PackagesOption = None,
) -> None:
    """Draw the power of a radio's signal all over an arena."""
    with ErrorExit():
        where = chosen_out(out, old_out)
        announce(f"drawing the radio in arena {arena} ...")
        from usarmjx.comms.attenuation import RadioSettings, radio_settings
        from usarmjx.models.files.load import find_arena
        from usarmjx.plots.radio_map import parse_position, radio_picture

        settings = RadioSettings() if radio_ini is None else radio_settings(radio_ini)
        radio_picture(find_arena(arena), where, parse_position(source), settings, height=height)
        typer.echo(f"wrote {where}")
