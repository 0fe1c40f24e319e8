"""The cases of all benchmarks: frozen dataclasses whose fields are the options of `usarmjx bench`.

Each option is spelt here once: name, type, limits, default and help. Nothing heavy is imported, because the
command line reads this module for its help.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.common import (
    ArenaOption,
    EngineOption,
    SeedOption,
    WorldsOption,
    named,
    named_roster,
    read_size,
)
from usarmjx.cli.known_names import check_name, check_roster, complete_tasks

if TYPE_CHECKING:
    from usarmjx.models.compile.physics import Physics

BASELINES = ("all", "cpu", "none")
"""Words for what is measured beside a case: both baselines, not bare MJX (which compiles), neither."""
CLASS_ARENA = "field"
"""Arena in which robots of each class are initialised; it has room for cars."""
StepsOption = Annotated[int, typer.Option(min=1, help="Control steps, scans or rounds of a repeat.")]
RepeatsOption = Annotated[int, typer.Option(min=1, help="Repeats; the median counts.")]
BaselinesOption = Annotated[
    str,
    typer.Option(help="Measured beside it: all, cpu (C MuJoCo on all cores, not bare MJX) or none."),
]
LimitOption = Annotated[float, typer.Option(min=1.0, help="Seconds after which a wait is given up.")]


def one_class(roster: str) -> tuple[str, int]:
    """Return the class of a roster's robots, and their number.

    Raises:
        UsageError: They are of several classes, or there are none.
    """
    from usarmjx.server.worlds.make import parse_roster

    names = parse_roster(roster)
    if len({*names}) != 1:
        raise UsageError(f"--roster: expected robots of one class, as P2AT:16; got {roster!r}")
    return names[0], len(names)


def without(case: Any, *names: str) -> dict[str, Any]:  # noqa: ANN401 - any dataclass
    """Return the fields of a case but for some, as a record has them."""
    return {name: value for name, value in asdict(case).items() if name not in names}


# Records


@dataclass(frozen=True, kw_only=True)
class RecordOptions:
    """The record of a measurement: its file, and a note for its readers."""

    note: Annotated[str, typer.Option(help="Remark for readers of the record.")] = ""
    json: Annotated[Path | None, typer.Option(help="Append the record to this file.")] = None


@dataclass(frozen=True, kw_only=True)
class BaselineOptions(RecordOptions):
    """A record that has baselines beside its rates."""

    baselines: BaselinesOption = "cpu"

    def check(self) -> None:
        """Refuse another word than those of `BASELINES`.

        Raises:
            UsageError: See above.
        """
        if self.baselines not in BASELINES:
            raise UsageError(f"--baselines: {self.baselines!r} is not one of {', '.join(BASELINES)}")


@dataclass(frozen=True, kw_only=True)
class AllBaselineOptions(BaselineOptions):
    """A record that has all baselines unless fewer are asked for."""

    baselines: BaselinesOption = "all"


# Parts of the simulation


@dataclass(frozen=True, kw_only=True)
class RadioCase:
    """`steps` evaluations of all links, `repeats` times."""

    worlds: WorldsOption = 64
    roster: Annotated[
        str,
        typer.Option(
            help="Robots in each; all pairs are evaluated, whatever their class.", callback=named_roster
        ),
    ] = "P2AT:16"
    walls: Annotated[int, typer.Option(min=1, help="Walls in each.")] = 100
    steps: StepsOption = 20
    repeats: RepeatsOption = 5
    seed: SeedOption = 0

    @property
    def robots(self) -> int:
        """Robots of a world.

        Raises:
            UsageError: Fewer than a link takes.
        """
        from usarmjx.server.worlds.make import parse_roster

        robots = len(parse_roster(self.roster))
        if robots < 2:
            raise UsageError(f"--roster: a link takes two robots; got {self.roster!r}")
        return robots

    def as_record(self) -> dict[str, Any]:
        """Return the case as a record has it."""
        return {**without(self, "roster"), "robots": self.robots}


@dataclass(frozen=True, kw_only=True)
class RayCase:
    """`steps` scans of every robot, `repeats` times."""

    worlds: WorldsOption = 4
    roster: Annotated[
        str,
        typer.Option(
            help="Robots in each, of a class with a range scanner; all of them scan.", callback=named_roster
        ),
    ] = "P2AT:16"
    walls: Annotated[int, typer.Option(min=1, help="Walls in each.")] = 100
    steps: StepsOption = 10
    repeats: RepeatsOption = 5
    seed: SeedOption = 0

    def as_record(self) -> dict[str, Any]:
        """Return the case as a record has it."""
        robot, robots = one_class(self.roster)
        return {**without(self, "roster"), "robot": robot, "robots": robots}


@dataclass(frozen=True, kw_only=True)
class CameraCase:
    """`steps` pictures of every robot's main camera, `repeats` times.

    With `peer` also those of MuJoCo Warp's own renderer, of the first robot's camera in each world.
    """

    worlds: WorldsOption = 16
    roster: Annotated[
        str, typer.Option(help="Robots in each, of one class; all of them look.", callback=named_roster)
    ] = "P2AT:1"
    arena: ArenaOption = "yellow"
    size: Annotated[str, typer.Option(help="Width and height of a picture, as 64x64.")] = "64x64"
    engine: EngineOption = "auto"
    steps: StepsOption = 5
    repeats: RepeatsOption = 5
    seed: SeedOption = 0
    peer: Annotated[bool, typer.Option("--peer", help="Measure MuJoCo Warp's renderer too.")] = False

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height of a picture."""
        from usarmjx.server.protocol.images import parse_size

        return parse_size(self.size)

    def as_record(self) -> dict[str, Any]:
        """Return the case as a record has it."""
        robot, robots = one_class(self.roster)
        width, height = self.pixels
        size = {"width": width, "height": height}
        return {**without(self, "roster", "size"), "robot": robot, "robots": robots, **size}


# Whole steps


@dataclass(frozen=True, kw_only=True)
class PhysicsOptions:
    """A solver and a timestep in place of those of the physics that a case names."""

    solver: Annotated[
        str | None, typer.Option(help="Solver in place of that of --physics: CG, Newton, block (warp).")
    ] = None
    timestep: Annotated[
        float | None, typer.Option(min=1e-4, help="Physics step in place of that of --physics [s].")
    ] = None

    def replaced(self, physics: "Physics") -> "Physics":
        """Return the settings with the solver and the timestep of the case, as far as it has them.

        The control step stays as long as it is.

        Raises:
            SpecError: No such solver.
        """
        physics = replace(physics, solver=self.solver or physics.solver)
        if self.timestep is None:
            return physics
        return replace(physics, timestep=self.timestep, substeps=round(physics.period / self.timestep))


@dataclass(frozen=True, kw_only=True)
class SceneOptions(PhysicsOptions):
    """A scene and its engine.

    Without `substeps`, control steps take 50 ms.

    With `generated` arenas, `arena` is the kind that is generated, and resets draw others of them. With 1 all
    worlds share one: the one with the most loose objects, and then solids, of a sample, for a fair
    comparison, as a batch of many has room for the most of everything. They have `size` cells, or, if that is
    None, those of `scenes.cells_for`; and a start pose for each robot.
    """

    roster: Annotated[str, typer.Option(help="Robots of each world, as P2AT:4,Zerg:2.")] = "P2AT:4"
    arena: Annotated[str, typer.Option(help="Arena name, or with --generated the kind.")] = "yellow"
    generated: Annotated[
        int, typer.Option(min=0, help="Number of generated arenas, which the worlds have in turn.")
    ] = 0
    size: Annotated[
        str | None,
        typer.Option(
            help="Cells of a generated arena, as 12x8; else 8x6, or 3 for each robot of a larger team."
        ),
    ] = None
    engine: EngineOption = "auto"
    radio: Annotated[bool, typer.Option("--radio", help="Evaluate all radio links too.")] = False
    physics: Annotated[
        str,
        typer.Option(help="Settings of the physics: reference, fast, sleeping (warp), coarse (planar)."),
    ] = "reference"
    substeps: Annotated[
        int | None, typer.Option(min=1, help="Physics steps per control step; else those of 50 ms.")
    ] = None
    seed: SeedOption = 0

    @property
    def cells(self) -> tuple[int, int] | None:
        """Columns and rows of a generated arena; None: those of `scenes.cells_for`.

        Raises:
            UsageError: The size is not of the form 12x8.
        """
        return read_size(self.size) if self.size else None

    def check_names(self, ini: Iterable[Path] | None = None) -> None:
        """Refuse an arena, a kind of arena or a robot that there is not; robots may be those of ini files.

        Raises:
            UnknownNameError: Gives the closest name and all.
        """
        check_name("kind of arena" if self.generated else "arena", self.arena)
        check_roster(self.roster, ini)

    def as_record(self) -> dict[str, Any]:
        """Return the case as a record has it."""
        return {**asdict(self), "size": self.cells}


@dataclass(frozen=True, kw_only=True)
class SceneCase(SceneOptions):
    """Worlds of a scene."""

    worlds: WorldsOption = 4


@dataclass(frozen=True, kw_only=True)
class StepCase(SceneCase):
    """`steps` control steps of `substeps` physics steps, `repeats` times.

    With `profile` the kernels of another repeat, which is not in the rates, are reported.
    """

    steps: StepsOption = 20
    repeats: RepeatsOption = 5
    graph: Annotated[
        str,
        typer.Option(
            help="CUDA graphs of engine warp: step or control, one for each; with -staged or -staged-ex, one "
            "for all arrays, which are copied in it or around it."
        ),
    ] = "step"
    profile: Annotated[
        bool, typer.Option("--profile", help="Tell which kernels a repeat of the whole step more takes.")
    ] = False


@dataclass(frozen=True, kw_only=True)
class CompileCase(SceneCase):
    """The first step of a scene, `repeats` times cold and cached."""

    repeats: Annotated[int, typer.Option(min=1, help="Pairs of processes, cold and cached.")] = 1
    limit: LimitOption = 1800.0

    @property
    def scene(self) -> dict[str, Any]:
        """The fields of its `SceneCase`, for another process."""
        return {one.name: getattr(self, one.name) for one in fields(SceneCase)}


@dataclass(frozen=True, kw_only=True)
class MemoryCase(SceneOptions):
    """Batches of several numbers of worlds of a scene."""

    counts: Annotated[
        list[int], typer.Option("--worlds", min=1, help="Worlds in the batch; may be repeated.")
    ] = field(default_factory=lambda: [1, 16])
    compile: Annotated[
        bool,
        typer.Option(
            "--compiled/--not-compiled", help="Compile a step too, for its memory beside the state."
        ),
    ] = True

    def scene_case(self, worlds: int) -> SceneCase:
        """Return the case of one number of worlds."""
        return SceneCase(worlds=worlds, **{one.name: getattr(self, one.name) for one in fields(SceneOptions)})


# Servers


@dataclass(frozen=True, kw_only=True)
class ViewerCase:
    """Updates of the live page, and the pace of a server with a page open and without.

    Attributes:
        served: 0: no server is measured.
        seconds: [s]
    """

    rosters: Annotated[
        list[str],
        typer.Option(
            "--roster",
            help="Robots whose updates are measured, as P2AT:16; may be repeated, with one class.",
            callback=named_roster,
        ),
    ] = field(default_factory=lambda: ["P2AT:1", "P2AT:16"])
    updates: Annotated[int, typer.Option(min=1, help="Updates of the page for each number.")] = 100
    served: Annotated[
        int, typer.Option(min=0, help="Robots of a server, whose pace is measured with a page and without.")
    ] = 16
    seconds: Annotated[float, typer.Option(min=0.5, help="Length of one look at that server.")] = 5.0
    windows: Annotated[int, typer.Option(min=1, help="Number of looks.")] = 3
    limit: LimitOption = 120.0

    @property
    def robots(self) -> list[int]:
        """Numbers of robots whose updates are measured."""
        return [one_class(one)[1] for one in self.rosters]

    @property
    def robot(self) -> str:
        """Class of the robots.

        Raises:
            UsageError: They are of several.
        """
        classes = {one_class(one)[0] for one in self.rosters}
        if len(classes) > 1:
            raise UsageError(f"--roster: robots of one class are measured; got {', '.join(self.rosters)}")
        return classes.pop()

    def as_record(self) -> dict[str, Any]:
        """Return the case as a record has it."""
        return {**without(self, "rosters"), "robot": self.robot, "robots": self.robots}


@dataclass(frozen=True, kw_only=True)
class ServeCase:
    """Waits of clients of a server, and the cost of robots.

    Attributes:
        classes: The first one watches the others.
        rosters: Only their numbers of robots count; more than the arena has start poses are in a hall.
        seconds: [s]
    """

    parts: Annotated[list[str], typer.Option("--part", help="Only this part; may be repeated.")] = field(
        default_factory=lambda: ["start", "init", "gaps", "load", "pictures"]
    )
    arena: ArenaOption = "yellow"
    classes: Annotated[
        list[str],
        typer.Option("--robot", help="Class whose INIT is timed; may be repeated.", callback=named("robot")),
    ] = field(default_factory=lambda: ["P2AT", "P2DX", "AirRobot", "Hummer", "Talon"])
    rosters: Annotated[
        list[str],
        typer.Option(
            "--roster",
            help="Robots whose load is measured: only the number counts, P2AT and P2DX in turn; may be "
            "repeated.",
            callback=named_roster,
        ),
    ] = field(default_factory=lambda: [f"P2AT:{count}" for count in (1, 4, 16, 64)])
    joining: Annotated[int, typer.Option(min=1, help="Number of clients that join, leave and talk.")] = 15
    engine: EngineOption = "c"
    seconds: Annotated[float, typer.Option(min=0.5, help="Length of one look at a load.")] = 5.0
    windows: Annotated[int, typer.Option(min=1, help="Number of looks.")] = 3
    repeats: Annotated[int, typer.Option(min=1, help="Servers started for each other figure.")] = 3
    limit: LimitOption = 120.0

    @property
    def robots(self) -> list[int]:
        """Numbers of robots whose load is measured."""
        from usarmjx.server.worlds.make import parse_roster

        return [len(parse_roster(one)) for one in self.rosters]

    def as_record(self) -> dict[str, Any]:
        """Return the case as a record has it."""
        return {**without(self, "rosters"), "robots": self.robots, "class_arena": CLASS_ARENA}


# Trainings, manoeuvres and other simulators


@dataclass(frozen=True, kw_only=True)
class TrainCase:
    """A training.

    Attributes:
        task: None: runs that were trained before are recorded.
        worlds: None: those of the task.
    """

    task: Annotated[
        str | None,
        typer.Option(
            help="Train this task here instead, and forget it.",
            autocompletion=complete_tasks,
            callback=named("task"),
        ),
    ] = None
    worlds: Annotated[int | None, typer.Option(min=1, help="With --task: worlds in the batch.")] = None
    steps: Annotated[int, typer.Option(min=1, help="With --task: agent steps.")] = 200_000
    engine: EngineOption = "auto"
    settings: Annotated[
        list[str],
        typer.Option("--set", "-c", help="With --task: a setting, key=value; may be repeated."),
    ] = field(default_factory=list)
    seed: SeedOption = 0

    def words(self, out: Path) -> list[str]:
        """Return the command line of the training."""
        words = ["train", str(self.task), "--out", str(out), "--steps", str(self.steps), "--quiet"]
        words += ["--engine", self.engine, "--seed", str(self.seed)]
        words += [] if self.worlds is None else ["--worlds", str(self.worlds)]
        return [*words, *(word for setting in self.settings for word in ("--set", setting))]


@dataclass(frozen=True, kw_only=True)
class ScorecardCase(PhysicsOptions):
    """Manoeuvres of robots under two settings of the physics, or on two engines."""

    robot: Annotated[
        list[str],
        typer.Option(help="Class that is driven; may be repeated. Else all.", callback=named("robot")),
    ] = field(default_factory=list)
    physics: Annotated[str, typer.Option(help="Settings beside the reference's.")] = "fast"
    engine: Annotated[
        str,
        typer.Option(
            help="Engine that applies them; the reference is on c. Others than c show every number.",
            callback=named("engine"),
        ),
    ] = "c"
    jobs: Annotated[int, typer.Option(min=1, help="Processes at once.")] = 1


@dataclass(frozen=True, kw_only=True)
class ContestCase:
    """Other simulators and ours, in turn."""

    size: Annotated[
        list[str], typer.Option(help="Worlds and robots in each, as 4096x16; may be repeated.")
    ] = field(default_factory=lambda: ["64x4"])
    peers: Annotated[
        list[str], typer.Option("--peer", help="Folder of a peer; may be repeated. Else all there are.")
    ] = field(default_factory=list)
    engines: Annotated[
        list[str],
        typer.Option("--engine", help="Engine of ours; may be repeated.", callback=named("engine")),
    ] = field(default_factory=lambda: ["auto", "planar"])
    variants: Annotated[
        list[str],
        typer.Option(
            "--variant",
            help="Only this of a peer or of ours, as jaxnav, navigation, whole, blind or bare; "
            "may be repeated. Else all.",
        ),
    ] = field(default_factory=list)
    arena: ArenaOption = "yellow"
    steps: StepsOption = 20
    repeats: RepeatsOption = 3
    limit: LimitOption = 900.0
    seed: SeedOption = 0

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """Worlds, and robots in each.

        Raises:
            UsageError: A size is not of the form 4096x16.
        """
        return [parse_worlds(text) for text in self.size]

    def as_record(self) -> dict[str, Any]:
        """Return the case as a record has it."""
        return {**without(self, "size"), "sizes": self.sizes}


def parse_worlds(text: str) -> tuple[int, int]:
    """Return worlds and robots in each, which are written as `4096x16`.

    Raises:
        UsageError: The text is not of that form.
    """
    worlds, cross, robots = text.partition("x")
    if not (cross and worlds.isdecimal() and robots.isdecimal() and int(worlds) and int(robots)):
        raise UsageError(f"--size: {text!r} is not WORLDSxROBOTS, as 4096x16")
    return int(worlds), int(robots)


@dataclass(frozen=True, kw_only=True)
class PeerFolders:
    """Folders of other simulators and of their environments."""

    folder: Annotated[Path, typer.Option(help="Folder of the peers.")] = Path("benchmarks/peers")
    environments: Annotated[
        Path, typer.Option(help="Folder of the peers' environments; missing ones are made there.")
    ] = Path("build/peers")
    install: Annotated[
        bool, typer.Option("--install/--no-install", help="Make environments that are not there.")
    ] = True
