"""`usarmjx train`, `usarmjx curves` and `usarmjx export`: policies, from tasks to files; clips."""

import os
import socket
import subprocess
import sys
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer
from typer.core import TyperCommand

from usarmjx.base.errors import UsageError
from usarmjx.base.settings import to_yaml
from usarmjx.cli.common import (
    ErrorExit,
    OldOutArgument,
    PackagesOption,
    PiecesOption,
    PortOffsetOption,
    TaskRobotOption,
    announce,
    chosen_out,
    named,
    say,
    tried_on,
    with_robot,
)
from usarmjx.cli.known_names import check_policy, complete_tasks
from usarmjx.cli.recordings import PicturesOption, RecordOption, export_recording
from usarmjx.cli.setting_options import ConfigOption, PrintConfigOption, help_table
from usarmjx.cli.task_options import PolicyEngineOption, task_text
from usarmjx.cli.train_plan import (
    TrainOptions,
    check_alone,
    check_curriculum,
    plan_run,
    recorded_engine,
    result_line,
    run_seeds,
    stop_request,
    trains_seeds,
)
from usarmjx.cli.viewer_options import ViewerPortOption, ViewOption, viewer_server, viewer_socket
from usarmjx.server.runtime.signals import ParentPipe

if TYPE_CHECKING:
    from usarmjx.plots.play import Sink
    from usarmjx.train.envs.env import Env
    from usarmjx.train.envs.state import EnvState
    from usarmjx.train.learning.config import Config
    from usarmjx.train.learning.trainer import StopRequest
    from usarmjx.train.learning.trajectory import RolloutInputs


HOST = "127.0.0.1"
"""Host of the live page of a training."""
app = typer.Typer()
TrainSetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        "-c",
        metavar="NAME=VALUE",
        help="A setting of the training or the task, see `usarmjx train TASK --help`; may be repeated.",
    ),
]


class ClippedTraining:
    """A training of which clips are made.

    Args:
        out: Folder of the run; clips go into its folder `clips`, and into TensorBoard's.
        every: Iterations from one clip to the next.
        wandb: Whether the run is shown in Weights & Biases, too.
    """

    def __init__(self, out: Path, every: int, wandb: bool) -> None:
        self._out, self._every, self._wandb = out, every, wandb
        self._held = ExitStack()

    def begin(self, env: "Env", config: "Config") -> None:
        """Take the training's worlds and its settings."""
        from usarmjx.plots.play import Clips
        from usarmjx.train.learning.tensorboard import TensorBoardLog

        # Agent steps are the axis of TensorBoard's other curves.
        agents = sum(len(group.agents) for group in env.groups)
        steps = config.rollout_length * config.num_worlds * agents
        # A file of its own, as the curves' is held by the training; TensorBoard shows it as a run beside it.
        board = TensorBoardLog(self._out / "tensorboard" / "clips", 0)
        self._held.callback(board.close)

        def to_board(rank: str, path: Path, iteration: int) -> None:
            board.show_picture(iteration * steps, f"clips/{rank}", path.read_bytes())

        sinks: tuple[Sink, ...] = (to_board, _to_wandb) if self._wandb else (to_board,)
        self._clips = Clips(env, self._out / "clips", self._every, sinks)

    def look(self, state: "EnvState") -> None:
        """Ignore it."""

    def inspect(self, inputs: "RolloutInputs") -> None:
        """Make clips, if the iteration is one of those."""
        from usarmjx.base.errors import WriteError

        try:
            self._clips.inspect(inputs)
        # A full disk must not end a training for the sake of a picture.
        except (OSError, WriteError) as error:
            say(f"no clips of iteration {inputs.iteration}: {error}; training goes on")

    def close(self) -> None:
        """Complete TensorBoard's file."""
        self._held.close()


def _to_wandb(rank: str, path: Path, iteration: int) -> None:
    """Add a clip to what is logged next; a service elsewhere may fail, training goes on."""
    from usarmjx.train.learning.metrics import find_wandb

    del iteration
    module = find_wandb()
    try:
        # Not committed: the clip goes out with the figures of its iteration, under the same step.
        module.log({f"clips/{rank}": module.Video(str(path), format="gif")}, commit=False)
    except Exception as error:
        say(f"note: Weights & Biases has no clip {path.name}: {error}")


class TrainCommand(TyperCommand):
    """`usarmjx train`, whose help lists the settings of the task that is named."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401 - click's, or typer's own copy
        """Parse the words after `usarmjx train`, and keep them for the help."""
        # Before parsing: `--help` ends it, and the task may stand on either side.
        ctx.meta[self.name] = list(args)
        return super().parse_args(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401 - as above
        """Write the help, and the settings of a task that is named before or after `--help`."""
        super().format_help(ctx, formatter)
        # The task may be one word with its option, as --task=explore.
        words = [word.removeprefix("--task=") for word in ctx.meta.get(self.name, ())]
        names = [word for word in words if not word.startswith("-")]
        if names:
            typer.echo(settings_help(names))


def settings_help(names: Sequence[str]) -> str:
    """Return the settings of the training and the fields of the first task among some words; else nothing."""
    from usarmjx.train.learning.config import Config, task_config
    from usarmjx.train.make import make_task
    from usarmjx.train.task_names import is_own, newest_name
    from usarmjx.train.tasks import TASKS

    task = next((newest_name(name) for name in names if is_own(name) or name in TASKS), None)
    if task is None:
        return ""
    found = make_task(task)
    tables = (
        (f"Settings of the training of {task}, on a CPU", Config, task_config(task)),
        (f"Settings of the task {task}", type(found), found),
    )
    return "\n\n".join(help_table(*table) for table in tables) + "\n"


TaskArgument = Annotated[
    str | None,
    typer.Argument(
        metavar="TASK",
        help="Name of the task, or FILE.py:CLASS.",
        autocompletion=complete_tasks,
        callback=named("task"),
    ),
]
TaskOption = Annotated[
    str | None,
    typer.Option(help="Name of the task, likewise.", autocompletion=complete_tasks, callback=named("task")),
]
RunFolderOption = Annotated[
    Path | None, typer.Option(help="Folder of the run; runs/TASK if none is given.", show_default=False)
]
NumWorldsOption = Annotated[
    int | None,
    typer.Option("--worlds", min=1, help="Worlds in all; each task has its number, and more on a GPU."),
]
TotalStepsOption = Annotated[
    int | None, typer.Option("--steps", min=1, help="Agent steps in all; each task has its number.")
]
RunSeedOption = Annotated[
    int | None, typer.Option(help="Seed of all random numbers; 0, or that of a run that is resumed.")
]
SeedsOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Train that many seeds in one program, from --seed on, each in a folder seed-K of its own.",
    ),
]
ResumeOption = Annotated[
    bool,
    typer.Option(
        "--resume", help="Continue the run in the folder from its last checkpoint, with its settings."
    ),
]
FromOption = Annotated[
    Path | None,
    typer.Option(
        "--from",
        metavar="RUN",
        help="Begin with the networks of another run, on this engine: its folder.",
        show_default=False,
    ),
]
FromCheckpointOption = Annotated[
    str, typer.Option(help="With --from: best, last, or the number of an iteration.")
]
ProcessesOption = Annotated[int, typer.Option(min=1, help="Processes on this host, each with a device.")]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Show no progress bar.")]
ServeOption = Annotated[
    bool,
    typer.Option(
        "--serve", help="Serve a world, too, in which the newest checkpoint drives; see `play --follow`."
    ),
]
ServePortOption = Annotated[int, typer.Option(min=0, max=65535, help="With --serve: its TCP port.")]
WandbOption = Annotated[
    str | None, typer.Option(help="Project of Weights & Biases that the run is shown in, too.")
]
RecordEveryOption = Annotated[
    int, typer.Option(min=1, help="With --record: iterations from one kept to the next; 4 worlds of each.")
]
ClipsOption = Annotated[
    int,
    typer.Option(
        min=0,
        help="Iterations from one to the next whose best, median and worst world are filmed, for TensorBoard "
        "and Weights & Biases, too; 0: none.",
    ),
]


@app.command(cls=TrainCommand, epilog="`usarmjx train TASK --help` lists the settings of a task.")
def train(
    named: TaskArgument = None,
    task: TaskOption = None,
    out: RunFolderOption = None,
    num_worlds: NumWorldsOption = None,
    total_steps: TotalStepsOption = None,
    seed: RunSeedOption = None,
    seeds: SeedsOption = None,
    engine: PolicyEngineOption = "auto",
    settings: TrainSetOption = None,
    config: ConfigOption = None,
    print_config: PrintConfigOption = False,
    resume: ResumeOption = False,
    source: FromOption = None,
    checkpoint: FromCheckpointOption = "best",
    processes: ProcessesOption = 1,
    quiet: QuietOption = False,
    serve: ServeOption = False,
    port: ServePortOption = 3000,
    port_offset: PortOffsetOption = 0,
    wandb: WandbOption = None,
    view: ViewOption = False,
    viewer_port: ViewerPortOption = None,
    record: RecordOption = None,
    record_every: RecordEveryOption = 50,
    clips: ClipsOption = 0,
    robot: TaskRobotOption = None,
    packages: PackagesOption = None,
    pieces: PiecesOption = None,
) -> None:
    """Train a policy for a task."""
    with ErrorExit():
        task = _task_of(named, task)
        if resume and source is not None:
            raise UsageError("a run that is resumed has networks of its own: leave out --from or --resume")
        if source is None and checkpoint != "best":
            raise UsageError("--checkpoint says which one of the run that --from names: name that, too")
        # Of FILE.py:CLASS the class names the folder, or else the file.
        out = out or Path("runs") / task.rpartition(":")[2].removesuffix(".py")
        typed = {"num_worlds": num_worlds, "total_steps": total_steps, "seed": seed}
        options = TrainOptions(
            out=out,
            engine=engine,
            resume=resume,
            source=source,
            checkpoint=checkpoint,
            config=config,
            given={key: value for key, value in typed.items() if value is not None},
            pairs=with_robot(settings, robot),
        )
        if print_config:
            typer.echo(config_text(task, options), nl=False)
            return
        shown = _Shown(serve, port, port_offset, view, viewer_port, record, record_every, wandb, quiet, clips)
        if trains_seeds(out, seeds, resume):
            check_alone(shown.views, processes)
            check_curriculum(options)
            run_seeds(task, options, seeds, quiet)
        else:
            _run_training(task, options, shown, processes)


@dataclass(frozen=True)
class _Shown:
    """Views of a training: the options of `train` of the same names."""

    serve: bool
    port: int
    port_offset: int
    view: bool
    viewer_port: int | None
    record: Path | None
    record_every: int
    wandb: str | None
    quiet: bool
    clips: int

    @property
    def views(self) -> dict[str, bool]:
        """Return whether each view is wanted, by option."""
        files = {"--record": self.record is not None, "--wandb": self.wandb is not None}
        return {"--serve": self.serve, "--view": self.view, "--clips": self.clips > 0, **files}


def _joined() -> bool:
    """Return whether this process is one of several that train together."""
    from usarmjx.train.learning.launch import process_info

    return process_info(os.environ) is not None


def _run_training(task: str, options: TrainOptions, shown: _Shown, processes: int) -> None:
    """Train in this process or start several, show it where the options say, and print the score."""
    from usarmjx.train.learning.launch import process_info, spawn

    if processes > 1 and not _joined():
        # The same words again: each process finds in the environment which one it is.
        raise typer.Exit(spawn(processes, [sys.executable, "-m", "usarmjx", *sys.argv[1:]]))
    joined, engine = process_info(os.environ), options.engine
    first = joined is None or joined.index == 0
    # The engine must be known before JAX is imported, and the record names it.
    recorded = options.resume and engine == "auto"
    announce(
        f"building worlds for {task} ...",
        aloud=first,
        engines=[recorded_engine(options.out) if recorded else tried_on(engine)],
    )
    # The child's ports open before this process imports JAX, for seconds.
    with _served(options.out, task, shown.port, shown.serve and first, shown.port_offset):
        _train_and_show(task, options, shown)


def _train_and_show(task: str, options: TrainOptions, shown: _Shown) -> None:
    """Train, after joining the other processes if there are any, and print the score."""
    from usarmjx.train.learning.processes import distributed_run

    with (
        distributed_run() as process,
        viewer_socket(HOST, shown.viewer_port, shown.port_offset, shown.view and process.index == 0) as page,
    ):
        watchers: list[_TrainingWatcher] = []
        if page is not None:
            watchers.append(_ShownTraining(page, f"{task}, in training"))
        if shown.record is not None and process.index == 0:
            watchers.append(_RecordedTraining(shown.record, shown.record_every))
        if shown.clips and process.index == 0:
            watchers.append(ClippedTraining(options.out, shown.clips, shown.wandb is not None))
        # In every process: each has worlds of its own.
        watchers.append(_RecordedFaults(options.out / "faults"))
        bar = not shown.quiet and not process.index
        with stop_request() as stop:
            # One run there, not one for each process.
            project = None if process.index else shown.wandb
            score, stopped = _train(task, options, watchers, project, bar, stop)
        # One of several processes is enough to say it.
        if process.index == 0:
            typer.echo(score)
        if stopped:
            say(f"go on with: usarmjx train {task} --out {options.out} --resume")
            # As shells report a process that a signal has ended.
            raise typer.Exit(128 + stop.number)


def config_text(task: str, options: TrainOptions) -> str:
    """Return the settings of a run and of its task as a file for `--config`."""
    plan = plan_run(task, options)
    return to_yaml(plan.config) + task_text(task, plan.overrides)


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
def _served(run: Path, task: str, port: int, wanted: bool, offset: int = 0) -> Generator[None]:
    """Serve a world of a run in a process of its own, on the CPU, until the training ends."""
    if not wanted:
        yield
        return
    from usarmjx.train.task_names import is_own

    # Only POSIX lets a child inherit the pipe by which it notices this process's end.
    if os.name == "nt":
        raise UsageError(f"train --serve needs POSIX: run `usarmjx play {run} --serve --follow` beside it")
    # A process, not a thread: Python would share its time between the training and the server.
    command = [sys.executable, "-m", "usarmjx", "play", str(run), "--serve", "--follow", "--port", str(port)]
    command += ["--port-offset", str(offset)] if offset else []
    if is_own(task):
        command += ["--task", task]
    with ExitStack() as waits, ParentPipe() as pipe:
        # On the CPU: the training has the GPU, and would lose memory to a second process.
        settings = {**os.environ, "JAX_PLATFORMS": "cpu", **pipe.settings}
        child = subprocess.Popen(command, env=settings, pass_fds=pipe.inherited)
        pipe.started()
        waits.callback(child.wait)  # behind the end of the pipe
        yield


def _train(
    task: str,
    options: TrainOptions,
    watchers: "Sequence[_TrainingWatcher]",
    project: str | None,
    bar: bool,
    stop: "StopRequest",
) -> tuple[str, bool]:
    """Train, in one of the processes, which must be joined already: some imports put arrays on the device.

    Args:
        task: Name of the task.
        options: The request.
        watchers: Viewers of the worlds.
        project: Of Weights & Biases; None: it is not shown there.
        bar: Show one.
        stop: Ends it early.

    Returns:
        The result in a line, and whether a signal ended it before its last iteration.
    """
    from usarmjx.train.learning.trainer import train as run
    from usarmjx.train.make import make

    plan, out = plan_run(task, options), options.out
    config, engine = plan.config, plan.origin.engine

    def worlds_of(count: int, first: int) -> "Env":
        env = make(task, worlds=count, engine=engine, seed=config.seed, first=first, **plan.overrides)
        # Before the first step: recordings need the worlds as they begin.
        for watcher in watchers:
            watcher.begin(env, config)
        return env

    # Keeping a rollout's worlds costs memory, so they are kept only for somebody.
    inspected = config.black_box or any(isinstance(one, ClippedTraining) for one in watchers)
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
            look=partial(_look, watchers),
            inspect=partial(_inspect, watchers) if inspected else None,
            stop=stop,
        )
    finally:
        # Also after a failure, so that files of watchers are complete up to it.
        for watcher in watchers:
            watcher.close()
    return result_line(done), done.stopped


def _look(watchers: "Sequence[_TrainingWatcher]", state: "EnvState") -> None:
    """Show all watchers the worlds as they are."""
    for watcher in watchers:
        watcher.look(state)


def _inspect(watchers: "Sequence[_TrainingWatcher]", inputs: "RolloutInputs") -> None:
    """Show all watchers what went into a rollout."""
    for watcher in watchers:
        watcher.inspect(inputs)


class _TrainingWatcher(Protocol):
    """Gets to see the worlds of a training."""

    def begin(self, env: "Env", config: "Config") -> None:
        """Take the training's worlds and its settings."""

    def look(self, state: "EnvState") -> None:
        """Look at the worlds as they are."""

    def inspect(self, inputs: "RolloutInputs") -> None:
        """Look at what went into a rollout."""

    def close(self) -> None:
        """The training is over."""


class _ShownTraining:
    """A training on the live page.

    Args:
        bound: Address of the page.
        title: Its name.
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

    def inspect(self, inputs: "RolloutInputs") -> None:
        """Ignore it."""

    def close(self) -> None:
        """Leave the page as it is: it goes with the process."""


class _RecordedFaults:
    """Worlds that go bad, recorded.

    Args:
        folder: For the recordings.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._box = folder, None

    def begin(self, env: "Env", config: "Config") -> None:
        """Take the training's worlds and its settings."""
        if config.black_box:
            from usarmjx.recording.episodes import BlackBox

            self._box = BlackBox(env, self._folder, config.black_box, say)

    def look(self, state: "EnvState") -> None:
        """Ignore it."""

    def inspect(self, inputs: "RolloutInputs") -> None:
        """Record the worlds that went bad."""
        if self._box is not None:
            self._box.inspect(inputs)

    def close(self) -> None:
        """Record those of the last rollout."""
        if self._box is not None:
            self._box.close()


class _RecordedTraining:
    """A training of which some iterations are recorded.

    Args:
        path: The file.
        every: Interval of recorded iterations.
    """

    def __init__(self, path: Path, every: int) -> None:
        self._path, self._every = path, every
        self._held = ExitStack()

    def begin(self, env: "Env", config: "Config") -> None:
        """Take the training's worlds and its settings."""
        from usarmjx.recording.episodes import TrainingRecorder, episode_file

        file = self._held.enter_context(episode_file(env, self._path))
        # Traceable worlds are seen once a rollout, others after each action.
        calls = 1 if env.traceable else config.rollout_length
        self._recorder = TrainingRecorder(env, file, self._every, calls)

    def look(self, state: "EnvState") -> None:
        """Keep the worlds as they are."""
        self._recorder.look(state)

    def inspect(self, inputs: "RolloutInputs") -> None:
        """Ignore it."""

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
            help="File: .npz, .onnx, folder .policy; of a recording .csv, .parquet, .gif, .mp4, .rosbag2.",
            show_default=False,
        ),
    ] = None,
    old_out: OldOutArgument = None,
    checkpoint: Annotated[str, typer.Option(help="best, last, or the number of an iteration.")] = "best",
    half: Annotated[bool, typer.Option("--half", help="Weights of 16 bits: half the size.")] = False,
    world: Annotated[int, typer.Option(min=0, help="Of a recording: which world films and bags show.")] = 0,
    speed: Annotated[
        float, typer.Option(min=0.01, help="Of a recording: speed of films, in real times.")
    ] = 2.0,
    pictures: PicturesOption = None,
) -> None:
    """Write a policy for NumPy or ONNX Runtime; or a recording as tables, film or ROS 2 bag."""
    with ErrorExit():
        where = chosen_out(out, old_out)
        # Otherwise the name would be looked up among the packaged policies.
        if not run.exists() and run.suffix.lower() == ".mcap":
            raise UsageError(f"{run}: cannot be read: No such file or directory")
        if not run.exists():
            check_policy(str(run))
        announce(f"reading {run} ...")
        if run.is_file():
            export_recording(run, where, world, speed, pictures)
            return
        from usarmjx.train.policies.export import export_run
        from usarmjx.train.policies.policy_file import size_of

        export_run(run, where, checkpoint, half)
        typer.echo(f"wrote {where}, {size_of(where) / 1024:.0f} KB")


@app.command()
def curves(
    sources: Annotated[
        list[Path], typer.Argument(help="Folders of runs, or files of benchmark records, one a line.")
    ],
    out: Annotated[
        Path, typer.Option(help="File to write, .png, .pdf, .svg or .eps; further figures have numbers.")
    ] = Path("curves.png"),
    over: Annotated[
        str, typer.Option(help="Draw scores over agent steps or over time: steps, time.")
    ] = "steps",
) -> None:
    """Draw scores of training runs over agent steps and over time, the last run of each seed.

    A figure has six tasks at most.
    """
    with ErrorExit():
        announce("drawing curves ...")
        from usarmjx.plots.training_plots import plot_curves

        for file in plot_curves(sources, out, over):
            typer.echo(f"wrote {file}")
