"""CO2 sensor: `{Gas CO2} {Density ...}` as captured; the manual has no section on it."""

from dataclasses import dataclass
from typing import Any

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.sensors.base import SENSORS, NoisySensorSettings, Sensor, SensorInput, noisy

BREATH_CO2 = 4.0
"""CO2 in breath in excess of that in air [percent by volume]."""
MOUTH_RADIUS = 0.1
"""Distance from a mouth within which the air is pure breath [m] (chosen)."""


@dataclass(frozen=True, eq=False)
class Co2(Sensor):
    """CO2 sensor for victims' breath; value: CO2 in excess of that in air [percent by volume] ().

    The concentration falls with the square of the distance, like sound: 0.04 % at 1 m, and beyond 3 m it
    vanishes in two decimals. This model is our own: no source describes the original's.
    """

    kind = "CO2Sensor"
    needs_surroundings = True
    settings_class = NoisySensorSettings

    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once."""
        around = inputs.surroundings_or_empty
        pos, _ = self.mount_poses(inputs.bodies)
        far = xp.linalg.norm(xp.asarray(around.mouth) - pos[0], axis=-1)
        breath = xp.where(
            xp.asarray(around.breathes),
            BREATH_CO2 * (MOUTH_RADIUS / xp.maximum(far, MOUTH_RADIUS)) ** 2,
            0.0,
        )
        density = xp.minimum(breath.sum(), BREATH_CO2)
        return memory, noisy(key, density[None], self.settings)[0]


SENSORS.add(Co2.kind, Co2)
