"""Battery meter. An extension; the manual has the remaining time only in STA (9.3)."""

from dataclasses import dataclass
from typing import Annotated, Any

from usarmjx.base.backend import Array, xp
from usarmjx.base.settings import POSITIVE
from usarmjx.sensors.base import (
    SENSORS,
    NoisySensorSettings,
    Quantity,
    Sensor,
    SensorInput,
    noisy,
    vectorized,
)


@dataclass(frozen=True)
class BatterySettings(NoisySensorSettings):
    """Keys of `[USARBot.Battery]`: a six-cell lithium polymer battery (chosen).

    Attributes:
        scan_interval: Time between two measurements [s].
        full_voltage: Voltage of the full battery [V].
        empty_voltage: Voltage of the empty battery [V].
    """

    scan_interval: float = 1.0
    full_voltage: Annotated[float, POSITIVE] = 25.2
    empty_voltage: Annotated[float, POSITIVE] = 19.8

    def problem(self) -> str:
        """Return a conflict between settings."""
        if self.empty_voltage > self.full_voltage:
            return (
                f"EmptyVoltage is {self.empty_voltage:g}, expected at most FullVoltage, {self.full_voltage:g}"
            )
        return ""


@dataclass(frozen=True, eq=False)
class BatteryMeter(Sensor):
    """Battery meter; value: charge as a fraction, voltage [V], and remaining time [s] (3,).

    Charge and voltage fall linearly over the robot's `battery_life`, like the value in STA; noise is on the
    voltage. Water that destroys a battery empties it.
    """

    kind = "Battery"
    needs_battery = True
    settings_class = BatterySettings
    quantities = (Quantity("Charge"), Quantity("Voltage"), Quantity("TimeLeft"))

    @vectorized
    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once."""
        settings, life = self.settings[0], self.plan.robot.battery_life
        full = xp.full(inputs.state.pos.shape[:-1], life)
        # None where inputs are made without rays, as at the start of an episode.
        left = full if inputs.battery is None else xp.asarray(inputs.battery, xp.float32)
        charge = xp.clip(left / life, 0.0, 1.0)
        voltage = settings.empty_voltage + charge * (settings.full_voltage - settings.empty_voltage)
        noisy_voltage = noisy(key, voltage[..., None], self.settings)
        return memory, xp.concatenate([charge[..., None], noisy_voltage, left[..., None]], -1)


SENSORS.add(BatteryMeter.kind, BatteryMeter)
