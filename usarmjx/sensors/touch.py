"""Touch sensor (manual 10.8)."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.rotations import matvec
from usarmjx.base.settings import POSITIVE
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.sensors.base import SENSORS, Sensor, SensorInput, SensorSettings
from usarmjx.sensors.ranging import BEAM_PATTERN

TOUCH_DISTANCE = 0.0047
"""Distance from the button within which a surface touches it [m] (manual 10.8.1)."""
ORIGIN_SETBACK = 0.01
"""Distance of the rays' origins behind the button's surface [m]. Bodies in contact penetrate by a millimetre
or so, and a ray that started inside a wall would only hit its far side."""


@dataclass(frozen=True)
class TouchSettings(SensorSettings):
    """Manual 10.8.2.

    Attributes:
        diameter: Diameter of the button [m].
    """

    diameter: Annotated[float, POSITIVE] = 0.01


def button_ray_origins(diameter: float) -> np.ndarray:
    """Return the ray origins of a button, on the y-z plane of its mount [m] (rays, 3).

    They are arranged like the rays of a sonar's cone: one in the centre, four at half the radius, four on the
    rim.
    """
    spots = [
        (-ORIGIN_SETBACK, share * math.cos(around) * diameter / 2, share * math.sin(around) * diameter / 2)
        for share, around in BEAM_PATTERN
    ]
    return np.array(spots, np.float32)


@dataclass(frozen=True, eq=False)
class Touch(Sensor):
    """Touch buttons that face along their x axis; value: 1 if touched, else 0 (mounts,)."""

    kind = "Touch"
    grouped = True
    settings_class = TouchSettings

    @cached_property
    def _spots(self) -> np.ndarray:
        """Ray origins of each button on its mount [m] (mounts, rays, 3)."""
        return np.stack([button_ray_origins(settings.diameter) for settings in self.settings])

    def rays(self, bodies: BodyPoses) -> tuple[Array, Array]:
        """Return all buttons' rays, button by button, parallel to its x axis."""
        pos, mat = self.mount_poses(bodies)
        origin = pos[:, None] + matvec(mat[:, None], self._spots)
        along = xp.broadcast_to(mat[:, None, :, 0], origin.shape)
        return origin.reshape(-1, 3), along.reshape(-1, 3)

    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once (manual 10.8.1); the robot's own parts do not count."""
        nearest = inputs.hits.distance.reshape(len(self.mounts), -1).min(-1)
        return memory, (nearest < ORIGIN_SETBACK + TOUCH_DISTANCE).astype(xp.float32)


SENSORS.add(Touch.kind, Touch)
