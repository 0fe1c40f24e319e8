"""Common parts of the tasks for teams: maps, messages about them, contacts, observations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.backend import Array, Part, get_rows, set_rows
from usarmjx.base.rotations import wrap_angle
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, SHARE
from usarmjx.base.transforms import flip_angles, flip_vector
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.mail import BYTES_PER_NUMBER, MessageSettings, OutgoingMessages
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.ranging import RangeScanner
from usarmjx.sensors.suite import suite_of
from usarmjx.sim.actions import Actions
from usarmjx.sim.scene import RobotGroup, Scene
from usarmjx.train.envs.recipe import Arenas
from usarmjx.train.envs.task import Task, TaskView, TeamMaps, TimeLimit
from usarmjx.train.mapping import planning
from usarmjx.train.mapping.belief import (
    HEADER_SIZE,
    RECENT_AGE,
    SCANNER_RANGE,
    STALE_AGE,
    Belief,
    GroupScan,
    compose_messages,
    initial_belief,
    other_slots,
    update_from_mail,
    update_from_scan,
    update_pose,
)
from usarmjx.train.mapping.maps import (
    FREE,
    MARK,
    UNKNOWN,
    WALL,
    MapGrid,
    classify_scan,
    egocentric_map,
    grid_of,
    to_robot_frame,
)
from usarmjx.train.mapping.planning import PlannerSettings
from usarmjx.train.tasks import safety
from usarmjx.train.tasks.buildings import Buildings, arena_notes, note_of
from usarmjx.train.tasks.clearance import clearance
from usarmjx.train.tasks.equip import flies, pose_sensor

MAX_READINGS = 24
"""More readings of one sensor than this are seen in sectors."""
MAX_RANGE = 5.0
"""Distance beyond which obstacles look alike [m]: a sonar's range."""


def first_kind(robot: RobotSpec, kinds: tuple[str, ...]) -> str | None:
    """Return the first of some types of sensors that a robot has; None: it has none of them."""
    there = {mount.kind.lower() for mount in robot.sensors}
    return next((kind for kind in kinds if kind.lower() in there), None)


def ranges(view: TaskView, group: int, kinds: tuple[str, ...]) -> jax.Array:
    """Return what a group's range sensors see (robots, n): 0 touching, 1 free for `MAX_RANGE` or more.

    Of the given types the first that the robots have is read. Of more than `MAX_READINGS` readings the
    shortest of each of equal sectors counts.
    """
    robots = len(view.scene.groups[group].slots)
    kind = first_kind(view.scene.groups[group].robot, kinds)
    if kind is None:
        return jnp.zeros((robots, 0))
    seen = view.sensor(group, kind).reshape(robots, -1)
    return jnp.clip(reduce_to_sectors(seen) / MAX_RANGE, 0.0, 1.0)


def range_lines(robot: RobotSpec, kinds: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return what lines `ranges` measures along, on a level robot's axes.

    Returns:
        Their starts, x forward and y left [m] (n, 2), and their directions, positive to the left
        [rad] (n,); those of a sector are its middle's.
    """
    kind = first_kind(robot, kinds)
    if kind is None:
        return np.zeros((0, 2), np.float32), np.zeros(0, np.float32)
    suite = suite_of(robot)
    sensor, plan = suite.sensors[suite.index(kind)], suite.plan
    with jax.ensure_compile_time_eval():  # constants, whoever is being traced
        rest = BodyPoses(pos=jnp.asarray(plan.rest_pos), mat=jnp.tile(jnp.eye(3), (len(plan.parts), 1, 1)))
        pos, mat = map(np.asarray, sensor.mount_poses(rest))
    along = sensor.directions() @ mat[0].T if isinstance(sensor, RangeScanner) else mat[:, :, 0]
    # A scanner has one place for all beams, sonars have one each.
    origin = np.broadcast_to(pos[:, :2] if len(pos) > 1 else pos[:1, :2], (len(along), 2))
    angle = np.arctan2(along[:, 1], along[:, 0])
    each = -(-len(angle) // MAX_READINGS)
    # Cut as by `reduce_to_sectors`: the last sector may have fewer lines.
    middles = np.array(
        [len(part) // 2 + part[0] for part in np.split(np.arange(len(angle)), _cuts(angle, each))]
    )
    return origin[middles].astype(np.float32), angle[middles].astype(np.float32)


def _cuts(angle: np.ndarray, each: int) -> list[int]:
    return list(range(each, len(angle), each))


def reduce_to_sectors(seen: jax.Array) -> jax.Array:
    """Return the shortest of each of at most `MAX_READINGS` equal sectors of readings (..., n)."""
    n = seen.shape[-1]
    each = -(-n // MAX_READINGS)
    # Filled up with infinity, which is never the shortest.
    room = -(-n // each) * each - n
    padded = jnp.concatenate([seen, jnp.full((*seen.shape[:-1], room), jnp.inf)], -1)
    return padded.reshape(*seen.shape[:-1], -1, each).min(-1)


BASE_STATION = "ComStation"
WALLED_RADIO = RadioSettings(pdo=-40.0, do=1.0, n=2.0, cutoff=-49.0, max_obs=8, atten_fac=6.0)
"""A radio for which walls are walls: 2.8 m in the open, half of that behind a thin one, a quarter behind one
that counts twice."""
PERFECT_RADIO = RadioSettings(cutoff=-1e6)
"""A radio that is always heard."""
LOCAL_MAP_WIDTH, SPACING = 11, 0.6
"""Points along a side of the map that a robot observes around itself, and the distance between two [m]."""
WAYPOINT_SCALE, POSITION_SCALE, PATH_SCALE = 1.2, 6.0, 60.0
"""Quantities observed as 1: the distance of the next position on the path [m], that of robots and goals [m],
the length of a path [squares]."""
PROGRESS_SCALE = 0.5
"""So far a robot has come lately, if it drives [m]."""


class TeamMemory(struct.PyTreeNode, kw_only=True):
    """Memory of team tasks in an episode.

    Attributes:
        belief: Beliefs of each robot (robots, ...).
        step: Actions so far, and those of `skipped` ().
        skipped: Actions that count as done before the episode began, see `Task.started_at` ().
        reachable: Which squares a robot gets to (i, j).
        explored: Which of them the team's scanners have truly seen to be free (i, j).
        touching: Which robots touch something (robots,).
        contacts: Number of contacts begun ().
        unlinked: Sum over steps of the share of pairs of robots that have no link ().
        score: So far ().
        extra: The task's own.
    """

    belief: Belief
    step: jax.Array
    reachable: jax.Array
    explored: jax.Array
    touching: jax.Array
    contacts: jax.Array
    unlinked: jax.Array
    score: jax.Array
    extra: Any = ()
    skipped: jax.Array | int = 0


def has_scanner(group: RobotGroup) -> bool:
    """Return whether a group's robots have a range scanner."""
    return any(sensor.kind == "RangeScanner" for sensor in group.suite.sensors)


def scanner_poses(group: RobotGroup, poses: jax.Array) -> jax.Array:
    """Return where the scanners of robots at poses x, y [m], yaw [rad] are (robots, 3)."""
    mount = group.suite.sensors[group.suite.index("RangeScanner")].mounts[0]
    x, y, _ = flip_vector(mount.at)
    cos, sin = jnp.cos(poses[:, 2]), jnp.sin(poses[:, 2])
    position = poses[:, :2] + jnp.stack([cos * x - sin * y, sin * x + cos * y], -1)
    yaw = wrap_angle(poses[:, 2] + flip_angles(mount.direction)[2])
    return jnp.concatenate([position, yaw[:, None]], -1)


def scan_of(view: TaskView, group: int, poses: jax.Array) -> GroupScan:
    """Return the scans of a group's robots at poses (robots, 3)."""
    members = view.scene.groups[group]
    sensor = members.suite.sensors[members.suite.index("RangeScanner")]
    return GroupScan(
        slots=members.slots,
        settings=sensor.settings[0],
        poses=scanner_poses(members, poses),
        ranges=view.sensor(group, "RangeScanner"),
        fresh=view.is_fresh(group, "RangeScanner"),
    )


def true_poses(view: TaskView, group: int) -> jax.Array:
    """Return where a group's robots truly are: x, y [m], yaw [rad] (robots, 3)."""
    robots = view.robots(group)
    w, x, y, z = jnp.moveaxis(robots.quat, -1, 0)
    # The yaw of ZYX angles: exact for robots that lean, too.
    yaw = jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return jnp.concatenate([robots.pos[:, :2], yaw[:, None]], -1)


def newly_explored(view: TaskView, memory: TeamMemory, grid: MapGrid) -> tuple[jax.Array, jax.Array]:
    """Return what of the arena is explored now (i, j), and whose part of what is new that is (robots,).

    Scans are drawn from where the scanners truly are; what several show at once is shared.
    """
    scene = view.scene
    parts = list[Part]()
    for g, group in enumerate(scene.groups):
        if not has_scanner(group):
            continue
        scan = scan_of(view, g, true_poses(view, g))
        free, _ = jax.vmap(partial(classify_scan, grid, scan.settings))(scan.poses, scan.ranges)
        # A reading that is not fresh was taken elsewhere: drawn from here it would be wrong.
        parts.append((group.slots, free & scan.fresh[:, None, None]))
    new = set_rows(jnp.zeros((scene.num_robots, *grid.shape), bool), *parts)
    new = new & memory.reachable & ~memory.explored
    # Squares that several scans show at once are shared evenly, so that credits add up to what is new.
    seers = new.sum(0)
    credit = (new / jnp.maximum(seers, 1)).sum((1, 2)) / jnp.maximum(memory.reachable.sum(), 1)
    return memory.explored | new.any(0), credit


def mate_observations(view: TaskView, belief: Belief) -> jax.Array:
    """Return what each robot believes of the others, as it observes that (robots, 4 others)."""
    robots = view.scene.num_robots
    others = other_slots(robots)
    rows = np.arange(robots)[:, None]
    age = (view.time - belief.heard_time)[rows, others]
    there = jax.vmap(to_robot_frame)(belief.pose, belief.mate_headers[rows, others, :2])
    # An old position is observed as 0, as if there were none: its age says which is meant.
    there = jnp.where((age < STALE_AGE)[..., None], there / POSITION_SCALE, 0.0)
    linked = jnp.zeros((robots, robots), bool) if view.world.links is None else view.links.in_range
    facts = [there, jnp.minimum(age / STALE_AGE, 1.0)[..., None], linked[rows, others][..., None]]
    return jnp.concatenate(facts, -1).reshape(robots, -1)


def true_pose_features(view: TaskView) -> jax.Array:
    """Return where all robots truly are, for critics (numbers,).

    Group by group: x and y as shares of the arena, then cosine and sine of the yaw.
    """
    extent = np.array(view.scene.arena.extent, np.float32)
    rows: list[Array] = []
    for group in range(len(view.scene.groups)):
        robots = view.robots(group)
        w, z = robots.quat[:, 0], robots.quat[:, 3]
        position = (robots.pos[:, :2] - extent[:, 0]) / (extent[:, 1] - extent[:, 0])
        # Products of the quaternion of a robot that stands level; an angle would jump at half a turn.
        rows += [position.ravel(), jnp.stack([w * w - z * z, 2 * w * z], -1).ravel()]
    return jnp.concatenate(rows)


def base_slot(scene: Scene) -> int | None:
    """Return the slot of the base station; None: there is none."""
    for group in scene.groups:
        if group.robot.name == BASE_STATION:
            return int(group.slots[0])
    return None


def station_slot(scene: Scene) -> int:
    """Return the slot of the base station, of a scene that has one."""
    slot = base_slot(scene)
    assert slot is not None  # as the task's roster says
    return slot


def unlinked(view: TaskView) -> jax.Array:
    """Return the share of pairs of robots, the base too, that have no link ()."""
    if view.world.links is None:
        return jnp.ones(())
    links = view.links
    # Links are counted in both directions, as are pairs, so the share is right.
    return 1 - links.in_range.sum() / jnp.maximum(links.paired.sum(), 1)


def coverage(memory: TeamMemory) -> jax.Array:
    """Return the share of the squares a robot gets to that are explored ()."""
    return memory.explored.sum() / jnp.maximum(memory.reachable.sum(), 1)


Talk = Literal["all", "base", "none"]
Number = TypeVar("Number", np.ndarray, jax.Array)


@dataclass(frozen=True, kw_only=True)
class TeamTask(Task):
    """A team of robots with scanners and radios in generated buildings.

    Each robot draws a map of what its scanner shows, where its INS says it is. With every action it sends
    the others where it is, where it is going, and its map; what they receive they draw into theirs.
    The messages are mail and go over links that hold; from robot to robot news travels by one link a step.

    Observation, in the robot's axes (x ahead, y to the left):
    - the way to the nearest frontier of its map, see `planning.plan_paths`: the next position on it (x, y; 1
      is 1.2 m), where it leads (x, y; 1 is 6 m), its length (1: 60 squares or none), how far the robot has
      come lately (1: 0.5 m);
    - the shortest beam of each of 12 sectors of its scanner, from right to left (1: 4 m);
    - the share of the time that is left, and its index among the robots;
    - for each other robot, the base too: where it said to be (x, y; 1 is 6 m), the age of that (1: 20 s or
      never), whether there is a link now;
    - its map around it, 11 x 11 points 0.6 m apart: walls (1, else 0), then what is unknown.
    End of the way, its next position and its length are the planner's advice: without `advice` these
    five numbers are 0, but for a baseline that teaches.

    Action: speed and turn to the left, as shares of the wheels' highest speed: the left wheels get their
    difference, the right ones their sum.

    Attributes:
        cell: Side of a map's squares [m].
        passing: Class of the robot that decides which squares are reached.
        talk: Receivers of the robots' messages: all others, the base station only, or none.
        touch: Distance from an obstacle that counts as contact [m].
        price: Price of a contact, in points of the score.
        advice: Let the robots observe the advice of their planner.
        haste: Share of the points for a find that it loses by coming at the end of the episode instead of at
            the start, the less the sooner it comes: at 1 it pays for the time that is left, at 0 it pays the
            same whenever it comes.
        safety: Let robots that skid take the command nearest to their action that keeps clear of scanned
            solids and reported robots.
    """

    reports_itself: ClassVar[bool] = True
    reports: ClassVar[bool] = False
    """Whether robots that send each other nothing still send to the base."""

    arena: Arenas = field(default_factory=Buildings)
    repeat: int = 10
    episode_steps: int = 500
    time_limit: TimeLimit = "end"
    radio: RadioSettings | None = WALLED_RADIO
    shuffle: bool = False
    cell: Annotated[float, POSITIVE] = 0.3
    passing: str = "P2AT"
    talk: Talk = "all"
    touch: Annotated[float, NOT_NEGATIVE] = 0.01
    price: float = 0.2
    advice: bool = True
    haste: Annotated[float, SHARE] = 1.0
    safety: bool = False

    def scene(self) -> Scene:
        """Return the scene, with room for maps in its messages if nothing else is said."""
        scene = super().scene()
        if self.mail is not None or self.radio is None:
            return scene
        others, numbers = max(scene.num_robots - 1, 1), self.letter_size(scene)
        # No limit: with each action a whole map goes to each of the others.
        mail = MessageSettings(
            numbers=numbers, capacity=others, bytes_per_step=BYTES_PER_NUMBER * numbers * others
        )
        return replace(scene, mail=mail)

    def letter_size(self, scene: Scene) -> int:
        """Return the numbers of a message: its header, and a packed map."""
        return HEADER_SIZE + self.arena_grid(scene).packed_size

    def arena_grid(self, scene: Scene) -> MapGrid:
        """Return the squares of the scene's arenas."""
        return grid_of((scene.arena,), self.cell)

    def arena_notes(self, scene: Scene, arenas: Sequence[ArenaSpec]) -> dict[str, np.ndarray]:
        """As `Task`: what robots get to, and extents."""
        return arena_notes(arenas, self.arena_grid(scene), self.passing)

    def note(self, view: TaskView, name: str) -> jax.Array:
        """Return what the task knows of a world's arena, see `buildings.arena_notes`."""
        return note_of(view, name, self.arena_grid(view.scene), self.passing)

    def action_sizes(self, scene: Scene) -> tuple[int, ...]:
        """Speed and turn."""
        return (2,) * len(self.agent_groups(scene))

    def agents(self, scene: Scene) -> np.ndarray:
        """Return the slots of the robots that are agents, group by group."""
        return np.concatenate([scene.groups[group].slots for group in self.agent_groups(scene)])

    def per_group(self, scene: Scene, values: jax.Array) -> tuple[jax.Array, ...]:
        """Return values of all slots (robots, ...) per group."""
        return tuple(get_rows(values, scene.groups[group].slots) for group in self.agent_groups(scene))

    # Beliefs of the robots.

    def maps(self, scene: Scene, memory: TeamMemory) -> TeamMaps:
        """Return the robots' maps."""
        grid = self.arena_grid(scene)
        return TeamMaps(low=grid.low, cell=grid.cell, squares=memory.belief.squares)

    def poses(self, view: TaskView) -> jax.Array:
        """Return where the robots believe to be: x, y [m], yaw [rad], by slot (robots, 3)."""
        groups = view.scene.groups
        read = [view.sensor(g, pose_sensor(group.robot))[:, (0, 1, 5)] for g, group in enumerate(groups)]
        slots = [group.slots for group in groups]
        return set_rows(jnp.zeros((view.scene.num_robots, 3)), *zip(slots, read, strict=True))

    def update_belief(self, view: TaskView, belief: Belief, *, mail: bool = True) -> Belief:
        """Return the belief after the robots read their sensors and mail, and planned.

        Args:
            view: The world.
            belief: That before it.
            mail: Whether they can have any; at the start of an episode all boxes are empty.
        """
        grid = self.arena_grid(view.scene)
        # Poses first: scans are drawn from where the robots believe to be now.
        belief = update_pose(grid, belief, self.poses(view))
        if mail and view.world.mail is not None:
            # Mail before scans: what others reported a moment ago keeps their bodies from becoming walls.
            belief = update_from_mail(grid, belief, view.mail, self.mail_period(view.scene))
        for g, group in enumerate(view.scene.groups):
            if has_scanner(group):
                scan = scan_of(view, g, get_rows(belief.pose, group.slots))
                recent = self.recent_age(view.scene)
                belief = update_from_scan(grid, belief, scan, view.time, recent)
        belief = self.update_task_belief(view, belief)
        return self.plan(view, belief)

    def mail_period(self, scene: Scene) -> float:
        """Return the time between two messages of a robot [s], see `update_from_mail`."""
        return self.repeat * scene.physics.period

    def recent_age(self, scene: Scene) -> float:
        """Return the age of messages up to which robots are taken to be where they said to be [s]."""
        del scene
        return RECENT_AGE

    def first_belief(self, view: TaskView) -> Belief:
        """Return what the robots believe before they scan: where all of them stand."""
        return initial_belief(self.arena_grid(view.scene), self.poses(view))

    def update_task_belief(self, view: TaskView, belief: Belief) -> Belief:
        """Return the belief after the robots sensed what the task is about; by default nothing."""
        del view
        return belief

    def plan(self, view: TaskView, belief: Belief) -> Belief:
        """Return the belief after the robots planned where to go: to a frontier."""
        return planning.plan_paths(
            self.arena_grid(view.scene), belief, view.time, self.planner_settings(view.scene)
        )

    def planner_settings(self, scene: Scene) -> PlannerSettings:
        """Return how the robots plan: those that move, and nobody heeds what does not."""
        flyers, agents = np.zeros(scene.num_robots, bool), np.zeros(scene.num_robots, bool)
        for group in scene.groups:
            flyers[group.slots] = flies(group.robot)
        agents[self.agents(scene)] = True
        # Robots that fly and those that drive hinder nobody of the other kind.
        peers = agents & (flyers[:, None] == flyers) & ~np.eye(scene.num_robots, dtype=bool)
        return PlannerSettings(peers=peers, flyers=flyers, planners=np.flatnonzero(agents))

    def recipients(self, scene: Scene) -> np.ndarray:
        """Return who sends messages to whom (robots, robots)."""
        to = ~np.eye(scene.num_robots, dtype=bool)
        if self.talk == "all":
            return to
        base = base_slot(scene)
        if self.talk == "none" or base is None:
            return np.zeros_like(to)
        return to & (np.arange(scene.num_robots) == base)

    def act(self, view: TaskView, memory: TeamMemory, actions: tuple[jax.Array, ...]) -> Actions:
        """Return drive values from the actions, and the messages."""
        drive = dict[int, dict[str, jax.Array]]()
        for group, action in zip(self.agent_groups(view.scene), actions, strict=True):
            safe = self.safe_actions(view, memory, group, action) if self.safety else action
            drive[group] = self.drive_values(view, memory, view.scene.groups[group], safe)
        messages = None if view.world.mail is None else self.outgoing(view, memory)
        return Actions(drive=drive, messages=messages)

    def outgoing(self, view: TaskView, memory: TeamMemory) -> OutgoingMessages:
        """Return the messages of all robots: their whole maps."""
        to = jnp.asarray(self.recipients(view.scene))
        return compose_messages(memory.belief, to, self.planner_settings(view.scene).flyers)

    def safe_actions(self, view: TaskView, memory: TeamMemory, group: int, action: jax.Array) -> jax.Array:
        """Return the safe commands nearest to a group's actions (robots, 2); flying robots keep theirs."""
        scene, belief = view.scene, memory.belief
        members = scene.groups[group]
        body = safety.footprint_of(members.robot)
        if body is None or not has_scanner(members):
            return action
        slots, scanner = members.slots, members.suite.sensors[members.suite.index("RangeScanner")]
        at = scanner_poses(members, jnp.zeros((1, 3)))[0]
        outlines = np.zeros((scene.num_robots, 8, 2), np.float32)
        for each in scene.groups:
            outlines[each.slots] = safety.outline(*safety.box_of(each.robot))
        other = np.arange(scene.num_robots) != slots[:, None]
        # A robot is no obstacle to itself, whatever its header's age.
        age = jnp.where(other, view.time - belief.heard_time[slots], jnp.inf)

        def one(
            command: jax.Array, ranges: jax.Array, pose: jax.Array, heads: jax.Array, age: jax.Array
        ) -> jax.Array:
            seen = safety.beam_points(scanner.settings[0], at, ranges)
            mates = safety.mate_points(pose, heads[:, :3], age, outlines)
            return safety.safe_command(body, seen, mates, command)

        ranges = view.sensor(group, "RangeScanner")
        return jax.vmap(one)(action, ranges, belief.pose[slots], belief.mate_headers[slots], age)

    def drive_values(
        self, view: TaskView, memory: TeamMemory, group: RobotGroup, action: jax.Array
    ) -> dict[str, jax.Array]:
        """Return numbers for the keys of DRIVE of a group's robots from their actions (robots, 2)."""
        del view, memory
        full = group.robot.drive.full_scale
        sides = {"Left": action[:, 0] - action[:, 1], "Right": action[:, 0] + action[:, 1]}
        return {key: jnp.clip(value, -1.0, 1.0) * full[key] for key, value in sides.items()}

    # Evaluation.

    def start(self, view: TaskView, key: jax.Array) -> TeamMemory:
        """Nothing is known but what the first scans show."""
        del key
        grid = self.arena_grid(view.scene)
        zero = jnp.zeros(())
        memory = TeamMemory(
            belief=self.update_belief(view, self.first_belief(view), mail=False),
            step=jnp.zeros((), jnp.int32),
            skipped=jnp.zeros((), jnp.int32),
            reachable=self.note(view, "reachable"),
            explored=jnp.zeros(grid.shape, bool),
            touching=jnp.zeros(view.scene.num_robots, bool),
            contacts=zero,
            unlinked=zero,
            score=zero,
        )
        shown, _ = newly_explored(view, memory, grid)
        return memory.replace(explored=shown)

    def started_at(self, memory: TeamMemory, steps: jax.Array) -> TeamMemory:
        """See `Task`."""
        return memory.replace(step=steps, skipped=steps)

    def worth(self, left: Number) -> Number:
        """Return what share of its points a find still pays with that share of the time left (...,)."""
        return (1.0 - self.haste) + self.haste * left

    def worth_of_steps(self) -> np.ndarray:
        """Return `worth` in each step of an episode (steps,)."""
        return self.worth(1.0 - np.arange(self.episode_steps) / self.episode_steps)

    def paid(self, share: np.ndarray) -> np.ndarray:
        """Return what a point for a share that only grows has paid after each step (steps, ...).

        Args:
            share: After each step of whole episodes (steps, ...).
        """
        # The share that the first scans show is paid with the first step.
        found = np.diff(share, axis=0, prepend=np.zeros_like(share[:1]))
        return np.cumsum(found * self.worth_of_steps().reshape(-1, *[1] * (share.ndim - 1)), axis=0)

    def score_parts(self, series: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return what each part of the score has come to after each step of whole episodes.

        Args:
            series: The metrics after each step, by name (steps, ...).

        Returns:
            Points by part (steps, ...), negative where a part costs; all parts together are the score.
        """
        return {"contacts": -self.price * series["contacts"]}

    @property
    def most_points(self) -> dict[str, float]:
        """The most that each part of the score can come to: the sum of its points."""
        return {"contacts": 0.0}

    def working(self, view: TaskView, memory: TeamMemory) -> jax.Array | None:
        """Return which robots still work, by slot (robots,); None: all do, in every episode."""
        del view, memory
        return None

    def touched(self, view: TaskView) -> jax.Array:
        """Return which robots truly touch something, by slot (robots,)."""
        slots = [group.slots for group in view.scene.groups]
        nothing = jnp.full(view.scene.num_robots, jnp.inf, jnp.float32)
        near = set_rows(nothing, *zip(slots, clearance(view), strict=True))
        return near <= self.touch

    def advance(self, view: TaskView, memory: TeamMemory) -> tuple[TeamMemory, jax.Array, jax.Array]:
        """Return the memory with all but score and extra brought up to date.

        Returns:
            The memory, whose part of what was explored is whose (robots,), and who began to touch something
            (robots,).
        """
        explored, credit = newly_explored(view, memory, self.arena_grid(view.scene))
        touching = self.touched(view)
        # Only the begin of a contact counts: a robot that leans on a wall pays once.
        begun = touching & ~memory.touching & jnp.isin(jnp.arange(len(touching)), self.agents(view.scene))
        if (working := self.working(view, memory)) is not None:
            begun &= working
        memory = memory.replace(
            belief=self.update_belief(view, memory.belief),
            step=memory.step + 1,
            explored=explored,
            touching=touching,
            contacts=memory.contacts + begun.sum(),
            unlinked=memory.unlinked + unlinked(view),
        )
        return memory, credit, begun

    def metrics(self, memory: TeamMemory) -> dict[str, jax.Array]:
        """Share of the squares that are explored, contacts, and share of the pair-steps without a link."""
        # Skipped steps have no sums behind them.
        steps = jnp.maximum(memory.step - memory.skipped, 1)
        return {
            "explored": coverage(memory),
            "contacts": memory.contacts,
            "unlinked": memory.unlinked / steps,
        }

    # Observations of the agents.

    def observe(self, view: TaskView, memory: TeamMemory) -> tuple[jax.Array, ...]:
        """See `TeamTask`."""
        return self.per_group(view.scene, self.observations(view, memory))

    def observations(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return what each robot sees, by slot (robots, n)."""
        belief, robots = memory.belief, view.scene.num_robots
        grid = self.arena_grid(view.scene)
        left = jnp.broadcast_to(1 - memory.step / self.episode_steps, (robots,))
        number = jnp.arange(robots) / robots
        moved = jnp.linalg.norm(belief.pose[:, :2] - belief.lagged_position, axis=-1)
        advice = advice_of(belief)
        rows = [
            *(advice if self.advice else [jnp.zeros_like(row) for row in advice]),
            jnp.minimum(moved / PROGRESS_SCALE, 1.0)[:, None],
            jnp.minimum(belief.sector_ranges / SCANNER_RANGE, 1.0),
            jnp.stack([left, number], -1),
            mate_observations(view, belief),
        ]

        def local_map(squares: jax.Array, pose: jax.Array) -> jax.Array:
            return egocentric_map(grid, squares, pose, LOCAL_MAP_WIDTH, SPACING)

        flyers = self.planner_settings(view.scene).flyers[:, None, None]
        flown = jnp.where(belief.evidence < 0, FREE, jnp.where(belief.evidence > 0, WALL, UNKNOWN))
        swept = jnp.where(belief.squares == MARK, MARK, flown)
        # Robots that fly have seen only what they flew over; maps of others are no help to keep them on
        # course.
        squares = jnp.where(flyers, swept, belief.squares)
        near = jax.vmap(local_map)(squares, belief.pose)
        near = near.reshape(robots, -1)
        # `MARK` is above `WALL`: robots keep off victims, too.
        return jnp.concatenate([*rows, near >= WALL, near == UNKNOWN], -1).astype(jnp.float32)

    @property
    def for_baseline(self) -> "TeamTask":
        """This task with advice."""
        return self if self.advice else replace(self, advice=True)

    def baseline_obs(
        self, scene: Scene, memory: TeamMemory, obs: tuple[jax.Array, ...]
    ) -> tuple[jax.Array, ...]:
        """As `Task`: where the planner's advice is hidden it is put in."""
        if self.advice:
            return obs
        advice = jnp.concatenate(advice_of(memory.belief), -1)
        return tuple(
            jnp.concatenate([told.astype(one.dtype), one[:, told.shape[-1] :]], -1)
            for told, one in zip(self.per_group(scene, advice), obs, strict=True)
        )

    def privileged(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Share explored, time, score, true poses (x, y as shares of the arena, cosine and sine of yaw)."""
        facts = [coverage(memory), memory.step / self.episode_steps, memory.score / 100.0]
        return jnp.concatenate([jnp.stack(facts), true_pose_features(view)])


def advice_of(belief: Belief) -> list[jax.Array]:
    """Return what robots' planners advise, as observed: next position, goal, length (robots, 2, 2 and 1)."""
    return [
        to_robot_frame(belief.pose, belief.waypoint) / WAYPOINT_SCALE,
        to_robot_frame(belief.pose, belief.goal) / POSITION_SCALE,
        jnp.minimum(belief.path_length / PATH_SCALE, 1.0)[:, None],
    ]
