"""The command line. Imports happen inside the commands, so that `--help` answers at once."""

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import usarmjx
from usarmjx.cli import (
    arena,
    calibrate,
    checkout,
    demo,
    doctor,
    evaluation,
    listing,
    pictures,
    play,
    recordings,
    serve,
    sweep,
    train,
)
from usarmjx.cli.console import command as console
from usarmjx.cli.startup_messages import say

RENAMED: Mapping[str, Mapping[str, str]] = {
    "serve": {"--viewer": "--view", "--no-viewer": "--no-view"},
    "radio-map": {"--ini": "--radio-ini"},
    "chaos": {"--page-port": "--spectator-port"},
    "train": {"--worlds": "--num-worlds", "--steps": "--total-steps"},
}
"""By commands: old options and what they are called now."""
COUNTED: Mapping[str, tuple[str, str]] = {
    "bench rays": ("P2AT", "16"),
    "bench camera": ("P2AT", "1"),
    "bench viewer": ("P2AT", ""),
    "bench radio": ("P2AT", "16"),
    "bench serve": ("P2AT", ""),
}
"""Commands with a roster that once had `--robots` and `--robot`, and what these were if not given."""
ROBOTS = ("--robots", "--robot")
OTHER_ROBOT = {"bench serve"}
"""Commands of these in which `--robot` is something else, and stays."""


def respelt(words: Sequence[str], tell: Callable[[str], None]) -> list[str]:
    """Return a command line with all options as they are spelt now.

    Args:
        words: What was typed after `usarmjx`.
        tell: Takes a line for each old spelling.
    """
    path = " ".join(words[:2]) if " ".join(words[:2]) in COUNTED else "".join(words[:1])
    names, done = RENAMED.get(path, {}), list[str]()
    for word in words:
        option, equals, value = word.partition("=")
        new = names.get(option)
        if new is not None:
            tell(f"{option} is called {new} now")
        done.append(word if new is None else f"{new}{equals}{value}")
    if path not in COUNTED:
        return done
    return _with_roster(done, *COUNTED[path], tell, ("--robots",) if path in OTHER_ROBOT else ROBOTS)


def _with_roster(
    words: Sequence[str], kind: str, count: str, tell: Callable[[str], None], old: Sequence[str]
) -> list[str]:
    """Return a command line with `--roster CLASS:COUNT` for `--robots COUNT` and `--robot CLASS`."""
    rest, counts, kinds = list[str](), list[str](), list[str]()
    given = iter(words)
    for word in given:
        option, equals, value = word.partition("=")
        if option in old:
            (counts if option == "--robots" else kinds).append(value if equals else next(given, ""))
        else:
            rest.append(word)
    if not (counts or kinds):
        return rest
    rosters = [f"{(kinds or [kind])[-1]}:{number}".rstrip(":") for number in counts or [count]]
    told = f"{old[0]} is" if len(old) == 1 else f"{' and '.join(old)} are"
    tell(f"{told} --roster now: --roster {' --roster '.join(rosters)}")
    return [*rest, *(word for roster in rosters for word in ("--roster", roster))]


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


checkout.add_benchmarks(app)
app.add_typer(arena.app, name="arena")
app.add_typer(sweep.app, name="sweep")
app.add_typer(train.app)
app.command("eval")(evaluation.evaluate_policy)
app.command()(play.play)
app.command()(evaluation.teams)
app.command("list")(listing.list_everything)
app.command()(pictures.portraits)
app.command()(serve.serve)
app.command()(calibrate.calibrate)
app.command()(console.console)
app.command("radio-map")(pictures.radio_map)
app.command()(recordings.view)
app.command()(recordings.plot)
app.command()(recordings.replay)
app.command()(demo.demo)
app.command()(doctor.doctor)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line `usarmjx` in this program, with the names that it has registered, and exit.

    Args:
        arguments: Words after `usarmjx`; None: those of this program.
    """
    app(args=arguments, prog_name="usarmjx")
