"""Common part of all adapters: robots as named agents, arrays by name, actions as choices, pictures."""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.base.errors import UsageError
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.sensors.cameras.picture import Viewpoint, pinhole_viewpoint

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env, EnvState
    from usarmjx.train.envs.state import AgentGroup


MAX_SEED = 2**31 - 1
"""Seeds are drawn below this: an int32 holds them."""
Actions = Literal["continuous", "discrete"]
BINS = 3
"""Values of each action: full back, none, full ahead."""
MAX_CHOICES = 4096
"""Choices of a robot that are allowed."""
RENDER_MODES = ("rgb_array",)
WIDTH, HEIGHT = 320, 240
"""Size of a picture [pixels]."""
FOV = 1.0
"""Horizontal field of view [rad]."""
MARGIN = 1.1
"""Factor on the arena's extent within a picture."""


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
        # Kind kept: a NumPy engine's state must not become JAX's within one step.
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
    # Both ways: a misspelt name is unknown, and that of a robot is missing.
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
        # Robots that take no part have no action: they do nothing.
        rows = [xp.asarray(known_rows.get(name, nothing), xp.float32) for name in group.agents]
        for name, row in zip(group.agents, rows, strict=True):
            if row.shape != (group.action_size,):
                raise UsageError(f"action of {name}: shape {row.shape}, expected ({group.action_size},)")
        stacked.append(xp.stack(rows)[None])
    return tuple(stacked)


def draw_seed(generator: np.random.Generator) -> int:
    """Return a seed for an environment."""
    return int(generator.integers(MAX_SEED))


@dataclass(frozen=True)
class ActionGrid:
    """A grid of the actions of one robot.

    Each of its actions has evenly spaced values from -1 to 1. A choice is a number of a point of the grid, in
    which the last action varies fastest: of 3 values and 2 actions, 0 is (-1, -1), 1 is (-1, 0), 4 is (0, 0).
    A robot that chooses one of several things has a point for each of these.

    Attributes:
        bins: Values of each action.
        size: Actions of the robot.
        chooses: Whether it chooses one of as many things.
    """

    bins: int
    size: int
    chooses: bool = False

    @property
    def choices(self) -> int:
        """Number of points."""
        return self.size if self.chooses else self.bins**self.size

    @cached_property
    def points(self) -> np.ndarray:
        """Actions of each choice (choices, size)."""
        if self.chooses:
            return np.eye(self.size, dtype=np.float32)
        values = np.linspace(-1.0, 1.0, self.bins, dtype=np.float32)
        # Without `ij` meshgrid swaps the first two axes, and the last action would not vary fastest.
        return np.stack(np.meshgrid(*[values] * self.size, indexing="ij"), -1).reshape(-1, self.size)

    def chosen(self, choices: Any, xp: ModuleType = np) -> Any:  # noqa: ANN401 - arrays of `xp`
        """Return the actions (..., size) of choices (...).

        JAX cannot refuse a number that is no choice; it takes the nearest one.

        Args:
            choices: Whole numbers.
            xp: NumPy, or JAX's.

        Raises:
            UsageError: Another number than from 0 to `choices` - 1, with NumPy.
        """
        numbers = xp.asarray(choices)
        if not xp.issubdtype(numbers.dtype, xp.integer):
            raise UsageError(f"discrete actions of type {numbers.dtype}, expected whole numbers")
        # Under jit the values are unknown, so nothing can be refused.
        if xp is not np:
            return xp.asarray(self.points)[xp.clip(numbers, 0, self.choices - 1)]
        if numbers.size and not 0 <= numbers.min() <= numbers.max() < self.choices:
            raise UsageError(
                f"discrete actions from {numbers.min()} to {numbers.max()}, allowed are 0 to "
                f"{self.choices - 1}"
            )
        return self.points[numbers]


def action_grids(
    groups: "tuple[AgentGroup, ...]", actions: Actions, bins: int
) -> tuple[ActionGrid, ...] | None:
    """Return the grid of each group's robots; None: actions are continuous.

    Args:
        groups: The groups.
        actions: Kind of action.
        bins: Values of each action, where they are discrete.

    Raises:
        UsageError: Another kind, fewer than two values, or too many choices; or choices with a vector.
    """
    if actions not in get_args(Actions):
        raise UsageError(f"actions is {actions!r}, allowed are 'continuous' and 'discrete'")
    if actions == "continuous":
        return None
    if bins < 2:
        raise UsageError(f"bins is {bins}, expected at least 2")
    for group in groups:
        if group.vector.size:
            raise UsageError(
                f"actions of {group.name} are choices and a vector of {group.vector.size} numbers, "
                "not discrete: take actions='continuous'"
            )
    grids = tuple(ActionGrid(bins, group.action_size, group.discrete) for group in groups)
    for group, grid in zip(groups, grids, strict=True):
        if grid.choices > MAX_CHOICES:
            raise UsageError(
                f"bins is {bins}: {group.name} has {grid.size} actions, {grid.choices} choices, at most "
                f"{MAX_CHOICES} are allowed"
            )
    return grids


def own_keywords(keywords: dict[str, Any]) -> dict[str, Any]:
    """Take an adapter's `actions` and `bins` out of keywords, and leave fields of the task.

    Tasks may have a field `actions`, too: a value that is no kind of action is the task's. `bins` alone asks
    for discrete actions.

    Args:
        keywords: Of `make`; loses what is returned.
    """
    own = {"bins": keywords.pop("bins"), "actions": "discrete"} if "bins" in keywords else dict[str, Any]()
    if keywords.get("actions") in get_args(Actions):
        own["actions"] = keywords.pop("actions")
    return own


def check_render_mode(mode: str | None) -> None:
    """Refuse a render mode that no adapter has.

    Raises:
        UsageError: Another mode than None or `rgb_array`.
    """
    if mode is not None and mode not in RENDER_MODES:
        raise UsageError(f"render_mode {mode!r}, expected None or {', '.join(RENDER_MODES)}")


def overhead_viewpoint(arena: ArenaSpec) -> Viewpoint:
    """Return a viewpoint above an arena that sees its whole extent; x of the arena points to the right."""
    (x0, x1), (y0, y1) = arena.extent
    # At least 1 m: an arena without extent would give a camera at the floor.
    wide = max(x1 - x0, (y1 - y0) * WIDTH / HEIGHT, 1.0)
    height = arena.floor + MARGIN * wide / (2 * math.tan(FOV / 2))
    pos = np.array([(x0 + x1) / 2, (y0 + y1) / 2, height], np.float32)
    # Columns: ahead is down, left is -x, up in the picture is y.
    mat = np.array([[0, -1, 0], [0, 0, 1], [-1, 0, 0]], np.float32)
    return pinhole_viewpoint(pos, mat, FOV)


def picture_of(env: "Env", state: "EnvState", world: int = 0) -> np.ndarray:
    """Return a picture of a world from above, uint8 (height, width, 3)."""
    viewpoint = overhead_viewpoint(env.batch.arena_of(state.batch, world))
    return np.asarray(env.batch.render_view(state.batch, world, viewpoint, WIDTH, HEIGHT).rgb)
