"""Common part of all adapters: the robots of an environment as named agents, and its arrays by name."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UsageError

if TYPE_CHECKING:
    from usarmjx.train.adapters.action_grid import ActionGrid
    from usarmjx.train.envs.env import Env, EnvState

MAX_SEED = 2**31 - 1
"""Seeds are drawn below this: an int32 holds them."""


@dataclass(frozen=True)
class Agent:
    """One robot.

    Attributes:
        name: Of the robot.
        group: Index of its agent group.
        index: Its own in that.
    """

    name: str
    group: int
    index: int


def agents_of(env: "Env") -> tuple[Agent, ...]:
    """Return all robots of an environment, group by group."""
    return tuple(
        Agent(name, g, index) for g, group in enumerate(env.groups) for index, name in enumerate(group.agents)
    )


def check_one_world(env: "Env", library: str) -> None:
    """Refuse an environment of several worlds.

    Raises:
        UsageError: It has another number of worlds than one.
    """
    if env.worlds != 1:
        raise UsageError(
            f"{library} has one world at a time: make {env.name} with worlds=1, not {env.worlds}"
        )


def check_one_group(env: "Env", purpose: str) -> None:
    """Refuse an environment of several robot classes.

    Raises:
        UsageError: Its robots are of several classes; names them.
    """
    if len(env.groups) != 1:
        names = ", ".join(group.name for group in env.groups)
        raise UsageError(f"{purpose} needs robots of one class, but {env.name} has {names}")


def check_no_options(options: "Mapping[str, Any] | None") -> None:
    """Refuse options of a reset.

    Raises:
        UsageError: There are any; names them.
    """
    if options:
        raise UsageError(f"unknown options of reset: {', '.join(sorted(map(str, options)))}; there are none")


def compiled_step(env: "Env") -> "Callable[[EnvState, tuple[Array, ...]], EnvState]":
    """Return the environment's step, compiled where it can be."""
    return jax.jit(env.step) if env.traceable else env.step


def with_held(before: "EnvState", after: "EnvState", held: Array) -> "EnvState":
    """Return a state in which some worlds are as they were.

    Args:
        before: State of all before.
        after: State of all now.
        held: Which are as they were (worlds,).
    """

    def chosen(old: Any, new: Any) -> Any:  # noqa: ANN401 - arrays of NumPy or JAX, which stay what they are
        shape = np.shape(new)
        if new is old or shape[:1] != np.shape(held):
            return new  # what all worlds share
        xp: Any = np if isinstance(new, np.ndarray) else jnp
        return xp.where(held.reshape(-1, *[1] * (len(shape) - 1)), old, new)

    return jax.tree.map(chosen, before, after)


def by_agent(env: "Env", values: tuple[Any, ...]) -> dict[str, Any]:
    """Return what each robot of the first world has of per-group arrays (worlds, robots, ...)."""
    return {agent.name: values[agent.group][0, agent.index] for agent in agents_of(env)}


def alive_names(env: "Env", alive: tuple[Any, ...] | None) -> list[str]:
    """Return the names of the first world's agents that are alive, from per-group masks; None: all are."""
    return [one.name for one in agents_of(env) if alive is None or alive[one.group][0, one.index]]


def stack_actions(
    env: "Env",
    actions: Mapping[str, Any],
    xp: ModuleType = np,
    acting: Collection[str] | None = None,
    grids: "tuple[ActionGrid, ...] | None" = None,
) -> tuple[Any, ...]:
    """Return the actions of one world's robots (action_size,) by group (1, robots, action_size).

    Args:
        env: The environment.
        actions: By name of the agent.
        xp: NumPy, or JAX's.
        acting: Agents that are alive; None: all. The others' actions are 0.
        grids: Grid of each group, whose robots choose from it; None: actions are continuous.

    Raises:
        UsageError: A robot without an action, an action without a robot, or one of another size.
    """
    known = [one.name for one in agents_of(env) if acting is None or one.name in acting]
    wrong = sorted({*known} ^ {*actions})
    if wrong:
        raise UsageError(f"an action for each of {', '.join(known)}; missing or unknown: {', '.join(wrong)}")
    stacked: list[Any] = []
    for g, group in enumerate(env.groups):
        nothing = xp.zeros(group.action_size, xp.float32)
        known_rows = (
            actions
            if grids is None
            else {name: grids[g].chosen(actions[name], xp) for name in group.agents if name in actions}
        )
        rows = [xp.asarray(known_rows.get(name, nothing), xp.float32) for name in group.agents]
        for name, row in zip(group.agents, rows, strict=True):
            if row.shape != (group.action_size,):
                raise UsageError(f"action of {name}: shape {row.shape}, expected ({group.action_size},)")
        stacked.append(xp.stack(rows)[None])
    return tuple(stacked)


def draw_seed(generator: np.random.Generator) -> int:
    """Return a seed for an environment."""
    return int(generator.integers(MAX_SEED))
