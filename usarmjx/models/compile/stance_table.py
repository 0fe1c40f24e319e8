"""Stances of robots whose wheels and mass differ between worlds, interpolated in tables per class."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.models.compile.randomization import (
    DomainRandomization,
    RandomizedValues,
    Range,
    is_randomized,
)
from usarmjx.models.compile.standing import stance_of, varied_stance
from usarmjx.models.types.robot import RobotSpec

WHEEL_KNOTS, MASS_KNOTS = 9, 3
"""Entries over a range. Between wheels of 0.8 and 1.25 the tilt of a robot with a caster is interpolated to
1.4e-5 rad; springs are linear."""
ALWAYS = (1.0, 1.0)
"""Range of what does not vary."""


@dataclass(frozen=True, eq=False)
class VariedStances:
    """Stances of robots of one class.

    Attributes:
        lift: Changes of the standing height [m] (n,).
        tilt: Orientations of the chassis, of yaw 0 (n, 4).
        joints: Positions of the joints, see `Stance` (n, joints).
    """

    lift: Array
    tilt: Array
    joints: Array


def stances_in(
    vary: DomainRandomization | None,
    varied: RandomizedValues | None,
    robot: RobotSpec,
    slots: Sequence[int] | np.ndarray,
) -> VariedStances | None:
    """Return the stances of robots of a class in one world; None: all have that of the class.

    Args:
        vary: The ranges.
        varied: The world's values.
        robot: The class.
        slots: The robots (n,).
    """
    if vary is None or varied is None or not is_randomized(vary, robot):
        return None
    wheel, mass = vary.wheel, vary.mass
    if wheel is None and mass is None:
        return None
    table, one = _table_of(robot, wheel or ALWAYS, mass or ALWAYS), xp.ones(len(slots))
    where = np.asarray(slots)
    numbers = _interpolated(
        table,
        _place(wheel, WHEEL_KNOTS, one if varied.wheel is None else varied.wheel[where]),
        _place(mass, MASS_KNOTS, one if varied.mass is None else varied.mass[where]),
    )
    tilt = numbers[:, 1:5] / xp.sqrt((numbers[:, 1:5] ** 2).sum(-1, keepdims=True))
    return VariedStances(lift=numbers[:, 0], tilt=tilt, joints=numbers[:, 5:])


@cache
def _table_of(robot: RobotSpec, wheel: Range, mass: Range) -> np.ndarray:
    """Return lift, tilt and joints by wheel and mass (WHEEL_KNOTS, MASS_KNOTS, 5 + joints)."""
    usual = stance_of(robot).height

    def row(factor: float, load: float) -> np.ndarray:
        stance = varied_stance(robot, factor, load)
        return np.array([stance.height - usual, *stance.tilt, *stance.joints], np.float32)

    loads = np.linspace(*mass, MASS_KNOTS).tolist()
    factors = np.linspace(*wheel, WHEEL_KNOTS).tolist()
    return np.array([[row(factor, load) for load in loads] for factor in factors])


def _place(span: Range | None, knots: int, value: Array) -> tuple[Array, Array]:
    """Return the entries below values (n,) in a range, and their shares of the way to the next (n, 1)."""
    low, high = span or ALWAYS
    place = xp.clip((value - low) / max((high - low) / (knots - 1), 1e-9), 0.0, knots - 1.0)
    below = xp.clip(xp.floor(place), 0.0, knots - 2.0)
    return below.astype(xp.int32), (place - below)[:, None]


def _interpolated(table: np.ndarray, wheel: tuple[Array, Array], mass: tuple[Array, Array]) -> Array:
    """Return entries of a table between four of its own (n, numbers)."""
    known = xp.asarray(table)
    (row, along), (column, across) = wheel, mass

    def in_row(row: Array) -> Array:
        return known[row, column] * (1.0 - across) + known[row, column + 1] * across

    return in_row(row) * (1.0 - along) + in_row(row + 1) * along
