"""Time that recording takes of the loop that steps a world of sixteen robots.

python -m benchmarks.recording --rounds 20
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import ParamSpec, TypeVar
from unittest.mock import patch

from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import RobotSpec
from usarmjx.recording.recorder import WorldRecorder
from usarmjx.server.worlds import dynamic_world
from usarmjx.server.worlds.recorded import record_worlds
from usarmjx.sim.control import CommandUpdate

ROBOTS_THERE, ROUND = 16, 10
"""Robots, and control steps of a round; each robot gets an order and reports once in a round."""
HEIGHT = 0.2
"""Of a P2DX that is brought [m]."""
LINES = b"SEN {Time 62.0100} {Type Sonar} {Name F1 Range 1.7626}\r\n" * 20

Given = ParamSpec("Given")
Result = TypeVar("Result")


class Spent:
    """CPU time of the loop's thread inside of some functions [s]."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def timed(self, function: Callable[Given, Result]) -> Callable[Given, Result]:
        """Return a function whose time counts."""

        def run(*args: Given.args, **kwargs: Given.kwargs) -> Result:
            began = time.thread_time()
            try:
                return function(*args, **kwargs)
            finally:
                self.seconds += time.thread_time() - began

        return run


def drive_crowd(
    world: dynamic_world.DynamicWorld, robot: RobotSpec, height: float, rounds: int
) -> Iterator[None]:
    """Spawn robots in a recorded world and drive them; yield after each round.

    Args:
        world: The world.
        robot: Class of all robots.
        height: Height of their origins at the start [m].
        rounds: Count of rounds.
    """
    recorder = world.recorder
    assert recorder is not None
    for number in range(ROBOTS_THERE):
        world.spawn_at(robot, f"R{number}", [((number % 4, number // 4, height), (0.0, 0.0, 0.0))])
    for step in range(rounds * ROUND):
        due = [one for one in world.robots.values() if (step + one.slot) % ROUND == 0]
        for one in due:
            world.update_command(one, CommandUpdate(drive={"Left": 1.0 + step % 3}))
            recorder.lines("127.0.0.1:4000", one.name, LINES, sent=True)
        world.step()
        if due:
            world.observe(due)
        if step % ROUND == ROUND - 1:
            yield


def measure(rounds: int, file: Path) -> list[float]:
    """Return what recording takes of a control step in each round [s]."""
    spent, costs = Spent(), list[float]()
    with ExitStack() as patches:
        patches.enter_context(
            patch.object(dynamic_world, "record_step", spent.timed(dynamic_world.record_step))
        )
        for name in ("record_orders", "read", "lines"):
            timed = spent.timed(getattr(WorldRecorder, name))
            patches.enter_context(patch.object(WorldRecorder, name, timed))
        world = dynamic_world.DynamicWorld(ARENAS.get("soccer"), max_robots=ROBOTS_THERE)
        recording = record_worlds([world], file)
        for _ in drive_crowd(world, ROBOTS.get("P2DX"), HEIGHT, rounds):
            costs.append(spent.seconds / ROUND)
            spent.seconds = 0.0
        recording.close()
    return costs


def main() -> None:
    """Measure, and print the least, the median and the most of the rounds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=20, help=f"rounds of {ROUND} control steps")
    rounds = parser.parse_args().rounds
    with tempfile.TemporaryDirectory() as folder:
        costs = [1e6 * one for one in measure(rounds, Path(folder) / "crowd.mcap")]
    print(
        f"recording takes {min(costs):.0f} us of a control step with {ROBOTS_THERE} P2DX at least, "
        f"{statistics.median(costs):.0f} in the median, {max(costs):.0f} at most, of {rounds} rounds"
    )


if __name__ == "__main__":
    main()
