"""Sound sensor (manual 10.11)."""

from dataclasses import dataclass
from typing import Any

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.sensors.base import (
    SENSORS,
    NoisySensorSettings,
    OutputCurve,
    Sensor,
    SensorInput,
    apply_output_curve,
    curve_problem,
    noisy,
)

MIN_SOURCE_DISTANCE = 0.1
"""Sources sound no louder from nearer than this [m]."""


@dataclass(frozen=True)
class SoundSettings(NoisySensorSettings):
    """Manual 10.11.2; noise is on the loudness.

    Attributes:
        output_curve: Points of the distortion curve of the loudness; none: undistorted.
    """

    noise: float = 0.05
    output_curve: OutputCurve = ()

    def problem(self) -> str:
        """Return what settings do not go together."""
        return curve_problem(self.output_curve)


@dataclass(frozen=True, eq=False)
class Sound(Sensor):
    """Hears the victim that is the loudest here; value: loudness, and how long its cries last [s] (2,).

    Walls do not dampen sound: the manual has the square of the distance and nothing else. In silence both
    are 0.
    """

    kind = "Sound"
    needs_surroundings = True
    settings_class = SoundSettings

    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Listen once."""
        settings, around = self.settings[0], inputs.surroundings_or_empty
        if around.mouth.shape[0] == 0:
            return memory, xp.zeros(2)
        pos, _ = self.mount_poses(inputs.bodies)
        far = xp.maximum(xp.linalg.norm(xp.asarray(around.mouth) - pos[0], axis=-1), MIN_SOURCE_DISTANCE)
        loud = xp.asarray(around.loudness) / far**2
        best = xp.argmax(loud)
        heard = apply_output_curve(noisy(key, loud[best][None], self.settings)[0], settings.output_curve)
        lasts = xp.where(loud[best] > 0, xp.asarray(around.duration)[best], 0.0)
        return memory, xp.stack([heard, lasts])


SENSORS.add(Sound.kind, Sound)
