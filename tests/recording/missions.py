"""A short recorded mission in a small room: robots join and leave, drive, scan and meet a victim."""

from dataclasses import replace

import numpy as np
import pytest

from usarmjx.base.errors import UsageError
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec, LooseObject, StartPose, Victim
from usarmjx.models.types.robot import Mount, options
from usarmjx.models.types.shapes import Shape
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.recorded import record_worlds
from usarmjx.sim.control import CommandUpdate

SIDE = 3.0
"""Half the length of the room's walls [m]."""
BLOCK = (20.0, 0.0)
"""In the middle of a solid far away, where no robot finds room."""


def _wall(x, y, along_x):
    size = (SIDE, 0.05, 0.5) if along_x else (0.05, SIDE, 0.5)
    return Shape(kind="box", size=size, at=(x, y, 0.5), surface="wall")


ROOM = ArenaSpec(
    name="room",
    shapes=(
        *(_wall(0, -SIDE, True), _wall(0, SIDE, True), _wall(-SIDE, 0, False), _wall(SIDE, 0, False)),
        Shape(kind="box", size=(3.0, 3.0, 3.0), at=(*BLOCK, 3.0), surface="wall"),
    ),
    starts=(StartPose(tag="a", at=(-1.0, 0.0, 0.188)), StartPose(tag="b", at=(-1.0, 1.0, 0.188))),
    extent=((-SIDE, SIDE), (-SIDE, SIDE)),
    loose=(
        LooseObject(name="ball", at=(1, 1.5, 0.1), shapes=(Shape(kind="sphere", size=(0.1,), mass=0.2),)),
    ),
    victims=(Victim(name="v", at=(1.5, 0.0, 0.2)),),
)
SCOUT = replace(
    ROBOTS.get("P2DX"),
    name="Scout",
    sensors=(
        Mount(kind="RangeScanner", name="Scanner1", options=options(Resolution=0.1, MaxRange=20.0)),
        Mount(kind="VictSensor", name="Victims"),
    ),
    cameras=(),
)
HEIGHT = 0.3


def mission_world(path):
    """A served world that is recorded, and its recording."""
    world = DynamicWorld(ROOM, max_robots=3, seed=5)
    return world, record_worlds([world], path, RadioSettings())


def observe(world):
    """Read all robots' sensors, as reports do."""
    robots = [*world.robots.values()]
    world.observe(robots)
    for robot in robots:
        robot.pending.clear()


def drive_mission(path, steps=60):
    """Record a mission; return where the chassis of all robots were after each step, by name."""
    world, file = mission_world(path)
    first = world.spawn_at(SCOUT, "First", [((-1.0, 0.0, HEIGHT), (0.0, 0.0, 0.0))])
    places = []
    for step in range(steps):
        if step == 5:
            world.update_command(first, CommandUpdate(drive={"Left": 4.0, "Right": 5.0}, light=True))
        if step == 20:
            second = world.spawn_at(SCOUT, "Second", [((-1.0, 1.0, HEIGHT), (0.0, 0.0, 1.0))])
            world.update_command(second, CommandUpdate(drive={"Left": -2.0, "Right": 3.0}))
        if step == 30:
            with pytest.raises(UsageError, match="no room"):
                world.spawn_at(SCOUT, "Third", [((*BLOCK, 0.0), (0.0, 0.0, 0.0))])
        if step == 40:
            world.recorder.lines("127.0.0.1:4000", "First", b"DRIVE {Left 1}\r\n", sent=False)
            world.remove(first)
        world.step()
        places.append({r.name: np.array(world.state(r).pos) for r in world.robots.values()})
        if step % 10 == 0:
            observe(world)
    file.close()
    return places
