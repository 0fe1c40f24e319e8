"""The command line. Each command is imported when it is used, so that `--help` answers at once."""

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar

import typer

import usarmjx
from usarmjx.cli.common import BAD_INPUT, say
from usarmjx.cli.lazy_commands import LazyGroup

RENAMED: Mapping[str, Mapping[str, str]] = {
    "serve": {"--viewer": "--view", "--no-viewer": "--no-view"},
    "radio-map": {"--ini": "--radio-ini"},
    "chaos": {"--page-port": "--viewer-port", "--spectator-port": "--viewer-port"},
    "train": {"--num-worlds": "--worlds", "--total-steps": "--steps"},
}
"""By commands: old options and what they are called now."""
REMOVED: Mapping[tuple[str, str], str] = {
    (command, "--spectator-port"): "the live page replaces that page: --viewer-port sets its port"
    for command in ("serve", "play")
}
"""By command and option: what to use in place of an option that is no more."""
NO_COMMANDS: Mapping[str, str] = {
    "record": "recordings are made by --record FILE.mcap of serve, play and train",
    "evaluate": "policies are evaluated by eval",
}
"""Guesses of commands, and the commands that do it."""
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
        words: Arguments after `usarmjx`.
        tell: Takes a line for each old spelling.
    """
    # The longest name first: `bench rays` has spellings that `bench` has not.
    path = " ".join(words[:2]) if " ".join(words[:2]) in COUNTED else "".join(words[:1])
    names, done = RENAMED.get(path, {}), list[str]()
    for word in words:
        option, equals, value = word.partition("=")
        new = names.get(option)
        if new is not None:
            tell(f"{option} is called {new} now")
        # `--old=value` is one word, `--old value` two: the value of the latter is a word of its own and
        # passes.
        done.append(word if new is None else f"{new}{equals}{value}")
    if path not in COUNTED:
        return done
    return _with_roster(done, *COUNTED[path], tell, ("--robots",) if path in OTHER_ROBOT else ROBOTS)


def removed_option(words: Sequence[str]) -> str:
    """Return a line about the first option that is no more; empty: all are there."""
    options = [word.partition("=")[0] for word in words[1:]]
    found = ((one, REMOVED.get((words[0], one))) for one in options)
    return next((f"there is no {one}: {instead}" for one, instead in found if instead), "")


def _with_roster(
    words: Sequence[str], kind: str, count: str, tell: Callable[[str], None], old: Sequence[str]
) -> list[str]:
    """Return a command line with `--roster CLASS:COUNT` for `--robots COUNT` and `--robot CLASS`."""
    rest, counts, kinds = list[str](), list[str](), list[str]()
    given = iter(words)
    for word in given:
        option, equals, value = word.partition("=")
        if option in old:
            # An option without its value takes the next word, as click does.
            (counts if option == "--robots" else kinds).append(value if equals else next(given, ""))
        else:
            rest.append(word)
    if not (counts or kinds):
        return rest
    # The last class counts, as the parser takes the last value of an option that is not repeatable. A colon
    # with no count behind it is no roster, and some commands have no count of their own.
    rosters = [f"{(kinds or [kind])[-1]}:{number}".rstrip(":") for number in counts or [count]]
    told = f"{old[0]} is" if len(old) == 1 else f"{' and '.join(old)} are"
    tell(f"{told} --roster now: --roster {' --roster '.join(rosters)}")
    return [*rest, *(word for roster in rosters for word in ("--roster", roster))]


COMMANDS = {
    "demo": (
        "usarmjx.cli.demo:demo",
        "Show four robots that explore an arena, in a browser; take one over if you like.",
    ),
    "list": (
        "usarmjx.cli.listing:list_everything",
        "List robots, sensors, arenas, tasks, policies and engines.",
    ),
    "doctor": (
        "usarmjx.cli.doctor:doctor",
        "Check versions, devices, caches, ports, engines and small worlds; exit code 1 if one is wrong.",
    ),
    "train": ("usarmjx.cli.train:app", "Train a policy for a task."),
    "curves": (
        "usarmjx.cli.train:app",
        "Draw scores of training runs over agent steps and over time, the last run of each seed.",
    ),
    "export": (
        "usarmjx.cli.train:app",
        "Write a policy for NumPy or ONNX Runtime; or a recording as tables, film or ROS 2 bag.",
    ),
    "eval": (
        "usarmjx.cli.evaluation:evaluate_policy",
        "Report a policy's mean final score with its 95 % interval.",
    ),
    "teams": (
        "usarmjx.cli.evaluation:teams",
        "Compare teams in the same buildings: parts of their scores, and times of their finds.",
    ),
    "league": (
        "usarmjx.cli.league:league",
        "Show the ratings of a training's past selves, and play against them.",
    ),
    "sweep": ("usarmjx.cli.sweep:app", "Play many configurations of tasks, and compare them."),
    "suite": ("usarmjx.cli.suite:app", "Play methods through a suite of tasks, and rank them."),
    "serve": (
        "usarmjx.cli.serve:serve",
        "Serve worlds of a batch over the Gamebots protocol, with their radio and cameras.",
    ),
    "console": (
        "usarmjx.cli.console.command:console",
        "Talk to a server in a terminal: send commands, see messages and pictures, drive by keys or "
        "joystick.",
    ),
    "play": (
        "usarmjx.cli.play:play",
        "Show a policy at work in one world: draw an episode, show it in a browser, or serve it.",
    ),
    "robot": ("usarmjx.cli.robot:app", "Check robots from files: URDF, xacro, SDF, MJCF."),
    "view": ("usarmjx.cli.recordings:view", "Show a recording in a browser, at any speed."),
    "plot": (
        "usarmjx.cli.recordings:plot",
        "Draw a recorded mission: plan, trails, scans, radio power, victims found, and all over time.",
    ),
    "film": (
        "usarmjx.cli.recordings:film",
        "Write a recording as a film in three dimensions, without a screen.",
    ),
    "replay": (
        "usarmjx.cli.recordings:replay",
        "Compute a recording again, bit for bit; report the first number that differs, and fail then.",
    ),
    "arena": ("usarmjx.cli.arena:app", "List, draw, check and generate arenas."),
    "portraits": ("usarmjx.cli.pictures:portraits", "Draw robots with the sensors' raycaster."),
    "radio-map": (
        "usarmjx.cli.pictures:radio_map",
        "Draw the power of a radio's signal all over an arena.",
    ),
    "calibrate": (
        "usarmjx.cli.calibrate:calibrate",
        "Measure the responses of robots to their motors, for engine planar, and its remaining errors.",
    ),
    "kernels": (
        "usarmjx.cli.kernels:kernels",
        "Compile kernels of engine warp into the cache, for GPUs that are elsewhere.",
    ),
    "bench": ("benchmarks.commands:app", "Measure the speed of this machine."),
    "chaos": (
        "benchmarks.chaos.command:chaos",
        "Attack a server of your own, within bounds, and report the effect on a well-behaved neighbour.",
    ),
}
"""All commands: the module of each and its summary, which is the first paragraph of its help."""
GROUPS: Mapping[str, tuple[str, ...]] = {
    "Start here": ("demo", "list", "doctor"),
    "Train": ("train", "curves", "export"),
    "Compare": ("eval", "teams", "league", "sweep", "suite"),
    "Serve": ("serve", "console"),
    "Look": ("play", "view", "film", "plot", "replay"),
    "Arenas and robots": ("arena", "robot", "portraits", "radio-map", "calibrate"),
    "Maintenance": ("kernels", "bench", "chaos"),
}
"""Headings of the help, each with its commands."""
EXAMPLES: Mapping[str, str] = {
    "demo": "usarmjx demo",
    "list": "usarmjx list tasks",
    "doctor": "usarmjx doctor",
    "train": "usarmjx train drive-to-goal --worlds 64 --steps 1000000 --out runs/drive",
    "curves": "usarmjx curves runs/drive --out curves.png",
    "export": "usarmjx export runs/drive --out drive.npz",
    "eval": "usarmjx eval runs/drive",
    "league": "usarmjx league runs/soccer --games 64",
    "teams": "usarmjx teams victim-search --out teams.png",
    "sweep": "usarmjx sweep thousand --plan",
    "suite": "usarmjx suite run baseline --split validation --out results",
    "serve": "usarmjx serve --arena yellow",
    "console": "usarmjx console 127.0.0.1:3000",
    "play": "usarmjx play drive-to-goal --out drive.gif",
    "view": "usarmjx view mission.mcap",
    "film": "usarmjx film mission.mcap --out mission.mp4",
    "plot": "usarmjx plot mission.mcap --out mission.png",
    "replay": "usarmjx replay mission.mcap",
    "arena": "usarmjx arena check my_arena.yaml",
    "robot": "usarmjx robot check my_robot.urdf",
    "portraits": "usarmjx portraits --out robots.png",
    "radio-map": "usarmjx radio-map yellow --out map.png",
    "calibrate": "usarmjx calibrate P2AT",
    "kernels": "usarmjx kernels 80 90",
    "bench": "usarmjx bench step --help",
    "chaos": "usarmjx chaos --help",
}
"""A command line of each command, at the end of its help."""
HELP = {"help_option_names": ["-h", "--help"]}


class RootCommand(LazyGroup):
    """All of the command line; old spellings of options become the present ones here."""

    table = COMMANDS
    examples = EXAMPLES
    headings: ClassVar = {name: heading for heading, names in GROUPS.items() for name in names}

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401 - click's, or typer's own copy
        """Parse what was typed."""
        # Before the parser: it knows only that there is no such command.
        if args and args[0] in NO_COMMANDS:
            say(f"there is no command {args[0]}: {NO_COMMANDS[args[0]]}")
            raise typer.Exit(BAD_INPUT)
        if told := removed_option(args):
            say(told)
            raise typer.Exit(BAD_INPUT)
        return super().parse_args(ctx, respelt(args, say))


app = typer.Typer(
    cls=RootCommand,
    help="USARSim rebuilt as a GPU-batched simulator of multi-robot swarms.",
    epilog="Begin with `usarmjx demo`. `usarmjx COMMAND --help` has the options and an example.",
    no_args_is_help=True,
    context_settings=HELP,
    # `ErrorExit` prints our own errors in a line; any other is a bug, whose plain traceback is wanted.
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
    # The callback of the option has done its work while the line was parsed.
    del version


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line `usarmjx` in this program, with the names that it has registered, and exit.

    Args:
        arguments: Words after `usarmjx`; None: those of this program.
    """
    # The program that calls this has a name of its own, which help and errors must not show.
    app(args=arguments, prog_name="usarmjx")
