"""Checks of arenas, in sentences (plan, names, start poses, reachability, overlaps), and of a robot at rest.

Each check of an arena is a generator of sentences; its `ArenaProbe` is the arena on C MuJoCo with one robot.
It reports position and error distance, and never raises for a finding. Begin with `check_arena`.
"""

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.registry import is_name
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
from usarmjx.models.compile.reachability import footprint_of, reach_map, victims_reached
from usarmjx.models.compile.tags import MAX_RELEASED_ID
from usarmjx.models.compile.victims import box_names
from usarmjx.models.files.content import corners_of
from usarmjx.models.files.find_robot import find_robot
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import AUTOMATIC_TAG_ID, START_ELEVATION, ArenaSpec, Door, StartPose, Victim
from usarmjx.models.types.robot import HOLD_SUFFIX, RobotSpec

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
MAX_OVERHANG = 0.5
"""Largest overhang of a solid over the extent, as of an outer wall [m]."""
VICTIM_REACH = 1.0
"""Distance at which a victim counts as reached [m]."""
START_REACH = 0.3
"""Distance at which another start pose counts as reached [m]."""


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
        # No name begins with the default: then all geoms may be ground.
        self._model, self._data, self._ignore = model, data, ignore

    def below(self, at: tuple[float, float, float]) -> float | None:
        """Return the height of the first touchable solid below a point in the world [m]."""
        found = self.find(at)
        return None if found is None else found[0]

    def find(self, at: tuple[float, float, float]) -> tuple[float, str] | None:
        """Return height [m] and geom of the first touchable solid below a point in the world."""
        point, down = np.array(at), np.array([0.0, 0.0, -1.0])
        geom = np.zeros((1, 1), np.int32)
        # Rays meet looks and victims too: go on below these.
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
        # Compiled once with the robot: moving it is much faster than a model for each start.
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
            # In water a robot floats or dives: it needs no ground under it.
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
                # The loose object first: it is the one that the sentence is about.
                pair = sorted((one, other), key=lambda name: not name.startswith(LOOSE_PREFIX))
                first, second = (solid_name(self._arena, name) for name in pair)
                yield f"{first} lies {depth:.3f} m deep in {second}"

    def check_waters(self) -> Iterator[str]:
        """Yield faults of water."""
        for i, water in enumerate(self._arena.waters):
            x, y = ((a + b) / 2 for a, b in zip(water.low[:2], water.high[:2], strict=True))
            # From a little above its bottom, which may be the ground itself.
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
        # The robot is put on the ground under the pose: its wheels touch it.
        height = self._arena.floor + z - START_ELEVATION + kinematic_tree_of(self._robot).clearance
        self._set_robot_pose((x, y, height), start.yaw)
        found: dict[str, float] = {}
        for pair, depth in self._contacts().items():
            others = [name for name in pair if not name.startswith("robot/")]
            # Two: the robot has no part in it. None: it touches itself.
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
            # The distance of geoms that overlap is negative.
            found[one, other] = max(-float(contact.dist), found.get((one, other), 0.0))
        return found


def check_close_starts(arena: ArenaSpec, robot: RobotSpec) -> Iterator[str]:
    """Yield pairs of start poses that two of the robots cannot take at once."""
    length, width, height = robot.dimensions
    pairs = itertools.combinations(arena.starts, 2)
    found = [
        (one, other)
        for one, other in pairs
        # Starts of two storeys may lie one above the other.
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
    # Circles around both rectangles first: most pairs are far apart.
    if math.hypot(*way) > 2 * math.hypot(length, width):
        return False
    # Two for each rectangle are enough in the plane.
    axes = [
        np.array([math.cos(p.yaw + t), math.sin(p.yaw + t)]) for p in (one, other) for t in (0, math.pi / 2)
    ]
    for axis in axes:
        # Half the extents of both rectangles along the axis; they are apart where the way between them is
        # longer.
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
        # Loose objects move out of the way of doors and victims.
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
            # Half the height of the turned box.
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
            # One free way is enough, and doors with narrow limits need to reach only these.
            if max(low, high) < min(MIN_DOOR_OPENING, max(map(abs, door.limits))):
                widest = math.degrees(max(low, high))
                yield f"door {door.name!r} opens by {widest:.0f} degrees only: solids are in its way"

    def _opening(self, door: Door, geom: int, limit: float) -> float:
        """Return the angle that a door turns from closed towards a limit before a solid stops it [rad]."""
        address = int(self._model.joint(f"{DOOR_PREFIX}{door.name}").qposadr[0])
        angle, way = 0.0, math.copysign(1.0, limit)
        # No further: a door that turns by this angle passes, and each test looks at all solids.
        while angle < min(abs(limit), MIN_DOOR_OPENING):
            # Kinematics alone follow: distances need neither contacts nor forces.
            self._data.qpos[address] = way * min(angle + DOOR_STEP, abs(limit))
            mujoco.mj_kinematics(self._model, self._data)
            if self._deepest(geom)[0] > MAX_DOOR_PENETRATION:
                break
            angle += DOOR_STEP
        # Closed again: the next door is tested with this one at rest.
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
            # With a limit of 0 the result is 0 for solids that are apart: only depths count here.
            best = max(best, (-mujoco.mj_geomDistance(model, data, geom, solid, 0.0, None), solid))
        return best


def check_arena(arena: ArenaSpec, robot: str = "P2AT") -> list[str]:
    """Return the faults of an arena, a sentence each; empty: none was found.

    Checks: the plan (extent, names and IDs, items outside), each start pose for a robot of that class (ground
    under it, at the height of manual 5.3.5; no solid in the robot; room between two of them), reachability
    from the first start pose on ground (the others, the victims), loose objects and victims that lie in a
    solid or float in the air, doors that cannot turn, and water.

    Raises:
        UnknownNameError: No such robot class.
    """
    spec = find_robot(robot)
    found = [*_plan(arena), *_names(arena), *_tags(arena)]
    try:
        probe = ArenaProbe(arena, spec)
    except (SpecError, ValueError) as error:
        # A ValueError is MuJoCo's compiler's.
        return [*found, f"it cannot be built: {error}"]
    found += [*probe.check_starts(), *probe.check_loose(), *probe.check_waters()]
    bodies = BodyProbe(arena)
    found += [*check_close_starts(arena, spec), *bodies.check_victims(), *bodies.check_doors()]
    dry = [start for start in arena.starts if not in_water(arena, start)]
    if not dry or any(fault.startswith(f"start {dry[0].tag!r}") for fault in found):
        return found  # reachability starts from that pose
    return [*found, *_reach(arena, spec, dry)]


def _plan(arena: ArenaSpec) -> Iterator[str]:
    """Yield faults of the extent, and items outside it."""
    (x0, x1), (y0, y1) = arena.extent
    for i, shape in enumerate(arena.shapes):
        low, high = corners_of(shape)
        over = max(x0 - low[0], high[0] - x1, y0 - low[1], high[1] - y1)
        if over > MAX_OVERHANG:
            yield f"{solid_name(arena, f'{ARENA_PREFIX}{i}')} reaches {over:.2f} m over the extent; widen it"
    items = [(f"start {s.tag!r}", s.at) for s in arena.starts]
    items += [(f"victim {v.name!r}", v.at) for v in arena.victims]
    items += [(f"false alarm {i} ({a.part})", a.at) for i, a in enumerate(arena.false_alarms)]
    items += [(f"tag {i} (ID {tag.id})", tag.at) for i, tag in enumerate(arena.tags)]
    for name, (x, y, _) in items:
        if not (x0 <= x <= x1 and y0 <= y <= y1):
            yield f"{name} at {format_position(x, y)} is outside the extent"


def _names(arena: ArenaSpec) -> Iterator[str]:
    """Yield faults of names."""
    if not arena.starts:
        yield "it has no start pose"
    for tag, count in Counter(start.tag for start in arena.starts).items():
        if count > 1:
            yield f"{count} start poses are called {tag!r}"
        if not is_name(tag):
            yield f"start {tag!r}: a tag is one word of ASCII without braces: blanks separate them"
    for robot in arena.robots:
        if robot not in ROBOTS:
            yield f"recommended robot {robot!r} is unknown; `usarmjx list robots` shows them all"


def _tags(arena: ArenaSpec) -> Iterator[str]:
    """Yield faults of the IDs of tags."""
    given = Counter(tag.id for tag in arena.tags if tag.id != AUTOMATIC_TAG_ID)
    for number, count in given.items():
        if count > 1:
            yield f"{count} tags have the ID {number}"
        if number <= MAX_RELEASED_ID:
            yield f"a tag has the ID {number}; up to {MAX_RELEASED_ID} they belong to releasers"


def _reach(arena: ArenaSpec, robot: RobotSpec, dry: list[StartPose]) -> Iterator[str]:
    """Yield the starts and victims that a robot cannot reach from the first start pose on dry ground."""
    size = footprint_of(robot)
    found = reach_map(arena, size.radius, size.step, height=size.height, start=dry[0])
    if found.start_area < 0:
        yield f"start {dry[0].tag!r}: a {robot.name} has no room to turn there"
        return
    near = [found.reaches_within(*start.at, distance=START_REACH) for start in dry[1:]]
    far = [
        (f"start {s.tag!r}", s.at, START_REACH)
        for s, reached in zip(dry[1:], near, strict=True)
        if not reached
    ]
    touched = victims_reached(arena, found, VICTIM_REACH)
    far += [
        (f"victim {v.name!r}", v.at, VICTIM_REACH)
        for v, ok in zip(arena.victims, touched, strict=True)
        if not ok
    ]
    for name, (x, y, _), least in far:
        where = f"{name} at {format_position(x, y)}"
        yield f"{where}: a {robot.name} from {dry[0].tag!r} gets no nearer than {least} m"


SETTLING_TIME = 1.0
"""Time in which a robot comes to rest [s]."""
MAX_SETTLING = 0.005
"""Largest way to the place of rest [m]."""


def settling_distance(robot: RobotSpec) -> float:
    """Return the way of a robot's origin within a second after it is put on level ground [m].

    Its motors hold their joints, as before its first command.

    Raises:
        SpecError: It cannot be built.
    """
    spec = new_spec(ArenaSpec(name="nowhere", starts=(), extent=((-50, 50), (-50, 50))), Physics())
    add_robot(spec, robot, "", (0.0, 0.0, kinematic_tree_of(robot).clearance))
    model = spec.compile()
    data = mujoco.MjData(model)
    for actuator in range(model.nu):
        data.ctrl[actuator] = model.actuator(actuator).name.endswith(HOLD_SUFFIX)
    mujoco.mj_forward(model, data)
    chassis = model.body("chassis").id
    before = data.xpos[chassis].copy()
    for _ in range(round(SETTLING_TIME / model.opt.timestep)):
        mujoco.mj_step(model, data)
    way = float(np.linalg.norm(data.xpos[chassis] - before))
    # NaN, of physics that diverged, would compare as no fault.
    return way if np.isfinite(way) else np.inf


def robot_faults(robot: RobotSpec) -> list[str]:
    """Return the faults of a robot on level ground, in words."""
    way = settling_distance(robot)
    found: list[str] = []
    if way > MAX_SETTLING:
        found.append(
            f"it moves by {way * 1e3:.0f} mm within {SETTLING_TIME:g} s on level ground, more than "
            f"{MAX_SETTLING * 1e3:.0f} mm: it tips, or its legs give way"
        )
    wheels = [part for part in robot.wheels if part.motor is not None]
    if wheels and robot.wheel_radius <= 0:
        found.append("its wheels are not round: no cylinder, sphere or round mesh is about their axes")
    return found
