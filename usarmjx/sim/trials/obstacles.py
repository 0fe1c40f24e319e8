"""How difficult the obstacles of generated arenas are: how often a robot crosses them, and how fast."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.models.arenas.elements import CELL
from usarmjx.models.arenas.lanes import MobilityLane, lane_of
from usarmjx.models.compile.reachability import footprint_of
from usarmjx.models.generate.obstacles import CROSSINGS_FILE, OBSTACLES, SuccessCurve, obstacle_height
from usarmjx.models.generate.random_stream import RandomStream
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.trials.driver import Trial

ROW = 3
"""Obstacles one behind the other, a bare cell between two, as in rings."""
TIME = 60.0
"""For one crossing of them [s]."""
LEVELS = (0.3, 0.5, 0.7, 0.85, 0.95, 1.1, 1.3, 1.6, 2.0, 2.5, 3.0, 3.6)
"""Heights at which success is measured, over the robot's step."""
HOPELESS = 0.2
"""Once no more than this share of the drives succeeds, nothing higher is tried."""
ASIDE, ASKEW = 0.12, 0.2
"""Perturbed drives start up to so far beside the middle of the lane [m], turned by up to so much [rad]."""
SLOWEST, SLICKEST = 0.6, 0.6
"""They have at least this share of the top speed, and of everything's friction."""


@dataclass(frozen=True)
class Crossings:
    """What a robot did at obstacles of one kind and roughness.

    Attributes:
        kind: A name of `generate.obstacles.OBSTACLES`.
        roughness: From 0 to 1.
        tries: Lanes with other draws that it was sent through once each.
        crossed: How many it got through.
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
        roughness: How high they are, from 0 to 1.
        tries: How many lanes, each of other draws.
        scale: On the step that the robot is said to climb.

    Raises:
        UnknownNameError: No such kind.
        UsageError: The class does not drive on the ground.
    """
    height = scale * obstacle_height(footprint_of(robot), roughness)
    tried = lanes(kind, height, tries)
    rides = [Trial(lane.arena, robot).follow([*lane.way(back=False)], TIME) for lane in tried]
    times = [ride.seconds for ride in rides if not ride.fault]
    mean = sum(times) / len(times) if times else 0.0
    return Crossings(kind, roughness, tries, len(times), mean)


def lanes(kind: str, height: float, count: int) -> Iterator[MobilityLane]:
    """Yield lanes with three obstacles of a height [m] one behind the other, each of other draws.

    Raises:
        UnknownNameError: No such kind.
    """
    make = OBSTACLES.get(kind)
    for number in range(count):
        draw = RandomStream(number, f"{kind} to cross")
        shapes = [shape for i in range(ROW) for shape in make(draw, ((2 * i + 0.5) * CELL, 0.0), height, 0)]
        yield lane_of(kind, "not a test method", f"Obstacles: {kind}", (2 * ROW - 1) * CELL, *shapes)


def measure_success(robot: RobotSpec, kind: str, drives: int) -> list[tuple[float, float]]:
    """Send a robot over three obstacles often, each time from elsewhere, at another speed, on other ground.

    Args:
        robot: The robot's class.
        kind: A name of `OBSTACLES`.
        drives: How often at each height.

    Returns:
        Heights over the robot's step, and the share of the drives that got over them; until hardly any does.

    Raises:
        UsageError: The class does not drive on the ground.
    """
    found: list[tuple[float, float]] = []
    for level in LEVELS:
        tried = lanes(kind, level * footprint_of(robot).step, drives)
        crossed = sum(_drive_perturbed(lane, robot, number) for number, lane in enumerate(tried))
        found.append((level, crossed / drives))
        if found[-1][1] <= HOPELESS:
            break
    return found


def write_success(robot: RobotSpec, drives: int, path: Path) -> None:
    """Measure success of a robot at all kinds of obstacles; the file keeps what it has of other classes.

    Raises:
        UsageError: The class does not drive on the ground, or the file is another one.
        WriteError: The file cannot be written.
    """
    kept: dict[str, Any]
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))["classes"] if path.exists() else {}
    except (ValueError, KeyError, TypeError):
        raise UsageError(f"{path} holds no measured success; give a new file") from None
    kept[robot.name] = {kind: measure_success(robot, kind, drives) for kind in OBSTACLES.names()}
    with atomic_write(path) as fresh:
        fresh.write_text(success_text(kept, drives), encoding="utf-8")


def success_text(classes: Mapping[str, Mapping[str, SuccessCurve]], drives: int) -> str:
    """Return measured success as JSON with a line for each class and kind."""
    rows = {
        name: ",\n".join(f"   {json.dumps(kind)}: {json.dumps(curve)}" for kind, curve in found.items())
        for name, found in sorted(classes.items())
    }
    listed = ",\n".join(f"  {json.dumps(name)}: {{\n{row}\n  }}" for name, row in rows.items())
    command = f"usarmjx arena obstacles --robot CLASS --tries {drives} --write {CROSSINGS_FILE}"
    return f'{{\n "command": {json.dumps(command)},\n "classes": {{\n{listed}\n }}\n}}\n'


def _drive_perturbed(lane: MobilityLane, robot: RobotSpec, number: int) -> bool:
    """Return whether a robot gets through a lane from where, how fast and on what ground a number tells."""
    draw = np.random.default_rng(number)
    trial = Trial(lane.arena, robot, draw.uniform(SLOWEST, 1.0))
    trial.world.engine.model.geom_friction[:, 0] *= draw.uniform(SLICKEST, 1.0)
    start = lane.arena.starts[0]
    x, y, z = start.at
    aside, askew = draw.uniform(-ASIDE, ASIDE), draw.uniform(-ASKEW, ASKEW)
    beside = (x - aside * math.sin(start.yaw), y + aside * math.cos(start.yaw), z)
    trial.put_back(replace(start, at=beside, yaw=start.yaw + askew))
    return not trial.follow([*lane.way(back=False)], TIME).fault
