"""Generated arenas for team tasks, and which of their squares robots get to."""

from dataclasses import dataclass, replace
from functools import lru_cache
from types import ModuleType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.models.build.arena_set import ArenaSet
from usarmjx.models.build.reach import footprint_of
from usarmjx.models.generate import Difficulty, generate
from usarmjx.models.generate.kinds import budget
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.train.envs.recipe import GeneratedArenas
from usarmjx.train.envs.task import TaskView
from usarmjx.train.mapping.maps import MapGrid, grid_of, reachable_squares

NEAR_START = 5.0
"""Victims that lie nearer than this to the first start pose are found by luck [m]."""
FINGERPRINT_FREQUENCIES = np.array([12.9898, 5.3719, 8.1637, 3.7331])
"""Of the angles that tell arenas apart; one number each would not do among thousands of arenas."""


@dataclass(frozen=True, kw_only=True)
class Buildings(GeneratedArenas):
    """Generated arenas in which all robots start together, the first at the first start pose.

    The levels set how many walls there are. Nothing lies on the floor that scanners at the height of a robot
    would miss.

    Attributes:
        roughness: Height of boards and other obstacles, from 0 to 1.
        clutter: How much lies about, from 0 to 1.
        dead_ends: Share of the walls between rooms with only one doorway.
        radio_shadow: Share of the walls that count twice for the radio.
        sizes: Sizes that the arenas of a level have in turn, as `size`; none: all have that.
        near_victims: Most victims within `NEAR_START` of the first start pose. Victims are then drawn from
            the places all over the arena where the generator would put as many as it can; None: they are
            where it puts so few.
    """

    kind: str = "building"
    count: int = 16
    levels: tuple[float, ...] = (0.4, 0.6, 0.8)
    size: tuple[int, int] = (10, 8)
    victims: int | None = 0
    roughness: float = 0.0
    clutter: float = 0.0
    dead_ends: float = 0.0
    radio_shadow: float = 1.0
    sizes: tuple[tuple[int, int], ...] = ()
    near_victims: int | None = None

    def difficulty(self, level: float) -> Difficulty:
        """Return the difficulty of a level."""
        return Difficulty(
            wall_density=level,
            roughness=self.roughness,
            clutter=self.clutter,
            dead_ends=self.dead_ends,
            radio_shadow=self.radio_shadow,
        )

    def arenas(self) -> tuple[ArenaSpec, ...]:
        """Return the arenas, the easy ones first."""
        seeds, levels = self.seeds(), np.repeat(self.levels, self.count)
        sizes = self.sizes or (self.size,)
        return tuple(
            sort_starts(self._arena(sizes[number % self.count % len(sizes)], int(seed), float(level)))
            for number, (seed, level) in enumerate(zip(seeds, levels, strict=True))
        )

    def _arena(self, size: tuple[int, int], seed: int, level: float) -> ArenaSpec:
        """Return an arena, its start poses in any order."""
        victims = self.victims if self.near_victims is None else budget(self.kind, size).victims
        arena = generate(self.kind, size, seed, self.difficulty(level), self.robot, self.reachable, victims)
        if self.near_victims is None:
            return arena
        count = len(arena.victims) if self.victims is None else self.victims
        return thin_victims(arena, count, self.near_victims, seed)


def sort_starts(arena: ArenaSpec) -> ArenaSpec:
    """Return an arena with its start poses in the order of their distance from the first."""
    first = np.array(arena.starts[0].at[:2])
    away = [float(np.hypot(*(np.array(start.at[:2]) - first))) for start in arena.starts]
    return replace(arena, starts=tuple(arena.starts[int(i)] for i in np.argsort(away, kind="stable")))


def thin_victims(arena: ArenaSpec, count: int, near: int, seed: int) -> ArenaSpec:
    """Return an arena with only some of its victims, drawn at random.

    Args:
        arena: The arena.
        count: How many victims; fewer if there are not enough.
        near: How many of them, at most, within `NEAR_START` of the first start pose, in the plane.
        seed: Of the draw.
    """
    first = np.array(arena.starts[0].at[:2])
    away = np.array([np.hypot(*(np.array(victim.at[:2]) - first)) for victim in arena.victims])
    order = np.random.default_rng(seed).permutation(len(away))
    close = [int(i) for i in order if away[i] < NEAR_START][:near]
    kept = sorted([int(i) for i in order if away[i] >= NEAR_START or int(i) in close][:count])
    return replace(arena, victims=tuple(arena.victims[i] for i in kept))


class ArenaGrid(NamedTuple):
    """The squares of a scene's arenas.

    Attributes:
        grid: Where they are; the same for all arenas.
        reachable: Which a robot gets to (arenas, i, j).
        fingerprints: What tells the arenas apart (arenas, numbers).
        extents: From where to where they reach, x and y [m] (arenas, 2, low or high).
    """

    grid: MapGrid
    reachable: np.ndarray
    fingerprints: np.ndarray
    extents: np.ndarray


@lru_cache(maxsize=8)
def arena_grid_of(where: ArenaSpec | ArenaSet, cell: float, robot: str) -> ArenaGrid:
    """Return the squares of one or several arenas, and which a robot of a class gets to."""
    arenas = where.arenas if isinstance(where, ArenaSet) else (where,)
    grid, size = grid_of(tuple(arenas), cell), footprint_of(ROBOTS.get(robot))
    tables = np.stack([reachable_squares(arena, grid, size) for arena in arenas])
    probes = [_fingerprint(pos, np) for pos in where.states.pos] if isinstance(where, ArenaSet) else [[0.0]]
    return ArenaGrid(
        grid=grid,
        reachable=tables,
        fingerprints=np.array(probes, np.float32),
        extents=np.array([arena.extent for arena in arenas], np.float32),
    )


def _fingerprint(pos: Array, xp: ModuleType) -> Array:
    """Return numbers that differ between two arenas whose solids differ (numbers,): sums of sines."""
    flat = np.arange(pos.size).reshape(pos.shape)
    inside = pos[..., 2:] > -100.0  # parked ones say nothing
    weights = np.cos(FINGERPRINT_FREQUENCIES[:, None, None] * flat).astype(np.float32)
    return (xp.where(inside, pos, 0.0) * weights).sum((1, 2))


def _own_row(view: TaskView, arena_grid: ArenaGrid, table: np.ndarray) -> jax.Array:
    """Return the row of a table (arenas, ...) for a world's arena.

    The arena is known by where its solids are, as libraries may be in any order (`Env.at_level`).
    """
    rows = jnp.asarray(table)
    if view.world.arena_state is None:
        return rows[0]
    own = _fingerprint(view.world.arena_state.pos, jnp)
    return rows[jnp.argmin(jnp.abs(own - arena_grid.fingerprints).max(-1))]


def reachable_of(view: TaskView, arena_grid: ArenaGrid) -> jax.Array:
    """Return which squares of a world's arena a robot gets to (i, j)."""
    return _own_row(view, arena_grid, arena_grid.reachable)


def extent_of(view: TaskView, arena_grid: ArenaGrid) -> jax.Array:
    """Return from where to where a world's arena reaches, x and y [m] (2, low or high)."""
    return _own_row(view, arena_grid, arena_grid.extents)
