"""Attitude sensors of USARSim's later versions: their inertial unit and their compass.

The facts are those of IMU.uc and MagneticCompass.uc (`hrnr/robocup-usarsim`). The manual has neither.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Any

from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.rotations import matvec, wrap_angle
from usarmjx.base.settings import Setting
from usarmjx.base.transforms import angles_from_mat
from usarmjx.sensors.base import SENSORS, Quantity, Sensor, SensorInput, SensorSettings, vectorized

HALF_TURN_LIMITS = Setting(unit="rad", ge=-math.pi - 1e-5, le=math.pi + 1e-5)


@dataclass(frozen=True)
class AhrsSettings(SensorSettings):
    """Keys of `[USARSensor.IMU]`: those of all sensors."""


class AhrsMemory(struct.PyTreeNode, kw_only=True):
    """Memory of an attitude and heading reference.

    Attributes:
        velocity: Velocity of the chassis at the last reading, world axes [m/s] (3,).
        angles: Its roll, pitch and yaw then [rad] (3,).
        rates: Rates of these angles at the last reading [rad/s] (3,).
        step: Control step of the last reading ().
    """

    velocity: Array
    angles: Array
    rates: Array
    step: Array


@dataclass(frozen=True, eq=False)
class Ahrs(Sensor):
    """Attitude and heading reference, the later versions' IMU; value: as below (12,).

    Acceleration of the chassis in the sensor's axes without gravity [m/s2] (3,); the chassis' roll, pitch and
    yaw as rates [rad/s] (3,), accelerations [rad/s2] (3,) and angles [rad] (3,). All but the angles are
    differences since the last reading; the first reading has zeros.
    """

    kind = "AHRS"
    settings_class = AhrsSettings

    def init_memory(self, inputs: SensorInput, key: Array) -> AhrsMemory:
        """Keep the motion at the start."""
        angles = angles_from_mat(inputs.bodies.mat[0], xp)
        return AhrsMemory(
            velocity=xp.asarray(inputs.state.linear),
            angles=angles,
            rates=xp.zeros_like(angles),
            step=xp.asarray(inputs.clock.step, xp.int32),
        )

    @vectorized
    def read(self, inputs: SensorInput, memory: AhrsMemory, key: Array) -> tuple[AhrsMemory, Array]:
        """Divide the changes since the last reading by its time."""
        elapsed = inputs.clock.since(memory.step)[..., None]
        later = elapsed > 0
        span = xp.where(later, elapsed, 1.0)
        velocity, angles = inputs.state.linear, angles_from_mat(inputs.bodies.mat[..., 0, :, :], xp)
        _, mat = self.mount_poses(inputs.bodies)
        change = xp.where(later, (velocity - memory.velocity) / span, 0.0)
        force = matvec(mat[..., 0, :, :].mT, change)
        rates = xp.where(later, wrap_angle(angles - memory.angles) / span, memory.rates)
        accelerations = xp.where(later, (rates - memory.rates) / span, 0.0)
        now = xp.broadcast_to(inputs.clock.step, memory.step.shape)
        value = xp.concatenate([force, rates, accelerations, angles], -1)
        return AhrsMemory(velocity=velocity, angles=angles, rates=rates, step=now), value


@dataclass(frozen=True)
class CompassSettings(SensorSettings):
    """Keys of `[USARSensor.MagneticCompass]`.

    Attributes:
        north: Yaw of north as on the wire, clockwise from x [rad]; there the map has it as a sundial.
    """

    north: Annotated[float, HALF_TURN_LIMITS] = 0.0


@dataclass(frozen=True, eq=False)
class MagneticCompass(Sensor):
    """Compass; value: angle from the chassis' heading to north, to the left positive [rad] (1,)."""

    kind = "MagneticCompass"
    settings_class = CompassSettings
    quantities = (Quantity("MagneticAngle", "yaw"),)

    @vectorized
    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once."""
        mat = inputs.bodies.mat[..., 0, :, :]
        heading = xp.arctan2(mat[..., 1, 0], mat[..., 0, 0])
        return memory, wrap_angle(-self.settings[0].north - heading)[..., None]


for _sensor in (Ahrs, MagneticCompass):
    SENSORS.add(_sensor.kind, _sensor)
