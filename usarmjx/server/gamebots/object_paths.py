"""Commands of a world controller that set loose objects in motion (WorldController.uc).

    CONTROL {Type SetWP} {Name box} {Speed 0.5} {Loop true} {WP 1,0,-0.1;3,0,-0.1;3,2,-0.1}
    CONTROL {Type SetWP} {Name box} {Move false}
    CONTROL {Type AddWP} {Name box} {WP 1,2,-0.1}
    CONTROL {Type ClearWP} {Name box}
    CONTROL {Type Rotate} {Name box} {Speed 0,0,0.5}

`Time` is that of the whole path; with Speed, too, the slower of both holds. An object begins at its first point.
"""  # noqa: E501 - examples of lines

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from usarmjx.base.errors import PeerError
from usarmjx.base.transforms import Vec3, quat_from_angles
from usarmjx.server.protocol.commands import Control, PathOptions
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.worlds.object_motion import MAX_POINTS, ObjectMotion, angles_along, angles_of
from usarmjx.server.worlds.served_world import ServedWorld


def set_path(world: ServedWorld, index: int, command: Control) -> None:
    """Give an object waypoints, or change how it moves along those that it has.

    Args:
        world: The world.
        index: Index of the object among the arena's loose ones.
        command: The command.

    Raises:
        PeerError: Too many points.
        UsageError: The world cannot move it, or a point is out of reach.
    """
    options, name = command.path, _key(world, index)
    before = world.motions.get(name, ObjectMotion())
    motion = replace(before, loops=before.loops if options.loop is None else options.loop)
    if options.points:
        motion = replace(motion, points=_points(world, options), progress=0.0)
    else:
        motion.progress = min(motion.progress, motion.length)
    for field in ("move", "reset"):
        given = getattr(options, field)
        if given is not None:
            setattr(motion, {"move": "moving", "reset": "resets"}[field], given)
    motion.speed = _speed(motion, options)
    if options.align is not None:
        motion.aligned = options.align
    turns = options.align is not None and options.align != before.aligned
    if options.points or turns:
        _put(world, index, motion, back=turns and not motion.aligned)
    world.motions[name] = motion


def add_points(world: ServedWorld, index: int, command: Control) -> None:
    """Add waypoints behind those of an object; arguments and errors are those of `set_path`."""
    options, name = command.path, _key(world, index)
    if not options.points:
        raise PeerError("AddWP needs a WP")
    before = world.motions.get(name, ObjectMotion())
    points = np.concatenate([before.points, _points(world, options, len(before.points))])
    motion = replace(before, points=points)
    if not len(before.points):
        _put(world, index, motion)
    world.motions[name] = motion


def clear_path(world: ServedWorld, index: int, command: Control) -> None:
    """Remove the waypoints of an object, which returns to its first pose if it is set so."""
    del command
    name = _key(world, index)
    motion = world.motions.get(name)
    if motion is None or not len(motion.points):
        return
    if motion.resets:
        world.move_loose(index, *_first_pose(world, index))
    if motion.spin.any():
        world.motions[name] = ObjectMotion(spin=motion.spin, angles=motion.angles, resets=motion.resets)
    else:
        del world.motions[name]


def rotate(world: ServedWorld, index: int, command: Control) -> None:
    """Let an object rotate, or stop it with a Speed of 0.

    Raises:
        PeerError: There is no Speed.
        UsageError: The world cannot move it.
    """
    if command.spin is None:
        raise PeerError("Rotate needs a Speed of three numbers")
    name, row = _key(world, index), world.loose_poses()[index]
    world.move_loose(index, _vec3(row[:3]), row[3:])
    motion = world.motions.get(name, ObjectMotion())
    spin = np.array(flip_wire_angles(command.spin))
    world.motions[name] = replace(motion, spin=spin, angles=angles_of(row[3:]))


MOTION_COMMANDS: dict[str, Callable[[ServedWorld, int, Control], None]] = {
    "setwp": set_path,
    "addwp": add_points,
    "clearwp": clear_path,
    "rotate": rotate,
}
"""Commands by their type in lower case."""


def _key(world: ServedWorld, index: int) -> str:
    return world.scene.arena.loose[index].name.lower()


def _vec3(values: np.ndarray) -> Vec3:
    x, y, z = map(float, values)
    return x, y, z


def _points(world: ServedWorld, options: PathOptions, before: int = 0) -> np.ndarray:
    """Return new waypoints in our axes [m] (points, 3)."""
    if before + len(options.points) > MAX_POINTS:
        raise PeerError(f"an object has at most {MAX_POINTS} waypoints")
    points = [flip_wire_vector(point) for point in options.points]
    for point in points:
        world.check_position(point)
    return np.array(points)


def _speed(motion: ObjectMotion, options: PathOptions) -> float:
    """Return the speed along the path [m/s]; a Time is that of the whole path."""
    in_time = [motion.length / options.time] if options.time > 0 else []
    given = [options.speed] if options.speed > 0 else []
    return min([*given, *in_time], default=motion.speed)


def _first_pose(world: ServedWorld, index: int) -> tuple[Vec3, np.ndarray]:
    """Return position and orientation of an object at the beginning."""
    thing = world.scene.arena.loose[index]
    x, y, z = thing.at
    return (x, y, z + world.scene.arena.floor), np.asarray(quat_from_angles(*thing.rotation))


def _put(world: ServedWorld, index: int, motion: ObjectMotion, *, back: bool = False) -> None:
    """Put an object where it is on its path, aligned if it is so; `back`: turned as at the beginning."""
    row = world.loose_poses()[index]
    pos, along = motion.place() if len(motion.points) else (row[:3], None)
    quat = _first_pose(world, index)[1] if back else row[3:]
    if motion.aligned and along is not None:
        quat = np.asarray(quat_from_angles(*angles_along(along).tolist()))
    world.move_loose(index, _vec3(pos), quat)
