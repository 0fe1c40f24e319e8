"""Robots driven through arenas: lanes of the NIST test methods, generated obstacles, and all declared goals.

The driver follows points on C MuJoCo and sets flippers. It knows the true state and avoids nothing, so a
better one may pass where it fails.
"""

import itertools
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import mujoco
import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.random import RandomStream
from usarmjx.base.settings.json_file import as_mapping, read_json
from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.arenas.lanes import MobilityLane, lane_of
from usarmjx.models.arenas.pieces import CELL
from usarmjx.models.check import VICTIM_REACH, in_water
from usarmjx.models.compile.reachability import (
    DEFAULT_CELL_SIZE,
    ReachMap,
    footprint_of,
    reach_map,
    shapes_in_arena,
)
from usarmjx.models.drives.base import drive_values
from usarmjx.models.generate.obstacles import CROSSINGS_FILE, OBSTACLES, SuccessCurve, obstacle_height
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose, Victim
from usarmjx.models.types.robot import RobotSpec
from usarmjx.models.types.shapes import Position2D
from usarmjx.sim.control import CommandUpdate, idle_command, update_command
from usarmjx.sim.scene import build_scene, start_height
from usarmjx.sim.single_world import SingleWorld

Posture = Callable[[float], dict[str, float]]
"""From the pitch [rad], nose up positive, to angles of joints [rad]."""
FRONT, REAR = ("FRFlipper", "FLFlipper"), ("RRFlipper", "RLFlipper")
FRONT_RAISED_ANGLE = -0.6
"""Front flippers on level ground: tips up, to get onto what is ahead [rad]."""
MAX_PITCH = 0.6
"""Pitch from which on flippers do not move further [rad]."""


def crawl_posture(pitch: float) -> dict[str, float]:
    """Return flippers that are up ahead on level ground, flat in front and pressed down behind in a climb."""
    climb = min(max(pitch, 0.0), MAX_PITCH)
    return dict.fromkeys(FRONT, FRONT_RAISED_ANGLE + climb) | dict.fromkeys(REAR, -0.8 * climb)


def flipper_posture(robot: RobotSpec) -> Posture | None:
    """Return the function that sets a class's flippers; None: it has none."""
    return crawl_posture if {*FRONT, *REAR} <= {part.name for part in robot.parts} else None


ARRIVAL_DISTANCE = 0.25
"""Distance from a waypoint at which a robot has reached it [m]."""
STEERING_GAIN = 2.0
"""Steering for each radian that its heading is off."""
COMMAND_DURATION = 0.1
"""Duration of a command [s]."""
STUCK_TIMEOUT = 10.0
"""Time without progress after which a robot counts as stuck [s]."""
MIN_PROGRESS = 0.05
"""Nearer than this is nearer [m]."""
BACK_OFF_TIME = 1.5
"""Time for which a stuck robot drives back before it tries once more [s]."""
TIP_OVER_COS = math.cos(math.radians(80))
"""Least cosine of the tilt at which a robot is upright."""


@dataclass(frozen=True)
class DriveRun:
    """Result of a drive along a path.

    Attributes:
        reached: Points that it got to.
        seconds: Simulated time that it took [s].
        fault: "" if it got to all of them, else what stopped it.
    """

    reached: int
    seconds: float
    fault: str = ""


class Trial:
    """A robot alone in an arena.

    Args:
        arena: The arena.
        robot: Its class, which drives on the ground.
        share: Share of its top speed at which it is driven.

    Raises:
        UsageError: The class does not drive on the ground, or has no room at the first start pose.
    """

    def __init__(self, arena: ArenaSpec, robot: RobotSpec, share: float = 1.0) -> None:
        if robot.drive.steering not in ("SkidSteered", "AckermanSteered", "OmniDrive"):
            raise UsageError(f"a {robot.name} is not steered on the ground: no lane is for it")
        self._arena, self._robot, self._share = arena, robot, share
        self._posture = flipper_posture(robot)
        self._keys = robot.drive.full_scale
        # A single world and not a batch: nothing has to be compiled.
        self.world = SingleWorld(build_scene(arena, []), seats=1)
        self._period = self.world.scene.physics.period
        self._slot = self.world.add(robot, robot.name, [self._pose_at(arena.starts[0])])

    def _pose_at(self, start: StartPose) -> tuple[tuple[float, float, float], np.ndarray]:
        x, y, _ = start.at
        turned = np.array(quat_from_angles(0.0, 0.0, start.yaw))
        return (x, y, start_height(self._arena, start, self._robot)), turned

    def reset_to(self, start: StartPose) -> None:
        """Put the robot onto a start pose, at rest."""
        self.world.reset()
        pos, quat = self._pose_at(start)
        self.world.engine.place(self._index, np.array(pos), quat)

    @property
    def _index(self):  # noqa: ANN202 - a RobotIndex
        group, member = self.world.scene.group_of(self._slot)
        return self.world.scene.groups[group].indices[member]

    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Return position [m] (3,) and orientation (3, 3) of the robot."""
        pose, mat = self.world.engine.pose(self._index), np.zeros(9)
        mujoco.mju_quat2Mat(mat, pose[3:])
        return pose[:3], mat.reshape(3, 3)

    def command(self, ahead: float, left: float, pitch: float = 0.0) -> None:
        """Tell the robot to drive, as shares of its speed, with its flippers as its pitch [rad] asks for."""
        scene = self.world.scene
        group, _ = scene.group_of(self._slot)
        drive = drive_values(self._keys, ahead, left, 0.0, self._share)
        update = CommandUpdate(drive=drive, joints=self._posture(pitch) if self._posture else {})
        with numpy_backend():
            # From the idle command and not from the last one: nothing of the command before is left.
            robot_command = update_command(scene.groups[group].plan, idle_command(self._robot), update)
        self.world.edit(self._slot, command=robot_command)

    def advance(self, seconds: float) -> bool:
        """Let time pass; return whether the physics stayed sound."""
        # A list: on a generator `any` would stop stepping at the first fault.
        return not any([bool(self.world.step()) for _ in range(round(seconds / self._period))])

    def follow(
        self, path: Sequence[Position2D], seconds: float, arrival_distance: float = ARRIVAL_DISTANCE
    ) -> DriveRun:
        """Drive along points for a time at most [s]; the driver backs off once where it is stuck."""
        # By the world's time: the limit is of simulated seconds, whatever the machine's speed.
        began, reached, retried = self.world.time, 0, False
        closest, progress_time = math.inf, began
        while reached < len(path):
            pos, mat = self.pose()
            now = self.world.time
            if mat[2, 2] < TIP_OVER_COS:
                return DriveRun(reached, now - began, f"turned over at {_format_position(pos)}")
            offset = np.subtract(path[reached], pos[:2])
            distance = float(np.linalg.norm(offset))
            if distance < arrival_distance:
                reached, closest, progress_time, retried = reached + 1, math.inf, now, False
                continue
            # A margin, or a robot that rocks in place would seem to get nearer for ever.
            if distance < closest - MIN_PROGRESS:
                closest, progress_time = distance, now
            if now - began >= seconds:
                return DriveRun(reached, now - began, f"out of time at {_format_position(pos)}")
            if now - progress_time > STUCK_TIMEOUT:
                if retried:
                    return DriveRun(reached, now - began, f"stuck at {_format_position(pos)}")
                # Once per waypoint: `retried` is cleared when one is reached.
                retried, progress_time = True, now
                self.command(-1.0, 0.0)
                self.advance(BACK_OFF_TIME)
                continue
            self._steer(offset, mat)
            if not self.advance(COMMAND_DURATION):
                return DriveRun(reached, self.world.time - began, f"was recovered at {_format_position(pos)}")
        return DriveRun(reached, self.world.time - began)

    def _steer(self, offset: np.ndarray, mat: np.ndarray) -> None:
        """Head for a point that lies `offset` [m] (2,), slower ahead the sharper the turn."""
        forward = mat[:2, 0]
        # The signed angle, by cross and scalar product: no difference of angles has to be wrapped.
        error = math.atan2(forward[0] * offset[1] - forward[1] * offset[0], float(forward @ offset))
        turn = max(-1.0, min(1.0, STEERING_GAIN * error))
        # Far off its heading it turns on the spot: driving ahead would lead away from the path.
        ahead = max(0.0, 1.0 - abs(turn) / 2) if abs(error) < math.pi / 3 else 0.0
        # The height of the nose over its length is the sine of the pitch.
        self.command(ahead, turn, math.asin(max(-1.0, min(1.0, float(mat[2, 0])))))

    def stop(self) -> None:
        """Let the robot come to rest."""
        self.command(0.0, 0.0)
        self.advance(0.5)


def _format_position(pos: np.ndarray) -> str:
    return f"{pos[0]:.2f}, {pos[1]:.2f}"


MAX_FAULTS = 3
"""Faults after which a test ends."""


@dataclass(frozen=True)
class LaneScore:
    """Result of a robot in a lane.

    Attributes:
        lane: The lane.
        robot: Name of its class.
        seconds: Simulated time that counted [s].
        repetitions: Traverses with the whole robot from one end to the other; there and back in lanes where
            that is one.
        faults: Reasons why traverses did not count; after each the robot starts again.
    """

    lane: MobilityLane
    robot: str
    seconds: float
    repetitions: int
    faults: tuple[str, ...] = ()

    @property
    def per_minute(self) -> float:
        """Repetitions per minute."""
        return 60.0 * self.repetitions / self.seconds if self.seconds else 0.0

    @property
    def metres_per_minute(self) -> float:
        """Length of lane in counted repetitions, per minute [m/min]."""
        return self.per_minute * self.lane.length * (2 if self.lane.round_trip else 1)

    def __str__(self) -> str:
        """Return the score as a line."""
        return (
            f"{self.lane.arena.name} ({self.lane.method}), {self.robot}: {self.repetitions} repetitions in "
            f"{self.seconds / 60:.1f} min, {self.per_minute:.2f}/min, {self.metres_per_minute:.2f} m/min, "
            f"{len(self.faults)} faults"
        )


def run_lane(
    lane: MobilityLane,
    robot: RobotSpec,
    minutes: float = 5.0,
    share: float = 1.0,
    max_repetitions: int | None = None,
) -> LaneScore:
    """Drive a robot to and fro in a lane and return its score.

    Args:
        lane: The lane.
        robot: The robot's class.
        minutes: Duration [min].
        share: Share of its top speed.
        max_repetitions: Repetitions after which the test is over; None: only time ends it.

    Raises:
        UsageError: The class does not drive on the ground.
    """
    trial, starts = Trial(lane.arena, robot, share), lane.arena.starts
    faults: list[str] = []
    remaining, traverses, end = 60.0 * minutes, 0, 0
    legs = 2 if lane.round_trip else 1
    while (
        remaining > 0
        and len(faults) < MAX_FAULTS
        and (max_repetitions is None or traverses // legs < max_repetitions)
    ):
        run = trial.follow(lane.way(back=bool(end)), remaining)
        remaining -= run.seconds
        if not run.fault:
            traverses, end = traverses + 1, 1 - end
            continue
        # The end of the time is no fault of the robot.
        if remaining <= 0:
            break
        faults.append(run.fault)
        # Half a round trip before a fault does not count.
        traverses -= traverses % legs
        end = 0 if lane.round_trip else end
        trial.reset_to(starts[end])
    seconds = 60.0 * minutes - max(remaining, 0.0)
    return LaneScore(lane, robot.name, seconds, traverses // legs, tuple(faults))


OBSTACLES_PER_LANE = 3
"""Obstacles one behind the other, a bare cell between two, as in rings."""
TIME_LIMIT = 60.0
"""For one crossing of them [s]."""
LEVELS = (0.3, 0.5, 0.7, 0.85, 0.95, 1.1, 1.3, 1.6, 2.0, 2.5, 3.0, 3.6)
"""Heights at which success is measured, over the robot's step."""
MIN_SUCCESS = 0.2
"""Once no more than this share of the drives succeeds, nothing higher is tried."""
MAX_LATERAL_OFFSET, MAX_YAW_OFFSET = 0.12, 0.2
"""Largest offset of perturbed drives from the middle of the lane [m], and from its direction [rad]."""
MIN_SPEED_SHARE, MIN_FRICTION_SHARE = 0.6, 0.6
"""They have at least this share of the top speed, and of everything's friction."""


@dataclass(frozen=True)
class Crossings:
    """Result of a robot at obstacles of one kind and roughness.

    Attributes:
        kind: A name of `generate.obstacles.OBSTACLES`.
        roughness: From 0 to 1.
        tries: Lanes with other draws that it was sent through once each.
        crossed: Number of lanes that it crossed.
        seconds: Mean simulated time of those [s].
    """

    kind: str
    roughness: float
    tries: int
    crossed: int
    seconds: float


def measure_crossings(
    kind: str, robot: RobotSpec, roughness: float, tries: int = 4, scale: float = 1.0
) -> Crossings:
    """Send a robot through lanes of three obstacles, each once.

    Args:
        kind: A name of `OBSTACLES`.
        robot: The robot's class, to which they are sized.
        roughness: Height, from 0 to 1.
        tries: Number of lanes, each of other draws.
        scale: Factor on the step that the robot is rated to climb.

    Raises:
        UnknownNameError: No such kind.
        UsageError: The class does not drive on the ground.
    """
    height = scale * obstacle_height(footprint_of(robot), roughness)
    lanes = obstacle_lanes(kind, height, tries)
    runs = [Trial(lane.arena, robot).follow([*lane.way(back=False)], TIME_LIMIT) for lane in lanes]
    times = [run.seconds for run in runs if not run.fault]
    mean = sum(times) / len(times) if times else 0.0
    return Crossings(kind, roughness, tries, len(times), mean)


def obstacle_lanes(kind: str, height: float, count: int) -> Iterator[MobilityLane]:
    """Yield lanes with three obstacles of a height [m] one behind the other, each of other draws.

    Raises:
        UnknownNameError: No such kind.
    """
    make = OBSTACLES.get(kind)
    for number in range(count):
        # A stream of its own for each lane: lane k is the same whatever the number of tries.
        draw = RandomStream(number, f"{kind} to cross")
        shapes = [
            shape
            for i in range(OBSTACLES_PER_LANE)
            for shape in make(draw, ((2 * i + 0.5) * CELL, 0.0), height, 0)
        ]
        yield lane_of(
            kind, "not a test method", f"Obstacles: {kind}", (2 * OBSTACLES_PER_LANE - 1) * CELL, *shapes
        )


def measure_success(robot: RobotSpec, kind: str, drives: int) -> list[tuple[float, float]]:
    """Send a robot over three obstacles often, each time from elsewhere, at another speed, on other ground.

    Args:
        robot: The robot's class.
        kind: A name of `OBSTACLES`.
        drives: Number of drives at each height.

    Returns:
        Heights over the robot's step, and the share of the drives that got over them; until hardly any does.

    Raises:
        UsageError: The class does not drive on the ground.
    """
    curve: list[tuple[float, float]] = []
    for level in LEVELS:
        lanes = obstacle_lanes(kind, level * footprint_of(robot).step, drives)
        crossed = sum(_crosses_perturbed(lane, robot, number) for number, lane in enumerate(lanes))
        curve.append((level, crossed / drives))
        # Higher obstacles can only be harder, and a hopeless drive takes the whole time limit.
        if curve[-1][1] <= MIN_SUCCESS:
            break
    return curve


def write_success(robot: RobotSpec, drives: int, path: Path) -> None:
    """Measure success of a robot at all kinds of obstacles; the file keeps what it has of other classes.

    Raises:
        UsageError: The class does not drive on the ground, or the file is another one.
        WriteError: The file cannot be written.
    """
    kept = _measured_before(path) if path.exists() else {}
    kept[robot.name] = {kind: measure_success(robot, kind, drives) for kind in OBSTACLES.names()}
    with atomic_write(path) as fresh:
        fresh.write_text(success_text(kept, drives), encoding="utf-8")


def _measured_before(path: Path) -> dict[str, Any]:
    """Return the curves in a file by class and kind.

    Raises:
        UsageError: It holds none.
    """
    content = as_mapping(read_json(path, UsageError, finite=True)) or {}
    held = as_mapping(content.get("classes"))
    # None, in the place of classes that are missing, fails the test below.
    for kinds in [None] if held is None else held.values():
        curves = as_mapping(kinds)
        if curves is None or not all(_is_curve(curve) for curve in curves.values()):
            raise UsageError(f"{path} holds no measured success; give a new file")
    return held or {}


def _is_curve(curve: object) -> bool:
    """Return whether a value is a list of pairs of a level and a rate."""
    pairs = cast("list[Any]", curve) if isinstance(curve, list) else [None]
    numbers = [cast("list[Any]", pair) if isinstance(pair, list) else [] for pair in pairs]
    return all(len(pair) == 2 and all(type(one) in (int, float) for one in pair) for pair in numbers)


def success_text(classes: Mapping[str, Mapping[str, SuccessCurve]], drives: int) -> str:
    """Return measured success as JSON with a line for each class and kind."""
    rows = {
        name: ",\n".join(f"   {json.dumps(kind)}: {json.dumps(curve)}" for kind, curve in found.items())
        for name, found in sorted(classes.items())
    }
    listed = ",\n".join(f"  {json.dumps(name)}: {{\n{row}\n  }}" for name, row in rows.items())
    command = f"usarmjx arena obstacles --robot CLASS --tries {drives} --write {CROSSINGS_FILE}"
    return f'{{\n "command": {json.dumps(command)},\n "classes": {{\n{listed}\n }}\n}}\n'


def _crosses_perturbed(lane: MobilityLane, robot: RobotSpec, number: int) -> bool:
    """Return whether a robot crosses a lane; a seed draws its start pose, speed and friction."""
    rng = np.random.default_rng(number)
    trial = Trial(lane.arena, robot, rng.uniform(MIN_SPEED_SHARE, 1.0))
    # In the compiled model: sliding friction alone, of robot and ground alike.
    trial.world.engine.model.geom_friction[:, 0] *= rng.uniform(MIN_FRICTION_SHARE, 1.0)
    start = lane.arena.starts[0]
    x, y, z = start.at
    lateral_offset, yaw_offset = (
        rng.uniform(-MAX_LATERAL_OFFSET, MAX_LATERAL_OFFSET),
        rng.uniform(-MAX_YAW_OFFSET, MAX_YAW_OFFSET),
    )
    position = (x - lateral_offset * math.sin(start.yaw), y + lateral_offset * math.cos(start.yaw), z)
    trial.reset_to(replace(start, at=position, yaw=start.yaw + yaw_offset))
    return not trial.follow([*lane.way(back=False)], TIME_LIMIT).fault


FINE_CELL_SIZE = 0.02
"""Side of the squares of a plan where a robot fits narrowly [m]."""
WAYPOINT_SPACING = 0.3
"""Distance of the points that a robot is driven along [m]."""
MIN_ROUTE_SPEED_SHARE = 0.1
"""Share of its top speed at which a robot gets on at least, else it is out of time."""
EXTRA_TIME = 15.0
"""Time besides the drive itself, for turning and backing off [s]."""
BORDER_DISTANCE, BORDER_COST = 0.1, 3.0
"""Ways keep away from where a robot does not fit: so far [m], and what they give for it."""


class RouteSegment(NamedTuple):
    """A path between two points of an arena.

    Attributes:
        goal: Name of its end: "start 'B'".
        path: Points [m].
        length: Length [m].
        home: Start pose to continue from if the robot does not arrive.
    """

    goal: str
    path: tuple[Position2D, ...]
    length: float
    home: StartPose


@dataclass(frozen=True)
class ArenaRoute:
    """Result of a drive round an arena.

    Attributes:
        segments: Ways that it was sent.
        metres: Length of those that it made [m].
        seconds: Simulated time of those [s].
        faults: A sentence for each way that it did not make.
    """

    segments: int
    metres: float
    seconds: float
    faults: tuple[str, ...]

    @property
    def success(self) -> float:
        """Share of the ways that it made."""
        return 1.0 - len(self.faults) / self.segments if self.segments else 1.0


def drive_arena(arena: ArenaSpec, robot: RobotSpec, share: float = 1.0) -> ArenaRoute:
    """Drive a robot from the first start pose on ground to all others and to victims, where a plan leads.

    Ways are planned with its size and the step that it should climb; whether it climbs, tips over or gets
    stuck is what is found out. After a fault it goes on from the next start pose.

    Args:
        arena: The arena.
        robot: Its class.
        share: Share of its top speed.

    Raises:
        UsageError: The class does not drive on the ground, or there is no start pose for it.
    """
    dry_starts = tuple(start for start in arena.starts if not in_water(arena, start))
    arena = replace(arena, starts=dry_starts or arena.starts)
    trial, segments = Trial(arena, robot, share), plan_segments(arena, robot)
    metres = seconds = 0.0
    faults: list[str] = []
    for segment in segments:
        # The lower bound keeps a class without a top speed from dividing by 0.
        limit = EXTRA_TIME + segment.length / (
            MIN_ROUTE_SPEED_SHARE * max(robot.drive.top_speed, 1e-3) * share
        )
        run = trial.follow(segment.path, limit)
        if run.fault:
            faults.append(f"{segment.goal}: a driven {robot.name} {_verb(run.fault)}")
            trial.reset_to(segment.home)
            continue
        metres, seconds = metres + segment.length, seconds + run.seconds
    return ArenaRoute(len(segments), metres, seconds, tuple(faults))


def _verb(fault: str) -> str:
    return f"is {fault}" if fault.startswith(("stuck", "out of")) else fault


def plan_segments(arena: ArenaSpec, robot: RobotSpec) -> list[RouteSegment]:
    """Return ways to all start poses and victims that a robot should reach, the nearest next."""
    finder = _PathFinder(arena, robot)
    goals = {f"start {start.tag!r}": (finder.node(start), start) for start in arena.starts[1:]}
    goals |= {f"victim {victim.name!r}": (finder.beside(victim), None) for victim in arena.victims}
    remaining = {name: (target, start) for name, (target, start) in goals.items() if target >= 0}
    segments: list[RouteSegment] = []
    node, home = finder.node(arena.starts[0]), arena.starts[0]
    while remaining and node >= 0:
        lengths, predecessors = finder.shortest_paths(node)
        # The nearest next, and not the shortest tour: a route is a test of ways, not of planning.
        name = min(remaining, key=lambda one: lengths[remaining[one][0]])
        target, start = remaining.pop(name)
        # The plan has no way there: that is a fault of the arena's check, not of the drive.
        if not math.isfinite(lengths[target]):
            continue
        home = start or home
        path = finder.path(predecessors, node, target)
        segments.append(RouteSegment(name, path, _length(path), home))
        node = target
    return segments


def _length(path: Sequence[Position2D]) -> float:
    return sum(math.dist(a, b) for a, b in itertools.pairwise(path))


class _PathFinder:
    """Shortest ways over the surfaces of an arena on which a robot has room to turn."""

    def __init__(self, arena: ArenaSpec, robot: RobotSpec) -> None:
        size = footprint_of(robot)
        # Fine squares take far longer, and are needed only where coarse ones close every gap.
        for cell in (DEFAULT_CELL_SIZE, FINE_CELL_SIZE):
            self.map: ReachMap = reach_map(arena, size.radius, size.step, height=size.height, cell=cell)
            if self.map.start_area >= 0:
                break
        self._free = (self.map.area == self.map.start_area) & (self.map.start_area >= 0)
        self._numbers = np.full(self._free.shape, -1)
        self._numbers[self._free] = np.arange(int(self._free.sum()))
        _, i, j = np.nonzero(self._free)
        low, cell = self.map.grid.low, self.map.grid.cell
        self._points = np.stack([low[0] + (i + 0.5) * cell, low[1] + (j + 0.5) * cell], -1)
        self._graph = self._edges()

    def _edges(self) -> Any:  # noqa: ANN401 - a sparse matrix of scipy
        # Here, as SciPy takes half a second to import and only routes need it.
        from scipy import ndimage, sparse  # pyright: ignore[reportMissingTypeStubs]

        csr_array, distance_transform_edt = (
            cast(Any, sparse).csr_array,
            cast(Any, ndimage).distance_transform_edt,
        )

        cell = self.map.grid.cell
        # Padded by a border where robots do not fit: the map's edge is as unwelcome as a wall.
        clearances = [
            np.asarray(distance_transform_edt(np.pad(layer, 1)))[1:-1, 1:-1] for layer in self._free
        ]
        cost = 1.0 + BORDER_COST * np.exp(-np.stack(clearances) * cell / BORDER_DISTANCE)
        ends: list[np.ndarray] = []
        weights: list[np.ndarray] = []
        for link in self.map.links:
            for (lower, upper), joined in link.joined.items():
                here = self._numbers[lower][link.here][joined]
                there = self._numbers[upper][link.there][joined]
                edge_cost = (cost[lower][link.here][joined] + cost[upper][link.there][joined]) / 2
                usable = (here >= 0) & (there >= 0)
                ends.append(np.stack([here[usable], there[usable]]))
                weights.append(edge_cost[usable] * cell * (math.sqrt(2.0) if link.corner else 1.0))
        count = len(self._points)
        if not ends:
            return csr_array((count, count))
        pairs = np.concatenate(ends, axis=1)
        return csr_array((np.concatenate(weights), (pairs[0], pairs[1])), shape=(count, count))

    def node(self, start: StartPose) -> int:
        """Return the square under a start pose; -1: the robot does not get there."""
        return self._near(start.at[0], start.at[1], start.at[2] - START_ELEVATION, 4 * self.map.grid.cell)

    def beside(self, victim: Victim) -> int:
        """Return the square nearest to a victim that the robot may stand on; -1: none is near."""
        found = [self._near(*part.at, VICTIM_REACH) for part in shapes_in_arena(victim)]
        found = [node for node in found if node >= 0]
        if not found:
            return -1
        at = np.array(victim.at[:2])
        return min(found, key=lambda node: float(np.linalg.norm(self._points[node] - at)))

    def _near(self, x: float, y: float, z: float, max_distance: float) -> int:
        if not len(self._points):
            return -1
        ground = self.map.ground[self._free]
        # Squares on other floors are pushed away rather than dropped, so that argmin has a choice.
        distances = np.hypot(*(self._points - (x, y)).T) + np.where(
            np.abs(ground - z) < VICTIM_REACH, 0.0, 10.0 * VICTIM_REACH
        )
        best = int(distances.argmin())
        return best if distances[best] <= max_distance else -1

    def shortest_paths(self, node: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the cost of ways from a square to all others, and the squares before them."""
        from scipy.sparse import csgraph  # pyright: ignore[reportMissingTypeStubs]

        # Undirected: `SurfaceAdjacency` has each pair of neighbours once.
        lengths, predecessors = cast(Any, csgraph).dijkstra(
            self._graph, directed=False, indices=node, return_predecessors=True
        )
        return np.asarray(lengths), np.asarray(predecessors)

    def path(self, predecessors: np.ndarray, here: int, there: int) -> tuple[Position2D, ...]:
        """Return points along a way."""
        squares = [there]
        while squares[-1] != here:
            squares.append(int(predecessors[squares[-1]]))
        every = max(1, round(WAYPOINT_SPACING / self.map.grid.cell))
        # The goal itself is always the last point; the start is left out, for the robot stands there.
        chosen = [*squares[::-1][every::every], there]
        return tuple((float(x), float(y)) for x, y in self._points[chosen])
