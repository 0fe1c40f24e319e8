"""`usarmjx radio-map`: how strong a signal is all over an arena."""

from pathlib import Path
from typing import Annotated

import typer

from usarmjx.cli.tools import ErrorExit
from usarmjx.cli.waiting import announce


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
    with ErrorExit():
        announce(f"drawing the radio in arena {arena} ...")
        from usarmjx.comms.attenuation import RadioSettings, radio_settings
        from usarmjx.models.files.load import find_arena
        from usarmjx.plots.radio_map import parse_position, radio_picture

        settings = RadioSettings() if ini is None else radio_settings(ini)
        radio_picture(find_arena(arena), out, parse_position(source), settings, height=height)
        typer.echo(f"wrote {out}")
