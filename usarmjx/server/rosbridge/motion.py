"""Motion of robots as ROS messages: poses, frames, velocities, odometry out; Twist and JointTrajectory in.

Its axes are ours: x forward, y left, z up.

The estimate is that of the robot's Odometry sensor, advanced from its last reading to the present angles of
the wheels. A robot without such a sensor has the truth, and so has one that a policy drives: nobody reads its
sensors between two of its actions.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, cast

import numpy as np

from usarmjx.base.backend import Array, numpy_backend
from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import mat_from_quat, quat_from_mat, quat_times, rotated
from usarmjx.base.transforms import flip_angles, flip_vector, mat_from_angles, quat_from_angles
from usarmjx.models.compile.kinematic_tree import KinematicTree
from usarmjx.models.drives.base import Drive, RobotState
from usarmjx.models.drives.fluid import Blimp, RotaryWing
from usarmjx.models.drives.ground import Ackermann, OmniDrive, SkidSteer
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.motion import Odometry
from usarmjx.sensors.ranging import ScannerSettings
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion, json_object
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld

STANDS = 1e-6
"""Speed below which a robot counts as standing [m/s]."""
MAP = "map"
"""The world's frame."""
UPRIGHT = mat_from_angles(np.pi / 2, 0.0, 0.0)
"""Rotation from the frame of a scan in the x-z plane to that of its mount: ROS scans about z."""
AHEAD_IS_Z = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation from a picture's frame to its camera's: ROS has x to the right, y down and z ahead there."""
UNKNOWN = -1.0
"""First number of the covariance of an unmeasured quantity."""
MOST_POINTS = 10_000
"""Most points of a trajectory."""


@dataclass(frozen=True, eq=False)
class OdometryEstimate:
    """Pose of a robot in its odometry's frame, and its velocity.

    Attributes:
        pos: Position [m] (3,).
        quat: Orientation, w first (4,).
        linear: Velocity in the robot's own axes [m/s] (3,).
        angular: Angular velocity in its own axes [rad/s] (3,).
    """

    pos: np.ndarray
    quat: np.ndarray
    linear: np.ndarray
    angular: np.ndarray


def true_estimate(state: RobotState) -> OdometryEstimate:
    """Return the true pose in the map, and the true velocity."""
    quat = np.asarray(state.quat)
    with numpy_backend():
        mat = np.asarray(mat_from_quat(quat))
    pos, linear = np.asarray(state.pos), np.asarray(state.linear)
    # Linear velocity is in the world's axes, angular velocity in the robot's own already.
    return OdometryEstimate(pos, quat, mat.T @ linear, np.asarray(state.angular))


def odometry_sensor(world: ServedWorld, robot: Robot) -> int | None:
    """Return the index of the sensor that a robot's odometry comes from; None: it is the truth."""
    # A robot that a policy drives is not the clients': its sensors are not read here.
    if world.robots.get(robot.slot) is not robot:
        return None
    sensors = enumerate(robot.suite.sensors)
    return next((index for index, sensor in sensors if isinstance(sensor, Odometry)), None)


def estimate_of(world: ServedWorld, robot: Robot) -> OdometryEstimate:
    """Return the present odometry of a robot."""
    state, index = world.state(robot), odometry_sensor(world, robot)
    if index is None:
        return true_estimate(state)
    sensor = robot.suite.sensors[index]
    assert isinstance(sensor, Odometry)
    with numpy_backend():
        x, y, heading = map(float, sensor.estimate(state, world.memory(robot).own[index]))
        ahead, turn = map(float, sensor.velocity(state))
    quat = np.asarray(quat_from_angles(0.0, 0.0, heading))
    return OdometryEstimate(
        pos=np.array([x, y, 0.0]),
        quat=quat,
        linear=np.array([ahead, 0.0, 0.0]),
        angular=np.array([0.0, 0.0, turn]),
    )


def drift_of(state: RobotState, estimate: OdometryEstimate) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose of an odometry's frame in the map: position [m] (3,) and orientation, w first (4,).

    Args:
        state: True state of the robot.
        estimate: Its odometry at the same moment.
    """
    # Map to odom is the true pose after the inverse of the estimate, as REP 105 places the drift.
    w, x, y, z = np.asarray(estimate.quat, float)
    pos: list[Any] = estimate.pos.tolist()
    # The conjugate of a unit quaternion is its inverse.
    turn = quat_times(list(np.asarray(state.quat, float)), (w, -x, -y, -z))
    return np.asarray(state.pos) - np.array(rotated(turn, pos)), np.array(turn)


class Velocity(NamedTuple):
    """Commanded velocity of a robot.

    Attributes:
        ahead: [m/s]
        left: [m/s]
        up: [m/s]
        turn: To the left [rad/s].
    """

    ahead: float
    left: float
    up: float
    turn: float


def read_twist(message: object) -> Velocity:
    """Return the velocity of a Twist or TwistStamped; missing numbers are 0.

    Roll and pitch rates are ignored, and so is the header of a TwistStamped.

    Raises:
        UsageError: It is no Twist, or a number is not finite.
    """
    # One subscription takes both kinds: Nav2 and newer controllers send TwistStamped.
    whole = json_object(message) or {}
    if "twist" in whole:
        message = whole["twist"]
    parts = [_part(message, name) for name in ("linear", "angular")]
    linear, angular = ([_number(part, axis) for axis in "xyz"] for part in parts)
    return Velocity(linear[0], linear[1], linear[2], angular[2])


def _part(message: object, name: str) -> Mapping[str, Any]:
    whole = json_object(message)
    part = None if whole is None else json_object(whole.get(name, {}))
    if part is None:
        raise UsageError("a geometry_msgs/Twist has linear and angular, of x, y and z each")
    return part


def _number(part: Mapping[str, Any], axis: str) -> float:
    value = part.get(axis, 0.0)
    # In this form the comparison refuses NaN, too.
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < math.inf:
        raise UsageError(f"{axis} of a geometry_msgs/Twist is {str(value)[:20]!r}, expected a finite number")
    return float(value)


def can_follow(drive: Drive) -> bool:
    """Return whether a drive can follow a Twist."""
    return isinstance(drive, SkidSteer | Ackermann | OmniDrive | RotaryWing | Blimp)


def drive_keys(robot: RobotSpec, velocity: Velocity) -> dict[str, float]:
    """Return the keys of DRIVE for a velocity, as far as the drive can follow; limits apply later.

    Raises:
        UsageError: Its drive cannot follow a Twist.
    """
    drive = robot.drive
    if isinstance(drive, SkidSteer):
        # The lever, where there is one: skidding wheels turn as if they stood further apart.
        half = velocity.turn * (drive.lever or robot.wheel_separation) / 2
        sides = velocity.ahead - half, velocity.ahead + half
        return {"Left": sides[0] / drive.radius, "Right": sides[1] / drive.radius}
    if isinstance(drive, Ackermann):
        return _car_keys(drive, velocity)
    if isinstance(drive, OmniDrive):
        return _wheel_keys(drive, velocity)
    # The wire's lateral and rotational velocities are positive to the right, ROS's to the left.
    if isinstance(drive, RotaryWing | Blimp):
        return {
            "AltitudeVelocity": velocity.up,
            "LinearVelocity": velocity.ahead,
            "LateralVelocity": -velocity.left,
            "RotationalVelocity": -velocity.turn,
        }
    raise UsageError(f"a {robot.name} has no drive that follows a geometry_msgs/Twist")


def _car_keys(drive: Ackermann, velocity: Velocity) -> dict[str, float]:
    """Return speed and angle of the bicycle model of the car; a standing car cannot turn."""
    # Not ahead == 0: a curve of next to no speed would be steered at full lock.
    moves = abs(velocity.ahead) > STANDS
    angle = math.atan(velocity.turn / velocity.ahead * drive.wheel_base) if moves else 0.0
    front = max(-drive.max_front_steer, min(drive.max_front_steer, angle))
    # All three keys: one that a DRIVE leaves out keeps its former value.
    return {"Speed": velocity.ahead / drive.radius, "FrontSteer": front, "RearSteer": 0.0}


def _wheel_keys(drive: OmniDrive, velocity: Velocity) -> dict[str, float]:
    """Return speed and angle of every wheel, along the velocity of its contact with the floor."""
    keys: dict[str, float] = {}
    for number, wheel in enumerate(drive.wheels):
        ahead = velocity.ahead + velocity.turn * wheel.y  # y is to the right
        left = velocity.left + velocity.turn * wheel.x
        angle, speed = 0.0, ahead
        if wheel.steer:
            # A wheel that rolls backwards turns its speed's sign: its angle stays within 90 degrees.
            sign = -1.0 if ahead < 0 else 1.0
            speed = sign * math.hypot(ahead, left)
            angle = math.atan2(sign * left, sign * ahead)
            keys[f"WheelSteer{number}"] = max(-drive.max_steer, min(drive.max_steer, angle))
        if wheel.powered:
            keys[f"WheelSpeed{number}"] = speed / drive.radius
    return keys


class SensorFrame(NamedTuple):
    """Pose of a sensor or a camera on its robot.

    Attributes:
        name: Name of its mount.
        body: Index of its body; 0 is the chassis.
        pos: Position on it [m] (3,).
        mat: Orientation on it (3, 3).
    """

    name: str
    body: int
    pos: np.ndarray
    mat: np.ndarray


def frame_name(text: str) -> str:
    """Return a name in ROS's character set for topics and frames."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", text)
    # ROS wants a letter first: a name of digits alone gets one.
    return plain if plain[:1].isalpha() else f"r{plain}"


def optical_name(camera: str) -> str:
    """Return the name of the frame of a camera's pictures."""
    return f"{camera}_optical"


def frames_of(robot: Robot) -> list[SensorFrame]:
    """Return the frames of a robot's sensors, cameras and parts; of those with one name the first."""
    found: dict[str, SensorFrame] = {}
    for sensor in robot.suite.sensors:
        settings = sensor.settings[0]
        upright = isinstance(settings, ScannerSettings) and settings.pitch
        for mount, body in zip(sensor.mounts, sensor.bodies_of_mounts(), strict=True):
            mat = mat_from_angles(*flip_angles(mount.direction))
            mat = mat @ UPRIGHT if upright else mat
            frame = SensorFrame(mount.name, int(body), np.array(flip_vector(mount.at)), mat)
            found.setdefault(mount.name, frame)
    for camera in robot.cameras:
        name = camera.mount.name
        found.setdefault(name, SensorFrame(name, camera.body, camera.pos, camera.mat))
        picture = optical_name(name)
        found.setdefault(picture, SensorFrame(picture, camera.body, camera.pos, camera.mat @ AHEAD_IS_Z))
    for body, part in enumerate(robot.plan.parts[1:], 1):  # the links of `robot_description`
        found.setdefault(part, SensorFrame(part, body, np.zeros(3), np.eye(3)))
    return list(found.values())


def vector(values: Array | Sequence[float]) -> RosMessage:
    """Return a Vector3 or Point of three numbers."""
    return dict(zip("xyz", map(float, values), strict=True))


def quaternion(quat: Array) -> RosMessage:
    """Return a Quaternion of one with w first (4,)."""
    w, x, y, z = map(float, quat)
    return {"x": x, "y": y, "z": z, "w": w}


def pose(pos: Array | Sequence[float], quat: Array) -> RosMessage:
    """Return a Pose of a position [m] (3,) and an orientation, w first (4,)."""
    return {"position": vector(pos), "orientation": quaternion(quat)}


def pose_of_angles(values: Sequence[float]) -> RosMessage:
    """Return a Pose of a position [m] and roll, pitch and yaw [rad] (6,)."""
    roll, pitch, yaw = map(float, values[3:])
    return pose(values[:3], quat_from_angles(roll, pitch, yaw))


def odometry(version: RosVersion, time: float, name: str, estimate: OdometryEstimate) -> RosMessage:
    """Return an Odometry: the pose in the odometry's frame, and the velocities in the robot's own axes."""
    twist = {"linear": vector(estimate.linear), "angular": vector(estimate.angular)}
    return {
        "header": version.header(time, f"{name}/odom"),
        "child_frame_id": f"{name}/base_link",
        "pose": {"pose": pose(estimate.pos, estimate.quat), "covariance": [0.0] * 36},
        "twist": {"twist": twist, "covariance": [0.0] * 36},
    }


def joint_states(version: RosVersion, time: float, robot: Robot, state: RobotState) -> RosMessage:
    """Return positions [rad or m] and velocities [rad/s or m/s] of a robot's joints."""
    return {
        "header": version.header(time, ""),
        "name": list(robot.plan.parts[1:]),
        "position": np.asarray(state.joint_pos, float).tolist(),
        "velocity": np.asarray(state.joint_vel, float).tolist(),
        # Empty, as JointState has it for quantities that are not measured.
        "effort": [],
    }


def base_transform(version: RosVersion, time: float, name: str, estimate: OdometryEstimate) -> RosMessage:
    """Return the transform of a robot from its odom frame."""
    return transform(version, time, f"{name}/odom", f"{name}/base_link", (estimate.pos, estimate.quat))


def footprint_transform(
    version: RosVersion, time: float, name: str, robot: RobotSpec, state: RobotState, floor: float
) -> RosMessage:
    """Return the transform of `base_footprint` from `base_link`: on the ground below a robot, and level.

    The ground is where a robot of its class stands on it; below one that flies or dives it is the floor [m].
    """
    with numpy_backend():
        mat = np.asarray(mat_from_quat(np.asarray(state.quat)), float)
    # In the robot's own axes: a wheeled robot on a ramp has its footprint on the ramp.
    below = np.array([0.0, 0.0, -robot.origin_height])
    if not robot.drive.is_wheeled:
        below = mat.T @ np.array([0.0, 0.0, floor - float(state.pos[2])])
    yaw = math.atan2(mat[1, 0], mat[0, 0])
    level = mat.T @ mat_from_angles(0.0, 0.0, yaw)
    with numpy_backend():
        turn = np.asarray(quat_from_mat(level))
    return transform(version, time, f"{name}/base_link", f"{name}/base_footprint", (below, turn))


def odom_transform(
    version: RosVersion, time: float, name: str, where: tuple[Array, Array] = (np.zeros(3), np.eye(4)[0])
) -> RosMessage:
    """Return the transform of a robot's odom frame from the map; identity where its odometry is the truth."""
    return transform(version, time, MAP, f"{name}/odom", where)


def sensor_transforms(
    version: RosVersion, time: float, name: str, frames: Sequence[SensorFrame], bodies: tuple[Array, Array]
) -> Iterator[RosMessage]:
    """Yield the transforms of sensors from their robot.

    Args:
        version: Version of its field names.
        time: Simulated time [s].
        name: The robot's, in frames.
        frames: Frames of its sensors.
        bodies: Poses of its bodies: positions [m] (bodies, 3), orientations (bodies, 3, 3).
    """
    positions, mats = (np.asarray(one) for one in bodies)
    for frame in frames:
        pos = positions[frame.body] + mats[frame.body] @ frame.pos
        own = mats[0].T @ (pos - positions[0])
        with numpy_backend():
            quat = quat_from_mat(mats[0].T @ mats[frame.body] @ frame.mat)
        yield transform(version, time, f"{name}/base_link", f"{name}/{frame_name(frame.name)}", (own, quat))


def transform(
    version: RosVersion, time: float, parent: str, child: str, where: tuple[Array, Array]
) -> RosMessage:
    """Return the transform of a frame from its parent: position [m] (3,) and orientation, w first (4,)."""
    return {
        "header": version.header(time, parent),
        "child_frame_id": child,
        "transform": {"translation": vector(where[0]), "rotation": quaternion(where[1])},
    }


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """Positions of joints over time.

    Attributes:
        joints: Their names on the robot.
        times: Times of the points since the start, rising [s] (points,).
        positions: Positions at the points [rad or m] (points, joints).
        velocities: Velocities there [rad/s or m/s] (points, joints); None: positions change linearly.
        start: Time of the start [s]; 0: at once.
    """

    joints: tuple[str, ...]
    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray | None = None
    start: float = 0.0


@dataclass(eq=False)
class TrajectoryRun:
    """A trajectory that a robot follows.

    Attributes:
        trajectory: The trajectory.
        start: Simulated time of its start [s].
        before: Positions at the start [rad or m] (joints,).
    """

    trajectory: JointTrajectory
    start: float
    before: np.ndarray = field(repr=False)

    def is_over(self, now: float) -> bool:
        """Return whether its last point has passed at a time [s]."""
        return now - self.start >= self.trajectory.times[-1]

    def at(self, now: float) -> dict[str, float]:
        """Return the joints' positions at a time [s], by their names.

        Between two points they follow a line, or the cubic with the velocities of both points.
        """
        path = self.trajectory
        # The position at the start is the first knot: joints move to the first point and do not jump.
        times = np.concatenate(([0.0], path.times))
        knots = np.concatenate((self.before[None], path.positions))
        time = min(max(now - self.start, 0.0), float(times[-1]))
        # Cut at both ends: there is always a knot before and one behind.
        after = min(max(int(np.searchsorted(times, time, side="right")), 1), len(times) - 1)
        span = float(times[after] - times[after - 1])
        # A first point at time 0 leaves no span: its positions hold at once.
        share = (time - float(times[after - 1])) / span if span > 0.0 else 1.0
        low, high = knots[after - 1], knots[after]
        values = low + share * (high - low)
        if path.velocities is not None and span > 0.0:
            # Hermite's cubic; the joints stand still before the first point.
            speeds = np.concatenate((np.zeros_like(self.before)[None], path.velocities))
            bend_low = speeds[after - 1] * span - (high - low)
            bend_high = (high - low) - speeds[after] * span
            values = values + share * (1 - share) * ((1 - share) * bend_low + share * bend_high)
        return dict(zip(path.joints, values.tolist(), strict=True))


def read_trajectory(message: object, plan: KinematicTree) -> JointTrajectory | None:
    """Return the trajectory of a message for a robot; None for one without points, which stops the robot.

    Raises:
        UsageError: It is no trajectory, or not one for this robot.
    """
    whole = json_object(message)
    if whole is None:
        raise UsageError("a trajectory_msgs/JointTrajectory has joint_names and points")
    points = _list(whole, "points")
    if not points:
        return None
    joints = tuple(_joint(name, plan) for name in _list(whole, "joint_names"))
    if not joints:
        raise UsageError("joint_names of a trajectory_msgs/JointTrajectory is empty")
    if len(set(joints)) < len(joints):
        raise UsageError("joint_names of a trajectory_msgs/JointTrajectory names a joint twice")
    if len(points) > MOST_POINTS:
        raise UsageError(f"a trajectory has at most {MOST_POINTS} points, not {len(points)}")
    read = [json_object(point) or {} for point in points]
    times = np.array([_seconds(point.get("time_from_start")) for point in read])
    if times[0] < 0.0 or (np.diff(times) <= 0.0).any():
        raise UsageError("time_from_start of a trajectory's points must rise, from 0 on")
    positions = np.array([_numbers(point, "positions", len(joints)) for point in read])
    # All or none: a cubic needs the velocities at both of its ends.
    has_speeds = all(point.get("velocities") for point in read)
    speeds = np.array([_numbers(point, "velocities", len(joints)) for point in read]) if has_speeds else None
    header = json_object(whole.get("header")) or {}
    return JointTrajectory(joints, times, positions, speeds, _seconds(header.get("stamp")))


def _joint(name: object, plan: KinematicTree) -> str:
    index = plan.joint_index(name) if isinstance(name, str) else None
    if index is None:
        raise UsageError(
            f"{plan.robot.name} has no joint {clip(str(name))}; it has: {', '.join(plan.parts[1:])}"
        )
    return plan.parts[1 + index]


def _list(message: RosMessage, key: str) -> Sequence[Any]:
    values = message.get(key, [])
    if not isinstance(values, list):
        raise UsageError(f"{key} of a trajectory_msgs/JointTrajectory is no list")
    return cast(list[Any], values)


def _numbers(point: Mapping[str, Any], key: str, count: int) -> list[float]:
    values = point.get(key, [])
    items = cast(list[Any], values) if isinstance(values, list) else []
    # By type, as a bool is an int in Python.
    if len(items) != count or not all(type(one) in (int, float) and math.isfinite(one) for one in items):
        raise UsageError(f"{key} of a trajectory's point are {count} finite numbers, one for each joint")
    return [float(one) for one in items]


def _seconds(time: object) -> float:
    """Return a time or duration of either version [s]; 0 without one."""
    parts = json_object(time) or {}
    # ROS 1 has secs and nsecs, ROS 2 sec and nanosec.
    whole, rest = parts.get("sec", parts.get("secs", 0)), parts.get("nanosec", parts.get("nsecs", 0))
    # By type, as a bool is an int in Python.
    if type(whole) is not int or type(rest) is not int:
        raise UsageError("a time has whole numbers sec and nanosec")
    return whole + rest * 1e-9
