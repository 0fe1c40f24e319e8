"""How a robot class answers its motors: the figures of `planar`, measured on engine `c`."""

import hashlib
import json
import math
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import mujoco

from usarmjx.base.compilation import cache_folder
from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.base.markdown import markdown_table
from usarmjx.models.compile.compose import add_robot
from usarmjx.models.compile.parts import parts_of
from usarmjx.models.drives.ackermann import Ackermann
from usarmjx.models.drives.base import Drive
from usarmjx.models.drives.ground import NoDrive, OmniDrive, SkidSteer
from usarmjx.models.types.robot import RobotSpec

FILE = "responses.json"


@dataclass(frozen=True, kw_only=True)
class Response:
    """How a class that rolls answers the speeds of its wheels.

    Attributes:
        gain: Forward speed over what the wheels' rims do.
        turn_gain: Rate of turn over what the wheels' rims do, were they as far apart as in the description.
        forward_lag: The speed follows the wheels' with such a time constant [s].
        turn_lag: So does the rate of turn [s].
        acceleration: Most of it [m/s^2].
        turn_acceleration: Most change of the rate of turn [rad/s^2].
        cornering: Most sideways acceleration in a bend [m/s^2]: what is faster turns less.
        drift: Sideways speed over forward speed times rate of turn, to the outside [s].
        sides_apart: Whether the motors of each side go after its speed by themselves, up to their most, so
            that a robot that is to speed up and to turn does the one before the other; else both in step.
    """

    gain: float = 1.0
    turn_gain: float = 1.0
    forward_lag: float = 0.02
    turn_lag: float = 0.02
    acceleration: float = 5.0
    turn_acceleration: float = 20.0
    cornering: float = 8.0
    drift: float = 0.0
    sides_apart: bool = False


NAMES = tuple(field.name for field in fields(Response) if field.name != "sides_apart")
"""The figures that are numbers."""


@cache
def description_key(robot: RobotSpec) -> str:
    """Return what changes when the robot's physics does: of that robot a response was measured."""
    spec = mujoco.MjSpec()
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    spec.compile()
    motors = [part.motor for part in parts_of(robot)]
    words = f"{robot.drive!r}\n{motors!r}\n{spec.to_xml()}"
    return hashlib.sha256(words.encode()).hexdigest()[:16]


@cache
def measured() -> dict[str, Any]:
    """Return the shipped measurements: by class its key, its response and what remains unexplained."""
    return json.loads(resources.files("usarmjx.engines.planar").joinpath(FILE).read_text(encoding="utf-8"))


def rolls(drive: Drive) -> bool:
    """Whether a drive moves its robot by wheels or tracks."""
    return isinstance(drive, SkidSteer | Ackermann | OmniDrive)


class UncalibratedRobotError(UnsupportedFeatureError):
    """A scene for engine `planar` with robots of which no response was measured.

    Args:
        robots: The robots.
    """

    def __init__(self, robots: Iterable[RobotSpec]) -> None:
        self.robots = tuple(robots)
        names = ", ".join(robot.name for robot in self.robots)
        super().__init__(
            f"engine 'planar' cannot run this scene: no motor response of {names} was measured; "
            "usarmjx.sim.ensure_calibrated(scene) measures it"
        )


def response_file(robot: RobotSpec, folder: Path | None = None) -> Path | None:
    """Return the file with the measured response of a robot that is not packaged; None: the cache is off.

    Args:
        robot: The robot.
        folder: Cache folder; None: this user's.
    """
    cache = cache_folder(os.environ) if folder is None else folder
    return None if cache is None else cache / "planar" / f"{robot.name}-{description_key(robot)}.json"


def known_response(robot: RobotSpec, folder: Path | None = None) -> Response | None:
    """Return the response of a class that rolls, if it was measured with the present description.

    Args:
        robot: The robot.
        folder: Cache folder with responses of earlier runs; None: this user's.
    """
    if robot in _own:
        return _own[robot]
    entry = measured().get(robot.name)
    if entry is not None and entry["key"] == description_key(robot):
        return Response(**entry["response"])
    file = response_file(robot, folder)
    if file is None or not file.is_file():
        return None
    use_response(robot, Response(**json.loads(file.read_text(encoding="utf-8"))["response"]))
    return _own[robot]


def uncalibrated(robots: Iterable[RobotSpec], folder: Path | None = None) -> tuple[RobotSpec, ...]:
    """Return the robots that roll and whose response was not measured, each once; see `known_response`."""
    return tuple(
        robot
        for robot in dict.fromkeys(robots)
        if rolls(robot.drive) and known_response(robot, folder) is None
    )


def response_of(robot: RobotSpec) -> Response:
    """Return the response of a class that rolls.

    Raises:
        UncalibratedRobotError: It was not measured.
    """
    response = known_response(robot)
    if response is None:
        raise UncalibratedRobotError([robot])
    return response


_own: dict[RobotSpec, Response] = {}


def use_response(robot: RobotSpec, response: Response) -> None:
    """Let a class answer so in engines that are built from now on in this process."""
    _own[robot] = response


def check_robot(robot: RobotSpec) -> None:
    """Refuse what `planar` cannot move.

    Raises:
        UnsupportedFeatureError: Names it.
    """
    drive = robot.drive
    if isinstance(drive, NoDrive) and robot.parts:
        raise UnsupportedFeatureError(
            f"engine 'planar' cannot run this scene: {robot.name} walks on legs; engines c, jax and warp can"
        )
    if not (rolls(drive) or drive.applies_wrench or isinstance(drive, NoDrive)):
        raise UnsupportedFeatureError(
            f"engine 'planar' cannot run this scene: {robot.name} is driven by {type(drive).__name__}, known "
            "are skid steering, tracks, Ackermann and omnidirectional wheels, and what flies or dives"
        )


def as_entry(robot: RobotSpec, response: Response, **more: Any) -> dict[str, Any]:  # noqa: ANN401 - JSON
    """Return what the file of measurements has of a class."""
    return {"key": description_key(robot), "response": asdict(response), **more}


def error_table() -> str:
    """Return how far off the shipped figures leave each class, as a table in Markdown."""
    horizons = list(next(iter(measured().values()))["errors"])

    def told(error: dict[str, float]) -> str:
        return f"{error['distance']:.2f} m, {math.degrees(error['heading']):.0f}° of {error['way']:.1f} m"

    rows = (
        [name, *(told(entry["errors"][horizon]) for horizon in horizons)]
        for name, entry in sorted(measured().items(), key=lambda item: item[0].lower())
    )
    return markdown_table(["class", *(f"after {horizon}" for horizon in horizons)], rows)
