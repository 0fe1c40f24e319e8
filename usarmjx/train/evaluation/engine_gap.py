"""Gap between engine `planar` and another along random drives: poses, ranges, odometry, contacts."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import jax
import numpy as np

from usarmjx.base.errors import SpecError, UnsupportedFeatureError, UsageError
from usarmjx.base.tables import table_lines
from usarmjx.engines.planar.responses import rolls
from usarmjx.models.generate import generate
from usarmjx.models.types.arena import ArenaSpec, Water
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.batch import Batch, BatchState
from usarmjx.sim.calibration import HORIZONS, build_calibrated, random_commands
from usarmjx.sim.scene import build_scene
from usarmjx.train.envs.recipe import open_floor
from usarmjx.train.envs.task import TaskView
from usarmjx.train.evaluation.evaluate import Evaluation, evaluate_episodes, pooled_score
from usarmjx.train.learning.config import load_record
from usarmjx.train.policies import POLICIES
from usarmjx.train.policies.sources import PolicySource, baseline, load_policy
from usarmjx.train.task_names import newest_name
from usarmjx.train.tasks.clearance import clearance
from usarmjx.train.tasks.team import first_kind

TASKS_TRIED = (
    "drive-to-goal",
    "wander",
    "explore-v1",
    "relay-chain-v1",
    "convoy",
    "hover-inspect",
    "victim-search-v1",
    "soccer-v1",
    "stairs",
)


Tried: TypeAlias = tuple[str, tuple[PolicySource, ...]]
"""Subject of a row: its name, and a policy; or those of several runs that differ by their seeds only."""


def sources_of(named: Sequence[str]) -> Iterator[Tried]:
    """Yield what plays.

    Args:
        named: Tasks, of each of which its packaged policy plays, if there is one, and what is written by
            hand; and folders of runs. Runs of the same task, engine and fields of the task share a row.
    """
    runs: dict[tuple[str, str], list[PolicySource]] = {}
    for name in named:
        if Path(name).is_dir():
            record, found = load_record(Path(name)), load_policy(name)
            # Sorted: runs with the same fields share a row in whatever order these were set.
            fields = "".join(f", {key}={text}" for key, text in sorted(record.overrides.items()))
            runs.setdefault((record.task, f"trained on {record.engine}{fields}"), []).append(found)
            continue
        name = newest_name(name)
        if name in POLICIES:
            yield f"{name}, packaged policy", (load_policy(name),)
        yield f"{name}, baseline", (baseline(name),)
    # Runs last: those of one row may be named far apart.
    for (task, how), found in runs.items():
        yield f"{task}, {how}{f', {len(found)} runs' if len(found) > 1 else ''}", tuple(found)


def task_gap(
    engines: Sequence[str],
    tried: Iterator[Tried],
    episodes: int,
    seeds: Sequence[int],
    worlds: int,
    split: str | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Iterator[str]:
    """Return the lines of a table of scores in Markdown, row by row, each with the 95 % interval of its mean.

    Args:
        engines: On which.
        tried: Names and policies.
        episodes: Of each seed and policy, at least.
        seeds: Seeds of the environments.
        worlds: Number at once.
        split: Split of generated arenas, a name of `SPLITS`; None: `test`.
        tell: Receives how far it is.
    """

    def cell(name: str, sources: Sequence[PolicySource], engine: str) -> str:
        try:
            env, _, _ = sources[0].env(
                worlds=min(worlds, episodes),
                engine=engine,
                seed=seeds[0],
                split=split or sources[0].usual_split(),
            )
        # A cell of the table, not its end: other engines can run the task.
        except UnsupportedFeatureError as refused:
            tell(f"{name}: {refused}")
            return "refused"
        return score_text(
            [evaluate_episodes(env, one.policy(env), episodes, seeds, tell=tell) for one in sources]
        )

    rows = ((name, *(cell(name, sources, engine) for engine in engines)) for name, sources in tried)
    return table_lines(("task, policy", *engines), rows)


def score_text(found: Sequence[Evaluation]) -> str:
    """Return the score of one policy, or of several together, with its interval; then that of each."""
    score = pooled_score(found)
    each = f": {', '.join(f'{one.score.value:.3g}' for one in found)}" if len(found) > 1 else ""
    if not math.isfinite(score.low):
        return f"{score.value:.3g}{each}"
    return f"{score.value:.3g} ({score.low:.3g} to {score.high:.3g}){each}"


PLACES = ("floor", "maze", "air", "water")
"""An open floor; a generated maze that the robot gets through; air and water without anything in them."""
HIGH_UP, DEEP_DOWN = 200.0, 200.0
"""Start height of flying robots above the ground, and depth of diving ones in water [m]."""
LOOK_EVERY = 10
"""Control steps between two samples of sensors and contacts: five samples a second."""
TOUCH = 0.01
"""Distance that counts as touching, as in tasks [m]."""
RANGE_KINDS = ("RangeScanner", "Sonar", "IR")
MOST_RANGE = 5.0
"""Ranges beyond this count as this [m]: far ones tell little about the robot's position."""
COLUMNS = (
    "class, place", "after 1 s", "after 5 s", "after 20 s", "ranges after these",
    "odometry off by, c / planar", "contacts a minute, c / planar",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class DriveTrace:
    """Samples of robots of a class on a drive, one robot in each world.

    Attributes:
        pose: Positions on the plan [m] and headings [rad] (looks, robots, 3).
        height: Their heights [m] (looks, robots).
        ranges: Readings of their range sensors [m] (looks, robots, readings); no readings: they have none.
        odometry: Their poses by odometry since the start, likewise; NaN: they have none.
        touching: Whether they touched what stands around them, as tasks count it (looks, robots).
        period: Time between looks [s].
    """

    pose: np.ndarray
    height: np.ndarray
    ranges: np.ndarray
    odometry: np.ndarray
    touching: np.ndarray
    period: float

    @property
    def contacts_per_minute(self) -> float:
        """Number of times that a robot began to touch something."""
        # Beginnings, not looks: leaning on a wall for a minute is one contact.
        begun = self.touching[1:] & ~self.touching[:-1]
        return float(begun.sum() / begun.size * 60.0 / self.period)

    @property
    def slip(self) -> np.ndarray:
        """Distance of odometry from the true motion since the start [m] (looks, robots)."""
        way = self.pose[..., :2] - self.pose[0, :, :2]
        # Odometry starts at 0 in the robot's own axes, so the true way is turned into these.
        c, s = np.cos(self.pose[0, :, 2]), np.sin(self.pose[0, :, 2])
        own = np.stack([c * way[..., 0] + s * way[..., 1], c * way[..., 1] - s * way[..., 0]], -1)
        return np.linalg.norm(own - self.odometry[..., :2], axis=-1)

    def distance(self, other: "DriveTrace", in_space: bool) -> np.ndarray:
        """Return the distances between robots on two drives [m] (looks, robots).

        Args:
            other: Drive of equal numbers of looks and robots.
            in_space: Heights count, too; else on the plan.
        """
        apart = (other.pose - self.pose)[..., :2]
        height = (other.height - self.height) * in_space
        return np.sqrt((apart**2).sum(-1) + height**2)


def places_for(robot: RobotSpec) -> tuple[str, ...]:
    """Return the places that a class is compared in; none if neither it rolls nor flies nor dives."""
    if rolls(robot.drive):
        return "floor", "maze"
    if not robot.drive.applies_wrench:
        return ()
    return ("water",) if robot.drive.vehicle == "NauticVehicle" else ("air",)


def place_of(name: str, robot: RobotSpec) -> ArenaSpec:
    """Return a place to drive in; see `PLACES`.

    Raises:
        UsageError: No such place.
    """
    if name not in PLACES:
        raise UsageError(f"no place {name!r} to drive in, expected one of {', '.join(PLACES)}")
    if name == "maze":
        return generate("maze", (5, 4), 0, robot=robot.name)
    floor = open_floor()
    if name == "floor":
        return floor
    # So high that random commands for the whole drive reach no ground.
    starts = tuple(replace(start, at=(*start.at[:2], HIGH_UP)) for start in floor.starts)
    far = 10 * HIGH_UP
    # Its surface lies `DEEP_DOWN` above the starts.
    water = Water(low=(-far, -far, 0.0), high=(far, far, HIGH_UP + DEEP_DOWN))
    return replace(floor, starts=starts, waters=(water,) if name == "water" else ())


def drive_around(robot: RobotSpec, arena: ArenaSpec, engine: str, orders: np.ndarray) -> DriveTrace:
    """Return the samples of robots under commands (steps, robots, keys), one robot in each world."""
    ranging = first_kind(robot, RANGE_KINDS)
    # Other sensors only cost time, and an empty battery would end the drive.
    kept = tuple(one for one in robot.sensors if one.kind in (ranging, "Odometry"))
    scene = build_scene(arena, [replace(robot, sensors=kept, cameras=(), battery_life=1e6)])
    batch = build_calibrated(lambda: Batch(scene, worlds=orders.shape[1], engine=engine, shuffle=True))
    kinds = [sensor.kind for sensor in scene.groups[0].suite.sensors]
    meets = jax.jit(jax.vmap(partial(_touches, scene)))
    state, looks = batch.reset(), list[tuple[np.ndarray, ...]]()
    for number, order in enumerate(orders):
        # A command holds until the next; `drive` at every step would cost a transfer each.
        if not number or (order != orders[number - 1]).any():
            keys = enumerate(robot.drive.keys)
            state = batch.drive(state, 0, {key: order[:, None, i] for i, key in keys})
        if number % LOOK_EVERY == 0:
            state, seen = _look(batch, state, kinds, ranging)
            looks.append((*seen, np.asarray(meets(state.worlds, batch.physics(state)))))
        state = batch.step(state)
    place, ranges, odometry, touching = (np.array(part) for part in zip(*looks, strict=True))
    period = LOOK_EVERY * scene.physics.period
    return DriveTrace(place[..., :3], place[..., 3], ranges, odometry, touching, period)


def _touches(scene: Any, world: Any, physics: Any) -> jax.Array:  # noqa: ANN401 - of one world
    # Clearance is of true geometry: it needs no readings.
    view = TaskView(world=world, physics=physics, readings=(), scene=scene)
    return clearance(view)[0][0] <= TOUCH


def _look(
    batch: Batch, state: BatchState, kinds: list[str], ranging: str | None
) -> tuple[BatchState, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return the state with its sensors read; poses and heights, ranges and odometry of all worlds."""
    state, readings = batch.observe(state)
    worlds, root = (
        batch.worlds,
        np.asarray(batch.physics(state).qpos)[:, batch.scene.groups[0].root_qposadr[0]],
    )
    # Yaw of MuJoCo's quaternion, which has its real part first.
    w, x, y, z = root[:, 3:].T
    heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    place = np.column_stack([root[:, :2], heading, root[:, 2]])
    values = {kind: np.asarray(one.value)[:, 0] for kind, one in zip(kinds, readings[0], strict=True)}
    ranges = np.zeros((worlds, 0)) if ranging is None else values[ranging].reshape(worlds, -1)
    odometry = values.get("Odometry", np.full((worlds, 3), np.nan))
    return state, (place, np.minimum(ranges, MOST_RANGE), odometry)


def drive_gap(
    robot: RobotSpec, place: str, engines: tuple[str, str] = ("c", "planar"), robots: int = 16, seed: int = 1
) -> list[str]:
    """Return the gap between two engines under the same random commands, as a row of `COLUMNS`.

    Medians over robots: the distance of poses after each of `HORIZONS`, in space of what flies or dives, the
    difference of a range at each, how far odometry is from where the robot got to, and contacts.

    Args:
        robot: The class.
        place: Place that it drives in, one of `PLACES`.
        engines: Which; the first is the truth.
        robots: Number of robots, each in a world of its own.
        seed: Seed of their commands.

    Raises:
        UsageError: No such place.
    """
    arena = place_of(place, robot)
    # Steps of 20 ms, and one more: the look at the last horizon comes before the step of its number.
    orders = random_commands(robot, robots, round(HORIZONS[-1] / 0.02) + 1, seed)
    real, other = (drive_around(robot, arena, engine, orders) for engine in engines)
    apart = real.distance(other, in_space=robot.drive.applies_wrench)
    # Rounding of times to looks may end one behind the last.
    looks = [min(round(horizon / real.period), len(apart) - 1) for horizon in HORIZONS]
    # Medians: a single robot that gets stuck on one engine only would dominate a mean.
    cells = [f"{np.median(apart[look]):.2f} m" for look in looks]
    cells.append(" / ".join(_ranges_apart(real, other, look) for look in looks))
    cells.append(" / ".join(_metres(np.median(one.slip[-1])) for one in (real, other)))
    cells.append(" / ".join(f"{one.contacts_per_minute:.1f}" for one in (real, other)))
    return [f"{robot.name}, {place}", *cells]


def _metres(value: float) -> str:
    """Return a length in words; a dash where it was not measured."""
    return "-" if np.isnan(value) else f"{value:.2f} m"


def _ranges_apart(real: DriveTrace, other: DriveTrace, look: int) -> str:
    if not real.ranges.shape[-1]:
        return "-"
    return f"{np.median(np.abs(other.ranges[look] - real.ranges[look])):.2f} m"


def drive_table(robots: Iterable[RobotSpec], *, everything: bool = False) -> Iterator[str]:
    """Return the lines of a table of `drive_gap` in Markdown, row by row, of classes in their places.

    Args:
        robots: The classes.
        everything: Leave out what has no place in `places_for`, instead of refusing it.

    Raises:
        UsageError: A class neither rolls nor flies nor dives.
    """
    return table_lines(COLUMNS, _drive_rows(robots, everything))


def _drive_row(robot: RobotSpec, place: str) -> list[str]:
    try:
        return drive_gap(robot, place)
    except SpecError:  # a robot that is too large for the maze's corridors
        return [f"{robot.name}, {place}", "too large for it", *["-"] * (len(COLUMNS) - 2)]


def _drive_rows(robots: Iterable[RobotSpec], everything: bool) -> Iterator[list[str]]:
    for robot in robots:
        if not (everything or places_for(robot)):
            raise UsageError(f"{robot.name} neither rolls nor flies nor dives: its drives are not compared")
        yield from (_drive_row(robot, place) for place in places_for(robot))
