"""Parts of a task's scene: its arenas, and robots with only the sensors that the task reads."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.errors import SpecError, UnknownNameError, UsageError
from usarmjx.base.registry import Registry
from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE, SHARE, Setting, validate
from usarmjx.base.worker_processes import spread
from usarmjx.models.compile.reachability import RobotFootprint
from usarmjx.models.files.find_robot import find_robot
from usarmjx.models.generate import KINDS, Difficulty, generate
from usarmjx.models.generate.kinds import DEFAULT_STARTS
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose, start_tag
from usarmjx.models.types.robot import Mount, RobotSpec

GENERATED = "DM-"
"""Prefix of names of generated arenas."""
HELD_OUT_START, TEST_START, HELD_OUT_END = 4_000_000_000, 4_000_001_000, 4_000_010_000
"""Nobody trains on seeds from the first to the last; from the second on they are for tests."""
TRAIN_END, FRESH_END = 2**32, 2**48
"""Training draws seeds below the first; `fresh` draws those from it to the second."""
TRAIN, TEST, FRESH = "train", "test", "fresh"
"""Names of splits."""


@dataclass(frozen=True, kw_only=True)
class Split:
    """Seeds of generated arenas that are used for one thing.

    Attributes:
        start: First seed; those for training leave out what is held out.
        end: Seed after the last.
        arenas: Least number of arenas that are tried; 0: as many as a task has.
        drawn: Whether a seed draws them, as those of training; else they are the first of the split.
    """

    start: int
    end: int
    arenas: int = 0
    drawn: bool = False

    def seeds(self, seed: int | tuple[int, ...], count: int) -> np.ndarray:
        """Return the seeds of arenas (count,): drawn by `seed`, or of a held-out split the first.

        Args:
            seed: A number, or several.
            count: Number of arenas.

        Raises:
            UsageError: More than there are.
        """
        if self.drawn and self.start:
            # 64 bits for at most 48: the remainder favours no seed that anybody could notice.
            drawn = np.random.SeedSequence(seed).generate_state(count, np.uint64)
            return (drawn % np.uint64(self.end - self.start)).astype(np.int64) + self.start
        if self.drawn:
            # 32 bits are just the seeds below `TRAIN_END`: no remainder favours any.
            drawn = np.random.SeedSequence(seed).generate_state(count, np.uint32).astype(np.int64)
            kept = (drawn >= HELD_OUT_START) & (drawn < HELD_OUT_END)
            # Shifted below the held-out range, not drawn again: the count of draws, and so all others, stay
            # the same.
            return np.where(kept, drawn - (HELD_OUT_END - HELD_OUT_START), drawn)
        if count > self.end - self.start:
            raise UsageError(f"{count} arenas of a held-out split, which has {self.end - self.start}")
        return np.arange(self.start, self.start + count)


SPLITS: Registry[Split] = Registry("split")
"""Splits of generated arenas by name; policies train on `train` alone."""
SPLITS.add(TRAIN, Split(start=0, end=TRAIN_END, drawn=True))
SPLITS.add("validation", Split(start=HELD_OUT_START, end=TEST_START, arenas=100))
SPLITS.add(TEST, Split(start=TEST_START, end=HELD_OUT_END, arenas=200))
SPLITS.add(FRESH, Split(start=TRAIN_END, end=FRESH_END, arenas=100, drawn=True))


def generator_seed(name: str) -> int | None:
    """Return the seed of the generated arena of a name; None: the name is of no generated arena."""
    seed = name.rpartition("-")[2]
    return int(seed) if name.startswith(GENERATED) and seed.isdecimal() else None


def split_of(name: str) -> str | None:
    """Return the split of the generated arena of a name, by its seed; None: of no generated arena."""
    seed = generator_seed(name)
    if seed is None:
        return None
    held = (name for name, split in SPLITS if name != TRAIN and split.start <= seed < split.end)
    # Every seed that no other split has is one of training: the draw shifts, so there is no gap.
    return next(held, TRAIN)


def held_out(arenas: Iterable[ArenaSpec]) -> str | None:
    """Return the name of the split of the first of some arenas that nobody may train on; None: all may be."""
    return next((name for arena in arenas if (name := split_of(arena.name)) not in (None, TRAIN)), None)


MIN_START_DISTANCE = 1.0
"""Least distance of two start poses on an open floor [m]."""
SPARE_ROOM = 0.05
"""Share of further slots in a model whose arenas are renewed."""
RENEWAL_TRIES = 50
"""Most arenas that are generated to replace one before it counts as impossible."""
LEVEL_ATOL = 1e-6
"""Levels that rise in single precision are this far off at most."""
FLOOR_SIDE, FLOOR_STARTS = 8.0, 64
"""Side of the empty floor [m] and number of its start poses."""
FLOOR_ROOM = 2.0
"""Share of the floor for each start pose with which they are `MIN_START_DISTANCE` apart [m^2]."""
TRIES = 100
"""Positions that are drawn for a start pose, at most, before the floor counts as full."""


@dataclass(frozen=True, kw_only=True)
class GeneratedArenas:
    """A library of generated arenas, from easy to hard; every world gets another one at each reset.

    Attributes:
        kind: Kind of the arenas, a name of `models.generate.KINDS`.
        count: Arenas of each level.
        levels: Difficulties from easy to hard (`Difficulty.of`).
        size: Columns and rows of cells of 1.2 m.
        seed: Seed of the library; another seed gives arenas that were not trained on.
        robot: Robot that passes: a class, or its footprint.
        reachable: Share of the victims that the robot reaches.
        victims: Victims in each arena; None: one for 12 cells.
        starts: Start poses of each, if it has that many free cells; a task needs one for each of its robots.
        split: Use of the arenas, a name of `SPLITS`; only those of `train` may be trained on.
        renewable: Let a training go on to other arenas, see `Config.arena_refresh_interval`: there are more
            of them than anybody can train on, and the model has `SPARE_ROOM` for what they have more of.
    """

    kind: str = "maze"
    count: Annotated[int, AT_LEAST_ONE] = 16
    levels: Annotated[tuple[float, ...], Setting(ge=0, le=1, min_length=1)] = (0.0, 0.25, 0.5, 0.75, 1.0)
    size: Annotated[tuple[int, int], AT_LEAST_ONE] = (5, 4)
    seed: Annotated[int, NOT_NEGATIVE] = 0
    robot: str | RobotFootprint = "P2AT"
    reachable: Annotated[float, SHARE] = 1.0
    victims: Annotated[int | None, NOT_NEGATIVE] = None
    starts: Annotated[int, AT_LEAST_ONE] = DEFAULT_STARTS
    split: str = "train"
    renewable: bool = False

    def __post_init__(self) -> None:
        """Check the settings."""
        validate(self)

    def problem(self) -> str:
        """Return the fault of levels that do not rise, in words; empty: there is none."""
        rising = list(self.levels) == sorted(self.levels)
        return "" if rising else f"levels are {self.levels}, expected numbers that rise"

    def of_split(self, split: str) -> "GeneratedArenas":
        """Return the same arenas of a split, in the number that the split is evaluated on."""
        wanted = SPLITS.get(split).arenas
        # Rounded up: all levels have the same number of arenas.
        count = -(-wanted // len(self.levels)) if wanted else self.count
        # Scores are compared on the same arenas, which nothing may replace.
        return replace(self, split=split, count=count, renewable=False)

    @property
    def total(self) -> int:
        """Number of arenas, of all levels."""
        return self.count * len(self.levels)

    def seeds(self) -> np.ndarray:
        """Return the seed of each arena (arenas,)."""
        return SPLITS.get(self.split).seeds(self.seed, self.total)

    def arena(self, number: int, seed: int) -> ArenaSpec:
        """Return the arena of an index in the library, the easy ones first, generated from a seed."""
        difficulty = Difficulty.of(self.levels[number // self.count])
        needs = self.robot, self.reachable, self.victims, self.starts
        return generate(self.kind, self.size, seed, difficulty, *needs)

    def arenas(self) -> tuple[ArenaSpec, ...]:
        """Return the arenas, the easy ones first."""
        return tuple(self.arena(number, seed) for number, seed in enumerate(self.seeds().tolist()))

    def mixed_order(self) -> np.ndarray:
        """Return the arenas by number, one of each level in turn: any in a row are of all alike (arenas,)."""
        return np.arange(self.total).reshape(len(self.levels), self.count).T.ravel()

    def renewed(
        self, generation: int, check: Callable[[ArenaSpec], None] = lambda arena: None
    ) -> tuple[ArenaSpec, ...]:
        """Return newly generated arenas in place of all; a generation always has the same ones.

        Args:
            generation: Number of the replacement, from 1.
            check: Raises SpecError for an arena that does not fit; another seed's is tried then.

        Raises:
            UsageError: None of `RENEWAL_TRIES` arenas fits; gives the reason of the last.
        """
        # The first seed mostly fits: those of all arenas are generated in parallel.
        drawn = [self._drawn(generation, number) for number in range(self.total)]
        first = spread(self._arena_of, [(number, seeds[0]) for number, seeds in enumerate(drawn)])
        return tuple(
            self._fitting(number, (arena, seeds), check)
            for number, (arena, seeds) in enumerate(zip(first, drawn, strict=True))
        )

    def _drawn(self, generation: int, number: int) -> list[int]:
        """Return the seeds that are tried for an arena."""
        # A sequence for each number: an arena that is refused changes the seeds of no other one.
        return SPLITS.get(self.split).seeds((self.seed, generation, number), RENEWAL_TRIES).tolist()

    def _arena_of(self, place: tuple[int, int]) -> ArenaSpec:
        return self.arena(*place)

    def _fitting(
        self, number: int, first: tuple[ArenaSpec, list[int]], check: Callable[[ArenaSpec], None]
    ) -> ArenaSpec:
        """Return the first arena of some seeds that can be taken; that of the first of them is known."""
        why = ""
        for turn, seed in enumerate(first[1]):
            arena = self.arena(number, seed) if turn else first[0]
            try:
                check(arena)
            except SpecError as error:
                why = str(error)
            else:
                return arena
        raise UsageError(f"{RENEWAL_TRIES} generated arenas could not take the place of others: {why}")

    def arena_indices(self, level: jax.Array) -> jax.Array:
        """Return the arenas that a library of as many holds at a level, by number (arenas,).

        They are those whose difficulty is at most the level, and always the easiest; over and over, each as
        often as the others or once more.

        Args:
            level: From 0 to 1 ().
        """
        slots = jnp.arange(self.total)
        # At least the easiest level, also below its own difficulty.
        there = self.count * jnp.maximum((jnp.array(self.levels) <= level + LEVEL_ATOL).sum(), 1)
        rest = len(slots) % there  # slots beyond the last whole round, which go to arenas of all levels alike
        spread = (slots - (len(slots) - rest)) * there // jnp.maximum(rest, 1)
        return jnp.where(slots < len(slots) - rest, slots % there, spread)


Arenas = str | ArenaSpec | Sequence[ArenaSpec] | GeneratedArenas
"""Arenas of a task: a name, a description, several, or the recipe of generated ones."""


def open_floor(side: float = FLOOR_SIDE, starts: int = FLOOR_STARTS, seed: int = 0) -> ArenaSpec:
    """Return an empty floor with start poses at random, `MIN_START_DISTANCE` apart if there is room.

    Args:
        side: Side of the square in which they are [m].
        starts: Number.
        seed: Seed of positions and yaws.
    """
    draw, positions = np.random.default_rng(seed), list[np.ndarray]()
    for _ in range(starts):
        position = np.zeros(2)
        for _ in range(TRIES):
            # Rounded as arena files are written, so a file that is read back is the same floor.
            position = draw.uniform(-side / 2, side / 2, 2).round(3)
            if all(np.hypot(*(position - other)) >= MIN_START_DISTANCE for other in positions):
                break
        # The last draw counts even if it is too close: a full floor still has all its starts.
        positions.append(position)
    poses = [
        StartPose(tag=start_tag(i), at=(float(x), float(y), START_ELEVATION), yaw=float(yaw))
        for i, ((x, y), yaw) in enumerate(
            zip(positions, draw.uniform(-np.pi, np.pi, starts).round(3), strict=True)
        )
    ]
    half = side / 2
    return ArenaSpec(
        name="DM-Floor", about="An empty floor.", starts=tuple(poses), extent=((-half, half), (-half, half))
    )


def resolve_arenas(arenas: Arenas, robot: str, robots: int = 1) -> Arenas:
    """Return arenas with the names that only tasks know resolved: kinds to generate, `floor`.

    Args:
        arenas: As they were given.
        robot: The class that passes those that are generated.
        robots: Number of robots that need start poses in arenas that are made here.
    """
    if isinstance(arenas, str):
        if arenas.lower() == "floor":
            return floor_for(robots)
        arenas = GeneratedArenas(kind=arenas, robot=robot) if arenas in KINDS else arenas
    if isinstance(arenas, GeneratedArenas) and arenas.starts < robots:
        return replace(arenas, starts=robots)
    return arenas


@cache
def floor_for(robots: int) -> ArenaSpec:
    """Return the empty floor, or a larger one if so many robots would overlap."""
    # One floor for all teams that have room on it: start poses do not depend on their size.
    if robots * FLOOR_ROOM <= FLOOR_SIDE**2:
        return open_floor()
    return open_floor(side=round(math.sqrt(robots * FLOOR_ROOM), 3), starts=robots)


def spec_of(robot: str | RobotSpec) -> RobotSpec:
    """Return the description of a robot.

    Raises:
        UnknownNameError: No such class.
    """
    return find_robot(robot)


def with_sensors(robots: Sequence[str | RobotSpec], keep: Sequence[str | Mount] | None) -> list[RobotSpec]:
    """Return robots with only some of their sensors; no others are computed.

    Args:
        robots: The robots, as names or descriptions.
        keep: Types of sensors that each keeps if it has them, and mounts that each is given; None: all that
            it has.

    Raises:
        UnknownNameError: No such robot, or a type that none of them has; lists those they have.
    """
    specs = [spec_of(robot) for robot in robots]
    if keep is None:
        return specs
    kinds = {kind.lower() for kind in keep if isinstance(kind, str)}
    extra = tuple(mount for mount in keep if isinstance(mount, Mount))
    there = {mount.kind.lower(): mount.kind for spec in specs for mount in spec.sensors}
    if missing := kinds - set(there):
        known = ", ".join(sorted(there.values())) or "none"
        raise UnknownNameError(
            f"none of the robots has a sensor {', '.join(sorted(missing))}; they have: {known}"
        )
    return [
        replace(spec, sensors=(*(m for m in spec.sensors if m.kind.lower() in kinds), *extra))
        for spec in specs
    ]
