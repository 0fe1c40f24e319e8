"""CO2 sensor: `{Gas CO2} {Density ...}` as captured; the manual has no section on it."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from usarmjx.sensors.base import SENSORS, Measuring, Sensor, Sight
from usarmjx.sensors.noise import noisy

EXHALED = 4.0
"""CO2 in breath beyond that of air, percent by volume."""
MOUTH = 0.1
"""Distance from a mouth up to which there is nothing but breath [m] (chosen)."""


@dataclass(frozen=True, eq=False)
class Co2(Sensor):
    """Smells the breath of victims; value: CO2 beyond that of air [percent by volume] ().

    The breath of each thins out with the square of the distance, as sound does: 0.04 % at 1 m, and what is
    beyond 3 m does not show in two decimals. Ours: no source says how the original worked.
    """

    kind = "CO2Sensor"
    looks_around = True
    defaults = Measuring

    def read(self, sight: Sight, memory: Any, key: jax.Array) -> tuple[Any, jax.Array]:  # noqa: ANN401
        """Smell once."""
        around = sight.around
        pos, _ = self.mount_poses(sight.bodies)
        far = jnp.linalg.norm(jnp.asarray(around.mouth) - pos[0], axis=-1)
        breath = jnp.where(
            jnp.asarray(around.breathes), EXHALED * (MOUTH / jnp.maximum(far, MOUTH)) ** 2, 0.0
        )
        density = jnp.minimum(breath.sum(), EXHALED)
        return memory, noisy(key, density[None], self.settings)[0]


SENSORS.add(Co2.kind, Co2)
