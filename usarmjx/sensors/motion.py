"""Sensors of the robot's own motion: odometry, INS, encoder, ground truth (manual 10.4, 10.6, 10.7).

Tachometer, altitude sensor and mission time are those of USARSim's later versions, after Tachometer.uc,
AltitudeSensor.uc and MissionTime.uc (`hrnr/robocup-usarsim`); the manual has none of them. Values are in
MuJoCo's axes; the server converts them to USARSim's.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, xp
from usarmjx.base.errors import SpecError
from usarmjx.base.nodes import Node
from usarmjx.base.rotations import mat_from_rotation_vector, matmul, matvec, rotation_vector, wrap_angle
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, Parameters, Setting
from usarmjx.base.transforms import angles_from_mat, flip_angles, mat_from_angles
from usarmjx.models.drives.base import RobotState
from usarmjx.models.types.robot import ANGLE_STEP, Mount
from usarmjx.sensors.base import (
    SENSORS,
    NoisySensorSettings,
    Quantity,
    Sensor,
    SensorInput,
    SensorSettings,
    noisy,
    normal_factor,
    relative_normal,
    vectorized,
)

RELATIVE_ERROR = Setting(gt=-1)
"""Relative error; above -1, so that the measured value stays positive."""


@dataclass(frozen=True)
class OdometrySettings(SensorSettings):
    """Manual 10.4.2.

    Attributes:
        encoder_resolution: Smallest measurable wheel angle [rad].
        left_tire: Wheel of the left side; empty: the left-most.
        right_tire: Wheel of the right side; empty: the right-most.
        diameter_error: Relative error of the measured wheel diameter. Own key, like the next: the manual
            names both errors (10.4.1) without keys.
        separation_error: Relative error of the measured wheel separation.
        mean: Mean of the relative noise on each wheel's path.
        sigma: Standard deviation of that noise (manual 10.6.2: any sensor may have it).
    """

    scan_interval: float = 0.2
    encoder_resolution: Annotated[float, ANGLE_STEP] = 0.01
    left_tire: str = "LeftFWheel"
    right_tire: str = "RightFWheel"
    diameter_error: Annotated[float, RELATIVE_ERROR] = 0.0
    separation_error: Annotated[float, RELATIVE_ERROR] = 0.0
    mean: float = 0.0
    sigma: Annotated[float, NOT_NEGATIVE] = 0.0


class OdometryMemory(Node, kw_only=True):
    """Memory of odometry.

    Attributes:
        pose: Estimate of x, y [m] and heading [rad] (3,).
        ticks: Wheel ticks included in the estimate, left and right (2,).
    """

    pose: Array
    ticks: Array


@dataclass(frozen=True, eq=False)
class Odometry(Sensor):
    """Dead reckoning from two wheel encoders; value: x, y [m], heading [rad] since the start (3,)."""

    kind = "Odometry"
    opcodes: ClassVar[dict[str, Parameters]] = {"RESET": Parameters()}
    settings_class = OdometrySettings

    def _wheel(self, name: str, leftmost: bool) -> int:
        names = [wheel.name for wheel in self.plan.robot.wheels]
        if name and name not in names:
            raise SpecError(f"Odometry {self.mounts[0].name}: no wheel {name!r}; wheels: {', '.join(names)}")
        joints = [self.plan.parts.index(wheel) - 1 for wheel in names]
        if name:
            return joints[names.index(name)]
        # Part 0 is the chassis, so joint k moves part k + 1; y points left.
        leftward = [self.plan.rest_pos[joint + 1, 1] for joint in joints]
        return joints[int(np.argmax(leftward) if leftmost else np.argmin(leftward))]

    def check(self) -> None:
        """Check mounts and settings; see `Sensor.check`."""
        super().check()
        # For its errors: an unknown wheel is refused with the robot, not at the first reading.
        _ = self._pair

    @cached_property
    def _pair(self) -> np.ndarray:
        """Joints of the left and the right wheel (2,)."""
        settings = self.settings[0]
        return np.array([self._wheel(settings.left_tire, True), self._wheel(settings.right_tire, False)])

    def _ticks(self, state: RobotState) -> Array:
        # From the absolute angle: the fraction of a tick is not lost between two readings.
        return xp.trunc(state.joint_pos[..., self._pair] / self.settings[0].encoder_resolution)

    def init_memory(self, inputs: SensorInput, key: Array) -> OdometryMemory:
        """Start the estimate at the current pose."""
        return OdometryMemory(pose=xp.zeros(3), ticks=self._ticks(inputs.state))

    @vectorized
    def read(self, inputs: SensorInput, memory: OdometryMemory, key: Array) -> tuple[OdometryMemory, Array]:
        """Advance the estimate by the ticks since the last time, along the old heading."""
        ticks, settings = self._ticks(inputs.state), self.settings[0]
        ways = relative_normal(key, self._ways(ticks, memory), settings.mean, settings.sigma)
        pose = self._advanced(memory.pose, ways)
        return OdometryMemory(pose=pose, ticks=ticks), pose

    def estimate(self, state: RobotState, memory: OdometryMemory) -> Array:
        """Return the estimate for the present wheel angles, without noise since the last reading (3,)."""
        return self._advanced(memory.pose, self._ways(self._ticks(state), memory))

    def velocity(self, state: RobotState) -> Array:
        """Return speed ahead [m/s] and turning rate to the left [rad/s] by the spins of the wheels (2,)."""
        # The measured radius, errors and all: what a robot believes of itself.
        speeds = state.joint_vel[..., self._pair] * self._radius
        left, right = speeds[..., 0], speeds[..., 1]
        return xp.stack([(left + right) / 2, (right - left) / self._separation], -1)

    @property
    def _radius(self) -> float:
        """Measured wheel radius [m]."""
        return self.plan.robot.wheel_radius * (1 + self.settings[0].diameter_error)

    @property
    def _separation(self) -> float:
        """Measured wheel separation [m]."""
        return self.plan.robot.wheel_separation * (1 + self.settings[0].separation_error)

    def _ways(self, ticks: Array, memory: OdometryMemory) -> Array:
        """Return the ways of the left and the right wheel since the last reading [m] (2,)."""
        return (ticks - memory.ticks) * self.settings[0].encoder_resolution * self._radius

    def _advanced(self, pose: Array, ways: Array) -> Array:
        """Return a pose advanced by the ways of the wheels along its heading (3,)."""
        left, right = ways[..., 0], ways[..., 1]
        x, y, heading = (pose[..., i] for i in range(3))
        advance = (left + right) / 2
        turned = heading + (right - left) / self._separation
        return xp.stack(
            # Along the old heading, not the mean of old and new: the estimate drifts in turns, as
            # simple dead reckoning does.
            [x + advance * xp.cos(heading), y + advance * xp.sin(heading), wrap_angle(turned)],
            -1,
        )

    def handle_set(
        self, opcode: str, params: tuple[float, ...], inputs: SensorInput, memory: OdometryMemory
    ) -> OdometryMemory | None:
        """Handle RESET: the current pose becomes the reference (manual, Table 4)."""
        return self.init_memory(inputs, xp.zeros(0)) if opcode.upper() == "RESET" else None


@dataclass(frozen=True)
class InsSettings(SensorSettings):
    """Manual 10.6 (its 9.5.2).

    Attributes:
        mean: Mean of the relative noise.
        sigma: Standard deviation of the relative noise.
        drifting: Whether the estimate drifts.
        precision: Inverse of the drift rate.
        polar_step: Whether a step is added along the heading whatever its direction, as the manual words it:
            climbs and sideways motion are lost then. Own key.
    """

    weight: float = 0.1
    scan_interval: float = 0.2
    mean: float = 0.0
    sigma: Annotated[float, NOT_NEGATIVE] = 0.1
    drifting: Annotated[bool, Setting(manual_key="Drifting")] = False
    precision: Annotated[float, POSITIVE] = 1000.0
    polar_step: Annotated[bool, Setting(manual_key="PolarStep")] = False


class InsMemory(Node, kw_only=True):
    """Memory of the INS.

    Attributes:
        pos: Estimated position [m] (3,).
        mat: Estimated orientation (3, 3).
        true_pos: True position at the last step [m] (3,).
        true_mat: True orientation at the last step (3, 3).
        step: Control step of the last estimate ().
        drift_rate: Drift of x, y, z [m/s] and about x, y, z [rad/s] (6,).
    """

    pos: Array
    mat: Array
    true_pos: Array
    true_mat: Array
    step: Array
    drift_rate: Array


@dataclass(frozen=True, eq=False)
class Ins(Sensor):
    """Inertial navigation; value: estimated position [m] and roll, pitch, yaw [rad] (6,)."""

    kind = "INS"
    opcodes: ClassVar[dict[str, Parameters]] = {"POSE": Parameters(6, 6)}
    settings_class = InsSettings

    def init_memory(self, inputs: SensorInput, key: Array) -> InsMemory:
        """Start the estimate at the true pose, with a drift rate for each component.

        The manual gives no formula for the drift, only that a higher Precision means less of it and that
        components drift differently: here a constant rate, uniform in +-1/Precision.
        """
        pos, mat = self.mount_poses(inputs.bodies)
        rate = random.uniform(key, (6,), minval=-1.0, maxval=1.0) / self.settings[0].precision
        return InsMemory(
            pos=pos[0],
            mat=mat[0],
            true_pos=pos[0],
            true_mat=mat[0],
            step=xp.asarray(inputs.clock.step, xp.int32),
            # Times 0 instead of left out: memories have one structure whatever the settings.
            drift_rate=rate * float(self.settings[0].drifting),
        )

    @vectorized
    def read(self, inputs: SensorInput, memory: InsMemory, key: Array) -> tuple[InsMemory, Array]:
        """Apply the manual's seven steps, with the last three on the motion in the robot's axes.

        On a straight drive that equals the manual's step. The distance of `polar_step` has the sign of the
        motion along the heading; the manual's has none, so that a robot that backs up would count as driving
        forward.
        """
        settings = self.settings[0]
        pos, mat = self.mount_poses(inputs.bodies)
        pos, mat = pos[..., 0, :], mat[..., 0, :, :]
        elapsed = inputs.clock.since(memory.step)[..., None]
        # A second reading in the same step has no interval, and no rotation either: 0 / 1e-6 is 0.
        span = xp.maximum(elapsed, 1e-6)
        # As a rotation vector: differences of Euler angles jump at half a turn and depend on their order.
        rate = rotation_vector(matmul(memory.true_mat.mT, mat)) / span  # 1
        factor = normal_factor(key, (*rate.shape[:-1], 4), settings.mean, settings.sigma)
        rate = rate * factor[..., :3]  # 2
        drift = memory.drift_rate * elapsed
        # The error builds up on the estimate, not on the truth: that is what makes an INS drift away.
        estimate = matmul(memory.mat, mat_from_rotation_vector(rate * span + drift[..., 3:]))  # 3
        # In the robot's axes: the estimate then goes the same way along its own, wrong heading.
        path = matvec(mat.mT, pos - memory.true_pos)
        if settings.polar_step:
            distance = xp.linalg.norm(path, axis=-1) * xp.sign(path[..., 0])  # 4
            path = distance[..., None] * np.array([1.0, 0.0, 0.0], np.float32)
        position = memory.pos + matvec(estimate, factor[..., 3:] * path) + drift[..., :3]  # 5, 6, 7
        angles = angles_from_mat(estimate, xp)
        now = xp.broadcast_to(inputs.clock.step, memory.step.shape)
        memory = memory.replace(pos=position, mat=estimate, true_pos=pos, true_mat=mat, step=now)
        return memory, xp.concatenate([position, angles], -1)

    def handle_set(
        self, opcode: str, params: tuple[float, ...], inputs: SensorInput, memory: InsMemory
    ) -> InsMemory | None:
        """Handle POSE: set the estimate to x, y, z, roll, pitch, yaw (MuJoCo's axes) and end the drift."""
        if opcode.upper() != "POSE" or len(params) != 6:
            return None
        roll, pitch, yaw = xp.asarray(params[3:])
        mat = mat_from_angles(roll, pitch, yaw, xp)
        return memory.replace(pos=xp.asarray(params[:3]), mat=mat, drift_rate=xp.zeros(6))


@dataclass(frozen=True, eq=False)
class Inu(Ins):
    """Inertial navigation under its older name, which Player uses; value: as of an INS (6,)."""

    kind = "INU"


@dataclass(frozen=True)
class EncoderSettings(NoisySensorSettings):
    """Manual 10.7.2.

    Attributes:
        resolution: Angle of one tick [rad].
    """

    resolution: Annotated[float, ANGLE_STEP] = 0.01745
    noise: float = 0.005


@dataclass(frozen=True, eq=False)
class Encoder(Sensor):
    """Rotation of the part of each mount, about the mount's x axis; value: ticks (mounts,).

    The memory is the angle of each part at the last RESET [rad] (mounts,).
    """

    kind = "Encoder"
    opcodes: ClassVar[dict[str, Parameters]] = {"RESET": Parameters()}
    grouped = True
    settings_class = EncoderSettings

    def _sign(self, mount: Mount) -> float:
        looks_along = mat_from_angles(*flip_angles(mount.direction))[:, 0]
        axis = self.plan.axis[self.plan.parts.index(mount.parent)]
        # The mount may look along the axis or against it: counts are of turns about the mount's own x.
        return float(np.dot(looks_along, axis))

    def check(self) -> None:
        """Check mounts and settings; see `Sensor.check`."""
        super().check()
        # Body 0 is the chassis, which no joint turns.
        if (self.bodies_of_mounts() == 0).any():
            raise SpecError("an encoder needs a part that turns, not the chassis")

    @cached_property
    def _joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Joint of each mount's part, and the sign of its rotation, both (mounts,)."""
        sign = np.array([self._sign(mount) for mount in self.mounts], np.float32)
        # Joint k moves body k + 1.
        return self.bodies_of_mounts() - 1, sign

    def _angles(self, inputs: SensorInput) -> Array:
        joints, sign = self._joints
        return xp.asarray(inputs.state.joint_pos[..., joints] * sign)

    def init_memory(self, inputs: SensorInput, key: Array) -> Array:
        """Start all counts at zero."""
        return self._angles(inputs)

    @vectorized
    def read(self, inputs: SensorInput, memory: Array, key: Array) -> tuple[Array, Array]:
        """Divide the angle by the resolution, noise first (manual 10.7.1)."""
        angles = self._angles(inputs) - memory
        resolution = np.array([settings.resolution for settings in self.settings], np.float32)
        # Towards zero, so that a turn back gives the same count with the other sign.
        return memory, xp.trunc(noisy(key, angles, self.settings) / resolution)

    def handle_set(
        self, opcode: str, params: tuple[float, ...], inputs: SensorInput, memory: Array
    ) -> Array | None:
        """Handle RESET: set the counts to zero (manual, Table 5)."""
        return self.init_memory(inputs, xp.zeros(0)) if opcode.upper() == "RESET" else None


@dataclass(frozen=True)
class GroundTruthSettings(SensorSettings):
    """Captured CONF: ScanInterval 0.05; captured lines carry the time."""

    with_time_stamp: bool = True
    scan_interval: float = 0.05


@dataclass(frozen=True, eq=False)
class GroundTruth(Sensor):
    """True pose of the mount; value: position [m] and roll, pitch, yaw [rad] (6,)."""

    kind = "GroundTruth"
    settings_class = GroundTruthSettings

    @vectorized
    def read(self, inputs: SensorInput, memory: tuple[()], key: Array) -> tuple[tuple[()], Array]:
        """Return the pose."""
        pos, mat = self.mount_poses(inputs.bodies)
        return memory, xp.concatenate([pos[..., 0, :], angles_from_mat(mat[..., 0, :, :], xp)], -1)


for _sensor in (Odometry, Ins, Inu, Encoder, GroundTruth):
    SENSORS.add(_sensor.kind, _sensor)


ROUNDING = 1e-3
"""Time that a minute may lack because of single precision [s]."""


@dataclass(frozen=True)
class TachometerSettings(SensorSettings):
    """Keys of `[USARSensor.Tachometer]`: those of all sensors."""


class TachometerMemory(Node, kw_only=True):
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
        # Both branches are computed: 1 instead of 0 avoids 0 / 0 in the one that is not used.
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
