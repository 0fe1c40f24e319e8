"""Difficulty of the obstacles of generated arenas: share of drives that cross them, and their time."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.settings.json_file import as_mapping, read_json
from usarmjx.models.arenas.elements import CELL
from usarmjx.models.arenas.lanes import MobilityLane, lane_of
from usarmjx.models.compile.reachability import footprint_of
from usarmjx.models.generate.obstacles import CROSSINGS_FILE, OBSTACLES, SuccessCurve, obstacle_height
from usarmjx.models.generate.random_stream import RandomStream
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.trials.driver import Trial

OBSTACLES_PER_LANE = 3
"""Obstacles one behind the other, a bare cell between two, as in rings."""
TIME_LIMIT = 60.0
"""For one crossing of them [s]."""
LEVELS = (0.3, 0.5, 0.7, 0.85, 0.95, 1.1, 1.3, 1.6, 2.0, 2.5, 3.0, 3.6)
"""Heights at which success is measured, over the robot's step."""
MIN_SUCCESS = 0.2
"""Once no more than this share of the drives succeeds, nothing higher is tried."""
MAX_LATERAL_OFFSET, MAX_YAW_OFFSET = 0.12, 0.2
"""Largest offset of perturbed drives from the middle of the lane [m], and from its direction [rad]."""
MIN_SPEED_SHARE, MIN_FRICTION_SHARE = 0.6, 0.6
"""They have at least this share of the top speed, and of everything's friction."""


@dataclass(frozen=True)
class Crossings:
    """Result of a robot at obstacles of one kind and roughness.

    Attributes:
        kind: A name of `generate.obstacles.OBSTACLES`.
        roughness: From 0 to 1.
        tries: Lanes with other draws that it was sent through once each.
        crossed: Number of lanes that it crossed.
        seconds: Mean simulated time of those [s].
    """

    kind: str
    roughness: float
    tries: int
    crossed: int
    seconds: float


def measure_crossings(
    kind: str, robot: RobotSpec, roughness: float, tries: int = 4, scale: float = 1.0
) -> Crossings:
    """Send a robot through lanes of three obstacles, each once.

    Args:
        kind: A name of `OBSTACLES`.
        robot: The robot's class, to which they are sized.
        roughness: Height, from 0 to 1.
        tries: Number of lanes, each of other draws.
        scale: Factor on the step that the robot is rated to climb.

    Raises:
        UnknownNameError: No such kind.
        UsageError: The class does not drive on the ground.
    """
    height = scale * obstacle_height(footprint_of(robot), roughness)
    lanes = obstacle_lanes(kind, height, tries)
    runs = [Trial(lane.arena, robot).follow([*lane.way(back=False)], TIME_LIMIT) for lane in lanes]
    times = [run.seconds for run in runs if not run.fault]
    mean = sum(times) / len(times) if times else 0.0
    return Crossings(kind, roughness, tries, len(times), mean)


def obstacle_lanes(kind: str, height: float, count: int) -> Iterator[MobilityLane]:
    """Yield lanes with three obstacles of a height [m] one behind the other, each of other draws.

    Raises:
        UnknownNameError: No such kind.
    """
    make = OBSTACLES.get(kind)
    for number in range(count):
        draw = RandomStream(number, f"{kind} to cross")
        shapes = [
            shape
            for i in range(OBSTACLES_PER_LANE)
            for shape in make(draw, ((2 * i + 0.5) * CELL, 0.0), height, 0)
        ]
        yield lane_of(
            kind, "not a test method", f"Obstacles: {kind}", (2 * OBSTACLES_PER_LANE - 1) * CELL, *shapes
        )


def measure_success(robot: RobotSpec, kind: str, drives: int) -> list[tuple[float, float]]:
    """Send a robot over three obstacles often, each time from elsewhere, at another speed, on other ground.

    Args:
        robot: The robot's class.
        kind: A name of `OBSTACLES`.
        drives: Number of drives at each height.

    Returns:
        Heights over the robot's step, and the share of the drives that got over them; until hardly any does.

    Raises:
        UsageError: The class does not drive on the ground.
    """
    curve: list[tuple[float, float]] = []
    for level in LEVELS:
        lanes = obstacle_lanes(kind, level * footprint_of(robot).step, drives)
        crossed = sum(_crosses_perturbed(lane, robot, number) for number, lane in enumerate(lanes))
        curve.append((level, crossed / drives))
        if curve[-1][1] <= MIN_SUCCESS:
            break
    return curve


def write_success(robot: RobotSpec, drives: int, path: Path) -> None:
    """Measure success of a robot at all kinds of obstacles; the file keeps what it has of other classes.

    Raises:
        UsageError: The class does not drive on the ground, or the file is another one.
        WriteError: The file cannot be written.
    """
    kept = _measured_before(path) if path.exists() else {}
    kept[robot.name] = {kind: measure_success(robot, kind, drives) for kind in OBSTACLES.names()}
    with atomic_write(path) as fresh:
        fresh.write_text(success_text(kept, drives), encoding="utf-8")


def _measured_before(path: Path) -> dict[str, Any]:
    """Return the curves in a file by class and kind.

    Raises:
        UsageError: It holds none.
    """
    content = as_mapping(read_json(path, UsageError, finite=True)) or {}
    held = as_mapping(content.get("classes"))
    for kinds in [None] if held is None else held.values():
        curves = as_mapping(kinds)
        if curves is None or not all(_is_curve(curve) for curve in curves.values()):
            raise UsageError(f"{path} holds no measured success; give a new file")
    return held or {}


def _is_curve(curve: object) -> bool:
    """Return whether a value is a list of pairs of a level and a rate."""
    pairs = cast("list[Any]", curve) if isinstance(curve, list) else [None]
    numbers = [cast("list[Any]", pair) if isinstance(pair, list) else [] for pair in pairs]
    return all(len(pair) == 2 and all(type(one) in (int, float) for one in pair) for pair in numbers)


def success_text(classes: Mapping[str, Mapping[str, SuccessCurve]], drives: int) -> str:
    """Return measured success as JSON with a line for each class and kind."""
    rows = {
        name: ",\n".join(f"   {json.dumps(kind)}: {json.dumps(curve)}" for kind, curve in found.items())
        for name, found in sorted(classes.items())
    }
    listed = ",\n".join(f"  {json.dumps(name)}: {{\n{row}\n  }}" for name, row in rows.items())
    command = f"usarmjx arena obstacles --robot CLASS --tries {drives} --write {CROSSINGS_FILE}"
    return f'{{\n "command": {json.dumps(command)},\n "classes": {{\n{listed}\n }}\n}}\n'


def _crosses_perturbed(lane: MobilityLane, robot: RobotSpec, number: int) -> bool:
    """Return whether a robot crosses a lane; a seed draws its start pose, speed and friction."""
    rng = np.random.default_rng(number)
    trial = Trial(lane.arena, robot, rng.uniform(MIN_SPEED_SHARE, 1.0))
    trial.world.engine.model.geom_friction[:, 0] *= rng.uniform(MIN_FRICTION_SHARE, 1.0)
    start = lane.arena.starts[0]
    x, y, z = start.at
    lateral_offset, yaw_offset = (
        rng.uniform(-MAX_LATERAL_OFFSET, MAX_LATERAL_OFFSET),
        rng.uniform(-MAX_YAW_OFFSET, MAX_YAW_OFFSET),
    )
    position = (x - lateral_offset * math.sin(start.yaw), y + lateral_offset * math.cos(start.yaw), z)
    trial.reset_to(replace(start, at=position, yaw=start.yaw + yaw_offset))
    return not trial.follow([*lane.way(back=False)], TIME_LIMIT).fault
