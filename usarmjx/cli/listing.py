"""`usarmjx list`: what robots, arenas, sensors and engines there are."""

from typing import Annotated

import typer

from usarmjx.cli.tools import ErrorExit, IniOption, UnitOption, configure_from
from usarmjx.cli.waiting import announce


def list_everything(
    what: Annotated[
        str, typer.Argument(help="everything; robots or sensors: the full tables.")
    ] = "everything",
    ini: IniOption = None,
    uu_per_metre: UnitOption = 250.0,
) -> None:
    """List robots, arenas, sensors and engines."""
    with ErrorExit():
        announce("reading what there is ...")
        configure_from(ini, uu_per_metre)
        from usarmjx.base.errors import UsageError
        from usarmjx.cli.catalogue import catalogue, robots_table
        from usarmjx.cli.sensor_tables import sensors_table

        listings = {"everything": catalogue, "robots": robots_table, "sensors": sensors_table}
        if what not in listings:
            raise UsageError(f"cannot list {what!r}; there is: {', '.join(listings)}")
        typer.echo(listings[what]())
