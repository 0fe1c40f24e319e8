"""The command line. Imports happen inside the commands, so that `--help` answers at once."""

import typer

from usarmjx.cli import (
    arena,
    bench,
    chaos,
    console,
    demo,
    listing,
    play,
    portraits,
    radio_map,
    recordings,
    sensor_plots,
    serve,
    train,
)

app = typer.Typer(
    help="USARSim rebuilt as a GPU-batched simulator of multi-robot swarms.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.add_typer(bench.app, name="bench")
app.add_typer(arena.app, name="arena")
app.add_typer(train.app)
app.add_typer(play.app)
app.command("list")(listing.list_everything)
app.command()(portraits.portraits)
app.command()(serve.serve)
app.command()(chaos.chaos)
app.command()(console.console)
app.command("radio-map")(radio_map.radio_map)
app.command()(recordings.view)
app.command()(recordings.plot)
app.command()(recordings.replay)
app.command()(demo.demo)
app.command("sensor-plots")(sensor_plots.sensor_plots)
