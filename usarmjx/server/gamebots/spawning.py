"""Pose and name of the robot of an INIT (manual 9.4)."""

import logging
from collections.abc import Callable

from usarmjx.base.errors import UsageError
from usarmjx.base.transforms import Vec3
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.robot import RobotSpec
from usarmjx.server.protocol.commands import Init
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.sim.scene import start_height

log = logging.getLogger(__name__)


def spawn_from_init(
    world: ServedWorld, init: Init, spec: RobotSpec, convert: Callable[[Vec3], Vec3] = lambda pos: pos
) -> Robot:
    """Spawn the robot of an INIT in a world; log its place if that is not the requested one.

    Args:
        world: The world.
        init: The INIT.
        spec: The robot.
        convert: Converts a position to the axes of the log.

    Raises:
        UsageError: There is no room for it, no such start pose, or a robot of that name, case ignored.
    """
    # The views of image clients and the radio find a robot by its name, whose case does not count.
    if init.name.lower() in names_of_robots(world):
        raise UsageError(f"there is a robot {init.name} already")
    poses = _poses(world, init, spec)
    # Chosen before the spawn, or the new robot's own default would count as a tile in use.
    tile = world.free_tile(spec)
    robot = world.spawn_at(spec, init.name or free_name(world, spec), poses)
    robot.tile = tile
    if robot.refused is not None:
        x, y, z = (float(value) for value in world.state(robot).pos)
        asked, there = _text(convert(robot.refused)), _text(convert((x, y, z)))
        log.info("%s: no room at %s: it stands at %s", robot.name, asked, there)
    return robot


def _text(pos: Vec3) -> str:
    return ",".join(f"{value:.2f}" for value in pos)


def free_name(world: ServedWorld, spec: RobotSpec) -> str:
    """Return a name for a robot of a class that no other has."""
    taken = names_of_robots(world)
    # One more candidate than names taken, so that one is always free.
    numbers = (f"{spec.name}_{i}" for i in range(len(taken) + 1))
    return next(name for name in numbers if name.lower() not in taken)


def start_of(arena: ArenaSpec, tag: str) -> StartPose:
    """Return the start pose of a tag, in any case.

    Raises:
        UsageError: There is none; the message lists the tags.
    """
    tags = {start.tag.lower(): start for start in arena.starts}
    if tag.lower() not in tags:
        known = ", ".join(start.tag for start in tags.values())
        raise UsageError(f"no start pose {clip(tag)}; known: {known}")
    return tags[tag.lower()]


def names_of_robots(world: ServedWorld) -> set[str]:
    """Return the names of the robots in a world, in lower case."""
    return {robot.name.lower() for robot in world.robots.values()}


def _poses(world: ServedWorld, init: Init, spec: RobotSpec) -> list[tuple[Vec3, Vec3]]:
    """Return the poses that an INIT allows, the best first: the given one, or all start poses."""
    arena = world.arena
    named = start_of(arena, init.start) if init.start else None
    angles = flip_wire_angles(init.rotation) if init.rotation else None
    # A start pose wins over a Location if an INIT has both.
    if init.location is not None and named is None:
        return [(flip_wire_vector(init.location), angles or (0.0, 0.0, 0.0))]
    if not arena.starts:
        raise UsageError(f"arena {arena.name} has no start poses: give a Location")
    starts = world.starts_for(spec) if named is None else [named]
    return [((*start.at[:2], start_height(arena, start, spec)), angles or start.angles) for start in starts]
