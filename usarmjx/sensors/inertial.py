"""Inertial units, compasses and magnetometers. The manual has none of them.

IMU and magnetometer are modelled on MEMS chips. Attitude reference and magnetic compass are those of
USARSim's later versions, after IMU.uc and MagneticCompass.uc (`hrnr/robocup-usarsim`). Values are in MuJoCo's
axes; the server converts them to USARSim's.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, xp
from usarmjx.base.nodes import Node
from usarmjx.base.rotations import mat_from_rotation_vector, matmul, matvec, rotation_vector, wrap_angle
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, Setting
from usarmjx.base.transforms import GRAVITY, angles_from_mat, flip_vector
from usarmjx.sensors.base import SENSORS, Quantity, Sensor, SensorInput, SensorSettings, vectorized

REST_FORCE = np.array([0.0, 0.0, GRAVITY], np.float32)
"""Specific force of a body at rest, world axes [m/s2]."""
FIRST_INTERVAL = 0.02
"""Assumed duration of the first measurement: a control step [s]."""
# A little more than the exact limits, since files round them up to 1.5708 and 3.1416.
QUARTER_TURN_LIMITS = Setting(ge=-math.pi / 2 - 1e-5, le=math.pi / 2 + 1e-5)
HALF_TURN_LIMITS = Setting(ge=-math.pi - 1e-5, le=math.pi + 1e-5)


@dataclass(frozen=True)
class ImuSettings(SensorSettings):
    """Keys of `[USARBot.IMU]`; noise is of the order of an ADIS16448's (chosen).

    Attributes:
        gyro_noise: Density of the white noise of angular velocities [rad/s/sqrt(Hz)].
        gyro_bias: Standard deviation of their bias at the start [rad/s].
        gyro_bias_walk: Random walk of that bias [rad/s/sqrt(s)].
        gyro_range: Largest angular velocity about an axis [rad/s].
        accel_noise: Density of the white noise of accelerations [m/s2/sqrt(Hz)].
        accel_bias: Standard deviation of their bias at the start [m/s2].
        accel_bias_walk: Random walk of that bias [m/s2/sqrt(s)].
        accel_range: Largest acceleration along an axis [m/s2].
    """

    weight: float = 0.05
    gyro_noise: Annotated[float, NOT_NEGATIVE] = 1.7e-4
    gyro_bias: Annotated[float, NOT_NEGATIVE] = 5e-3
    gyro_bias_walk: Annotated[float, NOT_NEGATIVE] = 2e-5
    gyro_range: Annotated[float, POSITIVE] = 17.45
    accel_noise: Annotated[float, NOT_NEGATIVE] = 2e-3
    accel_bias: Annotated[float, NOT_NEGATIVE] = 0.05
    accel_bias_walk: Annotated[float, NOT_NEGATIVE] = 3e-3
    accel_range: Annotated[float, POSITIVE] = 176.0


class ImuMemory(Node, kw_only=True):
    """Memory of an IMU.

    Attributes:
        velocity: Velocity of its mount at the last measurement, world axes [m/s] (3,).
        mat: Orientation of its mount at the last measurement (3, 3).
        step: Control step of the last measurement ().
        bias: Bias of angular velocities [rad/s] and accelerations [m/s2] (6,).
    """

    velocity: Array
    mat: Array
    step: Array
    bias: Array


@dataclass(frozen=True, eq=False)
class Imu(Sensor):
    """Gyroscopes and accelerometers; value: angular velocity [rad/s], specific force [m/s2], own axes (6,).

    At rest the specific force is 9.81 upward. Both are means since the last measurement, as such a chip
    integrates between two readings: the rotation, and the change of velocity minus gravity, in the
    orientation half-way between both measurements.
    """

    kind = "IMU"
    settings_class = ImuSettings
    quantities = (Quantity("AngularVelocity", "vector"), Quantity("Acceleration", "vector"))

    @cached_property
    def _chain(self) -> np.ndarray:
        """Bodies from the chassis to the mount, without the chassis (n,)."""
        found, body = list[int](), int(self.bodies_of_mounts()[0])
        while body > 0:
            found.append(body)
            body = self.plan.parent[body]
        return np.array(found[::-1], int)

    def _motion(self, inputs: SensorInput, pos: Array) -> tuple[Array, Array]:
        """Return velocity [m/s] and angular velocity [rad/s] of a point (..., 3) of the mount, world axes."""
        state, bodies = inputs.state, inputs.bodies
        # MuJoCo has angular velocities of free bodies in their own axes.
        turn = matvec(bodies.mat[..., 0, :, :], state.angular)
        velocity = state.linear + xp.cross(turn, pos - state.pos)
        for body in self._chain:
            axis = matvec(bodies.mat[..., body, :, :], self.plan.axis[body].astype(np.float32))
            axis = axis * state.joint_vel[..., body - 1, None]
            if self.plan.slides[body]:
                velocity = velocity + axis
            else:
                # Each joint turns everything beyond it: velocities of the chain add up at the mount.
                velocity = velocity + xp.cross(axis, pos - bodies.pos[..., body, :])
                turn = turn + axis
        return velocity, turn

    def _by_kind(self, suffix: str) -> Array:
        """Return a setting of gyroscopes and accelerometers, repeated for all six values (6,)."""
        pair = [getattr(self.settings[0], f"{kind}_{suffix}") for kind in ("gyro", "accel")]
        return xp.repeat(xp.stack([xp.asarray(value, xp.float32) for value in pair]), 3)

    def init_memory(self, inputs: SensorInput, key: Array) -> ImuMemory:
        """Draw the initial bias."""
        pos, mat = self.mount_poses(inputs.bodies)
        velocity, _ = self._motion(inputs, pos[0])
        bias = self._by_kind("bias") * random.normal(key, (6,))
        return ImuMemory(
            velocity=velocity, mat=mat[0], step=xp.asarray(inputs.clock.step, xp.int32), bias=bias
        )

    @vectorized
    def read(self, inputs: SensorInput, memory: ImuMemory, key: Array) -> tuple[ImuMemory, Array]:
        """Measure rotation and change of velocity since the last time, with noise, bias and limits."""
        pos, mat = self.mount_poses(inputs.bodies)
        pos, mat = pos[..., 0, :], mat[..., 0, :, :]
        velocity, turn = self._motion(inputs, pos)
        # A second reading at the same time has no interval: it reports the momentary rate without
        # acceleration.
        elapsed = inputs.clock.since(memory.step)[..., None]
        again, span = elapsed > 0, xp.where(elapsed > 0, elapsed, FIRST_INTERVAL)
        # A rotation leaves its own axis alone, so this vector is the same in the mount's old and new axes.
        turned = rotation_vector(matmul(memory.mat.mT, mat))
        rate = xp.where(again, turned / span, matvec(mat.mT, turn))
        change = xp.where(again, (velocity - memory.velocity) / span, 0.0)
        half_turned = matmul(memory.mat, mat_from_rotation_vector(turned / 2))
        half_way = xp.where(again[..., None], half_turned, mat)
        force = matvec(half_way.mT, change + REST_FORCE)
        # One draw for bias and noise: each call of the generator is a hundred operations to XLA.
        drawn = random.normal(key, (*memory.step.shape, 12))
        # A random walk grows with the root of time, so that it does not depend on the scan interval.
        bias = memory.bias + self._by_kind("bias_walk") * xp.sqrt(elapsed) * drawn[..., :6]
        # White noise of a mean falls with the root of the time that it is taken over.
        noise = self._by_kind("noise") / xp.sqrt(span) * drawn[..., 6:]
        limit = self._by_kind("range")
        # Clipped last: a saturated chip shows its limit, without noise on top.
        measured = xp.clip(xp.concatenate([rate, force], -1) + bias + noise, -limit, limit)
        now = xp.broadcast_to(inputs.clock.step, memory.step.shape)
        return ImuMemory(velocity=velocity, mat=mat, step=now, bias=bias), measured


@dataclass(frozen=True)
class MagnetometerSettings(SensorSettings):
    """Keys of `[USARBot.Magnetometer]`; the field is about that of central Europe (chosen).

    Attributes:
        strength: Strength of the earth's field [uT].
        inclination: Its angle below the horizontal [rad].
        declination: Its angle east of north, which is x in every world [rad].
        hard_iron: Field of the robot's own iron, in the mount's axes as on the wire [uT].
        field_noise: Standard deviation of the noise along each axis [uT].
    """

    weight: float = 0.05
    strength: Annotated[float, NOT_NEGATIVE] = 48.0
    inclination: Annotated[float, QUARTER_TURN_LIMITS] = 1.13
    declination: Annotated[float, HALF_TURN_LIMITS] = 0.0
    hard_iron: tuple[tuple[str, float], ...] = (("X", 0.0), ("Y", 0.0), ("Z", 0.0))
    field_noise: Annotated[float, NOT_NEGATIVE] = 0.1

    def problem(self) -> str:
        """Return a conflict between settings."""
        axes = {str(axis).upper() for axis, _ in self.hard_iron}
        return "" if axes <= set("XYZ") else f"HardIron is {self.hard_iron}, expected X, Y and Z"

    @property
    def field(self) -> np.ndarray:
        """Earth's field in world axes, x to the north and z up [uT] (3,)."""
        # y points west in a world whose x is north: a field to the east is negative there.
        level, east = math.cos(self.inclination), math.sin(self.declination)
        ahead = level * math.cos(self.declination)
        return self.strength * np.array([ahead, -level * east, -math.sin(self.inclination)], np.float32)


@dataclass(frozen=True, eq=False)
class Magnetometer(Sensor):
    """Three-axis magnetometer; value: field in its own axes [uT] (3,)."""

    kind = "Magnetometer"
    settings_class = MagnetometerSettings
    quantities = (Quantity("Field", "vector"),)

    @cached_property
    def _iron(self) -> np.ndarray:
        axes = {str(axis).upper(): value for axis, value in self.settings[0].hard_iron}
        return np.array(flip_vector(tuple(float(axes.get(axis, 0.0)) for axis in "XYZ")), np.float32)  # type: ignore[arg-type]

    @vectorized
    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once."""
        settings = self.settings[0]
        _, mat = self.mount_poses(inputs.bodies)
        # Hard iron turns with the robot: it is added in the mount's axes, behind the rotation.
        seen = matvec(mat[..., 0, :, :].mT, settings.field) + self._iron
        return memory, seen + settings.field_noise * random.normal(key, seen.shape)


for _sensor in (Imu, Magnetometer):
    SENSORS.add(_sensor.kind, _sensor)


# The margin admits 3.1416, which is 7.3e-6 above pi.
HEADING_LIMITS = Setting(unit="rad", ge=-math.pi - 1e-5, le=math.pi + 1e-5)


@dataclass(frozen=True)
class AhrsSettings(SensorSettings):
    """Keys of `[USARSensor.IMU]`: those of all sensors."""


class AhrsMemory(Node, kw_only=True):
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
        # Both branches are computed: 1 instead of 0 avoids 0 / 0 in the one that is not used.
        span = xp.where(later, elapsed, 1.0)
        velocity, angles = inputs.state.linear, angles_from_mat(inputs.bodies.mat[..., 0, :, :], xp)
        _, mat = self.mount_poses(inputs.bodies)
        change = xp.where(later, (velocity - memory.velocity) / span, 0.0)
        force = matvec(mat[..., 0, :, :].mT, change)
        # Wrapped: from +pi to -pi a robot has not spun around.
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

    north: Annotated[float, HEADING_LIMITS] = 0.0


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
        # North is clockwise, as on the wire; headings here are counter-clockwise.
        return memory, wrap_angle(-self.settings[0].north - heading)[..., None]


for _sensor in (Ahrs, MagneticCompass):
    SENSORS.add(_sensor.kind, _sensor)
