"""Odometry of robots from their wheels, as ROS expects it: it begins at the start, and drifts.

The estimate is that of the robot's Odometry sensor, advanced from its last reading to the present angles of
the wheels. A robot without such a sensor has the truth, and so has one that a policy drives: nobody reads its
sensors between two of its actions.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import mat_from_quat, quat_times, rotated
from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.drives.base import RobotState
from usarmjx.sensors.motion import Odometry
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld


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
    return OdometryEstimate(pos, quat, mat.T @ linear, np.asarray(state.angular))


def odometry_sensor(world: ServedWorld, robot: Robot) -> int | None:
    """Return the index of the sensor that a robot's odometry comes from; None: it is the truth."""
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
    w, x, y, z = np.asarray(estimate.quat, float)
    pos: list[Any] = estimate.pos.tolist()
    turn = quat_times(list(np.asarray(state.quat, float)), (w, -x, -y, -z))
    return np.asarray(state.pos) - np.array(rotated(turn, pos)), np.array(turn)
