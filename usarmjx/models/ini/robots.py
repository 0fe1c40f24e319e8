"""Robots from USARBot.ini and USARMisPkg.ini (manual 12.1.2, 14.4.2): classes changed, and classes made anew.

Files are read in order; of a key that stands several times the last counts. A list (Sensors, Effecters,
Cameras, MisPkgs, JointParts, Wheels) of one file replaces what the class had or an earlier file gave it, as
Unreal's arrays do; AddSensors, AddEffecters, AddCameras and AddMisPkgs (ours) add to it instead.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from usarmjx.base.errors import SpecError, UsageError
from usarmjx.base.registry import Registry
from usarmjx.models.ini.classes import read_classes
from usarmjx.models.ini.items import Settings, WarningLog, examples, with_defaults
from usarmjx.models.ini.packages import known_packages, read_packages, redefine
from usarmjx.models.ini.parse import IniFile, read_ini
from usarmjx.models.ini.read import UU_PER_METRE, as_class, fail
from usarmjx.models.ini.sort import sort_sections
from usarmjx.models.ini.spec import BuildContext, RobotSection, build_robot
from usarmjx.models.ini.tracks import read_tracks
from usarmjx.models.spec.robot import Options, RobotSpec

MOST_BASES = 32
"""Classes of a file that are based on each other in a row."""


@dataclass(frozen=True)
class LoadedRobots:
    """What ini files say, ready to be put in force.

    Attributes:
        robots: Robot classes that they change or define.
        defaults: Defaults of item classes: type and options.
        warnings: Unknown keys, and known ones that change nothing and why, each with file and line.
        source_lines: Where each robot class of a section is first told of: name, file and line.
    """

    robots: tuple[RobotSpec, ...] = ()
    defaults: tuple[tuple[str, Options], ...] = ()
    warnings: tuple[str, ...] = ()
    source_lines: tuple[tuple[str, str], ...] = ()

    def apply(self, robots: Registry[RobotSpec]) -> None:
        """Put the robot classes into a registry, in place of those of the same name."""
        for robot in self.robots:
            robots.replace(robot.name, robot)


def load_robots(
    paths: Iterable[str | Path],
    robots: Registry[RobotSpec],
    uu_per_metre: float = UU_PER_METRE,
    settings: Settings | None = None,
) -> LoadedRobots:
    """Read ini files; nothing is changed by that.

    Args:
        paths: USARBot.ini and USARMisPkg.ini files, in any order; a later one overrides.
        robots: The robot classes there are, and whose wheels and packages new ones may use.
        uu_per_metre: Length of a metre in Unreal units; 52.5 reads the excerpt of manual 12.1.2.
        settings: What each type of item can be set to, as `usarmjx.sim.configure.settings_by_kind` gives it;
            None takes any key, which then fails where the robot's sensors are built.

    Raises:
        SpecError: A file that does not read, a value that is wrong, or a robot that cannot be built; the
            message names file and line, what was wrong and what is allowed.
        UsageError: A scale that is not above 0.
    """
    return build_robots(read_files(paths, uu_per_metre), robots, settings)


def read_files(paths: Iterable[str | Path], uu_per_metre: float = UU_PER_METRE) -> tuple[IniFile, ...]:
    """Read ini files whose Unreal units have that scale.

    Raises:
        SpecError: A file that does not read; names file and line.
        UsageError: A scale that is not above 0.
    """
    if not uu_per_metre > 0:
        raise UsageError(f"Unreal units per metre are {uu_per_metre:g}, expected a number above 0")
    return tuple(replace(read_ini(Path(path)), uu_per_metre=uu_per_metre) for path in paths)


def build_robots(
    files: Sequence[IniFile], robots: Registry[RobotSpec], settings: Settings | None = None
) -> LoadedRobots:
    """Return what ini files say of the robot classes that there are; see `load_robots`."""
    notes = WarningLog()
    definitions = read_packages(files, notes)
    classes = read_classes(files, robots.names(), settings, notes)
    found = sort_sections(files, robots, settings, notes, classes)
    sources = BuildContext(
        robots=robots,
        definitions=definitions,
        packages=known_packages(robots, definitions),
        settings=settings,
        warnings=notes,
        classes=classes,
    )
    builder = _Builder(found.robots, sources)
    built = {name: builder.build(name) for name in found.robots}
    for name, counts in found.tracks.items():
        before = built.get(name.lower()) or robots.get(name)
        built[name.lower()] = read_tracks(before, counts)
    kept: dict[tuple[str, str], list[str]] = {}
    changed = []
    for name in dict.fromkeys([*(name.lower() for name in robots.names()), *built]):
        before = robots.get(name) if name in robots else None
        robot = built.get(name) or _with_packages(robots.get(name), sources)
        robot = with_defaults(robot, found.defaults, kept)
        if robot != before:
            changed.append(robot)
    for (kind, key), items in kept.items():
        notes.add(found.lines[kind, key], f"{key} leaves alone what has its own: {examples(items)}")
    places = tuple((built[key].name, orders.where) for key, orders in found.robots.items())
    return LoadedRobots(tuple(changed), tuple(found.defaults.items()), tuple(notes.texts), places)


def _with_packages(robot: RobotSpec, sources: BuildContext) -> RobotSpec:
    packages = tuple(redefine(package, sources.definitions) for package in robot.packages)
    return replace(robot, packages=packages)


class _Builder:
    """Builds the classes that have a section, bases first, each once.

    Args:
        orders: What each is told, by its name in lower case.
        sources: What to build from.
    """

    def __init__(self, orders: Mapping[str, RobotSection], sources: BuildContext) -> None:
        self.orders, self.sources = orders, sources
        self.built: dict[str, RobotSpec] = {}

    def build(self, name: str, waiting: tuple[str, ...] = ()) -> RobotSpec:
        """Return a class by its name in lower case; `waiting` are those that are based on it."""
        if name not in self.built:
            order = self.orders[name]
            base = self._base(order, (*waiting, name))
            self.built[name] = build_robot(order, base, self.sources)
        return self.built[name]

    def _base(self, order: RobotSection, waiting: tuple[str, ...]) -> RobotSpec | None:
        """Return the class as it was, or the one a new class is based on; None for one made of parts."""
        robots, line = self.sources.robots, order.figures.get("baseclass")
        if order.name in robots and line is not None:
            fail(line, f"{order.name} exists already", "BaseClass in a new class' section only")
        if order.name in robots:
            return _with_packages(robots.get(order.name), self.sources)
        known = ", ".join(robots.names())
        if line is not None:
            name = as_class(line, line.value, "BaseClass")
            if name.lower() in waiting:
                fail(line, f"{name} is based on itself", "another class")
            if len(waiting) > MOST_BASES:
                fail(line, f"{name} is the base of {len(waiting)} classes in a row", f"at most {MOST_BASES}")
            if name.lower() in self.orders:
                return self.build(name.lower(), waiting)
            if name not in robots:
                fail(line, f"unknown BaseClass {name!r}", f"one of {known}, or an item class")
            return _with_packages(robots.get(name), self.sources)
        if not order.joints:
            raise SpecError(
                f"{order.where}: [USARBot.{order.name}] is neither a robot nor an item class; a new robot "
                f"needs JointParts or a BaseClass; expected one of {known}, or an item class"
            )
        return None
