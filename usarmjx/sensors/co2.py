"""CO2 sensor: `{Gas CO2} {Density ...}` as captured; the manual has no section on it."""

from dataclasses import dataclass
from typing import Any

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.sensors.base import SENSORS, NoisySensorSettings, Sensor, SensorInput, noisy

BREATH_CO2 = 4.0
"""CO2 in breath beyond that of air, percent by volume."""
MOUTH_RADIUS = 0.1
"""Distance from a mouth up to which there is nothing but breath [m] (chosen)."""


@dataclass(frozen=True, eq=False)
class Co2(Sensor):
    """Smells the breath of victims; value: CO2 beyond that of air [percent by volume] ().

    The breath of each thins out with the square of the distance, as sound does: 0.04 % at 1 m, and what is
    beyond 3 m does not show in two decimals. Ours: no source says how the original worked.
    """

    kind = "CO2Sensor"
    needs_surroundings = True
    settings_class = NoisySensorSettings

    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Smell once."""
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
