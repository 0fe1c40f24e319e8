"""Runs of several seeds in one program: what one run computes, mapped over a leading axis of seeds.

The worlds of all seeds are one batch, in which each seed has a group as large as it has alone. Networks and
updates have an axis over seeds. Neither a world nor a policy learns of another seed's.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from usarmjx.base import random
from usarmjx.base.program_cache import ProgramCache
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.state import Memory
from usarmjx.train.envs.task import Carry, Policy
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.learner import EnvFactory, Trainer
from usarmjx.train.learning.processes import ProcessGroup
from usarmjx.train.learning.rollout import Rollout
from usarmjx.train.learning.train_state import STAGGER_STREAM, Networks, TrainState
from usarmjx.train.learning.trajectory import (
    Decision,
    GroupArrays,
    RolloutEnds,
    RolloutState,
    StepView,
    Trajectory,
)

SEED_AXIS = "seed"
"""Axis over seeds within a rollout."""
Tree = TypeVar("Tree")
"""Any tree of arrays."""


def split_worlds(tree: Tree, seeds: int, axis: int = 0) -> Tree:
    """Return arrays (..., seeds, worlds, ...) of arrays with an axis over the worlds of all seeds."""

    def split(leaf: jax.Array) -> jax.Array:
        shape = leaf.shape
        return leaf.reshape(*shape[:axis], seeds, shape[axis] // seeds, *shape[axis + 1 :])

    return jax.tree.map(split, tree)


def join_worlds(tree: Tree) -> Tree:
    """Return arrays over the worlds of all seeds (seeds * worlds, ...) of arrays (seeds, worlds, ...)."""

    def join(leaf: jax.Array) -> jax.Array:
        return leaf.reshape(leaf.shape[0] * leaf.shape[1], *leaf.shape[2:])

    return jax.tree.map(join, tree)


def stack_seeds(trees: list[Tree]) -> Tree:
    """Return the trees of all seeds as one, with a leading axis over seeds."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def of_seed(tree: Tree, number: int) -> Tree:
    """Return the part of the seed of an index, of a tree with a leading axis over seeds."""
    return jax.tree.map(lambda leaf: leaf[number], tree)


class SeedRollout(Rollout):
    """Rollouts of several seeds at once; train states have a leading axis over seeds.

    Worlds, trajectories and rollout states have one axis over the worlds of all seeds, in order.

    Args:
        seeds: The seeds.
        env: The worlds of all seeds.
        networks: Shapes of policy and critics.
        config: Settings of each run.
        teacher: See `Rollout`.
        program_cache: Cache of its programs.
    """

    def __init__(
        self,
        seeds: tuple[int, ...],
        env: Env,
        networks: Networks,
        config: Config,
        teacher: Policy | None = None,
        program_cache: ProgramCache | None = None,
    ) -> None:
        super().__init__(env, networks, config, 0, teacher, program_cache)
        self.seeds, self.worlds = seeds, env.worlds // len(seeds)

    def _split(self, tree: Tree) -> Tree:
        return split_worlds(tree, len(self.seeds))

    def _mapped(self, function: Callable[..., Any], train_state: TrainState) -> Callable[..., Any]:
        """Return a function of train state and more, mapped over seeds in the same iteration."""
        # Not mapped: a condition on it stays one, where else both of its branches were computed.
        iteration = train_state.iteration[0]

        def run(train_state: TrainState, *rest: Any) -> Any:  # noqa: ANN401 - as of the function
            return function(train_state.replace(iteration=iteration), *rest)

        return jax.vmap(run, axis_name=SEED_AXIS)

    def _any(self, where: jax.Array) -> jax.Array:
        """Return whether something is true in any world of any seed ()."""
        return jax.lax.psum(where.any().astype(jnp.int32), SEED_AXIS) > 0

    def _seeds(self) -> tuple[Any, jax.Array]:
        keys = jnp.stack([random.key(seed) for seed in self.seeds])
        return keys, random.fold_in(keys, STAGGER_STREAM)

    def _initial_carry(self, key: jax.Array) -> tuple[jax.Array, jax.Array, GroupArrays]:
        return join_worlds(jax.vmap(super()._initial_carry)(key))

    def _choose_actions(
        self,
        train_state: TrainState,
        view: StepView,
        carry: tuple[GroupArrays, GroupArrays, Carry],
        worlds: jax.Array,
        key: tuple[jax.Array, Any],
        memory: Memory,
    ) -> tuple[GroupArrays, Decision]:
        base = super()._choose_actions
        keys, step = key

        def choose(train_state: TrainState, key: jax.Array, *seen: Any) -> tuple[GroupArrays, Decision]:  # noqa: ANN401
            view, carry, worlds, memory = seen
            return base(train_state, view, carry, worlds, (key, step), memory)

        seen = self._split((view, carry, worlds, memory))
        return join_worlds(self._mapped(choose, train_state)(train_state, keys, *seen))

    def _record_step(
        self,
        train_state: TrainState,
        episode: tuple[jax.Array, jax.Array],
        decision: Decision,
        before: StepView,
        after: StepView,
    ) -> tuple[Trajectory, tuple[GroupArrays, GroupArrays, Carry], jax.Array, dict[str, jax.Array]]:
        mapped = self._mapped(super()._record_step, train_state)
        *rows, sums = mapped(train_state, *self._split((episode, decision, before, after)))
        step, carry, episode_return = join_worlds(tuple(rows))
        return step, carry, episode_return, sums

    def _rollout_ends(
        self,
        train_state: TrainState,
        before: tuple[GroupArrays, GroupArrays],
        after: tuple[jax.Array, GroupArrays],
        view: StepView,
    ) -> RolloutEnds:
        mapped = self._mapped(super()._rollout_ends, train_state)
        return join_worlds(mapped(train_state, *self._split((before, after, view))))


class SeedTrainer(Trainer):
    """Runs of several seeds at once, in one process; train states have a leading axis over seeds.

    Args:
        env: The worlds of all seeds, or what makes them.
        config: Settings of each run; its seed does not matter.
        process_group: This process.
        seeds: The seeds.
    """

    def __init__(
        self,
        env: Env | EnvFactory,
        config: Config,
        process_group: ProcessGroup,
        seeds: tuple[int, ...],
    ) -> None:
        self.seeds, self.runs = seeds, len(seeds)
        super().__init__(env, config, process_group)
        self._fold = jax.jit(jax.vmap(jax.random.fold_in, (0, None)))

    def _make_rollout(self, first: int, teacher: Policy | None) -> Rollout:
        del first
        return SeedRollout(self.seeds, self.env, self.networks, self.config, teacher, self._program_cache)

    def _updater(self) -> Callable[..., tuple[TrainState, dict[str, jax.Array]]]:
        mapped = jax.vmap(super()._updater(), in_axes=(0, (1, 0, 1), 0))

        def update_all(
            train_state: TrainState,
            experience: tuple[Trajectory, RolloutEnds, dict[str, jax.Array]],
            stream: jax.Array,
        ) -> tuple[TrainState, dict[str, jax.Array]]:
            steps, ends, sums = experience
            split = split_worlds(steps, self.runs, 1), split_worlds(ends, self.runs), sums
            return mapped(train_state, split, stream)

        return update_all

    def _stream_key(self, stream: int) -> jax.Array:
        return random.fold_in(jnp.stack([random.key(seed) for seed in self.seeds]), stream)

    def starts(self) -> tuple[TrainState, RolloutState, jax.Array]:
        """Return the arguments of the first rollout, on any device."""
        learner = stack_seeds([self._begin(random.key(seed)) for seed in self.seeds])
        return learner, self.rollout.start(self.level(0)), self._key

    def numbers(self, known: dict[str, jax.Array]) -> list[dict[str, float]]:
        """Return the numbers for the log of each seed, once they are computed."""
        found = jax.device_get(known)
        return [{name: float(value[k]) for name, value in found.items()} for k in range(self.runs)]
