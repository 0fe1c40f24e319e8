"""Actions of robots as numbers from -1 to 1, or as choices from a grid of them: the adapters' `actions`."""

from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from usarmjx.base.errors import UsageError

if TYPE_CHECKING:
    from usarmjx.train.envs.state import AgentGroup

Actions = Literal["continuous", "discrete"]
BINS = 3
"""Values of each action: full back, none, full ahead."""
MAX_CHOICES = 4096
"""Choices of a robot that are allowed."""


@dataclass(frozen=True)
class ActionGrid:
    """A grid of the actions of one robot.

    Each of its actions has evenly spaced values from -1 to 1. A choice is a number of a point of the grid, in
    which the last action varies fastest: of 3 values and 2 actions, 0 is (-1, -1), 1 is (-1, 0), 4 is (0, 0).

    Attributes:
        bins: Values of each action.
        size: Actions of the robot.
    """

    bins: int
    size: int

    @property
    def choices(self) -> int:
        """Number of points."""
        return self.bins**self.size

    @cached_property
    def points(self) -> np.ndarray:
        """Actions of each choice (choices, size)."""
        values = np.linspace(-1.0, 1.0, self.bins, dtype=np.float32)
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
        UsageError: Another kind, fewer than two values, or too many choices.
    """
    if actions not in get_args(Actions):
        raise UsageError(f"actions is {actions!r}, allowed are 'continuous' and 'discrete'")
    if actions == "continuous":
        return None
    if bins < 2:
        raise UsageError(f"bins is {bins}, expected at least 2")
    grids = tuple(ActionGrid(bins, group.action_size) for group in groups)
    for group, grid in zip(groups, grids, strict=True):
        if grid.choices > MAX_CHOICES:
            raise UsageError(
                f"bins is {bins}: {group.name} has {grid.size} actions, {grid.choices} choices, at most "
                f"{MAX_CHOICES} are allowed"
            )
    return grids
