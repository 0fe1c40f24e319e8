"""Robots of ini files that tests have as text."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from usarmjx.base.registry import Registry
from usarmjx.models.ini.robots import LoadedRobots, load_robots
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.configure import settings_by_kind

SETTINGS = settings_by_kind()


def load_texts(
    folder: Path, texts: Sequence[str], stock: Iterable[RobotSpec], scale=250.0, settings=SETTINGS
) -> LoadedRobots:
    """Load texts as the files a.ini, b.ini and c.ini of a folder, on a registry of some robots."""
    paths: list[Path] = []
    for letter, text in zip("abc", texts, strict=False):
        paths.append(folder / f"{letter}.ini")
        paths[-1].write_text(text)
    robots: Registry[RobotSpec] = Registry("robot")
    for robot in stock:
        robots.add(robot.name, robot)
    return load_robots(paths, robots, scale, settings)
