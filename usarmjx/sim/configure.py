"""Robots as ini files configure them, put in force for this process (manual 12.1.2, 14.4.2)."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from usarmjx.base.errors import SpecError, UsageError
from usarmjx.models.effecters import EFFECTERS
from usarmjx.models.ini.read import UU_PER_METRE
from usarmjx.models.ini.robots import LoadedRobots, load_robots
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.base import SENSORS
from usarmjx.sensors.payload import overload
from usarmjx.sensors.settings import CameraSettings
from usarmjx.sensors.suite import suite_of


def settings_by_kind() -> dict[str, type]:
    """Return the settings of every type of sensor, effecter and camera: dataclasses, by type."""
    items = [*SENSORS, *EFFECTERS]
    return {"Camera": CameraSettings} | {kind: item.settings_class for kind, item in items}


def configure(paths: Iterable[str | Path], uu_per_metre: float = UU_PER_METRE) -> LoadedRobots:
    """Load ini files and put the robot classes that they change or define into `ROBOTS`.

    Robots that are there already stay as they are; call it before the first scene or world.

    Args:
        paths: USARBot.ini and USARMisPkg.ini files; a later one overrides.
        uu_per_metre: Length of a metre in Unreal units.

    Returns:
        What was loaded, with a warning more for each robot that carries more than its payload, if it has a
        section or did not carry too much before.

    Raises:
        SpecError: A file or value that is wrong, or a robot that cannot be built; nothing has changed then.
    """
    paths = tuple(paths)
    loaded = load_robots(paths, ROBOTS, uu_per_metre, settings_by_kind())
    places, files = dict(loaded.source_lines), ", ".join(map(str, paths))
    warnings = list(loaded.warnings)
    for robot in loaded.robots:
        try:
            suite_of(robot)
        except UsageError as error:
            raise SpecError(f"{places.get(robot.name, files)}: robot {robot.name}: {error}") from error
        mine = robot.name in places or not (robot.name in ROBOTS and overload(ROBOTS.get(robot.name)))
        if mine and (problem := overload(robot)):
            warnings.append(f"{places.get(robot.name, files)}: {problem}")
    loaded.apply(ROBOTS)
    return replace(loaded, warnings=tuple(warnings))
