"""Options and helpers that all commands share, and their messages while they start and compile.

The messages are on the standard error stream, terminal or not.
"""

import os
import sys
import threading
import time
import warnings
from collections.abc import Callable, Collection, Generator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from usarmjx.base.compilation import (
    COMPILE_EVENT_PREFIX,
    JAX_FOLDER,
    disable_optimization,
    enable_compilation_cache,
    is_compiling,
    silence,
    warn_once_of_broken_entries,
)
from usarmjx.base.errors import MAX_QUOTATION, UsageError, UsarmjxError, one_line
from usarmjx.base.files import disk_error
from usarmjx.base.process import fit_pool_to_cores
from usarmjx.base.progress import clear_status
from usarmjx.base.settings import RenamedSettingWarning
from usarmjx.cli.known_names import (
    check_name,
    check_roster,
    complete_arenas,
    complete_engines,
    complete_robots,
    full_name,
)

# 130 is 128 plus the number of SIGINT, as shells report a process that Ctrl-C has ended.
FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130
"""Exit codes beside 0: what was tried did not come out well; it could not be tried as asked for; Ctrl-C."""


class ErrorExit:
    """Turns our own exceptions, and a disk's, into one line and an exit code; anything else is a bug.

    The code is `BAD_INPUT` where the caller can do something about it, else `FAILED`.
    A disk is met here where what a command shows goes to a file.
    """

    def __enter__(self) -> None:
        """Begin; from now on old names of settings are reported, a line each."""
        # `__enter__` is called here: the filters must hold until `__exit__`, over the caller's block.
        self._warnings = warnings.catch_warnings()
        self._warnings.__enter__()
        # Python hides deprecations outside of the main module and repeats none: a user must see each.
        warnings.simplefilter("always", RenamedSettingWarning)
        # Other warnings keep the form that Python, or pytest, gives them.
        usual = warnings.showwarning

        def report(message: Warning | str, category: type[Warning], *where: Any) -> None:  # noqa: ANN401
            if issubclass(category, RenamedSettingWarning):
                typer.echo(f"usarmjx: {message}", err=True)
            else:
                usual(message, category, *where)

        warnings.showwarning = report

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> bool:
        """End the command if the error is one of ours, or a disk's."""
        self._warnings.__exit__(None, None, None)
        text = str(error) if isinstance(error, UsarmjxError) else None
        if isinstance(error, OSError) and (reason := disk_error(error)):
            # An error of a stream that is open, as the standard output, names no file.
            name = str(error.filename or "the output")
            text = f"{name if len(name) <= MAX_QUOTATION else f'{name[:MAX_QUOTATION]}...'}: {reason}"
        # Any other exception is a bug of ours: its traceback is what helps.
        if text is None:
            return False
        with suppress(OSError):  # the error stream may go to the same disk
            clear_status()
            typer.echo(f"usarmjx: {one_line(text)}", err=True)
        raise typer.Exit(BAD_INPUT if isinstance(error, UsageError | OSError) else FAILED)


def ends_on_signals() -> AbstractContextManager[object]:
    """Return a context in which SIGINT and SIGTERM end a command that has nothing to keep, at once.

    Python's own handler waits for XLA, which may compile for minutes. A signal that is ignored stays so.
    """
    from usarmjx.server.runtime.signals import StopSignals, heard_signals

    return StopSignals(heard_signals())


@contextmanager
def unwinds_on_signals(patience: float = 0.0, kept: str = "") -> Generator[None]:
    """On SIGINT or SIGTERM leave the contexts within this one, say so in a line, and end the process.

    A signal that is ignored stays so.

    Args:
        patience: Time for that, beyond `signals.END_TIME` and at most `signals.FILES_TIME` [s].
        kept: Said behind the name of the signal.
    """
    from usarmjx.server.runtime.signals import StopSignals, heard_signals

    heard = heard_signals()
    with StopSignals(heard) as signals:
        signals.finish_files(lambda: time.sleep(patience))
        try:
            yield
        except SystemExit as end:
            # `StopSignals` leaves with 128 plus the number of the signal; any other status is no signal's.
            for number in heard:
                if end.code == 128 + number:
                    with suppress(OSError):
                        clear_status()
                        typer.echo(f"usarmjx: stopped by {number.name}{kept}", err=True)
            raise


def named_roster(ctx: typer.Context, value: Any) -> Any:  # noqa: ANN401 - a roster or several
    """Refuse rosters, as P2AT:4,P2DX:2, with classes of robots that there are not."""
    with ErrorExit():
        for roster in [value] if isinstance(value, str) else value or ():
            # Click parses incomplete lines to complete them: then names may be half typed.
            if not ctx.resilient_parsing:
                check_roster(roster)
    return value


def named(kind: str) -> Callable[[typer.Context, Any], Any]:
    """Return a callback of options and arguments that refuses names which there are not.

    It works while the command line is parsed, before the command imports anything. A bare name becomes that
    of the newest version.

    Args:
        kind: Kind of the names, see `known_names.REGISTRIES`.
    """

    def check(ctx: typer.Context, value: Any) -> Any:  # noqa: ANN401 - a name, names, or None
        with ErrorExit():
            for name in [value] if isinstance(value, str) else value or ():
                if not ctx.resilient_parsing:
                    check_name(kind, name)
        return full_name(kind, value) if isinstance(value, str) else value

    return check


OutOption = Annotated[Path | None, typer.Option("--out", help="File to write; needed.", show_default=False)]
OutFolderOption = Annotated[
    Path | None, typer.Option("--out", help="Folder for the pictures; needed.", show_default=False)
]
SeedOption = Annotated[int, typer.Option(help="Seed of all random numbers.")]
EngineOption = Annotated[
    str,
    typer.Option(
        help="warp, jax, c, planar, or auto: the best for the purpose here.",
        autocompletion=complete_engines,
        callback=named("engine"),
    ),
]
ArenaOption = Annotated[
    str,
    typer.Option(
        help="Arena name, as `usarmjx list` shows them, or a file.",
        autocompletion=complete_arenas,
        callback=named("arena"),
    ),
]
ArenaArgument = Annotated[
    str,
    typer.Argument(help="Arena name, or a file.", autocompletion=complete_arenas, callback=named("arena")),
]
RobotFilesOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--robot", help="URDF, xacro, SDF or MJCF file of a robot to add; may be given several times."
    ),
]


def search_packages(ctx: typer.Context, folders: list[Path] | None) -> list[Path] | None:
    """Search packages and models in the folders of `--packages` first, until the command ends."""
    if folders and not ctx.resilient_parsing:
        from usarmjx.models.files.resources import search_first

        # Undone at the end: tests and programs run several commands in one process.
        ctx.call_on_close(search_first(folders))
    return folders


PackagesOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--packages",
        exists=True,
        file_okay=False,
        callback=search_packages,
        help="Folder with packages or models that files of robots and arenas name; may be repeated.",
    ),
]
TaskRobotOption = Annotated[
    str | None,
    typer.Option(
        help="Robot class, or a file, of the task: as --set robot=.",
        autocompletion=complete_robots,
        callback=named("robot"),
    ),
]


def set_pieces(ctx: typer.Context, pieces: int | None) -> int | None:
    """Cut meshes of robots into as many pieces as `--pieces` says, until the command ends."""
    if pieces is not None and not ctx.resilient_parsing:
        from usarmjx.models.files.resources import cut_meshes

        # Undone at the end, as `search_packages`.
        ctx.call_on_close(cut_meshes(pieces))
    return pieces


PiecesOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=64,
        callback=set_pieces,
        help="Convex pieces of a mesh of a robot's file at most, by coacd; else its hull.",
    ),
]
IniOption = Annotated[
    list[Path] | None,
    typer.Option("--ini", help="USARBot.ini or USARMisPkg.ini with robots; may be given several times."),
]
JsonFlag = Annotated[bool, typer.Option("--json", help="Print JSON.")]
WorldsOption = Annotated[int, typer.Option(min=1, help="Worlds in the batch.")]
RadioIniOption = Annotated[
    Path | None, typer.Option("--radio-ini", help="USARComServer.ini with the radio's constants.")
]
PortOffsetOption = Annotated[
    int, typer.Option(min=0, max=65535, help="Added to this port and all others, for a second server.")
]
UnitOption = Annotated[float, typer.Option(help="Unreal units in a metre, for ini files with bMountByUU.")]


def read_size(text: str) -> tuple[int, int]:
    """Return columns and rows of a size given as 12x8.

    Raises:
        UsageError: It is not of that form.
    """
    columns, _, rows = text.partition("x")
    # Not int() alone, which also takes signs, blanks and underscores.
    if not (columns.isdecimal() and rows.isdecimal()):
        raise UsageError(f"size {text!r} is not of the form 12x8 (columns x rows)")
    return int(columns), int(rows)


OldOutArgument = Annotated[Path | None, typer.Argument(hidden=True)]
"""Former positional argument of the output file."""


def chosen_out(out: Path | None, old: Path | None) -> Path:
    """Return the path of the output.

    Args:
        out: Value of `--out`.
        old: Value of the former positional argument, which is reported as deprecated.

    Raises:
        UsageError: Neither or both are given.
    """
    if out is not None and old is not None:
        raise UsageError(f"{old} is too much: --out names the file to write")
    if old is not None:
        typer.echo(f"usarmjx: the file to write is an option now: --out {old}", err=True)
    where = out or old
    if where is None:
        raise UsageError("name the file to write: --out PATH")
    return where


def add_robots(files: list[Path] | None) -> None:
    """Register the robots of files; what is left out of them goes to the standard error stream."""
    if not files:
        return
    from usarmjx.models.files.find_robot import register_robot_file

    for path in files:
        register_robot_file(path)


def with_robot(pairs: Sequence[str] | None, robot: str | None) -> list[str]:
    """Return `--set` of a task with the robot of `--robot`; a robot in both is refused when it is read."""
    return [*(pairs or ()), *([] if robot is None else [f"robot={robot}"])]


def configure_from(files: list[Path] | None, uu_per_metre: float) -> None:
    """Apply ini files to the robots; warnings go to the standard error stream."""
    if not files:
        return
    from usarmjx.sim.configure import configure

    for warning in configure(files, uu_per_metre).warnings:
        typer.echo(f"usarmjx: warning: {warning}", err=True)


FIRST, INTERVAL = 3.0, 10.0
"""Time after which a compilation is reported, and interval of further reports [s]."""
GAP = 5.0
"""Longest pause between compilations that belong together [s]."""
NEEDS_POOL = {"jax", "auto"}
"""The engine that deadlocks in a small pool of threads, and what stands for it in a batch on a CPU."""
LOWERED, COMPILED = "jaxpr_to_mlir_module_duration", "backend_compile_duration"


class CompilationWatch:
    """Says now and then that JAX is compiling, and when it is over.

    JAX tells of each part of a compilation when it ends: that a function was traced, lowered, compiled.
    Between the last two XLA is at work, for minutes perhaps.

    Args:
        say: Takes a line.
        at_work: Whether a thread, by number, compiles just now: what is lowered need not be compiled.
        interval: Interval of reports [s]
    """

    def __init__(
        self, say: Callable[[str], None], at_work: Callable[[int], bool], interval: float = INTERVAL
    ) -> None:
        self._say, self._at_work, self._interval = say, at_work, interval
        self._compiling: set[int] = set()  # threads in which XLA may be at work
        # The last event lies far back, so that the first one always begins an interval.
        self._begun, self._last, self._next = 0.0, -1e9, FIRST
        self._is_over = False  # an end was reported
        # JAX calls its listeners in the threads that compile, the watch looks from its own.
        self._lock = threading.Lock()

    def heard(self, event: str, duration: float, now: float, thread: int = 0) -> None:
        """Take note of an event of JAX's.

        Args:
            event: Its name.
            duration: Duration so far [s].
            now: The time [s].
            thread: Place of that.
        """
        if not event.startswith(COMPILE_EVENT_PREFIX):
            return
        with self._lock:
            if not self._busy() and (self._is_over or now - duration - self._last > GAP):
                # The new interval begins after the last reported event, even if its tracing began earlier.
                self._begun, self._next = max(now - duration, self._last), FIRST
            self._last, self._is_over = now, False
            # Any event of a thread means that its former compilation is over.
            self._compiling.discard(thread)
            if event.endswith(LOWERED):
                self._compiling.add(thread)

    def _busy(self) -> bool:
        return any(map(self._at_work, self._compiling))

    def look(self, now: float) -> None:
        """Report compilations that are due at a time [s]."""
        with self._lock:
            busy = self._busy()
            # While nothing compiles the length is that of the past, so that pauses do not count.
            length = (now if busy else self._last) - self._begun
            if busy or now - self._last <= GAP:
                if length >= self._next:
                    self._say(f"compiling ... {length:.0f} s")
                    # To a whole multiple of the interval, so that lines keep their rhythm after a long step.
                    self._next = length - length % self._interval + self._interval
            elif self._next > FIRST:
                # Only where a line has said before that it compiles: short compilations pass in silence.
                self._say(f"compiled, {length:.0f} s")
                self._next, self._is_over = FIRST, True


def say(text: str) -> None:
    """Write a line to the standard error stream; unheard where that is a file and the disk is full."""
    with suppress(OSError):
        clear_status()
        typer.echo(f"usarmjx: {text}", err=True)


def announce(
    text: str,
    *,
    keep: bool = True,
    aloud: bool = True,
    quickly: bool = False,
    interval: float = INTERVAL,
    engines: Collection[str] = ("auto",),
) -> None:
    """Say what takes a while, and go on saying so while it compiles; what is compiled is kept.

    The first line comes before JAX is imported, which takes a second or two. Nothing happens in a process
    that has it behind itself: it compiles, and keeps what it compiles, as it likes.

    Args:
        text: The step begun.
        keep: Whether compilations are kept, and those of before used.
        aloud: Whether to report; of several processes that do the same, one is enough.
        quickly: Whether to compile without optimisation.
        interval: Interval of reports about compilation [s].
        engines: Those that may be built; without `NEEDS_POOL` JAX's pool has a thread for each core.
    """
    # Environment variables and the cache's folder are read when JAX is imported: later they have no effect.
    if "jax" in sys.modules:
        return
    silence()
    tell = say if aloud else _say_nothing
    tell(one_line(text))
    if NEEDS_POOL.isdisjoint(name.strip().lower() for name in engines):
        fit_pool_to_cores()
    if quickly:
        disable_optimization()
    if keep:
        if complaint := enable_compilation_cache():
            tell(f"note: {complaint}")
        if folder := os.environ.get(JAX_FOLDER):
            warn_once_of_broken_entries(tell, Path(folder))
    # A thread, as the main one is inside JAX for all the time that is worth reporting.
    threading.Thread(target=_watch, args=(tell, interval), name="compilations", daemon=True).start()


def tried_on(engine: str) -> str:
    """Return the engine of policies that are trained or tried on a CPU: `auto` is c, see `choose_engine`."""
    return "c" if engine.lower() == "auto" else engine


def _say_nothing(text: str) -> None:
    del text


def _watch(tell: Callable[[str], None], interval: float) -> None:
    """Tell of compilations from the moment on that somebody imports JAX."""
    # This thread must not import JAX itself: the command decides about its settings before.
    while "jax" not in sys.modules:
        # Polled, as nothing reports an import.
        time.sleep(0.1)
    from jax import monitoring

    watch = CompilationWatch(tell, is_compiling, interval)

    def hear(event: str, duration_secs: float, **_: object) -> None:
        watch.heard(event, duration_secs, time.monotonic(), threading.get_ident())

    monitoring.register_event_duration_secs_listener(hear)
    # Events come only at the end of a step, so the clock alone shows that a long one goes on.
    while True:
        time.sleep(0.5)
        watch.look(time.monotonic())
