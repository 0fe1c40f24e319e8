"""`usarmjx train`, `usarmjx curves` and `usarmjx export`: policies, from tasks to files."""

import json
import os
import socket
import subprocess
import sys
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.common import ErrorExit, OldOutArgument, chosen_out
from usarmjx.cli.completion import complete_tasks
from usarmjx.cli.policy_options import PolicyEngineOption
from usarmjx.cli.recordings import RecordOption, export_recording
from usarmjx.cli.startup_messages import announce, say, tried_on
from usarmjx.cli.viewer_options import ViewerPortOption, ViewOption, viewer_server, viewer_socket
from usarmjx.server.runtime.signals import PARENT_PIPE

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env
    from usarmjx.train.envs.state import EnvState
    from usarmjx.train.learning.config import Config
    from usarmjx.train.learning.fine_tuning import TrainedNetworks
    from usarmjx.train.learning.run_record import EnvArguments


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """What is asked for, by options of their own and by `--set`.

    Attributes:
        out: Folder of the run.
        engine: Its name, or `auto`.
        resume: Go on with the run in the folder.
        source: Folder of the run whose networks are begun with; None: random ones.
        checkpoint: Of that run.
        given: Settings with options of their own, those that were given.
        pairs: Others, as typed.
    """

    out: Path
    engine: str
    resume: bool = False
    source: Path | None = None
    checkpoint: str = "best"
    given: dict[str, Any]
    pairs: list[str]

    @property
    def typed(self) -> set[str]:
        """Keys of what `--set` sets."""
        return {pair.partition("=")[0] for pair in self.pairs}

    def within(self, settings: dict[str, Any], fields: dict[str, str]) -> "TrainOptions":
        """Return these with settings and fields of the task that hold where nothing else is asked for."""
        pairs = [f"{key}={text}" for key, text in fields.items() if key not in self.typed]
        kept = {key: value for key, value in settings.items() if key not in self.typed}
        return replace(self, given={**kept, **self.given}, pairs=[*pairs, *self.pairs])


@dataclass(frozen=True, kw_only=True)
class RunPlan:
    """What is run.

    Attributes:
        config: Settings of the training.
        overrides: Fields of the task that are set otherwise.
        origin: Engine, and the same fields as typed.
        source: Networks to begin with.
    """

    config: "Config"
    overrides: dict[str, Any]
    origin: "EnvArguments"
    source: "TrainedNetworks | None"


def plan_run(task: str, options: TrainOptions) -> RunPlan:
    """Return what is run when that is asked for; a line tells what nobody has typed.

    Raises:
        UnknownNameError: No such task, engine, setting or field; lists those there are.
        UsageError: A value that does not read, or no networks to begin with.
    """
    from usarmjx.train.learning.run_record import EnvArguments

    source, notice = None, ""
    if options.resume:
        options = _as_before(options)
    else:
        if options.source is not None:
            from usarmjx.train.learning.fine_tuning import load_trained

            source = load_trained(options.source, options.checkpoint)
            options = _as_trained(task, source, options)
        options, notice = _as_usual(task, options)
    config, overrides = _split_settings(task, options)
    if notice:  # once nothing is wrong with what was typed
        say(notice)
    texts = dict(pair.split("=", 1) for pair in options.pairs)
    origin = EnvArguments(options.engine, {key: texts[key] for key in overrides})
    return RunPlan(config=config, overrides=overrides, origin=origin, source=source)


def _as_before(options: TrainOptions) -> TrainOptions:
    """Return settings, fields and engine as the run was started, unless asked for otherwise."""
    from usarmjx.train.learning.run_record import RECORD_FILE, load_record

    if not (options.out / RECORD_FILE).exists():
        return options
    record = load_record(options.out)
    before = options.within(vars(record.config), record.overrides)
    return replace(before, engine=record.engine if options.engine == "auto" else options.engine)


def recorded_engine(out: Path) -> str:
    """Return the engine that a run was started with, before JAX is imported; `auto` where none is told."""
    try:
        return str(json.loads((out / "config.json").read_text())["engine"])
    except (OSError, ValueError, KeyError, TypeError):  # `load_record` says what is wrong with it
        return "auto"


def _as_trained(task: str, source: "TrainedNetworks", options: TrainOptions) -> TrainOptions:
    """Return networks' settings and, of the same task, fields as those were trained with, but for physics."""
    from usarmjx.train.make import same_class

    same = same_class(task, source.record.task)
    fields = {key: text for key, text in source.record.overrides.items() if same and key != "physics"}
    chosen = options.within(source.settings, fields)
    say("; ".join([source.describe(), *chosen.pairs[: len(chosen.pairs) - len(options.pairs)]]))
    return chosen


def _as_usual(task: str, options: TrainOptions) -> tuple[TrainOptions, str]:
    """Return what trainings of the task have unless asked for otherwise, and what to say of it."""
    from usarmjx.engines import choose_engine
    from usarmjx.train.learning.config import training_engine, training_fields

    engine = training_engine(task, options.engine)
    chosen = replace(options.within({}, training_fields(task, engine)), engine=engine)
    if engine == choose_engine(options.engine, "train"):
        return chosen, ""
    usual = chosen.pairs[: len(chosen.pairs) - len(options.pairs)]
    return chosen, ", ".join([f"{task} trains on engine {engine} unless another is named", *usual])


def _split_settings(task: str, options: TrainOptions) -> tuple["Config", dict[str, Any]]:
    """Return the settings of the training, and the fields of the task that are set otherwise."""
    from dataclasses import asdict, fields

    from usarmjx.train.learning.config import Config, on_gpu, parse_settings, task_config
    from usarmjx.train.make import make_task

    chosen = make_task(task)
    own = {field.name: getattr(chosen, field.name) for field in fields(chosen)}
    simple = {
        name: value for name, value in own.items() if isinstance(value, str | bool | int | float | tuple)
    }
    training = asdict(Config())
    found = parse_settings(options.pairs, {**simple, **training}, f"{task} and its training")
    overrides = {key: value for key, value in found.items() if key not in training}
    chosen_here = {**options.given, **{key: value for key, value in found.items() if key in training}}
    return task_config(task, gpu=on_gpu(options.engine), **chosen_here), overrides


HOST = "127.0.0.1"
"""Where the live page of a training is."""
app = typer.Typer()

SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        "-c",
        help="A setting of the training or a field of the task, key=value; may be repeated.",
    ),
]


@app.command()
def train(
    named: Annotated[
        str | None,
        typer.Argument(
            metavar="TASK", help="Name of the task, or FILE.py:CLASS.", autocompletion=complete_tasks
        ),
    ] = None,
    task: Annotated[
        str | None, typer.Option(help="Name of the task, likewise.", autocompletion=complete_tasks)
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the run; runs/TASK if none is given.", show_default=False)
    ] = None,
    worlds: Annotated[
        int | None,
        typer.Option(min=1, help="Worlds in all; each task has its number, and more on a GPU."),
    ] = None,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Agent steps in all; each task has its number.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of all random numbers; 0, or that of a run that is resumed.")
    ] = None,
    engine: PolicyEngineOption = "auto",
    settings: SetOption = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Go on where the run in the folder was left, with its settings."),
    ] = False,
    source: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="RUN",
            help="Begin with the networks of another run, on this engine: its folder.",
            show_default=False,
        ),
    ] = None,
    checkpoint: Annotated[
        str, typer.Option(help="With --from: best, last, or the number of an iteration.")
    ] = "best",
    processes: Annotated[int, typer.Option(min=1, help="Processes on this host, each with a device.")] = 1,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress bar.")] = False,
    serve: Annotated[
        bool,
        typer.Option(
            "--serve", help="Serve a world, too, in which the newest checkpoint drives; see `play --follow`."
        ),
    ] = False,
    port: Annotated[int, typer.Option(min=0, max=65535, help="With --serve: its TCP port.")] = 3000,
    wandb: Annotated[
        str | None, typer.Option(help="Project of Weights & Biases that the run is shown in, too.")
    ] = None,
    view: ViewOption = False,
    viewer_port: ViewerPortOption = None,
    record: RecordOption = None,
    record_every: Annotated[
        int, typer.Option(min=1, help="With --record: of so many iterations one is kept, of 4 worlds.")
    ] = 50,
) -> None:
    """Train a policy for a task. An unknown --set key lists what may be set."""
    with ErrorExit():
        task = _task_of(named, task)
        if resume and source is not None:
            raise UsageError("a run that is resumed has networks of its own: leave out --from or --resume")
        if source is None and checkpoint != "best":
            raise UsageError("--checkpoint says which one of the run that --from names: name that, too")
        out = out or Path("runs") / task.rpartition(":")[2].removesuffix(".py")
        from usarmjx.train.learning.processes import process_info, spawn

        joined = process_info(os.environ)
        if processes > 1 and joined is None:
            raise typer.Exit(spawn(processes, [sys.executable, "-m", "usarmjx", *sys.argv[1:]]))
        announce(
            f"building worlds for {task} ...",
            aloud=joined is None or joined.index == 0,
            engines=[recorded_engine(out) if resume and engine == "auto" else tried_on(engine)],
        )
        from usarmjx.train.learning.processes import distributed_run

        with (
            distributed_run() as process,
            _served(out, port, serve and process.index == 0),
            viewer_socket(HOST, viewer_port, 0, view and process.index == 0) as page,
        ):
            watchers: list[_TrainingWatcher] = []
            if page is not None:
                watchers.append(_ShownTraining(page, f"{task}, in training"))
            if record is not None and process.index == 0:
                watchers.append(_RecordedTraining(record, record_every))
            typed = {"worlds": worlds, "steps": steps, "seed": seed}
            options = TrainOptions(
                out=out,
                engine=engine,
                resume=resume,
                source=source,
                checkpoint=checkpoint,
                given={key: value for key, value in typed.items() if value is not None},
                pairs=settings or [],
            )
            bar = not quiet and not process.index
            score = _train(task, options, watchers, None if process.index else wandb, bar)
            if process.index == 0:
                typer.echo(score)


def _task_of(named: str | None, task: str | None) -> str:
    """Return the task, which is named by its place or by an option.

    Raises:
        UsageError: By neither, or by both.
    """
    chosen = [name for name in (named, task) if name is not None]
    if len(chosen) != 1:
        raise UsageError("name one task, as usarmjx train explore; `usarmjx list tasks` shows them all")
    return chosen[0]


@contextmanager
def _served(run: Path, port: int, wanted: bool) -> Generator[None]:
    """Serve a world of a run in a process of its own, on the CPU, until the training ends."""
    if not wanted:
        yield
        return
    if os.name == "nt":
        from usarmjx.base.errors import UsageError

        raise UsageError(f"train --serve needs POSIX: run `usarmjx play {run} --serve --follow` beside it")
    command = [sys.executable, "-m", "usarmjx", "play", str(run), "--serve", "--follow", "--port", str(port)]
    # The child ends with this process, however that ends: then nobody holds the other end of its pipe.
    theirs, ours = os.pipe()
    settings = {**os.environ, "JAX_PLATFORMS": "cpu", PARENT_PIPE: str(theirs)}
    child = subprocess.Popen(command, env=settings, pass_fds=(theirs,))
    os.close(theirs)
    try:
        yield
    finally:
        os.close(ours)
        child.wait()


def _train(
    task: str,
    options: TrainOptions,
    watchers: "Sequence[_TrainingWatcher]",
    project: str | None,
    bar: bool,
) -> str:
    """Train, in one of the processes, which must be joined already: some imports put arrays on the device.

    Args:
        task: Name of the task.
        options: What is asked for.
        watchers: Who gets to see the worlds.
        project: Of Weights & Biases; None: it is not shown there.
        bar: Show one.

    Returns:
        What came of it, in a line.
    """
    from usarmjx.train.learning.trainer import train as run
    from usarmjx.train.make import make

    plan, out = plan_run(task, options), options.out
    config, engine = plan.config, plan.origin.engine

    def worlds_of(count: int, first: int) -> "Env":
        env = make(task, worlds=count, engine=engine, seed=config.seed, first=first, **plan.overrides)
        for watcher in watchers:
            watcher.begin(env, config)
        return env

    def look(state: "EnvState") -> None:
        for watcher in watchers:
            watcher.look(state)

    watch = None
    if project is not None:
        from usarmjx.train.learning.metrics import wandb_watch

        watch = wandb_watch(project, out.name, {"task": task, **vars(config)}, say)
    try:
        done = run(
            worlds_of,
            config,
            out,
            options.resume,
            origin=plan.origin,
            source=plan.source,
            progress=bar,
            watch=watch,
            look=look if watchers else None,
        )
    finally:
        for watcher in watchers:
            watcher.close()
    score = done.last_metrics.get("score")
    return f"{done.agent_steps:,} agent steps, score {score if score is None else round(score, 3)}: {out}"


class _TrainingWatcher(Protocol):
    """Gets to see the worlds of a training."""

    def begin(self, env: "Env", config: "Config") -> None:
        """Take the training's worlds and its settings."""

    def look(self, state: "EnvState") -> None:
        """Look at the worlds as they are."""

    def close(self) -> None:
        """The training is over."""


class _ShownTraining:
    """A training on the live page.

    Args:
        bound: Where the page is.
        title: What it is called.
    """

    def __init__(self, bound: socket.socket, title: str) -> None:
        self._server, self._title = viewer_server(bound, HOST), title

    def begin(self, env: "Env", config: "Config") -> None:
        """Take the training's worlds."""
        del config
        from usarmjx.view.page import ViewerPage
        from usarmjx.view.training_page import TrainingPage
        from usarmjx.view.user_panels import UserPanels

        self._page = TrainingPage(
            env.batch,
            lambda source: ViewerPage(source, title=self._title, panels=[UserPanels], server=self._server),
        )

    def look(self, state: "EnvState") -> None:
        """Show the worlds as they are."""
        self._page.show(state.batch)

    def close(self) -> None:
        """Leave the page as it is: it goes with the process."""


class _RecordedTraining:
    """A training of which some iterations are recorded.

    Args:
        path: The file.
        every: Of so many iterations one is kept.
    """

    def __init__(self, path: Path, every: int) -> None:
        self._path, self._every = path, every
        self._held = ExitStack()

    def begin(self, env: "Env", config: "Config") -> None:
        """Take the training's worlds and its settings."""
        from usarmjx.recording.episodes import TrainingRecorder, episode_file

        file = self._held.enter_context(episode_file(env, self._path))
        calls = 1 if env.traceable else config.rollout
        self._recorder = TrainingRecorder(env, file, self._every, calls)

    def look(self, state: "EnvState") -> None:
        """Keep the worlds as they are."""
        self._recorder.look(state)

    def close(self) -> None:
        """Complete the file."""
        self._held.close()


@app.command()
def export(
    run: Annotated[
        Path, typer.Argument(help="Folder of the run, or task of a packaged policy; or a recording, .mcap.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="File to write, .npz; of a recording .csv, .parquet, .gif or .mp4; needed.",
            show_default=False,
        ),
    ] = None,
    old_out: OldOutArgument = None,
    checkpoint: Annotated[str, typer.Option(help="best, last, or the number of an iteration.")] = "best",
    half: Annotated[bool, typer.Option("--half", help="Weights of 16 bits: half the size.")] = False,
    world: Annotated[int, typer.Option(min=0, help="Of a recording: which world films show.")] = 0,
    speed: Annotated[float, typer.Option(min=0.01, help="Of a recording: how fast films are.")] = 2.0,
) -> None:
    """Write a policy to a file that NumPy alone can run; or a recording as tables or as a film."""
    with ErrorExit():
        where = chosen_out(out, old_out)
        announce(f"reading {run} ...")
        if run.is_file():
            export_recording(run, where, world, speed)
            return
        from usarmjx.train.policies.policy_file import export_run

        export_run(run, where, checkpoint, half)
        typer.echo(f"wrote {where}, {where.stat().st_size / 1024:.0f} KB")


@app.command()
def curves(
    sources: Annotated[
        list[Path], typer.Argument(help="Folders of runs, or files of benchmark records, one a line.")
    ],
    out: Annotated[Path, typer.Option(help="PNG file to write.")] = Path("curves.png"),
) -> None:
    """Draw how scores rose in training, over agent steps and over time; of each seed the last run given."""
    with ErrorExit():
        announce("drawing curves ...")
        from usarmjx.plots.training_plots import plot_curves

        plot_curves(sources, out)
        typer.echo(f"wrote {out}")
