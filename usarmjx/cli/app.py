"""The command line. Imports happen inside the commands, so that `--help` answers at once."""

import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import usarmjx
from usarmjx.cli import (
    arena,
    bench,
    calibrate,
    chaos,
    console,
    demo,
    doctor,
    evaluation,
    listing,
    play,
    portraits,
    radio_map,
    recordings,
    sensor_plots,
    serve,
    sweep,
    teams,
    train,
)
from usarmjx.cli.spelling import respelt
from usarmjx.cli.waiting import say

HELP = {"help_option_names": ["-h", "--help"]}


class RootCommand(TyperGroup):
    """All of the command line; old spellings of options become the present ones here."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401 - click's, or typer's own copy
        """Parse what was typed."""
        return super().parse_args(ctx, respelt(args, say))


app = typer.Typer(
    cls=RootCommand,
    help="USARSim rebuilt as a GPU-batched simulator of multi-robot swarms.",
    no_args_is_help=True,
    context_settings=HELP,
    pretty_exceptions_enable=False,
)


def _tell_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"usarmjx {usarmjx.__version__} (Python {'.'.join(map(str, sys.version_info[:3]))})")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool,
        typer.Option("--version", "-V", callback=_tell_version, is_eager=True, help="Tell the version."),
    ] = False,
) -> None:
    """USARSim rebuilt as a GPU-batched simulator of multi-robot swarms."""
    del version


app.add_typer(bench.app, name="bench")
app.add_typer(arena.app, name="arena")
app.add_typer(sweep.app, name="sweep")
app.add_typer(train.app)
app.command("eval")(evaluation.evaluate_policy)
app.command()(play.play)
app.command()(teams.teams)
app.command("list")(listing.list_everything)
app.command()(portraits.portraits)
app.command()(serve.serve)
app.command()(calibrate.calibrate)
app.command()(chaos.chaos)
app.command()(console.console)
app.command("radio-map")(radio_map.radio_map)
app.command()(recordings.view)
app.command()(recordings.plot)
app.command()(recordings.replay)
app.command()(demo.demo)
app.command()(doctor.doctor)
app.command("sensor-plots")(sensor_plots.sensor_plots)
