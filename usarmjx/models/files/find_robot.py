"""Robots by name, or from the file that a name is."""

import logging
from pathlib import Path

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.registry import unknown_name
from usarmjx.models.files.resources import Resources, mesh_pieces, search_path
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import RobotSpec

logger = logging.getLogger(__name__)

ROBOT_SUFFIXES = (".urdf", ".xacro", ".sdf", ".xml", ".mjcf")
"""Suffixes of robots' files."""
_loaded: dict[tuple[object, ...], RobotSpec] = {}


def find_robot(robot: str | RobotSpec) -> RobotSpec:
    """Return a registered robot class by its name, or the one in a file; a `RobotSpec` is itself.

    Another name is that of a file without its suffix in the folders of `--packages`, ROS and Gazebo. A robot
    from a file is registered under its class name. Names that come over a network are not for this function:
    it reads files.

    Raises:
        UnknownNameError: Neither a known name nor that of a file.
        SpecError: An unreadable file.
        UsageError: A file whose robot has the name of another robot.
    """
    if isinstance(robot, RobotSpec):
        return robot
    if robot in ROBOTS:
        return ROBOTS.get(robot)
    path = Path(robot)
    if path.suffix.lower() in ROBOT_SUFFIXES or path.is_file():
        return register_robot_file(path)
    # Only a bare name is searched: a path means one file.
    found = Resources().named(robot, ROBOT_SUFFIXES) if path.name == robot else None
    if found is not None:
        return register_robot_file(found)
    refusal = unknown_name("robot", robot, ROBOTS.names())
    raise UnknownNameError(f"{refusal}; or a file: {', '.join(ROBOT_SUFFIXES)}")


def register_robot_file(path: Path) -> RobotSpec:
    """Return the robot in a file, and register it; what is left out is logged as warnings.

    Args:
        path: The file.

    Raises:
        UnknownNameError: There is no such file.
        SpecError: An unreadable file.
        UsageError: Its robot has the name of another robot.
    """
    # Imported here: the readers of all formats are slow to import, and registered robots need none of them.
    from usarmjx.models.files.robot_file import load_robot

    check_robot_file(path)
    # The robot depends on all of these: the file and the folders of its parts may change.
    key = path.resolve(), path.stat().st_mtime_ns, search_path(), mesh_pieces()
    # The registry may have another robot of that name by now, from another file.
    known = _loaded.get(key)
    if known is not None and ROBOTS.find(known.name) is known:
        return known
    loaded = load_robot(path)
    robot, before = loaded.robot, ROBOTS.find(loaded.robot.name)
    # A file may replace the robot of another file, but never one of usarmjx's own.
    if before is not None and before != robot and before not in _loaded.values():
        raise UsageError(
            f"{path}: its robot is called {robot.name}, as one of usarmjx's; rename it in the file"
        )
    for note in loaded.notes:
        logger.warning("%s", note)
    # Not `add`, which refuses a name that is in use: a changed file is loaded again under its name.
    ROBOTS.replace(robot.name, robot)
    _loaded[key] = robot
    return robot


def check_robot_file(path: Path) -> None:
    """Refuse a name that is no file.

    Raises:
        UnknownNameError: There is no such file.
    """
    if not path.is_file():
        raise UnknownNameError(f"{path}: there is no such file")
