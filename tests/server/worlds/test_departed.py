"""Robots that have left leave no objects behind, in a world and in its recording."""

import gc
import time
from collections import Counter

from tests.recording.missions import HEIGHT, SCOUT, mission_world
from usarmjx.models.robots import ROBOTS
from usarmjx.sim.control import CommandUpdate

CLASSES = (SCOUT, ROBOTS.get("P2AT"), ROBOTS.get("Talon"))
ROUNDS = 10
"""Visits of a robot of each class."""
STEPS = 12
"""Control steps of a visit: with a frame of the recording."""
PATIENCE = 60.0
"""Time [s] for what the recording's thread does in a second."""


def visit(world, robot):
    here = world.spawn_at(robot, f"{robot.name}_0", [((-1.0, 0.0, HEIGHT), (0.0, 0.0, 0.0))])
    world.update_command(here, CommandUpdate(drive={"Left": 2.0, "Right": 1.0}))
    for _ in range(STEPS):
        world.step()
        world.observe([here])
    world.remove(here)


def objects(world):
    """The present objects by type, once the recording has written all, shapes for Foxglove too."""
    file, end = world.recorder.file, time.monotonic() + PATIENCE
    while (file._jobs or file._pieces) and time.monotonic() < end:
        time.sleep(0.05)
    assert not file._jobs
    assert not file._pieces
    gc.collect()
    return Counter(type(one).__qualname__ for one in gc.get_objects())


def test_robots_that_leave_leave_nothing_behind(tmp_path):
    """`tests/server/test_visits.py` has the same of a world that nobody records."""
    world, file = mission_world(tmp_path / "visits.mcap")
    for robot in CLASSES * 2:  # the first of a class fills caches
        visit(world, robot)
    gc.freeze()  # there are a million others, which need not be counted
    try:
        counts = [objects(world)]
        for _ in range(2):
            for _ in range(ROUNDS):
                for robot in CLASSES:
                    visit(world, robot)
            counts.append(objects(world))
    finally:
        gc.unfreeze()
    file.close()
    # Both times: a thread may hold one drawing, of 146 shapes, at one of the moments.
    left = (counts[1] - counts[0]) & (counts[2] - counts[1])
    # Less than one of a visit, whatever the type: other threads and caches of the interpreter have some.
    assert {name: count for name, count in left.items() if count >= ROUNDS} == {}
