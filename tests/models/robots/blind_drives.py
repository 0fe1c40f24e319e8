"""Robots driven blindly: `python -m tests.models.robots.blind_drives CLASS [DRIVES] [SECONDS]`."""

import math
import sys
from dataclasses import dataclass

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots import ROBOTS
from usarmjx.sim.control import CommandUpdate, update_command
from usarmjx.sim.scene import build_scene, start_height
from usarmjx.sim.single_world import SingleWorld

PERIOD = 0.02
HELD, HELD_TURN = 0.03, 0.15
"""Who comes no further [m] and turns no more [rad] while it is told to drive was held for that time."""


@dataclass(frozen=True)
class BlindDrive:
    """How upright a robot was at its worst and at its end, and how long it was held at the end [s]."""

    least_upright: float
    upright: float
    held: float


def blind_drive(name, number, seconds, arena="yellow"):
    """Drive a robot from some start, ahead, back and in curves of 1 to 3 s each, whatever is in the way."""
    arena, robot, draw = ARENAS.get(arena), ROBOTS.get(name), np.random.default_rng(number)
    start = arena.starts[draw.integers(len(arena.starts))]
    at = (*start.at[:2], start_height(arena, start, robot))
    world = SingleWorld(build_scene(arena, ()), seed=0, seats=1)
    world.add(robot, name, [(at, np.array(quat_from_angles(0.0, 0.0, draw.uniform(-math.pi, math.pi))))])
    plan, member = world.scene.groups[0], world.scene.group_of(0)[1]
    root, least, held, time = plan.indices[member].root_qposadr, 1.0, 0.0, 0.0
    while time < seconds:
        length = draw.uniform(1, 3)
        speed = draw.uniform(0.5, 1) * robot.drive.full_scale["Left"] * draw.choice([1, 1, 1, -1])
        sides = (speed, speed * draw.choice([1, 1, 0.5, -1]))
        left, right = sides if draw.random() < 0.5 else sides[::-1]
        with numpy_backend():
            told = CommandUpdate(drive={"Left": left, "Right": right})
            world.edit(0, command=update_command(plan.plan, world.state_of(0).command, told))
        poses = []
        for _ in range(round(length / PERIOD)):
            world.step()
            poses.append(world.engine.data.qpos[root : root + 7].copy())
        path, time = np.array(poses), time + length
        upright = 1 - 2 * (path[:, 4] ** 2 + path[:, 5] ** 2)
        turned = np.ptp(np.unwrap(2 * np.arctan2(path[:, 6], path[:, 3])))
        stays = np.linalg.norm(np.ptp(path[:, :2], axis=0)) < HELD and turned < HELD_TURN
        held, least = (held + length if stays else 0.0), min(least, upright.min())
    return BlindDrive(least, upright[-1], held)


def main(name, drives="40", seconds="40"):
    """Print how a class got through so many drives."""
    found = [blind_drive(name, number, float(seconds)) for number in range(int(drives))]
    print(f"{name}: {drives} drives of {seconds} s")
    for what, least in (("on its side at the end", 0.5), ("more than 25 degrees askew at the end", 0.906)):
        print(f"  {what}: {sum(drive.upright < least for drive in found)}")
    print(f"  more than 60 degrees askew on the way: {sum(drive.least_upright < 0.5 for drive in found)}")
    print(f"  held for longer than 5 s at the end: {sum(drive.held > 5.0 for drive in found)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
