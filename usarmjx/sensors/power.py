"""Battery meter: what is left in a robot's battery. Ours; the manual has the time left in STA alone (9.3)."""

from dataclasses import dataclass
from typing import Annotated, Any

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.models.types.settings import POSITIVE
from usarmjx.sensors.base import SENSORS, NoisySensorSettings, Quantity, Sensor, SensorInput, for_teams, noisy


@dataclass(frozen=True)
class BatterySettings(NoisySensorSettings):
    """Keys of `[USARBot.Battery]`: six cells of a lithium polymer battery (chosen).

    Attributes:
        scan_interval: Time between two measurements [s].
        full_voltage: Its voltage when full [V].
        empty_voltage: Its voltage when empty [V].
    """

    scan_interval: float = 1.0
    full_voltage: Annotated[float, POSITIVE] = 25.2
    empty_voltage: Annotated[float, POSITIVE] = 19.8

    def problem(self) -> str:
        """Return what settings do not go together."""
        if self.empty_voltage > self.full_voltage:
            return (
                f"EmptyVoltage is {self.empty_voltage:g}, expected at most FullVoltage, {self.full_voltage:g}"
            )
        return ""


@dataclass(frozen=True, eq=False)
class BatteryMeter(Sensor):
    """Meter of the battery; value: charge as a share, voltage [V], and for how long it lasts yet [s] (3,).

    The charge falls evenly during the robot's `battery_life`, as the one of STA, and the voltage with it;
    noise is on the voltage. Water that kills a battery leaves nothing.
    """

    kind = "Battery"
    needs_battery = True
    settings_class = BatterySettings
    quantities = (Quantity("Charge"), Quantity("Voltage"), Quantity("TimeLeft"))

    @for_teams
    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once."""
        settings, life = self.settings[0], self.plan.robot.battery_life
        full = xp.full(inputs.state.pos.shape[:-1], life)
        left = full if inputs.battery is None else xp.asarray(inputs.battery, xp.float32)
        charge = xp.clip(left / life, 0.0, 1.0)
        voltage = settings.empty_voltage + charge * (settings.full_voltage - settings.empty_voltage)
        told = noisy(key, voltage[..., None], self.settings)
        return memory, xp.concatenate([charge[..., None], told, left[..., None]], -1)


SENSORS.add(BatteryMeter.kind, BatteryMeter)
