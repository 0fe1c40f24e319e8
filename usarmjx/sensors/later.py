"""Tachometer, altitude sensor and mission time of USARSim's later versions, on the Unreal Development Kit.

The facts are those of Tachometer.uc, AltitudeSensor.uc and MissionTime.uc (`hrnr/robocup-usarsim`). The
manual has none of them.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.errors import SpecError
from usarmjx.base.parameters import Parameters
from usarmjx.sensors.base import SENSORS, Quantity, Sensor, SensorInput, SensorSettings, vectorized

ROUNDING = 1e-3
"""Time that a minute may lack because of single precision [s]."""


@dataclass(frozen=True)
class TachometerSettings(SensorSettings):
    """Keys of `[USARSensor.Tachometer]`: those of all sensors."""


class TachometerMemory(struct.PyTreeNode, kw_only=True):
    """Memory of a tachometer.

    Attributes:
        angles: Angles of the wheels at the last reading [rad] (wheels,).
        step: Control step of the last reading ().
    """

    angles: Array
    step: Array


@dataclass(frozen=True, eq=False)
class Tachometer(Sensor):
    """Spin of the driven wheels since the last reading; value: spins [rad/s], angles [rad] (2 wheels,).

    A positive spin rolls forward. The first reading has the momentary spins.
    """

    kind = "Tachometer"
    opcodes: ClassVar[dict[str, Parameters]] = {"RESET": Parameters()}
    settings_class = TachometerSettings

    @cached_property
    def _joints(self) -> np.ndarray:
        """Joints of the driven wheels (wheels,)."""
        driven = [wheel.name for wheel in self.plan.robot.wheels if wheel.motor is not None]
        return np.array([self.plan.joint_index(name) for name in driven], int)

    def check(self) -> None:
        """Check mounts and settings; see `Sensor.check`."""
        super().check()
        if not len(self._joints):
            raise SpecError(f"Tachometer {self.mounts[0].name}: {self.plan.robot.name} has no driven wheels")

    def init_memory(self, inputs: SensorInput, key: Array) -> TachometerMemory:
        """Start at the present angles."""
        angles = xp.asarray(inputs.state.joint_pos[..., self._joints])
        return TachometerMemory(angles=angles, step=xp.asarray(inputs.clock.step, xp.int32))

    @vectorized
    def read(
        self, inputs: SensorInput, memory: TachometerMemory, key: Array
    ) -> tuple[TachometerMemory, Array]:
        """Divide the rotation since the last reading by its time."""
        angles = inputs.state.joint_pos[..., self._joints]
        elapsed = inputs.clock.since(memory.step)[..., None]
        later = elapsed > 0
        mean = (angles - memory.angles) / xp.where(later, elapsed, 1.0)
        spins = xp.where(later, mean, inputs.state.joint_vel[..., self._joints])
        now = xp.broadcast_to(inputs.clock.step, memory.step.shape)
        return TachometerMemory(angles=angles, step=now), xp.concatenate([spins, angles], -1)

    def handle_set(
        self, opcode: str, params: tuple[float, ...], inputs: SensorInput, memory: TachometerMemory
    ) -> TachometerMemory | None:
        """Handle RESET: the spin is counted from now (WheelSensor.uc)."""
        return self.init_memory(inputs, xp.zeros(0)) if opcode.upper() == "RESET" else None


@dataclass(frozen=True)
class AltitudeSettings(SensorSettings):
    """Keys of `[USARSensor.AltitudeSensor]`.

    Attributes:
        asl: Height of the place where the robot appears above the sea [m].
    """

    asl: float = 111.0


@dataclass(frozen=True, eq=False)
class AltitudeSensor(Sensor):
    """Altimeter; value: height above the start, and above the sea, which is 0 at least [m] (2,)."""

    kind = "AltitudeSensor"
    settings_class = AltitudeSettings
    quantities = (Quantity("relativeAltitude"), Quantity("absoluteAltitude"))

    def init_memory(self, inputs: SensorInput, key: Array) -> Array:
        """Keep the height of the start."""
        return xp.asarray(inputs.state.pos[..., 2], xp.float32)

    @vectorized
    def read(self, inputs: SensorInput, memory: Array, key: Array) -> tuple[Array, Array]:
        """Measure the chassis's height."""
        risen = inputs.state.pos[..., 2] - memory
        return memory, xp.stack([risen, xp.maximum(self.settings[0].asl + risen, 0.0)], -1)


@dataclass(frozen=True)
class MissionTimeSettings(SensorSettings):
    """Keys of `[USARSensor.MissionTime]`: those of all sensors."""


@dataclass(frozen=True, eq=False)
class MissionTime(Sensor):
    """Clock of the mission; value: whole minutes since the robot appeared (1,)."""

    kind = "MissionTime"
    settings_class = MissionTimeSettings
    quantities = (Quantity("Minutes", "count"),)

    def init_memory(self, inputs: SensorInput, key: Array) -> Array:
        """Keep the time of the start."""
        return xp.asarray(inputs.clock.step, xp.int32)

    @vectorized
    def read(self, inputs: SensorInput, memory: Array, key: Array) -> tuple[Array, Array]:
        """Count the minutes."""
        minutes = xp.floor((inputs.clock.since(memory) + ROUNDING) / 60.0)
        return memory, minutes[..., None]


for _sensor in (Tachometer, AltitudeSensor, MissionTime):
    SENSORS.add(_sensor.kind, _sensor)
