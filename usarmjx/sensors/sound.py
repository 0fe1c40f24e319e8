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
"""Lower bound of a source's distance [m]."""


@dataclass(frozen=True)
class SoundSettings(NoisySensorSettings):
    """Manual 10.11.2; noise is on the loudness.

    Attributes:
        output_curve: Points of the loudness's distortion curve; none: undistorted.
    """

    noise: float = 0.05
    output_curve: OutputCurve = ()

    def problem(self) -> str:
        """Return a conflict between settings."""
        return curve_problem(self.output_curve)


@dataclass(frozen=True, eq=False)
class Sound(Sensor):
    """Microphone for the loudest victim; value: loudness, and duration of its cries [s] (2,).

    Walls do not attenuate sound: the manual has only the square of the distance. In silence both are 0.
    """

    kind = "Sound"
    needs_surroundings = True
    settings_class = SoundSettings

    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once."""
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
