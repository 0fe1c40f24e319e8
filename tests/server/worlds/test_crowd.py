"""Robots that are driven against each other at random: nobody is put back but by the rule.

`python -m tests.server.worlds.test_crowd 600` does it for ten minutes.
"""

import sys

import numpy as np
import pytest

from usarmjx.base.backend import numpy_backend
from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots import ROBOTS
from usarmjx.sim.control import idle_command, set_drive
from usarmjx.sim.scene import build_scene, start_height
from usarmjx.sim.single_world import SingleWorld
from usarmjx.sim.world import runaway_limit

CLASSES = ("P2AT", "P2DX", "ATRVJr", "Talon", "Zerg", "Kenaf")
ROBOTS_PER_CLASS = 2
HOLD = 25
"""Control steps for which an order stands."""
FALLEN = 10.0
"""What falling from the arena's highest place may add to a robot's own top speed [m/s]: 5 m of height."""


def crowd(arena):
    """Return a world with two robots of each class, side by side."""
    scene = build_scene(ARENAS.get(arena), [])
    world = SingleWorld(scene, seats=len(CLASSES) * ROBOTS_PER_CLASS)
    for number, name in enumerate(CLASSES * ROBOTS_PER_CLASS):
        robot = ROBOTS.get(name)
        start = scene.arena.starts[number % len(scene.arena.starts)]
        place = (*start.at[:2], start_height(scene.arena, start, robot))
        world.add(robot, f"{name}{number}", [(place, quat_from_angles(0.0, 0.0, start.yaw))])
    return world


def drive_at_random(world, seconds):
    """Return how often robots were put back, and the fastest that anybody else was, of its limit."""
    rng, put_back, fastest = np.random.default_rng(1), 0, 0.0
    period, indices = world.scene.physics.period, world._indices
    limits = {slot: runaway_limit(entry.spec) + FALLEN for slot, entry in world.roster.items()}
    before = {slot: world.engine.pose(index)[:3] for slot, index in indices.items()}
    for step in range(round(seconds / period)):
        if step % HOLD == 0:
            for slot, entry in world.roster.items():
                tops = entry.spec.drive.full_scale
                with numpy_backend():
                    values = {key: np.float32(rng.uniform(-top, top)) for key, top in tops.items()}
                    world.edit(slot, command=set_drive(entry.spec, idle_command(entry.spec), values))
        mended = world.step().robots
        put_back += len(mended)
        now = {slot: world.engine.pose(index)[:3] for slot, index in indices.items()}
        for slot in set(now) - set(mended):
            speed = np.linalg.norm(now[slot] - before[slot]) / period
            fastest = max(fastest, speed / limits[slot])
        before = now
    return put_back, fastest


@pytest.mark.parametrize("arena", ["yellow", pytest.param("field", marks=pytest.mark.thorough)])
def test_nobody_is_put_back_but_by_the_rule(arena):
    world = crowd(arena)
    put_back, fastest = drive_at_random(world, 10.0)
    assert fastest < 1.0  # nobody jumps, which being put back would be
    assert put_back == int(world.world.faults.not_finite) == 0


if __name__ == "__main__":
    for name in ("yellow", "field"):
        print(name, *drive_at_random(crowd(name), float(sys.argv[1])))
