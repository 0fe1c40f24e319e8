"""The later versions' world controller: a client without a robot that moves what is in the world.

    INIT {ClassName USARBot.WorldController} {Name W}
    CONTROL {Type GetSTA}                             STA {Name crate} {Size 0.06,0.06,-0.06} {Location ...} {Rotation ...}
    CONTROL {Type AbsMove} {Name crate} {Location 1,2,-0.1} {Rotation 0,0,1.57}
    CONTROL {Type RelMove} {Name R1} {Location 0.5,0,0}

Names are those of loose objects of the arena, then of robots. Keys, axes and signs are WorldController.uc's;
the z of a size is negative there, as all lengths downward are. Nothing answers a move.
"""  # noqa: E501 - an answer is one line

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import PeerError
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import Vec3, angles_from_mat, quat_from_angles
from usarmjx.server.protocol.commands import Control
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.protocol.grammar import Message, Segment, clip, four_decimals_list
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.server.worlds.wire_pose import wire_pose

CLASS_NAME = "WorldController"
"""Class that INIT names."""
OBJECT_CLASSES = ("", "wcobject")
"""Classes of objects that GetSTA tells of, in lower case."""
_ORIGIN: Vec3 = (0.0, 0.0, 0.0)


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
            UsageError: The world cannot move it, or has no room there.
        """
        match command.type.lower():
            case "getsta":
                return self._status(command)
            case "absmove":
                self._move(command, relative=False)
            case "relmove":
                self._move(command, relative=True)
            case _:
                raise PeerError(f"no CONTROL of type {clip(command.type)}; known: GetSTA, AbsMove, RelMove")
        return None

    def _status(self, command: Control) -> Message:
        segments: list[Segment] = []
        if command.class_name.rpartition(".")[2].lower() in OBJECT_CLASSES:
            for index, thing in enumerate(self._world.scene.arena.loose):
                if command.name.lower() in ("", thing.name.lower()):
                    segments += self._described(index, thing.name)
        return Message("STA", tuple(segments))

    def _described(self, index: int, name: str) -> list[Segment]:
        row = self._world.loose_poses()[index]
        size, (location, rotation) = self._size(index, row[3:]), wire_pose(row[:3], row[3:])
        return [
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
            half = np.abs(turn) @ box[3:]
            low, high = np.minimum(low, middle - half), np.maximum(high, middle + half)
        return (high - low).tolist()

    def _move(self, command: Control, *, relative: bool) -> None:
        world = self._world
        pos, angles = command.location or _ORIGIN, command.rotation or _ORIGIN
        by, turn = np.array(flip_wire_vector(pos)), np.array(flip_wire_angles(angles))
        names = [thing.name.lower() for thing in world.scene.arena.loose]
        robot = next((one for one in world.robots.values() if one.name.lower() == command.name.lower()), None)
        index = names.index(command.name.lower()) if command.name.lower() in names else None
        if index is None and robot is None:
            raise PeerError(f"nothing here is called {clip(command.name)}")
        if relative:
            row = self._pose(robot) if index is None and robot is not None else world.loose_poses()[index]
            with numpy_backend():
                present = angles_from_mat(np.asarray(mat_from_quat(row[3:]), float))
            by, turn = row[:3] + by, present + turn
        place: Vec3 = (float(by[0]), float(by[1]), float(by[2]))
        world.check_position(place)
        roll, pitch, yaw = map(float, turn)
        quat = np.asarray(quat_from_angles(roll, pitch, yaw))
        if index is not None:
            world.move_loose(index, place, quat)
        elif robot is not None:
            world.move_robot(robot, place, quat)
