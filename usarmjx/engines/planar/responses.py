"""Drive responses of robot classes: parameters of `planar`, measured on engine `c`."""

import hashlib
import json
import logging
import math
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import mujoco

from usarmjx.base.compilation import own_cache_folder
from usarmjx.base.errors import SpecError, UnsupportedFeatureError
from usarmjx.base.settings.json_file import NotWholeError, as_mapping, read_kept
from usarmjx.base.tables import markdown_table
from usarmjx.models.compile.compose import add_robot
from usarmjx.models.compile.parts import parts_of
from usarmjx.models.drives.base import Drive
from usarmjx.models.drives.ground import Ackermann, NoDrive, OmniDrive, SkidSteer
from usarmjx.models.types.robot import RobotSpec

log = logging.getLogger(__name__)

RESPONSES_FILE = "responses.json"
"""Package resource with the measured responses."""


@dataclass(frozen=True, kw_only=True)
class Response:
    """Response of a rolling class to its wheel speeds.

    Attributes:
        gain: Forward speed over rim speed.
        turn_gain: Yaw rate over the rate computed from rim speeds and the described track.
        forward_lag: Time constant of the speed [s].
        turn_lag: Time constant of the yaw rate [s].
        acceleration: Largest acceleration [m/s^2].
        turn_acceleration: Largest angular acceleration [rad/s^2].
        cornering: Largest lateral acceleration [m/s^2], which limits the yaw rate at speed.
        drift: Lateral speed, to the outside, over forward speed times yaw rate [s].
        sides_apart: Whether the sides saturate independently, so that a robot that accelerates and turns does
            one before the other; otherwise both proportionally.
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


NUMERIC_FIELDS = tuple(field.name for field in fields(Response) if field.name != "sides_apart")
"""Numeric fields of a response."""


def read_response(entry: Any, place: str) -> Response:  # noqa: ANN401 - any data
    """Return the response of an entry of a file of measurements.

    Raises:
        NotWholeError: A field is missing, unknown, of another type, or not finite; names it.
    """
    held = as_mapping((as_mapping(entry) or {}).get("response"))
    if held is None or held.keys() - {"sides_apart"} != set(NUMERIC_FIELDS):
        raise NotWholeError(f"{place}: has no response with the fields of one")
    for name in NUMERIC_FIELDS:
        value = held[name]
        # JSON's true is an int in Python.
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise NotWholeError(f"{place}: {name} is {str(value)[:40]}, expected a finite number")
    if not isinstance(held.get("sides_apart", False), bool):
        raise NotWholeError(
            f"{place}: sides_apart is {str(held['sides_apart'])[:40]}, expected true or false"
        )
    return Response(**held)


@cache
def description_key(robot: RobotSpec) -> str:
    """Return a digest of a robot's physics; a measurement is valid only for the digest it was made with."""
    spec = mujoco.MjSpec()
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    # to_xml needs a compiled description.
    spec.compile()
    motors = [part.motor for part in parts_of(robot)]
    # Drive and motors are not in MuJoCo's description, but change how the robot answers.
    words = f"{robot.drive!r}\n{motors!r}\n{spec.to_xml()}"
    return hashlib.sha256(words.encode()).hexdigest()[:16]


@cache
def packaged_responses() -> dict[str, Any]:
    """Return the packaged measurements by class: key, response and residual errors."""
    return json.loads(
        resources.files("usarmjx.engines.planar").joinpath(RESPONSES_FILE).read_text(encoding="utf-8")
    )


def rolls(drive: Drive) -> bool:
    """Return whether a drive moves its robot by wheels or tracks."""
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
    """Return the file with the measured response of a robot that is not packaged.

    None: the cache is off, or others may write to it.

    Args:
        robot: The robot.
        folder: Cache folder; None: this user's.
    """
    cache = own_cache_folder(os.environ) if folder is None else folder
    # By digest, too: robots of one name may have other descriptions.
    return None if cache is None else cache / "planar" / f"{robot.name}-{description_key(robot)}.json"


def find_response(robot: RobotSpec, folder: Path | None = None) -> Response | None:
    """Return a rolling class's response, if it was measured for its current description.

    A kept file that is damaged, or for another description, counts as none and is removed, with a warning.
    """
    # Before the packaged ones: a new measurement is tried out without changing the package.
    if robot in _overrides:
        return _overrides[robot]
    entry = packaged_responses().get(robot.name)
    # A robot of the same name with another description answers differently.
    if entry is not None and entry["key"] == description_key(robot):
        return Response(**entry["response"])
    file = response_file(robot, folder)
    if file is None or not file.is_file():
        return None
    try:
        content = read_kept(file)
        if content.get("key") != description_key(robot):
            raise NotWholeError(f"{file}: is the response of another robot")
        # Kept for this process, so that the file is read and checked once.
        override_response(robot, read_response(content, str(file)))
    except SpecError as error:
        log.warning("%s; it is measured again", error)
        file.unlink(missing_ok=True)
        return None
    return _overrides[robot]


def uncalibrated(robots: Iterable[RobotSpec], folder: Path | None = None) -> tuple[RobotSpec, ...]:
    """Return the robots that roll and whose response was not measured, each once; see `find_response`."""
    return tuple(
        robot
        for robot in dict.fromkeys(robots)
        if rolls(robot.drive) and find_response(robot, folder) is None
    )


def response_of(robot: RobotSpec) -> Response:
    """Return a rolling class's response.

    Raises:
        UnsupportedFeatureError: It was not measured.
    """
    response = find_response(robot)
    if response is None:
        raise UncalibratedRobotError([robot])
    return response


_overrides: dict[RobotSpec, Response] = {}


def override_response(robot: RobotSpec, response: Response) -> None:
    """Override a class's response in engines built later in this process."""
    _overrides[robot] = response


def check_robot(robot: RobotSpec) -> None:
    """Refuse a robot that `planar` cannot move.

    Raises:
        UnsupportedFeatureError: Names the robot.
    """
    drive = robot.drive
    # Parts without a drive are legs' joints, on which a robot walks.
    if isinstance(drive, NoDrive) and robot.parts:
        raise UnsupportedFeatureError(
            f"engine 'planar' cannot run this scene: {robot.name} walks on legs; engines c, jax and warp can"
        )
    if not (rolls(drive) or drive.applies_wrench or isinstance(drive, NoDrive)):
        raise UnsupportedFeatureError(
            f"engine 'planar' cannot run this scene: {robot.name} is driven by {type(drive).__name__}, known "
            "are skid steering, tracks, Ackermann and omnidirectional wheels, flyers and divers"
        )


def response_entry(robot: RobotSpec, response: Response, **more: Any) -> dict[str, Any]:  # noqa: ANN401 - JSON
    """Return a class's entry of the file of measurements."""
    return {"key": description_key(robot), "response": asdict(response), **more}


def error_table() -> str:
    """Return the residual errors of the packaged responses by class, as a Markdown table."""
    # All measurements have the same horizons.
    horizons = list(next(iter(packaged_responses().values()))["errors"])

    def text(error: dict[str, float]) -> str:
        return f"{error['distance']:.2f} m, {math.degrees(error['heading']):.0f}° of {error['way']:.1f} m"

    rows = (
        [name, *(text(entry["errors"][horizon]) for horizon in horizons)]
        for name, entry in sorted(packaged_responses().items(), key=lambda item: item[0].lower())
    )
    return markdown_table(["class", *(f"after {horizon}" for horizon in horizons)], rows)
