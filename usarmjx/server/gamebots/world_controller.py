"""The later versions' world controller: a client without a robot that moves objects and robots.

    INIT {ClassName USARBot.WorldController} {Name W}
    CONTROL {Type GetSTA}                             STA {Name crate} {Size 0.06,0.06,-0.06} {Location ...} {Rotation ...}
    CONTROL {Type AbsMove} {Name crate} {Location 1,2,-0.1} {Rotation 0,0,1.57}
    CONTROL {Type RelMove} {Name R1} {Location 0.5,0,0}
    CONTROL {Type Create} {ClassName WCCrate11401} {Name box} {Location 1,2,-0.1} {Physics RigidBody}
    CONTROL {Type Conveyor} {Name Belt1} {Speed 0.5}
    CONTROL {Type SetWP} {Name box} {Speed 0.5} {Loop true} {WP 1,0,-0.1;3,0,-0.1;3,2,-0.1}
    CONTROL {Type SetWP} {Name box} {Move false}
    CONTROL {Type AddWP} {Name box} {WP 1,2,-0.1}, CONTROL {Type ClearWP} {Name box}
    CONTROL {Type Rotate} {Name box} {Speed 0,0,0.5}
    CONTROL {Type Kill} {Name box}, CONTROL {Type KillAll} {MinPos 0,0,-1} {MaxPos 3,3,0}

Names are those of loose objects of the arena, then of robots. Keys, axes and signs are WorldController.uc's;
the z of a size is negative, because z points down on the wire. Only GetSTA has an answer. A created object
stays when its controller leaves. Kill does not remove the arena's own objects.
`Time` is that of a whole path; with Speed, too, the slower of both holds. An object begins at its first point.
"""  # noqa: E501 - an answer is one line

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import PeerError
from usarmjx.base.registry import is_name
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import Vec3, quat_from_angles
from usarmjx.models.types.shapes import MAX_BELT_SPEED
from usarmjx.server.gamebots.spawning import names_of_robots, start_of
from usarmjx.server.gamebots.world_objects import (
    FREE_PHYSICS,
    MAX_OBJECTS,
    CreatedObject,
    class_of,
    make_object,
)
from usarmjx.server.protocol.commands import Control, PathOptions
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.protocol.grammar import Message, Segment, clip, four_decimals_list
from usarmjx.server.worlds.object_motion import MAX_POINTS, ObjectMotion, angles_along, angles_of
from usarmjx.server.worlds.robot import Robot, wire_pose
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
    # A copy: an error below must leave the object's motion as it was.
    motion = replace(before, loops=before.loops if options.loop is None else options.loop)
    if options.points:
        motion = replace(motion, points=_points(world, options), progress=0.0)
    else:
        # A path that is no longer closed is shorter by its last leg, on which the object may be.
        motion.progress = min(motion.progress, motion.length)
    for field in ("move", "reset"):
        given = getattr(options, field)
        # An absent option keeps its former value: None and False mean different things here.
        if given is not None:
            setattr(motion, {"move": "moving", "reset": "resets"}[field], given)
    # After the points: a Time is turned into a speed by the length of the new path.
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
    # An object begins at its first point; further points leave it where it is.
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
    # The rotation is a command of its own, and goes on without a path.
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
    # A move to its present pose refuses here, in a world without moved objects, before anything is stored.
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


CLASS_NAME = "WorldController"
"""Class that INIT names."""
ARENA_OBJECT = CreatedObject("", is_permanent=True)
"""Entry of each object of the arena."""
UNIT_SCALE: Vec3 = (1.0, 1.0, 1.0)
_ORIGIN: Vec3 = (0.0, 0.0, 0.0)
_TYPES = ("GetSTA", "AbsMove", "RelMove", "Create", "Kill", "KillAll", "Conveyor")


class WorldController:
    """Carries out the commands of one controller.

    Args:
        world: The world.
    """

    def __init__(self, world: ServedWorld) -> None:
        self._world = world

    def execute(self, command: Control) -> Message | None:
        """Carry out a CONTROL; return the answer, if it has one.

        Raises:
            PeerError: Nothing has that name, or there is no such type.
            UsageError: The world cannot move it, has no room there, or has no such start pose.
        """
        match command.type.lower():
            case "getsta":
                return self._status(command)
            case "absmove":
                self._move(command, relative=False)
            case "relmove":
                self._move(command, relative=True)
            case "create":
                self._create(command)
            case "kill":
                self._kill(command.name)
            case "killall":
                self._kill_all(command.corners)
            case "conveyor":
                self._set_conveyors(command)
            case kind if kind in MOTION_COMMANDS:
                MOTION_COMMANDS[kind](self._world, self._index(command.name), command)
            case _:
                known = ", ".join((*_TYPES, "SetWP, AddWP, ClearWP, Rotate"))
                raise PeerError(f"no CONTROL of type {clip(command.type)}; known: {known}")
        return None

    def _status(self, command: Control) -> Message:
        segments: list[Segment] = []
        wanted = class_of(command.class_name)
        for index, thing in enumerate(self._world.scene.arena.loose):
            about = self._world.created.get(thing.name.lower(), ARENA_OBJECT)
            if about.is_of(wanted) and command.name.lower() in ("", thing.name.lower()):
                segments += self._described(index, thing.name)
        return Message("STA", tuple(segments))

    def _described(self, index: int, name: str) -> list[Segment]:
        row = self._world.loose_poses()[index]
        size, (location, rotation) = self._size(index, row[3:]), wire_pose(row[:3], row[3:])
        return [
            # A name with blanks would be read as several words by clients.
            ("Name", "_".join(name.split()) or "_"),
            ("Size", four_decimals_list((size[0], size[1], -size[2]))),
            ("Location", four_decimals_list(location)),
            ("Rotation", four_decimals_list(rotation)),
        ]

    def _pose(self, robot: Robot) -> np.ndarray:
        """Return position [m] and orientation of a robot (7,)."""
        state = self._world.state(robot)
        return np.concatenate([np.asarray(state.pos, float), np.asarray(state.quat, float)])

    def _size(self, index: int, quat: np.ndarray) -> list[float]:
        """Return the lengths of the box along the world's axes around an object that is turned so [m]."""
        with numpy_backend():
            mat = np.asarray(mat_from_quat(quat), float)
        scene = self._world.scene
        loose, boxes = scene.loose_geoms, scene.model.geom_aabb
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for piece in np.flatnonzero(loose.owner == index):
            box = boxes[loose.local.geom[piece]]
            turn = mat @ loose.local.mat[piece]
            middle = mat @ loose.local.pos[piece] + turn @ box[:3]
            # The absolute matrix gives the half lengths of a turned box along the world's axes.
            half = np.abs(turn) @ box[3:]
            low, high = np.minimum(low, middle - half), np.maximum(high, middle + half)
        return (high - low).tolist()

    def _names(self) -> list[str]:
        """Return the names of all objects in lower case, by index."""
        return [thing.name.lower() for thing in self._world.scene.arena.loose]

    def _index(self, name: str) -> int:
        """Return the index of an object.

        Raises:
            PeerError: None has that name.
        """
        names = self._names()
        if name.lower() not in names:
            raise PeerError(f"no object here is called {clip(name)}")
        return names.index(name.lower())

    def _create(self, command: Control) -> None:
        world, key = self._world, command.name.lower()
        if not is_name(command.name):
            raise PeerError("Create needs a Name of one word")
        if key in (*self._names(), *names_of_robots(world)):
            raise PeerError(f"{clip(command.name)} is here already")
        if len(world.created) >= MAX_OBJECTS:
            raise PeerError(f"there are {MAX_OBJECTS} objects already")
        x, y, z = flip_wire_vector(command.location or _ORIGIN)
        # Positions in an arena are above its floor, those on the wire are not.
        place, angles = (x, y, z - world.arena.floor), flip_wire_angles(command.rotation or _ORIGIN)
        if command.start:
            # A start pose is above the floor already, as all positions in an arena.
            start = start_of(world.arena, command.start)
            place, angles = start.at, start.angles
        world.check_position((*place[:2], place[2] + world.arena.floor))
        scale = command.scale if command.scale is not None and any(command.scale) else UNIT_SCALE
        thing = make_object(command.class_name, command.name, place, angles, scale)
        world.add_loose(thing, held=command.physics.lower() not in FREE_PHYSICS)
        world.created[key] = CreatedObject(class_of(command.class_name), command.permanent)

    def _set_conveyors(self, command: Control) -> None:
        """Set the speed of all conveyors of a name, as a share of their own; below 0 they run backwards."""
        name, share = command.name, command.share
        belts = [shape.conveyor for shape in self._world.scene.arena.shapes if shape.conveyor is not None]
        speeds = [max(map(abs, belt.velocity)) for belt in belts if belt.name.lower() == name.lower()]
        if not speeds:
            known = ", ".join(sorted({belt.name for belt in belts})) or "none"
            raise PeerError(f"no conveyor here is called {clip(name)}; there are: {known}")
        if share is None:
            raise PeerError("Conveyor needs a Speed, as a share of the conveyor's own")
        fastest = max(speeds) * abs(share)
        if fastest > MAX_BELT_SPEED:
            raise PeerError(f"{clip(name)} would run at {fastest:g} m/s; at most {MAX_BELT_SPEED:g}")
        self._world.set_conveyors(name, share)

    def _kill(self, name: str) -> None:
        if name.lower() not in self._world.created:
            raise PeerError(f"no object {clip(name)} was created")
        self._world.remove_loose(self._names().index(name.lower()))
        del self._world.created[name.lower()]
        # `advance_objects` looks up each moving object, and would fail with one that is gone.
        self._world.motions.pop(name.lower(), None)

    def _kill_all(self, corners: tuple[Vec3, Vec3] | None) -> None:
        """Remove all created objects that are not permanent, or only those between two corners."""
        world, poses = self._world, self._world.loose_poses()
        ends = None if corners is None or corners[0] == corners[1] else corners
        # Names and poses are taken once before: each removal shifts the indices of the objects behind it.
        for name, row in zip(self._names(), poses, strict=True):
            about = world.created.get(name, ARENA_OBJECT)
            # The corners are in the wire's axes, and so is the comparison: a box of ours would have them
            # swapped.
            place = flip_wire_vector(row[:3])
            is_inside = ends is None or all(
                low < value < high for low, value, high in zip(ends[0], place, ends[1], strict=True)
            )
            if is_inside and not about.is_permanent:
                self._kill(name)

    def _move(self, command: Control, *, relative: bool) -> None:
        world = self._world
        pos, angles = command.location or _ORIGIN, command.rotation or _ORIGIN
        by, turn = np.array(flip_wire_vector(pos)), np.array(flip_wire_angles(angles))
        names = self._names()
        robot = next((one for one in world.robots.values() if one.name.lower() == command.name.lower()), None)
        index = names.index(command.name.lower()) if command.name.lower() in names else None
        if index is None and robot is None:
            raise PeerError(f"nothing here is called {clip(command.name)}")
        if relative:
            row = self._pose(robot) if index is None and robot is not None else world.loose_poses()[index]
            by, turn = row[:3] + by, angles_of(row[3:]) + turn
        place: Vec3 = (float(by[0]), float(by[1]), float(by[2]))
        world.check_position(place)
        roll, pitch, yaw = map(float, turn)
        quat = np.asarray(quat_from_angles(roll, pitch, yaw))
        if index is not None:
            world.move_loose(index, place, quat)
            # Otherwise the next step of its rotation would turn it back.
            if command.name.lower() in world.motions:
                world.motions[command.name.lower()].angles = turn
        elif robot is not None:
            world.move_robot(robot, place, quat)
