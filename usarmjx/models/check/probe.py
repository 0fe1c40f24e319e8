"""An arena on C MuJoCo with one robot: the ground under its start poses, and overlapping solids."""

from collections.abc import Iterator

import mujoco
import numpy as np

from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.compile.compose import (
    ARENA_PREFIX,
    DOOR_PREFIX,
    LOOSE_PREFIX,
    VICTIM_PREFIX,
    add_robot,
    new_spec,
)
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.victims import box_names
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose
from usarmjx.models.types.robot import RobotSpec

ELEVATION_TOLERANCE = 0.02
"""Tolerance of a start pose's height above the ground [m]; the wire rounds to 1 cm."""
MAX_PENETRATION, MAX_GROUND_PENETRATION = 0.02, 0.08
"""Largest initial depth of a robot in a solid, and in the ground [m]: robots start level on slopes."""
MAX_LOOSE_PENETRATION = 0.005
"""Largest depth of a loose object in another solid [m]."""
MAX_WATER_GAP = 0.1
"""Largest height of the lower end of a volume of water above the ground [m]."""
WALL_TOP = 0.8
"""Height from which on a wall is not meant to be stood on [m]."""
PARKED_HEIGHT = 1000.0
"""Height at which the robot is parked while it must not be in the way [m]."""
RAY_STEP = 1e-4
"""Distance by which a ray goes on below a solid that is visible but not touchable [m]."""


def format_position(*at: float) -> str:
    """Return a position as messages show it."""
    return ", ".join(f"{v:.4g}" for v in at)


def solid_name(arena: ArenaSpec, geom: str) -> str:
    """Return a geom's solid in words: its index in the arena, or its name."""
    if geom.startswith(ARENA_PREFIX):
        number = geom.removeprefix(ARENA_PREFIX).split("/")[0]
        shape = arena.shapes[int(number)]
        return f"shapes[{number}] ({shape.kind} at {format_position(*shape.at)})"
    if geom.startswith(LOOSE_PREFIX):
        return f"loose object {geom.removeprefix(LOOSE_PREFIX).rpartition('/')[0]!r}"
    if geom.startswith(DOOR_PREFIX):
        return f"door {geom.removeprefix(DOOR_PREFIX)!r}"
    if geom.startswith(VICTIM_PREFIX):
        names = box_names(arena.victims, arena.false_alarms)
        return f"victim {names[int(geom.removeprefix(VICTIM_PREFIX))].rpartition('/')[0]!r}"
    return f"the {geom}"


def in_water(arena: ArenaSpec, start: StartPose) -> bool:
    """Return whether a start pose is in water."""
    return any(
        all(low <= v <= high for low, v, high in zip(water.low, start.at, water.high, strict=True))
        for water in arena.waters
    )


class GroundFinder:
    """Finds the ground straight below a point.

    Args:
        model: A model with an arena.
        data: Its state.
        ignore: Prefix of the names of geoms that are no ground.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, ignore: str = "\0") -> None:
        self._model, self._data, self._ignore = model, data, ignore

    def below(self, at: tuple[float, float, float]) -> float | None:
        """Return the height of the first touchable solid below a point in the world [m]."""
        found = self.find(at)
        return None if found is None else found[0]

    def find(self, at: tuple[float, float, float]) -> tuple[float, str] | None:
        """Return height [m] and geom of the first touchable solid below a point in the world."""
        point, down = np.array(at), np.array([0.0, 0.0, -1.0])
        geom = np.zeros((1, 1), np.int32)
        while (distance := mujoco.mj_ray(self._model, self._data, point, down, None, 1, -1, geom)) >= 0:
            point = point + down * distance
            hit = int(geom[0, 0])
            name = self._model.geom(hit).name
            touched = self._model.geom_contype[hit] or self._model.geom_conaffinity[hit]
            if touched and not name.startswith(self._ignore):
                return float(point[2]), name
            point = point + down * RAY_STEP
        return None


class ArenaProbe:
    """The arena on C MuJoCo with one robot, which can be moved to any pose.

    Args:
        arena: The arena.
        robot: The robot's class.

    Raises:
        SpecError: The arena cannot be built.
    """

    def __init__(self, arena: ArenaSpec, robot: RobotSpec) -> None:
        self._arena, self._robot = arena, robot
        spec = new_spec(arena, Physics())
        add_robot(spec, robot, "robot/", (0.0, 0.0, PARKED_HEIGHT))
        self._model = spec.compile()
        self._root = int(self._model.joint("robot/root").qposadr[0])
        self._names: list[str] = [self._model.geom(i).name for i in range(self._model.ngeom)]
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)

    def check_starts(self) -> Iterator[str]:
        """Yield faults of start poses."""
        for start in self._arena.starts:
            name = f"start {start.tag!r}"
            if not in_water(self._arena, start):
                found = self._find_ground(start.at)
                if found is None:
                    yield f"{name}: there is no ground under it"
                    continue
                ground, geom = found
                if self._surface(geom) == "wall" and ground > WALL_TOP:
                    yield f"{name} is on top of {solid_name(self._arena, geom)}, which is a wall"
                if abs(start.at[2] - ground - START_ELEVATION) > ELEVATION_TOLERANCE:
                    yield (
                        f"{name} is {start.at[2] - ground:.3f} m above the ground under it, not "
                        f"{START_ELEVATION} (manual 5.3.5): its z should be {ground + START_ELEVATION:.3f}"
                    )
            for solid, depth in self._inside(start).items():
                yield f"{name}: a {self._robot.name} stands {depth:.2f} m deep in {solid}"

    def check_loose(self) -> Iterator[str]:
        """Yield overlaps of loose objects."""
        self._set_robot_pose((0.0, 0.0, PARKED_HEIGHT), 0.0)
        for (one, other), depth in self._contacts().items():
            if depth > MAX_LOOSE_PENETRATION and LOOSE_PREFIX in (
                one[: len(LOOSE_PREFIX)],
                other[: len(LOOSE_PREFIX)],
            ):
                pair = sorted((one, other), key=lambda name: not name.startswith(LOOSE_PREFIX))
                first, second = (solid_name(self._arena, name) for name in pair)
                yield f"{first} lies {depth:.3f} m deep in {second}"

    def check_waters(self) -> Iterator[str]:
        """Yield faults of water."""
        for i, water in enumerate(self._arena.waters):
            x, y = ((a + b) / 2 for a, b in zip(water.low[:2], water.high[:2], strict=True))
            ground = self._ground((x, y, water.low[2] + RAY_STEP))
            if ground is None:
                yield f"waters[{i}] has no ground under its middle: a body that sinks there sinks forever"
            elif water.low[2] - ground > MAX_WATER_GAP:
                yield f"waters[{i}] ends {water.low[2] - ground:.2f} m above the ground"

    def _set_robot_pose(self, at: tuple[float, float, float], yaw: float) -> None:
        self._data.qpos[self._root : self._root + 7] = (*at, *quat_from_angles(0.0, 0.0, yaw))
        mujoco.mj_forward(self._model, self._data)

    def _ground(self, at: tuple[float, float, float]) -> float | None:
        """Return the height of the first touchable solid below a point, in the arena's axes."""
        found = self._find_ground(at)
        return None if found is None else found[0]

    def _find_ground(self, at: tuple[float, float, float]) -> tuple[float, str] | None:
        """Return height, in the arena's axes, and geom of the first touchable solid below a point."""
        self._set_robot_pose((0.0, 0.0, PARKED_HEIGHT), 0.0)
        found = GroundFinder(self._model, self._data).find((at[0], at[1], at[2] + self._arena.floor))
        return None if found is None else (found[0] - self._arena.floor, found[1])

    def _inside(self, start: StartPose) -> dict[str, float]:
        """Return the solids that overlap the robot at a start pose, with their depths."""
        x, y, z = start.at
        height = self._arena.floor + z - START_ELEVATION + kinematic_tree_of(self._robot).clearance
        self._set_robot_pose((x, y, height), start.yaw)
        found: dict[str, float] = {}
        for pair, depth in self._contacts().items():
            others = [name for name in pair if not name.startswith("robot/")]
            if len(others) == 1 and depth > self._bearable(others[0]):
                solid = solid_name(self._arena, others[0])
                found[solid] = max(depth, found.get(solid, 0.0))
        return found

    def _surface(self, geom: str) -> str:
        """Return the surface of a fixed solid; "" of anything else."""
        if not geom.startswith(ARENA_PREFIX):
            return ""
        return self._arena.shapes[int(geom.removeprefix(ARENA_PREFIX).split("/")[0])].surface

    def _bearable(self, geom: str) -> float:
        """Return the largest depth in a solid at which a robot may start."""
        return MAX_GROUND_PENETRATION if self._surface(geom) == "ground" else MAX_PENETRATION

    def _contacts(self) -> dict[tuple[str, str], float]:
        """Return the pairs of geoms in contact, with their depths."""
        found: dict[tuple[str, str], float] = {}
        for contact in self._data.contact:
            one, other = (self._names[int(geom)] for geom in contact.geom)
            found[one, other] = max(-float(contact.dist), found.get((one, other), 0.0))
        return found
