"""Generated arenas for team tasks, and which of their squares robots get to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE, SHARE
from usarmjx.base.worker_processes import spread
from usarmjx.models.compile.reachability import footprint_of
from usarmjx.models.files.find_robot import find_robot
from usarmjx.models.generate import Difficulty, generate
from usarmjx.models.generate.kinds import budget
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.train.envs.recipe import GeneratedArenas
from usarmjx.train.envs.task import TaskView
from usarmjx.train.mapping.maps import MapGrid, reachable_squares

NEAR_START = 5.0
"""Victims that lie nearer than this to the first start pose are found by luck [m]."""


@dataclass(frozen=True, kw_only=True)
class Buildings(GeneratedArenas):
    """Generated arenas in which all robots start together, the first at the first start pose.

    The levels set how many walls there are. Nothing lies on the floor that scanners at the height of a robot
    would miss.

    Attributes:
        roughness: Height of boards and other obstacles.
        clutter: Amount of clutter.
        dead_ends: Share of the walls between rooms with only one doorway.
        radio_shadow: Share of the walls that count twice for the radio.
        sizes: Sizes that the arenas of a level have in turn, as `size`; none: all have that.
        near_victims: Most victims within `NEAR_START` of the first start pose. Victims are then drawn from
            the positions all over the arena where the generator would put as many as it can; None: they are
            where it puts so few.
        together: Let robots start in the free cells nearest to the first start pose; else at those nearest to
            it of `starts` all over the arena.
        spacing: Least distance of two start poses, as far as enough of them have it [m].
    """

    kind: str = "building"
    count: int = 16
    levels: tuple[float, ...] = (0.4, 0.6, 0.8)
    size: tuple[int, int] = (10, 8)
    victims: int | None = 0
    roughness: Annotated[float, SHARE] = 0.0
    clutter: Annotated[float, SHARE] = 0.0
    dead_ends: Annotated[float, SHARE] = 0.0
    radio_shadow: Annotated[float, SHARE] = 1.0
    sizes: Annotated[tuple[tuple[int, int], ...], AT_LEAST_ONE] = ()
    near_victims: Annotated[int | None, NOT_NEGATIVE] = None
    together: bool = False
    spacing: Annotated[float, NOT_NEGATIVE] = 0.0

    def difficulty(self, level: float) -> Difficulty:
        """Return the difficulty of a level."""
        return Difficulty(
            wall_density=level,
            roughness=self.roughness,
            clutter=self.clutter,
            dead_ends=self.dead_ends,
            radio_shadow=self.radio_shadow,
        )

    def arena(self, number: int, seed: int) -> ArenaSpec:
        """As `GeneratedArenas`; its start poses in the order of their distance from the first."""
        sizes = self.sizes or (self.size,)
        # Numbers run through one level after the other, and each level begins with the first size.
        size, level = sizes[number % self.count % len(sizes)], self.levels[number // self.count]
        victims = self.victims if self.near_victims is None else budget(self.kind, size).victims
        # All free cells: the generator spreads fewer over the whole arena, and then there are no near ones.
        starts = size[0] * size[1] if self.together else self.starts
        needs = self.robot, self.reachable, victims, starts
        arena = generate(self.kind, size, seed, self.difficulty(level), *needs)
        if self.near_victims is not None:
            count = len(arena.victims) if self.victims is None else self.victims
            arena = thin_victims(arena, count, self.near_victims, seed)
        arena = spread_starts(sort_starts(arena), self.spacing)
        # Cut at last: sorting and spreading choose among all start poses.
        return replace(arena, starts=arena.starts[: self.starts])


def sort_starts(arena: ArenaSpec) -> ArenaSpec:
    """Return an arena with its start poses in the order of their distance from the first."""
    first = np.array(arena.starts[0].at[:2])
    away = [float(np.hypot(*(np.array(start.at[:2]) - first))) for start in arena.starts]
    # Cells at equal distances are common: without `stable` their order varies between processors.
    return replace(arena, starts=tuple(arena.starts[int(i)] for i in np.argsort(away, kind="stable")))


def spread_starts(arena: ArenaSpec, spacing: float) -> ArenaSpec:
    """Return an arena with start poses in front that are at least so far from all before them [m].

    The others follow. Both keep their order.
    """
    if spacing <= 0:
        return arena
    at = np.array([start.at[:2] for start in arena.starts])
    kept: list[int] = []
    free = np.ones(len(at), bool)
    for i, position in enumerate(at):
        if free[i]:
            kept.append(i)
            # The pose itself drops out here too: its distance is 0.
            free &= np.hypot(*(at - position).T) >= spacing
    order = [*kept, *sorted(set(range(len(at))) - set(kept))]
    return replace(arena, starts=tuple(arena.starts[i] for i in order))


def thin_victims(arena: ArenaSpec, count: int, near: int, seed: int) -> ArenaSpec:
    """Return an arena with only some of its victims, drawn at random.

    Args:
        arena: The arena.
        count: Number of victims; fewer if there are not enough.
        near: Largest number of them within `NEAR_START` of the first start pose, in the plane.
        seed: Of the draw.
    """
    first = np.array(arena.starts[0].at[:2])
    away = np.array([np.hypot(*(np.array(victim.at[:2]) - first)) for victim in arena.victims])
    order = np.random.default_rng(seed).permutation(len(away))
    close = [int(i) for i in order if away[i] < NEAR_START][:near]
    # Drawn in random order, kept in the arena's: names and segments of victims follow that.
    kept = sorted([int(i) for i in order if away[i] >= NEAR_START or int(i) in close][:count])
    return replace(arena, victims=tuple(arena.victims[i] for i in kept))


def arena_notes(arenas: Sequence[ArenaSpec], grid: MapGrid, robot: str) -> dict[str, np.ndarray]:
    """Return what team tasks know of arenas beside their solids (arenas, ...).

    Args:
        arenas: The arenas.
        grid: Their squares.
        robot: A class.

    Returns:
        `reachable`: which squares a robot of the class gets to (arenas, i, j); `extent`: from where to where
        an arena reaches, x and y [m] (arenas, 2, low or high).
    """
    size = footprint_of(find_robot(robot))
    return {
        "reachable": np.stack(spread(partial(reachable_squares, grid=grid, size=size), arenas)),
        "extent": np.array([arena.extent for arena in arenas], np.float32),
    }


# A scene of one arena has no notes in its state, and each trace asks for them several times.
@lru_cache(maxsize=8)
def _notes_of(arena: ArenaSpec, grid: MapGrid, robot: str) -> dict[str, np.ndarray]:
    return arena_notes((arena,), grid, robot)


def note_of(view: TaskView, name: str, grid: MapGrid, robot: str) -> jax.Array:
    """Return what is known of a world's arena, see `arena_notes`; without the axis over arenas."""
    if view.world.arena_state is None:
        return jnp.asarray(_notes_of(view.scene.arena, grid, robot)[name][0])
    return jnp.asarray(view.world.arena_state.notes[name])
