"""Up to which speed the robots of a single world are sound: what they drive and what they fell together."""

from collections.abc import Iterable, Mapping

import numpy as np

from usarmjx.base.transforms import GRAVITY
from usarmjx.sim.robot_group import RobotGroup
from usarmjx.sim.world import runaway_limit

MAX_FALL = 1000.0
"""Whoever has fallen further below the highest place where it was [m] has left the world, and is put back."""


class SpeedLimits:
    """Remembers how high robots have been.

    Args:
        groups: The robots.
        tops: Highest place of some of them so far, by slot [m].
        qpos: Where they are (nq,).
        period: Length of a control step [s].
    """

    def __init__(
        self, groups: Iterable[RobotGroup], tops: Mapping[int, float], qpos: np.ndarray, period: float
    ) -> None:
        robots = [
            (int(slot), index.root_qposadr + 2, runaway_limit(group.robot))
            for group in groups
            for slot, index in zip(group.slots, group.indices, strict=True)
        ]
        self._slots = [slot for slot, _, _ in robots]
        self._heights = np.array([address for _, address, _ in robots], int)
        self._drives = np.array([limit for _, _, limit in robots])
        self._step = GRAVITY * period
        self._tops = np.array([tops.get(slot, float(qpos[address])) for slot, address, _ in robots])

    @property
    def tops(self) -> dict[int, float]:
        """Highest place of each robot so far, by slot [m]."""
        return dict(zip(self._slots, self._tops.tolist(), strict=True))

    def begin_again(self, slots: Iterable[int], qpos: np.ndarray) -> None:
        """Forget how high robots have been: they are somewhere else now."""
        here = np.isin(self._slots, list(slots))
        self._tops[here] = qpos[self._heights[here]]

    def update(self, qpos: np.ndarray) -> dict[int, float]:
        """Look where robots are; return how fast each may be after the next control step [m/s], by slot."""
        height = qpos[self._heights]
        height = np.where(np.isfinite(height), height, self._tops)
        self._tops = np.maximum(self._tops, height)
        fallen = np.sqrt(2 * GRAVITY * np.minimum(self._tops - height, MAX_FALL)) + self._step
        return dict(zip(self._slots, np.hypot(self._drives, fallen).tolist(), strict=True))
