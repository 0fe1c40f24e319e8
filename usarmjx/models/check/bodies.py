"""Checks of solids that overlap or float: victims, doors that do not turn, starts side by side."""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import mujoco
import numpy as np

from usarmjx.models.check.probe import GroundFinder, solid_name
from usarmjx.models.compile.compose import ARENA_PREFIX, DOOR_PREFIX, VICTIM_PREFIX, new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.victims import box_names
from usarmjx.models.types.arena import ArenaSpec, Door, StartPose, Victim
from usarmjx.models.types.robot import RobotSpec

MAX_BODY_PENETRATION, MAX_LIMB_PENETRATION = 0.05, 0.15
"""Largest depth of a victim's trunk and of its limbs in a solid, as they lean on walls [m]."""
TRUNK = ("Pelvis", "Chest", "Head")
MAX_FALL = 0.1
"""Largest height of the lowest part of a victim above the ground [m]."""
MAX_DOOR_PENETRATION = 0.02
"""Largest depth of a closed door in its frame [m]."""
MIN_DOOR_OPENING = math.radians(30)
"""Angle by which a door must turn to one side [rad]."""
DOOR_STEP = math.radians(3)
"""Angle between two tests of a turning door [rad]."""
MAX_LISTED_PAIRS = 3
"""Number of pairs of starts that are listed."""
SOLID_KINDS = (
    mujoco.mjtGeom.mjGEOM_BOX,
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_CAPSULE,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    mujoco.mjtGeom.mjGEOM_MESH,
)
"""Geom types whose distance to others `mj_geomDistance` computes."""


def check_close_starts(arena: ArenaSpec, robot: RobotSpec) -> Iterator[str]:
    """Yield pairs of start poses that two of the robots cannot take at once."""
    length, width, height = robot.dimensions
    pairs = itertools.combinations(arena.starts, 2)
    found = [
        (one, other)
        for one, other in pairs
        if abs(one.at[2] - other.at[2]) < height and _overlap(one, other, length / 2, width / 2)
    ]
    for one, other in found[:MAX_LISTED_PAIRS]:
        apart = math.dist(one.at[:2], other.at[:2])
        yield (
            f"starts {one.tag!r} and {other.tag!r} are {apart:.2f} m apart, too near for two robots: "
            f"a {robot.name} is {length:.2f} m long and {width:.2f} m wide"
        )
    if len(found) > MAX_LISTED_PAIRS:
        yield f"{len(found) - MAX_LISTED_PAIRS} more pairs of starts are too near for two {robot.name}s"


def _overlap(one: StartPose, other: StartPose, length: float, width: float) -> bool:
    """Return whether rectangles of these half lengths overlap at two poses, by their separating axes."""
    way = np.subtract(other.at[:2], one.at[:2])
    if math.hypot(*way) > 2 * math.hypot(length, width):
        return False
    axes = [
        np.array([math.cos(p.yaw + t), math.sin(p.yaw + t)]) for p in (one, other) for t in (0, math.pi / 2)
    ]
    for axis in axes:
        reach = sum(abs(half * (axis @ side)) for half, side in zip((length, width) * 2, axes, strict=True))
        if abs(way @ axis) >= reach:
            return False
    return True


class BodyProbe:
    """The arena on C MuJoCo without robots.

    Args:
        arena: The arena, which can be built.
    """

    def __init__(self, arena: ArenaSpec) -> None:
        self._arena = replace(arena, loose=())
        self._model = new_spec(self._arena, Physics()).compile()
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        self._names: list[str] = [self._model.geom(i).name for i in range(self._model.ngeom)]
        touched = (self._model.geom_contype != 0) & np.isin(self._model.geom_type, SOLID_KINDS)
        self._solids = [
            i for i, name in enumerate(self._names) if touched[i] and name.startswith(ARENA_PREFIX)
        ]

    def check_victims(self) -> Iterator[str]:
        """Yield victims that are in solids, in the air or below the ground."""
        # Bones whose scale is 0 have no box.
        table = box_names(self._arena.victims, self._arena.false_alarms)
        ground = GroundFinder(self._model, self._data, ignore=VICTIM_PREFIX)
        for victim in self._arena.victims:
            parts = {
                self._names.index(f"{VICTIM_PREFIX}{i}"): name.rpartition("/")[2]
                for i, name in enumerate(table)
                if name.rpartition("/")[0] == victim.name
            }
            if parts:
                yield from self._in_solids(victim, parts)
                yield from self._over_ground(victim, parts, ground)

    def _in_solids(self, victim: Victim, parts: Mapping[int, str]) -> Iterator[str]:
        """Yield the deepest overlap of a victim with a fixed solid, if too deep."""
        found: list[tuple[float, int]] = []
        for part, bone in parts.items():
            depth, solid = self._deepest(part)
            if depth > (MAX_BODY_PENETRATION if bone in TRUNK else MAX_LIMB_PENETRATION):
                found.append((depth, solid))
        if found:
            depth, solid = max(found)
            where = solid_name(self._arena, self._names[solid])
            yield f"victim {victim.name!r} is {depth:.2f} m deep in {where}"

    def _over_ground(self, victim: Victim, parts: Mapping[int, str], ground: GroundFinder) -> Iterator[str]:
        """Yield a victim that floats, or is below the floor; victims in water may do either."""
        gaps: list[float] = []
        floor = self._arena.floor
        for part in parts:
            x, y, z = (float(v) for v in self._data.geom_xpos[part])
            half = float(np.abs(self._data.geom_xmat[part].reshape(3, 3)[2]) @ self._model.geom_size[part])
            under = ground.below((x, y, z))
            gaps.append(math.inf if under is None else z - half - under)
        if any(all(w.low[k] <= victim.at[k] <= w.high[k] for k in range(3)) for w in self._arena.waters):
            return
        gap, low = min(gaps), min(float(self._data.geom_xpos[part][2]) for part in parts) - floor
        if self._arena.has_floor and low < 0.0:
            yield f"victim {victim.name!r} is {-low:.2f} m below the floor"
        elif gap == math.inf:
            yield f"victim {victim.name!r}: there is no ground under it"
        elif gap > MAX_FALL:
            yield f"victim {victim.name!r} hangs in the air, {gap:.2f} m above the ground"

    def check_doors(self) -> Iterator[str]:
        """Yield doors that are hung in solids or cannot turn."""
        for door in self._arena.doors:
            geom = self._names.index(f"{DOOR_PREFIX}{door.name}")
            depth, solid = self._deepest(geom)
            if depth > MAX_DOOR_PENETRATION:
                where = solid_name(self._arena, self._names[solid])
                yield f"door {door.name!r} hangs {depth:.2f} m deep in {where}: it cannot turn"
                continue
            low, high = (self._opening(door, geom, limit) for limit in door.limits)
            if max(low, high) < min(MIN_DOOR_OPENING, max(map(abs, door.limits))):
                widest = math.degrees(max(low, high))
                yield f"door {door.name!r} opens by {widest:.0f} degrees only: solids are in its way"

    def _opening(self, door: Door, geom: int, limit: float) -> float:
        """Return the angle that a door turns from closed towards a limit before a solid stops it [rad]."""
        address = int(self._model.joint(f"{DOOR_PREFIX}{door.name}").qposadr[0])
        angle, way = 0.0, math.copysign(1.0, limit)
        while angle < min(abs(limit), MIN_DOOR_OPENING):
            self._data.qpos[address] = way * min(angle + DOOR_STEP, abs(limit))
            mujoco.mj_kinematics(self._model, self._data)
            if self._deepest(geom)[0] > MAX_DOOR_PENETRATION:
                break
            angle += DOOR_STEP
        self._data.qpos[address] = 0.0
        mujoco.mj_kinematics(self._model, self._data)
        return min(angle, abs(limit))

    def _deepest(self, geom: int) -> tuple[float, int]:
        """Return the depth of a geom in a fixed solid, and that solid; 0 and -1 if it is in none."""
        model, data = self._model, self._data
        best = (0.0, -1)
        for solid in self._solids:
            # Bounding spheres first: mj_geomDistance is much slower, and most solids are far.
            apart = np.linalg.norm(data.geom_xpos[solid] - data.geom_xpos[geom])
            if apart > model.geom_rbound[solid] + model.geom_rbound[geom]:
                continue
            best = max(best, (-mujoco.mj_geomDistance(model, data, geom, solid, 0.0, None), solid))
        return best
