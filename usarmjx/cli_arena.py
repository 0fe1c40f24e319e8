"""`usarmjx arena`: look at arenas, check them, and make new ones."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from usarmjx.cli_tools import Failure

if TYPE_CHECKING:
    from usarmjx.models.arena_spec import ArenaSpec

app = typer.Typer(help="List, draw, check and generate arenas.", no_args_is_help=True)

PngOption = Annotated[Path | None, typer.Option(help="Write the floor plan to this PNG file.")]
ViewOption = Annotated[
    Path | None, typer.Option("--perspective", help="Write a picture from a corner above to this PNG file.")
]


@app.command("list")
def list_arenas() -> None:
    """List the arenas that ship with usarmjx, with what is in them."""
    with Failure():
        from usarmjx.arena_tables import arenas_table

        typer.echo(arenas_table())


@app.command()
def draw(
    arena: Annotated[str, typer.Argument(help="Arena name, or a file.")],
    png: PngOption = None,
    perspective: ViewOption = None,
) -> None:
    """Draw an arena's floor plan, or the arena from a corner above, or both."""
    with Failure():
        from usarmjx.errors import UsageError
        from usarmjx.models.arena_files import find_arena

        if png is None and perspective is None:
            raise UsageError("say what to draw: --png for the floor plan, --perspective for a view")
        _draw(find_arena(arena), png, perspective)


@app.command()
def check(
    arena: Annotated[str, typer.Argument(help="Arena name, or a file.")],
    robot: Annotated[str, typer.Option(help="Robot class that shall start and drive there.")] = "P2AT",
    png: PngOption = None,
    perspective: ViewOption = None,
) -> None:
    """Say what is wrong with an arena; exit code 1 if anything is."""
    with Failure():
        from usarmjx.models.arena_check import check_arena
        from usarmjx.models.arena_files import find_arena

        found = find_arena(arena)
        faults = check_arena(found, robot)
        _draw(found, png, perspective)
        for fault in faults:
            typer.echo(fault)
        if faults:
            raise typer.Exit(1)
        typer.echo(f"{found.name}: no faults found for a {robot}")


@app.command()
def gallery(
    out: Annotated[Path, typer.Argument(help="Folder for the pictures.")],
    count: Annotated[int, typer.Option(min=1, help="Generated arenas of each kind.")] = 1,
) -> None:
    """Draw the pictures of docs/arenas.md: all arenas, and generated ones of each kind."""
    with Failure():
        from usarmjx.gallery import plan_sheet, view_sheet
        from usarmjx.models.arenas import ARENAS

        arenas = [arena for _, arena in ARENAS]
        for write, name in ((plan_sheet, "arenas-plan.png"), (view_sheet, "arenas-view.png")):
            write(arenas, out / name)
            typer.echo(f"wrote {out / name}")


def _draw(arena: "ArenaSpec", png: Path | None, perspective: Path | None) -> None:
    from usarmjx.floor_plan import plan
    from usarmjx.gallery import perspective as view

    for write, path in ((plan, png), (view, perspective)):
        if path is not None:
            write(arena, path)
            typer.echo(f"wrote {path}")
