"""Robots as ini files configure them, put in force for this process (manual 12.1.2, 14.4.2)."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from usarmjx.base.errors import SpecError, UsageError
from usarmjx.base.registry import Registry
from usarmjx.models.effecters import EFFECTERS
from usarmjx.models.ini.parse import UU_PER_METRE, IniFile
from usarmjx.models.ini.robots import LoadedRobots, build_robots, read_files
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.base import SENSORS
from usarmjx.sensors.payload import overload
from usarmjx.sensors.settings import CameraSettings
from usarmjx.sensors.suite import suite_of


def settings_by_kind() -> dict[str, type]:
    """Return the settings of every type of sensor, effecter and camera: dataclasses, by type."""
    items = [*SENSORS, *EFFECTERS]
    return {"Camera": CameraSettings} | {kind: item.settings_class for kind, item in items}


@dataclass
class FilesInForce:
    """The ini files that are in force, so that further ones come after them as if read together.

    Attributes:
        files: All of them, in order.
        robots: The robots that were there when the last one came, as they are with the files, by name.
        originals: Those of them that the files change, as they would be without; None: there would be none.
        warnings: What has been told about the files.
    """

    files: tuple[IniFile, ...] = ()
    robots: Mapping[str, RobotSpec] = field(default_factory=dict[str, RobotSpec])
    originals: Mapping[str, RobotSpec | None] = field(default_factory=dict[str, RobotSpec | None])
    warnings: frozenset[str] = frozenset()

    def hold_in(self, robots: Registry[RobotSpec]) -> bool:
        """Whether nobody has replaced one of the robots since."""
        return all(name in robots and robots.get(name) is robot for name, robot in self.robots.items())

    def without(self, robots: Registry[RobotSpec]) -> Registry[RobotSpec]:
        """Return the robots as they would be without the files."""
        others = robots.copy()
        for name, robot in self.originals.items():
            if robot is None:
                others.discard(name)
            else:
                others.replace(name, robot)
        return others


_in_force = [FilesInForce()]


def configure(paths: Iterable[str | Path], uu_per_metre: float = UU_PER_METRE) -> LoadedRobots:
    """Load ini files and put the robot classes that they change or define into `ROBOTS`.

    Robots that are there already stay as they are; call it before the first scene or world. A second call's
    files come after those of the first, as if all were read together, unless another has replaced one of the
    robots in `ROBOTS` since: then they come on top of what is there.

    Args:
        paths: USARBot.ini and USARMisPkg.ini files; a later one overrides.
        uu_per_metre: Length of a metre in Unreal units.

    Returns:
        What was loaded, with a warning more for each robot that carries more than its payload, if it has a
        section or did not carry too much before.

    Raises:
        SpecError: A file or value that is wrong, or a robot that cannot be built; nothing has changed then.
    """
    before = _in_force[0] if _in_force[0].hold_in(ROBOTS) else FilesInForce()
    stock, files = before.without(ROBOTS), (*before.files, *read_files(paths, uu_per_metre))
    loaded = build_robots(files, stock, settings_by_kind())
    warnings = [*loaded.warnings, *_check(loaded, stock, ", ".join(file.path for file in files))]
    new = {robot.name.lower(): robot for robot in loaded.robots}
    again = (robot for name, robot in before.originals.items() if robot is not None and name not in new)
    told = tuple(robot for robot in (*loaded.robots, *again) if ROBOTS.find(robot.name) != robot)
    fresh = tuple(text for text in warnings if text not in before.warnings)
    loaded = replace(loaded, robots=told, warnings=fresh)
    loaded.apply(ROBOTS)
    _in_force[0] = FilesInForce(
        files=files,
        robots=dict(ROBOTS),
        originals={name: stock.find(name) for name in new},
        warnings=before.warnings | frozenset(warnings),
    )
    return loaded


def _check(loaded: LoadedRobots, stock: Registry[RobotSpec], files: str) -> list[str]:
    """Return warnings about robots that carry too much.

    Raises:
        SpecError: A robot whose sensors cannot be built.
    """
    places, warnings = dict(loaded.source_lines), list[str]()
    for robot in loaded.robots:
        try:
            suite_of(robot)
        except UsageError as error:
            raise SpecError(f"{places.get(robot.name, files)}: robot {robot.name}: {error}") from error
        mine = robot.name in places or not (robot.name in stock and overload(stock.get(robot.name)))
        if mine and (problem := overload(robot)):
            warnings.append(f"{places.get(robot.name, files)}: {problem}")
    return warnings
