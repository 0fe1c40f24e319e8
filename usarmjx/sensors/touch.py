"""Touch sensor (manual 10.8)."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.rotations import matvec
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.types.settings import POSITIVE
from usarmjx.sensors.base import SENSORS, Sensor, SensorInput, SensorSettings
from usarmjx.sensors.ranging import BEAM_PATTERN

TRIGGER = 0.0047
"""A thing nearer to the button than this touches it [m] (manual 10.8.1)."""
SETBACK = 0.01
"""How far behind the button's surface its lines start [m]. Things in contact sink into each other by a
millimetre or so, and a line that started inside a wall would only meet its far side."""


@dataclass(frozen=True)
class TouchSettings(SensorSettings):
    """Manual 10.8.2.

    Attributes:
        diameter: Of the button [m].
    """

    diameter: Annotated[float, POSITIVE] = 0.01


def button_ray_origins(diameter: float) -> np.ndarray:
    """Return where the lines of a button start, which is the y-z plane of its mount [m] (lines, 3).

    They stand on the button as those of a sonar's beam do in their cone: one in the middle, four half
    way out, four on the rim.
    """
    spots = [
        (-SETBACK, share * math.cos(around) * diameter / 2, share * math.sin(around) * diameter / 2)
        for share, around in BEAM_PATTERN
    ]
    return np.array(spots, np.float32)


@dataclass(frozen=True, eq=False)
class Touch(Sensor):
    """Buttons that look along their x axis; value: 1 where one is touched, else 0 (mounts,)."""

    kind = "Touch"
    grouped = True
    settings_class = TouchSettings

    @cached_property
    def _spots(self) -> np.ndarray:
        """Where the lines of each button start on its mount [m] (mounts, lines, 3)."""
        return np.stack([button_ray_origins(settings.diameter) for settings in self.settings])

    def rays(self, bodies: BodyPoses) -> tuple[Array, Array]:
        """All buttons' lines, button by button, parallel to its x axis."""
        pos, mat = self.mount_poses(bodies)
        origin = pos[:, None] + matvec(mat[:, None], self._spots)
        along = xp.broadcast_to(mat[:, None, :, 0], origin.shape)
        return origin.reshape(-1, 3), along.reshape(-1, 3)

    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Feel once (manual 10.8.1); the robot's own parts do not count."""
        nearest = inputs.hits.distance.reshape(len(self.mounts), -1).min(-1)
        return memory, (nearest < SETBACK + TRIGGER).astype(xp.float32)


SENSORS.add(Touch.kind, Touch)
