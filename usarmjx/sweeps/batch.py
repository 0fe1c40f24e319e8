"""A group of cells as worlds of one environment: the episodes of a cell are worlds beside each other.

A world has its key by the cell's seed and its number within the cell, and its arena, ranges and weights as
data; so an episode is the same in whatever batch it is played, to the bit where the engine is C MuJoCo.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base import random
from usarmjx.base.errors import UsageError
from usarmjx.models.compile.arena_set import ArenaState
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.sim.batch import select_worlds
from usarmjx.sweeps.resolve import Resolved
from usarmjx.train.envs.presence import carry_of_alive
from usarmjx.train.envs.state import EnvState
from usarmjx.train.envs.task import Policy
from usarmjx.train.make import build_env

Tick = Callable[[float], None]
"""Receives the share of a batch that is done."""


@dataclass(frozen=True, kw_only=True)
class CellEpisodes:
    """The episodes of a cell.

    Attributes:
        scores: Final scores (episodes,).
        steps: Their lengths (episodes,).
        bad: Which of them went wrong in their physics (episodes,).
        metrics: The task's metrics at their ends, by name (episodes,).
        seconds: The cell's share of the time that its batch took [s].
        agents: Robots that act in each world; 0: not known.
    """

    scores: np.ndarray
    steps: np.ndarray
    bad: np.ndarray
    metrics: dict[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    seconds: float = 0.0
    agents: int = 0


class StepOutcome(NamedTuple):
    """Outcome of a step in all worlds.

    Attributes:
        done: Worlds whose episode has ended (worlds,).
        values: Score, whether the physics went wrong, metrics by name (worlds,).
        alive: As `EnvState.alive`.
    """

    done: jax.Array
    values: dict[str, Any]
    alive: tuple[jax.Array, ...] | None


class EpisodeResults(NamedTuple):
    """Results of the first episode of each world, on the device.

    Attributes:
        over: Whether it has ended (worlds,).
        steps: Its length; 0 before its end (worlds,).
        values: As `StepOutcome.values`, at its end (worlds,).
    """

    over: jax.Array
    steps: jax.Array
    values: dict[str, Any]


class GroupRunner:
    """Plays batches of cells that differ in data only; all of them with what is compiled for the first.

    Args:
        cells: Cells of the group that have all of its arenas between them.
        size: Number played at once.
        engine: The physics engine.
        seed: Of what no world draws from.

    Raises:
        UsageError: A cell's world cannot be built.
    """

    def __init__(self, cells: Sequence[Resolved], size: int, engine: str, seed: int = 0) -> None:
        self._first, self._size = cells[0], size
        self._episodes = cells[0].episodes
        library = list(dict.fromkeys(spec for cell in cells for spec in cell.arenas or ()))
        self._places: dict[ArenaSpec, int] = {spec: place for place, spec in enumerate(library)}
        task = cells[0].task
        # The arenas of all cells, so that those of a cell are data.
        task = replace(task, arena=tuple(library)) if library else task
        self.env = build_env(
            task, size * self._episodes, name=cells[0].settings["task"], engine=engine, seed=seed
        )
        # Compiled once for the whole group: weights and arenas of a batch are arguments.
        self._step = jax.jit(self._act)
        self._note = jax.jit(self._noted)

    def run(self, chosen: Sequence[Resolved], tick: Tick | None = None) -> list[CellEpisodes]:
        """Play the episodes of some cells of the group.

        Args:
            chosen: The cells, at most as many as are played at once.
            tick: Receives the progress.

        Raises:
            UsageError: A policy that does not fit.
        """
        begun = time.perf_counter()
        # Spare places repeat the last cell, as shapes are compiled; their results are dropped.
        cells = [*chosen, *[chosen[-1]] * (self._size - len(chosen))]
        weights = jax.tree.map(_stacked, *[cell.driver.weights for cell in cells])
        found = self._play(cells, weights, tick or (lambda share: None))
        taken = (time.perf_counter() - begun) / len(chosen)
        agents = sum(len(group.agents) for group in self.env.groups)
        own = [self._of(found, place) for place in range(len(chosen))]
        return [replace(one, seconds=taken, agents=agents) for one in own]

    def _of(self, found: CellEpisodes, place: int) -> CellEpisodes:
        rows = slice(place * self._episodes, (place + 1) * self._episodes)
        return CellEpisodes(
            scores=found.scores[rows],
            steps=found.steps[rows],
            bad=found.bad[rows],
            metrics={name: values[rows] for name, values in found.metrics.items()},
        )

    # Policies: of each cell its own weights, carry and key.

    def _policy(self, weights: Any) -> Policy:  # noqa: ANN401 - a tree of arrays
        make = self._first.driver.make
        if make is None:
            raise UsageError("a client over TCP drives in no batch")
        return make(self.env, weights)

    def _begin(self, weights: Any) -> Any:  # noqa: ANN401
        """Return the carry of each cell's worlds (cells, episodes, ...)."""
        # The shapes of a carry do not depend on the weights: those of the first cell are as good as any.
        first = jax.tree.map(lambda rows: rows[0], weights)
        carry = self._policy(first).initial_carry(self._episodes)
        return jax.tree.map(lambda one: jnp.broadcast_to(one, (self._size, *jnp.shape(one))), carry)

    def _act(
        self,
        weights: Any,  # noqa: ANN401
        carry: Any,  # noqa: ANN401
        obs: tuple[jax.Array, ...],
        keys: jax.Array,
        step: jax.Array,
    ) -> tuple[Any, tuple[jax.Array, ...]]:
        """Return carry and actions of all worlds, cell by cell, in a step of the batch."""
        shape = self._size, self._episodes
        # A key of the cell's seed and the step: the draw does not depend on the place in the batch.
        keys = jax.vmap(jax.random.fold_in, (0, None))(keys, step)
        apart = jax.tree.map(lambda one: one.reshape(*shape, *one.shape[1:]), obs)

        def of_cell(
            weights: Any,  # noqa: ANN401
            carry: Any,  # noqa: ANN401
            obs: tuple[jax.Array, ...],
            key: jax.Array,
        ) -> tuple[Any, tuple[jax.Array, ...]]:
            return self._policy(weights).act(carry, obs, key)

        carry, actions = jax.vmap(of_cell)(weights, carry, apart, keys)
        return carry, jax.tree.map(lambda one: one.reshape(self.env.worlds, *one.shape[2:]), actions)

    # Worlds.

    def _starts(self, cells: Sequence[Resolved], keys: jax.Array) -> EnvState:
        """Return all worlds at the start of their episodes, given the key of each cell (cells,)."""
        ranges = {
            name: jnp.asarray(
                np.repeat([cell.ranges[name] for cell in cells], self._episodes, 0), jnp.float32
            )
            for name in cells[0].ranges
        }
        keys = _episode_keys(keys, jnp.arange(self._episodes))
        return self.env.reset_each(keys, self._arenas(cells), ranges or None)

    def _arenas(self, cells: Sequence[Resolved]) -> ArenaState | None:
        """Return the arena of each world."""
        if not self._places:
            return None
        found: dict[tuple[str, ...], np.ndarray] = {}  # arenas are slow to find, and many cells share them
        for cell in cells:
            if cell.labels not in found:
                found[cell.labels] = np.array([self._places[spec] for spec in cell.arenas or ()])
        turns = np.arange(self._episodes)
        rows = np.concatenate([found[cell.labels][turns % len(cell.labels)] for cell in cells])
        known = self.env.scene.arenas
        assert known is not None  # as there are places
        return jax.tree.map(lambda one: jnp.asarray(one[rows]), known.states)

    def _noted(
        self,
        results: EpisodeResults,
        carry: Any,  # noqa: ANN401
        begin: Any,  # noqa: ANN401
        before: tuple[jax.Array, ...] | None,
        now: StepOutcome,
        step: jax.Array,
    ) -> tuple[EpisodeResults, Any, jax.Array]:
        """Return the results with those of a step, the carry with ended episodes reset, and if all are over.

        Args:
            results: Results before.
            carry: Carry of the policies after the step (cells, episodes, ...).
            begin: Carry at the start of an episode.
            before: Robots alive before the step, as `EnvState.alive`.
            now: Outcome of the step.
            step: Number of steps made.
        """
        # Only the first end counts: worlds go on into further episodes until all are over.
        first = now.done & ~results.over
        taken = jax.tree.map(partial(jnp.where, first), now.values, results.values)
        results = EpisodeResults(
            over=results.over | now.done, steps=jnp.where(first, step, results.steps), values=taken
        )
        # Not -1: a policy without memory has a carry of no numbers.
        flat = jax.tree.map(lambda one: one.reshape(self.env.worlds, *one.shape[2:]), (begin, carry))
        fresh = carry_of_alive(jax.tree.map(partial(select_worlds, now.done), *flat), before, now.alive)
        carry = jax.tree.map(lambda one, old: one.reshape(old.shape), fresh, carry)
        return results, carry, results.over.all()

    def _play(self, cells: Sequence[Resolved], weights: Any, tick: Tick) -> CellEpisodes:  # noqa: ANN401
        """Return the first episode of each world."""
        env = self.env
        begin = carry = self._begin(weights)
        keys = _cell_keys(cells)
        state, step, pending = self._starts(cells, keys), 0, None
        # Only shapes and types matter: each world is written at its first end.
        values = jax.tree.map(jnp.zeros_like, _outcome(state).values)
        none = jnp.zeros(env.worlds, bool)
        results = EpisodeResults(over=none, steps=jnp.zeros(env.worlds, int), values=values)
        over = False
        while not over:
            carry, actions = self._step(weights, carry, state.obs, keys, step)
            before, state = state, env.step(state, actions)
            step += 1
            results, carry, ended = self._note(results, carry, begin, before.alive, _outcome(state), step)
            tick(step / env.episode_steps)
            # The step before: the device computes this one while the next one is prepared.
            over = bool(ended if pending is None or step >= env.episode_steps else pending)
            pending = ended
        found = jax.device_get(results)
        return CellEpisodes(
            scores=found.values["score"].astype(float),
            steps=found.steps.astype(int),
            bad=found.values["bad"],
            metrics={name: one.astype(float) for name, one in found.values["metrics"].items()},
        )


def _outcome(state: EnvState) -> StepOutcome:
    values = {"score": state.final_score, "bad": state.bad, "metrics": state.metrics}
    return StepOutcome(done=state.done, values=values, alive=state.alive)


def _stacked(*rows: Any) -> jax.Array:  # noqa: ANN401 - arrays
    """Return the weights of cells as one array, which goes to the device at once."""
    if any(isinstance(row, jax.Array) for row in rows):
        return jnp.stack(rows)
    return jnp.asarray(np.stack(rows))


def _cell_keys(cells: Sequence[Resolved]) -> jax.Array:
    """Return the key of each cell's seed (cells,)."""
    seeds = [cell.settings["seed"] for cell in cells]
    # Cells share a few seeds, and each key is an operation of its own on the device.
    places = {seed: place for place, seed in enumerate(dict.fromkeys(seeds))}
    return jnp.stack([random.key(seed) for seed in places])[np.array([places[seed] for seed in seeds])]


@jax.jit
def _episode_keys(keys: jax.Array, numbers: jax.Array) -> jax.Array:
    """Return the keys of the episodes of cells, cell by cell (cells * episodes,)."""
    return random.fold_in(keys, numbers).reshape(-1)
